//! Figures of a run over time, a bounded number of samples.

use crate::view::{FleetView, MapView};
use msg::{MapTransforms, VelocityCommand};
use serde::Serialize;

/// Most samples: 34 minutes at 1 Hz. Then every second one makes way, and the rate halves.
const SAMPLES_MAX: usize = 2048;
/// Age at which a velocity counts no longer, seconds: the robot stands by then.
const COMMAND_AGE_MAX_S: f64 = 0.5;

/// Figures of one robot, a value for each sample.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RobotSeries {
    /// Name of the robot.
    pub robot: String,
    /// Known area of its map, square metres.
    pub known_m2: Vec<f64>,
    /// Scans that SLAM received in the second before, Hz.
    pub scan_hz: Vec<f64>,
    /// Pose in its map: x m, y m, yaw rad; `None` before the first scan.
    pub pose: Vec<Option<[f64; 3]>>,
    /// Forward velocity that it was told, m/s; 0 if nobody drives.
    pub linear_m_s: Vec<f64>,
    /// Turning rate that it was told, rad/s.
    pub angular_rad_s: Vec<f64>,
    /// Where its map lies in the merged map at the end: x m, y m, yaw rad; `None` if it is not merged.
    pub map_from_robot_map: Option<[f64; 3]>,
}

/// Figures of a run over time.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Series {
    /// Time since the first sample, seconds.
    pub time_s: Vec<f64>,
    /// Figures of each robot.
    pub robots: Vec<RobotSeries>,
    /// Known area of the merged map, square metres; `None` before the first.
    pub merged_m2: Vec<Option<f64>>,
    /// Known cells of the merged map over what can be known of the room, 0 to 1; `None`: not a simulation.
    pub room_coverage: Vec<Option<f64>>,
    /// Cross-instance consistency, 0 to 1; `None` without shared area.
    pub consistency: Vec<Option<f64>>,
    #[serde(skip)]
    begun_s: Option<f64>,
    /// One of this many samples is kept.
    #[serde(skip)]
    stride: usize,
    #[serde(skip)]
    seen: usize,
}

fn known_m2(map: &MapView) -> Option<f64> {
    let [free, occupied, _, total, _, _, resolution_m] = map.slam_stats;
    (total > 0.0).then_some((free + occupied) * resolution_m * resolution_m)
}

impl Series {
    /// Adds the figures of a second. `commands` are the robots' newest velocities, and `age_s` of each in seconds.
    pub fn add(&mut self, fleet: &FleetView, commands: impl Fn(usize) -> Option<(VelocityCommand, f64)>) {
        self.stride = self.stride.max(1);
        self.seen += 1;
        if !(self.seen - 1).is_multiple_of(self.stride) {
            return;
        }
        let begun_s = *self.begun_s.get_or_insert(fleet.time_s);
        self.robots.resize_with(fleet.robots.len(), RobotSeries::default);
        self.time_s.push(fleet.time_s - begun_s);
        self.merged_m2.push(known_m2(&fleet.merged_map));
        self.room_coverage.push(fleet.room_coverage);
        self.consistency.push(fleet.consistency);
        for (index, (series, robot)) in self.robots.iter_mut().zip(&fleet.robots).enumerate() {
            let command = commands(index).filter(|(_, age_s)| *age_s < COMMAND_AGE_MAX_S);
            let (linear, angular) =
                command.map_or((0.0, 0.0), |(command, _)| (command.linear_m_s, command.angular_rad_s));
            series.robot.clone_from(&robot.robot);
            series.known_m2.push(known_m2(&robot.map).unwrap_or(0.0));
            series.scan_hz.push(robot.scan_hz_last_second);
            series.pose.push((robot.scans > 0).then_some(robot.pose));
            series.linear_m_s.push(linear);
            series.angular_rad_s.push(angular);
        }
        if self.time_s.len() >= SAMPLES_MAX {
            self.thin();
        }
    }

    /// Sets where the robots' maps lie in the merged map.
    pub fn set_map_transforms(&mut self, transforms: &MapTransforms) {
        for (series, transform) in self.robots.iter_mut().zip(&transforms.robots) {
            series.map_from_robot_map = transform.known_pose().map(|pose| [pose.x_m, pose.y_m, pose.yaw_rad]);
        }
    }

    /// Removes every second sample.
    fn thin(&mut self) {
        self.stride *= 2;
        halve(&mut self.time_s);
        halve(&mut self.merged_m2);
        halve(&mut self.room_coverage);
        halve(&mut self.consistency);
        for robot in &mut self.robots {
            halve(&mut robot.known_m2);
            halve(&mut robot.scan_hz);
            halve(&mut robot.pose);
            halve(&mut robot.linear_m_s);
            halve(&mut robot.angular_rad_s);
        }
    }
}

fn halve<T>(values: &mut Vec<T>) {
    let mut index = 0;
    values.retain(|_| {
        index += 1;
        index % 2 == 1
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::{FleetStats, Stamp};

    #[test]
    fn a_long_run_has_a_bounded_number_of_samples_over_all_of_its_time() {
        let mut stats: Box<FleetStats> = bytemuck::allocation::zeroed_box();
        stats.robot_count = 2;
        let mut series = Series::default();
        for second in 0..10_000 {
            stats.header.stamp = Stamp::from_seconds(f64::from(second));
            series.add(&FleetView::new(&stats), |_| None);
        }
        assert!(series.time_s.len() < SAMPLES_MAX, "{}", series.time_s.len());
        assert_eq!(series.time_s[0], 0.0);
        assert!(*series.time_s.last().unwrap() > 9_900.0);
        let steps: Vec<f64> = series.time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(steps.iter().all(|step| (step - steps[0]).abs() < 1e-6), "evenly");
        assert_eq!(series.robots[1].scan_hz.len(), series.time_s.len());
        assert!(series.merged_m2.iter().all(Option::is_none), "no map is no data, and not 0 m2");
    }
}
