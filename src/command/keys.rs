//! Tool `mr-slam keys`, which creates the keys of a fleet on several machines.

use super::{Error, output};
use crate::allowed;
use link_transport::keys::{KeyOwner, create_authority, create_key};
use std::path::PathBuf;

/// Neither `XDG_STATE_HOME` nor `HOME` is set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no folder to keep keys in: set HOME, or name one with --keys")]
pub struct NoFolderError;

/// Returns the folder of all keys if none is named.
pub(super) fn default_folder() -> Result<PathBuf, NoFolderError> {
    Ok(allowed::state_folder().ok_or(NoFolderError)?.join("keys"))
}

/// Create the keys with which robots and base of several machines know each other
#[derive(Clone, Debug, clap::Args)]
pub struct KeysArgs {
    /// Key to create.
    #[command(subcommand)]
    pub key: Key,
    /// Folder of all keys [default: ~/.local/state/mr-slam/keys]
    #[arg(long, value_name = "DIR", global = true)]
    pub keys: Option<PathBuf>,
}

/// Key to create.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Key {
    /// Create the authority that signs all others; do this first and once
    Authority,
    /// Create the key of the base
    Base,
    /// Create the key of a router between robots and base
    Router,
    /// Create the key of a robot
    Robot {
        /// Name of the robot, such as alice
        name: String,
    },
}

/// Creates a key and says what to do with it.
pub fn run(args: &KeysArgs) -> Result<(), Error> {
    let keys = args.keys.clone().map_or_else(default_folder, Ok)?;
    let owner = match &args.key {
        Key::Authority => {
            let path = create_authority(&keys)?;
            output::print(&format!(
                "{}: the authority of your fleet; keep its folder secret\n",
                path.display()
            ))?;
            return Ok(());
        }
        Key::Base => KeyOwner::Base,
        Key::Router => KeyOwner::Router,
        Key::Robot { name } => KeyOwner::Robot(name.clone()),
    };
    let folder = create_key(&keys, &owner)?;
    let whose = match &owner {
        KeyOwner::Base => {
            "the base's key; where another machine is the base, copy this folder there".to_owned()
        }
        KeyOwner::Router => "the router's key; copy this folder to its machine".to_owned(),
        KeyOwner::Robot(name) => format!("{name}'s key; copy this folder to {name}'s computer"),
    };
    output::print(&format!("{}: {whose}\n", folder.display()))?;
    Ok(())
}
