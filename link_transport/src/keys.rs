//! Keys of the machines of a fleet: an authority, and a certificate with its private key for the base, for each robot, and for a
//! router between them.
//!
//! All are PEM files below one folder. Folders `base`, `router` and
//! `robots/NAME` have all that their machine needs; the authority's private key stays where it was created.

use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer,
    KeyPair, KeyUsagePurpose,
};
use ros_messages::RobotNames;
use std::fs::{self, DirBuilder, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// Name in the base's certificate.
pub const BASE_SUBJECT: &str = "base";
/// Name in a router's certificate.
pub const ROUTER_SUBJECT: &str = "router";
/// Name in the authority's certificate.
const AUTHORITY_SUBJECT: &str = "MR-SLAM authority";
/// Certificate of the authority: every machine has it.
const AUTHORITY: &str = "authority.pem";
/// Private key of the authority.
const AUTHORITY_KEY: &str = "authority.key.pem";
const CERTIFICATE: &str = "certificate.pem";
const PRIVATE_KEY: &str = "key.pem";
/// Largest file that is read, bytes.
const BYTES_MAX: u64 = 64 << 10;

/// Returns the name in a robot's certificate.
pub fn robot_subject(name: &str) -> String {
    format!("robot {name}")
}

/// Machine that a key is for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum KeyOwner {
    /// The base, wherever it runs.
    Base,
    /// A router between robots and base.
    Router,
    /// The robot of this name.
    Robot(String),
}

impl KeyOwner {
    fn subject(&self) -> String {
        match self {
            Self::Base => BASE_SUBJECT.into(),
            Self::Router => ROUTER_SUBJECT.into(),
            Self::Robot(name) => robot_subject(name),
        }
    }

    /// Returns the owner's folder below the folder of all keys.
    pub fn folder(&self, keys: &Path) -> PathBuf {
        match self {
            Self::Base => keys.join("base"),
            Self::Router => keys.join("router"),
            // A name such as lab/bob is one folder.
            Self::Robot(name) => keys.join("robots").join(name.replace('/', "__")),
        }
    }
}

/// Why there are no keys.
#[derive(Debug, thiserror::Error)]
pub enum KeysError {
    /// A file or folder cannot be read or written.
    #[error("{path}: {why}")]
    File {
        /// Path of the file.
        path: PathBuf,
        /// What the system answered.
        why: io::Error,
    },
    /// There is no authority to sign with.
    #[error("{0}: there is no authority; create one with `mr-slam keys authority`")]
    NoAuthority(PathBuf),
    /// A key exists and is not replaced.
    #[error("{0} exists; remove it first if its owner is to get another key")]
    Exists(PathBuf),
    /// A machine has no key.
    #[error(
        "{0}: there is no key for this machine; create it where the authority is (`mr-slam keys robot NAME`, `mr-slam keys \
         base`) and copy its folder here, or name another with --keys"
    )]
    NoKey(PathBuf),
    /// Others can read a private key.
    #[error("{path}: its mode is {mode:o}, so that others can read the private key; run `chmod 600` on it")]
    Readable {
        /// Path of the private key.
        path: PathBuf,
        /// Mode of the file.
        mode: u32,
    },
    /// A name is not that of a robot.
    #[error("`{0}` is no robot's name; expected letters, digits, _ and /, such as alice or lab/bob")]
    Name(String),
    /// A key or certificate cannot be created.
    #[error("a key cannot be created: {0}")]
    Creation(#[from] rcgen::Error),
}

fn at(path: &Path) -> impl FnOnce(io::Error) -> KeysError + '_ {
    move |why| KeysError::File { path: path.into(), why }
}

/// Files of one machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyFiles {
    /// Certificate of the authority.
    pub authority: PathBuf,
    /// Certificate of the machine.
    pub certificate: PathBuf,
    /// Private key of the machine.
    pub private_key: PathBuf,
}

impl KeyFiles {
    /// Finds the files in a machine's folder, and checks that nobody else can read the private key.
    pub fn find(folder: &Path) -> Result<Self, KeysError> {
        let [authority, certificate, private_key] =
            [AUTHORITY, CERTIFICATE, PRIVATE_KEY].map(|name| folder.join(name));
        for path in [&authority, &certificate, &private_key] {
            if !path.is_file() {
                return Err(KeysError::NoKey(path.clone()));
            }
        }
        let mode = fs::metadata(&private_key).map_err(at(&private_key))?.permissions().mode() & 0o777;
        if mode & 0o077 != 0 {
            return Err(KeysError::Readable { path: private_key, mode });
        }
        Ok(Self { authority, certificate, private_key })
    }
}

