//! Services of clients, and the calls that wait for a response of a client, of SLAM or of a ROS 2 node.

use crate::relay::RosRequestId;
use crate::router::ClientId;
use crate::slam_services;
use msg::{Monotonic, RobotId, SlamRequest};
use std::collections::BTreeMap;
use std::time::Duration;
use thiserror::Error;

/// The bridge numbers its calls from here, as the reference endpoint does.
const FIRST_CALL_NUMBER: i64 = 1001;
/// Calls that may wait for a response, of all callers together.
const CALLS_MAX: usize = 1024;
/// Calls of one client, or of all ROS 2 nodes together, that may wait for a response.
const CALLS_PER_CALLER_MAX: usize = 256;

/// Why a service cannot be registered or called.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ServiceError {
    /// Clients have registered as many services as they may.
    #[error("there are {limit} services already, the limit (client_topics_max)")]
    TooManyServices {
        /// Most services of all clients together (`client_topics_max`).
        limit: usize,
    },
    /// Another client offers the service already.
    #[error("service '{name}' is offered by another client; you offer it as soon as that client leaves")]
    Taken {
        /// The service's name.
        name: String,
    },
    /// The service is registered with another type.
    #[error("service '{name}' is {existing}, not {requested}")]
    OtherType {
        /// The service's name.
        name: String,
        /// Its type, `package/Type`.
        existing: String,
        /// The type that the client asked for.
        requested: String,
    },
    /// The client has not registered as caller of the service.
    #[error("service '{name}' is not registered: send __ros_service first")]
    NotRegistered {
        /// The service's name as the client wrote it.
        name: String,
    },
    /// Neither a client nor a ROS 2 node provides the service.
    #[error("nobody offers service '{name}' now: {hint}")]
    NoProvider {
        /// The service's name as the client wrote it.
        name: String,
        /// Where a provider was looked for.
        hint: &'static str,
    },
    /// The fleet offers the service itself.
    #[error("service '{name}' is offered by the fleet; choose another name")]
    OfFleet {
        /// The service's name.
        name: String,
    },
    /// A ROS 2 node offers the service.
    #[error("service '{name}' is offered by a ROS 2 node; choose another name")]
    OfRos {
        /// The service's name.
        name: String,
    },
    /// Too many calls of one caller, or of all, wait for a response.
    #[error("{limit} service calls wait for a response already; try again later")]
    TooManyCalls {
        /// Most calls that may wait.
        limit: usize,
    },
}

#[derive(Debug, Default)]
struct Service {
    service_type: String,
    /// The client that answers: the first that registered, while it lives.
    provider: Option<ClientId>,
    /// Clients that offer the service too, first come first: one answers when the provider has left.
    successors: Vec<ClientId>,
    callers: Vec<ClientId>,
}

impl Service {
    fn has(&self, client: ClientId) -> bool {
        self.provider == Some(client) || self.callers.contains(&client) || self.successors.contains(&client)
    }

    /// Removes a client from the providers; the next of them answers.
    fn remove_provider(&mut self, client: ClientId) {
        self.successors.retain(|successor| *successor != client);
        if self.provider == Some(client) {
            self.provider = (!self.successors.is_empty()).then(|| self.successors.remove(0));
        }
    }
}

/// Who waits for the response of a call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Caller {
    /// A client that has registered as caller.
    Client {
        /// The client that waits.
        id: ClientId,
        /// The client's number of the call.
        number: i64,
        /// The service's name as the client wrote it.
        spelled: String,
    },
    /// A ROS 2 node, by its request.
    Ros(RosRequestId),
}

impl Caller {
    fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Client { id, .. }, Self::Client { id: other, .. }) => id == other,
            (Self::Ros(_), Self::Ros(_)) => true,
            _ => false,
        }
    }
}

/// Who must respond to a call.
#[derive(Clone, Debug, PartialEq)]
pub enum Provider {
    /// A client that offers the service.
    Client(ClientId),
    /// A ROS 2 node that offers the service.
    Ros,
    /// A robot's SLAM.
    Slam {
        /// Robot whose SLAM must respond.
        robot: RobotId,
        /// What the service does.
        service: slam_services::Service,
        /// The request that follows when the present one is done.
        next: Option<Box<SlamRequest>>,
    },
}

