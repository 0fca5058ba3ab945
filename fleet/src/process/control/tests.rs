use super::files::FileThread;
use super::*;
use crate::config::FleetConfig;
use crate::emergency_stop_file::latch_stop;
use crate::job_thread::JobWorker;
use crate::storage::{DiskStorage, FileCount, Storage};
use ::bridge::{ADDRESSES_MAX, BridgeConfig};
use formats::map_file::MapFileError;
use msg::{Grid, GridView, NavigationAction, RobotId};
use saved_state::{BridgeSnapshot, SavedFiles, stop_file};
use std::net::IpAddr;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex};

/// What has not happened by then never happens.
const WAIT_MAX: Duration = Duration::from_secs(20);

/// A disk that answers only while it is open.
#[derive(Clone)]
struct StalledDisk(Arc<(Mutex<bool>, Condvar)>);

impl StalledDisk {
    fn new() -> Self {
        Self(Arc::new((Mutex::new(true), Condvar::new())))
    }

    fn set_open(&self, is_open: bool) {
        *self.0.0.lock().unwrap() = is_open;
        self.0.1.notify_all();
    }

    fn wait(&self) {
        let (open, changed) = &*self.0;
        drop(changed.wait_timeout_while(open.lock().unwrap(), WAIT_MAX, |open| !*open).unwrap());
    }
}

impl Storage for StalledDisk {
    fn read(&self, path: &Path, bytes_max: u64) -> io::Result<Vec<u8>> {
        self.wait();
        // Root may read any file: here it is a user who may not.
        if path.metadata().is_ok_and(|about| about.permissions().mode() & 0o777 == 0) {
            return Err(io::ErrorKind::PermissionDenied.into());
        }
        DiskStorage.read(path, bytes_max)
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.replace(path, bytes)
    }

    fn replace(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.wait();
        DiskStorage.replace(path, bytes)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.wait();
        DiskStorage.remove(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.wait();
        DiskStorage.rename(from, to)
    }

    fn append(&self, _: &Path, _: u64, _: &[u8]) -> io::Result<()> {
        unreachable!("the bridge appends to no file")
    }

    fn write_map(&self, _: &Path, _: GridView<'_>, _: &[&str]) -> Result<(), MapFileError> {
        unreachable!("the bridge writes no map")
    }

    fn read_map(&self, path: &Path) -> Result<Grid, MapFileError> {
        DiskStorage.read_map(path)
    }

    fn count_files(&self, _: &Path, _: usize) -> io::Result<FileCount> {
        unreachable!("the bridge counts no files")
    }
}

fn run_in(folder: &Path) -> Run {
    let bridge = BridgeConfig { remember: false, ..Default::default() };
    let mut run = Run::in_memory(FleetConfig { bridge, ..FleetConfig::default() }).unwrap();
    run.dir = folder.into();
    run
}

fn control_on(run: &Run, disk: &StalledDisk) -> RefCell<Control<FileThread>> {
    let bridge = Rc::new(Bridge::new(run.config.bridge.clone(), 2, |_, _| {}).unwrap());
    let files = restore_files(&bridge, run, disk.clone(), Monotonic(0));
    RefCell::new(Control::new(bridge, run, FileThread::start(files).unwrap()))
}

/// Runs an exchange to its end, which a thread of files may delay.
fn block_on<T>(future: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
    runtime.block_on(async { timeout(WAIT_MAX, future).await.expect("no answer") })
}

#[test]
fn a_disk_that_does_not_answer_delays_neither_the_loop_nor_a_stop() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path());
    let disk = StalledDisk::new();
    let control = control_on(&run, &disk);
    disk.set_open(false);
    // The loop goes on, and at most one update waits for the disk, however often it is due.
    for step in 1..1000 {
        control.borrow_mut().update_files(Monotonic(step));
    }
    let stop =
        block_on(async { timeout(Duration::from_millis(1), answer(&control, Request::Stop, now)).await });
    assert!(stop.is_err(), "the disk has not answered");
    assert!(control.borrow().bridge.is_stopped(), "the stop does not wait for it");

    disk.set_open(true);
    assert!(block_on(answer(&control, Request::Stop, now)).unwrap().stopped);
    assert!(stop_file(&run.dir).exists());
    assert!(!block_on(answer(&control, Request::Release, now)).unwrap().stopped);
    assert!(!stop_file(&run.dir).exists());
}

