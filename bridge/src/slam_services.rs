//! Names, types and encodings of SLAM's services in ROS.
//!
//! Names and types are SLAM Toolbox's where it has the service (slam_toolbox 2.8, Jazzy), otherwise std_srvs'. All names
//! lie under `/robotN/`. Files are written below `saved/` in the run's folder: a name from the network must not lead out of it.

use msg::{
    FileNameError, InitialPoseKind, Pose2, RobotId, SlamMode, SlamRequest, SlamRequestKind, SlamResponse,
    Text, check_relative_file_name,
};
use ros_messages::RobotNames;
use ros_messages::cdr::{DecodeError, Dialect, Reader, Writer};
use std::collections::BTreeMap;
use thiserror::Error;

/// What a service does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Service {
    /// slam_toolbox/Pause: pauses, or resumes if SLAM is paused.
    TogglePause,
    /// std_srvs/SetBool: pauses or resumes.
    Pause,
    /// slam_toolbox/Reset: starts a new map, paused if the request says so.
    Reset,
    /// slam_toolbox/SaveMap: writes image files for map_server.
    SaveMap,
    /// slam_toolbox/SerializePoseGraph: writes a session file.
    SaveSession,
    /// slam_toolbox/DeserializePoseGraph: loads a session file.
    LoadSession,
    /// std_srvs/Trigger: makes one request without arguments.
    Trigger(SlamRequestKind),
}

/// A service with its ROS name and type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NamedService {
    /// Name under `/robotN/`, such as `slam_toolbox/save_map`.
    pub name: &'static str,
    /// ROS type as `package/Type`, such as `std_srvs/Trigger`.
    pub service_type: &'static str,
    /// What the service does.
    pub service: Service,
}

const fn named(name: &'static str, service_type: &'static str, service: Service) -> NamedService {
    NamedService { name, service_type, service }
}

