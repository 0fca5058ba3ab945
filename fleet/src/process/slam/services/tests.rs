//! Tests of files that are saved and loaded, and of answers while the disk does not answer.

use super::*;
use crate::channel::Opener;
use crate::config::FleetConfig;
use crate::lockstep::faults::FaultPlan;
use crate::lockstep::memory_storage::MemoryStorage;
use crate::lockstep::queues::{MemoryPorts, Network, QueueReader, QueueWriter};
use crate::ports::Clock;
use crate::process::ProcessLoop;
use crate::process::slam::SlamProcess;
use crate::sessions;
use crate::storage::Storage;
use ::slam::{Session, SessionIdentity};
use msg::{Grid, Monotonic, Role, SubmapPoses};
use std::path::Path;
use std::rc::Rc;

/// A SLAM process without scans, and a bridge that asks it. Its disk is full when the faults say so, and answers if it is to.
struct Asked {
    network: Rc<Network>,
    process: SlamProcess<MemoryPorts, MemoryStorage>,
    storage: MemoryStorage,
    /// What merging reads.
    poses: QueueReader<SubmapPoses>,
    requests: QueueWriter<SlamRequest>,
    responses: QueueReader<SlamResponse>,
    does_disk_answer: bool,
}

impl Asked {
    fn new(faults: FaultPlan) -> Self {
        let network = Network::new(faults);
        let robot = RobotId::new(1).unwrap();
        let run = Run::in_memory(FleetConfig::default()).unwrap();
        let attach =
            |role: Role, robot| MemoryPorts::attach(&network, Opener { program: role.into(), robot });
        let (slam, bridge) = (attach(Role::Slam, Some(robot)), attach(Role::Bridge, None));
        let poses = attach(Role::Merge, None).reader(&channel::submap_poses(robot)).unwrap();
        let storage = MemoryStorage::new(&network);
        Self {
            process: SlamProcess::open([&slam, &slam], &run, robot, None, storage.clone()).unwrap(),
            storage,
            poses,
            requests: bridge.writer(&channel::slam_request(robot)).unwrap(),
            responses: bridge.reader(&channel::slam_response(robot)).unwrap(),
            network,
            does_disk_answer: true,
        }
    }

    fn now(&self) -> Monotonic {
        self.network.clock().now()
    }

    /// Goes on for 50 ms. Returns the response that has come.
    fn step(&mut self) -> Option<SlamResponse> {
        self.network.clock().set(self.now() + std::time::Duration::from_millis(50));
        self.process.front_end_loop.step();
        self.process.back_end.step(None);
        while let Ok(input) = self.process.inputs.try_recv() {
            self.process.back_end.step(Some(input));
        }
        while self.does_disk_answer
            && let Ok(job) = self.process.jobs.try_recv()
        {
            assert!(self.process.files.try_run(job).is_none(), "there is room for the outcome");
        }
        self.responses.receive().map(|response| *response)
    }

    /// Returns the response that comes within some seconds, and after how many.
    fn wait(&mut self, seconds: u64) -> Option<(SlamResponse, f64)> {
        let begun = self.now();
        (0..20 * seconds).find_map(|_| Some((self.step()?, self.now().since(begun) as f64 * 1e-9)))
    }

    fn ask(&mut self, kind: SlamRequestKind, text: &str) -> (SlamResponse, f64) {
        let text = Text::shortened(text);
        self.requests.send(&SlamRequest { kind: kind as u32, text, ..SlamRequest::default() });
        self.wait(60).expect("an answer")
    }
}

#[test]
fn a_reset_is_done_when_it_is_saved_and_says_if_it_is_not() {
    let second = |s: f64| Monotonic((s * 1e9) as u64);
    let mut asked = Asked::new(FaultPlan::none().with_full_disk(second(5.0), second(20.0)));
    let (response, _) = asked.ask(SlamRequestKind::Reset, "");
    assert_eq!(response.outcome(), SlamOutcome::Done, "{}", response.text.as_str());
    asked.wait(6);
    for kind in [SlamRequestKind::Reset, SlamRequestKind::SetMode] {
        let (response, after_s) = asked.ask(kind, "");
        let text = response.text.as_str();
        assert_eq!(response.outcome(), SlamOutcome::NotSaved, "{text}");
        assert!(text.contains("NOT SAVED") && text.contains("robot1.slam"), "{text}");
        assert!(after_s < 3.0, "the disk has refused it: {after_s} s");
    }
    asked.wait(20);
    assert_eq!(asked.ask(SlamRequestKind::Reset, "").0.outcome(), SlamOutcome::Done);
}