#[test]
fn a_stop_that_comes_by_the_disk_is_set_and_survives_an_earlier_release() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path());
    let disk = StalledDisk::new();
    let control = control_on(&run, &disk);
    latch_stop(&DiskStorage, &stop_file(&run.dir), Monotonic(1)).unwrap();
    // Any request but those for the state and for a stop waits until the files are read.
    assert!(block_on(answer(&control, Request::Allow([10, 0, 0, 7].into()), now)).unwrap().stopped);
    assert!(!block_on(answer(&control, Request::Release, now)).unwrap().stopped);
    latch_stop(&DiskStorage, &stop_file(&run.dir), Monotonic(2)).unwrap();
    assert!(block_on(answer(&control, Request::Deny([10, 0, 0, 7].into()), now)).unwrap().stopped);
    assert!(stop_file(&run.dir).exists());
}

#[test]
fn a_state_that_cannot_be_read_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path());
    let disk = StalledDisk::new();
    std::fs::write(run.dir.join("bridge.json"), "{").unwrap();
    let control = control_on(&run, &disk);
    block_on(answer(&control, Request::Allow([10, 0, 0, 7].into()), now)).unwrap();
    let content = |name: &str| std::fs::read_to_string(run.dir.join(name)).unwrap();
    assert_eq!(content("bridge.json.unreadable"), "{");
    assert!(content("bridge.json").contains("10.0.0.7"));
}

#[test]
fn a_stop_that_only_another_user_may_read_is_set_and_can_be_released() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path());
    let disk = StalledDisk::new();
    let control = control_on(&run, &disk);
    let path = stop_file(&run.dir);
    for stop in 1..3 {
        latch_stop(&DiskStorage, &path, Monotonic(stop)).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o0)).unwrap();
        assert!(block_on(answer(&control, Request::Allow([10, 0, 0, 7].into()), now)).unwrap().stopped);
        assert!(!block_on(answer(&control, Request::Release, now)).unwrap().stopped && !path.exists());
    }
}

#[test]
fn a_stop_that_is_set_anew_before_a_release_is_saved_is_not_released() {
    for mode in [0o600, 0o0] {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path());
        let bridge = Bridge::new(run.config.bridge.clone(), 2, |_, _| {}).unwrap();
        let mut files = SavedFiles::restore(&bridge, &run, StalledDisk::new(), Monotonic(0));
        let path = stop_file(&run.dir);
        let mut set_anew = |stops_applied| {
            latch_stop(&DiskStorage, &path, Monotonic(1 + stops_applied)).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            // The bridge has set and released those before.
            let released = BridgeSnapshot::take(&bridge, run.begun, stops_applied, Monotonic(0));
            files.update(&released).unwrap();
            (files.stops_found(), path.exists())
        };
        for stops_applied in 0..3 {
            assert_eq!(set_anew(stops_applied), (stops_applied + 1, true), "mode {mode:o}");
        }
    }
}

#[test]
fn requests_beyond_what_may_wait_for_the_disk_are_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path());
    let disk = StalledDisk::new();
    let control = control_on(&run, &disk);
    disk.set_open(false);
    let refused = (0..100).find_map(|_| {
        let answer = answer(&control, Request::Release, now);
        block_on(async { timeout(Duration::from_millis(1), answer).await }).ok()
    });
    disk.set_open(true);
    assert_eq!(
        refused.expect("waiting requests are bounded").unwrap_err(),
        RequestError::DiskBusy.to_string()
    );
}

/// Counts the jobs. Their disk is full while `is_full`.
#[derive(Default)]
struct CountedJobs {
    count: usize,
    is_full: bool,
    /// Number of jobs for which there is room; further ones are refused.
    room: Option<usize>,
}

impl JobWorker<FileJob, FileReport> for CountedJobs {
    fn submit(&mut self, _: FileJob) -> oneshot::Receiver<FileReport> {
        self.count += 1;
        let result = if self.is_full { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) };
        let (sender, receiver) = oneshot::channel();
        if self.room.is_some_and(|room| self.count > room) {
            return receiver;
        }
        sender.send(FileReport { stops_found: 0, result }).unwrap();
        receiver
    }
}

