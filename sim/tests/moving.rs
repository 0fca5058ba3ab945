//! People, doors and boxes in rooms over seeds: they keep off walls, robots and each other, and move without jumps.

mod common;

use common::{drive, robot, scan};
use msg::{Header, MovingObject, MovingObjects, ObjectKind, Pose2, Stamp};
use sim::{MovingConfig, NoiseConfig, ObjectSimulator, Room, RoomKind, SimConfig, Simulator};

const ALL: MovingConfig = MovingConfig { people: 5, doors: 3, boxes: 4 };
/// Largest speed of a person, m/s.
const SPEED_MAX_M_S: f64 = 1.4;

fn rooms() -> Vec<Room> {
    vec![
        Room::laboratory(),
        Room::generate(RoomKind::Office, 7),
        Room::generate(RoomKind::Flat, 3),
        Room::generate(RoomKind::Museum, 2),
    ]
}

fn message(objects: &ObjectSimulator, tick: u64) -> MovingObjects {
    let mut message = MovingObjects::default();
    objects.write(&mut message);
    message.header = Header { stamp: Stamp(tick as i64 * 50_000_000), ..Header::default() };
    message
}

fn of_kind(message: &MovingObjects, kind: ObjectKind) -> impl Iterator<Item = &MovingObject> {
    message.objects().iter().filter(move |object| object.kind() == Some(kind))
}

/// Distance from a point to an object's outline, metres.
fn distance_m(object: &MovingObject, [x, y]: [f64; 2]) -> f64 {
    let pose = object.world_from_object;
    if object.kind() == Some(ObjectKind::Person) {
        return (pose.x_m - x).hypot(pose.y_m - y) - object.half_size_m[0];
    }
    let at = pose.inverse() * Pose2::new(x, y, 0.0);
    let [a, b] = object.half_size_m;
    (at.x_m.abs() - a).max(0.0).hypot((at.y_m.abs() - b).max(0.0))
}

fn at_m(object: &MovingObject) -> [f64; 2] {
    [object.world_from_object.x_m, object.world_from_object.y_m]
}

/// Runs ten minutes of objects among robots that stand.
fn run(room: &Room, seed: u64, mut check: impl FnMut(&[Pose2], &MovingObjects, &MovingObjects)) {
    let starts = room.starts(3).unwrap();
    let mut objects = ObjectSimulator::new(room, &ALL, &starts, seed);
    let mut before = message(&objects, 0);
    for tick in 1..12_000 {
        objects.advance(starts.iter().copied());
        let now = message(&objects, tick);
        check(&starts, &before, &now);
        before = now;
    }
}

#[test]
fn people_keep_off_walls_robots_doors_boxes_and_each_other() {
    for (index, room) in rooms().iter().enumerate() {
        let plan = room.floor_plan(0.05);
        run(room, index as u64, |starts, _, now| {
            let people: Vec<_> = of_kind(now, ObjectKind::Person).collect();
            for (number, person) in people.iter().enumerate() {
                let (at, radius_m) = (at_m(person), person.half_size_m[0]);
                for robot in starts {
                    let gap_m = (robot.x_m - at[0]).hypot(robot.y_m - at[1]) - radius_m;
                    assert!(
                        gap_m > sim::burger::RADIUS_M + 0.15,
                        "{} {number}: {gap_m} m to a robot",
                        room.name()
                    );
                }
                for other in now.objects().iter().filter(|object| object.is_present == 1) {
                    let gap_m = distance_m(other, at) - radius_m;
                    assert!(
                        *other == **person || gap_m > 0.02,
                        "{} {number}: {gap_m} m to {other:?}",
                        room.name()
                    );
                }
                // Walls are in the plan where the LiDAR sees them.
                for ring in 0..16 {
                    let (sin, cos) = (f64::from(ring) * core::f64::consts::TAU / 16.0).sin_cos();
                    let (x, y) =
                        plan.view().cell_of([at[0] + 0.8 * radius_m * cos, at[1] + 0.8 * radius_m * sin]);
                    let cell = plan.view().cell(x, y);
                    assert!(cell <= 0, "{} {number} stands in a wall at {at:?}", room.name());
                }
            }
        });
    }
}

