//! The settings of the operator's page.

use super::{ConfigError, HttpsConfig};
use serde::{Deserialize, Serialize};
use std::net::{IpAddr, Ipv4Addr};

/// Most entries of `bridge.page.origins`.
const ORIGINS_MAX: usize = 64;

/// The table `bridge.page` of the fleet file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PageConfig {
    /// Whether the bridge serves the operator's page and the Foxglove protocol.
    pub enabled: bool,
    /// Address to listen on. Anything but loopback is reached without encryption: other machines may read along.
    pub address: IpAddr,
    /// TCP port, 0 to 65535. 0: any free port. If the port is taken, any free port is used.
    pub port: u16,
    /// Web pages of other origins that may connect, such as `https://app.foxglove.dev`; at most 64. The page of this
    /// port may always, and so may programs that are no browsers.
    pub origins: Vec<String>,
    /// The same page and protocol, encrypted.
    pub https: HttpsConfig,
}

impl Default for PageConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            port: 8080,
            origins: Vec::new(),
            https: HttpsConfig::default(),
        }
    }
}

impl PageConfig {
    /// Refuses values that cannot work; the error names the key.
    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        self.https.validate()?;
        if self.origins.len() > ORIGINS_MAX {
            return Err(ConfigError::new(
                "page.origins",
                self.origins.len().to_string(),
                "at most 64 origins work",
            ));
        }
        let is_origin = |origin: &&String| {
            let host = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
            host.is_some_and(|host| !host.is_empty() && !host.contains(['/', '*', ' ']))
        };
        match self.origins.iter().find(|origin| !is_origin(origin)) {
            Some(origin) => Err(ConfigError::new(
                "page.origins",
                format!("'{origin}'"),
                "expected an origin such as https://app.foxglove.dev, without a path",
            )),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_origin_is_a_scheme_and_a_host() {
        let with = |origin: &str| PageConfig { origins: vec![origin.into()], ..PageConfig::default() };
        assert_eq!(with("https://app.foxglove.dev").validate(), Ok(()));
        assert_eq!(with("http://localhost:3000").validate(), Ok(()));
        for wrong in ["*", "app.foxglove.dev", "https://", "https://a/b", "https://*.dev"] {
            let error = with(wrong).validate().unwrap_err().to_string();
            assert!(error.contains("bridge.page.origins"), "{error}");
        }
    }
}
