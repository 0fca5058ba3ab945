//! Announces the node's readers and writers to the ROS graph, on `ros_discovery_info`.

use ros2_client::builtin_topics::ros_discovery;
use ros2_client::dds::rustdds::dds::CreateResult;
use ros2_client::dds::rustdds::no_key::DataWriterCdr;
use ros2_client::dds::rustdds::policy::{Durability, History, ResourceLimits};
use ros2_client::dds::rustdds::{
    DomainParticipant, Duration, GUID, Publisher, QosPolicyBuilder, RTPSEntity, TopicKind,
};
use ros2_client::entities_info::{NodeEntitiesInfo, ParticipantEntitiesInfo};
use ros2_client::{Gid, NodeName};
use std::cell::Cell;

/// Announcements kept for participants that have not taken them yet.
const ANNOUNCEMENTS_MAX: i32 = 8;

/// Longest time that others have to acknowledge that the node has left. On a network they take milliseconds.
const ACKNOWLEDGMENT_MAX: std::time::Duration = std::time::Duration::from_millis(500);
/// Period at which an announcement is tried again that the writer has not taken.
const RETRY_PERIOD: std::time::Duration = std::time::Duration::from_millis(5);

/// So often it is announced that the node has left: RustDDS may lose a message that is written while a reader is being matched.
const LEAVE_ANNOUNCEMENTS: usize = 2;

/// The source of what `ros2 node list` and `ros2 topic info` show.
pub struct NodeGraphAnnouncer {
    participant: GUID,
    node: NodeName,
    writer: DataWriterCdr<ParticipantEntitiesInfo>,
    has_left: Cell<bool>,
}

impl NodeGraphAnnouncer {
    /// Creates the announcements of the participant's only node.
    pub fn new(participant: &DomainParticipant, publisher: &Publisher, node: NodeName) -> CreateResult<Self> {
        let limits = ResourceLimits {
            max_samples: ANNOUNCEMENTS_MAX,
            max_instances: 1,
            max_samples_per_instance: ANNOUNCEMENTS_MAX,
        };
        let qos = QosPolicyBuilder::new()
            .reliable(Duration::ZERO)
            .durability(Durability::TransientLocal)
            .history(History::KeepLast { depth: 1 })
            .resource_limits(limits)
            .build();
        let (name, class) = (ros_discovery::TOPIC_NAME.into(), ros_discovery::TYPE_NAME.into());
        let topic = participant.create_topic(name, class, &qos, TopicKind::NoKey)?;
        let writer = publisher.create_datawriter_no_key_cdr(&topic, None)?;
        Ok(Self { participant: participant.guid(), node, writer, has_left: Cell::new(false) })
    }

    /// Announces the readers and writers that exist now; nothing once the node has left. Returns whether it is done.
    ///
    /// It fails while another participant has not acknowledged what was announced before.
    #[must_use]
    pub fn publish(&self, readers: impl Iterator<Item = GUID>, writers: impl Iterator<Item = GUID>) -> bool {
        if self.has_left.get() {
            return true;
        }
        let mut info = NodeEntitiesInfo::new(self.node.clone());
        readers.for_each(|guid| info.add_reader(Gid::from(guid)));
        writers.for_each(|guid| info.add_writer(Gid::from(guid)));
        info.add_writer(Gid::from(self.writer.guid()));
        let message = ParticipantEntitiesInfo::new(Gid::from(self.participant), vec![info]);
        self.writer.write(message, None).is_ok()
    }

    /// Announces that the node is gone, and waits until all participants know it, or for a bounded time.
    ///
    /// A participant's own message that it leaves may be lost. Then others keep its nodes until its lease ends, 50 s later.
    pub async fn leave(&self) {
        self.has_left.set(true);
        let is_acknowledged = async {
            let nothing = || ParticipantEntitiesInfo::new(Gid::from(self.participant), Vec::new());
            for _ in 0..LEAVE_ANNOUNCEMENTS {
                // Before that, what was announced last must be acknowledged.
                while self.writer.write(nothing(), None).is_err() {
                    tokio::time::sleep(RETRY_PERIOD).await;
                }
                let _ = self.writer.async_wait_for_acknowledgments().await;
                tokio::time::sleep(RETRY_PERIOD).await;
            }
        };
        // A participant that has crashed does not acknowledge.
        let _ = tokio::time::timeout(ACKNOWLEDGMENT_MAX, is_acknowledged).await;
    }
}