#[test]
fn a_bridge_that_does_not_change_reads_the_stop_file_and_one_that_changes_saves_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path());
    let bridge = Rc::new(Bridge::new(run.config.bridge.clone(), 2, |_, _| {}).unwrap());
    let mut control = Control::new(bridge.clone(), &run, CountedJobs::default());
    let second = Duration::from_secs(1).as_nanos() as u64;
    // Called each millisecond: once for what is to be saved at the start, then whenever the file is due.
    (0..second).step_by(1_000_000).for_each(|at| control.update_files(Monotonic(at)));
    assert_eq!(control.files.count, 5);
    control.update_files(Monotonic(second));
    bridge.stop_robots();
    control.update_files(Monotonic(second + 1));
    assert_eq!(control.files.count, 7, "the stop is saved before the file is due");
    control.update_files(Monotonic(second + 2));
    assert_eq!(control.files.count, 7);

    control.files.is_full = true;
    bridge.release_stop();
    (3..13).for_each(|step| control.update_files(Monotonic(second + step)));
    assert_eq!(control.files.count, 17, "what a full disk refused is tried again each time");
}

/// The run's folder is replaced by a file: nothing can be written there.
fn lose_folder(run: &Run) {
    std::fs::remove_dir_all(&run.dir).unwrap();
    std::fs::write(&run.dir, "").unwrap();
}

#[test]
fn an_answer_names_what_was_not_saved_and_what_follows() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(&folder.path().join("run"));
    std::fs::create_dir(&run.dir).unwrap();
    let control = control_on(&run, &StalledDisk::new());
    let ask = |request| block_on(answer(&control, request, now)).unwrap();
    let address = [10, 0, 0, 7].into();
    assert_eq!(ask(Request::Allow(address)).not_saved, None);
    assert_eq!(ask(Request::Stop).not_saved, None);
    // The stop's file cannot be removed, as a folder is in its place. The state beside it is saved all the same.
    let stop = stop_file(&run.dir);
    std::fs::remove_file(&stop).unwrap();
    std::fs::create_dir(&stop).unwrap();
    std::fs::set_permissions(&stop, std::fs::Permissions::from_mode(0o0)).unwrap();
    let released = ask(Request::Release);
    std::fs::set_permissions(&stop, std::fs::Permissions::from_mode(0o700)).unwrap();
    let why = released.not_saved.unwrap();
    assert!(!released.stopped && why.contains("may set the emergency stop again"), "{why}");
    assert!(why.contains("stopped") && !why.contains("bridge.json"), "{why}");
    assert!(ask(Request::State).not_saved.is_some(), "the state goes on saying so");

    lose_folder(&run);
    for (request, expected) in [
        (Request::Stop, "may not set the emergency stop"),
        (Request::Deny(address), "after a restart 10.0.0.7 may drive"),
        (Request::Deny(address), "knows the selected robot, who drives and who may drive as they were"),
    ] {
        let why = ask(request).not_saved.unwrap();
        assert!(why.contains(expected), "{request:?}: {why}");
    }
    std::fs::remove_file(&run.dir).unwrap();
    std::fs::create_dir(&run.dir).unwrap();
    assert_eq!(ask(Request::Release).not_saved, None, "the disk is there again");
}

#[test]
fn a_release_whose_save_finds_no_room_is_not_answered_as_refused() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path());
    let bridge = Rc::new(Bridge::new(run.config.bridge.clone(), 2, |_, _| {}).unwrap());
    bridge.stop_robots();
    // The first job is that before the release.
    let files = CountedJobs { room: Some(1), ..CountedJobs::default() };
    let control = RefCell::new(Control::new(bridge, &run, files));
    let state = block_on(answer(&control, Request::Release, now)).unwrap();
    assert!(!state.stopped && state.not_saved.is_some_and(|why| why.contains("does not answer")));
}

#[test]
fn who_is_denied_does_not_wait_for_the_disk() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path());
    let disk = StalledDisk::new();
    let control = control_on(&run, &disk);
    disk.set_open(false);
    let address = [10, 0, 0, 7].into();
    let deny = answer(&control, Request::Deny(address), now);
    assert!(block_on(async { timeout(Duration::from_millis(1), deny).await }).is_err(), "no answer yet");
    assert_eq!(control.borrow().bridge.denied_addresses(), [address]);
    disk.set_open(true);
}

