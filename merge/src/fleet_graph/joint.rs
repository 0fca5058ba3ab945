//! The fleet's joint graph: what is put together, and what comes of its solution.

use super::task::{Job, Problem, ProblemPair, Solution, Task};
use super::{FleetPoseGraph, robots_of};
use msg::{EdgeState, Pose2};
use posegraph::{Edge, Kernel, information_from_sigmas};

/// Closures that make an edge of two robots that others had brought together.
const CLOSURES_MIN: usize = 2;
/// How well a given start is known, metres and radians; and the frame of the fleet itself.
const START: [f64; 2] = [0.02, 0.005];
const FRAME: [f64; 2] = [1e-3, 1e-4];
/// Map transforms and drawn maps follow the graph in steps of half a cell of 0.05 m.
const TOLERANCE_M: f64 = 0.025;

impl FleetPoseGraph {
    /// Robots that nothing in force ties to the fleet's frame are taken out; those newly tied get a place.
    pub(super) fn connect(&mut self) {
        let mut reached: Vec<bool> = self.members.iter().map(|member| member.start.is_some()).collect();
        if let Some((holder, _)) = self.holder {
            reached[holder] = true;
        }
        // As often as there are robots: a path has no more edges.
        for _ in 0..self.members.len() {
            for (index, pair) in self.pairs.iter().enumerate().filter(|(_, pair)| pair.state().in_force()) {
                let [a, b] = robots_of(index);
                for (from, to, from_from_to) in [(a, b, pair.a_from_b), (b, a, pair.a_from_b.inverse())] {
                    if reached[from] && !reached[to] {
                        reached[to] = true;
                        let Some(anchor) = self.members[from].anchor else { continue };
                        let member = &mut self.members[to];
                        if member.anchor.is_none() {
                            let anchor = anchor * from_from_to;
                            (member.anchor, member.corrections) = (Some(anchor), vec![anchor]);
                        }
                    }
                }
            }
        }
        for (member, _) in self.members.iter_mut().zip(reached).filter(|(_, reached)| !*reached) {
            (member.anchor, member.bent, member.straightened) = (None, false, None);
            member.corrections.clear();
        }
    }

    pub(super) fn solve_task(&mut self) -> Option<Task> {
        if !core::mem::take(&mut self.unsolved) {
            return None;
        }
        for (index, pair) in self.pairs.iter_mut().enumerate() {
            let [a, b] = robots_of(index);
            pair.sow(&self.members[a], &self.members[b]);
        }
        let mut problem = Problem {
            poses: vec![Pose2::IDENTITY],
            constraints: Vec::new(),
            members: Vec::new(),
            pairs: Vec::new(),
        };
        let mut place = vec![None; self.members.len()];
        for (index, member) in self.members.iter().enumerate() {
            let (Some(anchor), Some(own)) = (member.anchor, member.poses.first()) else { continue };
            let first = problem.poses.len();
            place[index] = Some(problem.members.len());
            problem.members.push((index, first, member.poses.clone()));
            problem.poses.extend(member.poses.iter().map(|pose| anchor * *pose));
            problem.constraints.extend(member.constraints(first));
            let held = self.holder.filter(|(holder, _)| *holder == index).map(|(_, pose)| (pose, FRAME));
            if let Some((pose, [m, rad])) = member.start.map(|start| (start, START)).or(held) {
                let information = information_from_sigmas(m, rad);
                problem.constraints.push(Edge {
                    a: 0,
                    b: first,
                    a_from_b: pose * *own,
                    information,
                    kernel: Kernel::Quadratic,
                });
            }
        }
        for (index, pair) in self.pairs.iter().enumerate() {
            let [a, b] = robots_of(index);
            let (Some(m), Some(n)) = (place[a], place[b]) else { continue };
            let seed = pair.seed_constraint([problem.members[m].1, problem.members[n].1]);
            problem.pairs.push(ProblemPair {
                pair: index,
                members: [m, n],
                closures: pair.closures.clone(),
                seed,
            });
        }
        (!problem.members.is_empty()).then(|| self.task(Job::Solve(problem))).flatten()
    }

    pub(super) fn solved(&mut self, solution: Solution) {
        self.solutions += 1;
        for (robot, corrections) in solution.members {
            if self.members[robot].anchor.is_some() {
                self.members[robot].settle(corrections, TOLERANCE_M);
            }
        }
        for (index, in_force, residual_m) in solution.pairs {
            let [a, b] = robots_of(index);
            let pair = &mut self.pairs[index];
            (pair.in_force, pair.residual_m) = (in_force, residual_m);
            if let Some((a, b)) = self.members[a].anchor.zip(self.members[b].anchor)
                && (pair.state().in_force() || pair.in_force.len() >= CLOSURES_MIN)
            {
                pair.a_from_b = a.between(b);
                if !pair.state().in_force() && !pair.is_refused(pair.a_from_b) {
                    pair.state = Some(EdgeState::Accepted);
                }
            }
        }
    }

    pub(super) fn straighten_task(&self) -> Option<Task> {
        let robot = (0..self.members.len()).find(|k| self.members[*k].wants_straightening(TOLERANCE_M))?;
        let member = &self.members[robot];
        let anchor = member.anchor?;
        self.task(Job::Straighten {
            robot,
            version: member.version,
            anchor,
            corrections: member.corrections.clone(),
            placed: member.placed_in(anchor.inverse()),
        })
    }

    pub(super) fn match_task(&self) -> Option<Task> {
        for (index, pair) in self.pairs.iter().enumerate() {
            let [a, b] = robots_of(index).map(|robot| &self.members[robot]);
            let Some((on_a, on_b)) = a.anchor.zip(b.anchor) else { continue };
            if pair.is_refused(on_a.between(on_b)) {
                continue;
            }
            let Some(next) = pair.next_match(a, b) else { continue };
            let [i, j] = next.ids;
            let (of_i, of_j) = a.piece(i).zip(b.piece(j))?;
            let grids = [of_i.0.grid.clone(), of_j.0.grid.clone()];
            let (predicted, window) = (next.predicted, next.window);
            return self.task(Job::Match { pair: index, ids: next.ids, grids, predicted, window });
        }
        None
    }
}
