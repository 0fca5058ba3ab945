//! Tours of the fleet through viewpoints: which robot visits which, and in which order.
//!
//! A travelling-deliveryman problem with several vehicles: the sum over viewpoints of weight times arrival is small, so
//! that much is seen early, and so is the last arrival. Cheapest insertion, then three moves until none improves: a part of
//! a tour goes elsewhere (Or 1976), a part is reversed (Lin 1965), two tours exchange their ends (Potvin and Rousseau 1995).
//! Deterministic and bounded.
//!
//! Such a search ends in one of many local optima, and a small change of the times may lead to another one. So the
//! tours of the last plan are improved too, and are replaced only by better ones: else two plans of nearly the same cost,
//! whose first viewpoints lie on opposite sides, could turn a robot to and fro for ever.

/// Most moves that are tried for one solution. Each costs about as many additions as a tour has viewpoints.
const TRIES_MAX: usize = 100_000;
/// Most viewpoints of a part that goes elsewhere.
const PART_MAX: usize = 3;
/// Least improvement that counts, relative. Less would let rounding decide.
const IMPROVEMENT_MIN: f64 = 1e-6;

/// Times of travel of a fleet between viewpoints, and what they are worth.
#[derive(Clone, Debug, Default)]
pub(super) struct TourProblem {
    /// Time from robot `r` to viewpoint `v`, seconds: `from_robot_s[r][v]`; infinite if unreachable.
    pub(super) from_robot_s: Vec<Vec<f64>>,
    /// Time between viewpoints, seconds.
    pub(super) between_s: Vec<Vec<f64>>,
    /// Time to look around at each viewpoint, seconds.
    pub(super) service_s: Vec<f64>,
    /// Worth of seeing each viewpoint early.
    pub(super) weight: Vec<f64>,
    /// Worth of ending early, in the unit of the weights.
    pub(super) makespan_weight: f64,
    /// The viewpoints that remain of each robot's tour of the last plan, in its order; each in one tour at most.
    pub(super) previous: Vec<Vec<usize>>,
}

impl TourProblem {
    /// Solves the problem: a list of viewpoints per robot. Viewpoints that no robot reaches are left out.
    pub(super) fn solve(&self) -> Vec<Vec<usize>> {
        let robots = self.from_robot_s.len();
        if robots == 0 {
            return Vec::new();
        }
        let new = Search::complete(self, vec![Vec::new(); robots]);
        if self.previous.iter().all(Vec::is_empty) {
            return new.tours;
        }
        let mut kept = self.previous.clone();
        kept.resize(robots, Vec::new());
        for (robot, tour) in kept.iter_mut().enumerate() {
            tour.retain(|viewpoint| self.from_robot_s[robot][*viewpoint].is_finite());
        }
        let kept = Search::complete(self, kept);
        if new.total() < kept.total() * (1.0 - IMPROVEMENT_MIN) { new.tours } else { kept.tours }
    }

    /// Time at the end of one robot's tour, seconds.
    pub(super) fn duration_s(&self, robot: usize, tour: &[usize]) -> f64 {
        self.tour_cost(robot, tour).end_s
    }

    fn tour_cost(&self, robot: usize, tour: &[usize]) -> TourCost {
        let mut cost = TourCost::default();
        let mut last: Option<usize> = None;
        for viewpoint in tour {
            cost.end_s += match last {
                None => self.from_robot_s[robot][*viewpoint],
                Some(last) => self.between_s[last][*viewpoint],
            };
            cost.end_s += self.service_s[*viewpoint];
            cost.arrivals += self.weight[*viewpoint] * cost.end_s;
            last = Some(*viewpoint);
        }
        cost
    }
}

/// Cost of one robot's tour.
#[derive(Clone, Copy, Debug, Default)]
struct TourCost {
    /// Sum of weight times arrival.
    arrivals: f64,
    /// Time at its end, seconds.
    end_s: f64,
}

/// A local search: tours with their costs.
struct Search<'a> {
    problem: &'a TourProblem,
    tours: Vec<Vec<usize>>,
    costs: Vec<TourCost>,
    /// Tours that a move makes of one or two, before it is judged.
    first: Vec<usize>,
    second: Vec<usize>,
    tries: usize,
}

impl<'a> Search<'a> {
    /// Inserts the viewpoints that are missing in tours, and improves them.
    fn complete(problem: &'a TourProblem, tours: Vec<Vec<usize>>) -> Self {
        let costs = tours.iter().enumerate().map(|(robot, tour)| problem.tour_cost(robot, tour)).collect();
        let mut search = Self { problem, tours, costs, first: Vec::new(), second: Vec::new(), tries: 0 };
        search.insert_missing();
        while search.improve() && search.tries < TRIES_MAX {}
        search
    }

