//! Which ROS 2 nodes are found: the fleet file's settings, and ROS 2's own environment variables where it leaves them open.

use super::DdsConfig;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Variable of the domain.
const DOMAIN_ID: &str = "ROS_DOMAIN_ID";
/// Variable of how far nodes are looked for.
const DISCOVERY_RANGE: &str = "ROS_AUTOMATIC_DISCOVERY_RANGE";
/// Variable of addresses where nodes are looked for, too.
const STATIC_PEERS: &str = "ROS_STATIC_PEERS";
/// Variable that ROS 2 still honours: nodes on this machine alone.
const LOCALHOST_ONLY: &str = "ROS_LOCALHOST_ONLY";

/// The highest domain whose UDP ports exist (RTPS 2.5, 9.6.1.1).
pub(super) const DOMAIN_MAX: u16 = 232;

/// A setting of the fleet file, or `"environment"`: as ROS 2's environment variables say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected \"environment\", or a number or true or false without quotes")]
pub enum OrEnvironment<T> {
    /// `"environment"`: the variables decide.
    #[default]
    #[serde(with = "environment")]
    Environment,
    /// The fleet file's own setting.
    Value(T),
}

impl<T> From<T> for OrEnvironment<T> {
    fn from(value: T) -> Self {
        Self::Value(value)
    }
}

impl<T: Copy> OrEnvironment<T> {
    /// Returns the setting; `None` if it is left to the environment.
    pub fn value(&self) -> Option<T> {
        match self {
            Self::Environment => None,
            Self::Value(value) => Some(*value),
        }
    }
}

/// The word for [`OrEnvironment::Environment`] in a file.
mod environment {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    const WORD: &str = "environment";

    pub fn serialize<S: Serializer>(to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(WORD)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<(), D::Error> {
        let word = String::deserialize(from)?;
        if word == WORD { Ok(()) } else { Err(D::Error::custom("expected \"environment\" or a value")) }
    }
}

/// The values of ROS 2's environment variables for discovery. An empty value counts as none, as in ROS 2.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DiscoveryVariables {
    domain_id: Option<String>,
    range: Option<String>,
    static_peers: Option<String>,
    localhost_only: Option<String>,
}

impl DiscoveryVariables {
    /// Reads the variables. `get` returns the value of a variable, if it is set.
    pub fn new(get: impl Fn(&str) -> Option<String>) -> Self {
        let get = |name| get(name).filter(|value: &String| !value.is_empty());
        Self {
            domain_id: get(DOMAIN_ID),
            range: get(DISCOVERY_RANGE),
            static_peers: get(STATIC_PEERS),
            localhost_only: get(LOCALHOST_ONLY),
        }
    }
}

/// Why the environment's variables cannot be obeyed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DiscoveryError {
    /// The domain is not a number of a domain.
    #[error("ROS_DOMAIN_ID is '{value}': expected 0 to {DOMAIN_MAX}; set it, or give --ros-domain")]
    Domain {
        /// The variable's value.
        value: String,
    },
    /// No node shall be found.
    #[error(
        "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF: the fleet would find no ROS 2 node. Leave ROS 2 out (no --ros-domain, \
         bridge.dds.enabled = false), or set the variable to LOCALHOST or SUBNET"
    )]
    Off,
    /// Peers are named that are not on this machine.
    #[error(
        "ROS_STATIC_PEERS is '{peers}': the fleet's DDS library (RustDDS) cannot be told of peers. Start it without \
         (env -u ROS_STATIC_PEERS mr-slam ...). ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET finds nodes in the same subnet; \
         bring others there with a VPN or zenoh-bridge-ros2dds"
    )]
    StaticPeers {
        /// The variable's value.
        peers: String,
    },
}

/// Which domain the endpoint joins, and which nodes it finds there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Discovery {
    /// Domain, 0 to 232.
    pub domain: u16,
    /// Whether only nodes on this machine are found.
    pub is_loopback_only: bool,
    /// What a person should know of the variables, as ROS 2 itself warns.
    pub warning: Option<String>,
}

impl Discovery {
    /// Decides as ROS 2 does (rcl): what the fleet file says comes before the variables.
    ///
    /// Where neither says anything, domain 0 is joined, as in ROS 2, and only this machine's nodes are found: ROS 2 would find
    /// the subnet's, which could then watch without being asked.
    pub fn new(config: &DdsConfig, variables: &DiscoveryVariables) -> Result<Self, DiscoveryError> {
        let domain = match (config.domain.value(), &variables.domain_id) {
            (Some(domain), _) => domain,
            (None, None) => 0,
            (None, Some(value)) => {
                let domain = value.trim().parse().ok().filter(|domain| *domain <= DOMAIN_MAX);
                domain.ok_or_else(|| DiscoveryError::Domain { value: value.clone() })?
            }
        };
        let of_file = config.loopback_only.value();
        if of_file.is_none() && variables.localhost_only.as_deref() == Some("1") {
            let warning = "ROS_LOCALHOST_ONLY=1: ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_STATIC_PEERS are ignored, as in ROS 2";
            let is_other_set = variables.range.is_some() || variables.static_peers.is_some();
            let warning = is_other_set.then(|| warning.to_owned());
            return Ok(Self { domain, is_loopback_only: true, warning });
        }
        let mut warning = None;
        let is_loopback_only = match (of_file, variables.range.as_deref()) {
            (Some(is_loopback_only), _) => is_loopback_only,
            (None, None | Some("NOT_SET" | "LOCALHOST")) => true,
            (None, Some("SUBNET" | "SYSTEM_DEFAULT")) => false,
            (None, Some("OFF")) => return Err(DiscoveryError::Off),
            (None, Some(other)) => {
                warning = Some(format!(
                    "ROS_AUTOMATIC_DISCOVERY_RANGE is '{other}', which is none of SUBNET, LOCALHOST, OFF and \
                     SYSTEM_DEFAULT: taken as LOCALHOST, as in ROS 2"
                ));
                true
            }
        };
        match &variables.static_peers {
            Some(peers) if !peers.split(';').all(is_this_machine) => {
                Err(DiscoveryError::StaticPeers { peers: peers.clone() })
            }
            _ => Ok(Self { domain, is_loopback_only, warning }),
        }
    }
}

