//! Merging as a library: finds how one occupancy grid lies in another, without a guess.
//!
//! `cargo run --release --example merge_two_maps [A.yaml B.yaml]`
//!
//! The maps are a `.yaml` with its image, as map_server writes them. Without files, two maps of the built-in laboratory
//! are aligned: the second one's frame is moved and turned by a known transform.

use formats::map_file::read_map;
use merge::{AlignConfig, align};
use msg::{Grid, Pose2};
use sim::Room;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (a, b) = match &arguments[..] {
        [a, b] => (read_map(Path::new(a))?, read_map(Path::new(b))?),
        [] => laboratory_twice(Pose2::new(1.5, -0.7, 2.0)),
        _ => return Err("expected two map files (.yaml), or none".into()),
    };
    match align(a.view(), b.view(), &AlignConfig::default()) {
        Some(found) if found.accepted => {
            let pose = found.a_from_b;
            println!("b lies in a at x {:.3} m, y {:.3} m, yaw {:.4} rad", pose.x_m, pose.y_m, pose.yaw_rad);
        }
        Some(_) => println!("refused: the best place found is not certain enough"),
        None => println!("refused: no place fits at all"),
    }
    Ok(())
}

/// A map, and the same map in a frame of its own; `a_from_b` is the transform to be found.
fn laboratory_twice(a_from_b: Pose2) -> (Grid, Grid) {
    let a = Room::laboratory().floor_plan(0.05);
    let mut b = a.clone();
    b.header.origin = a_from_b.inverse() * a.header.origin;
    println!("truth: x {} m, y {} m, yaw {} rad", a_from_b.x_m, a_from_b.y_m, a_from_b.yaw_rad);
    (a, b)
}