    fn total(&self) -> f64 {
        self.total_with(&[])
    }

    /// Total cost if some robots had tours of other costs.
    fn total_with(&self, changed: &[(usize, TourCost)]) -> f64 {
        let (mut arrivals, mut latest_s) = (0.0, 0.0_f64);
        for (robot, cost) in self.costs.iter().enumerate() {
            let cost = changed.iter().find(|(other, _)| *other == robot).map_or(cost, |(_, cost)| cost);
            arrivals += cost.arrivals;
            latest_s = latest_s.max(cost.end_s);
        }
        arrivals + self.problem.makespan_weight * latest_s
    }

    /// Inserts the viewpoints that no tour has where they cost least, the weightiest first; leaves out what no robot reaches.
    fn insert_missing(&mut self) {
        let weight = &self.problem.weight;
        let is_missing = |viewpoint: &usize| !self.tours.iter().any(|tour| tour.contains(viewpoint));
        let mut order: Vec<usize> = (0..weight.len()).filter(is_missing).collect();
        order.sort_by(|a, b| weight[*b].total_cmp(&weight[*a]).then(a.cmp(b)));
        for viewpoint in order {
            let mut best: Option<(f64, usize, usize)> = None;
            for robot in 0..self.tours.len() {
                for place in 0..=self.tours[robot].len() {
                    self.first.clone_from(&self.tours[robot]);
                    self.first.insert(place, viewpoint);
                    let total = self.total_with(&[(robot, self.problem.tour_cost(robot, &self.first))]);
                    if total.is_finite() && best.is_none_or(|(least, ..)| total < least) {
                        best = Some((total, robot, place));
                    }
                }
            }
            if let Some((_, robot, place)) = best {
                self.tours[robot].insert(place, viewpoint);
                self.costs[robot] = self.problem.tour_cost(robot, &self.tours[robot]);
            }
        }
    }

    /// Tries all moves once, and makes each that improves. Returns false if none did.
    fn improve(&mut self) -> bool {
        let mut has_improved = false;
        for from in 0..self.tours.len() {
            for to in 0..self.tours.len() {
                has_improved |= self.move_parts(from, to);
                if from < to {
                    has_improved |= self.exchange_ends(from, to);
                }
            }
            has_improved |= self.reverse_parts(from);
        }
        has_improved
    }

    /// Moves parts of one tour to other places, in it or in another tour, in both directions.
    fn move_parts(&mut self, from: usize, to: usize) -> bool {
        let mut has_improved = false;
        for length in 1..=PART_MAX {
            let mut begin = 0;
            while begin + length <= self.tours[from].len() {
                let rest = self.tours[from].len() - length;
                let places = if from == to { rest } else { self.tours[to].len() };
                for (place, is_reversed) in (0..=places).flat_map(|place| [(place, false), (place, true)]) {
                    if is_reversed && length == 1 {
                        continue;
                    }
                    if self.try_part((from, begin, length), (to, place), is_reversed) {
                        has_improved = true;
                        break;
                    }
                }
                begin += 1;
            }
        }
        has_improved
    }

    /// Moves one part if that improves.
    fn try_part(
        &mut self,
        (from, begin, length): (usize, usize, usize),
        (to, place): (usize, usize),
        is_reversed: bool,
    ) -> bool {
        let Self { tours, first, second, .. } = self;
        let part = &tours[from][begin..begin + length];
        first.clear();
        first.extend_from_slice(&tours[from][..begin]);
        first.extend_from_slice(&tours[from][begin + length..]);
        let target = if from == to {
            first
        } else {
            second.clone_from(&tours[to]);
            second
        };
        target.splice(place..place, part.iter().copied());
        if is_reversed {
            target[place..place + length].reverse();
        }
        self.accept(from, (from != to).then_some(to))
    }

    /// Reverses parts of a tour.
    fn reverse_parts(&mut self, robot: usize) -> bool {
        let mut has_improved = false;
        for begin in 0..self.tours[robot].len() {
            for end in begin + 2..=self.tours[robot].len() {
                self.first.clone_from(&self.tours[robot]);
                self.first[begin..end].reverse();
                has_improved |= self.accept(robot, None);
            }
        }
        has_improved
    }

    /// Exchanges the ends of two tours, from some viewpoint of each on.
    fn exchange_ends(&mut self, one: usize, other: usize) -> bool {
        let mut has_improved = false;
        for i in 0..=self.tours[one].len() {
            for j in 0..=self.tours[other].len() {
                // Moves that were made shorten one of them.
                let i = i.min(self.tours[one].len());
                let j = j.min(self.tours[other].len());
                let Self { tours, first, second, .. } = self;
                first.clear();
                first.extend_from_slice(&tours[one][..i]);
                first.extend_from_slice(&tours[other][j..]);
                second.clear();
                second.extend_from_slice(&tours[other][..j]);
                second.extend_from_slice(&tours[one][i..]);
                has_improved |= self.accept(one, Some(other));
            }
        }
        has_improved
    }

