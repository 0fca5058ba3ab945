//! Initial poses from a person.

use crate::client::Client;
use crate::{Served, with_bridge};
use bridge::ros::{Message, PoseWithCovarianceStamped};
use bridge::{BridgeConfig, FleetMessage};
use msg::{MapTransform, MapTransforms, Pose2, SlamRequest, SlamRequestKind, Stamp};
use std::cell::RefCell;
use std::rc::Rc;

type Requests = Rc<RefCell<Vec<(usize, SlamRequest)>>>;

fn listen(served: &Served) -> Requests {
    let requests = Requests::default();
    let sink = requests.clone();
    served.bridge.on_slam_request(move |robot, request| sink.borrow_mut().push((robot.number(), request)));
    requests
}

/// At (1, 2), a quarter turn to the left, as RViz writes it.
fn message(frame_id: &str) -> PoseWithCovarianceStamped {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let mut covariance = [0.0; 36];
    (covariance[0], covariance[7], covariance[35]) = (0.25, 0.16, 0.04);
    let (position, orientation) = ([1.0, 2.0, 0.0], [0.0, 0.0, half, half]);
    PoseWithCovarianceStamped {
        stamp: Stamp(0),
        frame_id: frame_id.into(),
        position,
        orientation,
        covariance,
    }
}

async fn person(served: &Served) -> Client {
    let mut person = Client::connect(served.address).await;
    for topic in ["/initialpose", "/robot1/initialpose", "/robot2/initialpose"] {
        person.publish(topic, PoseWithCovarianceStamped::TYPE).await;
    }
    person.settle().await;
    person
}

fn is_near(pose: Pose2, [x_m, y_m, yaw_rad]: [f64; 3]) -> bool {
    let away = Pose2::new(x_m, y_m, yaw_rad).inverse() * pose;
    away.x_m.hypot(away.y_m) < 1e-9 && away.yaw_rad.abs() < 1e-9
}

#[test]
fn the_frame_or_the_topic_names_the_robot() {
    with_bridge(Default::default(), async |served| {
        let requests = listen(served);
        let mut person = person(served).await;
        person.send("/initialpose", &message("map_2")).await;
        person.send("/robot1/initialpose", &message("robot1/map")).await;
        person.settle().await;
        let requests = requests.borrow();
        assert_eq!(requests.iter().map(|(robot, _)| *robot).collect::<Vec<_>>(), [2, 1]);
        for (_, request) in requests.iter() {
            assert_eq!(request.kind, SlamRequestKind::SetPose as u32);
            assert!(is_near(request.pose, [1.0, 2.0, std::f64::consts::FRAC_PI_2]), "{:?}", request.pose);
            assert!((request.sigma_m - 0.5).abs() < 1e-12 && (request.sigma_rad - 0.2).abs() < 1e-12);
        }
    });
}

#[test]
fn a_pose_in_the_merged_map_is_the_selected_robots_if_its_map_transform_is_known() {
    with_bridge(Default::default(), async |served| {
        let requests = listen(served);
        let mut person = person(served).await;
        person.send("/initialpose", &message("map")).await;
        assert!(person.error().await.contains("not known yet"));
        let mut map_transforms = MapTransforms::default();
        map_transforms.robots[0] =
            MapTransform { map_from_robot_map: Pose2::new(1.0, 0.0, 0.0), known: 1, ..Default::default() };
        served.bridge.publish(FleetMessage::MapTransforms(&map_transforms));
        person.send("/initialpose", &message("/map")).await;
        person.settle().await;
        let requests = requests.borrow();
        assert!(
            requests.len() == 1
                && requests[0].0 == 1
                && is_near(requests[0].1.pose, [0.0, 2.0, std::f64::consts::FRAC_PI_2])
        );
    });
}

#[test]
fn an_invalid_pose_gets_an_error_and_makes_no_request() {
    with_bridge(Default::default(), async |served| {
        let requests = listen(served);
        for (topic, change, why) in [
            (
                "/robot1/initialpose",
                (|m| m.frame_id = "map_2".into()) as fn(&mut PoseWithCovarianceStamped),
                "robot1's",
            ),
            ("/initialpose", |m| m.frame_id = "odom_1".into(), "expected 'map'"),
            ("/initialpose", |m| m.frame_id = "map_3".into(), "expected 'map'"),
            ("/initialpose", |m| m.position[0] = f64::NAN, "NaN"),
            ("/initialpose", |m| m.orientation = [0.0; 4], "quaternion"),
            ("/initialpose", |m| m.covariance[35] = -1.0, "variance"),
        ] {
            // A new client each time, because the same refusal is reported once a second.
            let mut person = person(served).await;
            let mut invalid = message("map_1");
            change(&mut invalid);
            person.send(topic, &invalid).await;
            let error = person.error().await;
            assert!(error.contains(why), "{error}");
        }
        assert_eq!(requests.borrow().len(), 0);
    });
}

#[test]
fn a_client_without_permission_sets_no_pose() {
    with_bridge(BridgeConfig { trust_loopback: false, ..Default::default() }, async |served| {
        let requests = listen(served);
        let mut client = person(served).await;
        client.send("/initialpose", &message("map_1")).await;
        assert!(client.error().await.contains("may not drive"));
        assert_eq!(requests.borrow().len(), 0);
    });
}
