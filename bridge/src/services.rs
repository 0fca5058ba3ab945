//! Services between clients: who offers, who may call, which calls are under way.

use crate::client::ClientId;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Our numbers of calls begin here, as the reference's do.
const FIRST_CALL: i64 = 1001;
/// Calls under way at one time, all clients together.
const CALLS_MAX: usize = 1024;

#[derive(Debug, Default)]
struct Service {
    class: String,
    /// The client that answers; the newest to say so.
    provider: Option<ClientId>,
    callers: Vec<ClientId>,
}

/// A request on its way.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Call {
    /// Our number of it, which the provider answers to.
    pub number: i64,
    /// Who wants the response.
    pub caller: ClientId,
    /// The caller's number of it.
    pub caller_number: i64,
    /// Who must answer.
    pub provider: ClientId,
    /// The service's name as the caller spells it.
    pub service: String,
    deadline: Instant,
}

/// All services and calls.
#[derive(Debug)]
pub struct Services {
    services: BTreeMap<String, Service>,
    services_max: usize,
    calls: Vec<Call>,
    next: i64,
    timeout: Duration,
}

impl Services {
    /// Clients may bring `services_max` services; a call may take `timeout`.
    pub fn new(services_max: usize, timeout: Duration) -> Self {
        Self { services: BTreeMap::new(), services_max, calls: Vec::new(), next: FIRST_CALL, timeout }
    }

    fn entry(&mut self, name: &str, class: &str) -> Result<&mut Service, String> {
        let known = self.services.contains_key(name);
        if !known && self.services.len() >= self.services_max {
            return Err(format!("there are {} services already, the limit", self.services_max));
        }
        let fresh = || Service { class: class.to_owned(), ..Service::default() };
        let service = self.services.entry(name.to_owned()).or_insert_with(fresh);
        if service.class == class {
            Ok(service)
        } else {
            Err(format!("service '{name}' is {}, not {class}", service.class))
        }
    }

    /// The client will call this service.
    pub fn register_caller(&mut self, client: ClientId, name: &str, class: &str) -> Result<(), String> {
        let service = self.entry(name, class)?;
        if !service.callers.contains(&client) {
            service.callers.push(client);
        }
        Ok(())
    }

    /// The client answers this service, instead of any before.
    pub fn register_provider(&mut self, client: ClientId, name: &str, class: &str) -> Result<(), String> {
        self.entry(name, class)?.provider = Some(client);
        Ok(())
    }

    /// Undoes [`Self::register_caller`].
    pub fn remove_caller(&mut self, client: ClientId, name: &str) {
        if let Some(service) = self.services.get_mut(name) {
            service.callers.retain(|caller| *caller != client);
        }
        self.sweep();
    }

    /// Undoes [`Self::register_provider`]; the calls that will now get no answer.
    pub fn remove_provider(&mut self, client: ClientId, name: &str) -> Vec<Call> {
        if let Some(service) = self.services.get_mut(name) {
            service.provider = service.provider.filter(|provider| *provider != client);
        }
        self.sweep();
        self.end(|call| call.provider == client && same_name(&call.service, name))
    }

    /// A client is gone; the calls that will now get no answer.
    pub fn leave(&mut self, client: ClientId) -> Vec<Call> {
        for service in self.services.values_mut() {
            service.callers.retain(|caller| *caller != client);
            service.provider = service.provider.filter(|provider| *provider != client);
        }
        self.sweep();
        self.end(|call| call.caller == client);
        self.end(|call| call.provider == client)
    }

    fn sweep(&mut self) {
        self.services.retain(|_, service| service.provider.is_some() || !service.callers.is_empty());
    }

    fn end(&mut self, which: impl Fn(&Call) -> bool) -> Vec<Call> {
        let (ended, kept) = std::mem::take(&mut self.calls).into_iter().partition(which);
        self.calls = kept;
        ended
    }

    /// A client calls a service (`name` resolved, `spelled` as it wrote it): the call to pass on, or why not.
    pub fn call(
        &mut self,
        caller: ClientId,
        caller_number: i64,
        name: &str,
        spelled: &str,
        now: Instant,
    ) -> Result<&Call, String> {
        let registered = self.services.get(name).filter(|service| service.callers.contains(&caller));
        let Some(service) = registered else {
            return Err(format!("service '{spelled}' is not registered: send __ros_service first"));
        };
        let provider = service.provider.ok_or(format!("nobody offers service '{spelled}' now"))?;
        if self.calls.len() >= CALLS_MAX {
            return Err(format!("{CALLS_MAX} service calls are under way already"));
        }
        let number = self.next;
        self.next += 1;
        let deadline = now + self.timeout;
        self.calls.push(Call {
            number,
            caller,
            caller_number,
            provider,
            service: spelled.to_owned(),
            deadline,
        });
        Ok(&self.calls[self.calls.len() - 1])
    }

    /// The provider has answered the call of our `number`; `None` if that is no call of its.
    pub fn answered(&mut self, provider: ClientId, number: i64) -> Option<Call> {
        self.end(|call| call.number == number && call.provider == provider).pop()
    }

    /// Calls whose time is over.
    pub fn expired(&mut self, now: Instant) -> Vec<Call> {
        if self.calls.iter().all(|call| now < call.deadline) {
            return Vec::new();
        }
        self.end(|call| now >= call.deadline)
    }
}

fn same_name(spelled: &str, resolved: &str) -> bool {
    spelled.trim_start_matches('/') == resolved.trim_start_matches('/')
}
