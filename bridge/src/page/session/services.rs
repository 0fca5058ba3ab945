//! The services that one browser knows of, and its calls.

use super::{Encoder, OwnedFrame, registration};
use crate::command::{Call, name};
use crate::page::protocol::{
    CallId, ENCODING, SCHEMA_ENCODING, ServerCommand, Service, ServiceSchema, service_type_name,
};
use ros_messages::schema::service_schemas;
use std::collections::{BTreeMap, VecDeque};
use std::io;
use thiserror::Error;

/// Services that are registered for one browser at a time: half of what one client may (`limits.services_per_client`).
const REGISTERED_MAX: usize = 32;

/// Why a call is refused.
#[derive(Debug, Error)]
pub enum CallError {
    /// The service has gone, or never was.
    #[error("there is no service {0} now")]
    NoSuchService(u32),
    /// The client encodes its requests otherwise.
    #[error("the request is in '{0}'; the bridge takes '{ENCODING}'")]
    Encoding(String),
}

/// Services by their numbers on one connection.
#[derive(Debug, Default)]
pub struct ServiceTable {
    /// All services at the last update, sorted by name.
    offered: Vec<(String, String)>,
    /// Services that the client knows of: name and type.
    known: BTreeMap<u32, (String, String)>,
    last_number: u32,
    /// Services for which the client is registered as caller, the oldest first.
    registered: VecDeque<u32>,
}

impl ServiceTable {
    /// Tells the client which services have come and gone. Those whose schemas are not known are left out.
    pub fn update(&mut self, offered: &[(String, String)], encoder: &mut Encoder) -> io::Result<()> {
        if self.offered == offered {
            return Ok(());
        }
        self.offered = offered.to_vec();
        let is_gone = |service: &(String, String)| !offered.contains(service);
        let gone: Vec<u32> =
            self.known.iter().filter(|(_, service)| is_gone(service)).map(|(id, _)| *id).collect();
        if !gone.is_empty() {
            self.known.retain(|id, _| !gone.contains(id));
            self.registered.retain(|id| !gone.contains(id));
            encoder.send(&ServerCommand::UnadvertiseServices { service_ids: gone })?;
        }
        let mut services = Vec::new();
        for service in offered {
            if self.known.values().any(|known| known == service) {
                continue;
            }
            let Some(schemas) = service_schemas(&service.1) else { continue };
            self.last_number += 1;
            self.known.insert(self.last_number, service.clone());
            let part = |end, schema| ServiceSchema {
                encoding: ENCODING,
                schema_name: service_type_name(&service.1, end),
                schema_encoding: SCHEMA_ENCODING,
                schema,
            };
            services.push(Service {
                id: self.last_number,
                name: &service.0,
                r#type: service_type_name(&service.1, ""),
                request: part("_Request", schemas.request),
                response: part("_Response", schemas.response),
            });
        }
        if services.is_empty() {
            Ok(())
        } else {
            encoder.send(&ServerCommand::AdvertiseServices { services })
        }
    }

    /// Returns the service's name and the commands that must come before its request.
    pub fn begin_call(&mut self, id: CallId, encoding: &[u8]) -> Result<(&str, Vec<OwnedFrame>), CallError> {
        let (name, service_type) = self.known.get(&id.service).ok_or(CallError::NoSuchService(id.service))?;
        if encoding != ENCODING.as_bytes() {
            return Err(CallError::Encoding(String::from_utf8_lossy(encoding).into_owned()));
        }
        let mut commands = Vec::new();
        if !self.registered.contains(&id.service) {
            if self.registered.len() == REGISTERED_MAX {
                let oldest = self.registered.pop_front().and_then(|oldest| self.known.get(&oldest));
                commands.extend(oldest.map(|(name, _)| registration(name::REMOVE_ROS_SERVICE, name, "")));
            }
            self.registered.push_back(id.service);
            commands.push(registration(name::ROS_SERVICE, name, service_type));
        }
        // A struct of numbers serializes without errors.
        let payload = serde_json::to_vec(&Call { srv_id: id.number() }).unwrap_or_default();
        commands.push(OwnedFrame { name: name::REQUEST, payload });
        Ok((name, commands))
    }
}
