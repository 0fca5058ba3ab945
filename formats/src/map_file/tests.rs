//! Round trips, and files that must be refused.

use super::*;
use proptest::prelude::*;
use std::fs;

const YAML: &str = "image: m.pgm\nmode: trinary\nresolution: 0.050000\norigin: [-1.5, 2.0, 0.25]\n\
                    negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

/// Reads a map of this YAML and this image `m.pgm`.
fn read(yaml: &str, image: &[u8]) -> Result<Grid, MapFileError> {
    let folder = folder();
    fs::write(folder.path().join("m.pgm"), image).unwrap();
    fs::write(folder.path().join("m.yaml"), yaml).unwrap();
    read_map(&folder.path().join("m.yaml"))
}

fn refusal(yaml: &str, image: &[u8]) -> String {
    read(yaml, image).expect_err("must be refused").to_string()
}

#[test]
fn reads_what_map_saver_writes() {
    let grid = read(YAML, b"P5\n# CREATOR: map_saver.cpp 0.050 m/pix\n2 2\n255\n\x00\xfe\xcd\xfe").unwrap();
    assert_eq!(grid.header.origin, Pose2::new(-1.5, 2.0, 0.25));
    assert_eq!((grid.header.width, grid.header.height, grid.header.resolution_m), (2, 2, 0.05));
    // The image's last row is the grid's first.
    assert_eq!(grid.cells, [UNKNOWN, -LOADED_LOG_ODDS, LOADED_LOG_ODDS, -LOADED_LOG_ODDS]);
    let plain = read(YAML, b"P2 2 2 255\n0 254\n205 254\n").unwrap();
    assert_eq!(plain, grid);
}

#[test]
fn greys_of_16_bits_are_read_as_those_of_8() {
    let grid = read(YAML, b"P5\n2 2\n255\n\x00\xfe\xcd\xfe").unwrap();
    // Netpbm's order: the more significant byte first. 255 steps of 257 are 65535.
    let wide = read(YAML, b"P5\n2 2\n65535\n\x00\x00\xfe\xfe\xcd\xcd\xfe\xfe").unwrap();
    assert_eq!(wide, grid);
    assert_eq!(read(YAML, b"P2 2 2 65535 0 65278 52685 65278").unwrap(), grid);
}

#[test]
fn what_nobody_has_seen_is_unknown_whatever_map_savers_free_threshold_is() {
    let yaml = YAML.replace("0.196", "0.25");
    let grid = read(&yaml, b"P5 2 2 255\n\x00\xfe\xcd\xfe").unwrap();
    assert_eq!(grid.cells, [UNKNOWN, -LOADED_LOG_ODDS, LOADED_LOG_ODDS, -LOADED_LOG_ODDS]);
    // Another program's greys mean what the thresholds say.
    let graded = read(&yaml, b"P5 2 2 255\n\x00\xfe\xcd\xc8").unwrap();
    assert_eq!(graded.cells[..2], [-LOADED_LOG_ODDS; 2]);
}

#[test]
fn a_map_of_which_one_file_cannot_be_written_leaves_the_one_before_whole() {
    let header = |x_m| GridHeader {
        width: 2,
        height: 1,
        resolution_m: 0.05,
        origin: Pose2::new(x_m, 0.0, 0.0),
        ..GridHeader::default()
    };
    for refused in ["pgm", "png", "yaml"] {
        let folder = folder();
        let stem = folder.path().join("m");
        let write = |x_m, cells: &[i8]| write_map(&stem, GridView { header: &header(x_m), cells });
        write(1.0, &[LOADED_LOG_ODDS, -LOADED_LOG_ODDS]).unwrap();
        // A folder cannot be replaced by a file, as if the disk refused it.
        let path = stem.with_extension(refused);
        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        let read = || -> Vec<_> {
            let files = written_files(&stem).into_iter().filter(|file| *file != path);
            files.map(|file| fs::read(file).unwrap()).collect()
        };
        let before = read();
        assert!(write(2.0, &[-LOADED_LOG_ODDS, LOADED_LOG_ODDS]).is_err());
        assert_eq!(read(), before, "{refused} cannot be written");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3, "no temporary file stays");
    }
}

#[test]
fn modes_and_negation() {
    let image = b"P5 4 1 255\n\x00\x32\x7f\xfe";
    let cells = |yaml: &str| read(yaml, image).unwrap().cells;
    assert_eq!(
        cells(&YAML.replace("negate: 0", "negate: true")),
        [-LOADED_LOG_ODDS, UNKNOWN, UNKNOWN, LOADED_LOG_ODDS]
    );
    let scale = cells(&YAML.replace("trinary", "scale"));
    assert_eq!((scale[0], scale[3]), (LOADED_LOG_ODDS, -LOADED_LOG_ODDS));
    assert!(scale[2] > 0 && scale[2] < LOADED_LOG_ODDS, "{scale:?}");
    assert_eq!(cells(&YAML.replace("trinary", "raw")), [-LOADED_LOG_ODDS, 0, UNKNOWN, UNKNOWN]);
}

