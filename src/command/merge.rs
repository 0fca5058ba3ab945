//! Tool `mr-slam merge`, which merges map files of robots that started anywhere.

use super::output;
use crate::run::{RunError, check_output};
use formats::map_file::{self, MapFileError, read_map_with_reasons, write_map_with_reasons};
use formats::overwriting::replaced_input;
use merge::{AlignConfig, Alignment, MapRejected, MergeConfig, Merger, align};
use msg::{AlignmentRefusal, Grid, GridHeader, GridView, Pose2, ROBOTS_MAX, RobotId};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Merge map files of robots that started anywhere
#[derive(clap::Args, Clone, Debug)]
pub struct MergeArgs {
    /// Map files of map_server; the result has the first one's frame
    #[arg(value_name = "MAP.yaml", required = true, num_args = 2..)]
    pub maps: Vec<PathBuf>,
    /// File for the merged map: FILE.yaml with its PGM, and a PNG
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Print JSON: one object a line for each map but the first
    #[arg(long)]
    pub json: bool,
}

/// Longest reason why the merged map is unreliable, characters: those of a whole fleet fit into a map's YAML file.
const REASON_CHARS_MAX: usize = 500;

/// Reason why maps could not be merged.
#[derive(Debug, thiserror::Error)]
pub enum MergeMapsError {
    /// A map cannot be read.
    #[error(transparent)]
    Input(MapFileError),
    /// The merged map cannot be written.
    #[error(transparent)]
    File(MapFileError),
    /// The merger refuses a map.
    #[error("{}: {why}", file.display())]
    Refused {
        /// Path of the map's YAML file.
        file: PathBuf,
        /// Reason of the merger.
        why: MapRejected,
    },
    /// No map has found its place.
    #[error("none of the other maps could be placed in {}: nothing is merged, and no file is written", first.display())]
    NothingMerged {
        /// Path of the first map.
        first: PathBuf,
    },
    /// The result would replace one of the maps.
    #[error("--out: {} belongs to a map that is merged; nothing is merged or written; expected another name", file.display())]
    Overwrites {
        /// Path of the file.
        file: PathBuf,
    },
    /// The result would lie in the folder of a running fleet.
    #[error("--out: {0}")]
    Output(#[from] Box<RunError>),
    /// More maps than robots in the largest fleet.
    #[error("{0} maps; expected 2 to {ROBOTS_MAX}")]
    TooMany(usize),
    /// The result cannot be written to standard output.
    #[error(transparent)]
    Print(#[from] std::io::Error),
}

/// Reason where no place of a map was found that could be judged.
const NO_COMMON_WALLS: &str = "no common walls found";

/// Best alignment of a map with the merged one, accepted or not.
struct Place {
    alignment: Option<Alignment>,
    /// Duration of the newest attempt, milliseconds.
    ms: f64,
}

impl Place {
    fn accepted(&self) -> Option<&Alignment> {
        self.alignment.as_ref().filter(|alignment| alignment.accepted)
    }
}

/// Merges the map files and prints where each lies.
pub fn run(args: &MergeArgs) -> Result<(), MergeMapsError> {
    if args.maps.len() > ROBOTS_MAX {
        return Err(MergeMapsError::TooMany(args.maps.len()));
    }
    let out = args.out.as_deref().map(map_file::stem);
    if let Some(out) = &out {
        check_output(out).map_err(Box::new)?;
        check_inputs_stay(&args.maps, out)?;
    }
    let maps = args.maps.iter().map(|yaml| read_map_with_reasons(yaml)).collect::<Result<Vec<_>, _>>();
    let maps = maps.map_err(MergeMapsError::Input)?;
    let (maps, reasons): (Vec<Grid>, Vec<Vec<String>>) = maps.into_iter().unzip();
    let frame_from_lattice = maps[0].header.origin;
    let mut merger = start(args, &maps)?;
    let places = place_all(args, &maps, &mut merger)?;
    for (yaml, place) in args.maps.iter().zip(&places).skip(1) {
        let Some(place) = place else { continue };
        let name = yaml.display().to_string();
        let line = if args.json { as_json(&name, place).to_string() } else { as_text(&name, place) };
        output::print(&(line + "\n"))?;
    }
    let refused = places.iter().flatten().filter(|place| place.accepted().is_none()).count();
    if refused + 1 == maps.len() {
        return Err(MergeMapsError::NothingMerged { first: args.maps[0].clone() });
    }
    if refused > 0 {
        output::note(&format!("{refused} of {} maps have no place and are left out", maps.len()));
    }
    let reasons = reasons_of_merged(&args.maps, &reasons, &places);
    for reason in &reasons {
        output::note(&format!("the merged map is unreliable: {reason}"));
    }
    if let Some(out) = &out {
        let merged = merger.merged();
        let origin = frame_from_lattice * merged.header.origin;
        let header = GridHeader { origin, ..*merged.header };
        let reasons: Vec<&str> = reasons.iter().map(String::as_str).collect();
        write_map_with_reasons(out, GridView { header: &header, cells: merged.cells }, &reasons)
            .map_err(MergeMapsError::File)?;
    }
    Ok(())
}

/// Refuses a result that would replace a file of the maps.
fn check_inputs_stay(maps: &[PathBuf], out: &Path) -> Result<(), MergeMapsError> {
    let read = maps.iter().map(|yaml| map_file::read_files(yaml)).collect::<Result<Vec<_>, _>>();
    let read = read.map_err(MergeMapsError::Input)?;
    match replaced_input(&map_file::written_files(out), read.as_flattened()) {
        Some(file) => Err(MergeMapsError::Overwrites { file }),
        None => Ok(()),
    }
}

/// Returns why the merged map is unreliable: the reasons of the maps that are in it, each with its file.
fn reasons_of_merged(files: &[PathBuf], reasons: &[Vec<String>], places: &[Option<Place>]) -> Vec<String> {
    // The first map has no place: it is where the others are laid.
    let is_in = |place: &Option<Place>| place.as_ref().is_none_or(|place| place.accepted().is_some());
    let merged = files.iter().zip(reasons).zip(places).filter(|(_, place)| is_in(place));
    let with_reasons = merged.filter(|((_, reasons), _)| !reasons.is_empty());
    let reason = |((file, reasons), _): ((&PathBuf, &Vec<String>), _)| {
        let name = file.file_name().unwrap_or(file.as_os_str()).to_string_lossy();
        format!("{name}: {}", reasons.join("; ")).chars().take(REASON_CHARS_MAX).collect()
    };
    with_reasons.map(reason).collect()
}

/// Creates a merger with all maps, of which the first has a place: its cells are those of the merged map, so that it is
/// not resampled. The merger's frame is the first map's grid.
fn start(args: &MergeArgs, maps: &[Grid]) -> Result<Merger, MergeMapsError> {
    let config = MergeConfig { resolution_m: maps[0].header.resolution_m, ..MergeConfig::default() };
    let mut starts = vec![None; maps.len()];
    starts[0] = Some(maps[0].header.origin.inverse());
    let mut merger = Merger::new(&config, &starts);
    for ((robot, map), yaml) in RobotId::first(maps.len()).zip(maps).zip(&args.maps) {
        merger
            .update_map(robot, map.view())
            .map_err(|why| MergeMapsError::Refused { file: yaml.clone(), why })?;
    }
    Ok(merger)
}

/// Aligns each map but the first with the merged map; refused ones again whenever the merged map has grown.
fn place_all(
    args: &MergeArgs,
    maps: &[Grid],
    merger: &mut Merger,
) -> Result<Vec<Option<Place>>, MergeMapsError> {
    let mut places: Vec<Option<Place>> = maps.iter().map(|_| None).collect();
    loop {
        let mut grown = false;
        for (robot, map) in RobotId::first(maps.len()).zip(maps).skip(1) {
            if places[robot.index()].as_ref().is_some_and(|place| place.accepted().is_some()) {
                continue;
            }
            let began = Instant::now();
            let alignment = align(merger.merged(), map.view(), &AlignConfig::default());
            let first_from_map = |found: &Alignment| maps[0].header.origin * found.a_from_b;
            let in_lattice = alignment.as_ref().map(|found| found.a_from_b);
            let alignment = alignment.map(|found| Alignment { a_from_b: first_from_map(&found), ..found });
            let place = Place { alignment, ms: began.elapsed().as_secs_f64() * 1e3 };
            if place.accepted().is_some() {
                let file = || args.maps[robot.index()].clone();
                merger
                    .set_map_transform(robot, in_lattice)
                    .map_err(|why| MergeMapsError::Refused { file: file(), why })?;
                grown = true;
            }
            places[robot.index()] = Some(place);
        }
        if !grown {
            return Ok(places);
        }
    }
}

/// Formats the alignment as JSON: p_a = R(theta) p_b + (x, y), metres and radians.
fn as_json(name: &str, place: &Place) -> serde_json::Value {
    let Some(found) = &place.alignment else {
        return json!({
            "map": name, "accepted": false, "refusal": NO_COMMON_WALLS, "inliers": 0, "occupied_f1": 0.0, "ms": place.ms,
        });
    };
    json!({
        "map": name,
        "accepted": found.accepted,
        "refusal": found.refusal.map(AlignmentRefusal::text),
        "x": found.a_from_b.x_m,
        "y": found.a_from_b.y_m,
        "theta": found.a_from_b.yaw_rad,
        "inliers": found.inliers,
        "occupied_f1": found.occupied_f1,
        "ms": place.ms,
        "agreement": found.agreement,
        "conflict": found.conflict,
        "overlap_m2": found.overlap_m2,
        "overlap_share": found.overlap_share,
        "residual_m": found.residual_m,
        "margin": found.margin,
        "short_walls_margin": found.short_walls_margin,
        "observability": found.observability,
    })
}

fn as_text(name: &str, place: &Place) -> String {
    let Some(found) = &place.alignment else {
        return format!("{name}: refused: {NO_COMMON_WALLS} ({:.0} ms)", place.ms);
    };
    let Pose2 { x_m, y_m, yaw_rad } = found.a_from_b;
    let evidence = format!(
        "{} matching cells, F1 {:.2}, agreement {:.1} %, conflict {:.1} %, {:.0} m2 shared, {:.1} times the next best place, {:.0} ms",
        found.inliers,
        found.occupied_f1,
        100.0 * found.agreement,
        100.0 * found.conflict,
        found.overlap_m2,
        found.margin,
        place.ms
    );
    let outcome = match found.refusal {
        None => "lies at".into(),
        Some(refusal) => format!("refused, {}; the best place would be", refusal.text()),
    };
    format!("{name}: {outcome} x {x_m:.3} m, y {y_m:.3} m, {:.2} degrees ({evidence})", yaw_rad.to_degrees())
}

#[cfg(test)]
mod tests {
    use super::*;
    use formats::map_file::{read_map, write_map};

    /// Map of one house between columns `from` and `to`, in a frame of its own.
    fn part(from: i64, to: i64, origin: Pose2) -> Grid {
        let stands = |x: i64, y: i64| {
            let outer = x == 0 || x == 299 || y == 0 || y == 199;
            let inner =
                (x == 110 && !(60..78).contains(&y)) || (y == 120 && x > 110 && !(190..208).contains(&x));
            let furniture = [
                (20..52, 30..44),
                (150..190, 20..38),
                (230..245, 60..90),
                (130..150, 160..185),
                (60..66, 130..170),
            ];
            outer
                || inner
                || furniture.iter().any(|(across, along)| across.contains(&x) && along.contains(&y))
        };
        let cells =
            (0..200).flat_map(|y| (from..to).map(move |x| if stands(x, y) { 60 } else { -60 })).collect();
        let header = GridHeader {
            origin,
            resolution_m: 0.05,
            width: (to - from) as u32,
            height: 200,
            ..Default::default()
        };
        Grid { header, cells }
    }

    #[test]
    fn two_halves_of_a_house_become_one_map() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        write_map(&path("a"), part(0, 200, Pose2::new(-2.0, 1.0, 0.0)).view()).unwrap();
        write_map(&path("b"), part(80, 300, Pose2::new(5.0, -3.0, 0.9)).view()).unwrap();
        let args = MergeArgs {
            maps: vec![path("a.yaml"), path("b.yaml")],
            out: Some(path("whole.yaml")),
            json: true,
        };
        run(&args).unwrap();
        let whole = read_map(&path("whole.yaml")).unwrap();
        // 15 m x 10 m, give or take the border cells of the turned half.
        assert!((298..=304).contains(&whole.header.width), "{:?}", whole.header);
        assert!((198..=204).contains(&whole.header.height), "{:?}", whole.header);
        let known = msg::grid::known_count(&whole.cells);
        assert!((58_000..62_000).contains(&known), "{known}");
    }

    #[test]
    fn the_merged_map_says_which_of_its_maps_is_unreliable() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        write_map(&path("a"), part(0, 200, Pose2::IDENTITY).view()).unwrap();
        write_map_with_reasons(&path("b"), part(80, 300, Pose2::IDENTITY).view(), &["walls moved", "lost"])
            .unwrap();
        // A map without a place in the merged one does not count.
        let empty = Grid { cells: vec![-60; 200 * 200], ..part(0, 200, Pose2::IDENTITY) };
        write_map_with_reasons(&path("c"), empty.view(), &["empty"]).unwrap();
        let maps = ["a.yaml", "b.yaml", "c.yaml"].map(path).to_vec();
        run(&MergeArgs { maps, out: Some(path("whole")), json: true }).unwrap();
        let (_, reasons) = read_map_with_reasons(&path("whole.yaml")).unwrap();
        assert_eq!(reasons, ["b.yaml: walls moved; lost"]);
    }

