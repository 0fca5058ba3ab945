//! Services between clients, with providers, callers and the calls that wait for a response.

use crate::router::ClientId;
use msg::Monotonic;
use std::collections::BTreeMap;
use std::time::Duration;
use thiserror::Error;

/// The bridge numbers its calls from here, as the reference endpoint does.
const FIRST_CALL_NUMBER: i64 = 1001;
/// Calls that may wait for a response, of all clients together.
const CALLS_MAX: usize = 1024;

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
    /// No client provides the service.
    #[error("nobody offers service '{name}' now")]
    NoProvider {
        /// The service's name as the client wrote it.
        name: String,
    },
    /// Too many calls wait for a response.
    #[error("{CALLS_MAX} service calls wait for a response already; try again later")]
    TooManyCalls,
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

/// A call that waits for its response.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceCall {
    /// The bridge's number of the call, which the provider answers to.
    pub number: i64,
    /// The client that waits for the response.
    pub caller: ClientId,
    /// The caller's number of the call.
    pub caller_number: i64,
    /// The client that must respond.
    pub provider: ClientId,
    /// The service's name as the caller wrote it.
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
    timeout: Duration,
}

impl ServiceCalls {
    /// Creates an empty table. Clients may register `services_max` services; a call may take `timeout`.
    pub fn new(services_max: usize, timeout: Duration) -> Self {
        Self {
            services: BTreeMap::new(),
            services_max,
            calls: Vec::new(),
            next_number: FIRST_CALL_NUMBER,
            timeout,
        }
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
        self.remove_calls(|call| call.provider == client && is_same_name(&call.service, name))
    }

    /// Removes a client that has left; returns the calls that get no response any more.
    pub fn remove_client(&mut self, client: ClientId) -> Vec<ServiceCall> {
        for service in self.services.values_mut() {
            service.callers.retain(|caller| *caller != client);
            service.remove_provider(client);
        }
        self.remove_unused();
        self.remove_calls(|call| call.caller == client);
        self.remove_calls(|call| call.provider == client)
    }

    fn remove_unused(&mut self) {
        self.services.retain(|_, service| service.provider.is_some() || !service.callers.is_empty());
    }

    fn remove_calls(&mut self, is_wanted: impl Fn(&ServiceCall) -> bool) -> Vec<ServiceCall> {
        let (removed, kept) = std::mem::take(&mut self.calls).into_iter().partition(is_wanted);
        self.calls = kept;
        removed
    }

    /// Begins a client's call; returns the call to forward to the provider.
    ///
    /// `name` is the service's name with leading slash, `spelled` the name as the client wrote it.
    pub fn begin_call(
        &mut self,
        caller: ClientId,
        caller_number: i64,
        name: &str,
        spelled: &str,
        now: Monotonic,
    ) -> Result<ServiceCall, ServiceError> {
        let registered = self.services.get(name).filter(|service| service.callers.contains(&caller));
        let service = registered.ok_or_else(|| ServiceError::NotRegistered { name: spelled.to_owned() })?;
        let provider =
            service.provider.ok_or_else(|| ServiceError::NoProvider { name: spelled.to_owned() })?;
        if self.calls.len() >= CALLS_MAX {
            return Err(ServiceError::TooManyCalls);
        }
        let number = self.next_number;
        self.next_number += 1;
        let deadline = now + self.timeout;
        let call =
            ServiceCall { number, caller, caller_number, provider, service: spelled.to_owned(), deadline };
        self.calls.push(call.clone());
        Ok(call)
    }

    /// Ends the call with the bridge's `number`; `None` if the provider has no such call.
    pub fn end_call(&mut self, provider: ClientId, number: i64) -> Option<ServiceCall> {
        self.remove_calls(|call| call.number == number && call.provider == provider).pop()
    }

    /// Removes and returns the calls whose deadline has passed.
    pub fn remove_expired(&mut self, now: Monotonic) -> Vec<ServiceCall> {
        if self.calls.iter().all(|call| now < call.deadline) {
            return Vec::new();
        }
        self.remove_calls(|call| now >= call.deadline)
    }
}

fn is_same_name(spelled: &str, resolved: &str) -> bool {
    spelled.trim_start_matches('/') == resolved.trim_start_matches('/')
}
