//! Rooms drawn from a kind and a seed, in which exploration is worth while.
//!
//! The same kind and seed give the same room on every platform. All doors are at least 0.9 m wide, and furniture
//! keeps 0.7 m of lanes free, so that all parts of a room are connected for a robot.

mod buildings;
mod draw;
mod halls;

use super::Room;
use draw::Draw;

/// Kind of a generated room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RoomKind {
    /// Office floor of 30 m by 20 m: a ring of corridors, rooms outside and inside of it.
    Office,
    /// Warehouse of 24 m by 16 m: rows of racks with aisles, and an area of pallets.
    Warehouse,
    /// School of 30 m by 15 m: classrooms at both sides of a corridor.
    School,
    /// Museum of about 24 m by 18 m: halls in a grid, joined by wide doors, with exhibits.
    Museum,
    /// Flat of 11 m by 9 m: five rooms with much furniture.
    Flat,
    /// Open hall in the shape of an L, 22 m by 18 m, with a few columns and boxes.
    Hall,
}

impl RoomKind {
    /// All kinds, in the order of tables.
    pub const ALL: [Self; 6] =
        [Self::Office, Self::Warehouse, Self::School, Self::Museum, Self::Flat, Self::Hall];

    /// Returns the name, as in `--room`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Office => "office",
            Self::Warehouse => "warehouse",
            Self::School => "school",
            Self::Museum => "museum",
            Self::Flat => "flat",
            Self::Hall => "hall",
        }
    }

    /// Returns the kind with this name; `None` if there is none.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

impl Room {
    /// Generates a room. Any seed is good; its origin is the room's centre.
    pub fn generate(kind: RoomKind, seed: u64) -> Room {
        let mut draw = Draw::new(seed);
        match kind {
            RoomKind::Office => buildings::add_office(&mut draw),
            RoomKind::School => buildings::add_school(&mut draw),
            RoomKind::Museum => buildings::add_museum(&mut draw),
            RoomKind::Flat => buildings::add_flat(&mut draw),
            RoomKind::Warehouse => halls::add_warehouse(&mut draw),
            RoomKind::Hall => halls::add_hall(&mut draw),
        }
        let name = format!("{}:{seed}", kind.name());
        Room::from_mesh(&name, draw.into_mesh(), Some(0.0))
            .unwrap_or_else(|error| unreachable!("the generated room {name} is valid: {error}"))
    }

    /// Reads the name of a generated room: a kind, or `KIND:SEED`; the seed is 1 if it is left out.
    ///
    /// Returns `None` if the name is of another form.
    pub fn parse_generated(name: &str) -> Option<(RoomKind, u64)> {
        let (kind, seed) = name.split_once(':').unwrap_or((name, "1"));
        RoomKind::from_name(kind).zip(seed.parse().ok())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::ROBOTS_MAX;

    #[test]
    fn every_kind_is_one_connected_room_for_a_robot() {
        for (kind, seed) in RoomKind::ALL.into_iter().flat_map(|kind| (1..=6).map(move |seed| (kind, seed))) {
            let room = Room::generate(kind, seed);
            assert!(room.starts(8.min(ROBOTS_MAX)).is_ok(), "{}", room.name());
            let ground = &room.ground;
            let wide: Vec<bool> =
                (0..ground.raster.len()).map(|c| ground.floor[c] && ground.clearance_m[c] >= 0.22).collect();
            let (regions, sizes) = ground.raster.regions(&wide);
            let largest = (1..sizes.len()).max_by_key(|region| sizes[*region]).unwrap_or(0) as u32;
            // The insides of furniture are regions too; a part that is cut off would be wider than they are.
            for cell in (0..regions.len()).filter(|cell| regions[*cell] != 0 && regions[*cell] != largest) {
                let at_m = ground.raster.centre_m(cell);
                assert!(ground.clearance_m[cell] < 0.72, "{}: {at_m:?} is cut off", room.name());
            }
        }
    }

    #[test]
    fn a_seed_gives_one_room_and_another_seed_another() {
        let plan = |seed| Room::generate(RoomKind::Flat, seed).floor_plan(0.1).cells;
        assert_eq!(plan(3), plan(3));
        assert_ne!(plan(3), plan(4));
    }

    #[test]
    fn names_are_kinds_with_an_optional_seed() {
        assert_eq!(Room::parse_generated("office"), Some((RoomKind::Office, 1)));
        assert_eq!(Room::parse_generated("flat:12"), Some((RoomKind::Flat, 12)));
        assert_eq!(Room::parse_generated("flat:x"), None);
        assert_eq!(Room::parse_generated("flat.obj"), None);
    }
}