#[test]
fn objects_move_without_jumps_but_for_boxes_that_are_carried() {
    for (index, room) in rooms().iter().enumerate() {
        let (mut walked_m, mut slid_m, mut carried) = (0.0, 0.0, 0);
        run(room, 40 + index as u64, |_, before, now| {
            for (old, new) in before.objects().iter().zip(now.objects()) {
                let expected = old.world_from_object_after(1.0);
                let (jump_m, moved_m) = (
                    expected.distance_m(new.world_from_object),
                    old.world_from_object.distance_m(new.world_from_object),
                );
                match new.kind() {
                    Some(ObjectKind::Box) => carried += usize::from(jump_m > 0.0),
                    _ => assert!(jump_m < 1e-9, "{}: {jump_m} m", room.name()),
                }
                assert_eq!((old.kind, old.half_size_m), (new.kind, new.half_size_m));
                match new.kind() {
                    Some(ObjectKind::Person) => {
                        assert!(moved_m < SPEED_MAX_M_S * 0.05 + 1e-9);
                        walked_m += moved_m;
                    }
                    Some(ObjectKind::Door) => slid_m += moved_m,
                    _ => {}
                }
            }
        });
        println!("{}: walked {walked_m:.0} m, slid {slid_m:.1} m, carried {carried}", room.name());
        assert!(walked_m > 300.0 && carried > 2, "{}: {walked_m} m, {carried} times", room.name());
    }
}

#[test]
fn the_laboratory_and_an_office_have_doors_that_open_and_close() {
    for room in [Room::laboratory(), Room::generate(RoomKind::Office, 7)] {
        let (mut opened, mut closed) = (0, 0);
        run(&room, 1, |_, before, now| {
            for (old, new) in of_kind(before, ObjectKind::Door).zip(of_kind(now, ObjectKind::Door)) {
                opened += usize::from(old.is_present == 1 && new.is_present == 0);
                closed += usize::from(
                    old.velocity_m_s != [0.0; 2] && new.velocity_m_s == [0.0; 2] && new.is_present == 1,
                );
            }
        });
        println!("{}: opened {opened}, closed {closed}", room.name());
        assert!(opened > 5 && closed > 5, "{}: {opened} {closed}", room.name());
    }
}

#[test]
fn people_do_not_walk_into_robots_that_drive() {
    let room = Room::laboratory();
    for seed in 0..6 {
        let starts = room.starts(4).unwrap();
        let mut objects = ObjectSimulator::new(&room, &MovingConfig { people: 8, ..ALL }, &starts, seed);
        let mut before = message(&objects, 0);
        for tick in 1..6000_u64 {
            // Robots that drive to and fro, through everything.
            let phase = tick as f64 * 0.05 * 0.2;
            let robots: Vec<Pose2> = starts
                .iter()
                .map(|start| Pose2::new(2.0 * (phase + start.x_m).sin(), start.y_m, 0.0))
                .collect();
            objects.advance(robots.iter().copied());
            let now = message(&objects, tick);
            for robot in &robots {
                for person in of_kind(&now, ObjectKind::Person) {
                    let gap_m =
                        |pose: Pose2| robot.distance_m(pose) - person.half_size_m[0] - sim::burger::RADIUS_M;
                    let (here_m, next_m) =
                        (gap_m(person.world_from_object), gap_m(person.world_from_object_after(1.0)));
                    assert!(
                        next_m >= 0.19 || next_m >= here_m,
                        "seed {seed}: walks from {here_m} m to {next_m} m"
                    );
                }
            }
            before = now;
        }
        assert!(of_kind(&before, ObjectKind::Person).count() > 4);
    }
}

#[test]
fn a_door_does_not_close_on_a_robot() {
    let room = Room::generate(RoomKind::Office, 7);
    let starts = room.starts(1).unwrap();
    let config = MovingConfig { doors: 8, ..MovingConfig::default() };
    let new = || ObjectSimulator::new(&room, &config, &starts, 5);
    let (mut objects, mut closed) = (new(), Vec::new());
    for tick in 0..2000 {
        objects.advance(starts.iter().copied());
        for door in message(&objects, tick).objects().iter().filter(|door| door.is_present == 1) {
            if door.velocity_m_s == [0.0; 2]
                && !closed.iter().any(|at: &Pose2| at.distance_m(door.world_from_object) < 0.5)
            {
                closed.push(door.world_from_object);
            }
        }
    }
    assert!(closed.len() > 3, "{} doors were seen closed", closed.len());
    for doorway in closed {
        let mut objects = new();
        for tick in 0..6000 {
            objects.advance([doorway]);
            for door in message(&objects, tick).objects() {
                let gap_m = distance_m(door, [doorway.x_m, doorway.y_m]);
                assert!(door.is_present == 0 || gap_m > sim::burger::RADIUS_M, "{gap_m} m to {door:?}");
            }
        }
    }
}