/// A call that waits for its response.
#[derive(Clone, Debug, PartialEq)]
pub struct ServiceCall {
    /// The bridge's number of the call, which the provider answers to.
    pub number: i64,
    /// Who waits for the response.
    pub caller: Caller,
    /// Who must respond.
    pub provider: Provider,
    /// The service's name with leading slash.
    pub service: String,
    deadline: Monotonic,
}

/// All services of clients, and the calls that wait.
#[derive(Debug)]
pub struct ServiceCalls {
    services: BTreeMap<String, Service>,
    services_max: usize,
    calls: Vec<ServiceCall>,
    next_number: i64,
}

impl ServiceCalls {
    /// Creates an empty table. Clients may register `services_max` services.
    pub fn new(services_max: usize) -> Self {
        Self { services: BTreeMap::new(), services_max, calls: Vec::new(), next_number: FIRST_CALL_NUMBER }
    }

    fn find_or_add(&mut self, name: &str, service_type: &str) -> Result<&mut Service, ServiceError> {
        let is_known = self.services.contains_key(name);
        if !is_known && self.services.len() >= self.services_max {
            return Err(ServiceError::TooManyServices { limit: self.services_max });
        }
        let fresh = || Service { service_type: service_type.to_owned(), ..Service::default() };
        let service = self.services.entry(name.to_owned()).or_insert_with(fresh);
        if service.service_type == service_type {
            Ok(service)
        } else {
            Err(ServiceError::OtherType {
                name: name.to_owned(),
                existing: service.service_type.clone(),
                requested: service_type.to_owned(),
            })
        }
    }

    /// Returns the type of a service that is registered, `package/Type`.
    pub fn service_type(&self, name: &str) -> Option<&str> {
        self.services.get(name).map(|service| service.service_type.as_str())
    }

    /// Returns the client that provides a service.
    pub fn provider(&self, name: &str) -> Option<ClientId> {
        self.services.get(name)?.provider
    }

    /// Returns whether a client is registered as caller of a service.
    pub fn is_caller(&self, client: ClientId, name: &str) -> bool {
        self.services.get(name).is_some_and(|service| service.callers.contains(&client))
    }

    /// Returns the services with a provider: name, type and provider.
    pub fn provided(&self) -> impl Iterator<Item = (&str, &str, ClientId)> {
        let services = self.services.iter();
        services.filter_map(|(name, of)| Some((name.as_str(), of.service_type.as_str(), of.provider?)))
    }

    /// Returns the services that no client provides: name, type and callers.
    pub fn called(&self) -> impl Iterator<Item = (&str, &str, &[ClientId])> {
        let called = self.services.iter().filter(|(_, service)| service.provider.is_none());
        called.map(|(name, of)| (name.as_str(), of.service_type.as_str(), &of.callers[..]))
    }

    /// Registers a client as caller of a service.
    pub fn register_caller(
        &mut self,
        client: ClientId,
        name: &str,
        service_type: &str,
    ) -> Result<(), ServiceError> {
        let service = self.find_or_add(name, service_type)?;
        if !service.callers.contains(&client) {
            service.callers.push(client);
        }
        Ok(())
    }

    /// Registers a client as provider of a service. If another client is that and lives, it waits for its place.
    pub fn register_provider(
        &mut self,
        client: ClientId,
        name: &str,
        service_type: &str,
        is_alive: impl Fn(ClientId) -> bool,
    ) -> Result<(), ServiceError> {
        let service = self.find_or_add(name, service_type)?;
        match service.provider {
            Some(owner) if owner != client && is_alive(owner) => {
                if !service.successors.contains(&client) {
                    service.successors.push(client);
                }
                Err(ServiceError::Taken { name: name.to_owned() })
            }
            _ => {
                service.successors.retain(|successor| *successor != client);
                service.provider = Some(client);
                Ok(())
            }
        }
    }

