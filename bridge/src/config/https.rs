//! The settings of HTTPS for the operator's page.

use super::ConfigError;
use serde::{Deserialize, Serialize};
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;

/// The table `bridge.page.https` of the fleet file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HttpsConfig {
    /// Whether the page is served encrypted too. Headsets offer mixed reality only over HTTPS, or from localhost.
    pub enabled: bool,
    /// Address to listen on; `0.0.0.0`: every interface. Who may watch and drive is the same as on TCP.
    pub address: IpAddr,
    /// TCP port, 0 to 65535. 0: any free port. If the port is taken, any free port is used.
    pub port: u16,
    /// PEM file of the certificate and those that vouch for it. Empty: one that signs itself, created at the first start
    /// and kept beside the addresses that may drive.
    pub certificate: PathBuf,
    /// PEM file of the certificate's private key; empty if and only if `certificate` is.
    pub private_key: PathBuf,
}

impl Default for HttpsConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            address: IpAddr::V4(Ipv4Addr::UNSPECIFIED),
            port: 8443,
            certificate: PathBuf::new(),
            private_key: PathBuf::new(),
        }
    }
}

impl HttpsConfig {
    /// Returns whether the files of a certificate are given.
    pub fn has_own_certificate(&self) -> bool {
        !self.certificate.as_os_str().is_empty()
    }

    /// Refuses a certificate without its key, and a key without its certificate; the error names the key.
    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        let has_key = !self.private_key.as_os_str().is_empty();
        if self.has_own_certificate() == has_key {
            return Ok(());
        }
        let missing = if has_key { "page.https.certificate" } else { "page.https.private_key" };
        Err(ConfigError::new(
            missing,
            "''".to_owned(),
            "a certificate and its private key are given together",
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_certificate_and_its_key_are_given_together() {
        let with = |certificate: &str, key: &str| HttpsConfig {
            certificate: certificate.into(),
            private_key: key.into(),
            ..HttpsConfig::default()
        };
        assert_eq!(with("", "").validate(), Ok(()));
        assert_eq!(with("a.pem", "b.pem").validate(), Ok(()));
        let error = with("a.pem", "").validate().unwrap_err().to_string();
        assert!(error.contains("bridge.page.https.private_key"), "{error}");
        let error = with("", "b.pem").validate().unwrap_err().to_string();
        assert!(error.contains("bridge.page.https.certificate"), "{error}");
    }
}
