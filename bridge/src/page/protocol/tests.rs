use super::*;
use proptest::prelude::*;

#[test]
fn commands_are_read_as_the_protocol_writes_them() {
    let read = |json: &str| serde_json::from_str::<ClientCommand>(json).unwrap();
    let subscriptions = vec![Subscription { id: 3, channel_id: 7 }];
    assert_eq!(
        read(r#"{"op":"subscribe","subscriptions":[{"id":3,"channelId":7}]}"#),
        ClientCommand::Subscribe { subscriptions }
    );
    let subscription_ids = vec![3];
    assert_eq!(
        read(r#"{"op":"unsubscribe","subscriptionIds":[3]}"#),
        ClientCommand::Unsubscribe { subscription_ids }
    );
    assert_eq!(
        read(r#"{"op":"getParameters","parameterNames":["a"],"id":"1"}"#),
        ClientCommand::GetParameters { parameter_names: vec!["a".into()], id: Some("1".into()) }
    );
    assert_eq!(read(r#"{"op":"fetchAsset","uri":"a","requestId":1}"#), ClientCommand::Other);
    let advertise = read(
        r#"{"op":"advertise","channels":[{"id":1,"topic":"/cmd_vel_1","encoding":"cdr",
            "schemaName":"geometry_msgs/msg/Twist","schema":"","schemaEncoding":"ros2msg"}]}"#,
    );
    let ClientCommand::Advertise { channels } = advertise else { panic!("{advertise:?}") };
    assert_eq!(message_type(&channels[0].schema_name), "geometry_msgs/Twist");
    assert_eq!(schema_name("geometry_msgs/Twist"), "geometry_msgs/msg/Twist");
}

#[test]
fn a_status_has_the_protocols_numbers() {
    let status = ServerCommand::Status { level: StatusLevel::Error, message: "no" };
    let json = serde_json::to_string(&status).unwrap();
    assert_eq!(json, r#"{"op":"status","level":2,"message":"no"}"#);
}

#[test]
fn a_call_is_read_as_the_protocol_writes_it() {
    let bytes = [&[2, 7, 0, 0, 0, 9, 0, 0, 0, 3, 0, 0, 0], &b"cdr"[..], &[0, 1, 0, 0, 1]].concat();
    let id = CallId { service: 7, call: 9 };
    let call = ClientMessage::Call { id, encoding: b"cdr", payload: &[0, 1, 0, 0, 1] };
    assert_eq!(ClientMessage::parse(&bytes), Ok(call));
    assert_eq!(ClientMessage::parse(&bytes[..15]), Err(BinaryError::Short(15)));
    assert_eq!(service_type_name("std_srvs/Trigger", "_Request"), "std_srvs/srv/Trigger_Request");
}

proptest! {
    #[test]
    fn a_calls_number_has_both_of_its_numbers(service in any::<u32>(), call in any::<u32>()) {
        let id = CallId { service, call };
        prop_assert_eq!(CallId::of_number(id.number()), id);
    }

    #[test]
    fn random_bytes_are_a_message_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..32)) {
        match ClientMessage::parse(&bytes) {
            Ok(ClientMessage::Publish { payload, sent, .. }) => {
                let header_bytes = if sent.is_some() { 13 } else { 5 };
                prop_assert_eq!(payload.len() + header_bytes, bytes.len());
            }
            Ok(ClientMessage::Call { encoding, payload, .. }) => {
                prop_assert_eq!(encoding.len() + payload.len() + 13, bytes.len());
            }
            Err(_) => prop_assert!(bytes.len() < 13 || ![1, 128].contains(&bytes[0])),
        }
        let _ = serde_json::from_slice::<ClientCommand>(&bytes);
    }
}
