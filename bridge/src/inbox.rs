//! What a client sends: registrations, services, lists. What its messages mean is in `inputs`.

use crate::cdr::{Dialect, ENCAPSULATION, with_dummy_byte};
use crate::client::{ClientId, Expected, Publication};
use crate::command::{Call as CallBody, Registration, TopicList, name};
use crate::frame::{Frame, Side};
use crate::hub::Hub;
use crate::interfaces::{self, Kind};
use crate::outbox::Lane;
use crate::ros::{Message, Twist, TwistStamped};
use crate::services::Call;
use crate::topics::{Input, Source, TopicError, TopicId};
use serde::de::DeserializeOwned;
use std::time::Instant;

impl Hub {
    /// One frame from a client.
    pub(crate) fn receive(&mut self, id: ClientId, frame: Frame<'_>) {
        self.board.counted.received += 1;
        if frame.is_keepalive() {
            return;
        }
        let Ok(name) = core::str::from_utf8(frame.name) else {
            let text = format!("a destination is not UTF-8: '{}'", String::from_utf8_lossy(frame.name));
            return self.board.refuse(id, text);
        };
        let Some(client) = self.board.client_mut(id) else { return };
        let expected = client.expected.take();
        if name.starts_with("__") {
            if expected.is_some() {
                let text =
                    format!("{name} came between a service's number and its frame: the call is dropped");
                self.board.refuse(id, text);
            }
            return self.system_command(id, name, frame);
        }
        match expected {
            None => self.data(id, name, frame.payload),
            Some(Expected::Request(number)) => self.request(id, number, name, frame.payload),
            Some(Expected::Response(number)) => self.response(id, number, frame.payload),
        }
    }

    fn system_command(&mut self, id: ClientId, command: &str, frame: Frame<'_>) {
        if command == name::TOPIC_LIST {
            return self.topic_list(id);
        }
        let done = match command {
            name::REQUEST => {
                parse(frame).and_then(|CallBody { srv_id }| self.expect(id, Expected::Request(srv_id)))
            }
            name::RESPONSE => {
                parse(frame).and_then(|CallBody { srv_id }| self.expect(id, Expected::Response(srv_id)))
            }
            _ => parse(frame).and_then(|registration| self.register(id, command, &registration)),
        };
        if let Err(why) = done {
            self.board.refuse(id, format!("{command}: {why}"));
        }
    }

    fn expect(&mut self, id: ClientId, expected: Expected) -> Result<(), String> {
        if let Some(client) = self.board.client_mut(id) {
            client.expected = Some(expected);
        }
        Ok(())
    }

    fn register(&mut self, id: ClientId, command: &str, about: &Registration) -> Result<(), String> {
        let known = [
            name::SUBSCRIBE,
            name::PUBLISH,
            name::ROS_SERVICE,
            name::UNITY_SERVICE,
            name::REMOVE_SUBSCRIBER,
            name::REMOVE_PUBLISHER,
            name::REMOVE_ROS_SERVICE,
            name::REMOVE_UNITY_SERVICE,
        ];
        if !known.contains(&command) {
            return Err(format!("unknown command; there are {}", known.join(", ")));
        }
        let topic = interfaces::resolve_name(&about.topic)?;
        match command {
            name::SUBSCRIBE => self.subscribe(id, topic, about),
            name::PUBLISH => self.publish(id, topic, about),
            name::ROS_SERVICE => {
                let class = self.class(Kind::Service, about)?;
                self.services.register_caller(id, &topic, &class)
            }
            name::UNITY_SERVICE => {
                let class = self.class(Kind::Service, about)?;
                self.services.register_provider(id, &topic, &class)
            }
            name::REMOVE_ROS_SERVICE => {
                self.services.remove_caller(id, &topic);
                Ok(())
            }
            name::REMOVE_UNITY_SERVICE => {
                let failed = self.services.remove_provider(id, &topic);
                failed.into_iter().for_each(|call| self.fail(&call, "the client no longer offers it"));
                Ok(())
            }
            _ => self.remove(id, command, &topic, is_bare(about)),
        }
    }

    fn class(&self, kind: Kind, about: &Registration) -> Result<String, String> {
        interfaces::resolve(kind, &about.message_name, &self.config.message_packages)
            .map_err(|why| format!("{why} (for '{}')", about.topic))
    }

    fn find_topic(&mut self, name: String, class: &str) -> Result<TopicId, String> {
        self.board.topics.find_or_add(name.clone(), class).map_err(|error| match error {
            TopicError::Type { is } => format!("'{name}' is {is}, not {class}"),
            TopicError::TooMany { limit } => {
                format!("'{name}' would be one topic too many: the limit is {limit}")
            }
        })
    }

    fn subscribe(&mut self, id: ClientId, name: String, about: &Registration) -> Result<(), String> {
        let class = self.class(Kind::Message, about)?;
        self.check_watch(id)?;
        let topic = self.find_topic(name, &class)?;
        let new = self.board.subscribe(id, topic, is_bare(about));
        if new && topic == self.fleet.transforms {
            self.send_map_transforms(Instant::now());
        }
        Ok(())
    }

