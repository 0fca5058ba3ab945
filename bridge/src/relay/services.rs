//! The services that clients call in ROS or offer to it, and the commands that open and close them there.

use super::RosCommand;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// The services that are exchanged with ROS now: name with leading slash, and `package/Type`.
#[derive(Debug)]
pub struct ServiceExchange {
    called: BTreeMap<Arc<str>, String>,
    offered: BTreeMap<Arc<str>, String>,
    services_max: usize,
}

impl ServiceExchange {
    /// Creates an exchange of at most `services_max` services of clients.
    pub fn new(services_max: usize) -> Self {
        Self { called: BTreeMap::new(), offered: BTreeMap::new(), services_max }
    }

    /// Returns whether a service is called in ROS.
    pub fn is_called(&self, name: &str) -> bool {
        self.called.contains_key(name)
    }

    /// Returns whether a service of a client is offered to ROS.
    pub fn is_offered(&self, name: &str) -> bool {
        self.offered.contains_key(name)
    }

    /// Returns the most services of clients that are exchanged at a time.
    pub fn services_max(&self) -> usize {
        self.services_max
    }

    /// Replaces the services that shall be called and offered; what exceeds the limit is left out.
    ///
    /// A service that is exchanged already keeps its place.
    pub fn update(
        &mut self,
        called: BTreeMap<&str, &str>,
        offered: BTreeMap<&str, &str>,
        commands: &mut VecDeque<RosCommand>,
    ) {
        let is_wanted = |wanted: &BTreeMap<&str, &str>, name: &str, of: &str| wanted.get(name) == Some(&of);
        self.called.retain(|name, service_type| {
            let is_kept = is_wanted(&called, name, service_type);
            if !is_kept {
                commands.push_back(RosCommand::CloseClient { service: name.clone() });
            }
            is_kept
        });
        self.offered.retain(|name, service_type| {
            let is_kept = is_wanted(&offered, name, service_type);
            if !is_kept {
                commands.push_back(RosCommand::CloseServer { service: name.clone() });
            }
            is_kept
        });
        for (name, service_type) in called {
            if !self.called.contains_key(name) && self.has_room() {
                let (service, service_type): (Arc<str>, _) = (name.into(), service_type.to_owned());
                self.called.insert(service.clone(), service_type.clone());
                commands.push_back(RosCommand::OpenClient { service, service_type });
            }
        }
        for (name, service_type) in offered {
            if !self.offered.contains_key(name) && self.has_room() {
                let (service, service_type): (Arc<str>, _) = (name.into(), service_type.to_owned());
                self.offered.insert(service.clone(), service_type.clone());
                commands.push_back(RosCommand::OpenServer { service, service_type });
            }
        }
    }

    fn has_room(&self) -> bool {
        self.called.len() + self.offered.len() < self.services_max
    }
}