#[test]
fn a_file_of_denied_addresses_that_cannot_be_read_sets_the_emergency_stop() {
    for content in [&b"10.0.0.7\n"[..], b"", b"\xff\xfe10.0.0.7\n"] {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path());
        std::fs::write(saved_state::denied_file(&run), content).unwrap();
        let bridge = Bridge::new(run.config.bridge.clone(), 2, |_, _| {}).unwrap();
        restore_files(&bridge, &run, DiskStorage, Monotonic(0));
        let is_text = std::str::from_utf8(content).is_ok();
        assert_eq!(bridge.is_stopped(), !is_text, "{content:?}");
        // A denial writes the file anew.
        let files = PermissionFiles::new(&run, DiskStorage);
        files.remember([10, 0, 0, 8].into(), false).unwrap();
        let next = Bridge::new(run.config.bridge.clone(), 2, |_, _| {}).unwrap();
        files.deny(&next);
        assert!(!next.is_stopped() && next.denied_addresses().contains(&[10, 0, 0, 8].into()));
    }
}

fn numbered_lines(count: usize) -> String {
    (0..count).map(|i| format!("10.0.{}.{}\n", i / 256, i % 256)).collect()
}

#[test]
fn more_denied_addresses_than_are_kept_set_the_emergency_stop() {
    for (count, is_stopped) in [(ADDRESSES_MAX, false), (ADDRESSES_MAX + 1, true)] {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path());
        std::fs::write(saved_state::denied_file(&run), numbered_lines(count)).unwrap();
        let bridge = Bridge::new(run.config.bridge.clone(), 2, |_, _| {}).unwrap();
        restore_files(&bridge, &run, DiskStorage, Monotonic(0));
        assert_eq!((bridge.is_stopped(), bridge.denied_addresses().len()), (is_stopped, ADDRESSES_MAX));
    }
}

#[test]
fn who_has_no_place_among_the_denied_is_not_allowed_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path());
    std::fs::write(saved_state::denied_file(&run), numbered_lines(ADDRESSES_MAX)).unwrap();
    let disk = StalledDisk::new();
    disk.set_open(true);
    let control = control_on(&run, &disk);
    let address = IpAddr::from([10, 1, 0, 7]);
    block_on(answer(&control, Request::Allow(address), now)).unwrap();
    let why = block_on(answer(&control, Request::Deny(address), now)).unwrap_err();
    assert!(why.contains("NOT denied") && why.contains("--trust-lan"), "{why}");
    drop(control);
    let bridge = Bridge::new(run.config.bridge.clone(), 2, |_, _| {}).unwrap();
    restore_files(&bridge, &run, DiskStorage, Monotonic(0));
    assert!(!bridge.allowed_addresses().contains(&address));
}

#[test]
fn who_is_denied_after_a_restart_of_the_bridge_loses_the_goals_of_before() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path());
    let disk = StalledDisk::new();
    disk.set_open(true);
    let (robot, address) = (RobotId::new(1).unwrap(), IpAddr::from([10, 0, 0, 7]));
    let control = control_on(&run, &disk);
    control.borrow().bridge.restore_navigation_senders(&[(robot, address)], None);
    block_on(answer(&control, Request::Stop, now)).unwrap();
    block_on(answer(&control, Request::Release, now)).unwrap();
    drop(control);

    let bridge = Bridge::new(run.config.bridge.clone(), 2, |_, _| {}).unwrap();
    restore_files(&bridge, &run, DiskStorage, Monotonic(0));
    let paused = Rc::new(RefCell::new(Vec::new()));
    let sink = paused.clone();
    bridge.on_navigation(move |robot, command| sink.borrow_mut().push((robot, command.action())));
    // Nothing of navigation has been heard yet.
    bridge.deny([10, 0, 0, 8].into()).unwrap();
    assert!(paused.borrow().is_empty(), "another one's denial");
    bridge.deny(address).unwrap();
    assert_eq!(paused.take(), [(robot, Some(NavigationAction::Pause))]);
}