    fn check_watch(&mut self, id: ClientId) -> Result<(), String> {
        let Some(address) = self.board.client(id).map(|client| client.peer.ip()) else { return Ok(()) };
        if self.access.may_watch(address) {
            return Ok(());
        }
        self.access.ask(address);
        Err(format!(
            "{address} may not watch yet: somebody at the laptop must press `a` there, or say `mr-slam allow {address}`"
        ))
    }

    fn publish(&mut self, id: ClientId, name: String, about: &Registration) -> Result<(), String> {
        let class = self.class(Kind::Message, about)?;
        let stamped = class == TwistStamped::TYPE && self.takes_stamped(&name);
        let topic = self.find_topic(name, if stamped { Twist::TYPE } else { &class })?;
        let Some(entry) = self.board.topics.get(topic) else { return Ok(()) };
        if entry.source == Source::Fleet {
            return Err(format!("'{}' is published by the fleet; choose another name", entry.name));
        }
        if about.queue_size < 0 {
            let text =
                format!("__publish: '{}': queue_size is {}, taken as 10", about.topic, about.queue_size);
            self.board.notice(id, name::WARN, text);
        }
        let publication = Publication { topic, stamped, latch: about.latch };
        self.board.publish(id, publication, about.queue_size);
        Ok(())
    }

    /// `/robotN/cmd_vel` may be TwistStamped, as ROS 2 drivers from Jazzy on want it.
    fn takes_stamped(&self, name: &str) -> bool {
        let topic = self.board.topics.find(name).and_then(|id| self.board.topics.get(id));
        topic.is_some_and(|topic| matches!(topic.source, Source::Input(Input::Command(_))))
    }

    fn remove(&mut self, id: ClientId, command: &str, name: &str, bare: bool) -> Result<(), String> {
        let topic = self.board.topics.find(name).ok_or(format!("there is no topic '{name}'"))?;
        if command == name::REMOVE_SUBSCRIBER {
            self.board.unsubscribe(id.slot, topic, Some(bare));
        } else {
            self.board.unpublish(id.slot, topic);
        }
        Ok(())
    }

    fn topic_list(&mut self, id: ClientId) {
        let pairs = self.board.topics.sorted().map(|topic| (topic.name.clone(), topic.class.clone()));
        let (topics, types) = pairs.unzip();
        self.board.command(id, name::TOPIC_LIST, &TopicList { topics, types });
    }

    /// A client calls a service.
    fn request(&mut self, id: ClientId, number: i64, spelled: &str, payload: &[u8]) {
        let payload = with_dummy_byte(self.config.payloads, payload);
        let resolved = interfaces::resolve_name(spelled);
        let call =
            resolved.and_then(|name| self.services.call(id, number, &name, spelled, Instant::now()).cloned());
        match call {
            Ok(call) => self.board.answer(call.provider, Lane::Answer, |out| {
                Side::Server.write_command(out, name::REQUEST, &CallBody { srv_id: call.number });
                Side::Server.write(out, &call.service, payload);
            }),
            Err(why) => {
                self.board.refuse(id, format!("__request {number}: {why}"));
                self.respond(id, number, spelled, self.no_response());
            }
        }
    }

    /// A client answers a call.
    fn response(&mut self, id: ClientId, number: i64, payload: &[u8]) {
        let payload = with_dummy_byte(self.config.payloads, payload);
        match self.services.answered(id, number) {
            Some(call) => self.respond(call.caller, call.caller_number, &call.service, payload),
            None => self.board.refuse(id, format!("__response {number}: no such call waits for you")),
        }
    }

    fn respond(&mut self, caller: ClientId, number: i64, service: &str, payload: &[u8]) {
        self.board.answer(caller, Lane::Answer, |out| {
            Side::Server.write_command(out, name::RESPONSE, &CallBody { srv_id: number });
            Side::Server.write(out, service, payload);
        });
    }

    /// What a service's caller gets instead of a response: nothing behind the encapsulation header, so that its
    /// reader fails and whoever waits for it goes on.
    fn no_response(&self) -> &'static [u8] {
        match self.config.payloads {
            Dialect::Ros2 => &ENCAPSULATION,
            Dialect::Ros1 => &[],
        }
    }

    /// A call gets no answer: its caller is told, so that it does not wait for ever.
    pub(crate) fn fail(&mut self, call: &Call, why: &str) {
        self.board.refuse(call.caller, format!("service '{}': {why}", call.service));
        self.respond(call.caller, call.caller_number, &call.service, self.no_response());
    }
}

/// Unity projects often leave the leading slash out, and then know the topic only so.
fn is_bare(about: &Registration) -> bool {
    !about.topic.starts_with('/')
}

fn parse<T: DeserializeOwned>(frame: Frame<'_>) -> Result<T, String> {
    serde_json::from_slice(frame.json()).map_err(|error| format!("its JSON is unsound: {error}"))
}
