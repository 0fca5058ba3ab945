//! SLAM's services as ROS spells them: which there are, what a request's bytes ask of SLAM, what its answer is as
//! bytes. SLAM Toolbox's names and types where it has one (slam_toolbox 2.8, Jazzy), std_srvs beside them.
//!
//! All lie under `/robotN/`. Files are written below the run's folder: a name that comes over a network must not
//! lead out of it.

use crate::cdr::{DecodeError, Reader, Writer};
use msg::{Pose2, SlamMode, SlamOutcome, SlamRequest, SlamRequestKind, SlamResponse, StartPose, Text};
use std::path::{Component, Path};

/// What a service does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Service {
    /// slam_toolbox/Pause: pauses, or resumes if it was paused.
    TogglePause,
    /// std_srvs/SetBool: pauses or resumes.
    Pause,
    /// slam_toolbox/Reset.
    Reset,
    /// slam_toolbox/SaveMap: pictures for map_server.
    SaveMap,
    /// slam_toolbox/SerializePoseGraph: a session file.
    SaveSession,
    /// slam_toolbox/DeserializePoseGraph.
    LoadSession,
    /// std_srvs/Trigger: one request without arguments.
    Trigger(SlamRequestKind),
}

/// One service under `/robotN/`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Named {
    /// `slam_toolbox/save_map`.
    pub name: &'static str,
    /// `package/Type`.
    pub class: &'static str,
    /// What it does.
    pub service: Service,
}

const fn named(name: &'static str, class: &'static str, service: Service) -> Named {
    Named { name, class, service }
}

/// All of a robot's services. SLAM Toolbox's dynamic_map is missing: a reply longer than a datagram reaches nobody,
/// because RustDDS 0.15 writes one byte too many into each fragment that names its request. The map is on `/robotN/map`.
pub const ALL: [Named; 9] = [
    named("slam_toolbox/pause_new_measurements", "slam_toolbox/Pause", Service::TogglePause),
    named("slam_toolbox/reset", "slam_toolbox/Reset", Service::Reset),
    named("slam_toolbox/save_map", "slam_toolbox/SaveMap", Service::SaveMap),
    named("slam_toolbox/serialize_map", "slam_toolbox/SerializePoseGraph", Service::SaveSession),
    named("slam_toolbox/deserialize_map", "slam_toolbox/DeserializePoseGraph", Service::LoadSession),
    named("pause", "std_srvs/SetBool", Service::Pause),
    named("reset", "std_srvs/Trigger", Service::Trigger(SlamRequestKind::Reset)),
    named("relocalize", "std_srvs/Trigger", Service::Trigger(SlamRequestKind::Relocalize)),
    named("clear_closures", "std_srvs/Trigger", Service::Trigger(SlamRequestKind::ClearClosures)),
];

/// SLAM Toolbox's result codes: done; and any failure, which it does not tell apart.
const SUCCESS: u8 = 0;
const FAILURE: u8 = 255;

/// Why a request is not passed on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// It is not the request it should be.
    #[error(transparent)]
    Payload(#[from] DecodeError),
    /// It says what cannot be.
    #[error("{0}")]
    Content(String),
}

/// What is asked of SLAM: one thing, and perhaps a second after it.
#[derive(Clone, Debug, PartialEq)]
pub struct Asked {
    /// `client` and `id` are the caller's to fill in.
    pub first: SlamRequest,
    /// When the first is done.
    pub then: Option<SlamRequest>,
}

impl From<SlamRequest> for Asked {
    fn from(first: SlamRequest) -> Self {
        Self { first, then: None }
    }
}

fn ask(kind: SlamRequestKind) -> SlamRequest {
    SlamRequest { kind: kind as u32, ..SlamRequest::default() }
}

/// A name below the run's folder.
fn file(name: &str) -> Result<Text, RequestError> {
    let inside = Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
    let wrong = |why: &str| RequestError::Content(format!("'{name}' {why}"));
    if name.is_empty() || !inside || name.contains(char::is_control) {
        return Err(wrong("is no name below the run's folder, such as `monday` or `maps/monday`"));
    }
    Text::new(name).ok_or_else(|| wrong("is too long"))
}

