//! Memory of the bridge's process under attack: it grows by at most 64 MB, and returns when the attackers have left.
//!
//! The attackers are in the same process, but hold no memory: they send the same 64 kB over and over.

use bridge::command::{Registration, name};
use bridge::frame::Side;
use bridge::{Bridge, BridgeConfig, FleetMessage, process_clock, serve};
use msg::{GridHeader, GridView, Monotonic, RobotId};
use std::net::{Ipv4Addr, SocketAddr};
use std::rc::Rc;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::LocalSet;
use tokio::time::{Instant, sleep, timeout};

const MB: usize = 1 << 20;
/// Capacity of the free buffer for the fleet's next map.
const MAP_BUFFER: usize = 17 * MB;
/// What all clients together may cost.
const HELD_MAX: usize = 64 * MB;
/// What may be left afterwards: the allocator's leftovers and the tables of clients.
const LEFT_MAX: usize = 6 * MB;
/// Beside the held bytes: input buffers at rest, the allocator's fragments.
const BESIDE_MAX: usize = 8 * MB;
/// The bridge's clock runs so many times as fast as time does: the test waits for what it releases after seconds.
const CLOCK_RATE: u64 = 4;
/// A client gives a frame up that the bridge does not take for so long.
const REFUSED_AFTER: Duration = Duration::from_secs(2).checked_div(CLOCK_RATE as u32).unwrap();
/// An attack that takes longer has hung.
const ATTACK_MAX: Duration = Duration::from_secs(60);

/// Payloads repeat these bytes, which begin as a ROS 2 message does.
static BYTES: [u8; 64 << 10] = {
    let mut bytes = [7; 64 << 10];
    (bytes[0], bytes[1], bytes[2], bytes[3]) = (0, 1, 0, 0);
    bytes
};

fn resident_bytes() -> usize {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap();
    statm.split(' ').nth(1).unwrap().parse::<usize>().unwrap() * 4096
}

fn quick_clock() -> Monotonic {
    Monotonic(process_clock().0 * CLOCK_RATE)
}

struct Attack {
    bridge: Rc<Bridge>,
    address: SocketAddr,
    peak: usize,
}

impl Attack {
    async fn connect(&self, commands: &[(&str, Registration)]) -> TcpStream {
        let mut stream = TcpStream::connect(self.address).await.unwrap();
        let mut out = Vec::new();
        commands
            .iter()
            .for_each(|(name, registration)| Side::Client.write_command(&mut out, name, registration));
        stream.write_all(&out).await.unwrap();
        stream
    }

    /// Sends the head of a frame and as much of its payload as the bridge takes, up to `sent` bytes.
    async fn send_part(&mut self, stream: &mut TcpStream, topic: &str, payload: usize, sent: usize) {
        let mut head = Vec::new();
        Side::Client.write(&mut head, topic, &[]);
        let at = head.len() - 4;
        head[at..].copy_from_slice(&u32::try_from(payload).unwrap().to_le_bytes());
        let mut left = sent;
        let _ = stream.write_all(&head).await;
        while left > 0 {
            let part = left.min(BYTES.len());
            match timeout(REFUSED_AFTER, stream.write_all(&BYTES[..part])).await {
                Ok(Ok(())) => left -= part,
                _ => return,
            }
            self.look();
        }
    }

    fn look(&mut self) {
        self.peak = self.peak.max(resident_bytes());
        assert!(self.bridge.held_bytes() <= HELD_MAX, "{} MB held", self.bridge.held_bytes() / MB);
    }
}

fn registration(topic: String, latch: bool) -> Registration {
    Registration { topic, message_name: "std_msgs/String".into(), queue_size: 4096, latch }
}

/// 15 clients send most of a frame of 31 MB each, the largest that is allowed, and stop.
async fn half_frames(attack: &mut Attack) -> Vec<TcpStream> {
    let mut streams = Vec::new();
    for index in 0..15 {
        let topic = format!("/half{index}");
        let mut stream = attack.connect(&[(name::PUBLISH, registration(topic.clone(), false))]).await;
        attack.send_part(&mut stream, &topic, 31 * MB, 30 * MB).await;
        streams.push(stream);
    }
    streams
}

/// 160 latched messages of 1 MB each.
async fn latched_messages(attack: &mut Attack) -> Vec<TcpStream> {
    let mut streams = Vec::new();
    for client in 0..16 {
        let mut stream = attack.connect(&[]).await;
        for index in 0..10 {
            let topic = format!("/latched{client}_{index}");
            let mut out = Vec::new();
            Side::Client.write_command(&mut out, name::PUBLISH, &registration(topic.clone(), true));
            stream.write_all(&out).await.unwrap();
            attack.send_part(&mut stream, &topic, MB, MB).await;
        }
        streams.push(stream);
    }
    streams
}

