//! The link over Zenoh: one session between a robot's machine and the base, or through a router between them.
//!
//! Zenoh connects, connects again, and sends the more urgent first. What does not fit into its queues is dropped: all that
//! must arrive is sent again by the crate `link`.

use crate::connection_log::plain_reason;
use crate::keys::{BASE_SUBJECT, KeyFiles, ROUTER_SUBJECT, robot_subject};
use crate::{Endpoint, Protocol, Transport};
use link::Kind;
use link::table::{Direction, Priority, all_robots_key, key, keys, robot_of_key};
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use zenoh::Wait;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority as ZenohPriority};

/// Messages that wait until the loop reads them: 5 s of eight robots' signs of life and poses.
const WAITING_MAX: usize = 1024;
/// Time without any sign of a machine after which Zenoh closes its connection and connects again, milliseconds.
const LEASE_MS: u32 = 2000;
/// First and longest pause between two attempts to connect, milliseconds.
const RETRY_MS: [u32; 2] = [200, 1000];
/// Longest attempt to connect, milliseconds. One whose packets are lost backs off and is slower than the next one.
const OPEN_MS: u32 = 3000;
/// A machine tries to connect for as long as it takes.
const WITHOUT_END: i64 = -1;
/// Times for which a machine tries to connect by QUIC and then by TLS, milliseconds: attempts take [`OPEN_MS`] at most. QUIC,
/// which bears losses better, has more of them.
const PROTOCOLS_MS: [i64; 2] = [8000, 4000];
/// Time of the first attempt, milliseconds.
const FIRST_MS: i64 = 4000;
/// Pause before they are tried again.
const PROTOCOLS_PAUSE: Duration = Duration::from_millis(500);
/// Time between two warnings that there is no connection.
const REPORT_PERIOD: Duration = Duration::from_secs(60);
/// Largest batch of messages, bytes: an urgent message waits for one of them.
const BATCH_BYTES: u32 = 8192;
/// Bytes that wait in the operating system: 0.13 s at 1 Mbit/s. Urgent messages cannot overtake them.
const SOCKET_BYTES: u32 = 16 << 10;

/// Reason why there is no link.
#[derive(Debug, thiserror::Error)]
#[error("the link between machines (Zenoh): {what}: {why}")]
pub struct SessionError {
    what: &'static str,
    why: String,
}

fn failed<E: std::fmt::Display>(what: &'static str) -> impl FnOnce(E) -> SessionError {
    move |why| SessionError { what, why: why.to_string() }
}

/// What a machine is in the fleet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SessionRole {
    /// A robot's machine, which connects to the base or to a router.
    Robot,
    /// The base, at which robots join.
    Base,
    /// The base, which connects to a router.
    BaseBehindRouter,
    /// A router, at which robots and base join.
    Router,
}

impl SessionRole {
    /// Returns Zenoh's mode. What connects is a client: through a router peers would not reach each other.
    fn mode(self) -> &'static str {
        match self {
            Self::Robot | Self::BaseBehindRouter => "client",
            Self::Base => "peer",
            Self::Router => "router",
        }
    }
}

/// One machine's part in the link.
#[derive(Clone, Debug)]
pub struct SessionConfig {
    /// Endpoint at which the base or the router listens.
    pub endpoint: Endpoint,
    /// What this machine is.
    pub role: SessionRole,
    /// Names of the robots: all at the base and at a router, its own on a robot's machine.
    pub robots: Vec<String>,
    /// Certificates, if the endpoint is encrypted.
    pub keys: Option<KeyFiles>,
}

