//! Who sent a command to the fleet.

use bytemuck::{Pod, Zeroable};
use core::fmt;
use core::net::{IpAddr, Ipv6Addr, SocketAddr};

/// Kind of a command's sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum CommandSourceKind {
    /// Nobody said who sent it.
    Unknown = 0,
    /// The bridge itself: it stops robots whose operator is silent or gone.
    Bridge = 1,
    /// A client on TCP or in a browser, with its address.
    Client = 2,
    /// A node of ROS 2; nodes are not told apart.
    Ros2 = 3,
    /// The navigation process, which drives to a goal.
    Navigation = 4,
    /// A command line or the keys at the laptop.
    Laptop = 5,
    /// The base on another machine, on the robot's own: its navigation, or a person who drives there.
    Base = 6,
}

/// Sender of a command.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct CommandSource {
    /// Code of a [`CommandSourceKind`].
    kind: u32,
    /// TCP port of a client.
    port: u32,
    /// Address of a client; IPv4 addresses are mapped into IPv6 (RFC 4291).
    address: [u8; 16],
}

impl CommandSource {
    /// The bridge itself.
    pub const BRIDGE: Self = Self::of(CommandSourceKind::Bridge);
    /// A node of ROS 2.
    pub const ROS2: Self = Self::of(CommandSourceKind::Ros2);
    /// The navigation process.
    pub const NAVIGATION: Self = Self::of(CommandSourceKind::Navigation);
    /// A person or a program at the laptop.
    pub const LAPTOP: Self = Self::of(CommandSourceKind::Laptop);

    /// The base on another machine.
    pub const BASE: Self = Self::of(CommandSourceKind::Base);

    const fn of(kind: CommandSourceKind) -> Self {
        Self { kind: kind as u32, port: 0, address: [0; 16] }
    }

    /// A client at an address.
    pub fn client(peer: SocketAddr) -> Self {
        let address = match peer.ip() {
            IpAddr::V4(address) => address.to_ipv6_mapped(),
            IpAddr::V6(address) => address,
        };
        Self { port: peer.port().into(), address: address.octets(), ..Self::of(CommandSourceKind::Client) }
    }

    /// Decodes the kind; an unknown code is [`CommandSourceKind::Unknown`].
    pub fn kind(&self) -> CommandSourceKind {
        use CommandSourceKind::{Base, Bridge, Client, Laptop, Navigation, Ros2, Unknown};
        let kinds = [Bridge, Client, Ros2, Navigation, Laptop, Base];
        kinds.into_iter().find(|kind| *kind as u32 == self.kind).unwrap_or(Unknown)
    }

    /// Returns a client's address; `None` for every other sender.
    pub fn address(&self) -> Option<SocketAddr> {
        let port = u16::try_from(self.port).ok().filter(|_| self.kind() == CommandSourceKind::Client)?;
        Some(SocketAddr::new(IpAddr::V6(Ipv6Addr::from(self.address)).to_canonical(), port))
    }
}

impl fmt::Display for CommandSource {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.kind(), self.address()) {
            (CommandSourceKind::Client, Some(address)) => write!(to, "client {address}"),
            (CommandSourceKind::Bridge, _) => to.write_str("bridge"),
            (CommandSourceKind::Ros2, _) => to.write_str("ros2"),
            (CommandSourceKind::Navigation, _) => to.write_str("navigation"),
            (CommandSourceKind::Laptop, _) => to.write_str("laptop"),
            (CommandSourceKind::Base, _) => to.write_str("base"),
            (CommandSourceKind::Client | CommandSourceKind::Unknown, _) => to.write_str("unknown"),
        }
    }
}

/// What somebody did who operates the fleet, beside velocities, goals and requests to SLAM.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum OperatorAction {
    /// Set the emergency stop.
    Stop = 1,
    /// Released the emergency stop.
    Release = 2,
    /// Selected the robot that `/cmd_vel` drives.
    Select = 3,
    /// Took a robot over from its driver.
    TakeControl = 4,
}

impl OperatorAction {
    /// Returns the name in recordings.
    pub fn name(self) -> &'static str {
        match self {
            Self::Stop => "emergency_stop",
            Self::Release => "emergency_stop_release",
            Self::Select => "select_robot",
            Self::TakeControl => "take_control",
        }
    }
}

/// One action of an operator, as the bridge has carried it out.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct OperatorEvent {
    /// Header whose `stamp` is not used.
    pub header: crate::Header,
    /// Who did it.
    pub sender: CommandSource,
    /// Code of an [`OperatorAction`].
    pub action: u32,
    /// Number of the robot, from 1; 0: all, or none in particular.
    pub robot: u32,
}

impl OperatorEvent {
    /// Creates an event; `robot` is `None` for all robots, or none in particular.
    pub fn new(sender: CommandSource, action: OperatorAction, robot: Option<crate::RobotId>) -> Self {
        let robot = robot.map_or(0, |robot| robot.number() as u32);
        Self { sender, action: action as u32, robot, ..Self::default() }
    }

    /// Decodes the action; `None` for an unknown code.
    pub fn action(&self) -> Option<OperatorAction> {
        use OperatorAction::{Release, Select, Stop, TakeControl};
        [Stop, Release, Select, TakeControl].into_iter().find(|action| *action as u32 == self.action)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn senders_are_told_apart_and_damaged_ones_are_unknown() {
        let peer: SocketAddr = "192.0.2.7:5000".parse().unwrap();
        let client = CommandSource::client(peer);
        assert_eq!((client.address(), client.to_string().as_str()), (Some(peer), "client 192.0.2.7:5000"));
        let peer: SocketAddr = "[2001:db8::1]:70".parse().unwrap();
        assert_eq!(CommandSource::client(peer).to_string(), "client [2001:db8::1]:70");
        assert_eq!(CommandSource::default().to_string(), "unknown");
        assert_eq!(CommandSource::NAVIGATION.to_string(), "navigation");
        assert_eq!(CommandSource::BASE.to_string(), "base");
        assert_eq!(CommandSource::BASE.kind(), CommandSourceKind::Base);
        assert_eq!(CommandSource::LAPTOP.address(), None);
        let damaged = CommandSource { kind: 2, port: u32::MAX, address: [0xff; 16] };
        assert_eq!((damaged.address(), damaged.to_string().as_str()), (None, "unknown"));
        assert_eq!(CommandSource { kind: 77, ..damaged }.kind(), CommandSourceKind::Unknown);
    }
}