/// 30 clients do not read: one sends them large messages, the fleet a map of 16 MB that changes.
async fn full_queues(attack: &mut Attack) -> Vec<TcpStream> {
    let mut streams = Vec::new();
    for index in 0..30 {
        let subscriptions = [
            (name::SUBSCRIBE, registration(format!("/flood{}", index % 5), false)),
            (
                name::SUBSCRIBE,
                Registration {
                    message_name: "nav_msgs/OccupancyGrid".into(),
                    ..registration("/robot1/map".into(), false)
                },
            ),
        ];
        streams.push(attack.connect(&subscriptions).await);
    }
    for topic in (0..5).map(|index| format!("/flood{index}")) {
        let mut stream = attack.connect(&[(name::PUBLISH, registration(topic.clone(), false))]).await;
        for size in [100_000, 3 * MB, 700_000].into_iter().cycle().take(30) {
            attack.send_part(&mut stream, &topic, size, size).await;
        }
        streams.push(stream);
    }
    streams
}

/// 40 clients send a frame of 31 MB each, drop by drop.
async fn slow_frames(attack: &mut Attack) -> Vec<TcpStream> {
    let mut streams = Vec::new();
    for index in 0..40 {
        let topic = format!("/slow{index}");
        streams.push(attack.connect(&[(name::PUBLISH, registration(topic.clone(), false))]).await);
        attack.send_part(&mut streams[index], &topic, 31 * MB, 100_000).await;
    }
    for _ in 0..20 {
        for stream in &mut streams {
            let _ = stream.try_write(&BYTES[..1000]);
            attack.look();
        }
        sleep(Duration::from_millis(10)).await;
    }
    streams
}

/// Waits until no client is there, and nothing is held but the buffer of the fleet's next map.
async fn wait_for_rest(what: &str, attack: &Attack) {
    let begun = Instant::now();
    while attack.bridge.counters().clients > 0 || attack.bridge.held_bytes() != MAP_BUFFER {
        assert!(begun.elapsed() < ATTACK_MAX, "{what}: {} bytes are held", attack.bridge.held_bytes());
        sleep(Duration::from_millis(50)).await;
    }
}

/// Runs an attack, disconnects the attackers, and compares the memory.
async fn measure(what: &str, attack: &mut Attack, run: impl AsyncFnOnce(&mut Attack) -> Vec<TcpStream>) {
    wait_for_rest(what, attack).await;
    let before = resident_bytes();
    attack.peak = before;
    let streams = timeout(ATTACK_MAX, run(attack)).await.unwrap_or_else(|_| panic!("{what}: hung"));
    attack.look();
    let held = attack.bridge.held_bytes();
    drop(streams);
    wait_for_rest(what, attack).await;
    let (grown, left) = (attack.peak - before, resident_bytes().saturating_sub(before));
    println!("{what}: grown by {} MB, held {} MB, left {} MB", grown / MB, held / MB, left / MB);
    assert!(grown <= HELD_MAX + BESIDE_MAX, "{what}: grown by {} MB", grown / MB);
    assert!(left <= LEFT_MAX, "{what}: {} MB are left", left / MB);
}

/// The test has no harness: memory of other tests in the process would be counted too.
fn main() {
    if std::env::var_os("MALLOC_MMAP_THRESHOLD_").is_none() {
        // As the bridge's process is started.
        let program = std::env::current_exe().unwrap();
        let mut command = std::process::Command::new(program);
        command.envs(bridge::ALLOCATOR_SETTINGS);
        assert!(command.status().unwrap().success());
        return;
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    LocalSet::new().block_on(&runtime, async {
        let bridge = Rc::new(Bridge::new(BridgeConfig::default(), 2, |_, _| {}).unwrap());
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let address = listener.local_addr().unwrap();
        tokio::task::spawn_local(serve(bridge.clone(), listener, quick_clock, std::future::pending()));
        let publisher = bridge.clone();
        tokio::task::spawn_local(async move {
            let cells = vec![50; 16 * MB];
            loop {
                let shape =
                    GridHeader { width: 4096, height: 4096, resolution_m: 0.05, ..Default::default() };
                let grid = GridView::new(&shape, &cells).unwrap();
                publisher.publish(FleetMessage::Map(RobotId::new(1).unwrap(), grid));
                sleep(Duration::from_millis(300)).await;
            }
        });
        sleep(Duration::from_secs(1)).await;
        let mut attack = Attack { bridge, address, peak: 0 };
        measure("half frames", &mut attack, half_frames).await;
        measure("latched messages", &mut attack, latched_messages).await;
        measure("full queues", &mut attack, full_queues).await;
        measure("slow frames", &mut attack, slow_frames).await;
    });
}