    /// Takes the tour in `first` for one robot, and the one in `second` for another, if that improves.
    fn accept(&mut self, robot: usize, other: Option<usize>) -> bool {
        self.tries += 1;
        let cost = self.problem.tour_cost(robot, &self.first);
        let other_cost = other.map(|other| (other, self.problem.tour_cost(other, &self.second)));
        let total = match other_cost {
            Some(other) => self.total_with(&[(robot, cost), other]),
            None => self.total_with(&[(robot, cost)]),
        };
        if self.tries > TRIES_MAX || total >= self.total() * (1.0 - IMPROVEMENT_MIN) {
            return false;
        }
        core::mem::swap(&mut self.tours[robot], &mut self.first);
        self.costs[robot] = cost;
        if let Some((other, cost)) = other_cost {
            core::mem::swap(&mut self.tours[other], &mut self.second);
            self.costs[other] = cost;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn on_a_line(robots: &[f64], viewpoints: &[f64]) -> TourProblem {
        let time_s = |a: f64, b: f64| (a - b).abs();
        TourProblem {
            from_robot_s: robots
                .iter()
                .map(|r| viewpoints.iter().map(|v| time_s(*r, *v)).collect())
                .collect(),
            between_s: viewpoints
                .iter()
                .map(|a| viewpoints.iter().map(|b| time_s(*a, *b)).collect())
                .collect(),
            service_s: vec![0.0; viewpoints.len()],
            weight: vec![1.0; viewpoints.len()],
            makespan_weight: 1.0,
            previous: Vec::new(),
        }
    }

    #[test]
    fn robots_visit_what_is_on_their_side_in_order() {
        let problem = on_a_line(&[0.0, 10.0], &[2.0, 8.0, 1.0, 9.0]);
        assert_eq!(problem.solve(), [vec![2, 0], vec![3, 1]]);
    }

    #[test]
    fn one_robot_turns_to_the_side_with_more_to_see() {
        let mut problem = on_a_line(&[0.0], &[-2.0, 3.0]);
        assert_eq!(problem.solve(), [vec![0, 1]]);
        problem.weight = vec![1.0, 20.0];
        assert_eq!(problem.solve(), [vec![1, 0]]);
    }

    proptest! {
        #[test]
        fn a_robot_that_turns_a_little_does_not_change_sides_again_and_again(
            places_m in prop::collection::vec((-8.0..8.0, -8.0..8.0), 2..24),
            weights in prop::collection::vec(0.5..10.0, 24),
            turns_s in prop::collection::vec(-1.0..1.0, 12),
        ) {
            let time_s = |a: (f64, f64), b: (f64, f64)| 5.0 * (a.0 - b.0).hypot(a.1 - b.1);
            let count = places_m.len();
            let mut problem = TourProblem {
                between_s: places_m.iter().map(|a| places_m.iter().map(|b| time_s(*a, *b)).collect()).collect(),
                service_s: vec![0.0; count],
                weight: weights[..count].to_vec(),
                makespan_weight: 10.0,
                ..TourProblem::default()
            };
            let mut changes = 0;
            for turn_s in turns_s {
                // To turn to one side takes longer, and to the other less; to change the goal costs 5 s.
                let goal = problem.previous.first().and_then(|tour| tour.first()).copied();
                let from_robot_s = |(i, place): (usize, &(f64, f64))| {
                    let switch_s = if goal.is_some_and(|goal| goal != i) { 5.0 } else { 0.0 };
                    2.0 + time_s((0.0, 0.0), *place) + turn_s * place.0.signum() + switch_s
                };
                problem.from_robot_s = vec![places_m.iter().enumerate().map(from_robot_s).collect()];
                let tours = problem.solve();
                changes += u32::from(goal.is_some_and(|goal| goal != tours[0][0]));
                problem.previous = tours;
            }
            prop_assert!(changes <= 1, "{changes} changes");
        }
    }

    #[test]
    fn what_no_robot_reaches_is_left_out() {
        let mut problem = on_a_line(&[0.0], &[1.0, 2.0]);
        problem.from_robot_s[0][1] = f64::INFINITY;
        problem.between_s[0][1] = f64::INFINITY;
        assert_eq!(problem.solve(), [vec![0]]);
        assert!(TourProblem::default().solve().is_empty());
    }
}
