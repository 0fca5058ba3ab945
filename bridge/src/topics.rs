//! The table of topics: the fleet's, fixed at start, and those clients bring.

use crate::pool::Bytes;
use msg::RobotId;
use std::collections::BTreeMap;

/// An index into the table.
pub type TopicId = usize;

/// How many newest messages wait for a slow subscriber if nobody says otherwise: the reference's history.
pub const DEPTH_USUAL: usize = 10;
/// The most that a client may ask to be kept.
const DEPTH_MAX: usize = 4096;

/// What a message on a topic that clients may publish means to the fleet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// A velocity for the selected robot.
    SelectedCommand,
    /// A velocity for one robot.
    Command(RobotId),
    /// A thumb stick and a grip, for the selected robot: sensor_msgs/Joy.
    Joystick,
    /// The same as Quest2ROS sends it.
    HandInputs,
    /// Where a robot is, as a person says: the named robot, or the one its frame or the selection names.
    InitialPose(Option<RobotId>),
    /// The number of the robot to select.
    Select,
    /// The number of the robot to take over; 0 for all.
    Take,
    /// `true` stops the fleet.
    Stop,
    /// Lets it go again.
    Release,
    /// `pin 1 2`, `unpin 1 2` or `undo 1 2`: what merging shall do with what holds two robots' maps together.
    MergeEdge,
    /// Transforms, which must leave the fleet's own frames alone; in a world of a client's, the robots' are its own.
    Transforms,
    /// A robot's scan, in a world of a client's.
    Scan(RobotId),
    /// What its wheels say, in a world of ROS's.
    Odometry(RobotId),
    /// The time there.
    Clock,
}

/// Who publishes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The fleet alone.
    Fleet,
    /// Clients, and the fleet listens.
    Input(Input),
    /// Clients, for each other.
    Clients,
}

/// A client that is sent a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Subscriber {
    /// Of the client.
    pub slot: usize,
    /// It wrote the name without the leading slash, and knows it only so.
    pub bare: bool,
}

/// One topic.
#[derive(Debug)]
pub struct Topic {
    /// With leading slash.
    pub name: String,
    /// `package/Type`.
    pub class: String,
    /// Who publishes.
    pub source: Source,
    /// How many newest messages wait for a slow subscriber.
    pub depth: usize,
    /// Whether the newest message is sent to late subscribers.
    pub latch: bool,
    /// That message, as a frame.
    pub latched: Option<Bytes>,
    /// In the order they came.
    pub subscribers: Vec<Subscriber>,
    /// Slots of clients that registered to publish.
    pub publishers: Vec<usize>,
    /// Length of the last frame, for the next one's buffer.
    pub typical: usize,
}

impl Topic {
    fn is_unused(&self) -> bool {
        self.source == Source::Clients && self.subscribers.is_empty() && self.publishers.is_empty()
    }

    /// The depth a publisher's `queue_size` asks for.
    pub fn deepen(&mut self, queue_size: i64) {
        let asked = usize::try_from(queue_size).ok().filter(|size| *size > 0).unwrap_or(DEPTH_USUAL);
        let others = self.publishers.len() > 1;
        let asked = asked.min(DEPTH_MAX);
        self.depth = if others { self.depth.max(asked) } else { asked };
    }
}

/// Why a topic cannot be had.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TopicError {
    /// It exists with another type.
    Type {
        /// The type it has.
        is: String,
    },
    /// Clients have brought too many.
    TooMany {
        /// The limit.
        limit: usize,
    },
}

/// All topics.
#[derive(Debug)]
pub struct Topics {
    all: Vec<Option<Topic>>,
    free: Vec<TopicId>,
    /// With and without the leading slash.
    by_name: BTreeMap<String, TopicId>,
    from_clients: usize,
    from_clients_max: usize,
}

impl Topics {
    /// Clients may bring `from_clients_max`.
    pub fn new(from_clients_max: usize) -> Self {
        Self {
            all: Vec::new(),
            free: Vec::new(),
            by_name: BTreeMap::new(),
            from_clients: 0,
            from_clients_max,
        }
    }

    /// A topic of the fleet's.
    pub fn add(&mut self, name: String, class: &str, source: Source, depth: usize, latch: bool) -> TopicId {
        let topic = Topic {
            name: name.clone(),
            class: class.to_owned(),
            source,
            depth,
            latch,
            latched: None,
            subscribers: Vec::new(),
            publishers: Vec::new(),
            typical: 0,
        };
        let id = self.free.pop().unwrap_or_else(|| {
            self.all.push(None);
            self.all.len() - 1
        });
        self.all[id] = Some(topic);
        self.by_name.insert(name.trim_start_matches('/').to_owned(), id);
        self.by_name.insert(name, id);
        id
    }

    /// The topic of that name and type, made if there is none. Whoever is first says the type.
    pub fn find_or_add(&mut self, name: String, class: &str) -> Result<TopicId, TopicError> {
        match self.find(&name).and_then(|id| Some((id, self.get(id)?))) {
            Some((id, topic)) if topic.class == class => Ok(id),
            Some((_, topic)) => Err(TopicError::Type { is: topic.class.clone() }),
            None if self.from_clients >= self.from_clients_max => {
                Err(TopicError::TooMany { limit: self.from_clients_max })
            }
            None => {
                self.from_clients += 1;
                Ok(self.add(name, class, Source::Clients, DEPTH_USUAL, false))
            }
        }
    }

    /// By name, with or without leading slash.
    pub fn find(&self, name: &str) -> Option<TopicId> {
        self.by_name.get(name).copied()
    }

    /// `None` for a topic that is gone.
    pub fn get(&self, id: TopicId) -> Option<&Topic> {
        self.all.get(id)?.as_ref()
    }

    /// `None` for a topic that is gone.
    pub fn get_mut(&mut self, id: TopicId) -> Option<&mut Topic> {
        self.all.get_mut(id)?.as_mut()
    }

    /// Removes a client's topic that nobody publishes or wants; its latched frame, if it had one.
    pub fn sweep(&mut self, id: TopicId) -> Option<Bytes> {
        if !self.get(id)?.is_unused() {
            return None;
        }
        let topic = self.all[id].take()?;
        self.by_name.remove(&topic.name);
        self.by_name.remove(topic.name.trim_start_matches('/'));
        self.free.push(id);
        self.from_clients -= 1;
        topic.latched
    }

    /// All topics by name.
    pub fn sorted(&self) -> impl Iterator<Item = &Topic> {
        self.by_name.iter().filter(|(name, _)| name.starts_with('/')).filter_map(|(_, id)| self.get(*id))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_says_the_type_and_the_last_takes_the_topic_with_it() {
        let mut topics = Topics::new(1);
        let clock = topics.add("/clock".into(), "rosgraph_msgs/Clock", Source::Fleet, 1, false);
        let id = topics.find_or_add("/a".into(), "std_msgs/String").unwrap();
        assert_eq!((topics.find("/a"), topics.find("a")), (Some(id), Some(id)));
        let other = topics.find_or_add("/a".into(), "std_msgs/Bool");
        assert_eq!(other, Err(TopicError::Type { is: "std_msgs/String".into() }));
        assert_eq!(topics.find_or_add("/b".into(), "std_msgs/Bool"), Err(TopicError::TooMany { limit: 1 }));
        topics.sweep(id);
        topics.sweep(clock);
        assert_eq!(topics.find("/a"), None);
        assert!(topics.find_or_add("/b".into(), "std_msgs/Bool").is_ok());
        assert_eq!(topics.sorted().map(|topic| topic.name.as_str()).collect::<Vec<_>>(), ["/b", "/clock"]);
    }
}
