//! People who walk, doors that open and close, and boxes that are moved, in the room of a fleet.
//!
//! [`ObjectSimulator`] decides where they are, tick by tick, from the poses of the robots. Every robot's
//! [`Simulator`](crate::Simulator) gets the same [`MovingObjects`] and lets its robot see and touch them.

mod carried_box;
mod door;
mod floor;
mod person;
mod shape;

use crate::config::MovingConfig;
use crate::noise::Draws;
use crate::room::Room;
use carried_box::{CarriedBox, Others};
use core::time::Duration;
use door::{Doorway, SlidingDoor};
use floor::Floor;
use msg::{MovingObject, MovingObjects, OBJECTS_OF_KIND_MAX, ObjectKind, Pose2, ROBOTS_MAX};
use person::{Person, Surroundings};
pub(crate) use shape::Outline;

/// Duration of a tick of moving objects, seconds.
const PERIOD_S: f64 = MovingObjects::PERIOD_S;
/// Draws of a kind's objects: this distance apart in the number of the stream.
const STREAMS_OF_KIND: u64 = 256;

/// Returns the number of ticks in a time, at least one.
fn ticks_of(seconds: f64) -> u32 {
    (seconds / PERIOD_S).round().max(1.0) as u32
}

/// Simulation of the people, doors and boxes that move in a room.
///
/// The same room, configuration, seed and poses of robots give the same objects. People keep off walls, robots, closed doors, boxes and
/// each other. A door does not close on anybody, and a box is placed apart from robots and people, where it cuts off no floor.
///
/// ```
/// use sim::{MovingConfig, ObjectSimulator, Room};
///
/// let room = Room::laboratory();
/// let starts = room.starts(1)?;
/// let config = MovingConfig { people: 2, ..MovingConfig::default() };
/// let mut objects = ObjectSimulator::new(&room, &config, &starts, 42);
/// for _ in 0..200 {
///     objects.advance(starts.iter().copied());
/// }
/// let mut message = msg::MovingObjects::default();
/// objects.write(&mut message);
/// assert_eq!(message.objects().len(), 2);
/// # Ok::<(), sim::StartError>(())
/// ```
pub struct ObjectSimulator {
    seed: u64,
    floor: Floor,
    people: Vec<Person>,
    doors: Vec<SlidingDoor>,
    boxes: Vec<CarriedBox>,
    robots_m: Vec<[f64; 2]>,
    /// Outlines of the people, those of the tick's end for whom it is decided.
    outlines: Vec<Outline>,
    obstacles: Vec<Outline>,
}

/// Returns the draws of one object, which differ from those of an earlier process by the moment of the restart.
fn draws_of(seed: u64, kind: ObjectKind, number: usize, moment: u64) -> Draws {
    Draws::new(seed ^ moment, kind as u64 * STREAMS_OF_KIND + number as u64)
}

impl ObjectSimulator {
    /// Duration of a tick.
    pub const TICK: Duration = Duration::from_millis(50);

    /// Places people, doors and boxes in a room, apart from the robots' starts. There are fewer than configured if the room has no place
    /// for all; see [`Self::counts`]. There are as many people as without boxes.
    pub fn new(room: &Room, config: &MovingConfig, starts: &[Pose2], seed: u64) -> Self {
        let robots_m: Vec<[f64; 2]> = starts.iter().map(|start| [start.x_m, start.y_m]).collect();
        let mut all = Self {
            seed,
            floor: Floor::new(room),
            people: Vec::new(),
            doors: Vec::new(),
            boxes: Vec::new(),
            robots_m,
            outlines: Vec::new(),
            obstacles: Vec::new(),
        };
        all.add_doors(config.doors.min(OBJECTS_OF_KIND_MAX));
        all.add_boxes(config.boxes);
        all.add_people(config.people);
        if all.people.len() < config.people.min(OBJECTS_OF_KIND_MAX) {
            // Boxes take no place that people need.
            all.boxes.clear();
            all.people.clear();
            all.add_people(config.people);
            all.add_boxes(config.boxes);
        }
        all
    }

