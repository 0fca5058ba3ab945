//! What the ros_tcp door costs, over loopback: latency and jitter of the fleet's mix, rates, maps, commands written
//! as Unity's connector writes them, and a storm of reconnects.
//! `cargo bench -p bridge`, or some of it: `-- mix commands rates maps storm`.
//!
//! Server and clients are threads of this process, so their wake-ups are in the figures. "bare" is the same bytes
//! over a plain socket between the same two threads: what belongs to the machine.

use bridge::command::{Registration, name};
use bridge::frame::{Parser, Side};
use bridge::ros::{Message, Twist, encode};
use bridge::{Bridge, BridgeConfig, FleetMessage, process_clock, serve};
use msg::{
    Clock, Correction, GridHeader, GridView, Header, Link, LinkTransform, RobotId, Scan, Stamp, Transforms,
};
use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::rc::Rc;
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};
use tokio::task::LocalSet;

const ROBOTS: usize = 3;
type Job = Box<dyn FnOnce(&Bridge) + Send>;

/// A bridge on a thread of its own that does what it is told.
struct Server {
    address: SocketAddr,
    jobs: UnboundedSender<Job>,
    commands: mpsc::Receiver<Instant>,
}

impl Server {
    fn start() -> Self {
        let (told, commands) = mpsc::channel();
        let (jobs, mut todo) = unbounded_channel::<Job>();
        let (tell_address, address) = mpsc::channel();
        thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            LocalSet::new().block_on(&runtime, async move {
                let on_command = move |_, _| {
                    let _ = told.send(Instant::now());
                };
                let bridge = Rc::new(Bridge::new(BridgeConfig::default(), ROBOTS, on_command).unwrap());
                let listener = tokio::net::TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
                tell_address.send(listener.local_addr().unwrap()).unwrap();
                tokio::task::spawn_local(serve(
                    bridge.clone(),
                    listener,
                    process_clock,
                    std::future::pending(),
                ));
                while let Some(job) = todo.recv().await {
                    job(&bridge);
                }
            });
        });
        Self { address: address.recv().unwrap(), jobs, commands }
    }

    fn ask<T: Send + 'static>(&self, question: impl FnOnce(&Bridge) -> T + Send + 'static) -> T {
        let (tell, answer) = mpsc::channel();
        let job: Job = Box::new(move |bridge| drop(tell.send(question(bridge))));
        self.jobs.send(job).unwrap();
        answer.recv().unwrap()
    }
}

struct Client {
    stream: TcpStream,
    parser: Parser,
}

impl Client {
    fn connect(address: SocketAddr, registrations: &[(&str, &str, &str)]) -> Self {
        let stream = TcpStream::connect(address).unwrap();
        let mut out = Vec::new();
        for (command, topic, class) in registrations {
            let (topic, message_name) = ((*topic).to_owned(), (*class).to_owned());
            let about = Registration { topic, message_name, queue_size: 4096, latch: false };
            Side::Client.write_command(&mut out, command, &about);
        }
        Side::Client.write_command(&mut out, name::TOPIC_LIST, &serde_json::json!({}));
        (&stream).write_all(&out).unwrap();
        let mut client = Self { stream, parser: Parser::new(64 << 20).keep(64 << 20) };
        while client.next(|name, _| name == name::TOPIC_LIST.as_bytes()) != Some(true) {}
        client
    }

    /// The next frame, or `None` after the socket's read timeout.
    fn next<T>(&mut self, see: impl FnOnce(&[u8], &[u8]) -> T) -> Option<T> {
        loop {
            if let Some(frame) = self.parser.next_frame().unwrap() {
                return Some(see(frame.name, frame.payload));
            }
            match self.stream.read(self.parser.space()) {
                Ok(0) | Err(_) => return None,
                Ok(count) => self.parser.filled(count),
            }
        }
    }
}

fn nanoseconds(begin: Instant) -> i64 {
    begin.elapsed().as_nanos() as i64
}

fn header(begin: Instant) -> Header {
    Header { stamp: Stamp(nanoseconds(begin)), ..Header::default() }
}

