//! The certificate of the operator's page: the one that is configured, or a self-signed one.
//!
//! The own one is kept in `$XDG_STATE_HOME/mr-slam/certificate.pem`, otherwise in `~/.local/state/mr-slam/certificate.pem`, with
//! its private key, so that a browser's exception for it and a headset's anchors hold from run to run.

use crate::allowed;
use bridge::{HttpsConfig, TlsAcceptor, TlsError, tls_acceptor};
use rcgen::{CertificateParams, DistinguishedName, DnType, KeyPair};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Ipv6Addr};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Largest certificate with its chain, or private key, bytes.
const BYTES_MAX: u64 = 256 << 10;
/// Name in the own certificate.
const NAME: &str = "MR-SLAM on this machine";

/// Why there is no certificate.
#[derive(Debug, Error)]
pub enum CertificateError {
    /// Neither `XDG_STATE_HOME` nor `HOME` is set.
    #[error("no folder to keep a certificate in: set HOME, or name one with bridge.page.https.certificate")]
    NoFolder,
    /// A file cannot be read or written.
    #[error("{path}: {why}")]
    File {
        /// Path of the file.
        path: PathBuf,
        /// What the system answered.
        why: io::Error,
    },
    /// The files are no certificate with its key.
    #[error("{path}: {why}")]
    Unusable {
        /// Path of the certificate.
        path: PathBuf,
        /// What is wrong.
        why: TlsError,
    },
    /// The own certificate cannot be made.
    #[error("a certificate cannot be created: {0}")]
    Creation(#[from] rcgen::Error),
}

/// Loads the certificate of a configuration, and creates the own one at the first time.
pub fn load(config: &HttpsConfig) -> Result<TlsAcceptor, CertificateError> {
    if config.has_own_certificate() {
        let (certificate, key) = (read(&config.certificate)?, read(&config.private_key)?);
        return tls_acceptor(&certificate, &key)
            .map_err(|why| CertificateError::Unusable { path: config.certificate.clone(), why });
    }
    let path = allowed::state_folder().ok_or(CertificateError::NoFolder)?.join("certificate.pem");
    load_or_create(&path)
}

/// Loads the own certificate with its key from one file; creates it if there is none, or none that can be used.
fn load_or_create(path: &Path) -> Result<TlsAcceptor, CertificateError> {
    match read(path).map(|pem| tls_acceptor(&pem, &pem)) {
        Ok(Ok(acceptor)) => return Ok(acceptor),
        // A file that was cut off by a full disk is replaced.
        Ok(Err(_)) => {}
        Err(CertificateError::File { why, .. }) if why.kind() == io::ErrorKind::NotFound => {}
        // It may be whole: browsers trust it.
        Err(why) => return Err(why),
    }
    let pem = create()?;
    write_private(path, pem.as_bytes())
        .map_err(|why| CertificateError::File { path: path.to_owned(), why })?;
    tls_acceptor(pem.as_bytes(), pem.as_bytes())
        .map_err(|why| CertificateError::Unusable { path: path.to_owned(), why })
}

fn read(path: &Path) -> Result<Vec<u8>, CertificateError> {
    let wrong = |why| CertificateError::File { path: path.to_owned(), why };
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(wrong)?;
    file.take(BYTES_MAX + 1).read_to_end(&mut bytes).map_err(wrong)?;
    if bytes.len() as u64 > BYTES_MAX {
        return Err(wrong(io::Error::other(format!("is larger than {} kB", BYTES_MAX >> 10))));
    }
    Ok(bytes)
}

/// Creates a certificate that signs itself, with its key, in PEM. It vouches for no other certificate.
fn create() -> Result<String, CertificateError> {
    let key = KeyPair::generate()?;
    let names = ["localhost".to_owned(), Ipv4Addr::LOCALHOST.to_string(), Ipv6Addr::LOCALHOST.to_string()];
    let mut params = CertificateParams::new(names)?;
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, NAME);
    let certificate = params.self_signed(&key)?;
    Ok(certificate.pem() + &key.serialize_pem())
}

/// Writes a file that only this user may read. At any moment it is the old one or the new one.
fn write_private(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    let part = path.with_extension(format!("pem.{}", std::process::id()));
    let write = || {
        let mut file = OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(&part)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&part, path)
    };
    write().inspect_err(|_| drop(fs::remove_file(&part)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn the_own_certificate_is_kept_and_nobody_else_reads_its_key() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mr-slam/certificate.pem");
        load_or_create(&path).unwrap();
        let first = fs::read(&path).unwrap();
        load_or_create(&path).unwrap();
        assert_eq!(fs::read(&path).unwrap(), first, "a browser's exception would end with each run");
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1, "nothing is left over");
        fs::write(&path, &first[..first.len() / 2]).unwrap();
        load_or_create(&path).unwrap();
        assert_ne!(fs::read(&path).unwrap(), first, "half a file is replaced");

        fs::write(&path, vec![b' '; BYTES_MAX as usize + 1]).unwrap();
        assert!(load_or_create(&path).is_err());
        assert_eq!(fs::metadata(&path).unwrap().len(), BYTES_MAX + 1, "what cannot be read is left as it is");
    }

    #[test]
    fn a_given_certificate_is_used_or_refused_with_its_path() {
        let folder = tempfile::tempdir().unwrap();
        let (certificate, key) = (folder.path().join("c.pem"), folder.path().join("k.pem"));
        let pem = create().unwrap();
        let (first, second) = pem.split_at(pem.find("-----BEGIN PRIVATE").unwrap());
        fs::write(&certificate, first).unwrap();
        fs::write(&key, second).unwrap();
        let config = |certificate: &Path, private_key: &Path| HttpsConfig {
            certificate: certificate.into(),
            private_key: private_key.into(),
            ..HttpsConfig::default()
        };
        load(&config(&certificate, &key)).unwrap();
        let swapped = load(&config(&key, &certificate)).err().unwrap().to_string();
        assert!(swapped.contains("k.pem") && swapped.contains("certificate"), "{swapped}");
        let missing = load(&config(&folder.path().join("none.pem"), &key)).err().unwrap().to_string();
        assert!(missing.contains("none.pem"), "{missing}");
        fs::write(&key, create().unwrap().split_at(first.len()).1).unwrap();
        assert!(load(&config(&certificate, &key)).is_err(), "the key of another certificate");
    }
}