    /// Returns how many people, doors and boxes there are.
    pub fn counts(&self) -> MovingConfig {
        MovingConfig { people: self.people.len(), doors: self.doors.len(), boxes: self.boxes.len() }
    }

    fn add_doors(&mut self, count: usize) {
        if count == 0 {
            return;
        }
        let mut doorways = Doorway::find_all(&self.floor, &self.robots_m);
        let mut draws = draws_of(self.seed, ObjectKind::Door, OBJECTS_OF_KIND_MAX, 0);
        for number in 0..count.min(doorways.len()) {
            let doorway = doorways.swap_remove(draws.below(doorways.len()));
            self.doors.push(SlidingDoor::new(draws_of(self.seed, ObjectKind::Door, number, 0), doorway));
        }
    }

    fn add_boxes(&mut self, count: usize) {
        (0..count.min(OBJECTS_OF_KIND_MAX)).for_each(|number| self.add_box(number));
    }

    fn add_people(&mut self, count: usize) {
        (0..count.min(OBJECTS_OF_KIND_MAX)).for_each(|number| self.add_person(number));
    }

    fn add_box(&mut self, number: usize) {
        let (doors, boxes) = (self.closed_doors(), self.box_outlines(None));
        let people: Vec<Outline> = self.people.iter().map(Person::outline).collect();
        let others = Others {
            robots_m: &self.robots_m,
            is_start: true,
            people: &people,
            doors: &doors,
            boxes: &boxes,
        };
        let draws = draws_of(self.seed, ObjectKind::Box, number, 0);
        self.boxes.extend(CarriedBox::draw(draws, &mut self.floor, &others));
    }

    fn add_person(&mut self, number: usize) {
        let obstacles: Vec<Outline> =
            self.closed_doors().into_iter().chain(self.box_outlines(None)).collect();
        let people: Vec<Outline> = self.people.iter().map(Person::outline).collect();
        let around = Surroundings { robots_m: &self.robots_m, obstacles: &obstacles, people: &people };
        let draws = draws_of(self.seed, ObjectKind::Person, number, 0);
        self.people.extend(Person::draw(draws, &self.floor, &around));
    }

    /// Goes on from the objects of an earlier process with the same room, configuration and seed, which `message` has. What does not fit
    /// is left where it is.
    pub fn resume(&mut self, message: &MovingObjects) {
        let of_kind = |kind: ObjectKind| {
            let objects = message.objects().iter().filter(move |object| object.kind() == Some(kind));
            let finite = objects.enumerate().filter(|(_, object)| is_valid(object));
            // The end of the tick, to which the simulators have moved them.
            finite.map(|(number, object)| (number, object.world_from_object_after(PERIOD_S)))
        };
        let (seed, moment) = (self.seed, message.header.stamp.0 as u64);
        for (number, pose) in of_kind(ObjectKind::Person) {
            let Some(person) = self.people.get_mut(number) else { continue };
            if self.floor.clearance_m([pose.x_m, pose.y_m]) > person.radius_m {
                person.resume([pose.x_m, pose.y_m], draws_of(seed, ObjectKind::Person, number, moment));
            }
        }
        for (number, pose) in of_kind(ObjectKind::Door) {
            if let Some(door) = self.doors.get_mut(number) {
                door.resume(pose, draws_of(seed, ObjectKind::Door, number, moment));
            }
        }
        for (number, pose) in of_kind(ObjectKind::Box) {
            if let Some(carried) = self.boxes.get_mut(number) {
                carried.resume(pose, draws_of(seed, ObjectKind::Box, number, moment));
            }
        }
    }