fn print_us(what: &str, mut values_ns: Vec<i64>) {
    if values_ns.is_empty() {
        return println!("{what:<52} nothing arrived");
    }
    values_ns.sort_unstable();
    let at = |share: f64| values_ns[((values_ns.len() - 1) as f64 * share) as usize] as f64 / 1e3;
    let [p50, p95, p99, max] = [0.5, 0.95, 0.99, 1.0].map(at);
    println!(
        "{what:<52} p50 {p50:8.1}  p95 {p95:8.1}  p99 {p99:8.1}  max {max:8.1} us  n {}",
        values_ns.len()
    );
}

/// Time on a processor, nanoseconds, of the calling thread.
fn thread_cpu_ns() -> u64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|field| field.parse().ok()).unwrap_or(0)
}

fn resident_kb() -> u64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    text.split(' ').nth(1).and_then(|field| field.parse::<u64>().ok()).unwrap_or(0) * 4
}

/// The stamp of a message that begins with one, or of a sequence whose first element does.
fn stamp_at(payload: &[u8], offset: usize) -> i64 {
    let word = |at: usize| u32::from_le_bytes(payload[at..at + 4].try_into().unwrap());
    i64::from(word(offset)) * 1_000_000_000 + i64::from(word(offset + 4))
}

fn links(header: Header) -> Transforms {
    let mut message = Transforms { header, len: 6, ..Transforms::default() };
    for (link, child) in message.links.iter_mut().zip(&Link::ALL[1..]) {
        *link = LinkTransform { parent: Link::Odom as u32, child: *child as u32, ..LinkTransform::default() };
    }
    message
}

/// The fleet's own mix: 3 robots' links at 20 Hz and scans at 10 Hz, clock at 100 Hz.
fn mix(seconds: u64) {
    let server = Server::start();
    let subscribed = [
        (name::SUBSCRIBE, "/tf", "tf2_msgs/TFMessage"),
        (name::SUBSCRIBE, "/clock", "rosgraph_msgs/Clock"),
        (name::SUBSCRIBE, "/robot1/scan", "sensor_msgs/LaserScan"),
        (name::SUBSCRIBE, "/robot2/scan", "sensor_msgs/LaserScan"),
        (name::SUBSCRIBE, "/robot3/scan", "sensor_msgs/LaserScan"),
    ];
    let mut client = Client::connect(server.address, &subscribed);
    client.stream.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let begin = Instant::now();
    let reader = thread::spawn(move || {
        let (mut transforms, mut clocks, mut scans) = (Vec::new(), Vec::new(), Vec::new());
        while client
            .next(|name, payload| {
                let age = |offset| nanoseconds(begin) - stamp_at(payload, offset);
                match name {
                    b"/tf" => transforms.push(age(8)),
                    b"/clock" => clocks.push(age(4)),
                    _ => scans.push(age(4)),
                }
            })
            .is_some()
        {}
        (transforms, clocks, scans)
    });
    let scan = Box::new(Scan { len: 180, ..bytemuck::Zeroable::zeroed() });
    let cpu = server.ask(|_| thread_cpu_ns());
    for tick in 0..seconds * 100 {
        let due = begin + Duration::from_millis(10 * tick);
        thread::sleep(due.saturating_duration_since(Instant::now()));
        let mut scan = scan.clone();
        server
            .jobs
            .send(Box::new(move |bridge| {
                bridge.publish(FleetMessage::Clock(&Clock { header: header(begin) }))
            }))
            .unwrap();
        for robot in RobotId::first(ROBOTS) {
            if tick % 5 == robot.index() as u64 {
                let job: Job = Box::new(move |bridge| {
                    bridge.publish(FleetMessage::Transforms(robot, &links(header(begin))))
                });
                server.jobs.send(job).unwrap();
            }
            if tick % 10 == 5 + robot.index() as u64 {
                scan.header = header(begin);
                let scan = scan.clone();
                server
                    .jobs
                    .send(Box::new(move |bridge| bridge.publish(FleetMessage::Scan(robot, &scan))))
                    .unwrap();
            }
        }
    }
    let cpu = server.ask(|_| thread_cpu_ns()) - cpu;
    let (transforms, clocks, scans) = reader.join().unwrap();
    let lost = seconds * 60 - transforms.len() as u64 + seconds * 100 - clocks.len() as u64;
    let mean = transforms.iter().sum::<i64>() / transforms.len().max(1) as i64;
    print_us("TF, encode to client", transforms.clone());
    print_us("TF jitter, |latency - mean|", transforms.iter().map(|ns| (ns - mean).abs()).collect());
    print_us("clock, encode to client", clocks);
    print_us("scan, made to client", scans);
    let share = cpu as f64 / (seconds * 10_000_000) as f64;
    println!(
        "{:<52} {share:.2} % of a core, {lost} of {} lost",
        "bridge's thread in this mix",
        seconds * 190
    );
}

