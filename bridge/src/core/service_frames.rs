//! Service calls of clients and of ROS 2 nodes, with the reply to a call that fails.

use super::Core;
use crate::access::{Action, PermissionError};
use crate::command::{Call, CallFailure, name};
use crate::frame::Side;
use crate::relay::{IDENTIFIED_BYTES_MAX, RosRequestId};
use crate::router::{ClientId, FrameKind};
use crate::services::{Caller, Provider, ServiceCall, ServiceError};
use crate::slam_services;
use msg::{Monotonic, RobotId, SlamOutcome, SlamRequest, SlamResponse};
use ros_messages::cdr::{DecodeError, Dialect, ENCAPSULATION, Reader, Writer, with_dummy_byte};
use ros_messages::interfaces::{self, NameError};
use std::time::Duration;
use thiserror::Error;

/// A call of SLAM fails after this time: it writes a large session within it.
const SLAM_TIMEOUT: Duration = Duration::from_secs(20);

/// Why a client's call fails at once.
#[derive(Debug, Error)]
pub(super) enum CallError {
    /// The service's name is not a ROS name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Nobody can answer.
    #[error(transparent)]
    Service(#[from] ServiceError),
    /// The client may not call the fleet's services or those of ROS nodes.
    #[error(transparent)]
    Permission(#[from] PermissionError),
    /// The service's limit in ROS is reached.
    #[error(
        "it is not called in ROS 2: {limit} services are exchanged, the limit (bridge.dds.relayed_services_max)"
    )]
    TooManyRelayed {
        /// Most services of clients that are exchanged with ROS.
        limit: usize,
    },
    /// The request is not one of SLAM's service.
    #[error(transparent)]
    Request(#[from] slam_services::RequestError),
    /// The request is not encoded as ROS 2 expects it.
    #[error(transparent)]
    Payload(#[from] DecodeError),
}

impl Core {
    /// Forwards a client's request to the service's provider: another client, a robot's SLAM, or a ROS 2 node.
    pub(super) fn receive_request(
        &mut self,
        id: ClientId,
        number: i64,
        spelled: &str,
        payload: &[u8],
        now: Monotonic,
    ) {
        let payload = with_dummy_byte(self.config.payloads, payload);
        if let Err(error) = self.begin_clients_call(id, number, spelled, payload, now) {
            let notice = format!("__request {number}: {error}");
            self.send_failure(id, number, spelled, notice, &error.to_string());
        }
    }

    fn begin_clients_call(
        &mut self,
        id: ClientId,
        number: i64,
        spelled: &str,
        payload: &[u8],
        now: Monotonic,
    ) -> Result<(), CallError> {
        let name = interfaces::resolve_name(spelled)?;
        if !self.services.is_caller(id, &name) {
            return Err(ServiceError::NotRegistered { name: spelled.to_owned() }.into());
        }
        let caller = Caller::Client { id, number, spelled: spelled.to_owned() };
        if let Some((robot, service)) = self.offered.slam.find(&name) {
            self.check_call(id)?;
            return self.call_slam(caller, robot, service.service, &name, payload, now);
        }
        if let Some(provider) = self.services.provider(&name) {
            return Ok(self.call_client(caller, provider, &name, payload, now)?);
        }
        Reader::new(payload)?;
        self.check_ros_call(id, &name, spelled)?;
        let timeout = self.config.service_timeout();
        let call = self.services.begin_call(caller, Provider::Ros, &name, timeout, now)?;
        self.relay.call_service(&name, call.number, payload);
        Ok(())
    }

    /// Fails if the client may not call what moves or changes the fleet, or a ROS 2 node.
    fn check_call(&mut self, id: ClientId) -> Result<(), PermissionError> {
        let peer = self.router.client(id).map(|client| client.peer.ip());
        peer.map_or(Ok(()), |peer| self.access.check(Action::Drive, peer))
    }

    /// Fails if no ROS 2 node offers the service, or if the client may not call it there.
    fn check_ros_call(&mut self, id: ClientId, name: &str, spelled: &str) -> Result<(), CallError> {
        let missing = |hint| ServiceError::NoProvider { name: spelled.to_owned(), hint };
        if !self.relay.has_endpoint() {
            return Err(
                missing("no client does, and ROS 2 is not connected (mr-slam up --ros-domain N)").into()
            );
        }
        let Some(types) = self.relay.graph().services.get(name) else {
            return Err(missing("no client and no ROS 2 node does").into());
        };
        let requested = self.services.service_type(name).unwrap_or_default();
        if !types.iter().any(|theirs| theirs == requested) {
            let existing = types.join(" and ");
            let (name, requested) = (spelled.to_owned(), requested.to_owned());
            return Err(ServiceError::OtherType { name, existing, requested }.into());
        }
        if !self.relay.is_public_name(name) {
            self.check_call(id)?;
        }
        if !self.relay.services().is_called(name) {
            // Its permission may be new.
            self.update_services();
        }
        if !self.relay.services().is_called(name) {
            return Err(CallError::TooManyRelayed { limit: self.relay.services().services_max() });
        }
        Ok(())
    }

    /// Forwards a request to the client that provides the service.
    fn call_client(
        &mut self,
        caller: Caller,
        provider: ClientId,
        name: &str,
        payload: &[u8],
        now: Monotonic,
    ) -> Result<(), ServiceError> {
        let timeout = self.config.service_timeout();
        let call = self.services.begin_call(caller, Provider::Client(provider), name, timeout, now)?;
        let spelled = match &call.caller {
            Caller::Client { spelled, .. } => spelled,
            Caller::Ros(_) => name,
        };
        self.router.send_frames(provider, FrameKind::Reply, |out| {
            Side::Server.write_command(out, name::REQUEST, &Call { srv_id: call.number });
            Side::Server.write(out, spelled, payload);
        });
        Ok(())
    }

    /// Asks a robot's SLAM.
    fn call_slam(
        &mut self,
        caller: Caller,
        robot: RobotId,
        service: slam_services::Service,
        name: &str,
        payload: &[u8],
        now: Monotonic,
    ) -> Result<(), CallError> {
        let dialect = self.dialect_of(&caller);
        let mut from = Reader::with(dialect, payload).map_err(slam_services::RequestError::from)?;
        let requests = service.read(&mut from, self.offered.slam.is_paused(robot))?;
        let sender = self.commands.sender();
        let next = requests.next.map(|next| Box::new(SlamRequest { sender, ..next }));
        let provider = Provider::Slam { robot, service, next };
        let call = self.services.begin_call(caller, provider, name, SLAM_TIMEOUT, now)?;
        let request = SlamRequest { id: call.number as u64, ..requests.first };
        self.commands.push_slam_request(robot, request);
        Ok(())
    }

    /// Handles the answer of a robot's SLAM. `is_ours`: the answer is to a request of this bridge.
    pub fn receive_slam_response(&mut self, robot: RobotId, answer: &SlamResponse, is_ours: bool) {
        self.offered.slam.record(robot, answer);
        if !is_ours {
            return;
        }
        let is_of =
            |provider: &Provider| matches!(provider, Provider::Slam { robot: of, .. } if *of == robot);
        let Some(mut call) = self.services.end_call(answer.id as i64, is_of) else { return };
        let outcome = answer.outcome();
        let is_done = outcome != SlamOutcome::Refused;
        let Provider::Slam { service, next, .. } = &mut call.provider else { return };
        let service = *service;
        match next.take() {
            Some(next) if is_done => {
                let request = SlamRequest { id: call.number as u64, ..*next };
                self.commands.push_slam_request(robot, request);
                self.services.resume_call(call);
            }
            _ if is_done => {
                let mut payload = Vec::new();
                let to = &mut Writer::with(self.dialect_of(&call.caller), &mut payload);
                service.write(to, outcome == SlamOutcome::Done, answer.text.as_str());
                self.respond(&call, &payload);
            }
            _ => self.fail_call(&call, answer.text.as_str()),
        }
    }

    fn dialect_of(&self, caller: &Caller) -> Dialect {
        match caller {
            Caller::Client { .. } => self.config.payloads,
            Caller::Ros(_) => Dialect::Ros2,
        }
    }

    /// Forwards a ROS 2 node's request to a robot's SLAM or to the client that provides the service.
    ///
    /// ROS has no response that tells a failure: a request that nobody answers gets none.
    pub(super) fn receive_ros_request(
        &mut self,
        service: &str,
        id: RosRequestId,
        payload: &[u8],
        now: Monotonic,
    ) {
        self.router.counted.received += 1;
        if let Some((server, part)) = self.offered.actions.find(service) {
            return self.receive_action_request(server, part, id, payload, now);
        }
        let caller = Caller::Ros(id);
        if let Some((robot, named)) = self.offered.slam.find(service) {
            if let Err(error) = self.call_slam(caller, robot, named.service, service, payload, now) {
                self.fail_ros_call(service, id, &error.to_string());
            }
            return;
        }
        let provider = self.services.provider(service).filter(|_| self.relay.services().is_offered(service));
        let result = provider.map(|provider| self.call_client(caller, provider, service, payload, now));
        if !matches!(result, Some(Ok(()))) {
            self.fail_ros_call(service, id, "nobody can answer");
        }
    }

    /// Forwards a ROS 2 node's response to the client that called.
    pub(super) fn receive_ros_response(&mut self, number: i64, payload: &[u8]) {
        self.router.counted.received += 1;
        if let Some(call) = self.services.end_call(number, |provider| *provider == Provider::Ros) {
            self.respond(&call, payload);
        }
    }

    /// Forwards a client's response to the caller.
    pub(super) fn receive_response(&mut self, id: ClientId, number: i64, payload: &[u8]) {
        let payload = with_dummy_byte(self.config.payloads, payload);
        let Some(call) = self.services.end_call(number, |provider| *provider == Provider::Client(id)) else {
            return self.router.refuse(id, format!("__response {number}: no such call waits for you"));
        };
        match (&call.caller, Reader::new(payload)) {
            (Caller::Ros(_), Err(error)) => {
                self.router.refuse(id, format!("__response {number}: {error}"));
                self.fail_call(&call, "the response is not encoded as ROS 2 expects it");
            }
            (Caller::Ros(request), Ok(_)) if !request.can_carry(payload.len()) => {
                let bytes = payload.len();
                let text = format!(
                    "__response {number}: {bytes} bytes are not sent to ROS 2: at most {IDENTIFIED_BYTES_MAX} reach a \
                     node on Fast DDS; publish long data on a topic"
                );
                self.router.refuse(id, text);
                self.fail_call(&call, "the response is too long");
            }
            _ => self.respond(&call, payload),
        }
    }

    /// Sends a response to the caller.
    fn respond(&mut self, call: &ServiceCall, payload: &[u8]) {
        match &call.caller {
            Caller::Client { id, number, spelled } => self.send_response(*id, *number, spelled, payload),
            Caller::Ros(request) => self.relay.respond(&call.service, *request, payload),
        }
    }

    fn send_response(&mut self, caller: ClientId, number: i64, service: &str, payload: &[u8]) {
        self.router.send_frames(caller, FrameKind::Reply, |out| {
            Side::Server.write_command(out, name::RESPONSE, &Call { srv_id: number });
            Side::Server.write(out, service, payload);
        });
    }

    /// Answers a call that fails, so that the caller stops waiting.
    ///
    /// Clients of the Foxglove protocol are told of the failure itself. ros_tcp has no frame for it: `notice` goes to the
    /// client's log, and SLAM's services have responses that say so. Others get a response without fields, which the
    /// caller's reader refuses. If the service's response has no fields, or its fields are not known, an empty one would
    /// read as success: then there is none, and the caller has the notice alone.
    fn send_failure(&mut self, caller: ClientId, number: i64, spelled: &str, notice: String, reason: &str) {
        if self.router.client(caller).is_some_and(|client| client.takes_call_failures()) {
            self.router.counted.refused += 1;
            let failure = CallFailure { srv_id: number, text: reason.to_owned() };
            return self.router.send_command(caller, name::CALL_FAILURE, &failure);
        }
        self.router.refuse(caller, notice);
        let name = interfaces::resolve_name(spelled).unwrap_or_default();
        if let Some((_, named)) = self.offered.slam.find(&name) {
            if let Some(payload) = failure(named.service, self.config.payloads, reason) {
                self.send_response(caller, number, spelled, &payload);
            }
            return;
        }
        let service_type = self.services.service_type(&name).unwrap_or_default();
        if interfaces::has_response_fields(service_type) {
            let payload: &[u8] = match self.config.payloads {
                Dialect::Ros2 => &ENCAPSULATION,
                Dialect::Ros1 => &[],
            };
            self.send_response(caller, number, spelled, payload);
        }
    }

    /// Tells a caller that its call fails.
    pub(super) fn fail_call(&mut self, call: &ServiceCall, reason: &str) {
        if call.provider == Provider::Ros {
            self.relay.cancel_call(&call.service, call.number);
        }
        match &call.caller {
            Caller::Client { id, number, spelled } => {
                let notice = format!("service '{spelled}': {reason}");
                self.send_failure(*id, *number, spelled, notice, reason);
            }
            Caller::Ros(request) => self.fail_ros_call(&call.service, *request, reason),
        }
    }

    /// Answers a ROS 2 node's call that fails, if the service's response can say so.
    fn fail_ros_call(&mut self, service: &str, request: RosRequestId, reason: &str) {
        self.router.counted.refused += 1;
        let named = self.offered.slam.find(service);
        if let Some(payload) = named.and_then(|(_, named)| failure(named.service, Dialect::Ros2, reason)) {
            self.relay.respond(service, request, &payload);
        }
    }
}

/// Encodes the response of one of SLAM's services to a call that fails; `None` if it has no such response.
fn failure(service: slam_services::Service, dialect: Dialect, reason: &str) -> Option<Vec<u8>> {
    let mut payload = Vec::new();
    service
        .can_report_failure()
        .then(|| service.write(&mut Writer::with(dialect, &mut payload), false, reason))?;
    Some(payload)
}