#[test]
fn a_disk_that_does_not_answer_is_told_within_seconds_and_each_request_has_one_answer() {
    let mut asked = Asked::new(FaultPlan::none());
    assert_eq!(asked.ask(SlamRequestKind::Pause, "").0.outcome(), SlamOutcome::Done);
    asked.does_disk_answer = false;
    for (kind, outcome, longest_s) in [
        (SlamRequestKind::Pause, SlamOutcome::NotSaved, 4.0),
        (SlamRequestKind::Reset, SlamOutcome::NotSaved, 4.0),
        (SlamRequestKind::LoadSession, SlamOutcome::Refused, 11.0),
        (SlamRequestKind::State, SlamOutcome::Done, 0.5),
    ] {
        let (response, after_s) = asked.ask(kind, "monday");
        let text = response.text.as_str();
        assert_eq!(response.outcome(), outcome, "{kind:?}: {text}");
        assert!(text.contains("the disk has not answered for"), "{kind:?}: {text}");
        assert!(after_s < longest_s, "{kind:?}: {after_s} s");
    }
    asked.does_disk_answer = true;
    let late = asked.wait(20).map(|(response, _)| response.text.as_str().to_owned());
    assert_eq!(late, None, "what was answered is not answered again");
    let (response, _) = asked.ask(SlamRequestKind::State, "");
    assert!(response.text.as_str().is_empty());
    assert_eq!(asked.ask(SlamRequestKind::Reset, "").0.outcome(), SlamOutcome::Done);
}

/// Writes a session of robot 1 with a small map, saved in a run of this number.
fn save(asked: &Asked, name: &str, run: u64) {
    let side = 80;
    let header = msg::GridHeader { width: side, height: side, resolution_m: 0.05, ..Default::default() };
    let is_wall = |cell: u32| [cell % side, cell / side].iter().any(|at| [0, side - 1].contains(at));
    let cells = (0..side * side).map(|cell| if is_wall(cell) { 100 } else { -100 }).collect();
    let grid = Grid { header, cells };
    let config = Run::in_memory(FleetConfig::default()).unwrap().config.slam.clone();
    let session = Session::from_grid(SessionIdentity::new(1, run, &config), grid.view(), &config);
    let path = Path::new("lockstep").join(name);
    asked.storage.write(&path, &session.encode().unwrap()).unwrap();
}

#[test]
fn merging_is_told_that_a_loaded_map_has_another_frame() {
    let mut asked = Asked::new(FaultPlan::none());
    // The run in memory has number 0.
    save(&asked, "own.slam", 0);
    save(&asked, "other.slam", 7);
    let mut load = |name: &str| {
        let (response, _) = asked.ask(SlamRequestKind::LoadSession, name);
        let text = response.text.as_str().to_owned();
        assert_eq!(response.outcome(), SlamOutcome::Done, "{text}");
        (
            asked.poses.newest().expect("poses of the loaded map").map_frame,
            text.contains("merging finds anew"),
        )
    };
    assert_eq!(load("own"), (0, false));
    let (first, is_reported) = load("other");
    assert!(first != 0 && is_reported);
    // It may have been saved after the other one was loaded.
    let (again, is_reported) = load("own");
    assert!(again != first && again != 0 && is_reported);
}

#[test]
fn a_map_that_begins_anew_where_nobody_knew_the_robot_has_another_frame() {
    let mut asked = Asked::new(FaultPlan::none());
    let (response, _) = asked.ask(SlamRequestKind::Reset, "");
    assert_eq!((response.outcome(), response.text.as_str()), (SlamOutcome::Done, "the map begins anew"));
    // A loaded map in which no scan has told where the robot is.
    save(&asked, "own.slam", 0);
    assert_eq!(asked.ask(SlamRequestKind::LoadSession, "own").0.outcome(), SlamOutcome::Done);
    let (response, _) = asked.ask(SlamRequestKind::Reset, "");
    assert!(response.text.as_str().contains("merging finds anew"), "{}", response.text.as_str());
    asked.wait(2);
    assert_eq!(asked.poses.newest().map(|poses| poses.map_frame), Some(1));
    assert_eq!(saved_frame(&asked), 1);
}

