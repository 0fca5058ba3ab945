//! Figures of the link: `link.json` in the run's folder, written once a second.

use super::{BaseLink, RobotLink, StopControl};
use crate::clock::now;
use crate::job_thread::JobRunner;
use crate::ports::Ports;
use crate::run::{LINK_REPORT, Run};
use ::link::{ByteCounters, unknown_robot_text};
use link_transport::Transport;
use msg::Monotonic;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Largest file that is read, bytes: 64 robots have 30 kB.
const BYTES_MAX: u64 = 256 << 10;

/// Age of a run below which nothing is said of a base that was not heard yet.
const UNHEARD_MIN: Duration = Duration::from_secs(5);

/// Figures of the link to one peer.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct PeerReport {
    /// Name of the robot.
    pub robot: String,
    /// Whether the peer was heard in the last 3 s.
    pub is_heard: bool,
    /// Whether the robot's own emergency stop is set, as the robot told the base last; `None` if its bridge does not answer,
    /// and in a robot's own file.
    pub is_stopped: Option<bool>,
    /// Parts of the map that the base does not hold as they are.
    pub waiting: u64,
    /// Messages of other peers than the one that counts.
    pub refused: u64,
    /// Scans that the base dropped because the link delivered them late.
    pub late_scans: u64,
    /// At the base: why the robot does not follow it.
    pub hold: Option<String>,
    /// At the base: another machine bears the robot's name, too, and is refused.
    pub is_contested: bool,
    /// On a robot's machine: velocities of the base that came too late to be obeyed.
    pub late_velocities: u64,
    /// At the base: when the robot's newest state arrived, by the machine's clock, nanoseconds; 0: never.
    pub state_ns: u64,
    /// Whether the peer was ever heard in this run.
    pub was_heard: bool,
    /// Bytes from the robot to the base by kind of message, as this end counts them.
    pub bytes: BTreeMap<String, u64>,
}

/// Figures of a machine's link.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LinkReport {
    /// When its figures were taken, by the machine's clock, nanoseconds: it is written once a second.
    pub written_ns: u64,
    /// Process that has written it.
    pub process: u32,
    /// One for each robot.
    pub peers: Vec<PeerReport>,
    /// At the base: machines that send under names of no robot of its fleet.
    pub unknown_robots: Vec<String>,
    /// On a robot's machine: endpoint of its base, or of a router before it.
    pub base: Option<String>,
}

impl LinkReport {
    /// Reads the report of a run.
    pub fn read(run_dir: &Path) -> io::Result<Self> {
        let text = formats::limited::read_text(&path(run_dir), BYTES_MAX)?;
        serde_json::from_str(&text).map_err(io::Error::other)
    }

    /// Returns the robots that an earlier process of this run had heard.
    fn heard_before(run: &Run) -> Vec<String> {
        let before = Self::read(&run.dir).unwrap_or_default();
        let is_of_run = before.written_ns >= run.begun.0;
        let heard = before.peers.into_iter().filter(|peer| is_of_run && peer.was_heard);
        heard.map(|peer| peer.robot).collect()
    }

    /// Writes the first report of a robot's machine, before it reaches its base.
    pub(super) fn begin(run: &Run, robot: &str, base: &str) -> io::Result<()> {
        let peers = vec![PeerReport { robot: robot.into(), ..PeerReport::default() }];
        let report = Self { peers, base: Some(base.into()), ..Self::default() };
        report.of_now().write(&run.dir, &Self::heard_before(run))
    }

    /// Says what is wrong with the link of a robot's machine to its base; `None` elsewhere, and in the first seconds.
    pub fn base_alarm(&self, run_age: Duration) -> Option<String> {
        let (base, peer) = (self.base.as_ref()?, self.peers.first()?);
        let heard = match (peer.is_heard, peer.was_heard) {
            (true, _) => return None,
            (false, true) => "is not heard any more".to_owned(),
            (false, false) if run_age < UNHEARD_MIN => return None,
            (false, false) => format!("was never heard, for {} s", run_age.as_secs()),
        };
        Some(format!(
            "the base at {base} {heard}: look whether it runs and is reached at this address and port, whether its --names have {}, \
             and whether both keys are of one fleet; the robot goes on mapping",
            peer.robot
        ))
    }

    /// Returns the report with the present time.
    pub(super) fn of_now(self) -> Self {
        Self { written_ns: now().0, ..self }
    }

    /// Writes the report of a run, with those that were heard before.
    fn write(mut self, run_dir: &Path, heard_before: &[String]) -> io::Result<()> {
        self.process = std::process::id();
        for name in heard_before {
            match self.peers.iter_mut().find(|peer| peer.robot == *name) {
                Some(peer) => peer.was_heard = true,
                None => {
                    let robot = name.clone();
                    self.peers.push(PeerReport { robot, was_heard: true, ..PeerReport::default() });
                }
            }
        }
        let json = serde_json::to_string_pretty(&self)?;
        formats::atomic::write(&path(run_dir), |file| file.write_all(json.as_bytes()))
    }
}

fn path(run_dir: &Path) -> PathBuf {
    run_dir.join(LINK_REPORT)
}

/// The file with the figures of the link, and the robots that an earlier process of this run had heard.
pub(super) struct ReportFile {
    run_dir: PathBuf,
    heard_before: Vec<String>,
    /// The base of a robot's machine, as the first report has it.
    base: Option<String>,
    has_failed: bool,
}

impl ReportFile {
    pub(super) fn new(run: &Run) -> Self {
        let base = LinkReport::read(&run.dir).unwrap_or_default().base;
        Self {
            run_dir: run.dir.clone(),
            heard_before: LinkReport::heard_before(run),
            base,
            has_failed: false,
        }
    }
}

