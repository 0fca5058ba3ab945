//! SLAM's services on DDS, as ROS 2's Fast DDS middleware spells them: a request topic and a reply topic, the
//! request's identity beside the reply.

use super::door::{DoorError, Maker, create_error};
use super::raw::{Adapter, Raw};
use super::sender::stream_qos;
use crate::cdr::{Reader as CdrReader, Writer};
use crate::slam_services::{self, Asked, Service};
use msg::{RobotId, SlamRequest, SlamResponse};
use ros2_client::MessageInfo;
use ros2_client::dds::rustdds::no_key::{DataWriter, DeserializedCacheChange, SimpleDataReader};
use ros2_client::dds::rustdds::{
    GUID, RTPSEntity, SampleIdentity, SequenceNumber, Subscriber, Timestamp, WriteOptionsBuilder,
};
use std::rc::Rc;
use std::time::{Duration, Instant};

/// Calls that wait for SLAM; more are refused.
const CALLS_MAX: usize = 64;
/// SLAM writes a session within this.
const PATIENCE: Duration = Duration::from_secs(20);
/// Replies kept for a client that is slow.
const WINDOW: i32 = 64;

/// One service of one robot.
pub struct Server {
    pub robot: RobotId,
    pub service: Service,
    pub requests: Rc<SimpleDataReader<Raw, Adapter>>,
    replies: DataWriter<Raw, Adapter>,
}

/// A request that SLAM has not answered yet.
struct Call {
    server: usize,
    caller: SampleIdentity,
    id: u64,
    then: Option<SlamRequest>,
    due: Instant,
}

/// All services, and the calls that are open.
pub struct Servers {
    pub all: Vec<Server>,
    calls: Vec<Call>,
    asked: u64,
    /// Whether each robot's SLAM is paused, as it said last.
    paused: Vec<bool>,
}

impl Servers {
    /// Every service of every robot.
    pub fn open(maker: &Maker<'_>, subscriber: &Subscriber, robots: usize) -> Result<Self, DoorError> {
        let mut all = Vec::new();
        for robot in RobotId::first(robots) {
            for service in slam_services::ALL {
                all.push(Server::open(maker, subscriber, robot, service)?);
            }
        }
        Ok(Self { all, calls: Vec::new(), asked: 0, paused: vec![false; robots] })
    }

    /// The endpoints: (readers, writers).
    pub fn guids(&self) -> (Vec<GUID>, Vec<GUID>) {
        self.all.iter().map(|server| (server.requests.guid(), server.replies.guid())).unzip()
    }

    /// A request has come: what is to be asked of whose SLAM. Anything wrong is answered at once.
    pub fn request(
        &mut self,
        server: usize,
        sample: DeserializedCacheChange<Raw>,
        now: Instant,
    ) -> Option<(RobotId, SlamRequest)> {
        let Server { robot, service, .. } = *self.all.get(server)?;
        let caller = identity(&MessageInfo::from(&sample));
        let paused = self.paused.get(robot.index()).copied().unwrap_or_default();
        let Raw(payload) = sample.into_value();
        let asked = CdrReader::new(&payload)
            .map_err(Into::into)
            .and_then(|mut from| service.read(&mut from, paused))
            .map_err(|why| why.to_string());
        let asked = if self.calls.len() < CALLS_MAX { asked } else { Err("too many calls are open".into()) };
        match asked {
            Ok(Asked { first, then }) => {
                self.asked += 1;
                self.calls.push(Call { server, caller, id: self.asked, then, due: now + PATIENCE });
                Some((robot, SlamRequest { id: self.asked, ..first }))
            }
            Err(why) => {
                self.reply(server, caller, Err(&why));
                None
            }
        }
    }

    /// SLAM has answered; what is to be asked next.
    pub fn answered(&mut self, robot: RobotId, answer: &SlamResponse, ours: bool) -> Option<SlamRequest> {
        if let Some(paused) = self.paused.get_mut(robot.index()) {
            *paused = answer.paused == 1;
        }
        let found = self.calls.iter().position(|call| ours && call.id == answer.id)?;
        let mut call = self.calls.swap_remove(found);
        match call.then.take() {
            Some(next) if answer.outcome() == msg::SlamOutcome::Done => {
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

    /// Calls that nobody has answered in time.
    pub fn tick(&mut self, now: Instant) {
        while let Some(found) = self.calls.iter().position(|call| now >= call.due) {
            let call = self.calls.swap_remove(found);
            self.reply(call.server, call.caller, Err("SLAM did not answer in time"));
        }
    }

    fn reply(&self, server: usize, caller: SampleIdentity, answer: Result<&SlamResponse, &str>) {
        let mut bytes = Vec::new();
        self.all[server].service.write(&mut Writer::new(&mut bytes), answer);
        let options =
            WriteOptionsBuilder::new().source_timestamp(Timestamp::now()).related_sample_identity(caller);
        // A client that takes no replies has itself to blame.
        let _ = self.all[server].replies.write_with_options(Raw(bytes.into()), options.build());
    }
}

/// Who called. Fast DDS names its reply reader beside the request, without the number.
fn identity(about: &MessageInfo) -> SampleIdentity {
    let number = SequenceNumber::from(about.sequence_number());
    match about.related_request_id().map(SampleIdentity::from) {
        Some(named) if named.sequence_number != SequenceNumber::UNKNOWN => named,
        Some(named) => SampleIdentity { sequence_number: number, ..named },
        None => SampleIdentity { writer_guid: about.publisher_gid().into(), sequence_number: number },
    }
}

impl Server {
    fn open(
        maker: &Maker<'_>,
        subscriber: &Subscriber,
        robot: RobotId,
        named: slam_services::Named,
    ) -> Result<Self, DoorError> {
        let name = format!("{}/{robot}/{}", maker.namespace, named.name);
        let qos = stream_qos(WINDOW);
        let (package, kind) = named.class.split_once('/').unwrap_or(("", named.class));
        let class = |side: &str| format!("{package}::srv::dds_::{kind}_{side}_");
        let requests = maker.dds_topic(&format!("rq{name}Request"), class("Request"), &qos)?;
        let replies = maker.dds_topic(&format!("rr{name}Reply"), class("Response"), &qos)?;
        let requests =
            subscriber.create_simple_datareader_no_key(&requests, Some(qos.clone())).map_err(create_error)?;
        let replies = maker.publisher.create_datawriter_no_key(&replies, Some(qos)).map_err(create_error)?;
        Ok(Self { robot, service: named.service, requests: Rc::new(requests), replies })
    }
}
