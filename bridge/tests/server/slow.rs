//! A client that does not read: its queue is bounded and has the newest messages, and other clients are not delayed.

use crate::client::Client;
use crate::{header, robot, with_bridge};
use bridge::command::{Registration, name};
use bridge::ros::{Clock, Message, OccupancyGrid, Text};
use bridge::{BridgeConfig, FleetMessage, process_clock};
use msg::{GridHeader, GridView, Stamp};

const WIDTH: u32 = 1000;

fn map(served: &crate::Served, stamp: i64, cells: &[i8]) {
    let (width, height) = (WIDTH, cells.len() as u32 / WIDTH);
    let shape = GridHeader { header: header(stamp), width, height, resolution_m: 0.05, ..Default::default() };
    served.bridge.publish(FleetMessage::Map(robot(1), GridView::new(&shape, cells).unwrap()));
}

#[test]
fn a_stalled_client_gets_the_newest_map_and_delays_no_other() {
    with_bridge(Default::default(), async |served| {
        let mut slow = Client::connect(served.address).await;
        let mut quick = Client::connect(served.address).await;
        for client in [&mut slow, &mut quick] {
            client.subscribe("/robot1/map", OccupancyGrid::TYPE).await;
            client.settle().await;
        }
        let cells = vec![50; 2_000 * WIDTH as usize];
        for stamp in 1..=20 {
            map(served, stamp, &cells);
            let got: OccupancyGrid = quick.message("/robot1/map").await;
            assert_eq!(got.stamp, Stamp(stamp), "the quick one gets every map");
        }
        let statuses = served.bridge.clients(process_clock());
        assert!(statuses[0].dropped > 0 && statuses[1].dropped == 0);
        assert!(
            statuses[0].waiting_bytes <= 2 * (cells.len() + 1000),
            "one being written, the newest waiting"
        );
        let mut last = Stamp(0);
        while last < Stamp(20) {
            let got: OccupancyGrid = slow.message("/robot1/map").await;
            assert!(got.stamp > last);
            last = got.stamp;
        }
        assert_eq!(served.bridge.counters().dropped, statuses[0].dropped);
    });
}

#[test]
fn the_queue_of_a_stalled_client_is_bounded_and_in_order() {
    let outbox_bytes_max = 1 << 20;
    with_bridge(BridgeConfig { outbox_bytes_max, ..Default::default() }, async |served| {
        let mut slow = Client::connect(served.address).await;
        slow.subscribe("/clock", Clock::TYPE).await;
        slow.subscribe("/log", Text::TYPE).await;
        slow.settle().await;
        let mut talker = Client::connect(served.address).await;
        let message_name = Text::TYPE.to_owned();
        let about = Registration { topic: "/log".into(), message_name, queue_size: 100_000, latch: false };
        talker.command(name::PUBLISH, &about).await;
        let mut sent = 0;
        while served.bridge.counters().dropped < 100 {
            for _ in 0..10 {
                talker.send("/log", &Text(format!("{sent:09}{}", "x".repeat(30_000)))).await;
                sent += 1;
            }
            talker.settle().await;
            served.bridge.publish(FleetMessage::Clock(&msg::Clock { header: header(sent) }));
            let waiting = served.bridge.clients(process_clock())[0].waiting_bytes;
            assert!(waiting <= outbox_bytes_max + 40_000, "{waiting}");
        }
        let (mut previous, mut last_clock) = (-1, Stamp(0));
        while previous < sent - 1 {
            let (name, payload) = slow.next().await.unwrap();
            if name == "/clock" {
                let clock: Clock = bridge::ros::decode(&payload).unwrap();
                assert!(clock.clock > last_clock);
                last_clock = clock.clock;
            } else {
                let text: Text = bridge::ros::decode(&payload).unwrap();
                let number: i64 = text.0[..9].parse().unwrap();
                assert!(number > previous, "oldest lost, order kept");
                previous = number;
            }
        }
    });
}

#[test]
fn a_stalled_client_costs_at_most_8_mb_by_default() {
    with_bridge(Default::default(), async |served| {
        let mut slow = Client::connect(served.address).await;
        slow.subscribe("/robot1/map", OccupancyGrid::TYPE).await;
        slow.subscribe("/log", Text::TYPE).await;
        slow.settle().await;
        let mut talker = Client::connect(served.address).await;
        let message_name = Text::TYPE.to_owned();
        let about = Registration { topic: "/log".into(), message_name, queue_size: 100_000, latch: false };
        talker.command(name::PUBLISH, &about).await;
        talker.settle().await;
        let cells = vec![50; 500 * WIDTH as usize];
        let line = Text("x".repeat(30_000));
        let mut stamp = 0;
        while served.bridge.counters().dropped < 200 {
            for _ in 0..10 {
                talker.send("/log", &line).await;
            }
            // The slow client sends requests too, and reads nothing.
            let _ = slow.stream.try_write(b"\x0d\0\0\0__topic_list\0\x03\0\0\0{}\0");
            talker.settle().await;
            stamp += 1;
            map(served, stamp, &cells);
            let waiting = served.bridge.clients(process_clock())[0].waiting_bytes;
            assert!(waiting <= 8_000_000, "{waiting}");
        }
    });
}

#[test]
fn a_client_that_reads_no_replies_is_disconnected() {
    with_bridge(Default::default(), async |served| {
        let mut witness = Client::connect(served.address).await;
        let unread = Client::connect(served.address).await;
        let many = b"\x0d\0\0\0__topic_list\0\x03\0\0\0{}\0".repeat(1000);
        // It sends requests until the server disconnects it: then its writes fail.
        let mut rest = many.as_slice();
        while served.bridge.counters().clients > 1 {
            let taken = unread.stream.try_write(rest).unwrap_or(0);
            rest = if taken == rest.len() { &many } else { &rest[taken..] };
            witness.settle().await;
        }
        assert_eq!(served.bridge.counters().refused, 0, "its frames were valid");
        witness.settle().await;
    });
}