impl Service {
    /// What a request asks of SLAM. `paused` is whether it is now.
    pub fn read(self, from: &mut Reader<'_>, paused: bool) -> Result<Asked, RequestError> {
        let pause = |wished: bool| ask(if wished { SlamRequestKind::Pause } else { SlamRequestKind::Resume });
        Ok(match self {
            Self::TogglePause => pause(!paused).into(),
            Self::Pause => pause(from.bool("data")?).into(),
            Self::Reset => {
                let then = from.bool("pause_new_measurements")?.then(|| ask(SlamRequestKind::Pause));
                Asked { first: ask(SlamRequestKind::Reset), then }
            }
            Self::SaveMap => {
                SlamRequest { text: file(from.string("name.data")?)?, ..ask(SlamRequestKind::SaveMap) }.into()
            }
            Self::SaveSession => {
                SlamRequest { text: file(from.string("filename")?)?, ..ask(SlamRequestKind::SaveSession) }
                    .into()
            }
            Self::LoadSession => load(from)?.into(),
            Self::Trigger(what) => ask(what).into(),
        })
    }

    /// SLAM's answer, or why there is none.
    pub fn write(self, to: &mut Writer<'_>, answer: Result<&SlamResponse, &str>) {
        let done = answer.is_ok_and(|answer| answer.outcome() == SlamOutcome::Done);
        let text = answer.map_or_else(|why| why, |answer| answer.text.as_str());
        match self {
            Self::TogglePause => to.bool(done),
            Self::Reset | Self::SaveMap | Self::SaveSession => to.u8(if done { SUCCESS } else { FAILURE }),
            // An empty response is one byte in ROS 2.
            Self::LoadSession => to.u8(0),
            Self::Pause | Self::Trigger(_) => {
                to.bool(done);
                to.string(text);
            }
        }
    }
}

/// slam_toolbox/DeserializePoseGraph: filename, match_type, initial_pose (Pose2D).
fn load(from: &mut Reader<'_>) -> Result<SlamRequest, RequestError> {
    let text = file(from.string("filename")?)?;
    let match_type = from.u8("match_type")?;
    let [x_m, y_m, yaw_rad] =
        [from.finite("initial_pose.x")?, from.finite("initial_pose.y")?, from.finite("initial_pose.theta")?];
    let (mode, start) = match match_type {
        0 => (SlamMode::Mapping, StartPose::Unknown),
        1 => (SlamMode::Mapping, StartPose::FirstNode),
        2 => (SlamMode::Mapping, StartPose::Given),
        3 => (SlamMode::Localization, StartPose::Given),
        other => {
            let why = format!("match_type {other}: expected 0 unset, 1 first node, 2 given pose, 3 localize");
            return Err(RequestError::Content(why));
        }
    };
    let (mode, start) = (mode as u32, start as u32);
    let pose = Pose2::new(x_m, y_m, yaw_rad);
    Ok(SlamRequest { text, mode, start, pose, ..ask(SlamRequestKind::LoadSession) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn request(fill: impl FnOnce(&mut Writer<'_>)) -> Vec<u8> {
        let mut bytes = Vec::new();
        fill(&mut Writer::new(&mut bytes));
        bytes
    }

    fn read(service: Service, bytes: &[u8]) -> Result<Asked, RequestError> {
        service.read(&mut Reader::new(bytes)?, false)
    }

    #[test]
    fn requests_are_what_slam_toolbox_means_by_them() {
        let toggled = read(Service::TogglePause, &request(|to| to.u8(0))).unwrap();
        assert_eq!(toggled.first.kind, SlamRequestKind::Pause as u32);
        let reset = read(Service::Reset, &request(|to| to.bool(true))).unwrap();
        assert_eq!(reset.first.kind, SlamRequestKind::Reset as u32);
        assert_eq!(reset.then.map(|then| then.kind), Some(SlamRequestKind::Pause as u32));
        let saved = read(Service::SaveMap, &request(|to| to.string("maps/monday"))).unwrap();
        assert_eq!(saved.first.text.as_str(), "maps/monday");
        let loaded = request(|to| {
            to.string("monday");
            to.u8(3);
            to.f64s(&[1.0, 2.0, 0.5]);
        });
        let loaded = read(Service::LoadSession, &loaded).unwrap().first;
        assert_eq!((loaded.mode, loaded.start), (SlamMode::Localization as u32, StartPose::Given as u32));
        assert_eq!(loaded.pose, Pose2::new(1.0, 2.0, 0.5));
    }

    #[test]
    fn no_file_lies_outside_the_run() {
        for name in ["", "/etc/passwd", "../up", "a/../../b", "./a", "a\n"] {
            assert!(read(Service::SaveMap, &request(|to| to.string(name))).is_err(), "{name}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(which in 0..ALL.len(), bytes in proptest::collection::vec(any::<u8>(), 0..80)) {
            let payload = [&crate::cdr::ENCAPSULATION[..], &bytes].concat();
            if let Ok(asked) = read(ALL[which].service, &payload) {
                prop_assert!(asked.first.pose.is_finite());
                prop_assert!(!asked.first.text.as_str().starts_with('/'));
            }
        }
    }
}