impl JobRunner for ReportFile {
    type Job = LinkReport;
    /// Whether the file is written.
    type Report = io::Result<()>;

    fn run(&mut self, report: &LinkReport) -> io::Result<()> {
        let report = LinkReport { base: self.base.clone(), ..report.clone() };
        let written = report.write(&self.run_dir, &self.heard_before);
        if let Err(why) = &written
            && !self.has_failed
        {
            tracing::warn!(
                "{}: link.json: {why}; `mr-slam status` and `stop` do not know how the robots on other machines are",
                self.run_dir.display()
            );
        }
        self.has_failed = written.is_err();
        written
    }
}

/// One end of the link, whose figures are written.
pub trait ReportLink {
    /// Returns the figures.
    fn report(&self) -> LinkReport;
}

fn by_kind(bytes: &ByteCounters) -> BTreeMap<String, u64> {
    bytes.rows().filter(|(_, bytes, _)| *bytes > 0).map(|(name, bytes, _)| (name.to_owned(), bytes)).collect()
}

impl<P: Ports, T: Transport, S: StopControl> ReportLink for RobotLink<P, T, S> {
    fn report(&self) -> LinkReport {
        let (end, robot) = (self.end(), self.name().to_owned());
        let (waiting, refused) = (end.waiting() as u64, end.refused());
        let (is_heard, bytes) = (end.is_heard(self.now()), by_kind(end.sent()));
        LinkReport {
            peers: vec![PeerReport {
                robot,
                is_heard,
                waiting,
                refused,
                late_velocities: end.late_velocities(),
                was_heard: is_heard,
                bytes,
                ..PeerReport::default()
            }],
            ..LinkReport::default()
        }
    }
}

impl<P: Ports, T: Transport, S: StopControl> BaseLink<P, T, S> {
    /// Says in the log which machines are here whose names this fleet does not have.
    pub(super) fn hear_unknown(&mut self, now: Monotonic) {
        while let Some(name) = self.transport.receive_unknown_name() {
            if let Some(name) = self.unknown.hear(&name, now) {
                let names: Vec<String> = self.robots.iter().map(|robot| robot.name.clone()).collect();
                tracing::warn!("{}", unknown_robot_text(name, &names));
            }
        }
    }
}

impl<P: Ports, T: Transport, S: StopControl> ReportLink for BaseLink<P, T, S> {
    fn report(&self) -> LinkReport {
        let peers = self.ends().map(|(name, end, late_scans)| PeerReport {
            robot: name.to_owned(),
            is_heard: end.is_heard(self.now()),
            is_stopped: Some(end.robot_state()).filter(|state| state.is_known).map(|state| state.is_stopped),
            waiting: end.robot_state().waiting.into(),
            refused: end.refused(),
            late_scans,
            hold: end.hold().reason.map(|reason| reason.text().to_owned()),
            is_contested: end.is_contested(self.now()),
            state_ns: end.state_received().0,
            was_heard: end.state_received().0 > 0,
            bytes: by_kind(end.received()),
            ..PeerReport::default()
        });
        let unknown_robots = self.unknown.present(self.now());
        LinkReport { peers: peers.collect(), unknown_robots, ..LinkReport::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::FleetConfig;
    use crate::job_thread::{JobThread, JobWorker};

    #[test]
    fn a_robot_that_never_heard_its_base_is_told_so_with_the_time() {
        let folder = tempfile::tempdir().unwrap();
        let mut run = Run::in_memory(FleetConfig::default()).unwrap();
        run.dir = folder.path().into();
        LinkReport::begin(&run, "bob", "tcp/127.0.0.1:17999").unwrap();
        let mut report = LinkReport::read(&run.dir).unwrap();
        let text = report.base_alarm(Duration::from_secs(29)).unwrap();
        assert!(text.starts_with("the base at tcp/127.0.0.1:17999 was never heard, for 29 s"), "{text}");
        assert!(text.contains("--names have bob"), "{text}");
        assert_eq!(report.base_alarm(Duration::from_secs(2)), None);
        // What the link's loop writes keeps the base.
        let written =
            ReportFile::new(&run).run(&LinkReport { peers: report.peers.clone(), ..LinkReport::default() });
        written.unwrap();
        assert_eq!(LinkReport::read(&run.dir).unwrap().base, report.base);
        report.peers[0].was_heard = true;
        assert!(report.base_alarm(Duration::ZERO).unwrap().contains("not heard any more"));
        report.peers[0].is_heard = true;
        assert_eq!(report.base_alarm(Duration::from_secs(29)), None);
    }

    #[test]
    fn the_thread_of_the_files_says_that_a_report_is_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let mut run = Run::in_memory(FleetConfig::default()).unwrap();
        run.dir = folder.path().join("run");
        let mut files = JobThread::start(ReportFile::new(&run)).unwrap();
        let report = || {
            let peers = vec![PeerReport { robot: "robot1".into(), ..PeerReport::default() }];
            LinkReport { peers, ..LinkReport::default() }.of_now()
        };
        // There is no folder, then a file in its place, then a folder.
        let why = files.submit(report()).blocking_recv().unwrap().unwrap_err();
        assert_eq!(why.kind(), io::ErrorKind::NotFound, "{why}");
        std::fs::write(&run.dir, "").unwrap();
        assert!(files.submit(report()).blocking_recv().unwrap().is_err());
        assert!(LinkReport::read(&run.dir).is_err());
        std::fs::remove_file(&run.dir).unwrap();
        std::fs::create_dir(&run.dir).unwrap();
        files.submit(report()).blocking_recv().unwrap().unwrap();
        assert_eq!(LinkReport::read(&run.dir).unwrap().peers[0].robot, "robot1");
    }
}
