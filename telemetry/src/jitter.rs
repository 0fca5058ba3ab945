//! TF jitter as the MR-SLAM paper defines it: |(receive - stamp) - its mean over the link|.

use crate::Histogram;
use msg::{Monotonic, RobotFrame, Transforms};

/// Transforms of a link that only count for its mean, before the first deviation is counted: one second at 20 Hz. Until
/// then the mean is not reliable.
const WARM_UP: u64 = 20;
/// Transforms of a link before those, left out altogether: while a fleet starts, messages wait for processes that are
/// still loading, and one such wait would shift the mean for minutes.
const LEFT_OUT: u64 = 20;

/// Jitter of one robot's transforms.
///
/// `stamp` is the sender's, and `receive` the time at which telemetry's loop reads the message: the jitter is that of the
/// sender's time, of shared memory and of the wake-up of the loop. `receive` is the machine's clock and `stamp` the run's; their unknown offset is the same for
/// all, so it cancels in the difference to the mean. The mean runs since the start of the writer:
/// a deviation is against the mean so far, which differs from the mean of the whole run by about
/// jitter / sqrt(n).
#[derive(Clone, Debug, Default)]
pub(crate) struct TransformJitter {
    run: u64,
    frames: [Mean; RobotFrame::ALL.len()],
    deviations: Histogram,
}

/// Running mean of (receive - stamp), nanoseconds, relative to the first: the differences are small whole numbers that
/// f64 holds exactly.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    left_out: u64,
    count: u64,
    first_ns: i64,
    mean_ns: f64,
}

impl Mean {
    /// Adds a value and returns its deviation from the mean so far.
    fn deviation_ns(&mut self, age_ns: i64) -> f64 {
        if self.count == 0 {
            self.first_ns = age_ns;
        }
        self.count += 1;
        let relative_ns = age_ns.wrapping_sub(self.first_ns) as f64;
        self.mean_ns += (relative_ns - self.mean_ns) / self.count as f64;
        (relative_ns - self.mean_ns).abs()
    }
}

impl TransformJitter {
    /// Adds a message.
    pub fn add(&mut self, transforms: &Transforms, received: Monotonic) {
        if transforms.header.incarnation != self.run {
            // The clock of a restarted writer may begin elsewhere. Deviations counted so far stay.
            self.run = transforms.header.incarnation;
            self.frames = Default::default();
        }
        let age_ns = (received.0 as i64).wrapping_sub(transforms.header.stamp.0);
        for frame in transforms.transforms().iter().filter_map(|it| RobotFrame::from_code(it.child_frame)) {
            let mean = &mut self.frames[frame as usize - 1];
            if mean.left_out < LEFT_OUT {
                mean.left_out += 1;
                continue;
            }
            let deviation_ns = mean.deviation_ns(age_ns);
            if mean.count > WARM_UP {
                self.deviations.add(deviation_ns.round() as u64);
            }
        }
    }

    /// Returns the histogram of all deviations so far.
    pub fn deviations(&self) -> &Histogram {
        &self.deviations
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::{Header, RobotFrameTransform, Stamp};

    fn message(stamp_ns: i64, run: u64) -> Transforms {
        let mut message = Transforms { len: 2, ..Default::default() };
        message.header = Header { stamp: Stamp(stamp_ns), incarnation: run, ..Default::default() };
        message.transforms[0] =
            RobotFrameTransform { child_frame: RobotFrame::BaseFootprint as u32, ..Default::default() };
        message.transforms[1] = RobotFrameTransform { child_frame: 99, ..Default::default() };
        message
    }

    #[test]
    fn alternating_delays_deviate_by_half_their_difference() {
        let mut jitter = TransformJitter::default();
        for n in 0..1000_u64 {
            // 50 ms apart, 1 ms or 3 ms late, and clocks that are years apart.
            let late = if n % 2 == 0 { 1_000_000 } else { 3_000_000 };
            jitter.add(&message(n as i64 * 50_000_000, 1), Monotonic((1 << 60) + n * 50_000_000 + late));
        }
        let ms = jitter.deviations().distribution_ms();
        assert_eq!(ms.count, 1000 - WARM_UP - LEFT_OUT);
        assert!((ms.p50 - 1.0).abs() < 0.02 && (ms.p99 - 1.0).abs() < 0.06, "{ms:?}");
    }

    #[test]
    fn a_restart_of_the_writer_is_not_jitter() {
        let mut jitter = TransformJitter::default();
        for n in 0..200_i64 {
            let (run, epoch) = if n < 100 { (1, 0) } else { (2, 5_000_000_000) };
            jitter.add(&message(n * 50_000_000 - epoch, run), Monotonic(n as u64 * 50_000_000));
        }
        assert_eq!(jitter.deviations().distribution_ms().max, 0.0);
    }
}
