//! Properties of the solver: what holds for any graph.

use msg::Pose2;
use msg::pose::wrap_angle;
use nalgebra::Matrix3;
use posegraph::{Edge, Kernel, SolveError, SolverOptions, Termination, cost, information_from_sigmas, solve};
use proptest::prelude::*;

fn edge(a: usize, b: usize, a_from_b: Pose2, kernel: Kernel) -> Edge {
    Edge { a, b, a_from_b, information: information_from_sigmas(0.1, 0.02), kernel }
}

fn pose() -> impl Strategy<Value = Pose2> {
    (-5.0..5.0, -5.0..5.0, -9.0..9.0).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
}

/// A chain of random steps with random further edges, right or wrong, and random first guesses.
fn graph() -> impl Strategy<Value = (Vec<Pose2>, Vec<Edge>)> {
    let further = (0_usize..12, 0_usize..12, pose(), any::<bool>());
    let guesses = prop::collection::vec(pose(), 12);
    (prop::collection::vec(pose(), 11), prop::collection::vec(further, 0..10), guesses).prop_map(
        |(steps, further, guesses)| {
            let mut edges: Vec<Edge> =
                steps.iter().enumerate().map(|(k, step)| edge(k, k + 1, *step, Kernel::Quadratic)).collect();
            edges.extend(further.into_iter().filter(|(a, b, ..)| a != b).map(|(a, b, measured, robust)| {
                edge(a, b, measured, if robust { Kernel::Cauchy { sigmas: 2.0 } } else { Kernel::Quadratic })
            }));
            (guesses, edges)
        },
    )
}

proptest! {
    #[test]
    fn the_cost_never_rises_and_the_first_pose_never_moves((guesses, edges) in graph()) {
        let mut poses = guesses.clone();
        let summary = solve(&mut poses, &edges, &SolverOptions::default()).unwrap();
        prop_assert!(summary.final_cost <= summary.initial_cost * (1.0 + 1e-9) + 1e-9, "{:?}", summary);
        prop_assert_eq!(summary.initial_cost, cost(&guesses, &edges));
        prop_assert_eq!(summary.final_cost, cost(&poses, &edges));
        prop_assert_eq!(poses[0], guesses[0]);
        prop_assert!(poses.iter().all(|pose| pose.is_finite()));
    }

    #[test]
    fn a_converged_solution_is_a_minimum(
        (guesses, edges) in graph(),
        moves in prop::collection::vec((1_usize..12, -1e-3..1e-3, -1e-3..1e-3, -1e-3..1e-3), 20),
    ) {
        let mut poses = guesses;
        let options = SolverOptions { iterations_max: 200, step_min: 1e-9, ..SolverOptions::default() };
        let summary = solve(&mut poses, &edges, &options).unwrap();
        prop_assume!(summary.termination == Termination::Converged);
        for (k, x, y, yaw) in moves {
            let mut moved = poses.clone();
            moved[k] = Pose2::new(poses[k].x_m + x, poses[k].y_m + y, poses[k].yaw_rad + yaw);
            prop_assert!(cost(&moved, &edges) >= summary.final_cost - 1e-6 * (1.0 + summary.final_cost));
        }
    }

    /// Gauge: only relative poses are measured, so the frame that the graph is solved in does not show.
    #[test]
    fn the_solution_moves_with_its_frame(
        steps in prop::collection::vec(pose(), 3..10),
        noise in prop::collection::vec((-0.05..0.05, -0.05..0.05, -0.02..0.02), 10),
        frame in (-100.0..100.0, -100.0..100.0, -9.0..9.0),
    ) {
        let frame = Pose2::new(frame.0, frame.1, frame.2);
        let mut poses = vec![Pose2::IDENTITY];
        let mut edges = Vec::new();
        for (k, step) in steps.iter().enumerate() {
            poses.push(poses[k] * *step);
            let (x, y, yaw) = noise[k];
            edges.push(edge(k, k + 1, *step * Pose2::new(x, y, yaw), Kernel::Quadratic));
        }
        edges.push(edge(0, steps.len(), poses[steps.len()], Kernel::Cauchy { sigmas: 2.0 }));
        let mut elsewhere: Vec<Pose2> = poses.iter().map(|pose| frame * *pose).collect();
        let options = SolverOptions { step_min: 1e-9, ..SolverOptions::default() };
        solve(&mut poses, &edges, &options).unwrap();
        solve(&mut elsewhere, &edges, &options).unwrap();
        for (here, there) in poses.iter().zip(&elsewhere) {
            let expected = frame * *here;
            prop_assert!(expected.distance_m(*there) < 1e-6, "{:?} {:?}", expected, there);
            prop_assert!(wrap_angle(expected.yaw_rad - there.yaw_rad).abs() < 1e-6);
        }
    }

    #[test]
    fn a_chain_without_loops_is_solved_exactly(steps in prop::collection::vec(pose(), 1..10), guesses in prop::collection::vec(pose(), 10)) {
        let edges: Vec<Edge> =
            steps.iter().enumerate().map(|(k, step)| edge(k, k + 1, *step, Kernel::Quadratic)).collect();
        let mut poses = guesses[..=steps.len().min(9)].to_vec();
        let edges = &edges[..poses.len() - 1];
        let options = SolverOptions { iterations_max: 500, step_min: 1e-9, ..SolverOptions::default() };
        let summary = solve(&mut poses, edges, &options).unwrap();
        prop_assert!(summary.final_cost <= summary.initial_cost + 1e-9, "{:?}", summary);
        if summary.final_cost < 1e-6 {
            for (k, step) in steps[..edges.len()].iter().enumerate() {
                prop_assert!(poses[k].between(poses[k + 1]).distance_m(*step) < 1e-3);
            }
        }
    }
}

