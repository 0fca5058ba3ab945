//! Charge, voltage and urgency of what drivers send.

use super::*;
use proptest::prelude::*;

const ROBOT: RobotId = RobotId::new(1).unwrap();

fn at(seconds: u64) -> Monotonic {
    Monotonic(seconds * 1_000_000_000)
}

fn battery(percentage: f32) -> Battery {
    Battery { percentage, voltage_v: 11.8, is_present: 1, ..Battery::default() }
}

/// Returns what is known after a robot has sent these numbers in turn, one a second.
fn after(sent: &[Battery]) -> BatteryStatus {
    let mut batteries = Batteries::new(1);
    for (battery, second) in sent.iter().zip(0..) {
        batteries.set(ROBOT, battery);
        batteries.tick(at(second));
    }
    batteries.status(ROBOT, &BatteryConfig::default(), at(sent.len() as u64 - 1)).unwrap()
}

fn charge(sent: &[f32]) -> Option<f64> {
    after(&sent.iter().map(|percentage| battery(*percentage)).collect::<Vec<_>>()).charge
}

#[test]
fn a_share_is_one_and_percent_are_told_by_a_number_above_it() {
    assert_eq!(charge(&[0.42]), Some(0.42));
    assert_eq!(charge(&[1.0]), Some(1.0));
    assert_eq!(charge(&[0.0]), Some(0.0), "empty");
    assert_eq!(charge(&[42.0]), Some(0.42));
    assert_eq!(charge(&[116.67]), Some(1.0), "a full battery of a TurtleBot3");
    // Nearly empty, and counted in percent: the robot has said before how it counts.
    assert_eq!(charge(&[5.0, 1.1, 0.8]), Some(0.008));
    assert_eq!(charge(&[42.0, 0.0]), Some(0.0), "empty in both");
    assert_eq!(charge(&[1.1]), None, "full by its voltage, or 1.1 %");
    assert_eq!(charge(&[0.9, 0.8, 0.7]), Some(0.7));
}

#[test]
fn one_wrong_number_makes_no_battery_empty_or_full() {
    assert_eq!(charge(&[0.5, 42.0]), None, "42 % or no charge");
    assert_eq!(charge(&[0.5, 42.0, 0.5]), Some(0.5));
    assert_eq!(charge(&[0.5, 42.0, 117.0, 0.5, 42.0, 0.49]), Some(0.49));
    assert_eq!(charge(&[42.0, 0.9]), None, "0.9 % or 90 %");
    assert_eq!(charge(&[42.0, 0.9, 42.0]), Some(0.42));
    // A driver that was replaced by another one.
    assert_eq!(charge(&[0.5, 42.0, 42.0]), None);
    assert_eq!(charge(&[0.5, 42.0, 42.0, 42.0]), Some(0.42));
    assert_eq!(charge(&[42.0, 0.9, 0.9]), None);
    assert_eq!(charge(&[42.0, 0.9, 0.9, 0.9, 0.8]), Some(0.8));
}

#[test]
fn an_empty_battery_has_no_sign() {
    for sent in [&[-0.0][..], &[42.0, -0.0]] {
        assert!(charge(sent).is_some_and(f64::is_sign_positive), "{sent:?}: {:?}", charge(sent));
    }
}

#[test]
fn what_is_not_measured_is_not_known() {
    for percentage in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, -0.01, 126.0, 1e30] {
        assert_eq!(charge(&[percentage]), None, "{percentage}");
        assert_eq!(charge(&[42.0, percentage]), None, "{percentage}");
    }
    for voltage_v in [f32::NAN, f32::INFINITY, 0.0, -1.0, 11_800.0] {
        assert_eq!(after(&[Battery { voltage_v, ..battery(0.5) }]).voltage_v, None, "{voltage_v}");
    }
    assert_eq!(after(&[battery(f32::NAN)]).voltage_v, Some(11.8), "the voltage is shown all the same");
    let unset = Battery { is_present: 0, ..battery(0.0) };
    assert_eq!(after(&[unset]).charge, None);
    assert_eq!(after(&[Battery { is_present: 0, ..battery(0.6) }]).charge, Some(0.6));
    let statuses = [0, 1, 2, 3, 4, 9]
        .map(|power_supply_status| after(&[Battery { power_supply_status, ..battery(0.5) }]).is_charging);
    assert_eq!(statuses, [None, Some(true), Some(false), Some(false), Some(false), None]);
}

#[test]
fn a_low_charge_is_urgent_unless_it_is_being_charged() {
    let level = |percentage| after(&[battery(percentage)]).level;
    assert_eq!([0.21, 0.2].map(level), [None; 2]);
    assert_eq!([0.19, 0.1].map(level), [Some(BatteryLevel::Low); 2]);
    assert_eq!([0.09, 0.0].map(level), [Some(BatteryLevel::Critical); 2]);
    assert_eq!(after(&[Battery { power_supply_status: 1, ..battery(0.05) }]).level, None);
    assert_eq!(level(f32::NAN), None);
}

#[test]
fn an_old_state_is_not_shown_as_true() {
    let mut batteries = Batteries::new(2);
    batteries.set(ROBOT, &battery(8.0));
    batteries.tick(at(1));
    let status =
        |batteries: &Batteries, now| batteries.status(ROBOT, &BatteryConfig::default(), at(now)).unwrap();
    assert_eq!((status(&batteries, 31).charge, status(&batteries, 31).age_s), (Some(0.08), 30.0));
    batteries.tick(at(32));
    let old = status(&batteries, 32);
    assert_eq!((old.charge, old.voltage_v, old.is_charging, old.level), (None, None, None, None));
    assert_eq!((old.last_charge, old.age_s), (Some(0.08), 31.0), "what it was is known");
    // After a silence another driver may count otherwise.
    batteries.set(ROBOT, &battery(0.8));
    assert_eq!(status(&batteries, 33).charge, Some(0.8));
    let second = RobotId::new(2).unwrap();
    assert_eq!(batteries.status(second, &BatteryConfig::default(), at(33)), None, "it has sent nothing");
    batteries.set(RobotId::new(3).unwrap(), &battery(0.5));
}

proptest! {
    /// Whatever is sent, what is shown is a share, and is level with what a warning says.
    #[test]
    fn any_numbers_give_a_share_or_nothing(bits in prop::collection::vec(any::<[u32; 2]>(), 1..20), codes in any::<[u8; 2]>()) {
        let [power_supply_status, is_present] = codes;
        let sent: Vec<Battery> = bits
            .iter()
            .map(|bits| bits.map(f32::from_bits))
            .map(|[percentage, voltage_v]| Battery { percentage, voltage_v, power_supply_status, is_present, ..Battery::default() })
            .collect();
        let status = after(&sent);
        prop_assert!(status.charge.is_none_or(|charge| (0.0..=1.0).contains(&charge)));
        prop_assert!(status.voltage_v.is_none_or(|volts| (0.0..=1000.0).contains(&volts)));
        prop_assert!(status.level.is_none() || status.charge.is_some_and(|charge| charge < 0.2));
    }

    /// One that counts to 100 and one that counts to 1 are told the same from the first message on.
    #[test]
    fn both_scales_are_read_alike(percent in prop::collection::vec(2.0_f32..100.0, 1..10)) {
        let shares: Vec<f32> = percent.iter().map(|percent| percent / 100.0).collect();
        let (a, b) = (charge(&percent).unwrap(), charge(&shares).unwrap());
        prop_assert!((a - b).abs() < 0.0011, "{a} {b}");
    }
}
