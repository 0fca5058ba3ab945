//! People, doors and boxes that move in a simulated room, as JSON for recordings.

use msg::{MovingObject, MovingObjects, ObjectKind, Pose2};
use serde_json::{Value, json};

/// Returns the true poses in `world`, metres and radians, with half of the objects' size; of a person that is the radius.
pub fn moving_objects_json(message: &MovingObjects) -> Value {
    let object = |object: &MovingObject| {
        let Pose2 { x_m, y_m, yaw_rad } = object.world_from_object;
        let kind = object.kind().map(|kind| match kind {
            ObjectKind::Person => "person",
            ObjectKind::Door => "door",
            ObjectKind::Box => "box",
        });
        json!({
            "kind": kind, "x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad, "half_size_m": object.half_size_m,
            "velocity_m_s": object.velocity_m_s, "is_present": object.is_present == 1,
        })
    };
    let objects: Vec<Value> = message.objects().iter().map(object).collect();
    json!({ "stamp_s": message.header.stamp.seconds(), "objects": objects })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_that_count_are_listed_with_their_kind() {
        let mut message = MovingObjects { len: 1, ..MovingObjects::default() };
        message.objects[0] = MovingObject {
            world_from_object: Pose2::new(1.0, -2.0, 0.0),
            half_size_m: [0.2; 2],
            kind: ObjectKind::Person as u32,
            is_present: 1,
            ..MovingObject::default()
        };
        let json = moving_objects_json(&message);
        assert_eq!(json["objects"].as_array().unwrap().len(), 1);
        assert_eq!(
            (&json["objects"][0]["kind"], &json["objects"][0]["y_m"]),
            (&json!("person"), &json!(-2.0))
        );
    }
}