#[test]
fn refuses_with_file_what_and_expected() {
    let image = b"P5 2 2 255\n\x00\xfe\xcd\xfe";
    for (field, found) in [
        ("image: m.pgm\n", "image"),
        ("resolution: 0.050000\n", "resolution"),
        ("origin: [-1.5, 2.0, 0.25]\n", "origin"),
        ("negate: 0\n", "negate"),
        ("occupied_thresh: 0.65\n", "occupied_thresh"),
        ("free_thresh: 0.196\n", "free_thresh"),
    ] {
        let error = refusal(&YAML.replace(field, ""), image);
        assert!(error.contains("m.yaml") && error.contains(found) && error.contains("expected"), "{error}");
    }
    for (from, to, found) in [
        ("0.050000", ".nan", "resolution"),
        ("0.050000", "-0.05", "resolution"),
        ("[-1.5, 2.0, 0.25]", "[-1.5, 2.0]", "origin"),
        ("[-1.5, 2.0, 0.25]", "[-1.5, .inf, 0.0]", "origin"),
        ("negate: 0", "negate: 7", "negate"),
        ("0.65", "0.1", "occupied_thresh"),
        ("trinary", "binary", "mode"),
        ("image: m.pgm", "image: [", "line"),
    ] {
        let error = refusal(&YAML.replace(from, to), image);
        assert!(error.contains(found), "{found}: {error}");
    }
    let error = refusal(&YAML.replace("m.pgm", "none.pgm"), image);
    assert!(error.contains("none.pgm"), "{error}");
}

#[test]
fn refuses_broken_images() {
    for (image, found) in [
        (&b"P5 2 2 255\n\x00\xfe\xcd"[..], "truncated: 3 pixels; expected 4"),
        (b"P5 4294967295 4294967295 255\n", "4294967295 x 4294967295"),
        (b"P5 99999999999999999999999 1 255\n", "no width"),
        (b"P5 0 2 255\n", "0 x 2 cells"),
        (b"P5 2 2 65536\n\0\0\0\0\0\0\0\0", "maximum grey 65536; expected 1 to 65535"),
        (b"P5 2 2 65535\n\0\0\0\0\0\0\0", "truncated: 3 pixels; expected 4"),
        (b"P5 1 1 256\n\x01\x01", "pixel 0 is 257 over the maximum grey 256"),
        (b"P2 2 2 255\n0 1 300 3", "pixel 2 is 300 over the maximum grey 255"),
        (b"P5 2", "no height"),
        (b"P5 2 2 100\n\x00\xfe\xcd\xfe", "pixel 1 is 254"),
        (b"P2 2 2 255\n0 1 x 3", "truncated: 2 pixels"),
        (b"BM", "starts with"),
        (b"", "starts with"),
        (b"\x89PNG\r\n\x1a\nnothing", "m.pgm"),
    ] {
        let error = refusal(YAML, image);
        assert!(error.contains(found), "{found}: {error}");
    }
}

#[test]
fn a_dot_in_the_stem_is_kept_and_nothing_else_is_left() {
    let folder = folder();
    let header = GridHeader { resolution_m: 0.05, width: 1, height: 1, ..Default::default() };
    let grid = Grid { header, cells: vec![100] };
    write_map(&folder.path().join("map.v1"), grid.view()).unwrap();
    let mut names: Vec<_> =
        fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["map.v1.pgm", "map.v1.png", "map.v1.yaml"]);
    let error = write_map(&folder.path().join("missing/map"), grid.view()).unwrap_err().to_string();
    assert!(error.contains("missing/map.pgm"), "{error}");
}

