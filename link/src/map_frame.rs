//! The number by which merging tells the frames of a robot's map apart.

/// Returns one number for the run on a robot's machine and the frame of its map in that run: merging begins anew with either.
pub fn run_and_frame(run: u32, frame: u32) -> u32 {
    // An odd factor: the frames of a run have different numbers, and frame 0 has the run's.
    run ^ frame.wrapping_mul(0x9E37_79B9)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn runs_and_frames_are_told_apart(run: u32, other: u32, frame: u32, next: u32) {
            prop_assert_eq!(run_and_frame(run, 0), run);
            prop_assert_eq!(run_and_frame(run, frame) == run_and_frame(run, next), frame == next);
            prop_assert_eq!(run_and_frame(run, frame) == run_and_frame(other, frame), run == other);
        }
    }
}
