//! The transforms that never change, of the fleet's robots and of other frames: one set, as tf2 keeps it.

use ros_messages::TransformStamped;

/// Most frames of the set: those of 64 robots with a dozen sensors each. Further ones are refused.
const FRAMES_MAX: usize = 1024;
/// The longest frame name that is kept, bytes.
const NAME_BYTES_MAX: usize = 256;

/// The newest transform to each child frame, in the order in which the frames came.
#[derive(Debug, Default)]
pub struct StaticTransformSet {
    transforms: Vec<TransformStamped>,
}

impl StaticTransformSet {
    /// Adds a transform in place of an older one to the same child frame; returns whether the set has changed.
    ///
    /// A transform that is not finite, whose names are empty or too long, or that does not fit is left out.
    pub fn insert(&mut self, transform: TransformStamped) -> bool {
        let numbers = transform.translation.iter().chain(&transform.rotation);
        let names = [&transform.frame_id, &transform.child_frame_id];
        let is_usable = names.iter().all(|name| (1..=NAME_BYTES_MAX).contains(&name.len()))
            && numbers.into_iter().all(|number| number.is_finite());
        if !is_usable {
            return false;
        }
        let child = &transform.child_frame_id;
        if let Some(known) = self.transforms.iter_mut().find(|known| known.child_frame_id == *child) {
            let has_changed = *known != transform;
            *known = transform;
            return has_changed;
        }
        let fits = self.transforms.len() < FRAMES_MAX;
        if fits {
            self.transforms.push(transform);
        }
        fits
    }

    /// Returns all transforms.
    pub fn transforms(&self) -> &[TransformStamped] {
        &self.transforms
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn transform(child: &str, x_m: f64) -> TransformStamped {
        TransformStamped {
            frame_id: "base_link".into(),
            child_frame_id: child.into(),
            translation: [x_m, 0.0, 0.0],
            rotation: [0.0, 0.0, 0.0, 1.0],
            ..TransformStamped::default()
        }
    }

    #[test]
    fn the_newest_transform_to_a_child_counts_and_the_set_is_bounded() {
        let mut set = StaticTransformSet::default();
        assert!(set.insert(transform("camera", 0.1)) && set.insert(transform("camera", 0.2)));
        assert!(!set.insert(transform("camera", 0.2)), "nothing new");
        assert!(!set.insert(transform("camera", f64::NAN)) && !set.insert(transform("", 0.0)));
        assert_eq!(set.transforms(), [transform("camera", 0.2)]);
        let added = (0..2 * FRAMES_MAX).filter(|n| set.insert(transform(&format!("frame{n}"), 0.0))).count();
        assert_eq!(added, FRAMES_MAX - 1);
        assert!(set.insert(transform("camera", 0.3)), "known frames are still updated");
    }
}