impl SessionConfig {
    /// Opens a session. A machine that connects waits until it has, and says once a minute why it has not. If QUIC is wanted it tries
    /// QUIC and TLS in turns: some networks let no UDP through, and a handshake that somebody does not finish occupies a QUIC port
    /// for 30 s.
    fn open(&self) -> Result<zenoh::Session, SessionError> {
        if self.listens() {
            return zenoh::open(self.to_zenoh(WITHOUT_END)?).wait().map_err(failed("cannot open a session"));
        }
        // The first attempt is short: who starts a robot sees soon that it has no base.
        let mut configs = vec![self.to_zenoh(FIRST_MS)?];
        let mut how = "it is tried until there is one";
        if self.endpoint.protocol == Protocol::Quic {
            let by_tls = Self { endpoint: self.endpoint.with_protocol(Protocol::Tls), ..self.clone() };
            configs.push(by_tls.to_zenoh(PROTOCOLS_MS[1])?);
            how = "QUIC and TLS are tried in turns until there is one";
        }
        let mut reported: Option<Instant> = None;
        loop {
            for config in &configs {
                match zenoh::open(config.clone()).wait() {
                    Ok(session) => return Ok(session),
                    Err(why) if reported.is_none_or(|reported| reported.elapsed() >= REPORT_PERIOD) => {
                        reported = Some(Instant::now());
                        tracing::warn!(
                            "{}: no connection ({}); {how}. Look whether the base runs and is reached at this address and port, and \
                             whether this machine's key is of its fleet",
                            self.endpoint,
                            plain_reason(&why.to_string())
                        );
                    }
                    Err(_) => {}
                }
            }
            configs[0] = self.to_zenoh(PROTOCOLS_MS[0])?;
            std::thread::sleep(PROTOCOLS_PAUSE);
        }
    }

    fn listens(&self) -> bool {
        matches!(self.role, SessionRole::Base | SessionRole::Router)
    }

    /// `connect_ms`: time for which it tries to connect, milliseconds, or [`WITHOUT_END`].
    fn to_zenoh(&self, connect_ms: i64) -> Result<zenoh::Config, SessionError> {
        let mut config = zenoh::Config::default();
        for (key, value) in self.values(connect_ms) {
            config.insert_json5(key, &value.to_string()).map_err(failed(key))?;
        }
        Ok(config)
    }

    /// Returns the settings as a configuration file of `zenohd`.
    pub fn to_json(&self) -> String {
        let mut file = json!({});
        for (key, value) in self.values(WITHOUT_END) {
            let names = key.split('/');
            *names.fold(&mut file, |table, name| &mut table[name]) = value;
        }
        format!("{file:#}\n")
    }

    fn values(&self, connect_ms: i64) -> Vec<(&'static str, Value)> {
        let endpoints = self.endpoints();
        let protocols: Vec<&str> = endpoints.iter().map(|endpoint| endpoint.protocol.name()).collect();
        let endpoints: Vec<String> = endpoints.iter().map(zenoh_endpoint).collect();
        let (listen, connect) = if self.listens() { (endpoints, vec![]) } else { (vec![], endpoints) };
        let mut values = vec![
            ("mode", json!(self.role.mode())),
            ("listen/endpoints", json!(listen)),
            ("connect/endpoints", json!(connect)),
            ("connect/timeout_ms", json!(connect_ms)),
            ("connect/exit_on_failure", json!(false)),
            ("connect/retry", json!({ "period_init_ms": RETRY_MS[0], "period_max_ms": RETRY_MS[1] })),
            ("open/return_conditions/connect_scouted", json!(false)),
            // Robots and base find each other by configuration alone.
            ("scouting/multicast/enabled", json!(false)),
            ("scouting/gossip/enabled", json!(false)),
            ("transport/link/protocols", json!(protocols)),
            ("transport/unicast/open_timeout", json!(OPEN_MS)),
            ("transport/unicast/accept_timeout", json!(OPEN_MS)),
            ("transport/link/tx/lease", json!(LEASE_MS)),
            ("transport/link/tx/batch_size", json!(BATCH_BYTES)),
        ];
        if let Some(keys) = &self.keys {
            values.push(("transport/link/tls", tls(keys)));
            values.push(("access_control", self.access_control()));
        }
        values
    }

    /// Returns where it listens, or what it connects to. Where it listens by QUIC it does by TLS at the same port, too, for robots
    /// whose network lets no UDP through.
    fn endpoints(&self) -> Vec<Endpoint> {
        let mut endpoints = vec![self.endpoint.clone()];
        if self.listens() && self.endpoint.protocol == Protocol::Quic {
            endpoints.push(self.endpoint.with_protocol(Protocol::Tls));
        }
        endpoints
    }