    #[test]
    fn maps_that_have_no_place_are_an_error_and_make_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        write_map(&path("a"), part(0, 200, Pose2::IDENTITY).view()).unwrap();
        let empty = Grid { cells: vec![-60; 200 * 200], ..part(0, 200, Pose2::IDENTITY) };
        write_map(&path("b"), empty.view()).unwrap();
        let maps = ["a.yaml", "b.yaml"].map(path).to_vec();
        let why = run(&MergeArgs { maps, out: Some(path("whole")), json: true }).unwrap_err().to_string();
        assert!(why.contains("nothing is merged") && why.contains("no file is written"), "{why}");
        assert!(!path("whole.yaml").exists());
    }

    #[test]
    fn a_result_that_would_replace_a_file_of_the_maps_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        write_map(&path("a"), part(0, 200, Pose2::IDENTITY).view()).unwrap();
        write_map(&path("b"), part(80, 300, Pose2::IDENTITY).view()).unwrap();
        // A map whose image has another name.
        let yaml = std::fs::read_to_string(path("b.yaml")).unwrap().replace("b.pgm", "c.png");
        std::fs::write(path("b.yaml"), yaml).unwrap();
        std::fs::rename(path("b.png"), path("c.png")).unwrap();
        let content = |name: &str| std::fs::read(path(name)).unwrap();
        let before = ["a.yaml", "a.pgm", "c.png"].map(content);
        for out in ["a", "a.yaml", "b", "c"] {
            let maps = ["a.yaml", "b.yaml"].map(path).to_vec();
            let why = run(&MergeArgs { maps, out: Some(path(out)), json: true }).unwrap_err().to_string();
            assert!(why.contains("--out") && why.contains("another name"), "{out}: {why}");
        }
        assert_eq!(["a.yaml", "a.pgm", "c.png"].map(content), before);
        assert!(!path("c.yaml").exists());
    }

    #[test]
    fn a_map_merged_with_itself_is_that_map() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        // Neither a whole number of cells nor a right angle from the frame's origin.
        let origin = Pose2::new(-2.013, 1.021, 0.3);
        write_map(&path("a"), part(0, 300, origin).view()).unwrap();
        let map = read_map(&path("a.yaml")).unwrap();
        let maps = vec![path("a.yaml"), path("a.yaml")];
        let args = MergeArgs { maps, out: Some(path("whole.yaml")), json: true };
        let grids = [map.clone(), map.clone()];
        let mut merger = start(&args, &grids).unwrap();
        let places = place_all(&args, &grids, &mut merger).unwrap();
        let found = places[1].as_ref().and_then(Place::accepted).unwrap().a_from_b;
        assert!(found.distance_m(Pose2::IDENTITY) < 1e-3 && found.yaw_rad.abs() < 1e-4, "{found:?}");
        run(&args).unwrap();
        let whole = read_map(&path("whole.yaml")).unwrap();
        for (x, y) in [(0, 0), (110, 100), (299, 199), (20, 31), (170, 60)] {
            let at = map.view().centre_m(x, y);
            let (u, v) = whole.view().cell_of(at);
            assert!((whole.view().cell(u, v) > 0) == (map.view().cell(x, y) > 0), "cell {x}, {y}");
            let [p, q] = whole.view().centre_m(u, v);
            assert!((p - at[0]).hypot(q - at[1]) < 1e-3, "cell {x}, {y} lies elsewhere");
        }
    }

    #[test]
    fn a_map_without_a_place_has_the_reason_in_json() {
        let none = as_json("b.yaml", &Place { alignment: None, ms: 1.0 });
        assert_eq!(none["refusal"], "no common walls found", "{none}");
        assert_eq!(none["accepted"], false);
    }

    #[test]
    fn says_which_map_is_missing() {
        let args = MergeArgs {
            maps: vec![PathBuf::from("nowhere/a.yaml"), PathBuf::from("nowhere/b.yaml")],
            out: None,
            json: false,
        };
        assert!(run(&args).unwrap_err().to_string().contains("nowhere/a.yaml"));
    }
}
