//! The headset's application on a thread of its own, connected to the bridge over TCP.

use crate::{CLOCK_AHEAD, HeadsetRobots};
use bridge::frame::{KEEPALIVE, Parser};
use runtime::clock::{Epoch, now};
use sim::Simulator;
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpStream};
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time between two attempts to connect, as the connector waits.
const RETRY_PERIOD: Duration = Duration::from_secs(1);
/// Delay after which missed ticks are skipped: the machine slept, or the link stood.
const BEHIND_MAX: Duration = Duration::from_secs(1);
/// Longest time that one write may wait for the link; then the application connects anew.
const WRITE_MAX: Duration = Duration::from_secs(10);
/// Topics of velocities of which the newest waits for the next tick; those of further topics are left out.
const TOPICS_MAX: usize = 256;
/// Largest frame from the bridge, bytes: velocities and notices.
const FRAME_BYTES_MAX: usize = 64 << 10;

/// The velocities that wait for the next tick: of each topic the newest, which may be the zero that stops its robot.
#[derive(Default)]
struct NewestVelocities {
    by_topic: Mutex<BTreeMap<String, Vec<u8>>>,
}

impl NewestVelocities {
    /// Takes a velocity in the place of an older one.
    fn set(&self, topic: &str, payload: &[u8]) {
        // A map is whole after any panic.
        let mut by_topic = self.by_topic.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(newest) = by_topic.get_mut(topic) {
            newest.clear();
            newest.extend_from_slice(payload);
        } else if by_topic.len() < TOPICS_MAX {
            by_topic.insert(topic.to_owned(), payload.to_vec());
        }
    }

    /// Returns those that have come since the last call.
    fn take(&self) -> BTreeMap<String, Vec<u8>> {
        core::mem::take(&mut *self.by_topic.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// The running application; dropping it ends it.
pub struct Headset {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Headset {
    /// Starts the application, which connects to a port of this machine, again and again if need be.
    ///
    /// # Errors
    /// No thread can be started.
    pub fn start(robots: HeadsetRobots, port: u16) -> std::io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let thread = std::thread::Builder::new().name("headset".into());
        let thread = thread.spawn(move || play(robots, port, &stopped))?;
        Ok(Self { stop, thread: Some(thread) })
    }

    /// Returns whether the application still runs.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }
}

impl Drop for Headset {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let ended = thread.join();
            if let (Err(why), false) = (ended, std::thread::panicking()) {
                resume_unwind(why);
            }
        }
    }
}

/// Plays on one connection after the other until the application is to end.
fn play(mut robots: HeadsetRobots, port: u16, stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        if let Ok(stream) = TcpStream::connect((Ipv4Addr::LOCALHOST, port))
            && let Err(why) = play_on(&mut robots, stream, stop)
        {
            tracing::warn!("the headset's connection ended: {why}");
        }
        let begun = Instant::now();
        while begun.elapsed() < RETRY_PERIOD && !stop.load(Ordering::Relaxed) {
            std::thread::sleep(Simulator::TICK);
        }
    }
}

/// Ticks in real time on a connection until it fails or the application is to end.
fn play_on(robots: &mut HeadsetRobots, mut stream: TcpStream, stop: &AtomicBool) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(WRITE_MAX))?;
    let velocities = Arc::new(NewestVelocities::default());
    let (reading, received) = (stream.try_clone()?, velocities.clone());
    let reader = std::thread::spawn(move || read_velocities(reading, &received));
    let result = tick_until(robots, &mut stream, &velocities, stop);
    let _ = stream.shutdown(Shutdown::Both);
    reader.join().unwrap_or_else(|why| resume_unwind(why));
    result
}

fn tick_until(
    robots: &mut HeadsetRobots,
    stream: &mut TcpStream,
    velocities: &NewestVelocities,
    stop: &AtomicBool,
) -> std::io::Result<()> {
    let mut frames = KEEPALIVE.to_vec();
    robots.register(&mut frames);
    // The headset's time of day.
    let time_of_day = || Epoch::unix().stamp(now()) + CLOCK_AHEAD;
    robots.set_time(time_of_day());
    let mut due = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        for (topic, payload) in velocities.take() {
            robots.receive(&topic, &payload);
        }
        robots.tick(&mut frames);
        stream.write_all(&frames)?;
        frames.clear();
        due += Simulator::TICK;
        if due.elapsed() > BEHIND_MAX {
            robots.set_time(time_of_day());
            due = Instant::now();
        }
    }
    Ok(())
}

/// Passes velocities on until the connection ends.
fn read_velocities(mut stream: TcpStream, velocities: &NewestVelocities) {
    let mut parser = Parser::new(FRAME_BYTES_MAX);
    while let Ok(count @ 1..) = stream.read(parser.space()) {
        parser.filled(count);
        loop {
            match parser.next_frame() {
                Ok(Some(frame)) => {
                    if let Ok(topic) = std::str::from_utf8(frame.name)
                        && topic.ends_with("/cmd_vel")
                    {
                        velocities.set(topic, frame.payload);
                    }
                }
                Ok(None) => break,
                Err(why) => {
                    tracing::warn!("the headset closes its connection: {why}");
                    // The thread that writes notices it, and connects anew.
                    let _ = stream.shutdown(Shutdown::Both);
                    return;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_velocity_of_each_robot_waits_however_many_came_before() {
        let velocities = NewestVelocities::default();
        for value in 0..1000_u32 {
            for robot in 1..=3 {
                velocities.set(&format!("/robot{robot}/cmd_vel"), &(robot * value).to_le_bytes());
            }
        }
        let taken: Vec<_> = velocities.take().into_values().collect();
        assert_eq!(taken, [999_u32, 1998, 2997].map(|value| value.to_le_bytes().to_vec()));
        assert!(velocities.take().is_empty());
        for topic in 0..1000 {
            velocities.set(&format!("/{topic}/cmd_vel"), &[0]);
        }
        assert_eq!(velocities.take().len(), TOPICS_MAX);
    }
}
