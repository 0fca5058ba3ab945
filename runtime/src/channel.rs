//! The channels between the fleet's processes: one table names the writers and readers of each.
//!
//! Both ends of a channel are opened through [`CHANNELS`], so that they cannot disagree, and a process that opens a
//! channel that the table does not grant it gets an error. The table also makes the chapter on channels in
//! ARCHITECTURE.md: see [`document`].

pub mod document;
mod memory;
mod table;

pub use memory::{SharedMemoryNeed, shared_memory_need};
pub use table::*;

use crate::processes::PROCESSES;
use msg::{Message, RobotId, Role};
use std::fmt;
use std::marker::PhantomData;

/// A program of a run, as far as channels are concerned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Program {
    /// A process that the launcher starts.
    Worker(Role),
    /// The process that starts the others; `mr-slam status` reads what it reads.
    Launcher,
    /// `mr-slam slam`: a person's requests to a robot's SLAM.
    SlamTool,
    /// `mr-slam edges`: a person's commands about merge edges.
    EdgesTool,
    /// `mr-slam goto`, which sends robots to places.
    GotoTool,
    /// `mr-slam explore`, which starts and stops the exploration of a fleet.
    ExploreTool,
    /// `mr-slam zone`, which shows and changes the exclusion zones of a fleet.
    ZoneTool,
    /// `mr-slam record`: a recording of a fleet that runs.
    RecordTool,
    /// The process between a robot's machine and the base; it runs where there are several machines.
    LinkTool,
}

impl Program {
    fn name(self) -> &'static str {
        match self {
            Self::Worker(role) => role.name(),
            Self::Launcher => "launcher",
            Self::SlamTool => "`mr-slam slam`",
            Self::EdgesTool => "`mr-slam edges`",
            Self::GotoTool => "`mr-slam goto`",
            Self::ExploreTool => "`mr-slam explore`",
            Self::ZoneTool => "`mr-slam zone`",
            Self::RecordTool => "`mr-slam record`",
            Self::LinkTool => "link",
        }
    }

    fn is_per_robot(self) -> bool {
        matches!(self, Self::Worker(role) if PROCESSES.iter().any(|row| row.role == role && row.per_robot))
    }

    fn is_tool(self) -> bool {
        use Program::{EdgesTool, ExploreTool, GotoTool, LinkTool, RecordTool, SlamTool, ZoneTool};
        matches!(self, SlamTool | EdgesTool | GotoTool | ExploreTool | ZoneTool | LinkTool | RecordTool)
    }
}

impl From<Role> for Program {
    fn from(role: Role) -> Self {
        Self::Worker(role)
    }
}

/// Opener of channels: a program, and the robot that it belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Opener {
    /// Process of the fleet or tool that opens the channel.
    pub program: Program,
    /// The robot of a simulator or of a SLAM process; none for all others.
    pub robot: Option<RobotId>,
}

impl Opener {
    /// Creates the opener of a program that belongs to the whole fleet.
    pub fn of_fleet(program: Program) -> Self {
        Self { program, robot: None }
    }

    /// Creates the opener of a program that belongs to one robot.
    pub fn of_robot(program: Program, robot: RobotId) -> Self {
        Self { program, robot: Some(robot) }
    }
}

impl fmt::Display for Opener {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.robot {
            Some(robot) => write!(f, "{} of {robot}", self.program.name()),
            None => f.write_str(self.program.name()),
        }
    }
}

/// Which processes of a program are at one end of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Endpoint {
    /// Its only process, or the process of the channel's robot.
    Of(Program),
    /// The process of robot 1.
    OfFirst(Program),
    /// The processes of all other robots.
    OfOthers(Program),
    /// Its process, if the robots are not simulated here.
    External(Program),
    /// Its process, if robots and base are on several machines.
    OtherMachines(Program),
}

impl Endpoint {
    fn program(self) -> Program {
        match self {
            Self::Of(program) | Self::OfFirst(program) => program,
            Self::OfOthers(program) | Self::External(program) => program,
            Self::OtherMachines(program) => program,
        }
    }

