use super::*;

/// Runs a script and says how it went; the name starts the line.
fn run(name: &str, script: Script) -> Outcome {
    let outcome = rehearse(script);
    let when = |share: f64| outcome.coverage.iter().position(|c| *c >= share).map(|i| i * 10);
    let shares = [0.8, 0.9, 0.95, 0.99].map(when);
    println!("{name}, seed {}: 80, 90, 95, 99 % of the floor after {shares:?} s", script.seed);
    for (robot, turns, held_s, figures) in outcome.tour.figures() {
        println!("  {robot}: {turns} turns, {held_s:.0} s, {figures:?}");
    }
    outcome
}

fn covered(outcome: &Outcome) -> f64 {
    *outcome.coverage.last().unwrap()
}

#[test]
fn one_robot_maps_the_lab() {
    for seed in 0..4 {
        let outcome = run("one robot", Script { seed, seconds: 200.0, ..Default::default() });
        assert!(covered(&outcome) > 0.9, "seed {seed}: {:?}", outcome.coverage);
        assert_eq!(outcome.bumps, 0, "seed {seed}");
    }
}

#[test]
fn three_robots_in_turn_map_the_lab() {
    for seed in 0..4 {
        let outcome = run("in turn", Script { seed, robots: 3, seconds: 240.0, ..Default::default() });
        assert!(covered(&outcome) > 0.9, "seed {seed}: {:?}", outcome.coverage);
        assert_eq!(outcome.bumps, 0, "seed {seed}");
        let held_s: Vec<f64> = outcome.tour.figures().map(|(_, _, held_s, _)| held_s).collect();
        assert!(held_s.iter().all(|held_s| (held_s - 80.0).abs() < 1.0), "seed {seed}: {held_s:?}");
    }
}

#[test]
fn three_robots_at_once_map_the_lab_sooner() {
    for seed in 0..4 {
        let script = Script { seed, robots: 3, all_at_once: true, seconds: 100.0, ..Default::default() };
        let outcome = run("at once", script);
        assert!(covered(&outcome) > 0.9, "seed {seed}: {:?}", outcome.coverage);
        assert_eq!(outcome.bumps, 0, "seed {seed}");
    }
}

#[test]
fn a_map_that_shifts_and_poses_that_are_off_do_not_stop_the_tour() {
    for seed in 0..2 {
        let script =
            Script { seed, shift_at_s: 45.0, pose_error_m: 0.03, seconds: 200.0, ..Default::default() };
        let outcome = run("shifted", script);
        assert!(covered(&outcome) > 0.9, "seed {seed}: {:?}", outcome.coverage);
    }
}

#[test]
fn once_all_is_seen_it_goes_back_to_far_places() {
    let outcome = run("patrol", Script { seconds: 400.0, ..Default::default() });
    let (_, _, _, figures) = outcome.tour.figures().next().unwrap();
    assert!(figures.patrols > 0, "{figures:?}");
    assert!(figures.driven_m > 20.0, "{figures:?}");
    assert_eq!(outcome.bumps, 0);
}

#[test]
fn same_seed_same_tour() {
    let script = Script { robots: 2, seconds: 60.0, ..Default::default() };
    assert!(rehearse(script).transcript == rehearse(script).transcript);
}
