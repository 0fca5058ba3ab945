use super::*;
use bridge::command::HANDSHAKE;
use bridge::ros::{Int32, Twist};
use std::net::TcpListener;

/// Server's end of a connection.
struct Server {
    stream: TcpStream,
    parser: Parser,
}

impl Server {
    fn accept(listener: &TcpListener) -> Self {
        let stream = listener.accept().unwrap().0;
        Self { stream, parser: Parser::new(1 << 20) }
    }

    fn send_handshake(&mut self) {
        let mut frame = Vec::new();
        Side::Server.write(&mut frame, name::HANDSHAKE, HANDSHAKE);
        self.stream.write_all(&frame).unwrap();
    }

    /// Next frame without its trailing NULs; `None` once the client has disconnected.
    fn next(&mut self) -> Option<(String, Vec<u8>)> {
        loop {
            if let Some(frame) = self.parser.next_frame().unwrap() {
                let json = frame.name.starts_with(b"__");
                let payload = if json { frame.json() } else { frame.payload };
                return Some((String::from_utf8(frame.name.to_vec()).unwrap(), payload.to_vec()));
            }
            let count = self.stream.read(self.parser.space()).unwrap_or(0);
            if count == 0 {
                return None;
            }
            self.parser.filled(count);
        }
    }
}

fn listener() -> (TcpListener, String) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    (listener, address)
}

/// Polls until `is_enough` holds for the events so far, as text.
fn poll_until(client: &mut Client, mut is_enough: impl FnMut(&[String]) -> bool) -> Vec<String> {
    let mut seen = Vec::new();
    while !is_enough(&seen) {
        client.poll(Instant::now() + Duration::from_millis(20), &mut |event| {
            seen.push(match event {
                Event::Message { topic, payload, .. } => format!("{topic} {payload:?}"),
                other => format!("{other:?}"),
            });
        });
    }
    seen
}

#[test]
fn the_first_frames_are_those_of_the_connector() {
    let (listener, address) = listener();
    let mut client = Client::new(address);
    let handle = client.handle();
    handle.subscribe("/tf", "tf2_msgs/TFMessage");
    handle.advertise::<Twist>("/cmd_vel");
    handle.subscribe("/tf", "tf2_msgs/TFMessage");
    let server = std::thread::spawn(move || {
        let mut server = Server::accept(&listener);
        server.send_handshake();
        let frames: Vec<_> = (0..5).map(|_| server.next().unwrap()).collect();
        (frames, server.next())
    });
    poll_until(&mut client, |seen| seen.iter().any(|event| event == "Connected"));
    assert!(handle.publish("/cmd_vel", &Twist { linear: [0.1, 0.0, 0.0], angular: [0.0; 3] }));
    drop((client, handle));
    let (frames, rest) = server.join().unwrap();
    let names: Vec<&str> = frames.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["", "__subscribe", "__publish", "__topic_list", "/cmd_vel"]);
    let json = |i: usize| serde_json::from_slice::<serde_json::Value>(&frames[i].1).unwrap();
    assert_eq!(json(1), serde_json::json!({"topic": "/tf", "message_name": "tf2_msgs/TFMessage"}));
    assert_eq!(
        json(2),
        serde_json::json!(
            {"topic": "/cmd_vel", "message_name": "geometry_msgs/Twist", "queue_size": 10, "latch": false}
        )
    );
    assert_eq!(frames[4].1.len(), 52, "a Twist as the connector writes it");
    assert_eq!(ros::decode::<Twist>(&frames[4].1).unwrap().linear[0], 0.1);
    assert_eq!(rest, None);
}