#[test]
fn an_unreliable_map_says_why_and_is_read_as_any_other() {
    let folder = folder();
    let header = GridHeader { resolution_m: 0.05, width: 1, height: 1, ..Default::default() };
    let grid = Grid { header, cells: vec![100] };
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    write_map(&folder.path().join("good"), grid.view()).unwrap();
    assert!(!String::from_utf8(read("good.yaml")).unwrap().contains("unreliable"));
    let reasons = ["scans see through \"walls\"", "robot2: lost"];
    write_map_with_reasons(&folder.path().join("bad"), grid.view(), &reasons).unwrap();
    let yaml = String::from_utf8(read("bad.yaml")).unwrap();
    assert!(yaml.contains("unreliable: [\"scans see through \\\"walls\\\"\", \"robot2: lost\"]\n"), "{yaml}");
    let text = b"Unreliable\0scans see through \"walls\"; robot2: lost";
    assert!(read("bad.png").windows(text.len()).any(|bytes| bytes == text));
    assert_eq!(read("bad.pgm"), read("good.pgm"));
    let map = |name: &str| read_map(&folder.path().join(name)).unwrap();
    assert_eq!(map("bad.yaml").cells, map("good.yaml").cells);
    let reasons_of = |name: &str| read_map_with_reasons(&folder.path().join(name)).unwrap().1;
    assert_eq!(reasons_of("bad.yaml"), reasons);
    assert!(reasons_of("good.yaml").is_empty());
    // Another program's field of the same name is no reason not to read the map.
    let other = String::from_utf8(read("good.yaml")).unwrap() + "unreliable: true\n";
    fs::write(folder.path().join("other.yaml"), other).unwrap();
    assert!(reasons_of("other.yaml").is_empty());
}

#[test]
fn a_robot_is_drawn_where_it_is() {
    let header = GridHeader {
        origin: Pose2::new(-1.0, -1.0, 0.0),
        resolution_m: 0.1,
        width: 20,
        height: 20,
        ..Default::default()
    };
    let grid = Grid { header, cells: vec![-100; 400] };
    let mut picture = Picture::new(grid.view());
    picture.path([[-0.95, 0.95], [0.95, 0.95], [f64::NAN, 0.0], [1e300, 0.0]], [0, 0, 9]);
    picture.robot(Pose2::new(0.5, -0.5, 0.0), 0.1, [9, 0, 0]);
    let pixel = |x: usize, y: usize| &picture.pixels[3 * (y * 20 + x)..][..3];
    assert_eq!(pixel(0, 0), [0, 0, 9]);
    assert_eq!(pixel(19, 0), [0, 0, 9]);
    assert_eq!(pixel(15, 15), [9, 0, 0]);
    assert_eq!(pixel(15, 5), [GREY_FREE; 3]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn round_trip_keeps_readings(
        (width, cells) in (1_u32..9, 1_u32..9).prop_flat_map(|(w, h)| {
            (Just(w), proptest::collection::vec(any::<i8>(), (w * h) as usize))
        }),
        origin in (-1e3..1e3, -1e3..1e3, -3.0..3.0),
        resolution_m in 0.01..1.0,
    ) {
        let header = GridHeader {
            origin: Pose2::new(origin.0, origin.1, origin.2),
            resolution_m,
            width,
            height: cells.len() as u32 / width,
            ..Default::default()
        };
        let grid = Grid { header, cells };
        let folder = folder();
        write_map(&folder.path().join("m"), grid.view()).unwrap();
        let back = read_map(&folder.path().join("m.yaml")).unwrap();
        prop_assert_eq!(back.header, header);
        let readings = |grid: &Grid| grid.cells.iter().map(|c| occupancy(*c)).collect::<Vec<_>>();
        prop_assert_eq!(readings(&back), readings(&grid));
        // The picture for people says the same.
        let yaml = fs::read_to_string(folder.path().join("m.yaml")).unwrap();
        fs::write(folder.path().join("p.yaml"), yaml.replace("m.pgm", "m.png")).unwrap();
        prop_assert_eq!(read_map(&folder.path().join("p.yaml")).unwrap(), back);
    }

    #[test]
    fn never_panics(yaml in "\\PC{0,80}", image in proptest::collection::vec(any::<u8>(), 0..80)) {
        let _ = read(&yaml, &image);
        let _ = read(YAML, &image);
        let _ = read(YAML, &[b"P5 3 3 255\n", &image[..]].concat());
        let _ = read(YAML, &[b"P2 3 ", &image[..]].concat());
    }
}

#[test]
fn a_merged_map_of_more_cells_than_a_robots_is_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let (width, height) = (4200, 4100);
    let header = GridHeader { resolution_m: 0.05, width, height, ..Default::default() };
    let mut cells = vec![msg::grid::UNKNOWN; (width * height) as usize];
    assert!(cells.len() > msg::grid::CELLS_MAX);
    cells[17] = 60;
    write_map(&folder.path().join("whole"), GridView { header: &header, cells: &cells }).unwrap();
    let read = read_map(&folder.path().join("whole.yaml")).unwrap();
    assert_eq!((read.header.width, read.header.height), (width, height));
    assert!(read.cells[17] > 0 && read.cells[18] == msg::grid::UNKNOWN);
}