/// Creates the authority in a folder of keys.
pub fn create_authority(keys: &Path) -> Result<PathBuf, KeysError> {
    let key = KeyPair::generate()?;
    let certificate = authority_params()?.self_signed(&key)?;
    create_folder(keys)?;
    write_new(&keys.join(AUTHORITY_KEY), &key.serialize_pem(), 0o600)?;
    let path = keys.join(AUTHORITY);
    write_new(&path, &certificate.pem(), 0o644)?;
    Ok(path)
}

/// Creates the key of a machine, signed by the authority; returns the folder to copy to that machine.
pub fn create_key(keys: &Path, owner: &KeyOwner) -> Result<PathBuf, KeysError> {
    if let KeyOwner::Robot(name) = owner
        && (name.is_empty() || RobotNames::new(vec![name.clone()]).is_err())
    {
        return Err(KeysError::Name(name.clone()));
    }
    let (authority, authority_key) = (keys.join(AUTHORITY), keys.join(AUTHORITY_KEY));
    if !authority.is_file() || !authority_key.is_file() {
        return Err(KeysError::NoAuthority(keys.into()));
    }
    let read = |path: &Path| formats::limited::read_text(path, BYTES_MAX).map_err(at(path));
    let issuer_key = KeyPair::from_pem(&read(&authority_key)?)?;
    let issuer = Issuer::new(authority_params()?, issuer_key);
    let mut params = CertificateParams::new(vec!["mr-slam".to_owned()])?;
    params.distinguished_name = name(&owner.subject());
    params.use_authority_key_identifier_extension = true;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    // A robot's key cannot be a base's or a router's: it is not one of a server.
    params.extended_key_usages = match owner {
        KeyOwner::Base | KeyOwner::Router => {
            vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth]
        }
        KeyOwner::Robot(_) => vec![ExtendedKeyUsagePurpose::ClientAuth],
    };
    let key = KeyPair::generate()?;
    let certificate = params.signed_by(&key, &issuer)?;
    let folder = owner.folder(keys);
    create_folder(&folder)?;
    write_new(&folder.join(PRIVATE_KEY), &key.serialize_pem(), 0o600)?;
    write_new(&folder.join(CERTIFICATE), &certificate.pem(), 0o644)?;
    write_new(&folder.join(AUTHORITY), &read(&authority)?, 0o644)?;
    Ok(folder)
}

fn authority_params() -> Result<CertificateParams, rcgen::Error> {
    let mut params = CertificateParams::new(Vec::new())?;
    params.distinguished_name = name(AUTHORITY_SUBJECT);
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    Ok(params)
}

fn name(subject: &str) -> DistinguishedName {
    let mut name = DistinguishedName::new();
    name.push(DnType::CommonName, subject);
    name
}

fn create_folder(path: &Path) -> Result<(), KeysError> {
    DirBuilder::new().recursive(true).mode(0o700).create(path).map_err(at(path))
}

/// Writes a file that must not exist. On a full disk it does not exist afterwards either.
fn write_new(path: &Path, text: &str, mode: u32) -> Result<(), KeysError> {
    let mut file = match OpenOptions::new().write(true).create_new(true).mode(mode).open(path) {
        Err(why) if why.kind() == io::ErrorKind::AlreadyExists => return Err(KeysError::Exists(path.into())),
        opened => opened.map_err(at(path))?,
    };
    let written = file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
    written.inspect_err(|_| drop(std::fs::remove_file(path))).map_err(at(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_machine_gets_a_folder_of_its_own_and_nothing_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let keys = folder.path().join("keys");
        let alice = KeyOwner::Robot("lab/alice".into());
        let why = create_key(&keys, &alice).unwrap_err().to_string();
        assert!(why.contains("mr-slam keys authority"), "{why}");
        create_authority(&keys).unwrap();
        let machine = create_key(&keys, &alice).unwrap();
        assert_eq!(machine, keys.join("robots/lab__alice"));
        let files = KeyFiles::find(&machine).unwrap();
        assert!(!machine.join(AUTHORITY_KEY).exists(), "a robot cannot sign");
        assert!(matches!(create_key(&keys, &alice), Err(KeysError::Exists(_))));
        assert!(matches!(create_authority(&keys), Err(KeysError::Exists(_))));
        assert!(matches!(create_key(&keys, &KeyOwner::Robot("../x".into())), Err(KeysError::Name(_))));
        fs::set_permissions(&files.private_key, fs::Permissions::from_mode(0o644)).unwrap();
        assert!(matches!(KeyFiles::find(&machine), Err(KeysError::Readable { mode: 0o644, .. })));
        fs::remove_file(&files.certificate).unwrap();
        assert!(matches!(KeyFiles::find(&machine), Err(KeysError::NoKey(_))));
    }
}
