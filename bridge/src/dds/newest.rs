//! The newest sample of each writer on a topic: tells new samples from those that were received before.

use super::raw::SerializedMessage;
use ros2_client::MessageInfo;
use ros2_client::dds::rustdds::no_key::DeserializedCacheChange;
use ros2_client::dds::rustdds::{GUID, SequenceNumber};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

/// The number of the newest sample of each writer. Clones share it.
///
/// RustDDS gives a new reader what the topic's former reader has had.
#[derive(Clone, Default)]
pub struct NewestSamples(Rc<RefCell<BTreeMap<GUID, SequenceNumber>>>);

impl NewestSamples {
    /// Forgets all samples: each counts as new again.
    pub fn clear(&self) {
        self.0.borrow_mut().clear();
    }

    /// Forgets the writers that are gone.
    pub fn retain(&self, is_kept: impl Fn(&GUID) -> bool) {
        self.0.borrow_mut().retain(|writer, _| is_kept(writer));
    }

    /// Returns whether a sample is newer than its writer's last one, and records it.
    pub fn is_new(&self, sample: &DeserializedCacheChange<SerializedMessage>) -> bool {
        let number = SequenceNumber::from(MessageInfo::from(sample).sequence_number());
        let newest = &mut *self.0.borrow_mut();
        let last = newest.insert(sample.writer_guid(), number);
        match last.filter(|last| *last >= number) {
            Some(last) => {
                newest.insert(sample.writer_guid(), last);
                false
            }
            None => true,
        }
    }
}
