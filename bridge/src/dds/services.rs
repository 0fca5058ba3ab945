//! SLAM's services on DDS: a request topic and a reply topic each, named as ROS 2's Fast DDS middleware does, and the
//! request's identity beside the reply.

use super::entities::{EndpointError, EntityFactory, RawReader, RawWriter};
use super::raw::Raw;
use super::topic_writer::stream_qos;
use crate::cdr::{Reader as CdrReader, Writer};
use crate::ros::RobotNames;
use crate::slam_services::{self, SERVICES, Service, ServiceFailure, SlamRequests};
use msg::{Monotonic, RobotId, SlamOutcome, SlamRequest, SlamResponse};
use ros2_client::MessageInfo;
use ros2_client::dds::rustdds::no_key::DeserializedCacheChange;
use ros2_client::dds::rustdds::{
    GUID, RTPSEntity, SampleIdentity, SequenceNumber, Timestamp, WriteOptionsBuilder,
};
use std::rc::Rc;
use std::time::Duration;

/// Calls that may wait for SLAM; more are refused.
const CALLS_MAX: usize = 64;
/// A call fails after this time: SLAM writes a large session within it.
const CALL_TIMEOUT: Duration = Duration::from_secs(20);
/// Replies kept for a slow client.
const REPLY_DEPTH: usize = 64;

/// One service of one robot.
struct ServiceServer {
    robot: RobotId,
    service: Service,
    requests: Rc<RawReader>,
    replies: RawWriter,
}

/// A call that SLAM has not answered yet.
struct WaitingCall {
    /// Index of the service's server.
    server: usize,
    caller: SampleIdentity,
    /// The endpoint's number of the call.
    id: u64,
    /// The request that must follow the first.
    next: Option<SlamRequest>,
    deadline: Monotonic,
}

/// All services, and the calls that wait.
pub struct ServiceServers {
    servers: Vec<ServiceServer>,
    calls: Vec<WaitingCall>,
    calls_begun: u64,
    /// Whether each robot's SLAM is paused, by its last answer.
    paused: Vec<bool>,
}

impl ServiceServers {
    /// Creates every service of every robot; `None`: of no robot.
    pub fn open(factory: &EntityFactory, robots: Option<&RobotNames>) -> Result<Self, EndpointError> {
        let mut servers = Vec::new();
        for (robots, robot) in
            robots.iter().flat_map(|robots| robots.robots().map(move |robot| (robots, robot)))
        {
            for service in &SERVICES {
                let name = robots.topic(robot, service.name);
                servers.push(ServiceServer::open(factory, robot, &name, service)?);
            }
        }
        let paused = vec![false; robots.map_or(0, RobotNames::count)];
        Ok(Self { servers, calls: Vec::new(), calls_begun: 0, paused })
    }

    /// Returns the readers of requests, in order of the servers.
    pub fn request_readers(&self) -> Vec<Rc<RawReader>> {
        self.servers.iter().map(|server| server.requests.clone()).collect()
    }

    /// Returns the identifiers of readers and writers.
    pub fn guids(&self) -> (Vec<GUID>, Vec<GUID>) {
        self.servers.iter().map(|server| (server.requests.guid(), server.replies.guid())).unzip()
    }

    /// Takes a request; returns what to ask of which robot's SLAM. An invalid request is answered at once.
    pub fn receive(
        &mut self,
        server: usize,
        sample: DeserializedCacheChange<Raw>,
        now: Monotonic,
    ) -> Option<(RobotId, SlamRequest)> {
        let ServiceServer { robot, service, .. } = *self.servers.get(server)?;
        let caller = identity(&MessageInfo::from(&sample));
        let paused = self.paused.get(robot.index()).copied().unwrap_or_default();
        let Raw(payload) = sample.into_value();
        match self.check(service, &payload, paused) {
            Ok(SlamRequests { first, next }) => {
                self.calls_begun += 1;
                let id = self.calls_begun;
                self.calls.push(WaitingCall { server, caller, id, next, deadline: now + CALL_TIMEOUT });
                Some((robot, SlamRequest { id, ..first }))
            }
            Err(failure) => {
                self.reply(server, caller, Err(&failure));
                None
            }
        }
    }

    fn check(&self, service: Service, payload: &[u8], paused: bool) -> Result<SlamRequests, ServiceFailure> {
        if self.calls.len() >= CALLS_MAX {
            return Err(ServiceFailure::TooManyCalls { limit: CALLS_MAX });
        }
        let mut from = CdrReader::new(payload).map_err(slam_services::RequestError::from)?;
        Ok(service.read(&mut from, paused)?)
    }

    /// Passes on SLAM's answer; returns the request that must follow it.
    pub fn answer(&mut self, robot: RobotId, answer: &SlamResponse, is_ours: bool) -> Option<SlamRequest> {
        if let Some(paused) = self.paused.get_mut(robot.index()) {
            *paused = answer.paused == 1;
        }
        let found = self.calls.iter().position(|call| is_ours && call.id == answer.id)?;
        let mut call = self.calls.swap_remove(found);
        match call.next.take() {
            Some(next) if answer.outcome() == SlamOutcome::Done => {
                let next = SlamRequest { id: call.id, ..next };
                self.calls.push(call);
                Some(next)
            }
            _ => {
                self.reply(call.server, call.caller, Ok(answer));
                None
            }
        }
    }

    /// Fails the calls that SLAM has not answered in time.
    pub fn tick(&mut self, now: Monotonic) {
        while let Some(found) = self.calls.iter().position(|call| now >= call.deadline) {
            let call = self.calls.swap_remove(found);
            self.reply(call.server, call.caller, Err(&ServiceFailure::Timeout));
        }
    }

    fn reply(&self, server: usize, caller: SampleIdentity, answer: Result<&SlamResponse, &ServiceFailure>) {
        let mut bytes = Vec::new();
        self.servers[server].service.write(&mut Writer::new(&mut bytes), answer);
        let options =
            WriteOptionsBuilder::new().source_timestamp(Timestamp::now()).related_sample_identity(caller);
        // The write fails only if the client reads none of its replies.
        let _ = self.servers[server].replies.write_with_options(Raw(bytes.into()), options.build());
    }
}

/// Returns the identity of a request, which its reply must carry.
///
/// Fast DDS sends the identity of its reply reader beside the request, without the sequence number.
fn identity(info: &MessageInfo) -> SampleIdentity {
    let number = SequenceNumber::from(info.sequence_number());
    match info.related_request_id().map(SampleIdentity::from) {
        Some(named) if named.sequence_number != SequenceNumber::UNKNOWN => named,
        Some(named) => SampleIdentity { sequence_number: number, ..named },
        None => SampleIdentity { writer_guid: info.publisher_gid().into(), sequence_number: number },
    }
}

impl ServiceServer {
    fn open(
        factory: &EntityFactory,
        robot: RobotId,
        name: &str,
        service: &slam_services::NamedService,
    ) -> Result<Self, EndpointError> {
        let name = format!("{}{name}", factory.namespace());
        let qos = stream_qos(REPLY_DEPTH);
        let (package, class) = service.service_type.split_once('/').unwrap_or(("", service.service_type));
        let dds_type = |part: &str| format!("{package}::srv::dds_::{class}_{part}_");
        let requests = factory.request_reader(&format!("rq{name}Request"), dds_type("Request"), &qos)?;
        let replies = factory.reply_writer(&format!("rr{name}Reply"), dds_type("Response"), &qos)?;
        Ok(Self { robot, service: service.service, requests, replies })
    }
}
