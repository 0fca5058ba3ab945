//! A link between a headset and the bridge: a TCP proxy that delays, limits and interrupts what passes.
//!
//! TCP hides loss: what a lost segment costs is a stall until it is sent again. So loss is drawn here as stalls.

use clap::ValueEnum;
use rand_pcg::Pcg32;
use rand_pcg::rand_core::{Rng, SeedableRng};
use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// Bytes of a TCP segment on Ethernet and Wi-Fi.
const SEGMENT_BYTES: usize = 1448;
/// Most bytes under way in one direction: a sender beyond it waits, as at a full socket.
const UNDER_WAY_MAX: usize = 256 * 1024;
/// Largest wait for new bytes while others are under way.
const LOOK: Duration = Duration::from_millis(1);

/// How a link behaves.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    /// Name in the table.
    pub name: &'static str,
    /// Smallest delay one way, milliseconds.
    pub delay_ms: f64,
    /// Mean of the exponentially distributed delay that comes on top, milliseconds.
    pub jitter_ms: f64,
    /// Throughput of one direction, Mbit/s.
    pub mbit_s: f64,
    /// Share of segments that are lost.
    pub loss: f64,
    /// Stall that a lost segment costs, milliseconds.
    pub stall_ms: f64,
    /// Period and length of outages, seconds; no outages if the length is 0.
    pub outage_s: [f64; 2],
}

/// A link that passes everything at once; the others change what they say.
const LOOPBACK: Link = Link {
    name: "loopback",
    delay_ms: 0.0,
    jitter_ms: 0.0,
    mbit_s: 1e4,
    loss: 0.0,
    stall_ms: 0.0,
    outage_s: [1.0, 0.0],
};
/// A 5 GHz network with nobody else on it.
const QUIET_WIFI: Link = Link {
    name: "quiet Wi-Fi",
    delay_ms: 2.0,
    jitter_ms: 1.5,
    mbit_s: 100.0,
    loss: 0.001,
    stall_ms: 12.0,
    ..LOOPBACK
};
/// A network that others use as well.
const BUSY_WIFI: Link = Link {
    name: "busy Wi-Fi",
    delay_ms: 4.0,
    jitter_ms: 8.0,
    mbit_s: 10.0,
    loss: 0.02,
    stall_ms: 40.0,
    ..LOOPBACK
};
/// All links, in the order of [`LinkChoice`].
pub const LINKS: [Link; 4] = [
    LOOPBACK,
    QUIET_WIFI,
    BUSY_WIFI,
    Link { name: "Wi-Fi with outages", outage_s: [15.0, 1.0], ..BUSY_WIFI },
];

/// One of [`LINKS`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LinkChoice {
    /// No proxy: the operator is on this machine
    #[default]
    Loopback,
    /// A 5 GHz network with nobody else on it
    QuietWifi,
    /// A network that others use as well
    BusyWifi,
    /// The same, with an outage of 1 s every 15 s
    Outages,
}

impl LinkChoice {
    /// Returns how the link behaves; `None`: everything passes at once, and no proxy is needed.
    pub fn link(self) -> Option<Link> {
        (self != Self::Loopback).then(|| LINKS[self as usize])
    }

    /// Returns the name for people.
    pub fn name(self) -> &'static str {
        LINKS[self as usize].name
    }
}

/// Starts a proxy to a port; returns its own port. It serves one connection after another, until the program ends.
///
/// # Errors
/// No port can be listened on.
pub fn start(link: Link, port: u16, seed: u64) -> std::io::Result<u16> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let own = listener.local_addr()?.port();
    std::thread::spawn(move || {
        for client in listener.incoming() {
            // Where the bridge is restarting, the client's connection ends, as it would without the proxy.
            let (Ok(client), Ok(server)) = (client, TcpStream::connect(("127.0.0.1", port))) else {
                continue;
            };
            let (Ok(from_server), Ok(to_client)) = (server.try_clone(), client.try_clone()) else { continue };
            let back = std::thread::spawn(move || pass(link, from_server, to_client, seed ^ 1));
            pass(link, client, server, seed);
            // A thread that panicked has said so.
            let _ = back.join();
        }
    });
    Ok(own)
}

/// Passes bytes one way until either end closes.
fn pass(link: Link, mut from: TcpStream, mut to: TcpStream, seed: u64) {
    let _ = (to.set_nodelay(true), from.set_read_timeout(Some(LOOK)));
    let mut random = Pcg32::seed_from_u64(seed);
    let mut uniform = move || -> f64 { (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64 };
    let mut under_way: VecDeque<(Instant, Vec<u8>)> = VecDeque::new();
    let (begun, mut last) = (Instant::now(), Instant::now());
    let mut space = [0; SEGMENT_BYTES];
    loop {
        let bytes: usize = under_way.iter().map(|(_, segment)| segment.len()).sum();
        if bytes < UNDER_WAY_MAX {
            match from.read(&mut space) {
                Ok(0) => break,
                Ok(count) => {
                    let mut delay_ms = link.delay_ms - link.jitter_ms * (1.0 - uniform()).ln();
                    if uniform() < link.loss {
                        delay_ms += link.stall_ms;
                    }
                    let sent_ms = count as f64 * 8e-3 / link.mbit_s;
                    // Bytes arrive in order, so that a stalled segment holds up those behind it.
                    last =
                        (Instant::now() + ms(delay_ms)).max(last + ms(sent_ms)).max(outage_end(link, begun));
                    under_way.push_back((last, space[..count].to_vec()));
                }
                Err(why) if matches!(why.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(_) => break,
            }
        } else {
            std::thread::sleep(LOOK);
        }
        while under_way.front().is_some_and(|(due, _)| *due <= Instant::now()) {
            let Some((_, segment)) = under_way.pop_front() else { break };
            if to.write_all(&segment).is_err() {
                let _ = from.shutdown(Shutdown::Both);
                return;
            }
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}

/// Returns the end of the outage of now, or now.
fn outage_end(link: Link, begun: Instant) -> Instant {
    let [period_s, length_s] = link.outage_s;
    let now = Instant::now();
    if length_s <= 0.0 {
        return now;
    }
    let phase_s = (now - begun).as_secs_f64() % period_s;
    // The outage is the end of each period.
    let left_s = if phase_s >= period_s - length_s { period_s - phase_s } else { 0.0 };
    now + Duration::from_secs_f64(left_s)
}

fn ms(milliseconds: f64) -> Duration {
    Duration::from_secs_f64(milliseconds * 1e-3)
}