/// One small transform after another, each written on its own.
fn rate_out(per_second: u64) {
    let server = Server::start();
    let mut client = Client::connect(server.address, &[(name::SUBSCRIBE, "/tf", "tf2_msgs/TFMessage")]);
    client.stream.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let reader = thread::spawn(move || {
        let (mut count, begin, mut last) = (0_u64, Instant::now(), Instant::now());
        while client.next(|_, payload| payload.len()).is_some() {
            count += 1;
            last = Instant::now();
        }
        (count, last - begin)
    });
    let cpu = server.ask(|_| thread_cpu_ns());
    let begin = Instant::now();
    for tick in 0..400 {
        thread::sleep((begin + Duration::from_millis(5 * tick)).saturating_duration_since(Instant::now()));
        let job: Job = Box::new(move |bridge| {
            let robot = RobotId::new(1).unwrap();
            (0..per_second / 200)
                .for_each(|_| bridge.publish(FleetMessage::Correction(robot, &Correction::default())));
        });
        server.jobs.send(job).unwrap();
    }
    let cpu = server.ask(|_| thread_cpu_ns()) - cpu;
    let (count, time) = reader.join().unwrap();
    let sent = per_second / 200 * 400;
    println!(
        "{:<52} {:.0}/s arrived, {} of {sent} lost, {:.1} us of processor each",
        format!("transforms out, {per_second}/s offered, one write each"),
        count as f64 / time.as_secs_f64(),
        sent - count,
        cpu as f64 / 1e3 / sent as f64
    );
}

/// Twists from one client through the bridge to another, as fast as the bridge takes them.
fn relay(count: usize) {
    let server = Server::start();
    let mut subscriber = Client::connect(server.address, &[(name::SUBSCRIBE, "/relay", Twist::TYPE)]);
    let publisher = Client::connect(server.address, &[(name::PUBLISH, "/relay", Twist::TYPE)]);
    subscriber.stream.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let begin = Instant::now();
    let reader = thread::spawn(move || {
        let (mut got, mut last) = (0, Instant::now());
        while subscriber.next(|_, payload| payload.len()).is_some() {
            got += 1;
            last = Instant::now();
        }
        (got, last)
    });
    let mut frames = Vec::new();
    (0..100)
        .for_each(|_| Side::Client.write_with(&mut frames, "/relay", |out| encode(&Twist::default(), out)));
    (0..count / 100).for_each(|_| (&publisher.stream).write_all(&frames).unwrap());
    let (got, last) = reader.join().unwrap();
    let rate = f64::from(got) / (last - begin).as_secs_f64();
    println!(
        "{:<52} {rate:.0}/s, {} of {count} lost",
        "52-byte twists, client to client",
        count as i32 - got
    );
}

fn large_map() {
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
            let (tell, encoded) = mpsc::channel();
            let job: Job = Box::new(move |bridge| {
                let shape =
                    GridHeader { width: SIDE, height: SIDE, resolution_m: 0.05, ..GridHeader::default() };
                let before = Instant::now();
                bridge.publish(FleetMessage::MergedMap(GridView::new(&shape, &cells).unwrap()));
                tell.send(nanoseconds(before)).unwrap();
            });
            server.jobs.send(job).unwrap();
            client.next(|_, payload| assert!(payload.len() > 16_000_000)).unwrap();
            whole.push(nanoseconds(begin));
            encode.push(encoded.recv().unwrap());
        }
        print_us(what, whole[2..].to_vec());
        print_us("  of which in merged_map(): others wait so long", encode[2..].to_vec());
    }
    bare_bulk(16_000_000);
}

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

