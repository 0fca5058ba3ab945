use super::*;
use bridge::command::HANDSHAKE;
use bridge::ros::{Int32, Twist};
use std::net::TcpListener;

/// One end of a connection as a server has it.
struct Server {
    stream: TcpStream,
    parser: Parser,
}

impl Server {
    fn accept(listener: &TcpListener) -> Self {
        let stream = listener.accept().unwrap().0;
        Self { stream, parser: Parser::new(1 << 20) }
    }

    fn greet(&mut self) {
        let mut frame = Vec::new();
        Side::Server.write(&mut frame, name::HANDSHAKE, HANDSHAKE);
        self.stream.write_all(&frame).unwrap();
    }

    /// The next frame, its NULs taken off; `None` once the client is gone.
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

/// Polls until `enough` says so of what came, as text.
fn poll_until(client: &mut Client, mut enough: impl FnMut(&[String]) -> bool) -> Vec<String> {
    let mut seen = Vec::new();
    while !enough(&seen) {
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
fn begins_as_the_connector_does() {
    let (listener, address) = listener();
    let mut client = Client::new(address);
    let voice = client.voice();
    voice.subscribe("/tf", "tf2_msgs/TFMessage");
    voice.advertise::<Twist>("/cmd_vel");
    voice.subscribe("/tf", "tf2_msgs/TFMessage");
    let server = std::thread::spawn(move || {
        let mut server = Server::accept(&listener);
        server.greet();
        let frames: Vec<_> = (0..5).map(|_| server.next().unwrap()).collect();
        (frames, server.next())
    });
    poll_until(&mut client, |seen| seen.iter().any(|event| event == "Connected"));
    assert!(voice.publish("/cmd_vel", &Twist { linear: [0.1, 0.0, 0.0], angular: [0.0; 3] }));
    drop((client, voice));
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
fn takes_frames_however_they_are_cut() {
    let (listener, address) = listener();
    let mut client = Client::new(address);
    let server = std::thread::spawn(move || {
        let mut server = Server::accept(&listener);
        server.greet();
        let mut bytes = Vec::new();
        for i in 0..20_u8 {
            Side::Server.write(&mut bytes, "/a", &vec![i; usize::from(i)]);
            Side::Server.write(&mut bytes, "", &[]);
        }
        Side::Server.write_command(&mut bytes, name::WARN, &Notice { text: "mind".into() });
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
    assert_eq!(seen[21], r#"Notice("__warn", "mind")"#);
    assert!(seen[22].starts_with("Topics("), "{}", seen[22]);
    drop(client);
    server.join().unwrap();
}

#[test]
fn comes_back_and_registers_again() {
    let (listener, address) = listener();
    let mut client = Client::new(address);
    let voice = client.voice();
    voice.subscribe("/tf", "tf2_msgs/TFMessage");
    let server = std::thread::spawn(move || {
        let mut first = Server::accept(&listener);
        first.greet();
        // All that was said is taken, or closing would reset the connection.
        (0..3).for_each(|_| drop(first.next().unwrap()));
        drop(first);
        let mut second = Server::accept(&listener);
        second.greet();
        let names = [second.next().unwrap().0, second.next().unwrap().0];
        while second.next().is_some() {}
        names
    });
    let seen = poll_until(&mut client, |seen| seen.iter().filter(|event| *event == "Connected").count() == 2);
    assert_eq!(seen.len(), 3, "{seen:?}");
    assert!(seen[1].contains("the server closed the connection"), "{seen:?}");
    assert_eq!(voice.connections(), 2);
    drop((client, voice));
    assert_eq!(server.join().unwrap(), ["", "__subscribe"]);
}

#[test]
fn says_what_is_wrong_with_a_server() {
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
    // Nobody there; and somebody who speaks something else altogether.
    let (listener, address) = listener();
    drop(listener);
    let seen = poll_until(&mut Client::new(address), |seen| !seen.is_empty());
    assert!(seen[0].starts_with("Lost("), "{seen:?}");
}

#[test]
fn keeps_a_quiet_link_alive() {
    let (listener, address) = listener();
    let mut client = Client::new(address);
    let server = std::thread::spawn(move || {
        let mut server = Server::accept(&listener);
        server.greet();
        (0..4).map(|_| server.next().unwrap().0).collect::<Vec<_>>()
    });
    while !server.is_finished() {
        client.poll(Instant::now() + Duration::from_millis(50), &mut |_| {});
    }
    assert_eq!(server.join().unwrap(), ["", "__topic_list", "", ""]);
}

#[test]
fn without_a_link_nothing_is_sent_and_registrations_are_bounded() {
    let voice = Voice::default();
    assert!(!voice.publish("/selected_robot", &Int32(1)));
    for i in 0..2 * REGISTRATIONS_MAX {
        voice.subscribe(&format!("/t{i}"), "a/B");
    }
    assert_eq!(voice.lock().registrations.len(), REGISTRATIONS_MAX);
}
