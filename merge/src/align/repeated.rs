//! Places that look like another one because objects repeat: bays of a hall, rows of pillars, desks in rows.
//!
//! Where two robots saw different parts of such a building, nothing contradicts the wrong place, and the search may not even
//! propose the true one. So the map is moved until one of its matched objects takes the place of another.

use super::distance_field::DistanceField;
use super::refine::COARSE_KERNELS_M;
use super::short_walls::ShortWalls;
use super::{WallMatch, is_same_place, match_walls, refine, strides, wall_proximity};
use core::f64::consts::PI;
use msg::Pose2;

/// Points of one object are nearer to its first than this, metres: pillars and desks.
const OBJECT_M: f64 = 1.0;
/// Most objects that are compared: every pair of them gives two places.
const OBJECTS_MAX: usize = 12;
/// Least length of matched wall of an object, metres: less is an edge or noise.
const OBJECT_WALL_MIN_M: f64 = 0.3;
/// Wall points of each map for choosing places.
const CHOICE_POINTS: usize = 400;
/// Wall points of each map for refining them.
const REFINE_POINTS: usize = 800;
/// Largest share of contradicted walls of a place that is worth refining: objects' centres are rough.
const CONFLICT_MAX: f64 = 0.25;
/// Most places that are refined.
const REFINED_MAX: usize = 24;

/// Finds the places of b in a at which matched objects of b lie on other objects than at `best`, refined.
pub(crate) fn repeated_places(
    fields: [&DistanceField; 2],
    short_walls_of_b: &ShortWalls,
    best: Pose2,
) -> Vec<WallMatch> {
    let centres = matched_objects(fields[0], short_walls_of_b, best);
    let mut places: Vec<Pose2> = Vec::new();
    for (i, from) in centres.iter().enumerate() {
        for (j, to) in centres.iter().enumerate() {
            let shift = Pose2::new(to[0] - from[0], to[1] - from[1], 0.0);
            // Half a turn exchanges the two, or turns one about itself.
            let half_turn = Pose2::new(from[0] + to[0], from[1] + to[1], PI);
            let moved = [(i != j).then_some(shift), (i <= j).then_some(half_turn)];
            for place in moved.into_iter().flatten().map(|moved| best * moved) {
                if !places.iter().any(|other| is_same_place(*other, place)) {
                    places.push(place);
                }
            }
        }
    }
    let few = strides(fields, CHOICE_POINTS);
    places.retain(|place| match_walls(fields, *place, few).conflict() <= CONFLICT_MAX);
    let mut ranked: Vec<(f64, Pose2)> =
        places.into_iter().map(|place| (wall_proximity(fields, place, few), place)).collect();
    ranked.sort_by(|x, y| y.0.total_cmp(&x.0));
    let strides = strides(fields, REFINE_POINTS);
    let refined = ranked.into_iter().take(REFINED_MAX);
    let refined = refined.map(|(_, place)| refine(fields, place, strides, COARSE_KERNELS_M));
    refined.map(|place| match_walls(fields, place, strides)).collect()
}

/// Centres of the objects of b that match a's walls, in b's frame, metres: those with most wall first.
fn matched_objects(a: &DistanceField, short_walls_of_b: &ShortWalls, a_from_b: Pose2) -> Vec<[f64; 2]> {
    // Sum and number of the points of each object.
    let mut objects: Vec<([f64; 2], [f64; 2], usize)> = Vec::new();
    for at in short_walls_of_b.matched_points(a, a_from_b) {
        let is_near = |first: &[f64; 2]| (first[0] - at[0]).hypot(first[1] - at[1]) < OBJECT_M;
        match objects.iter_mut().find(|(first, ..)| is_near(first)) {
            Some((_, sum, count)) => {
                *sum = [sum[0] + at[0], sum[1] + at[1]];
                *count += 1;
            }
            None => objects.push((at, at, 1)),
        }
    }
    objects.retain(|(_, _, count)| *count as f64 * short_walls_of_b.point_m() >= OBJECT_WALL_MIN_M);
    objects.sort_by_key(|(_, _, count)| core::cmp::Reverse(*count));
    objects.truncate(OBJECTS_MAX);
    objects.into_iter().map(|(_, sum, count)| sum.map(|sum| sum / count as f64)).collect()
}
