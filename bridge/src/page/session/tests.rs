use super::*;
use proptest::prelude::*;

/// A time of the bridge's clock.
const NOW: Monotonic = Monotonic(1_000_000_000_000);

fn topics() -> Vec<TopicName> {
    let topic = |name: &str, of: &str| (name.to_owned(), of.to_owned());
    vec![topic("/robot1/scan", "sensor_msgs/LaserScan"), topic("/chat", "own_msgs/Chat")]
}

#[test]
fn topics_of_known_types_are_offered_once() {
    let (mut session, mut encoder) = (Session::default(), Encoder::new(Vec::new()));
    session.update_channels(&topics(), &mut encoder).unwrap();
    assert_eq!(session.channels.keys().collect::<Vec<_>>(), [&1], "the schema of /chat is not known");
    assert!(encoder.has_waiting());
    let mut encoder = Encoder::new(Vec::new());
    session.update_channels(&topics(), &mut encoder).unwrap();
    assert!(!encoder.has_waiting(), "nothing has changed");
    session.update_channels(&[], &mut encoder).unwrap();
    assert!(encoder.has_waiting() && session.channels.is_empty());
}

#[test]
fn commands_become_registrations() {
    let (mut session, mut encoder) = (Session::default(), Encoder::new(Vec::new()));
    session.update_channels(&topics(), &mut encoder).unwrap();
    let mut send = |text: &str| session.receive_text(text, &mut encoder).unwrap();
    let subscribe = r#"{"op":"subscribe","subscriptions":[{"id":5,"channelId":1}]}"#;
    let expected = registration(name::SUBSCRIBE, "/robot1/scan", "sensor_msgs/LaserScan");
    assert_eq!(send(subscribe), [expected]);
    assert_eq!(send(subscribe), [], "it is subscribed");
    let unsubscribe = r#"{"op":"unsubscribe","subscriptionIds":[5,6]}"#;
    assert_eq!(send(unsubscribe), [registration(name::REMOVE_SUBSCRIBER, "/robot1/scan", "")]);
    let advertise = r#"{"op":"advertise","channels":[
        {"id":1,"topic":"/cmd_vel_1","encoding":"cdr","schemaName":"geometry_msgs/msg/Twist"},
        {"id":2,"topic":"/cmd_vel_2","encoding":"json","schemaName":"geometry_msgs/msg/Twist"}]}"#;
    assert_eq!(send(advertise), [registration(name::PUBLISH, "/cmd_vel_1", "geometry_msgs/Twist")]);
    let read = session.receive_binary(&[1, 1, 0, 0, 0, 9], NOW, &mut encoder).unwrap();
    assert_eq!(read, Some(ClientData::Message { topic: "/cmd_vel_1", payload: &[9] }));
    assert_eq!(session.receive_binary(&[1, 2, 0, 0, 0, 9], NOW, &mut encoder).unwrap(), None);
}

#[test]
fn a_call_registers_the_client_once_and_a_service_that_has_gone_is_no_more() {
    let (mut session, mut encoder) = (Session::default(), Encoder::new(Vec::new()));
    let service = |name: &str, of: &str| (name.to_owned(), of.to_owned());
    let services = [service("/plan", "nav_msgs/GetPlan"), service("/robot1/reset", "std_srvs/Trigger")];
    session.update_services(&services, &mut encoder).unwrap();
    let call = [&[2, 1, 0, 0, 0, 5, 0, 0, 0, 3, 0, 0, 0], &b"cdr"[..], &[0, 1, 0, 0, 0]].concat();
    let mut names = || -> Vec<&str> {
        match session.receive_binary(&call, NOW, &mut encoder).unwrap() {
            Some(ClientData::Call { commands, service: "/robot1/reset", payload: [0, 1, 0, 0, 0] }) => {
                commands.iter().map(|frame| frame.name).collect()
            }
            other => panic!("{other:?}"),
        }
    };
    assert_eq!([names(), names()], [vec![name::ROS_SERVICE, name::REQUEST], vec![name::REQUEST]]);
    session.update_services(&services[..1], &mut encoder).unwrap();
    assert_eq!(session.receive_binary(&call, NOW, &mut encoder).unwrap(), None);
}

#[test]
fn a_client_that_calls_many_services_stays_within_its_limit() {
    let (mut session, mut encoder) = (Session::default(), Encoder::new(Vec::new()));
    let services: Vec<TopicName> =
        (0..100).map(|i| (format!("/service{i:03}"), "std_srvs/Trigger".into())).collect();
    session.update_services(&services, &mut encoder).unwrap();
    let mut registered = 0_i32;
    for number in 1..=100 {
        let call = [&[2, number, 0, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0], &b"cdr"[..], &[0, 1, 0, 0, 0]].concat();
        let Some(ClientData::Call { commands, .. }) =
            session.receive_binary(&call, NOW, &mut encoder).unwrap()
        else {
            panic!("call {number} is refused")
        };
        let count = |wanted| commands.iter().filter(|frame| frame.name == wanted).count() as i32;
        registered += count(name::ROS_SERVICE) - count(name::REMOVE_ROS_SERVICE);
        assert!(registered <= 32, "{registered}");
    }
}

/// A message on the client's channel 1 that was sent so long ago, if it says so.
fn message(age: Option<Duration>) -> Vec<u8> {
    match age {
        None => vec![1, 1, 0, 0, 0, 9],
        Some(age) => {
            let sent = NOW.0 - age.as_nanos() as u64;
            [&[128, 1, 0, 0, 0][..], &sent.to_le_bytes(), &[9]].concat()
        }
    }
}

/// A session whose client publishes on channel 1.
fn publishing() -> Session {
    let mut session = Session::default();
    let advertise = r#"{"op":"advertise","channels":[
        {"id":1,"topic":"/robot1/goal_pose","encoding":"cdr","schemaName":"geometry_msgs/msg/PoseStamped"}]}"#;
    session.receive_text(advertise, &mut Encoder::new(Vec::new())).unwrap();
    session
}

#[test]
fn late_commands_are_told_of_once_a_second() {
    let (mut session, late) = (publishing(), message(Some(Duration::from_secs(30))));
    let mut is_reported = |after_ms: u64| {
        let mut encoder = Encoder::new(Vec::new());
        let now = NOW + Duration::from_millis(after_ms);
        assert_eq!(session.receive_binary(&late, now, &mut encoder).unwrap(), None);
        encoder.has_waiting()
    };
    assert_eq!([0, 1, 999, 1000, 1500].map(&mut is_reported), [true, false, false, true, false]);
}

proptest! {
    #[test]
    fn a_command_is_carried_out_unless_it_says_that_it_is_late(age_ms in proptest::option::of(0..60_000_u64)) {
        let bytes = message(age_ms.map(Duration::from_millis));
        let (mut session, mut encoder) = (publishing(), Encoder::new(Vec::new()));
        let read = session.receive_binary(&bytes, NOW, &mut encoder).unwrap();
        let is_late = age_ms.is_some_and(|age_ms| age_ms > 1000);
        let expected = ClientData::Message { topic: "/robot1/goal_pose", payload: &[9] };
        prop_assert_eq!(read, (!is_late).then_some(expected));
        prop_assert_eq!(encoder.has_waiting(), is_late, "what is refused is said");
    }

    #[test]
    fn any_text_is_a_command_or_refused(text in "\\PC{0,80}", depth in 0..2000_usize) {
        let (mut session, mut encoder) = (Session::default(), Encoder::new(Vec::new()));
        session.receive_text(&text, &mut encoder).unwrap();
        session.receive_text(&"[".repeat(depth), &mut encoder).unwrap();
    }
}
