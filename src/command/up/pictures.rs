//! The report of a run as HTML: maps, plots and tables.

use super::report::Report;
use super::system::add_system;
use crate::config::FleetConfig;
use crate::observer::Observer;
use crate::process::record::description::machine;
use msg::{GridView, Pose2};
use reports::{FleetView, Line, Page, RobotView, Row, Series, Trail};
use reports::{add_teleoperation, add_workload, colour, line_plot, map_picture, quantile_plot};

/// Longer sides of the pictures of the merged map and of a robot's map, pixels.
const MERGED_MAP_PX: f64 = 720.0;
const ROBOT_MAP_PX: f64 = 440.0;

/// Maps of a run as pictures.
#[derive(Clone, Debug, Default)]
pub struct Pictures {
    /// Robots' maps: name and SVG.
    robots: Vec<(String, String)>,
    /// The merged map; empty if there is none.
    merged: Option<String>,
    /// What ran, as a part of a page.
    system: String,
}

impl Pictures {
    /// Draws all maps with the ways of the robots.
    pub fn of_maps(config: &FleetConfig, observer: &Observer, series: &mut Series) -> Self {
        if let Some(transforms) = observer.map_transforms() {
            series.set_map_transforms(transforms);
        }
        let mut pictures = Self::new(config);
        observer.show_maps(|name, map| pictures.add(name, map, series));
        pictures
    }

    /// Begins without maps.
    pub fn new(config: &FleetConfig) -> Self {
        let mut system = Page::part();
        add_system(&mut system, config);
        Self { system: system.into_part(), ..Self::default() }
    }

    /// Draws a map by its name, such as `robot1_map`, with the ways of its robots.
    pub fn add(&mut self, name: &str, map: GridView<'_>, series: &Series) {
        let own = series.robots.iter().position(|robot| format!("{}_map", robot.robot) == name);
        match own {
            Some(index) => {
                let trail = trail(series, index, Pose2::new(0.0, 0.0, 0.0));
                let title = format!("map of {}", series.robots[index].robot);
                self.robots.push((
                    series.robots[index].robot.clone(),
                    map_picture(&title, map, &[trail], ROBOT_MAP_PX),
                ));
            }
            None => {
                let merged = series.robots.iter().enumerate();
                let trails = merged.filter_map(|(index, robot)| {
                    let [x, y, yaw] = robot.map_from_robot_map?;
                    Some(trail(series, index, Pose2::new(x, y, yaw)))
                });
                let trails: Vec<Trail> = trails.collect();
                self.merged = Some(map_picture("merged map", map, &trails, MERGED_MAP_PX));
            }
        }
    }
}

impl Pictures {
    /// Adds the maps to a page.
    pub fn add_to(&self, page: &mut Page) {
        if self.merged.is_none() && self.robots.is_empty() {
            page.paragraph("no data: no map came");
            return;
        }
        let merged = self.merged.iter().map(|picture| ("merged".to_owned(), picture.clone()));
        page.pictures(&merged.collect::<Vec<_>>());
        page.pictures(&self.robots);
        page.paragraph(
            "White is free, black is occupied, grey is unknown. Lines are the ways of the robots by SLAM, circles are where \
             they are at the end.",
        );
    }
}

fn trail(series: &Series, index: usize, map_from_robot_map: Pose2) -> Trail {
    let robot = &series.robots[index];
    let poses = robot.pose.iter().flatten().map(|[x, y, yaw]| {
        let pose = map_from_robot_map * Pose2::new(*x, *y, *yaw);
        [pose.x_m, pose.y_m, pose.yaw_rad]
    });
    Trail { name: robot.robot.clone(), colour: colour(index), poses: poses.collect() }
}

/// Returns the report as one HTML file.
pub fn write_html(report: &Report) -> String {
    let title = format!("{:.0} s in {}", report.seconds, report.room);
    let subtitle = format!("seed {}, version {}, {}", report.seed, env!("CARGO_PKG_VERSION"), machine());
    let mut page = Page::new(&title, &subtitle);
    if let Some(paper) = &report.paper {
        page.heading("Figures of the paper");
        let mut rows: Vec<Row> = paper.rows().into_iter().map(|row| with_dashes(row.into())).collect();
        rows.extend(paper.teleoperation.map(|driven| {
            let text = format!(
                "{} turns, {:.1} m driven, {:.1} commands/s",
                driven.turns, driven.driven_m, driven.commands_hz
            );
            with_dashes(vec!["teleoperation".into(), text, String::new()])
        }));
        page.table(&["", "this run", "the paper"], &rows);
        page.paragraph(
            "The paper is Aryan et al., MR-SLAM, University of Bern. Its robots were driven over Wi-Fi; a comparison with a \
             fleet on one machine is not like for like.",
        );
    }
    page.heading("Maps");
    report.pictures.add_to(&mut page);
    page.heading("Over time");
    add_plots(&mut page, &report.series, report.fleet.as_ref());
    if let Some(fleet) = &report.fleet {
        add_robots(&mut page, fleet, report);
    }
    add_workload(&mut page, &report.nasa_tlx);
    page.add_part(&report.pictures.system);
    let events = &report.events.events;
    if !events.is_empty() {
        page.heading("Events");
        let row = |event: &reports::Event| vec![format!("{:.1}", event.at_s), event.event.clone()];
        let rows: Vec<Row> = events.iter().map(row).collect();
        page.table(&["time, s", "event"], &rows);
    }
    page.finish()
}

