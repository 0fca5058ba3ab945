//! Figures of a run over time, a bounded number of samples.

use crate::html::{Page, Row};
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
    /// Forward velocity commanded, m/s; 0 if nobody drives.
    pub linear_m_s: Vec<f64>,
    /// Commanded turning rate, rad/s.
    pub angular_rad_s: Vec<f64>,
    /// Where its map lies in the merged map at the end: x m, y m, yaw rad; `None` if it is not merged.
    pub map_from_robot_map: Option<[f64; 3]>,
}

impl RobotSeries {
    fn is_driven(&self, sample: usize) -> bool {
        [&self.linear_m_s, &self.angular_rad_s].iter().any(|of| of.get(sample).is_some_and(|v| *v != 0.0))
    }
}

/// How long a robot was driven, by the figures of each second, and what it was commanded.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DrivenTime {
    /// Time in which it was commanded to move, seconds.
    pub driven_s: f64,
    /// Commanded distance, metres.
    pub distance_m: f64,
    /// Commanded angle of turning, radians.
    pub turned_rad: f64,
}

/// How the operator's time was spent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TeleoperationProfile {
    /// Each robot's part.
    pub robots: Vec<DrivenTime>,
    /// How often another robot was driven than the one before.
    pub switches: u64,
}

/// Adds the table of the teleoperation: time of each robot, mean speeds, switches. Says so if nobody drove.
pub fn add_teleoperation(page: &mut Page, series: &Series) {
    let profile = series.teleoperation();
    let sum: f64 = profile.robots.iter().map(|robot| robot.driven_s).sum();
    if sum <= 0.0 {
        page.paragraph("Teleoperation: no data, nobody drove");
        return;
    }
    let row = |(robot, driven): (&RobotSeries, &DrivenTime)| -> Row {
        let mean = |value: f64| {
            if driven.driven_s > 0.0 { format!("{:.3}", value / driven.driven_s) } else { "no data".into() }
        };
        vec![
            robot.robot.clone(),
            format!("{:.0}", driven.driven_s),
            format!("{:.1}", 100.0 * driven.driven_s / sum),
            mean(driven.distance_m),
            mean(driven.turned_rad),
        ]
    };
    let heads = ["teleoperation", "driven, s", "share, %", "mean speed, m/s", "mean turning rate, rad/s"];
    page.table(&heads, &series.robots.iter().zip(&profile.robots).map(row).collect::<Vec<_>>());
    page.paragraph(&format!(
        "{} switches between robots. From the velocities that the robots were given, read once a second over the whole run: \
         shorter moves are missed.",
        profile.switches
    ));
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
    /// How the operator's time was spent, by the figures of each second: also of those that are no samples any more.
    #[serde(skip)]
    teleoperation: TeleoperationProfile,
    /// Time of the newest figures, and the robot that was driven last, by its index.
    #[serde(skip)]
    newest_s: Option<f64>,
    #[serde(skip)]
    driven_last: Option<usize>,
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
        let commanded = |index| {
            let command = commands(index).filter(|(_, age_s)| *age_s < COMMAND_AGE_MAX_S);
            command.map_or([0.0, 0.0], |(command, _)| [command.linear_m_s, command.angular_rad_s])
        };
        let commanded: Vec<[f64; 2]> = (0..fleet.robots.len()).map(commanded).collect();
        self.count_teleoperation(fleet.time_s, &commanded);
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
        for ((series, robot), [linear, angular]) in self.robots.iter_mut().zip(&fleet.robots).zip(commanded) {
            series.robot.clone_from(&robot.robot);
            series.known_m2.push(known_m2(&robot.map).unwrap_or(0.0));
            series.scan_hz.push(robot.scan_hz_last_second);
            series.pose.push(robot.pose);
            series.linear_m_s.push(linear);
            series.angular_rad_s.push(angular);
        }
        if self.time_s.len() >= SAMPLES_MAX {
            self.thin();
        }
    }

    /// Returns each robot's name, and its number in the samples in which it was driven.
    pub fn driven(&self) -> Vec<(String, Vec<Option<f64>>)> {
        let of_robot = |(index, robot): (usize, &RobotSeries)| {
            let samples = 0..self.time_s.len();
            let number = samples.map(|sample| robot.is_driven(sample).then_some((index + 1) as f64));
            (robot.robot.clone(), number.collect())
        };
        self.robots.iter().enumerate().map(of_robot).collect()
    }

    /// Returns how the operator's time was spent.
    pub fn teleoperation(&self) -> &TeleoperationProfile {
        &self.teleoperation
    }

    /// Counts what the robots were `commanded`, in m/s and rad/s, for the time since the figures before.
    fn count_teleoperation(&mut self, time_s: f64, commanded: &[[f64; 2]]) {
        let profile = &mut self.teleoperation;
        profile.robots.resize(commanded.len(), DrivenTime::default());
        // What was commanded before the first figures is not known.
        let Some(before_s) = self.newest_s.replace(time_s) else { return };
        let lasted_s = (time_s - before_s).max(0.0);
        let is_driven = |[linear, angular]: &[f64; 2]| *linear != 0.0 || *angular != 0.0;
        for (driven, commanded) in
            profile.robots.iter_mut().zip(commanded).filter(|(_, commanded)| is_driven(commanded))
        {
            driven.driven_s += lasted_s;
            driven.distance_m += commanded[0].abs() * lasted_s;
            driven.turned_rad += commanded[1].abs() * lasted_s;
        }
        let mut now = (0..commanded.len()).filter(|robot| is_driven(&commanded[*robot]));
        // Several that are driven at once are no switch between them.
        if let (Some(robot), None) = (now.next(), now.next()) {
            profile.switches += u64::from(self.driven_last.is_some_and(|last| last != robot));
            self.driven_last = Some(robot);
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
    fn the_operators_time_is_divided_among_the_robots_and_switches_are_counted() {
        let mut stats: Box<FleetStats> = bytemuck::allocation::zeroed_box();
        stats.robot_count = 2;
        let mut series = Series::default();
        // Nobody, three seconds robot 1, a second nobody, two seconds robot 2, a second robot 1, a second both.
        for (second, driven) in [0, 1, 1, 1, 0, 2, 2, 1, 3].into_iter().enumerate() {
            stats.header.stamp = Stamp::from_seconds(second as f64);
            series.add(&FleetView::new(&stats), |robot| {
                let linear_m_s = if driven >> robot & 1 == 1 { 0.2 } else { 0.0 };
                Some((VelocityCommand { linear_m_s, ..VelocityCommand::default() }, 0.0))
            });
        }
        let profile = series.teleoperation();
        assert_eq!(profile.switches, 2);
        let driven_s: Vec<f64> = profile.robots.iter().map(|robot| robot.driven_s).collect();
        assert_eq!(driven_s, [5.0, 3.0]);
        assert!((profile.robots[0].distance_m - 1.0).abs() < 1e-9);
        let mut page = Page::part();
        add_teleoperation(&mut page, &series);
        let html = page.into_part();
        assert!(html.contains("62.5") && html.contains("2 switches"), "{html}");
        let mut page = Page::part();
        add_teleoperation(&mut page, &Series::default());
        assert!(page.into_part().contains("no data"));
    }

    /// A run of any length counts each second in which somebody drives, and each switch, though samples are thinned.
    #[test]
    fn teleoperation_is_counted_over_all_seconds_of_a_long_run() {
        for case in 0..16 {
            // Turns of one to three seconds, of nobody or a robot.
            let turns = (0..8).map(|turn| ((turn * 7 + case) % 3, 1 + (turn * 5 + case) % 3));
            let pattern: Vec<usize> = turns.flat_map(|(robot, s)| std::iter::repeat_n(robot, s)).collect();
            let seconds = 3_000 + 397 * case;
            let driven: Vec<usize> = pattern.iter().copied().cycle().take(seconds).collect();
            let mut stats: Box<FleetStats> = bytemuck::allocation::zeroed_box();
            stats.robot_count = 2;
            let mut series = Series::default();
            for (second, driven) in driven.iter().enumerate() {
                stats.header.stamp = Stamp::from_seconds(second as f64);
                series.add(&FleetView::new(&stats), |robot| {
                    let linear_m_s = if *driven == robot + 1 { 0.2 } else { 0.0 };
                    Some((VelocityCommand { linear_m_s, ..VelocityCommand::default() }, 0.0))
                });
            }
            assert!(series.time_s.len() < SAMPLES_MAX);
            let profile = series.teleoperation();
            for (robot, of) in profile.robots.iter().enumerate() {
                // The first figures only begin the time.
                let expected = driven[1..].iter().filter(|driven| **driven == robot + 1).count() as f64;
                assert!((of.driven_s - expected).abs() < 1e-6, "{} for {expected}", of.driven_s);
                assert!((of.distance_m - 0.2 * expected).abs() < 1e-6);
            }
            let mut of_robots: Vec<usize> =
                driven[1..].iter().copied().filter(|driven| *driven > 0).collect();
            of_robots.dedup();
            assert_eq!(profile.switches, of_robots.len().saturating_sub(1) as u64);
        }
    }

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