/// Cells of the plan in which a robot's centre fits, and which are connected with a start.
fn reachable(room: &Room, starts: &[Pose2], boxes: &[MovingObject]) -> Vec<bool> {
    let plan = room.floor_plan(0.05);
    let (width, height) = (plan.header.width as usize, plan.header.height as usize);
    let is_wall = |cell: usize| plan.cells[cell] > 0;
    let mut fits: Vec<bool> = plan.cells.iter().map(|cell| *cell < 0).collect();
    for cell in (0..plan.cells.len()).filter(|cell| is_wall(*cell)) {
        let (column, row) = ((cell % width) as isize, (cell / width) as isize);
        for (dx, dy) in
            (-3..=3).flat_map(|dx| (-3..=3).map(move |dy| (dx, dy))).filter(|(dx, dy)| dx * dx + dy * dy < 9)
        {
            let (u, v) = (column + dx, row + dy);
            if (0..width as isize).contains(&u) && (0..height as isize).contains(&v) {
                fits[v as usize * width + u as usize] = false;
            }
        }
    }
    let centre = |cell: usize| {
        let at = |index: usize| (index as f64 + 0.5) * 0.05;
        [plan.header.origin.x_m + at(cell % width), plan.header.origin.y_m + at(cell / width)]
    };
    for cell in (0..fits.len()).filter(|cell| boxes.iter().any(|b| distance_m(b, centre(*cell)) < 0.125)) {
        fits[cell] = false;
    }
    let (x, y) = plan.view().cell_of([starts[0].x_m, starts[0].y_m]);
    let mut open = vec![y as usize * width + x as usize];
    let mut reached = vec![false; fits.len()];
    while let Some(cell) = open.pop() {
        if std::mem::replace(&mut reached[cell], true) {
            continue;
        }
        open.extend(
            [cell - 1, cell + 1, cell - width, cell + width]
                .into_iter()
                .filter(|next| fits[*next] && !reached[*next]),
        );
    }
    reached
}