#[test]
fn frames_are_read_however_the_stream_is_cut() {
    let (listener, address) = listener();
    let mut client = Client::new(address);
    let server = std::thread::spawn(move || {
        let mut server = Server::accept(&listener);
        server.send_handshake();
        let mut bytes = Vec::new();
        for i in 0..20_u8 {
            Side::Server.write(&mut bytes, "/a", &vec![i; usize::from(i)]);
            Side::Server.write(&mut bytes, "", &[]);
        }
        Side::Server.write_command(&mut bytes, name::WARN, &Notice { text: "careful".into() });
        let topics = TopicList { topics: vec!["/a".into()], types: vec!["b/C".into()] };
        Side::Server.write_command(&mut bytes, name::TOPIC_LIST, &topics);
        for (i, piece) in bytes.chunks(7).enumerate() {
            server.stream.write_all(piece).unwrap();
            if i % 3 == 0 {
                std::thread::yield_now();
            }
        }
        while server.next().is_some() {}
    });
    let seen = poll_until(&mut client, |seen| seen.len() == 23);
    assert_eq!(seen[0], "Connected");
    for i in 0..20_u8 {
        assert_eq!(seen[1 + usize::from(i)], format!("/a {:?}", vec![i; usize::from(i)]));
    }
    assert_eq!(seen[21], r#"ServerText("__warn", "careful")"#);
    assert!(seen[22].starts_with("Topics("), "{}", seen[22]);
    drop(client);
    server.join().unwrap();
}

#[test]
fn the_client_reconnects_and_registers_again() {
    let (listener, address) = listener();
    let mut client = Client::new(address);
    let handle = client.handle();
    handle.subscribe("/tf", "tf2_msgs/TFMessage");
    let server = std::thread::spawn(move || {
        let mut first = Server::accept(&listener);
        first.send_handshake();
        // Unread data would make closing reset the connection.
        (0..3).for_each(|_| drop(first.next().unwrap()));
        drop(first);
        let mut second = Server::accept(&listener);
        second.send_handshake();
        let names = [second.next().unwrap().0, second.next().unwrap().0];
        while second.next().is_some() {}
        names
    });
    let seen = poll_until(&mut client, |seen| seen.iter().filter(|event| *event == "Connected").count() == 2);
    assert_eq!(seen.len(), 3, "{seen:?}");
    assert!(seen[1].contains("the server closed the connection"), "{seen:?}");
    assert_eq!(handle.connections(), 2);
    drop((client, handle));
    assert_eq!(server.join().unwrap(), ["", "__subscribe"]);
}

#[test]
fn errors_name_what_is_wrong_with_a_server() {
    let wrong: [(&str, &[u8], &str); 3] = [
        ("/tf", b"", "no ros_tcp endpoint"),
        ("__handshake", br#"{"version": "v0.6.0", "metadata": "{}"}"#, "version 'v0.6.0'"),
        ("__handshake", br#"{"version": "v0.7.0", "metadata": "{\"protocol\": \"ROS1\"}"}"#, "ROS1"),
    ];
    for (first, payload, expected) in wrong {
        let (listener, address) = listener();
        let mut client = Client::new(address.clone());
        let server = std::thread::spawn(move || {
            let mut server = Server::accept(&listener);
            let mut frame = Vec::new();
            Side::Server.write(&mut frame, first, payload);
            server.stream.write_all(&frame).unwrap();
            while server.next().is_some() {}
        });
        let seen = poll_until(&mut client, |seen| !seen.is_empty());
        assert!(seen[0].contains(expected) && seen[0].contains(&address), "{seen:?}");
        drop(client);
        server.join().unwrap();
    }
    // Nothing listens at this address.
    let (listener, address) = listener();
    drop(listener);
    let seen = poll_until(&mut Client::new(address), |seen| !seen.is_empty());
    assert!(seen[0].starts_with("Disconnected("), "{seen:?}");
}

#[test]
fn keepalives_are_sent_on_a_quiet_connection() {
    let (listener, address) = listener();
    let mut client = Client::new(address);
    let server = std::thread::spawn(move || {
        let mut server = Server::accept(&listener);
        server.send_handshake();
        (0..4).map(|_| server.next().unwrap().0).collect::<Vec<_>>()
    });
    while !server.is_finished() {
        client.poll(Instant::now() + Duration::from_millis(50), &mut |_| {});
    }
    assert_eq!(server.join().unwrap(), ["", "__topic_list", "", ""]);
}

#[test]
fn without_a_connection_nothing_is_sent_and_registrations_are_bounded() {
    let handle = ClientHandle::default();
    assert!(!handle.publish("/selected_robot", &Int32(1)));
    for i in 0..2 * REGISTRATIONS_MAX {
        handle.subscribe(&format!("/t{i}"), "a/B");
    }
    assert_eq!(handle.lock().registrations.len(), REGISTRATIONS_MAX);
}
