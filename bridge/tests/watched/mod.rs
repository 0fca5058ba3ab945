//! Runs a test on one thread, for 60 s at most.

use std::future::Future;
use std::time::Duration;
use tokio::task::LocalSet;

/// No test takes this long unless it hangs.
const WATCHDOG: Duration = Duration::from_secs(60);

/// Runs a test; fails if it hangs.
pub fn run(test: impl Future<Output = ()>) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    LocalSet::new().block_on(&runtime, async {
        tokio::time::timeout(WATCHDOG, test).await.expect("the test hangs");
    });
}