fn with_dashes(row: Row) -> Row {
    row.into_iter().map(|cell| if cell.is_empty() { "–".into() } else { cell }).collect()
}

/// Adds the plots over time and of jitter.
pub fn add_plots(page: &mut Page, series: &Series, fleet: Option<&FleetView>) {
    let time = &series.time_s;
    let of_robots = |values: fn(&reports::RobotSeries) -> &Vec<f64>| -> Vec<Line> {
        let robots = series.robots.iter().enumerate();
        let line = |(index, robot): (usize, &reports::RobotSeries)| {
            Line::new(&robot.robot, colour(index), time, values(robot).iter().copied().map(Some))
        };
        robots.map(line).collect()
    };
    let mut areas = of_robots(|robot| &robot.known_m2);
    areas.push(Line::new("merged", [40, 40, 40], time, series.merged_m2.iter().copied()));
    let percent = |values: &[Option<f64>]| -> Vec<Option<f64>> {
        values.iter().map(|value| value.map(|share| 100.0 * share)).collect()
    };
    let agreement = [
        Line::new("known of the room", [40, 40, 40], time, percent(&series.room_coverage).into_iter()),
        Line::new("consistency", [40, 120, 220], time, percent(&series.consistency).into_iter()),
    ];
    let mut plots = vec![
        line_plot("Known area", "m²", &areas),
        line_plot("Coverage of the room, agreement of the maps", "%", &agreement),
        line_plot("Scans received by SLAM", "Hz", &of_robots(|robot| &robot.scan_hz)),
    ];
    plots.extend(fleet.map(|fleet| {
        let group = |(index, robot): (usize, &RobotView)| {
            let jitter = &robot.tf_jitter_ms;
            let values = [jitter.p50, jitter.p95, jitter.p99].map(|value| value.map(f64::from));
            (robot.robot.clone(), colour(index), values.to_vec())
        };
        let groups: Vec<_> = fleet.robots.iter().enumerate().map(group).collect();
        quantile_plot("Jitter of transforms", "ms", &["median", "95 %", "99 %"], &groups)
    }));
    plots.push(line_plot("Teleoperation: forward velocity", "m/s", &of_robots(|robot| &robot.linear_m_s)));
    plots.push(line_plot("Teleoperation: turning rate", "rad/s", &of_robots(|robot| &robot.angular_rad_s)));
    let driven = series
        .driven()
        .into_iter()
        .enumerate()
        .map(|(index, (name, values))| Line::new(&name, colour(index), time, values.into_iter()));
    plots.push(line_plot("Teleoperation: robot that is driven", "robot", &driven.collect::<Vec<_>>()));
    let plots: Vec<_> = plots.into_iter().map(|plot| (String::new(), plot)).collect();
    page.pictures(&plots);
    add_teleoperation(page, series);
}

fn add_robots(page: &mut Page, fleet: &FleetView, report: &Report) {
    page.heading("Robots");
    let number =
        |value: Option<f64>, digits: usize| value.map_or("no data".into(), |v| format!("{v:.digits$}"));
    let row = |(index, robot): (usize, &RobotView)| {
        let driven = report.operator.as_ref().and_then(|operator| {
            let robots = operator["robots"].as_array()?;
            robots.iter().find(|of| of["robot"].as_u64() == Some(index as u64 + 1))
        });
        let of_operator = |value: Option<f64>, digits| number(value, digits);
        let jitter = &robot.tf_jitter_ms;
        vec![
            robot.robot.clone(),
            robot.state.to_owned(),
            number(robot.scan_hz, 2),
            robot.scans_lost.map_or_else(|| "no data".into(), |lost| lost.to_string()),
            format!("{} / {}", number(jitter.p50.map(f64::from), 3), number(jitter.p95.map(f64::from), 3)),
            number(robot.scan_to_map_ms.p50.map(f64::from), 1),
            number(robot.pose_error_m, 3),
            format!("{} / {}", robot.nodes, robot.closures),
            of_operator(driven.and_then(|of| of["turns"].as_f64()), 0),
            of_operator(driven.and_then(|of| of["held_s"].as_f64()), 0),
            of_operator(driven.and_then(|of| of["did"]["driven_m"].as_f64()), 1),
        ]
    };
    let rows: Vec<Row> = fleet.robots.iter().enumerate().map(row).collect();
    let heads = [
        "robot",
        "SLAM",
        "scans, Hz",
        "lost",
        "TF jitter median / 95 %, ms",
        "scan to map, ms",
        "pose error, m",
        "nodes / closures",
        "turns",
        "held, s",
        "driven, m",
    ];
    page.table(&heads, &rows);
    fleet.counting_note().iter().for_each(|note| page.paragraph(note));
}