fn saved_frame(asked: &Asked) -> u32 {
    sessions::read_frame(&asked.storage, Path::new("lockstep/sessions/robot1.frame")).unwrap()
}

#[test]
fn the_number_of_a_frame_is_saved_with_the_session_of_that_frame_and_not_for_a_load_that_is_not_used() {
    let mut asked = Asked::new(FaultPlan::none());
    save(&asked, "other.slam", 7);
    asked.does_disk_answer = false;
    let (response, _) = asked.ask(SlamRequestKind::LoadSession, "other");
    assert_eq!(response.outcome(), SlamOutcome::Refused, "{}", response.text.as_str());
    asked.does_disk_answer = true;
    asked.wait(20);
    assert_eq!((saved_frame(&asked), asked.poses.newest().map_or(0, |poses| poses.map_frame)), (0, 0));
    let (response, _) = asked.ask(SlamRequestKind::LoadSession, "other");
    assert_eq!(response.outcome(), SlamOutcome::Done, "{}", response.text.as_str());
    assert_eq!((saved_frame(&asked), asked.poses.newest().map(|poses| poses.map_frame)), (1, Some(1)));
}

#[test]
fn what_a_client_saves_replaces_no_file_of_the_run_and_is_found_by_its_name() {
    let mut asked = Asked::new(FaultPlan::none());
    save(&asked, "sessions/robot2.slam", 7);
    let read = |asked: &Asked, path: &str| asked.storage.read(Path::new(path), u64::MAX);
    let before = read(&asked, "lockstep/sessions/robot2.slam").unwrap();
    let mut load = |name: &str| {
        let (response, _) = asked.ask(SlamRequestKind::LoadSession, name);
        (response.outcome(), response.text.as_str().to_owned())
    };
    let (outcome, text) = load("nothing");
    assert_eq!(outcome, SlamOutcome::Refused);
    for place in ["lockstep/saved/nothing.slam", "lockstep/nothing.slam"] {
        assert!(text.contains(place), "{text}");
    }
    let (outcome, text) = load("sessions/robot2");
    assert!(outcome == SlamOutcome::Done && text.contains("lockstep/sessions/robot2.slam"), "{text}");
    for name in ["accepted-room.json", "sessions/robot2.slam", "run.json", "monday"] {
        let (response, _) = asked.ask(SlamRequestKind::SaveSession, name);
        let text = response.text.as_str().to_owned();
        assert_eq!(response.outcome(), SlamOutcome::Done, "{text}");
        assert!(text.starts_with("lockstep/saved/") && text.ends_with(".slam"), "{text}");
        assert!(read(&asked, &text).is_ok(), "{text}");
        let (response, _) = asked.ask(SlamRequestKind::LoadSession, name);
        assert!(response.text.as_str().starts_with(&text), "{} was saved", response.text.as_str());
    }
    for own in ["accepted-room.json", "run.json"] {
        assert!(read(&asked, &format!("lockstep/{own}")).is_err(), "{own}");
    }
    assert_eq!(read(&asked, "lockstep/sessions/robot2.slam").unwrap(), before);
}

#[test]
fn a_client_cannot_fill_the_disk_with_names() {
    let mut asked = Asked::new(FaultPlan::none());
    save(&asked, "own.slam", 0);
    assert_eq!(asked.ask(SlamRequestKind::LoadSession, "own").0.outcome(), SlamOutcome::Done);
    for number in 0..saved_files::FILES_MAX {
        asked.storage.write(Path::new(&format!("lockstep/saved/{number}.slam")), b"").unwrap();
    }
    for kind in [SlamRequestKind::SaveSession, SlamRequestKind::SaveMap] {
        let (response, _) = asked.ask(kind, "one-more");
        let text = response.text.as_str();
        assert_eq!(response.outcome(), SlamOutcome::Refused, "{text}");
        assert!(text.starts_with("lockstep/saved: has 1024 files"), "{text}");
    }
    asked.storage.remove(Path::new("lockstep/saved/7.slam")).unwrap();
    assert_eq!(asked.ask(SlamRequestKind::SaveSession, "one-more").0.outcome(), SlamOutcome::Done);
    // A map is named by the file that is loaded.
    asked.storage.remove(Path::new("lockstep/saved/8.slam")).unwrap();
    let (response, _) = asked.ask(SlamRequestKind::SaveMap, "plan.png");
    assert_eq!(response.text.as_str(), "lockstep/saved/plan.yaml");
}
