//! The estimate of a source's clock.

use super::super::suspects::STEP_MESSAGES;
use super::*;
use proptest::prelude::*;

const SECOND: i64 = 1_000_000_000;

/// Sends a message every 50 ms, delayed by `delay_s(i)`; returns the clock, and the largest error of a stamp after
/// the first `settle` messages.
fn measure(
    offset_s: f64,
    drift_ppm: f64,
    messages: usize,
    settle: usize,
    delay_s: impl Fn(usize) -> f64,
) -> (SourceClock, f64) {
    let mut clock = SourceClock::new(ClockOffset::Measured);
    let mut worst: f64 = 0.0;
    for i in 0..messages {
        let at_s = 1000.0 + 0.05 * i as f64;
        let there_s = at_s * (1.0 + drift_ppm * 1e-6) + offset_s;
        let stamp = clock.convert(Stamp::from_seconds(there_s), Stamp::from_seconds(at_s + delay_s(i)));
        if i >= settle {
            let stamp = stamp.expect("no message of a clock that was not set is dropped");
            worst = worst.max((stamp - Stamp::from_seconds(at_s)).abs());
        }
    }
    (clock, worst)
}

/// A pseudo-random number in 0..1.
fn noise(i: usize) -> f64 {
    (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as f64 / (1_u64 << 24) as f64
}

#[test]
fn an_offset_of_five_seconds_is_measured() {
    let wifi = |i: usize| 0.001 + 0.02 * noise(i).powi(4);
    let (clock, worst) = measure(5.0, 0.0, 1200, 20, wifi);
    let estimate = clock.estimate().unwrap();
    assert!((estimate.offset_s - 5.0).abs() < 2e-3, "{estimate:?}");
    assert!(worst < 3e-3, "{worst}");
    assert!(estimate.spread_p95_ms > 5.0 && estimate.spread_p95_ms < 21.0, "{estimate:?}");
    assert_eq!((estimate.messages, estimate.steps), (1200, 0));
}

#[test]
fn a_drifting_clock_is_followed_and_a_step_is_found() {
    let (clock, worst) = measure(-5.0, 80.0, 6000, 600, |i| 0.001 + 0.004 * noise(i));
    let estimate = clock.estimate().unwrap();
    assert!((estimate.drift_ppm - 80.0).abs() < 15.0, "{estimate:?}");
    assert!(worst < 3e-3, "{worst}");

    let mut clock = SourceClock::new(ClockOffset::Measured);
    for (offset_s, from) in [(5.0, 0), (60.0, 400), (-3.0, 800)] {
        for i in from..from + 400 {
            let at_s = 0.05 * i as f64;
            let _ = clock.convert(Stamp::from_seconds(at_s + offset_s), Stamp::from_seconds(at_s + 0.002));
        }
        let estimate = clock.estimate().unwrap();
        assert!((estimate.offset_s - offset_s).abs() < 3e-3, "{offset_s}: {estimate:?}");
    }
    let estimate = clock.estimate().unwrap();
    assert_eq!((estimate.steps, estimate.outliers), (2, 4), "ahead, the fifth message is believed");
    assert!((clock.take_step().unwrap() - (-3.0 - 5.0)).abs() < 0.01);
    assert_eq!(clock.take_step(), None);
}

#[test]
fn a_stalled_network_is_not_taken_for_a_clock_step() {
    // Every 10 s the network stalls for 2 s, and then delivers everything at once.
    let stalls = |i: usize| 0.001 + if i % 200 < 40 { 0.05 * (40 - i % 200) as f64 } else { 0.0 };
    let (clock, worst) = measure(5.0, 0.0, 2000, 60, stalls);
    assert_eq!(clock.estimate().unwrap().steps, 0);
    assert!(worst < 3e-3, "{worst}");
}

#[test]
fn a_first_message_that_is_faster_than_the_others_is_believed() {
    let (clock, worst) = measure(5.0, 0.0, 400, 0, |i| if i == 0 { 0.001 } else { 0.001 + 0.2 * noise(i) });
    assert_eq!((clock.estimate().unwrap().steps, clock.estimate().unwrap().outliers), (0, 0));
    assert!(worst < 3e-3, "{worst}");
}

#[test]
fn a_fixed_offset_is_applied_unmeasured() {
    let mut clock = SourceClock::new(ClockOffset::Fixed(5.0));
    assert_eq!(clock.convert(Stamp(7 * SECOND), Stamp(0)), Ok(Stamp(2 * SECOND)));
    assert_eq!(clock.estimate().unwrap().offset_s, 5.0);
    let read = |text: &str| serde_json::from_str::<ClockOffset>(text);
    assert_eq!(read("\"measured\"").unwrap(), ClockOffset::Measured);
    assert_eq!(read("-2.5").unwrap(), ClockOffset::Fixed(-2.5));
    assert!(read("\"guessed\"").is_err());
    assert_eq!(serde_json::to_string(&ClockOffset::Measured).unwrap(), "\"measured\"");
}

proptest! {
    #[test]
    fn a_constant_delay_is_measured_at_any_offset(offset_s in -1e9_f64..1e9, delay_s in 0.0..0.1) {
        let (clock, worst) = measure(offset_s, 0.0, 300, 0, |_| delay_s);
        prop_assert!((clock.estimate().unwrap().offset_s - offset_s + delay_s).abs() < 1e-3);
        prop_assert!(worst < delay_s + 1e-3, "{worst}");
    }

    #[test]
    fn a_single_wrong_stamp_at_any_place_changes_nothing(
        place in prop_oneof![Just(0), Just(1), 0_usize..300],
        size_s in prop_oneof![0.06..0.9_f64, 1.1..10.0, 10.0..1e9],
        is_ahead in any::<bool>(),
        copies in 1_usize..20,
    ) {
        let mut clock = SourceClock::new(ClockOffset::Measured);
        let mut refused = 0;
        for i in 0..400 {
            let at_s = 1000.0 + 0.05 * i as f64;
            let received = Stamp::from_seconds(at_s + 0.002);
            if i == place {
                // A message can have several transforms, all with the same stamp.
                let wrong_s = at_s + 5.0 + if is_ahead { size_s } else { -size_s };
                for _ in 0..copies {
                    let _ = clock.convert(Stamp::from_seconds(wrong_s), received);
                }
                continue;
            }
            match clock.convert(Stamp::from_seconds(at_s + 5.0), received) {
                Ok(stamp) if place > 0 || i > STEP_MESSAGES => {
                    prop_assert!((stamp - received).abs() < 1e-3, "{}", stamp - received);
                }
                Ok(_) => {}
                Err(_) => refused += 1,
            }
        }
        prop_assert_eq!(clock.estimate().unwrap().steps, 0);
        // If the first message is wrong, the next ones are not believed until they agree.
        prop_assert!(refused == 0 || (place == 0 && refused < STEP_MESSAGES), "{refused}");
        prop_assert_eq!(clock.take_step(), None);
    }

    #[test]
    fn any_stamps_give_a_finite_estimate(stamps in proptest::collection::vec((any::<i32>(), any::<u32>(), 0_i64..SECOND), 1..300)) {
        let mut clock = SourceClock::new(ClockOffset::Measured);
        let mut received = 0;
        for (sec, nanosec, step) in stamps {
            received += step;
            let _ = clock.convert(Stamp(i64::from(sec) * SECOND + i64::from(nanosec)), Stamp(received));
        }
        let estimate = clock.estimate().unwrap();
        prop_assert!(estimate.offset_s.is_finite() && estimate.spread_p95_ms.is_finite());
    }

    #[test]
    fn stamps_stay_in_order_without_a_clock_step(
        delays in proptest::collection::vec(0.0..0.04_f64, 100..400),
    ) {
        let mut clock = SourceClock::new(ClockOffset::Measured);
        let mut before = Stamp(i64::MIN);
        for (i, delay_s) in delays.iter().enumerate() {
            let at_s = 0.05 * i as f64;
            let stamp = clock.convert(Stamp::from_seconds(at_s + 5.0), Stamp::from_seconds(at_s + delay_s));
            let stamp = stamp.unwrap();
            prop_assert!(stamp > before);
            before = stamp;
        }
    }
}
