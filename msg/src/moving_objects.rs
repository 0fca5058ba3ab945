//! Message about people, doors and boxes that move in a simulated room.

use crate::{Header, Pose2};
use bytemuck::{Pod, Zeroable};

/// Largest number of objects of one kind that move in a room.
pub const OBJECTS_OF_KIND_MAX: usize = 16;
/// Largest number of objects that move in a room.
pub const MOVING_OBJECTS_MAX: usize = 3 * OBJECTS_OF_KIND_MAX;

/// Kind of an object that moves in a simulated room.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum ObjectKind {
    /// A person, whose outline on the floor is a disc.
    Person = 1,
    /// The leaf of a sliding door.
    Door = 2,
    /// A box that somebody carries to another place from time to time.
    Box = 3,
}

impl ObjectKind {
    /// Decodes a kind; `None` for an unknown code.
    pub fn from_code(code: u32) -> Option<Self> {
        [Self::Person, Self::Door, Self::Box].into_iter().find(|kind| *kind as u32 == code)
    }
}

/// One object of [`MovingObjects`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MovingObject {
    /// Pose of the object's centre in `world` at the stamp of the message, metres and radians.
    pub world_from_object: Pose2,
    /// Velocity in `world` from the stamp until the next message is due, m/s.
    pub velocity_m_s: [f64; 2],
    /// Half of its length along its x axis and along its y axis, metres. Of a person both are the radius.
    pub half_size_m: [f64; 2],
    /// Code of an [`ObjectKind`].
    pub kind: u32,
    /// 1 if robots see it and touch it; 0 if not, as the leaf of an open door, which is inside the wall.
    pub is_present: u32,
}

impl MovingObject {
    /// Returns the kind; `None` for an unknown code.
    pub fn kind(&self) -> Option<ObjectKind> {
        ObjectKind::from_code(self.kind)
    }

    /// Returns the pose so long after the stamp, in seconds: it moves for one period, and then it stands.
    pub fn world_from_object_after(&self, age_s: f64) -> Pose2 {
        let Pose2 { x_m, y_m, yaw_rad } = self.world_from_object;
        let moved_s = age_s.clamp(0.0, MovingObjects::PERIOD_S);
        let [x_m_s, y_m_s] = self.velocity_m_s;
        Pose2::new(x_m + moved_s * x_m_s, y_m + moved_s * y_m_s, yaw_rad)
    }
}

/// People, doors and boxes of a simulated room. The process `objects` sends it 20 times a second.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct MovingObjects {
    /// Header whose stamp is the time of the poses.
    pub header: Header,
    /// Number of objects that count.
    pub len: u32,
    /// Filler, always 0.
    pub reserved: u32,
    /// Objects, of which the first `len` count: people, then doors, then boxes, always in the same order.
    pub objects: [MovingObject; MOVING_OBJECTS_MAX],
}

impl MovingObjects {
    /// Period of the messages, seconds.
    pub const PERIOD_S: f64 = 0.05;

    /// Returns the objects that count.
    pub fn objects(&self) -> &[MovingObject] {
        &self.objects[..(self.len as usize).min(MOVING_OBJECTS_MAX)]
    }
}

impl Default for MovingObjects {
    fn default() -> Self {
        Self::zeroed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_object_moves_for_one_period_and_then_stands() {
        let person = MovingObject { velocity_m_s: [1.0, -2.0], ..MovingObject::default() };
        let x_m = |age_s| person.world_from_object_after(age_s).x_m;
        assert_eq!((x_m(-1.0), x_m(0.02), x_m(0.05), x_m(9.0)), (0.0, 0.02, 0.05, 0.05));
        assert_eq!(person.world_from_object_after(0.05).y_m, -0.1);
    }

    #[test]
    fn lengths_and_kinds_of_damaged_messages_are_bounded() {
        let message = MovingObjects { len: u32::MAX, ..MovingObjects::default() };
        assert_eq!(message.objects().len(), MOVING_OBJECTS_MAX);
        assert_eq!(message.objects()[0].kind(), None);
    }
}
