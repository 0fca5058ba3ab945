//! Time of large maps.

use crate::client::Client;
use crate::measure::{nanoseconds, print_us};
use crate::server::{Job, Server};
use bridge::FleetMessage;
use bridge::command::name;
use msg::{GridHeader, GridView};
use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::mpsc;
use std::thread;
use std::time::Instant;

/// Measures how long a map of 16 MB takes, of noise and like a building's.
pub fn large_map() {
    const SIDE: u32 = 4000;
    let noise =
        (0..SIDE * SIDE).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8 as i8).collect::<Vec<_>>();
    let rooms = (0..SIDE * SIDE).map(|i| if (i / 700) % 3 == 0 { -80 } else { msg::grid::UNKNOWN }).collect();
    for (what, cells) in [("16 MB map, noise", noise), ("16 MB map, like a building", rooms)] {
        let server = Server::start();
        let subscribed = [(name::SUBSCRIBE, "/merged_map", "nav_msgs/OccupancyGrid")];
        let mut client = Client::connect(server.address, &subscribed);
        let cells: std::sync::Arc<Vec<i8>> = cells.into();
        let (mut whole, mut encode) = (Vec::new(), Vec::new());
        for _ in 0..12 {
            let cells = cells.clone();
            let begin = Instant::now();
            let (send, encoded) = mpsc::channel();
            let job: Job = Box::new(move |bridge| {
                let shape =
                    GridHeader { width: SIDE, height: SIDE, resolution_m: 0.05, ..GridHeader::default() };
                let before = Instant::now();
                bridge.publish(FleetMessage::MergedMap(GridView::new(&shape, &cells).unwrap()));
                send.send(nanoseconds(before)).unwrap();
            });
            server.jobs.send(job).unwrap();
            client.next(|_, payload| assert!(payload.len() > 16_000_000)).unwrap();
            whole.push(nanoseconds(begin));
            encode.push(encoded.recv().unwrap());
        }
        print_us(what, whole[2..].to_vec());
        print_us("  of which in publish(): others wait so long", encode[2..].to_vec());
    }
    bare_bulk(16_000_000);
}

/// Measures the same bytes over a plain socket.
fn bare_bulk(size: usize) {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let address = listener.local_addr().unwrap();
    let writer = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let (data, mut go) = (vec![1; size], [0]);
        while stream.read_exact(&mut go).is_ok() {
            stream.write_all(&data).unwrap();
        }
    });
    let mut stream = TcpStream::connect(address).unwrap();
    let mut data = vec![0; size];
    let mut times = Vec::new();
    for _ in 0..12 {
        let begin = Instant::now();
        stream.write_all(&[1]).unwrap();
        stream.read_exact(&mut data).unwrap();
        times.push(nanoseconds(begin));
    }
    drop(stream);
    writer.join().unwrap();
    print_us("  bare: 16 MB over a plain socket", times[2..].to_vec());
}
