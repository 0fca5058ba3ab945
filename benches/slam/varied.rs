//! The logs as other robots would have made them: a narrower or sparser LiDAR, one that sees less
//! far or less exactly, worse wheels, a start elsewhere. Scored with the same relations.

use crate::noise::Noise;
use formats::carmen::LaserLine;
use msg::{Pose2, pose::wrap_angle};
use serde::{Deserialize, Serialize};

/// Where the noise begins: the same for every run.
const SEED: u64 = 0x5EED;

/// What is different; by default nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Varied {
    /// Only the central beams, degrees.
    pub fov_deg: Option<f64>,
    /// So many beams are left out between two that are kept.
    pub beams_skipped: usize,
    /// The LiDAR sees no farther, metres.
    pub range_max_m: Option<f64>,
    /// Standard deviation added to every range, metres.
    pub range_noise_m: f64,
    /// The wheels count so many metres a metre too much.
    pub way_extra: f64,
    /// Their heading runs away by so many radians a metre.
    pub drift_rad_per_m: f64,
    /// And is so uncertain besides (one standard deviation), as is the way: radians a metre, radians a
    /// radian, metres a metre.
    pub wheel_noise: [f64; 3],
    /// This share of the log is left out at its beginning.
    pub begins_at: f64,
}

const SAME: Varied = Varied {
    fov_deg: None,
    beams_skipped: 0,
    range_max_m: None,
    range_noise_m: 0.0,
    way_extra: 0.0,
    drift_rad_per_m: 0.0,
    wheel_noise: [0.0; 3],
    begins_at: 0.0,
};
/// Wheels about half as bad as the default configuration takes them to be.
const NOISY_WHEELS: [f64; 3] = [0.02, 0.1, 0.05];

/// All that is tried with each log. All logs are of 180°.
pub const VARIATIONS: [(&str, Varied); 15] = [
    ("as it is", SAME),
    ("120°", Varied { fov_deg: Some(120.0), ..SAME }),
    ("90°", Varied { fov_deg: Some(90.0), ..SAME }),
    ("60°", Varied { fov_deg: Some(60.0), ..SAME }),
    ("every second beam", Varied { beams_skipped: 1, ..SAME }),
    ("8 m", Varied { range_max_m: Some(8.0), ..SAME }),
    ("4 m", Varied { range_max_m: Some(4.0), ..SAME }),
    ("ranges +- 3 cm", Varied { range_noise_m: 0.03, ..SAME }),
    ("way x 1.05", Varied { way_extra: 0.05, ..SAME }),
    ("drift 0.02 rad/m", Varied { drift_rad_per_m: 0.02, ..SAME }),
    ("noisy wheels", Varied { wheel_noise: NOISY_WHEELS, ..SAME }),
    ("from the middle", Varied { begins_at: 0.5, ..SAME }),
    ("90°, 8 m", Varied { fov_deg: Some(90.0), range_max_m: Some(8.0), ..SAME }),
    ("90°, noisy wheels", Varied { fov_deg: Some(90.0), wheel_noise: NOISY_WHEELS, ..SAME }),
    ("90°, from the middle", Varied { fov_deg: Some(90.0), begins_at: 0.5, ..SAME }),
];

/// Varies one line after the other.
pub struct Maker {
    varied: Varied,
    noise: Noise,
    /// The odometry before: as it was, and as it was made.
    before: Option<(Pose2, Pose2)>,
}

impl Maker {
    /// Before the first line.
    pub fn new(varied: Varied) -> Self {
        Self { varied, noise: Noise::new(SEED), before: None }
    }

    /// The line as the other robot would have it.
    pub fn make(&mut self, mut line: LaserLine) -> LaserLine {
        let varied = self.varied;
        if let Some(metres) = varied.range_max_m {
            line.range_max_m = line.range_max_m.min(metres);
        }
        if varied.beams_skipped > 0 {
            let step = varied.beams_skipped + 1;
            line.ranges_m = line.ranges_m.iter().copied().step_by(step).collect();
            line.angle_increment_rad *= step as f64;
        }
        if varied.range_noise_m > 0.0 {
            for range in line.ranges_m.iter_mut().filter(|range| f64::from(**range) < line.range_max_m) {
                *range += (varied.range_noise_m * self.noise.normal()) as f32;
            }
        }
        let raw = line.odom_from_base;
        if let Some((before, made)) = self.before {
            line.odom_from_base = made * self.step(before.between(raw));
        }
        self.before = Some((raw, line.odom_from_base));
        line
    }

    fn step(&mut self, moved: Pose2) -> Pose2 {
        let varied = self.varied;
        if varied.way_extra == 0.0 && varied.drift_rad_per_m == 0.0 && varied.wheel_noise == [0.0; 3] {
            return moved;
        }
        let (way, turn) = (moved.x_m.hypot(moved.y_m), moved.yaw_rad.abs());
        let [rad_per_m, rad_per_rad, m_per_m] = varied.wheel_noise;
        let stretch = 1.0 + varied.way_extra + m_per_m * self.noise.normal();
        let aside = rad_per_m * way * self.noise.normal() + rad_per_rad * turn * self.noise.normal();
        let yaw_rad = wrap_angle(moved.yaw_rad + varied.drift_rad_per_m * way + aside);
        Pose2::new(stretch * moved.x_m, stretch * moved.y_m, yaw_rad)
    }
}