/// All services of a robot.
///
/// SLAM Toolbox's dynamic_map is missing: RustDDS 0.15 writes one byte too many into each fragment of a reply that
/// names its request, so that a reply longer than a datagram reaches nobody. The map is on `/robotN/map`.
pub const SERVICES: [NamedService; 9] = [
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

/// SLAM Toolbox's result code of a request that is done.
const RESULT_SUCCESS: u8 = 0;
/// SLAM Toolbox's result code of any failure.
const RESULT_FAILURE: u8 = 255;

/// Why a request is not passed on to SLAM.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RequestError {
    /// The payload is not the service's request.
    #[error(transparent)]
    Payload(#[from] DecodeError),
    /// The file's name is none, or leads out of the folder for saved files.
    #[error(transparent)]
    FileName(#[from] FileNameError),
    /// The file's name does not fit into a message.
    #[error("'{name}' is too long for a file's name")]
    LongFileName {
        /// The name in the request.
        name: String,
    },
    /// The match type is not known.
    #[error("match_type {match_type}: expected 0 unset, 1 first node, 2 given pose, 3 localize")]
    MatchType {
        /// The value in the request.
        match_type: u8,
    },
}

/// The requests to SLAM that one call makes. The caller fills in `client` and `id`.
#[derive(Clone, Debug, PartialEq)]
pub struct SlamRequests {
    /// The first request.
    pub first: SlamRequest,
    /// The request that follows when the first is done.
    pub next: Option<SlamRequest>,
}

impl From<SlamRequest> for SlamRequests {
    fn from(first: SlamRequest) -> Self {
        Self { first, next: None }
    }
}

fn request(kind: SlamRequestKind) -> SlamRequest {
    SlamRequest { kind: kind as u32, ..SlamRequest::default() }
}

/// Checks that a name lies below the folder for saved files.
fn file_name(name: &str) -> Result<Text, RequestError> {
    check_relative_file_name(name)?;
    Text::new(name).ok_or_else(|| RequestError::LongFileName { name: name.to_owned() })
}

impl Service {
    /// Reads a request. `paused` is whether SLAM is paused now.
    pub fn read(self, from: &mut Reader<'_>, paused: bool) -> Result<SlamRequests, RequestError> {
        let pause =
            |wanted: bool| request(if wanted { SlamRequestKind::Pause } else { SlamRequestKind::Resume });
        Ok(match self {
            Self::TogglePause => pause(!paused).into(),
            Self::Pause => pause(from.bool("data")?).into(),
            Self::Reset => {
                let next = from.bool("pause_new_measurements")?.then(|| request(SlamRequestKind::Pause));
                SlamRequests { first: request(SlamRequestKind::Reset), next }
            }
            Self::SaveMap => SlamRequest {
                text: file_name(from.string("name.data")?)?,
                ..request(SlamRequestKind::SaveMap)
            }
            .into(),
            Self::SaveSession => SlamRequest {
                text: file_name(from.string("filename")?)?,
                ..request(SlamRequestKind::SaveSession)
            }
            .into(),
            Self::LoadSession => read_load_session(from)?.into(),
            Self::Trigger(kind) => request(kind).into(),
        })
    }

    /// Returns whether a response can say that the call failed.
    ///
    /// SLAM Toolbox's DeserializePoseGraph has an empty response, which reads as success: such a call that fails gets none.
    pub fn can_report_failure(self) -> bool {
        self != Self::LoadSession
    }

    /// Writes the response. `text` tells a person what was done, or why not.
    pub fn write(self, to: &mut Writer<'_>, is_done: bool, text: &str) {
        match self {
            Self::TogglePause => to.bool(is_done),
            Self::Reset | Self::SaveMap | Self::SaveSession => {
                to.u8(if is_done { RESULT_SUCCESS } else { RESULT_FAILURE });
            }
            // An empty response is one byte in ROS 2.
            Self::LoadSession if to.dialect() == Dialect::Ros2 => to.u8(0),
            Self::LoadSession => {}
            Self::Pause | Self::Trigger(_) => {
                to.bool(is_done);
                to.string(text);
            }
        }
    }
}

/// SLAM's services of a fleet by their ROS names, and whether each robot's SLAM is paused by its last answer.
#[derive(Debug)]
pub struct SlamServices {
    by_name: BTreeMap<String, (RobotId, NamedService)>,
    paused: Vec<bool>,
}

impl SlamServices {
    /// Creates the services of all robots.
    pub fn new(robots: &RobotNames) -> Self {
        let of_robot = |robot| SERVICES.map(|service| (robots.topic(robot, service.name), (robot, service)));
        let by_name = robots.robots().flat_map(of_robot).collect();
        Self { by_name, paused: vec![false; robots.count()] }
    }

    /// Finds a service by its name with leading slash.
    pub fn find(&self, name: &str) -> Option<(RobotId, NamedService)> {
        self.by_name.get(name).copied()
    }

    /// Returns the name and the type of every service.
    pub fn names(&self) -> impl Iterator<Item = (&str, &'static str)> {
        self.by_name.iter().map(|(name, (_, service))| (name.as_str(), service.service_type))
    }

    /// Returns whether a robot's SLAM is paused, by its last answer.
    pub fn is_paused(&self, robot: RobotId) -> bool {
        self.paused.get(robot.index()).copied().unwrap_or_default()
    }

    /// Records whether a robot's SLAM is paused.
    pub fn record(&mut self, robot: RobotId, answer: &SlamResponse) {
        if let Some(paused) = self.paused.get_mut(robot.index()) {
            *paused = answer.paused == 1;
        }
    }
}

/// Reads slam_toolbox/DeserializePoseGraph: filename, match_type, initial_pose (Pose2D).
fn read_load_session(from: &mut Reader<'_>) -> Result<SlamRequest, RequestError> {
    let text = file_name(from.string("filename")?)?;
    let match_type = from.u8("match_type")?;
    let [x_m, y_m, yaw_rad] =
        [from.finite("initial_pose.x")?, from.finite("initial_pose.y")?, from.finite("initial_pose.theta")?];
    let (mode, kind) = match match_type {
        0 => (SlamMode::Mapping, InitialPoseKind::Unknown),
        1 => (SlamMode::Mapping, InitialPoseKind::FirstNode),
        2 => (SlamMode::Mapping, InitialPoseKind::Given),
        3 => (SlamMode::Localization, InitialPoseKind::Given),
        match_type => return Err(RequestError::MatchType { match_type }),
    };
    let (mode, initial_pose_kind) = (mode as u32, kind as u32);
    let pose = Pose2::new(x_m, y_m, yaw_rad);
    Ok(SlamRequest { text, mode, initial_pose_kind, pose, ..request(SlamRequestKind::LoadSession) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn encoded(fill: impl FnOnce(&mut Writer<'_>)) -> Vec<u8> {
        let mut bytes = Vec::new();
        fill(&mut Writer::new(&mut bytes));
        bytes
    }

    fn read(service: Service, bytes: &[u8]) -> Result<SlamRequests, RequestError> {
        service.read(&mut Reader::new(bytes)?, false)
    }

    #[test]
    fn requests_mean_what_they_mean_in_slam_toolbox() {
        let toggled = read(Service::TogglePause, &encoded(|to| to.u8(0))).unwrap();
        assert_eq!(toggled.first.kind, SlamRequestKind::Pause as u32);
        let reset = read(Service::Reset, &encoded(|to| to.bool(true))).unwrap();
        assert_eq!(reset.first.kind, SlamRequestKind::Reset as u32);
        assert_eq!(reset.next.map(|next| next.kind), Some(SlamRequestKind::Pause as u32));
        let saved = read(Service::SaveMap, &encoded(|to| to.string("maps/monday"))).unwrap();
        assert_eq!(saved.first.text.as_str(), "maps/monday");
        let loaded = encoded(|to| {
            to.string("monday");
            to.u8(3);
            to.f64s(&[1.0, 2.0, 0.5]);
        });
        let loaded = read(Service::LoadSession, &loaded).unwrap().first;
        assert_eq!(
            (loaded.mode, loaded.initial_pose_kind),
            (SlamMode::Localization as u32, InitialPoseKind::Given as u32)
        );
        assert_eq!(loaded.pose, Pose2::new(1.0, 2.0, 0.5));
    }

    #[test]
    fn a_name_that_leads_out_of_the_folder_for_saved_files_is_refused() {
        for name in ["", "/etc/passwd", "../up", "a/../../b", "./a", "a\n"] {
            assert!(read(Service::SaveMap, &encoded(|to| to.string(name))).is_err(), "{name}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_request_or_an_error(which in 0..SERVICES.len(), bytes in proptest::collection::vec(any::<u8>(), 0..80)) {
            let payload = [&ros_messages::cdr::ENCAPSULATION[..], &bytes].concat();
            if let Ok(requests) = read(SERVICES[which].service, &payload) {
                prop_assert!(requests.first.pose.is_finite());
                prop_assert!(!requests.first.text.as_str().starts_with('/'));
            }
        }
    }
}
