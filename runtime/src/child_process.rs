//! Starts further processes of this program, also after its file was replaced by another build.

use crate::child_messages::redirect;
use crate::shared_memory::{SHARED_MEMORY, close_descriptors_on_exec};
use crate::storage::free_bytes;
use rustix::process::{Pid, Signal, kill_process};
use std::io;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, Command, ExitStatus};

/// Name of the program, as `ps` shows it.
const PROGRAM: &str = "mr-slam";
/// The file that this process runs. It is there as long as the process, whatever is at its path by now.
const OWN_FILE: &str = "/proc/self/exe";

/// Returns a command that runs this very program. A process of another build would not understand this one's messages.
pub fn own_program() -> Command {
    let mut command = Command::new(OWN_FILE);
    command.arg0(PROGRAM);
    command
}

/// Starts a child that takes part in the fleet: it inherits no descriptors but its standard streams, and its messages are collected
/// if [`crate::child_messages::ChildMessages`] are. It has a process group of its
/// own, as Ctrl-C is for the launcher alone.
///
/// # Errors
/// The system cannot start it.
pub fn spawn(command: &mut Command) -> io::Result<Child> {
    close_descriptors_on_exec()?;
    redirect(command)?;
    command.process_group(0).spawn()
}

/// Gives this process the program's name, which it has not by itself if it was started by [`own_program`].
pub fn set_own_name() {
    // Only the lists of processes show it.
    let _ = rustix::thread::set_name(c"mr-slam");
}

/// What the kernel sends when shared memory runs out.
const SIGBUS: i32 = Signal::BUS.as_raw();
/// What the kernel sends at the limit of a file's size.
const SIGXFSZ: i32 = Signal::XFSZ.as_raw();

/// Describes how a process ended, for people.
pub fn describe_end(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("exit code {code}"),
        (None, Some(SIGBUS)) => {
            let free = free_bytes(Path::new(SHARED_MEMORY)).unwrap_or(0);
            format!("signal {SIGBUS}, as when {SHARED_MEMORY} is full: {:.1} MB free", free as f64 * 1e-6)
        }
        (None, Some(SIGXFSZ)) => format!("signal {SIGXFSZ}: a file would exceed the limit of `ulimit -f`"),
        (None, Some(signal)) => format!("signal {signal}"),
        (None, None) => "no reason given".into(),
    }
}

/// Sends a signal to a child that was not waited for yet.
pub fn signal(child: &Child, signal: Signal) {
    if let Some(pid) = Pid::from_raw(child.id() as i32) {
        let _ = kill_process(pid, signal);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Set for the process that the test starts.
    const IS_CHILD: &str = "MR_SLAM_TEST_CHILD";

    /// Links this test's program, runs it by the link, and has it start itself after the link was deleted.
    #[test]
    fn a_program_whose_file_is_gone_starts_itself_again() {
        let own = std::env::current_exe().unwrap();
        let this_test = [
            "--exact",
            "child_process::tests::a_program_whose_file_is_gone_starts_itself_again",
            "--nocapture",
        ];
        match std::env::var(IS_CHILD).as_deref() {
            Err(_) => {
                // A copy would be open for writing in the processes that other tests start meanwhile, and could not be started then.
                let folder = tempfile::tempdir_in(own.parent().unwrap()).unwrap();
                let link = folder.path().join("link");
                std::fs::hard_link(own, &link).unwrap();
                let output = Command::new(&link).args(this_test).env(IS_CHILD, "first").output().unwrap();
                let printed = String::from_utf8_lossy(&output.stdout).into_owned();
                assert!(
                    output.status.success() && printed.contains("the second runs as mr-slam"),
                    "{printed}"
                );
            }
            Ok("first") => {
                std::fs::remove_file(own).unwrap();
                let mut second = own_program();
                let status = spawn(second.args(this_test).env(IS_CHILD, "second")).unwrap().wait().unwrap();
                assert!(status.success());
            }
            Ok(_) => {
                let name = std::env::args().next().unwrap();
                println!("the second runs as {name}");
            }
        }
    }
}
