//! File of the addresses that may drive in later runs, so that a headset is allowed once.
//!
//! A person may edit it: one address a line, `#` begins a comment. It is `$XDG_STATE_HOME/mr-slam/allowed`, otherwise
//! `~/.local/state/mr-slam/allowed`, otherwise `allowed` in the run's folder.

use crate::run::Run;
use crate::storage::Storage;
use ::bridge::ADDRESSES_MAX;
use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};

/// Largest file that is read, bytes: more than [`ADDRESSES_MAX`] addresses need.
const BYTES_MAX: u64 = 64 << 10;

/// Returns the path of the file.
pub fn file(run: &Run) -> PathBuf {
    state_folder().unwrap_or_else(|| run.dir.clone()).join("allowed")
}

/// Returns the folder of what is kept from run to run, or `None` if the user has no home.
pub fn state_folder() -> Option<PathBuf> {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let state = absolute("XDG_STATE_HOME").or_else(|| Some(absolute("HOME")?.join(".local/state")));
    state.map(|state| state.join("mr-slam"))
}

/// Reads the addresses, oldest first, and the lines that are no addresses. A missing file has none.
pub fn read(storage: &impl Storage, path: &Path) -> io::Result<(Vec<IpAddr>, Vec<String>)> {
    let bytes = match storage.read(path, BYTES_MAX) {
        Ok(bytes) => bytes,
        Err(why) if why.kind() == io::ErrorKind::NotFound => return Ok(Default::default()),
        Err(why) => return Err(why),
    };
    // What is no text is among the lines that are no addresses.
    let text = String::from_utf8_lossy(&bytes);
    let (mut addresses, mut unsound) = (Vec::new(), Vec::new());
    for line in text.lines() {
        let word = line.split('#').next().unwrap_or_default().trim();
        match bridge::parse_peer_address(word) {
            Ok(address) => addresses.push(address),
            Err(_) if word.is_empty() => {}
            Err(_) => unsound.push(line.to_owned()),
        }
    }
    Ok((addresses, unsound))
}

/// Adds an address to the file or removes it, atomically.
///
/// # Errors
/// The file cannot be read or written, or has as many addresses as it may: none is dropped for another one.
pub fn remember(storage: &impl Storage, path: &Path, address: IpAddr, is_listed: bool) -> io::Result<()> {
    let address = address.to_canonical();
    let (mut addresses, _) = read(storage, path)?;
    addresses.retain(|known| *known != address);
    if is_listed {
        if addresses.len() >= ADDRESSES_MAX {
            return Err(io::Error::other(format!(
                "has {ADDRESSES_MAX} addresses, the limit, and {address} is not added: delete lines that are not needed any more"
            )));
        }
        addresses.push(address);
    }
    let mut text = String::from(
        "# Addresses that may drive a fleet on this machine; see `mr-slam allow` and `mr-slam deny`.\n",
    );
    for address in addresses {
        text += &format!("{address}\n");
    }
    storage.replace(path, text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::storage::DiskStorage;

    #[test]
    fn a_full_file_keeps_its_addresses_and_the_file_may_be_edited() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/allowed");
        assert_eq!(read(&DiskStorage, &path).unwrap().0, Vec::<IpAddr>::new());
        let address = |i: usize| IpAddr::from([10, 0, (i / 256) as u8, (i % 256) as u8]);
        let lines: String = (0..ADDRESSES_MAX).map(|i| format!("{}\n", address(i))).collect();
        DiskStorage.replace(&path, lines.as_bytes()).unwrap();
        let more = address(ADDRESSES_MAX);
        let error = remember(&DiskStorage, &path, more, true).unwrap_err().to_string();
        assert!(
            error.contains("1024 addresses, the limit") && error.contains("10.0.4.0 is not added"),
            "{error}"
        );
        remember(&DiskStorage, &path, address(20), true).unwrap();
        assert_eq!(read(&DiskStorage, &path).unwrap().0.len(), ADDRESSES_MAX);
        remember(&DiskStorage, &path, address(30), false).unwrap();
        remember(&DiskStorage, &path, "::ffff:10.0.0.40".parse().unwrap(), false).unwrap();
        remember(&DiskStorage, &path, more, true).unwrap();
        let (addresses, _) = read(&DiskStorage, &path).unwrap();
        assert_eq!(addresses.len(), ADDRESSES_MAX - 1);
        assert_eq!((addresses[0], *addresses.last().unwrap()), (address(0), more));
        assert!(!addresses.contains(&address(30)) && !addresses.contains(&address(40)));

        std::fs::write(&path, "# the lab's\n192.168.1.7  # Ana's headset\nnonsense\n\n").unwrap();
        let (addresses, unsound) = read(&DiskStorage, &path).unwrap();
        assert_eq!(addresses, ["192.168.1.7".parse::<IpAddr>().unwrap()]);
        assert_eq!(unsound, ["nonsense"]);
    }
}