    /// Returns whether `opener` is at this end of a channel of `channel_robot`'s.
    pub fn includes(self, opener: Opener, channel_robot: Option<RobotId>) -> bool {
        let same_program = self.program() == opener.program;
        same_program
            && match self {
                Self::Of(program) if program.is_per_robot() => {
                    channel_robot.is_none() || opener.robot == channel_robot
                }
                Self::Of(_) | Self::External(_) | Self::OtherMachines(_) => true,
                Self::OfFirst(_) => opener.robot.is_some_and(|robot| robot.number() == 1),
                Self::OfOthers(_) => opener.robot != channel_robot,
            }
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let program = self.program();
        match self {
            Self::Of(_) if program.is_per_robot() => write!(f, "{}(k)", program.name()),
            Self::Of(_) => f.write_str(program.name()),
            Self::OfFirst(_) => write!(f, "{}(1)", program.name()),
            Self::OfOthers(_) => write!(f, "the other {}s", program.name()),
            Self::External(_) => write!(f, "{} \\*", program.name()),
            Self::OtherMachines(_) => write!(f, "{} \\*\\*", program.name()),
        }
    }
}

/// Scope of a row of the table, which determines its number of channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// One channel of the fleet.
    Fleet,
    /// One channel for each robot.
    Robot,
    /// One channel for each process.
    Process,
}

/// One row of the table.
#[derive(Clone, Copy, Debug)]
pub struct ChannelRow {
    /// The last part of the channel's name: `scan` of `robot1/scan`.
    pub name: &'static str,
    /// The message type's name between processes.
    pub message: &'static str,
    /// Size of a message, bytes; of a map's, without its tiles.
    pub message_bytes: usize,
    /// Whether there is one such channel, or one for each robot or process.
    pub scope: Scope,
    /// Content and rate, for people.
    pub content: &'static str,
    /// The processes that write it.
    pub writers: &'static [Endpoint],
    /// The processes that read it.
    pub readers: &'static [Endpoint],
    /// Messages that a reader may fall behind before it loses the oldest.
    pub depth: usize,
    /// Messages kept for a reader that comes late: 1 for a state, 0 for a stream.
    pub history: usize,
    /// Largest number of readers at a time.
    pub readers_max: usize,
    /// Largest number of writers at a time.
    pub writers_max: usize,
    /// Whether a message wakes its readers, or waits until they poll.
    pub wakes: bool,
}

/// A direction in which a channel is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Direction {
    /// Messages are sent.
    Write,
    /// Messages are received.
    Read,
}

/// A row of the table with the type of its messages.
#[derive(Debug)]
pub struct TypedRow<T> {
    /// Row of the table, without the type.
    pub row: ChannelRow,
    message: PhantomData<fn() -> T>,
}

impl<T: Message> TypedRow<T> {
    const fn new(row: ChannelRow) -> Self {
        let row = ChannelRow { message: T::NAME, message_bytes: size_of::<T>(), ..row };
        Self { row, message: PhantomData }
    }

    fn channel(&'static self, robot: Option<RobotId>, name: String) -> Channel<T> {
        Channel { name, robot, row: &self.row, message: PhantomData }
    }

    fn of_fleet(&'static self) -> Channel<T> {
        self.channel(None, self.row.name.into())
    }

    fn of_robot(&'static self, robot: RobotId) -> Channel<T> {
        self.channel(Some(robot), format!("{robot}/{}", self.row.name))
    }
}

/// One channel of a run, ready to be opened.
#[derive(Debug)]
pub struct Channel<T> {
    /// Unique in a run, such as `robot1/scan`.
    pub name: String,
    /// The robot whose channel it is, if it is a robot's.
    pub robot: Option<RobotId>,
    /// The row of the table.
    pub row: &'static ChannelRow,
    message: PhantomData<fn() -> T>,
}

/// A process opened a channel that the table does not grant it.
#[derive(Debug, thiserror::Error)]
#[error(
    "the table of channels lets only {allowed} {verb} `{channel}`, not the {opener}; see runtime/src/channel/table.rs"
)]
pub struct Undeclared {
    channel: String,
    opener: Opener,
    verb: &'static str,
    allowed: String,
}

impl<T> Channel<T> {
    /// Checks that the table lets `opener` open this channel in this direction.
    pub fn check(&self, opener: Opener, direction: Direction) -> Result<(), Undeclared> {
        let (ends, verb) = match direction {
            Direction::Write => (self.row.writers, "write"),
            Direction::Read => (self.row.readers, "read"),
        };
        if ends.iter().any(|end| end.includes(opener, self.robot)) {
            return Ok(());
        }
        Err(Undeclared { channel: self.name.clone(), opener, verb, allowed: document::list(ends) })
    }
}
