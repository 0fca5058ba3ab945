//! Tool `mr-slam headset`, which makes a headset on a cable reach the operator's page.

use super::output;
use std::io;
use std::process::{Command, Stdio};
use thiserror::Error;

/// Let a headset reach the operator's page
#[derive(Clone, Debug, clap::Args)]
pub struct HeadsetArgs {
    /// How the headset is connected.
    #[command(subcommand)]
    pub connection: Connection,
}

/// How the headset is connected.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Connection {
    /// By a USB cable: its browser's http://localhost:PORT becomes this machine's, with `adb reverse`
    Usb(UsbArgs),
}

/// Arguments of `headset usb`
#[derive(Clone, Debug, clap::Args)]
pub struct UsbArgs {
    /// TCP port of the operator's page, as `mr-slam up` prints it
    #[arg(long, value_name = "PORT", default_value_t = 8080)]
    pub port: u16,
    /// Serial number of the headset, if several devices are connected; `adb devices` lists them
    #[arg(long, value_name = "NUMBER")]
    pub serial: Option<String>,
}

/// Why the headset cannot reach the page.
#[derive(Debug, Error)]
pub enum HeadsetError {
    /// The program is not installed.
    #[error("adb is not installed; install Android's platform tools (Debian: apt install adb)")]
    NoAdb,
    /// The program cannot be started.
    #[error("adb cannot be started: {0}")]
    Start(io::Error),
    /// The program says what is wrong, as when no device is connected.
    #[error("adb: {0}; connect the headset, allow USB debugging in it, and see what `adb devices` lists")]
    Refused(String),
    /// The result cannot be printed.
    #[error(transparent)]
    Output(#[from] io::Error),
}

/// Runs `adb reverse`.
pub fn run(args: &HeadsetArgs) -> Result<(), HeadsetError> {
    let Connection::Usb(usb) = &args.connection;
    reverse("adb", usb)?;
    let url = format!("http://localhost:{}", usb.port);
    Ok(output::print(&format!("open {url} in the headset's browser, and press \"Mixed reality\"\n"))?)
}

/// Asks the program to forward the headset's port to the same port of this machine.
fn reverse(program: &str, UsbArgs { port, serial }: &UsbArgs) -> Result<(), HeadsetError> {
    let mut command = Command::new(program);
    if let Some(serial) = serial {
        command.args(["-s", serial]);
    }
    let place = format!("tcp:{port}");
    let result = command.args(["reverse", &place, &place]).stdin(Stdio::null()).output();
    let output = result.map_err(|why| match why.kind() {
        io::ErrorKind::NotFound => HeadsetError::NoAdb,
        _ => HeadsetError::Start(why),
    })?;
    if output.status.success() {
        return Ok(());
    }
    let text = String::from_utf8_lossy(&output.stderr);
    let last = text.lines().map(str::trim).rfind(|line| !line.is_empty());
    let text =
        last.map_or_else(|| output.status.to_string(), |line| line.trim_start_matches("adb: ").to_owned());
    Err(HeadsetError::Refused(text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn the_same_port_is_forwarded_and_refusals_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("adb");
        let usb = |serial: Option<&str>| UsbArgs { port: 8090, serial: serial.map(Into::into) };
        let run = |script: &str, args: &UsbArgs| {
            std::fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
            std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
            reverse(program.to_str().unwrap(), args)
        };
        run("[ \"$*\" = 'reverse tcp:8090 tcp:8090' ]", &usb(None)).unwrap();
        run("[ \"$*\" = '-s Q3 reverse tcp:8090 tcp:8090' ]", &usb(Some("Q3"))).unwrap();
        let refused =
            run("echo 'adb: no devices/emulators found' >&2; exit 1", &usb(None)).unwrap_err().to_string();
        assert!(refused.starts_with("adb: no devices/emulators found; connect the headset"), "{refused}");
        let missing = reverse("/nonexistent/adb", &usb(None)).unwrap_err().to_string();
        assert!(missing.contains("not installed"), "{missing}");
    }
}