#[test]
fn boxes_cut_off_no_floor() {
    for room in [Room::laboratory(), Room::generate(RoomKind::Flat, 3)] {
        let starts = room.starts(2).unwrap();
        let without = reachable(&room, &starts, &[]);
        let config = MovingConfig { boxes: 16, ..MovingConfig::default() };
        let mut objects = ObjectSimulator::new(&room, &config, &starts, 11);
        for tick in 0..8000 {
            objects.advance(starts.iter().copied());
            if tick % 1600 != 0 {
                continue;
            }
            let now = message(&objects, tick);
            let with = reachable(&room, &starts, now.objects());
            let area_m2: f64 = now
                .objects()
                .iter()
                .map(|b| (2.0 * b.half_size_m[0] + 0.4) * (2.0 * b.half_size_m[1] + 0.4))
                .sum();
            let lost_m2 = without.iter().zip(&with).filter(|(before, after)| **before && !**after).count()
                as f64
                * 0.0025;
            assert!(lost_m2 < area_m2 + 0.1, "{}: {lost_m2} m2 lost to boxes of {area_m2} m2", room.name());
            assert!(now.objects().len() > 5, "{}: {} boxes", room.name(), now.objects().len());
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_objects_and_others_go_on_where_they_were() {
    let room = Room::laboratory();
    let starts = room.starts(2).unwrap();
    let new = |seed| ObjectSimulator::new(&room, &ALL, &starts, seed);
    let (mut one, mut same, mut other) = (new(3), new(3), new(4));
    for _ in 0..1000 {
        for objects in [&mut one, &mut same, &mut other] {
            objects.advance(starts.iter().copied());
        }
    }
    let last = message(&one, 1000);
    assert_eq!(last, message(&same, 1000));
    assert_ne!(last, message(&other, 1000));
    let mut resumed = new(3);
    resumed.resume(&last);
    let now = message(&resumed, 1000);
    for (before, after) in last.objects().iter().zip(now.objects()) {
        let jump_m = before.world_from_object_after(1.0).distance_m(after.world_from_object);
        assert!(jump_m < 1e-9 && before.half_size_m == after.half_size_m, "{jump_m} m");
    }
    // Values of a damaged file are left out.
    let mut damaged = last;
    damaged.len = u32::MAX;
    damaged.objects.iter_mut().for_each(|object| object.world_from_object.x_m = f64::NAN);
    resumed.resume(&damaged);
    resumed.advance(starts.iter().copied());
    assert!(message(&resumed, 0).objects().iter().all(|object| object.world_from_object.is_finite()));
}

#[test]
fn boxes_take_no_place_from_people() {
    let obj = "# up z\nv -3 -2.5 0\nv 3 -2.5 0\nv 3 2.5 0\nv -3 2.5 0\nv -3 -2.5 2\nv 3 -2.5 2\nv 3 2.5 2\nv -3 2.5 2\n\
        f 1 2 3 4\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    let room = Room::from_bytes("small.obj", obj.as_bytes()).unwrap();
    let starts = room.starts(1).unwrap();
    let people = |boxes| {
        let config = MovingConfig { people: 16, boxes, ..MovingConfig::default() };
        ObjectSimulator::new(&room, &config, &starts, 42).counts().people
    };
    assert!((2..16).contains(&people(0)), "{}", people(0));
    for boxes in [4, 12, 16] {
        assert!(people(boxes) >= people(0), "{} with {boxes} boxes, {} without", people(boxes), people(0));
    }
}

/// A message with one object that stands.
fn standing(
    kind: ObjectKind,
    world_from_object: Pose2,
    half_size_m: [f64; 2],
    stamp: Stamp,
) -> MovingObjects {
    let mut message = MovingObjects { len: 1, ..MovingObjects::default() };
    message.header.stamp = stamp;
    message.objects[0] = MovingObject {
        world_from_object,
        half_size_m,
        kind: kind as u32,
        is_present: 1,
        ..MovingObject::default()
    };
    message
}

#[test]
fn a_robot_sees_and_touches_a_person_and_a_box_and_no_longer_what_is_gone() {
    for (kind, half_size_m) in [(ObjectKind::Person, [0.2; 2]), (ObjectKind::Box, [0.2; 2])] {
        let config = SimConfig { noise: NoiseConfig::OFF, ..SimConfig::default() };
        let room = Room::laboratory();
        let start = Pose2::new(-1.2, -1.7, 0.0);
        let mut simulator = Simulator::new(&room, &config, robot(1), start, 1).unwrap();
        simulator.update_objects(&standing(kind, Pose2::new(-0.5, -1.7, 0.0), half_size_m, Stamp(1)));
        simulator.step();
        let scan = scan(&mut simulator);
        // From the LiDAR, 0.032 m behind the robot's centre, to the near side.
        let ahead_m = scan.ranges_m()[90];
        assert!((ahead_m - 0.532).abs() < 0.01, "{kind:?}: {ahead_m}");
        for _ in 0..1000 {
            simulator.set_velocity_command(&drive(0.15, 0.0));
            simulator.step();
        }
        let blocked = simulator.step().truth;
        assert!(blocked.contacts >= 1 && blocked.world_from_base.x_m < -0.7, "{kind:?}: {blocked:?}");
        let mut gone = standing(kind, Pose2::new(-0.5, -1.7, 0.0), half_size_m, simulator.now());
        gone.len = 0;
        simulator.update_objects(&gone);
        for _ in 0..300 {
            simulator.set_velocity_command(&drive(0.15, 0.0));
            simulator.step();
        }
        assert!(simulator.step().truth.world_from_base.x_m > -0.6, "{kind:?} is gone");
    }
}

#[test]
fn invalid_messages_are_refused_and_older_ones_ignored() {
    let room = Room::laboratory();
    let start = Pose2::new(-1.2, -1.7, 0.0);
    let mut simulator = Simulator::new(&room, &SimConfig::default(), robot(1), start, 1).unwrap();
    let at = |x_m, stamp| standing(ObjectKind::Person, Pose2::new(x_m, -1.7, 0.0), [0.2; 2], Stamp(stamp));
    for (number, broken) in [
        at(f64::NAN, 1),
        at(0.5, 5_000_000_000),
        standing(ObjectKind::Box, Pose2::IDENTITY, [0.0, 0.2], Stamp(1)),
        {
            let mut unknown = at(0.0, 1);
            unknown.objects[0].kind = 77;
            unknown
        },
    ]
    .iter()
    .enumerate()
    {
        simulator.update_objects(broken);
        assert_eq!(simulator.refused(), number as u64 + 1);
    }
    simulator.update_objects(&at(0.0, 10));
    simulator.update_objects(&at(-0.9, 9));
    assert_eq!(simulator.refused(), 4);
    simulator.step();
    assert_eq!(simulator.step().truth.contacts, 0, "the older message has no effect");
}