#[test]
fn a_wrong_closure_is_outvoted() {
    // A square driven twice, its corners 4 m apart, closed five times rightly and once wrongly.
    let side = Pose2::new(4.0, 0.0, core::f64::consts::FRAC_PI_2);
    let drifted = side * Pose2::new(0.1, 0.05, 0.02);
    let mut edges: Vec<Edge> = (0..8).map(|k| edge(k, k + 1, drifted, Kernel::Quadratic)).collect();
    let robust = Kernel::Cauchy { sigmas: 2.0 };
    edges.extend([(0, 4), (1, 5), (2, 6), (3, 7), (4, 8)].map(|(a, b)| edge(a, b, Pose2::IDENTITY, robust)));
    let wrong = edge(0, 2, Pose2::new(-3.0, 1.0, 1.0), robust);
    edges.push(wrong);
    let mut poses = vec![Pose2::IDENTITY];
    (0..8).for_each(|k| poses.push(poses[k] * drifted));
    let apart = poses[0].distance_m(poses[4]);
    let summary =
        solve(&mut poses, &edges, &SolverOptions { graduated: true, ..Default::default() }).unwrap();
    assert_eq!(summary.termination, Termination::Converged);
    assert!(poses[0].distance_m(poses[4]) < 0.1 * apart, "{:?} of {apart}", poses[4]);
    assert!(wrong.chi_squared(poses[0], poses[2]) > 100.0);
    assert!(poses[2].distance_m(Pose2::new(4.0, 4.0, 0.0)) < 0.4, "{:?}", poses[2]);
}

#[test]
fn a_step_that_raises_the_cost_is_damped() {
    // The first guess has a long chain turned by nearly half a turn: Gauss-Newton alone overshoots.
    let step = Pose2::new(10.0, 0.0, 0.0);
    let mut edges: Vec<Edge> = (0..6).map(|k| edge(k, k + 1, step, Kernel::Quadratic)).collect();
    edges.push(edge(0, 6, Pose2::new(60.0, 0.0, 0.0), Kernel::Quadratic));
    let mut poses: Vec<Pose2> =
        (0..7).map(|k| Pose2::new(-10.0 * k as f64, 3.0 * (k % 2) as f64, 2.8 * (k % 3) as f64)).collect();
    let options = SolverOptions { iterations_max: 100, ..SolverOptions::default() };
    let summary = solve(&mut poses, &edges, &options).unwrap();
    assert!(summary.damped > 0, "{summary:?}");
    assert!(summary.final_cost < 0.1 * summary.initial_cost, "{summary:?}");
}

#[test]
fn what_cannot_be_solved_is_left_as_it_was_and_says_why() {
    let before = vec![Pose2::IDENTITY, Pose2::new(1.0, 2.0, 3.0), Pose2::new(4.0, 5.0, 0.5)];
    let sound = edge(0, 1, Pose2::new(2.0, 0.0, 0.0), Kernel::Quadratic);
    let with = |information| Edge { information, ..edge(0, 1, before[2], Kernel::Quadratic) };
    let solved = |edges: &[Edge], options: SolverOptions| {
        let mut poses = before.clone();
        let why = solve(&mut poses, edges, &options).unwrap_err();
        assert_eq!(poses, before, "{why}");
        why
    };
    let options = SolverOptions::default();
    let not_finite = with(Matrix3::from_element(f64::NAN));
    assert_eq!(solved(&[sound, not_finite], options), SolveError::NotFinite { edge: 1 });
    let negative = with(-Matrix3::identity());
    assert_eq!(solved(&[negative], options), SolveError::Singular { iteration: 0 });
    // Pose 2 is held by no edge: without the prior the normal equations are singular.
    let no_prior = SolverOptions { prior: 0.0, ..options };
    assert_eq!(solved(&[sound], no_prior), SolveError::Singular { iteration: 0 });
    for (a, b) in [(0, 3), (7, 1), (1, 1)] {
        let invalid = edge(a, b, Pose2::IDENTITY, Kernel::Quadratic);
        assert_eq!(solved(&[sound, invalid], options), SolveError::InvalidEdge { edge: 1, a, b, poses: 3 });
    }
}

#[test]
fn poses_that_no_edge_holds_stay_where_they_are() {
    let mut poses = vec![Pose2::IDENTITY, Pose2::new(1.0, 2.0, 3.0), Pose2::new(4.0, 5.0, 0.5)];
    let edges = [edge(0, 1, Pose2::new(2.0, 0.0, 0.0), Kernel::Quadratic)];
    let summary = solve(&mut poses, &edges, &SolverOptions::default()).unwrap();
    assert!(poses[1].distance_m(Pose2::new(2.0, 0.0, 0.0)) < 1e-6, "{summary:?}");
    assert_eq!(poses[2], Pose2::new(4.0, 5.0, 0.5));
    // Neither are empty graphs an error.
    for count in [0, 1] {
        let mut few = vec![Pose2::new(1.0, 1.0, 1.0); count];
        assert_eq!(
            solve(&mut few, &[], &SolverOptions::default()).unwrap().termination,
            Termination::Converged
        );
    }
}
