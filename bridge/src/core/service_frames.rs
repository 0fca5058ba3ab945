//! Frames of service calls between clients, with the reply to a call that fails.

use super::Core;
use crate::cdr::{Dialect, ENCAPSULATION, with_dummy_byte};
use crate::command::{Call, name};
use crate::frame::Side;
use crate::interfaces::{self, NameError};
use crate::router::{ClientId, FrameKind};
use crate::services::{ServiceCall, ServiceError};
use msg::Monotonic;
use thiserror::Error;

/// Why a client's call fails at once.
#[derive(Debug, Error)]
enum RequestError {
    /// The service's name is not a ROS name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Nobody can answer.
    #[error(transparent)]
    Service(#[from] ServiceError),
}

impl Core {
    /// Forwards a client's request to the service's provider.
    pub(super) fn receive_request(
        &mut self,
        id: ClientId,
        number: i64,
        spelled: &str,
        payload: &[u8],
        now: Monotonic,
    ) {
        let payload = with_dummy_byte(self.config.payloads, payload);
        match self.begin_call(id, number, spelled, now) {
            Ok(call) => self.router.send_frames(call.provider, FrameKind::Reply, |out| {
                Side::Server.write_command(out, name::REQUEST, &Call { srv_id: call.number });
                Side::Server.write(out, &call.service, payload);
            }),
            Err(error) => {
                self.router.refuse(id, format!("__request {number}: {error}"));
                self.send_failure(id, number, spelled);
            }
        }
    }

    fn begin_call(
        &mut self,
        id: ClientId,
        number: i64,
        spelled: &str,
        now: Monotonic,
    ) -> Result<ServiceCall, RequestError> {
        let name = interfaces::resolve_name(spelled)?;
        Ok(self.services.begin_call(id, number, &name, spelled, now)?)
    }

    /// Forwards a provider's response to the caller.
    pub(super) fn receive_response(&mut self, id: ClientId, number: i64, payload: &[u8]) {
        let payload = with_dummy_byte(self.config.payloads, payload);
        match self.services.end_call(id, number) {
            Some(call) => self.send_response(call.caller, call.caller_number, &call.service, payload),
            None => self.router.refuse(id, format!("__response {number}: no such call waits for you")),
        }
    }

    fn send_response(&mut self, caller: ClientId, number: i64, service: &str, payload: &[u8]) {
        self.router.send_frames(caller, FrameKind::Reply, |out| {
            Side::Server.write_command(out, name::RESPONSE, &Call { srv_id: number });
            Side::Server.write(out, service, payload);
        });
    }

    /// Answers a call that fails with a response without fields, so that the caller's reader fails and stops waiting.
    ///
    /// The protocol has no error response. If the service's response has no fields, or its fields are not known, an empty
    /// one would read as success: then there is none, and the caller has the error alone.
    fn send_failure(&mut self, caller: ClientId, number: i64, service: &str) {
        let name = interfaces::resolve_name(service).unwrap_or_default();
        let service_type = self.services.service_type(&name).unwrap_or_default();
        if interfaces::has_response_fields(service_type) {
            let payload: &[u8] = match self.config.payloads {
                Dialect::Ros2 => &ENCAPSULATION,
                Dialect::Ros1 => &[],
            };
            self.send_response(caller, number, service, payload);
        }
    }

    /// Tells a caller that its call fails.
    pub(super) fn fail_call(&mut self, call: &ServiceCall, reason: &str) {
        self.router.refuse(call.caller, format!("service '{}': {reason}", call.service));
        self.send_failure(call.caller, call.caller_number, &call.service);
    }
}