    /// Returns the access list: at the base and at a router each robot's key has its own key expressions, on a robot the keys
    /// of base and router alone may speak to it. Nothing else is let through.
    fn access_control(&self) -> Value {
        let (mut rules, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
        for robot in &self.robots {
            // Neighbours whose messages of one direction are received, and who get those of the other.
            let (of_robot, of_base): (Vec<String>, Vec<&str>) = match self.role {
                SessionRole::Robot => (Vec::new(), vec![BASE_SUBJECT, ROUTER_SUBJECT]),
                SessionRole::Base => (vec![robot_subject(robot)], Vec::new()),
                SessionRole::BaseBehindRouter => (vec![ROUTER_SUBJECT.to_owned()], Vec::new()),
                SessionRole::Router => (vec![robot_subject(robot)], vec![BASE_SUBJECT]),
            };
            let neighbours = [
                (json!(of_robot), Direction::Up, Direction::Down),
                (json!(of_base), Direction::Down, Direction::Up),
            ];
            for (names, received, sent) in neighbours {
                if names.as_array().is_none_or(Vec::is_empty) {
                    continue;
                }
                let subject = format!("{robot} {}", received.name());
                let ids =
                    ["receive", "subscribe", "send", "be asked for"].map(|what| format!("{what} {subject}"));
                let (received, sent) = (keys(robot, received), keys(robot, sent));
                rules.extend([
                    rule(&ids[0], "ingress", "put", &received),
                    rule(&ids[1], "egress", "declare_subscriber", &received),
                    rule(&ids[2], "egress", "put", &sent),
                    rule(&ids[3], "ingress", "declare_subscriber", &sent),
                ]);
                subjects.push(json!({ "id": subject, "cert_common_names": names }));
                policies.push(json!({ "rules": ids, "subjects": [subject] }));
            }
        }
        json!({
            "enabled": true,
            "default_permission": "deny",
            "rules": rules,
            "subjects": subjects,
            "policies": policies,
        })
    }
}

/// Returns an endpoint as Zenoh reads it.
fn zenoh_endpoint(endpoint: &Endpoint) -> String {
    match endpoint.protocol {
        // Each priority has a stream of its own. QUIC bounds what waits at 1.25 MB a stream; of maps 16 kB are on their way.
        Protocol::Quic => endpoint.to_string(),
        // A small buffer of the socket: what waits there cannot be overtaken.
        Protocol::Tls | Protocol::Tcp => format!("{endpoint}#so_sndbuf={SOCKET_BYTES}"),
    }
}

fn rule(id: &str, flow: &str, message: &str, key: &str) -> Value {
    json!({ "id": id, "permission": "allow", "flows": [flow], "messages": [message], "key_exprs": [key] })
}

/// Returns the settings by which both sides show a certificate of the authority.
fn tls(keys: &KeyFiles) -> Value {
    json!({
        "root_ca_certificate": keys.authority,
        "listen_private_key": keys.private_key,
        "listen_certificate": keys.certificate,
        "connect_private_key": keys.private_key,
        "connect_certificate": keys.certificate,
        "enable_mtls": true,
        // The base is known by its key, whatever its address is: the access list checks the name in the certificate.
        "verify_name_on_connect": false,
        "close_link_on_expiration": true,
    })
}

/// Messages that were received, oldest first.
#[derive(Debug, Default)]
struct Inbox {
    messages: VecDeque<(usize, Vec<u8>)>,
    /// Names that are no robot's here.
    unknown: Vec<String>,
    dropped: u64,
}

impl Inbox {
    fn push_unknown(&mut self, name: &str) {
        if self.unknown.len() < link::UNKNOWN_NAMES_MAX && self.unknown.iter().all(|other| other != name) {
            self.unknown.push(name.to_owned());
        }
    }

