use super::*;
use bridge::ros::TransformStamped;
use std::time::Duration;

fn tf(child: &str, stamp_s: f64) -> Vec<u8> {
    let transform = TransformStamped {
        stamp: Stamp::from_seconds(stamp_s),
        frame_id: "odom_1".into(),
        child_frame_id: child.into(),
        translation: [0.0; 3],
        rotation: [0.0, 0.0, 0.0, 1.0],
    };
    let mut payload = Vec::new();
    ros::encode(&TfMessage { transforms: vec![transform] }, &mut payload);
    payload
}

#[test]
fn jitter_and_lost_messages_are_counted() {
    let mut statistics = LinkStatistics::default();
    let epoch = statistics.epoch;
    statistics.on_connected();
    for i in 0..1000 {
        let stamp_s = f64::from(i) * 0.05;
        // Every tenth comes 2 ms late; two are lost; the clocks differ by 7 s.
        let late_s = if i % 10 == 0 { 0.002 } else { 0.0 };
        let received = epoch + Duration::from_secs_f64(7.0 + stamp_s + late_s);
        if i != 500 && i != 501 {
            statistics.record("/tf", &tf("base_link_1", stamp_s), received).unwrap();
        }
    }
    let LinkReport { tf, slam_tf, topics, .. } = statistics.report();
    assert_eq!((tf.streams, tf.received, tf.lost, tf.disordered), (1, 998, 2, 0));
    assert!((tf.rate_hz - 19.96).abs() < 0.05, "{}", tf.rate_hz);
    assert!((tf.jitter_ms.median.unwrap() - 0.2).abs() < 0.01, "{:?}", tf.jitter_ms);
    let largest = [tf.jitter_ms.p95, tf.jitter_ms.max].map(Option::unwrap);
    assert!(largest.iter().all(|ms| (ms - 1.8).abs() < 0.01), "{:?}", tf.jitter_ms);
    assert_eq!((slam_tf.streams, slam_tf.jitter_ms.median), (0, None));
    assert!((topics[0].longest_pause_s - 0.15).abs() < 0.003, "{topics:?}");
}

#[test]
fn messages_between_two_connections_are_not_lost() {
    let mut statistics = LinkStatistics::default();
    let epoch = statistics.epoch;
    for connection in 0..2 {
        statistics.on_connected();
        for i in 0..100 {
            let stamp_s = f64::from(connection) * 60.0 + f64::from(i) * 0.1;
            statistics
                .record("/tf", &tf("odom_3", stamp_s), epoch + Duration::from_secs_f64(stamp_s))
                .unwrap();
        }
    }
    let report = statistics.report();
    assert_eq!((report.slam_tf.received, report.slam_tf.lost, report.connections), (200, 0, 2));
    assert!((report.slam_tf.rate_hz - 10.0).abs() < 0.01);
}

#[test]
fn memory_is_bounded_for_any_messages() {
    let mut statistics = LinkStatistics::default();
    let now = Instant::now();
    for i in 0..(2 * STREAMS_MAX) {
        statistics.record("/tf", &tf(&format!("frame{i}"), 0.0), now).unwrap();
        statistics.record(&format!("/topic{i}"), &[], now).unwrap();
    }
    for _ in 0..(2 * ARRIVALS_MAX) {
        statistics.record("/tf", &tf("frame0", 1.0), now).unwrap();
    }
    assert!(statistics.record("/robot1/scan", &[0, 1], now).is_err());
    let report = statistics.report();
    assert_eq!(report.topics.len(), TOPICS_MAX);
    assert!(report.other_messages > 0);
    assert_eq!((report.tf.streams, report.undecodable), (STREAMS_MAX, 1));
    assert_eq!(report.tf.jitter_ms.count, ARRIVALS_MAX + STREAMS_MAX - 1);
}
