//! Lost robots of an exploration: each looks for its place, several times with pauses.

use super::types::{CoordinatedRobot, RobotAvailability};
use crate::navigation::{FleetNavigator, NavigationInput, NavigationState};
use msg::{ROBOTS_MAX, RobotId, Stamp};

/// Time after which a robot without a pose looks for its place, seconds: a restart of SLAM and a relocalization of a robot that
/// stands take less.
const LOST_S: f64 = 10.0;

/// Pause after a search in vain, seconds: below the time after which an exploration without robots fails.
const PAUSE_S: f64 = 30.0;

/// Most searches each time that a robot is lost: ten minutes of driving. One wander of two minutes sees a part of a hall.
const SEARCHES_MAX: u32 = 5;

/// What is done about a robot that may be lost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Loss {
    /// Its pose is known, or it is not the exploration's to drive.
    #[default]
    None,
    /// It stands, without a pose since then.
    Waiting(Stamp),
    /// It looks for its place, for the time of this number, from 1.
    Searching { search: u32 },
    /// It has looked so many times in vain, the last time until then.
    Searched { searches: u32, until: Stamp },
}

/// The robots of an exploration that do not know where they are.
#[derive(Clone, Debug)]
pub(super) struct LostRobots([Loss; ROBOTS_MAX]);

impl Default for LostRobots {
    fn default() -> Self {
        Self([Loss::None; ROBOTS_MAX])
    }
}

impl LostRobots {
    /// Whether a robot looks for its place now.
    pub(super) fn is_searching(&self, robot: RobotId) -> bool {
        matches!(self.0[robot.index()], Loss::Searching { .. })
    }

    /// Has robots that were lost for some time look for their places, and ends that when their poses are known or somebody takes them.
    pub(super) fn step(
        &mut self,
        navigator: &mut FleetNavigator,
        input: &NavigationInput,
        robots: &[CoordinatedRobot],
    ) {
        let now = input.stamp;
        for robot in robots {
            let (id, loss) = (robot.robot, &mut self.0[robot.robot.index()]);
            if robot.availability != RobotAvailability::Lost {
                if matches!(loss, Loss::Searching { .. }) {
                    navigator.end_place_search(id);
                }
                *loss = Loss::None;
                continue;
            }
            let is_searching = || {
                let state = navigator.robots().find(|navigation| navigation.robot == id).map(|it| it.state);
                state == Some(NavigationState::FindingPlace)
            };
            // A robot that does not know where it is cannot keep out of zones.
            let may_search = input.exclusion_zones.is_empty();
            *loss = match *loss {
                Loss::None => Loss::Waiting(now),
                Loss::Waiting(since) if now - since >= LOST_S && may_search => {
                    navigator.find_place(now, id);
                    Loss::Searching { search: 1 }
                }
                Loss::Searching { search } if !is_searching() => {
                    Loss::Searched { searches: search, until: now }
                }
                Loss::Searched { searches, until }
                    if searches < SEARCHES_MAX && now - until >= PAUSE_S && may_search =>
                {
                    navigator.find_place(now, id);
                    Loss::Searching { search: searches + 1 }
                }
                same => same,
            };
        }
    }

    /// Ends all searches.
    pub(super) fn stop(&mut self, navigator: &mut FleetNavigator) {
        for robot in RobotId::first(ROBOTS_MAX).filter(|robot| self.is_searching(*robot)) {
            navigator.end_place_search(robot);
        }
        self.0.fill(Loss::None);
    }
}