    /// Simulates one tick of [`Self::TICK`] among robots at these poses, in `world`.
    pub fn advance(&mut self, world_from_robots: impl IntoIterator<Item = Pose2>) {
        self.robots_m.clear();
        let robots = world_from_robots.into_iter().filter(|pose| pose.is_finite()).take(ROBOTS_MAX);
        self.robots_m.extend(robots.map(|pose| [pose.x_m, pose.y_m]));
        self.people.iter_mut().for_each(Person::end_tick);
        self.doors.iter_mut().for_each(SlidingDoor::end_tick);
        self.outlines.clear();
        self.outlines.extend(self.people.iter().map(Person::outline));
        self.carry_boxes();
        for door in &mut self.doors {
            door.begin_tick(&self.robots_m, &self.outlines);
        }
        self.obstacles.clear();
        let leaves = self.doors.iter().filter(|door| door.is_present()).map(SlidingDoor::next_outline);
        self.obstacles.extend(leaves.chain(self.boxes.iter().map(CarriedBox::outline)));
        self.move_people();
    }

    fn move_people(&mut self) {
        for index in 0..self.people.len() {
            // Its own outline leaves the list for the time being.
            self.outlines.swap_remove(index);
            let person = &mut self.people[index];
            let around =
                Surroundings { robots_m: &self.robots_m, obstacles: &self.obstacles, people: &self.outlines };
            person.begin_tick(&mut self.floor, &around);
            let next = person.next_outline();
            // Back to its place, and the one that took it to the end again.
            self.outlines.push(next);
            let last = self.outlines.len() - 1;
            self.outlines.swap(index, last);
        }
    }

    fn carry_boxes(&mut self) {
        for index in 0..self.boxes.len() {
            if !self.boxes[index].is_due() {
                continue;
            }
            let (doors, boxes) = (self.closed_doors(), self.box_outlines(Some(index)));
            let others = Others {
                robots_m: &self.robots_m,
                is_start: false,
                people: &self.outlines,
                doors: &doors,
                boxes: &boxes,
            };
            self.boxes[index].carry(&mut self.floor, &others);
        }
    }

    fn closed_doors(&self) -> Vec<Outline> {
        self.doors.iter().map(|door| door.doorway().outline()).collect()
    }

    /// Returns the outlines of all boxes but one.
    fn box_outlines(&self, without: Option<usize>) -> Vec<Outline> {
        let others = self.boxes.iter().enumerate().filter(|(index, _)| Some(*index) != without);
        others.map(|(_, carried)| carried.outline()).collect()
    }

    /// Writes the objects, with their velocities until the next tick, into a message; its header is left as it is.
    pub fn write(&self, message: &mut MovingObjects) {
        let people = self.people.iter().map(|person| MovingObject {
            world_from_object: Pose2::new(person.at_m[0], person.at_m[1], 0.0),
            velocity_m_s: person.velocity_m_s,
            half_size_m: [person.radius_m; 2],
            kind: ObjectKind::Person as u32,
            is_present: 1,
        });
        let doors = self.doors.iter().map(|door| MovingObject {
            world_from_object: door.world_from_leaf(),
            velocity_m_s: door.velocity_m_s(),
            half_size_m: door.doorway().half_size_m(),
            kind: ObjectKind::Door as u32,
            is_present: door.is_present().into(),
        });
        let boxes = self.boxes.iter().map(|carried| MovingObject {
            world_from_object: carried.world_from_box,
            velocity_m_s: [0.0; 2],
            half_size_m: carried.half_size_m(),
            kind: ObjectKind::Box as u32,
            is_present: 1,
        });
        message.len = 0;
        for (slot, object) in message.objects.iter_mut().zip(people.chain(doors).chain(boxes)) {
            *slot = object;
            message.len += 1;
        }
    }
}

/// Returns whether an object's values are finite and within bounds.
pub(crate) fn is_valid(object: &MovingObject) -> bool {
    /// Largest half of an object's length, metres.
    const HALF_SIZE_MAX_M: f64 = 2.0;
    /// Largest speed, m/s.
    const SPEED_MAX_M_S: f64 = 5.0;
    let size = |half_m: f64| half_m > 0.0 && half_m <= HALF_SIZE_MAX_M;
    object.kind().is_some()
        && object.world_from_object.is_finite()
        && object.velocity_m_s.iter().all(|m_s| m_s.abs() <= SPEED_MAX_M_S)
        && object.half_size_m.into_iter().all(size)
}
