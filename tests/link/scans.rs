//! Scans of a robot on another machine: they cross the link while somebody at the base looks.

use crate::fleets::{Fleet, LIMIT, TestFolder, caught_up, start, until};
use mr_slam::process::link::LinkReport;
use operator::client::{Client, Event};
use std::time::{Duration, Instant};

/// Period at which a client looks for messages.
const POLL: Duration = Duration::from_millis(50);

/// Returns the bytes of scans that a machine has sent or received over the link.
fn scan_bytes(fleet: &Fleet) -> u64 {
    let report = LinkReport::read(&fleet.run.dir).unwrap_or_default();
    report.peers.iter().filter_map(|peer| peer.bytes.get("scan")).sum()
}

#[test]
fn scans_cross_the_link_only_while_somebody_looks() {
    let folder = TestFolder::new();
    let (mut base, mut robot) = start(folder.path());
    until("the base has the robot's map", LIMIT, || caught_up(&mut base, &mut robot));
    assert_eq!((scan_bytes(&robot), scan_bytes(&base)), (0, 0), "nobody looks");

    let mut client = Client::new(format!("127.0.0.1:{}", base.run.port));
    client.handle().subscribe("/alice/scan", "sensor_msgs/LaserScan");
    let mut scans = 0;
    until("a client of the base has scans", LIMIT, || {
        client.poll(Instant::now() + POLL, &mut |event| {
            if let Event::Message { topic: "/alice/scan", .. } = event {
                scans += 1;
            }
        });
        (scans >= 10).then_some(())
    });
    let seen = scan_bytes(&robot);
    assert!(seen > 0, "the link has counted them");

    // Nobody looks any more: after the demand has run out the counters stand still.
    drop(client);
    let mut before = (scan_bytes(&robot), Instant::now());
    until("no scan crosses any more", LIMIT, || {
        let bytes = scan_bytes(&robot);
        if bytes != before.0 {
            before = (bytes, Instant::now());
        }
        (before.1.elapsed() > Duration::from_secs(4)).then_some(())
    });
}