/// First write of a twist to the robot's command, as the connector writes: a write a field, Nagle's algorithm on.
fn command_in(field_by_field: bool) {
    let server = Server::start();
    let client = Client::connect(server.address, &[(name::PUBLISH, "/cmd_vel", Twist::TYPE)]);
    client.stream.set_nodelay(!field_by_field).unwrap();
    let mut frame = Vec::new();
    let moving = Twist { linear: [0.1, 0.0, 0.0], angular: [0.0; 3] };
    Side::Client.write_with(&mut frame, "/cmd_vel", |out| encode(&moving, out));
    let mut cuts = vec![0, 4, 12, 13, 17, 21];
    cuts.extend((21..frame.len()).step_by(8).skip(1));
    cuts.push(frame.len());
    if !field_by_field {
        cuts = vec![0, frame.len()];
    }
    let mut times = Vec::new();
    for _ in 0..500 {
        thread::sleep(Duration::from_millis(10));
        let begin = Instant::now();
        cuts.windows(2).for_each(|cut| (&client.stream).write_all(&frame[cut[0]..cut[1]]).unwrap());
        times.push(server.commands.recv().unwrap().duration_since(begin).as_nanos() as i64);
    }
    let how = if field_by_field { "field by field with Nagle" } else { "in one write" };
    print_us(&format!("twist in, {how}, to the robot's command"), times);
}

fn bare_wake_up() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let address = listener.local_addr().unwrap();
    let (tell, arrived) = mpsc::channel();
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut frame = [0; 68];
        while stream.read_exact(&mut frame).is_ok() {
            tell.send(Instant::now()).unwrap();
        }
    });
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_nodelay(true).unwrap();
    let mut times = Vec::new();
    for _ in 0..500 {
        thread::sleep(Duration::from_millis(10));
        let begin = Instant::now();
        stream.write_all(&[0; 68]).unwrap();
        times.push(arrived.recv().unwrap().duration_since(begin).as_nanos() as i64);
    }
    print_us("  bare: 68 bytes over a plain socket", times);
}

fn storm(connections: usize) {
    let server = Server::start();
    let registrations = [
        (name::SUBSCRIBE, "/tf", "tf2_msgs/TFMessage"),
        (name::SUBSCRIBE, "/robot1/scan", "sensor_msgs/LaserScan"),
        (name::SUBSCRIBE, "/clock", "rosgraph_msgs/Clock"),
        (name::SUBSCRIBE, "/of_mine", "std_msgs/String"),
        (name::PUBLISH, "/cmd_vel", Twist::TYPE),
    ];
    let go = |count: usize| {
        for _ in 0..count {
            let client = Client::connect(server.address, &registrations);
            server
                .jobs
                .send(Box::new(|bridge| bridge.publish(FleetMessage::Clock(&Clock::default()))))
                .unwrap();
            socket2::SockRef::from(&client.stream).set_linger(Some(Duration::ZERO)).unwrap();
        }
    };
    go(500);
    let (before, begin) = (resident_kb(), Instant::now());
    go(connections);
    let seconds = begin.elapsed().as_secs_f64();
    while server.ask(|bridge| bridge.counters().clients) > 0 {}
    let counters = server.ask(Bridge::counters);
    let what = format!("{connections} abrupt reconnects, 5 registrations each");
    println!("{what:<52} {seconds:.1} s, {before} -> {} kB resident, {counters:?}", resident_kb());
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let run = |name: &str| wanted.is_empty() || wanted.iter().any(|word| name.contains(word.as_str()));
    if run("mix") {
        mix(10);
    }
    if run("commands") {
        bare_wake_up();
        command_in(false);
        command_in(true);
    }
    if run("rates") {
        [10_000, 50_000, 100_000].into_iter().for_each(rate_out);
        relay(1_000_000);
    }
    if run("maps") {
        large_map();
    }
    if run("storm") {
        storm(10_000);
    }
}