    /// Returns how many services a client offers or calls, without the one of this name.
    pub fn count_others(&self, client: ClientId, name: &str) -> usize {
        self.services.iter().filter(|(of, service)| *of != name && service.has(client)).count()
    }

    /// Returns whether a client offers or calls any service.
    pub fn is_registered(&self, client: ClientId) -> bool {
        self.services.values().any(|service| service.has(client))
    }

    /// Removes a client from the callers of a service.
    pub fn remove_caller(&mut self, client: ClientId, name: &str) {
        if let Some(service) = self.services.get_mut(name) {
            service.callers.retain(|caller| *caller != client);
        }
        self.remove_unused();
    }

    /// Removes a client as provider of a service; returns the calls that get no response any more.
    pub fn remove_provider(&mut self, client: ClientId, name: &str) -> Vec<ServiceCall> {
        if let Some(service) = self.services.get_mut(name) {
            service.remove_provider(client);
        }
        self.remove_unused();
        self.remove_calls(|call| call.provider == Provider::Client(client) && call.service == name)
    }

    /// Removes a client that has left; returns the calls that get no response any more.
    pub fn remove_client(&mut self, client: ClientId) -> Vec<ServiceCall> {
        for service in self.services.values_mut() {
            service.callers.retain(|caller| *caller != client);
            service.remove_provider(client);
        }
        self.remove_unused();
        self.remove_calls(|call| call.provider == Provider::Client(client))
    }

    /// Removes and returns the calls of a client that has left.
    pub fn remove_calls_of(&mut self, client: ClientId) -> Vec<ServiceCall> {
        self.remove_calls(|call| matches!(call.caller, Caller::Client { id, .. } if id == client))
    }

    /// Removes and returns the calls that wait for a ROS 2 node, of services that none offers any more.
    pub fn remove_lost(&mut self, is_offered: impl Fn(&str) -> bool) -> Vec<ServiceCall> {
        self.remove_calls(|call| call.provider == Provider::Ros && !is_offered(&call.service))
    }

    fn remove_unused(&mut self) {
        self.services.retain(|_, service| service.provider.is_some() || !service.callers.is_empty());
    }

    fn remove_calls(&mut self, is_wanted: impl Fn(&ServiceCall) -> bool) -> Vec<ServiceCall> {
        let (removed, kept) = std::mem::take(&mut self.calls).into_iter().partition(is_wanted);
        self.calls = kept;
        removed
    }

    /// Begins a call of a service, which must be answered within `timeout`; returns the call to forward.
    pub fn begin_call(
        &mut self,
        caller: Caller,
        provider: Provider,
        service: &str,
        timeout: Duration,
        now: Monotonic,
    ) -> Result<ServiceCall, ServiceError> {
        let of_caller = self.calls.iter().filter(|call| call.caller.is_same(&caller)).count();
        let all = self.calls.len();
        for (count, limit) in [(of_caller, CALLS_PER_CALLER_MAX), (all, CALLS_MAX)] {
            if count >= limit {
                return Err(ServiceError::TooManyCalls { limit });
            }
        }
        let number = self.next_number;
        self.next_number += 1;
        let service = service.to_owned();
        let call = ServiceCall { number, caller, provider, service, deadline: now + timeout };
        self.calls.push(call.clone());
        Ok(call)
    }

    /// Ends the call with the bridge's `number`; `None` if the provider has no such call.
    pub fn end_call(&mut self, number: i64, is_of: impl Fn(&Provider) -> bool) -> Option<ServiceCall> {
        self.remove_calls(|call| call.number == number && is_of(&call.provider)).pop()
    }

    /// Waits again for a call that [`Self::end_call`] has returned.
    pub fn resume_call(&mut self, call: ServiceCall) {
        self.calls.push(call);
    }

    /// Removes and returns the calls whose deadline has passed.
    pub fn remove_expired(&mut self, now: Monotonic) -> Vec<ServiceCall> {
        if self.calls.iter().all(|call| now < call.deadline) {
            return Vec::new();
        }
        self.remove_calls(|call| now >= call.deadline)
    }
}
