//! Tours of the fleet through viewpoints: which robot visits which, and in which order.
//!
//! A travelling-deliveryman problem with several vehicles: the sum over viewpoints of weight times arrival is small, so
//! that much is seen early, and so is the last arrival. Cheapest insertion, then relocation and exchange until nothing
//! improves (as for vehicle routing, Lin 1965; Or 1976). Deterministic and bounded.

/// Most improvements of one solution. Each costs at most some tens of thousands of additions.
const IMPROVEMENTS_MAX: usize = 60;
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
}

impl TourProblem {
    /// Solves the problem: a list of viewpoints per robot. Viewpoints that no robot reaches are left out.
    pub(super) fn solve(&self) -> Vec<Vec<usize>> {
        let mut tours = vec![Vec::new(); self.from_robot_s.len()];
        if tours.is_empty() {
            return tours;
        }
        self.insert_all(&mut tours);
        for _ in 0..IMPROVEMENTS_MAX {
            if !self.improve(&mut tours) {
                break;
            }
        }
        tours
    }

    /// Time at the end of one robot's tour, seconds.
    pub(super) fn duration_s(&self, robot: usize, tour: &[usize]) -> f64 {
        self.tour_cost(robot, tour).1
    }

    /// Cost of one robot's tour: weighted arrivals, and the time at its end.
    fn tour_cost(&self, robot: usize, tour: &[usize]) -> (f64, f64) {
        let (mut at_s, mut cost) = (0.0, 0.0);
        let mut last: Option<usize> = None;
        for viewpoint in tour {
            at_s += match last {
                None => self.from_robot_s[robot][*viewpoint],
                Some(last) => self.between_s[last][*viewpoint],
            };
            at_s += self.service_s[*viewpoint];
            cost += self.weight[*viewpoint] * at_s;
            last = Some(*viewpoint);
        }
        (cost, at_s)
    }

    fn total(&self, costs: &[(f64, f64)]) -> f64 {
        let latest_s = costs.iter().map(|cost| cost.1).fold(0.0, f64::max);
        costs.iter().map(|cost| cost.0).sum::<f64>() + self.makespan_weight * latest_s
    }

    fn costs(&self, tours: &[Vec<usize>]) -> Vec<(f64, f64)> {
        tours.iter().enumerate().map(|(robot, tour)| self.tour_cost(robot, tour)).collect()
    }

    /// Inserts the viewpoints where they cost least, the weightiest first.
    fn insert_all(&self, tours: &mut [Vec<usize>]) {
        let mut order: Vec<usize> = (0..self.weight.len()).collect();
        order.sort_by(|a, b| self.weight[*b].total_cmp(&self.weight[*a]).then(a.cmp(b)));
        for viewpoint in order {
            self.insert_best(tours, viewpoint);
        }
    }

    /// Inserts one viewpoint where it costs least; leaves it out if no robot reaches it.
    fn insert_best(&self, tours: &mut [Vec<usize>], viewpoint: usize) {
        let mut costs = self.costs(tours);
        let mut best: Option<(f64, usize, usize)> = None;
        for robot in 0..tours.len() {
            let old = costs[robot];
            for place in 0..=tours[robot].len() {
                tours[robot].insert(place, viewpoint);
                costs[robot] = self.tour_cost(robot, &tours[robot]);
                let total = self.total(&costs);
                tours[robot].remove(place);
                if total.is_finite() && best.is_none_or(|(least, ..)| total < least) {
                    best = Some((total, robot, place));
                }
            }
            costs[robot] = old;
        }
        if let Some((_, robot, place)) = best {
            tours[robot].insert(place, viewpoint);
        }
    }

    /// Makes the best relocation of one viewpoint, or reversal of a part of a tour. Returns false if none improves.
    fn improve(&self, tours: &mut Vec<Vec<usize>>) -> bool {
        let costs = self.costs(tours);
        let before = self.total(&costs);
        let mut best: Option<(f64, Vec<Vec<usize>>)> = None;
        let mut consider = |candidate: &[Vec<usize>]| {
            let total = self.total(&self.costs(candidate));
            if total < before * (1.0 - IMPROVEMENT_MIN)
                && best.as_ref().is_none_or(|(least, _)| total < *least)
            {
                best = Some((total, candidate.to_vec()));
            }
        };
        let mut candidate = tours.clone();
        for robot in 0..tours.len() {
            for place in 0..tours[robot].len() {
                let viewpoint = candidate[robot].remove(place);
                self.insert_best(&mut candidate, viewpoint);
                consider(&candidate);
                candidate.clone_from(tours);
                for end in place + 1..tours[robot].len() {
                    candidate[robot][place..=end].reverse();
                    consider(&candidate);
                    candidate[robot].clone_from(&tours[robot]);
                }
            }
        }
        match best {
            Some((_, better)) => {
                *tours = better;
                true
            }
            None => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn what_no_robot_reaches_is_left_out() {
        let mut problem = on_a_line(&[0.0], &[1.0, 2.0]);
        problem.from_robot_s[0][1] = f64::INFINITY;
        problem.between_s[0][1] = f64::INFINITY;
        assert_eq!(problem.solve(), [vec![0]]);
        assert!(TourProblem::default().solve().is_empty());
    }
}