    fn push(&mut self, robot: usize, bytes: Vec<u8>) {
        if self.messages.len() == WAITING_MAX {
            self.messages.pop_front();
            self.dropped += 1;
        }
        self.messages.push_back((robot, bytes));
    }
}

/// Carries messages over a Zenoh session.
pub struct ZenohTransport {
    /// Publishers of each robot, by [`Priority`].
    publishers: Vec<[Publisher<'static>; Priority::ALL.len()]>,
    inbox: Arc<Mutex<Inbox>>,
    _subscribers: Vec<Subscriber<()>>,
    // Dropped last: it closes the connection.
    _session: zenoh::Session,
}

impl ZenohTransport {
    /// Opens a session and declares the key expressions of its robots. A machine that connects waits until it has.
    pub fn open(config: &SessionConfig) -> Result<Self, SessionError> {
        let session = config.open()?;
        let (out, back) = match config.role {
            SessionRole::Robot => (Direction::Up, Direction::Down),
            _ => (Direction::Down, Direction::Up),
        };
        let inbox: Arc<Mutex<Inbox>> = Arc::default();
        let (mut publishers, mut subscribers) = (Vec::new(), Vec::new());
        for (index, robot) in config.robots.iter().enumerate() {
            let [command, pose, map, scan] =
                Priority::ALL.map(|priority| declare(&session, robot, out, priority));
            publishers.push([command?, pose?, map?, scan?]);
            let inbox = inbox.clone();
            let receive = move |sample: zenoh::sample::Sample| {
                let bytes = sample.payload().to_bytes();
                // Larger ones are no messages of this format.
                if bytes.len() <= link::wire::MESSAGE_MAX {
                    inbox.lock().unwrap_or_else(PoisonError::into_inner).push(index, bytes.into_owned());
                }
            };
            let subscriber = session.declare_subscriber(keys(robot, back)).callback(receive).wait();
            subscribers.push(subscriber.map_err(failed("cannot subscribe"))?);
        }
        // With keys the access list refuses such machines, and the log names them.
        if matches!(config.role, SessionRole::Base | SessionRole::BaseBehindRouter) && config.keys.is_none() {
            let (inbox, robots) = (inbox.clone(), config.robots.clone());
            let receive = move |sample: zenoh::sample::Sample| {
                let Some(name) = robot_of_key(sample.key_expr().as_str()) else { return };
                if robots.iter().all(|robot| robot != name) {
                    inbox.lock().unwrap_or_else(PoisonError::into_inner).push_unknown(name);
                }
            };
            let subscriber = session.declare_subscriber(all_robots_key()).callback(receive).wait();
            subscribers.push(subscriber.map_err(failed("cannot subscribe"))?);
        }
        Ok(Self { publishers, inbox, _subscribers: subscribers, _session: session })
    }

    /// Returns the number of received messages that were dropped because the loop was slow.
    pub fn dropped(&self) -> u64 {
        self.inbox.lock().unwrap_or_else(PoisonError::into_inner).dropped
    }
}

/// A router between robots and base, until it is dropped.
pub struct Router {
    _session: zenoh::Session,
}

impl Router {
    /// Listens for robots and base.
    pub fn open(config: &SessionConfig) -> Result<Self, SessionError> {
        Ok(Self { _session: config.open()? })
    }
}

fn declare(
    session: &zenoh::Session,
    robot: &str,
    direction: Direction,
    priority: Priority,
) -> Result<Publisher<'static>, SessionError> {
    let zenoh_priority = match priority {
        Priority::Command => ZenohPriority::RealTime,
        Priority::Pose => ZenohPriority::DataHigh,
        Priority::Map => ZenohPriority::DataLow,
        Priority::Scan => ZenohPriority::Background,
    };
    session
        .declare_publisher(key(robot, direction, priority))
        .congestion_control(CongestionControl::Drop)
        .priority(zenoh_priority)
        // A velocity does not wait for others to fill a packet.
        .express(priority == Priority::Command)
        .wait()
        .map_err(failed("cannot publish"))
}

impl Transport for ZenohTransport {
    fn send(&mut self, robot: usize, kind: Kind, bytes: &[u8]) {
        if let Some(publishers) = self.publishers.get(robot) {
            // What is lost is sent again, or superseded.
            let _ = publishers[kind.row().priority as usize].put(bytes).wait();
        }
    }

    fn receive(&mut self) -> Option<(usize, Vec<u8>)> {
        self.inbox.lock().unwrap_or_else(PoisonError::into_inner).messages.pop_front()
    }

    fn receive_unknown_name(&mut self) -> Option<String> {
        self.inbox.lock().unwrap_or_else(PoisonError::into_inner).unknown.pop()
    }
}

#[cfg(test)]
mod tests;