/// Returns whether a static peer is this machine, whose nodes are found in any case.
fn is_this_machine(peer: &str) -> bool {
    let peer = peer.trim();
    let address = peer.parse::<std::net::IpAddr>();
    peer.is_empty() || peer == "localhost" || address.is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Domain and `loopback_only` of the file, the variables, and what is decided: domain and whether on loopback
    /// alone, or a part of the error's text.
    type Row<'a> = (Option<u16>, Option<bool>, &'a [(&'a str, &'a str)], Result<(u16, bool), &'a str>);

    fn decide(
        domain: Option<u16>,
        loopback_only: Option<bool>,
        variables: &[(&str, &str)],
    ) -> Result<Discovery, String> {
        let config = DdsConfig {
            domain: domain.map_or(OrEnvironment::Environment, OrEnvironment::Value),
            loopback_only: loopback_only.map_or(OrEnvironment::Environment, OrEnvironment::Value),
            ..DdsConfig::default()
        };
        let get =
            |name: &str| variables.iter().find(|(of, _)| *of == name).map(|(_, value)| (*value).to_owned());
        Discovery::new(&config, &DiscoveryVariables::new(get)).map_err(|error| error.to_string())
    }

    #[test]
    fn the_file_comes_before_the_variables_and_they_mean_what_they_mean_in_ros() {
        let range = |value| (DISCOVERY_RANGE, value);
        let (peer, here) = ((STATIC_PEERS, "192.168.1.7"), (STATIC_PEERS, "127.0.0.1;localhost;"));
        let only = (LOCALHOST_ONLY, "1");
        let table: &[Row<'_>] = &[
            (None, None, &[], Ok((0, true))),
            (None, None, &[(DOMAIN_ID, "")], Ok((0, true))),
            (None, None, &[(DOMAIN_ID, "42")], Ok((42, true))),
            (Some(7), None, &[(DOMAIN_ID, "42")], Ok((7, true))),
            (Some(7), None, &[(DOMAIN_ID, "many")], Ok((7, true))),
            (None, None, &[(DOMAIN_ID, "many")], Err("ROS_DOMAIN_ID is 'many'")),
            (None, None, &[(DOMAIN_ID, "233")], Err("expected 0 to 232")),
            (None, None, &[(DOMAIN_ID, "-1")], Err("expected 0 to 232")),
            (None, None, &[range("LOCALHOST")], Ok((0, true))),
            (None, None, &[range("SUBNET")], Ok((0, false))),
            (None, None, &[range("SYSTEM_DEFAULT")], Ok((0, false))),
            (None, None, &[range("NOT_SET")], Ok((0, true))),
            (None, None, &[range("subnet")], Ok((0, true))),
            (None, None, &[range("OFF")], Err("bridge.dds.enabled = false")),
            (None, Some(true), &[range("SUBNET")], Ok((0, true))),
            (None, Some(false), &[range("LOCALHOST")], Ok((0, false))),
            (None, Some(false), &[range("OFF")], Ok((0, false))),
            (None, None, &[only], Ok((0, true))),
            (None, None, &[only, range("SUBNET"), peer], Ok((0, true))),
            (None, None, &[only, range("OFF")], Ok((0, true))),
            (None, Some(false), &[only], Ok((0, false))),
            (None, Some(false), &[only, peer], Err("env -u ROS_STATIC_PEERS")),
            (None, None, &[(LOCALHOST_ONLY, "0"), range("SUBNET")], Ok((0, false))),
            (None, None, &[peer], Err("192.168.1.7")),
            (None, None, &[here], Ok((0, true))),
            (None, None, &[here, range("SUBNET")], Ok((0, false))),
        ];
        for (domain, loopback_only, variables, expected) in table {
            let decided = decide(*domain, *loopback_only, variables);
            let of = format!("{domain:?}, {loopback_only:?}, {variables:?}");
            match (expected, &decided) {
                (Ok(expected), Ok(found)) => {
                    assert_eq!((found.domain, found.is_loopback_only), *expected, "{of}")
                }
                (Err(part), Err(text)) => assert!(text.contains(part), "{of}: {text}"),
                _ => panic!("{of}: {decided:?}, expected {expected:?}"),
            }
        }
    }

    #[test]
    fn what_ros_warns_of_is_warned_of() {
        let warning = |variables: &[(&str, &str)]| decide(None, None, variables).unwrap().warning;
        assert!(warning(&[(DISCOVERY_RANGE, "subnet")]).unwrap().contains("'subnet'"));
        assert!(warning(&[(LOCALHOST_ONLY, "1"), (DISCOVERY_RANGE, "OFF")]).unwrap().contains("ignored"));
        assert_eq!(warning(&[(LOCALHOST_ONLY, "1")]), None);
    }

    #[test]
    fn a_setting_is_a_value_or_the_environment() {
        let read = |text: &str| serde_json::from_str::<DdsConfig>(text);
        assert_eq!(read("{}").unwrap().domain, OrEnvironment::Environment);
        let read = read(r#"{"domain": 5, "loopback_only": "environment"}"#).unwrap();
        assert_eq!((read.domain.value(), read.loopback_only.value()), (Some(5), None));
        assert!(serde_json::from_str::<DdsConfig>(r#"{"domain": "mine"}"#).is_err());
    }
}
