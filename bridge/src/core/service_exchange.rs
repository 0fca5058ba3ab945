//! The exchange of clients' services with ROS: who may offer and call there, and what clients are told about it.

use super::Core;
use crate::access::Action;
use crate::command::name;
use crate::relay::RosGraph;
use crate::router::ClientId;
use crate::services::ServiceError;
use std::collections::BTreeMap;

impl Core {
    /// Begins the exchange with ROS: the fleet's services and clients' services are offered there.
    pub fn open_relay(&mut self) {
        self.relay.open();
        // Who may not drive may not reset maps either.
        if self.config.may_ros_drive() {
            for (name, service_type) in self.offered.slam.names() {
                self.relay.offer_fleet_service(name, service_type);
            }
        }
        self.update_actions();
        self.update_services();
    }

    /// Returns the services that clients can call now, by their names: the fleet's, clients', and ROS 2 nodes'.
    ///
    /// A ROS 2 service of several types is left out: it cannot be called.
    pub fn callable_services(&self) -> BTreeMap<&str, &str> {
        let mut callable: BTreeMap<&str, &str> = BTreeMap::new();
        if self.relay.has_endpoint() {
            for (name, types) in &self.relay.graph().services {
                if let [service_type] = &types[..] {
                    callable.insert(name.as_str(), service_type.as_str());
                }
            }
        }
        // The later ones are those that answer where several have a name.
        for (name, service_type, _) in self.services.provided() {
            callable.insert(name, service_type);
        }
        for (name, service_type) in self.offered.slam.names() {
            callable.insert(name, service_type);
        }
        callable
    }

    /// Returns whether a client may publish, offer or call a name in ROS.
    pub(super) fn may_use_ros(&self, client: ClientId, name: &str) -> bool {
        let peer = self.router.client(client).map(|client| client.peer.ip());
        self.relay.is_public_name(name) || peer.is_some_and(|ip| self.access.may(Action::Drive, ip))
    }

    /// Calls and offers in ROS what clients call and offer, as far as they may. Call it when either has changed.
    pub fn update_services(&mut self) {
        if !self.relay.has_endpoint() {
            return;
        }
        let is_called = |name: &str, callers: &[ClientId]| {
            let is_of_fleet = self.offered.slam.find(name).is_some() || self.offered.actions.owns(name);
            !is_of_fleet && callers.iter().any(|caller| self.may_use_ros(*caller, name))
        };
        let called = self.services.called().filter(|(name, _, callers)| is_called(name, callers));
        let called: BTreeMap<_, _> = called.map(|(name, of, _)| (name.to_owned(), of.to_owned())).collect();
        let provided = self.services.provided();
        let offered = provided.filter(|(name, _, provider)| self.may_use_ros(*provider, name));
        let offered: BTreeMap<_, _> = offered.map(|(name, of, _)| (name.to_owned(), of.to_owned())).collect();
        self.relay.update_services(borrow(&called), borrow(&offered));
    }

    /// Fails if the fleet or a ROS 2 node offers a service: clients cannot take it over.
    pub(super) fn check_service_is_free(&self, name: &str) -> Result<(), ServiceError> {
        let name = name.to_owned();
        if self.offered.slam.find(&name).is_some() || self.offered.actions.owns(&name) {
            return Err(ServiceError::OfFleet { name });
        }
        if self.services.provider(&name).is_none() && self.relay.graph().services.contains_key(&name) {
            return Err(ServiceError::OfRos { name });
        }
        Ok(())
    }

    /// Tells a client why the service that it offers is not offered to ROS.
    pub(super) fn report_unoffered(&mut self, client: ClientId, name: &str) {
        if !self.relay.has_endpoint() || self.relay.services().is_offered(name) {
            return;
        }
        let limit = self.relay.services().services_max();
        let reason = if self.may_use_ros(client, name) {
            format!("{limit} services are exchanged, the limit (bridge.dds.relayed_services_max)")
        } else {
            let Some(peer) = self.router.client(client).map(|client| client.peer.ip()) else { return };
            let Err(error) = self.access.check(Action::Drive, peer) else { return };
            format!("{error}; open_topics in [bridge] opens a service to all")
        };
        let text = format!("service '{name}' is not offered to ROS 2: {reason}");
        self.router.send_notice(client, name::WARN, text);
    }

    /// Fails the calls that wait for ROS 2 nodes which have left.
    pub(super) fn fail_lost_calls(&mut self, graph: &RosGraph) {
        for call in self.services.remove_lost(|name| graph.services.contains_key(name)) {
            self.fail_call(&call, "the ROS 2 node that offered it has left");
        }
    }

    /// Handles that the endpoint cannot call or offer a service: its users are told, and calls that wait fail.
    pub(super) fn receive_service_failure(&mut self, service: &str, text: &str) {
        if let Some(provider) = self.services.provider(service) {
            self.router.send_notice(provider, name::ERROR, text.to_owned());
        }
        for call in self.services.remove_lost(|name| name != service) {
            self.fail_call(&call, text);
        }
    }
}

fn borrow(services: &BTreeMap<String, String>) -> BTreeMap<&str, &str> {
    services.iter().map(|(name, service_type)| (name.as_str(), service_type.as_str())).collect()
}
