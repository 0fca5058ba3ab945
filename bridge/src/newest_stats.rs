//! The newest figures of telemetry, until they are too old to say anything of now.

use crate::silence::SILENT;
use msg::{FleetStats, Monotonic};

/// The newest figures; none when telemetry has not renewed them for [`SILENT`]: what it said last would look true for ever.
#[derive(Default)]
pub struct NewestStats {
    stats: Option<Box<FleetStats>>,
    /// When they were first seen; `None` until the first tick after they came.
    since: Option<Monotonic>,
}

impl NewestStats {
    /// Takes newer figures in place of those before.
    pub fn set(&mut self, stats: &FleetStats) {
        self.since = None;
        match &mut self.stats {
            Some(newest) => **newest = *stats,
            None => self.stats = Some(Box::new(*stats)),
        }
    }

    /// Forgets figures that are too old. Call it often: their age is counted from the first call after they came.
    pub fn tick(&mut self, now: Monotonic) {
        if now > *self.since.get_or_insert(now) + SILENT {
            self.stats = None;
        }
    }

    /// Returns the figures that are known now.
    pub fn get(&self) -> Option<&FleetStats> {
        self.stats.as_deref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::time::Duration;

    proptest! {
        #[test]
        fn figures_are_known_while_they_are_renewed(renewed_ms in proptest::collection::vec(0..20_000_u64, 0..8)) {
            let mut newest = NewestStats::default();
            let mut came = None;
            for now_ms in (0..30_000).step_by(100) {
                let has_come = renewed_ms.iter().any(|at| *at >= now_ms && *at < now_ms + 100);
                if has_come {
                    newest.set(&FleetStats::default());
                    came = Some(now_ms);
                }
                newest.tick(Monotonic(0) + Duration::from_millis(now_ms));
                prop_assert_eq!(newest.get().is_some(), came.is_some_and(|came| now_ms - came <= 3000));
            }
        }
    }
}
