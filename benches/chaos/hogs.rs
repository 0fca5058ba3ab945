//! Both cores are busy: jitter of the transforms at a TCP client, with and without page, recorder and ROS 2 peer, what the recorder
//! misses, and how long a step of navigation takes while robots explore.

use crate::fleet::{LOOK_PERIOD, PATIENCE};
use crate::measure::Spread;
use crate::measured_fleet::Fleet;
use crate::peer::{self, Peer};
use crate::{Args, Row, Rows};
use serde_json::json;
use std::error::Error;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command};
use std::time::{Duration, Instant};
use tempfile::NamedTempFile;

/// Time until the clients are connected and the fleet has its first maps.
const WARM_UP: Duration = Duration::from_secs(4);
/// How much larger jitter may become with page, recorder and ROS 2 peer.
const WORSE_MAX: f64 = 1.2;
/// Growth that does not count, milliseconds: a fleet's own jitter differs by this from run to run.
const FLOOR_MS: f64 = 0.05;
/// Real-time settings beside the defaults.
const REALTIME: &str = "[realtime]\npriority = 50\nlock_memory = true\n";

/// Fleet that explores, and its room: so large that it takes longer than the measurement.
const EXPLORERS: usize = 8;
const EXPLORED_ROOM: &str = "office:1";
/// Longest step of navigation, milliseconds: after it the bridge has stopped the robots.
const STEP_MAX_MS: f32 = 300.0;

/// Place of the scheduling policy among the fields behind a process's name, proc_pid_stat(5), and its value for SCHED_FIFO.
const POLICY_FIELD: usize = 38;
const SCHED_FIFO: &str = "1";

/// Computes without end. The parent kills it.
pub fn spin() -> ! {
    let mut value = 1_u64;
    loop {
        value = std::hint::black_box(value.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1));
    }
}

/// Processes that compute without end, one for each core, until they are dropped.
pub struct Hogs(Vec<Child>);

impl Hogs {
    /// Starts them.
    pub fn start() -> Result<Self, Box<dyn Error>> {
        let cores = std::thread::available_parallelism()?.get();
        let mut hogs = Self(Vec::new());
        for _ in 0..cores {
            hogs.0.push(Command::new(std::env::current_exe()?).arg("hog").spawn()?);
        }
        Ok(hogs)
    }
}

impl Drop for Hogs {
    fn drop(&mut self) {
        for hog in &mut self.0 {
            // It computes without end: it lives.
            let _ = (hog.kill(), hog.wait());
        }
    }
}

/// Measures with default and with real-time settings.
pub fn run(args: &Args) -> Rows {
    let mut rows = Vec::new();
    for (settings, text) in [("default", ""), ("realtime", REALTIME)] {
        if !text.is_empty() && !is_realtime_permitted(args, text)? {
            let why = "SCHED_FIFO is not permitted: see `mr-slam doctor`".to_owned();
            rows.push(Row::note("hogs", &format!("{settings}: not checked"), why));
            continue;
        }
        for hogs in [false, true] {
            let (alone, _) = measure(args, text, hogs, false)?;
            let (attached, unrecorded) = measure(args, text, hogs, true)?;
            let load = if hogs { "hogs on all cores" } else { "no other load" };
            rows.push(row(&format!("{settings}, {load}"), &alone));
            let with = row(&format!("{settings}, {load}, page + recorder + ROS 2"), &attached);
            let within =
                |of: fn(&Spread) -> f64| of(&attached) <= (WORSE_MAX * of(&alone)).max(of(&alone) + FLOOR_MS);
            // Without load nothing is required: the peers themselves are the load.
            let holds = within(|spread| spread.p50_ms) && within(|spread| spread.p95_ms);
            rows.push(match hogs {
                true => Row { limit: "<= 1.2 times".into(), holds: Some(holds), ..with },
                false => with,
            });
            let what = format!("{settings}, {load}, messages not recorded");
            rows.push(Row::new("hogs", &what, unrecorded.to_string(), "0", unrecorded == 0));
        }
    }
    rows.push(navigation(args)?);
    Ok(rows)
}

/// Measures how long a step of navigation takes at most while a fleet explores and the cores are busy.
fn navigation(args: &Args) -> Result<Row, Box<dyn Error>> {
    let words = ["--explore", "--room", EXPLORED_ROOM, "--page", "off"];
    let mut fleet = Fleet::start_with(EXPLORERS, &words)?;
    std::thread::sleep(WARM_UP);
    let _hogs = Hogs::start()?;
    let (begun, mut longest_ms) = (Instant::now(), 0.0_f32);
    while begun.elapsed() < args.length {
        // The figures are those of the last second.
        let navigation = fleet.process("nav").ok_or("telemetry does not know navigation")?;
        longest_ms = longest_ms.max(navigation.work_max_us * 1e-3);
    }
    let what = format!("{EXPLORERS} robots explore, hogs on all cores: longest step of navigation");
    let (measured, limit) = (format!("{longest_ms:.0} ms"), format!("<= {STEP_MAX_MS} ms"));
    let holds = longest_ms > 0.0 && longest_ms <= STEP_MAX_MS;
    Ok(Row::new("hogs", &what, measured, &limit, holds))
}

/// Starts a fleet with real-time settings; returns whether its bridge got them. Where they are not permitted, a fleet warns and runs on.
fn is_realtime_permitted(args: &Args, settings: &str) -> Result<bool, Box<dyn Error>> {
    let file = config_file(settings)?;
    let config = path_of(&file)?;
    let mut fleet = Fleet::start_with(args.robots, &["--config", config, "--page", "off"])?;
    let bridge = fleet.pid("bridge").ok_or("telemetry does not know the bridge")?;
    let text = std::fs::read_to_string(format!("/proc/{bridge}/stat"))?;
    let fields = text.rsplit_once(')').map_or("", |(_, fields)| fields);
    Ok(fields.split_whitespace().nth(POLICY_FIELD) == Some(SCHED_FIFO))
}

/// Writes a configuration file, which is removed when it is dropped.
fn config_file(settings: &str) -> std::io::Result<NamedTempFile> {
    let mut file = NamedTempFile::with_suffix(".toml")?;
    write!(file, "{settings}")?;
    Ok(file)
}

fn path_of(file: &NamedTempFile) -> Result<&str, Box<dyn Error>> {
    Ok(file.path().to_str().ok_or("the temporary folder's name is not UTF-8")?)
}

fn row(what: &str, spread: &Spread) -> Row {
    let Spread { p50_ms, p95_ms, p99_ms, lost, .. } = spread;
    let measured = format!("{p50_ms:.3} / {p95_ms:.3} / {p99_ms:.3} ms, {lost} lost");
    Row::note("hogs", what, measured).with(json!({ "tf": spread }))
}

/// Returns the jitter of transforms, and the number of messages that the recorder missed or dropped.
fn measure(args: &Args, settings: &str, hogs: bool, attached: bool) -> Result<(Spread, u64), Box<dyn Error>> {
    let file = config_file(settings)?;
    let config = path_of(&file)?;
    let domain = peer::domain().to_string();
    let mut words = vec!["--config", config, "--page", "0"];
    if attached {
        words.extend(["--record", "--ros-domain", &domain]);
    }
    let mut fleet = Fleet::start_with(args.robots, &words)?;
    let mut listening = None;
    if attached {
        page(fleet.run().config.bridge.page.port)?;
        listening = Some(Peer::start(peer::domain(), WARM_UP + args.length)?);
    }
    let _hogs = if hogs { Some(Hogs::start()?) } else { None };
    let tf = fleet.measure(WARM_UP, args.length)?.tf;
    if let Some(peer) = listening
        && peer.heard()? == 0
    {
        return Err("the ROS 2 peer heard nothing".into());
    }
    if !attached {
        return Ok((tf, 0));
    }
    let recorder = fleet.process("record").ok_or("telemetry does not know the recorder")?;
    Ok((tf, recorder.lost + recorder.dropped))
}

/// Connects to the operator's page as a browser does, subscribes to every topic, and reads until the fleet ends.
fn page(port: u16) -> Result<(), Box<dyn Error>> {
    let begun = Instant::now();
    let mut stream = loop {
        // The bridge may be starting.
        match TcpStream::connect(("127.0.0.1", port)) {
            Ok(stream) => break stream,
            Err(why) if begun.elapsed() > PATIENCE => return Err(why.into()),
            Err(_) => std::thread::sleep(LOOK_PERIOD),
        }
    };
    write!(
        stream,
        "GET /ws HTTP/1.1\r\nHost: localhost:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
    )?;
    let mut reader = BufReader::new(stream.try_clone()?);
    let mut line = String::new();
    while line != "\r\n" {
        line.clear();
        if reader.read_line(&mut line)? == 0 {
            return Err("the bridge refused the page".into());
        }
    }
    loop {
        let text = frame(&mut reader)?;
        let Ok(message) = serde_json::from_slice::<serde_json::Value>(&text) else { continue };
        let Some(channels) = message["channels"].as_array() else { continue };
        let subscriptions: Vec<_> = channels
            .iter()
            .enumerate()
            .map(|(index, channel)| json!({ "id": index, "channelId": channel["id"] }))
            .collect();
        let text = json!({ "op": "subscribe", "subscriptions": subscriptions }).to_string();
        stream.write_all(&masked(text.as_bytes()))?;
        break;
    }
    std::thread::spawn(move || std::io::copy(&mut reader, &mut std::io::sink()));
    Ok(())
}

/// Reads a frame's payload: RFC 6455, 5.2.
fn frame(reader: &mut impl Read) -> std::io::Result<Vec<u8>> {
    let mut head = [0; 2];
    reader.read_exact(&mut head)?;
    let length = match head[1] {
        126 => {
            let mut long = [0; 2];
            reader.read_exact(&mut long)?;
            u64::from(u16::from_be_bytes(long))
        }
        127 => {
            let mut long = [0; 8];
            reader.read_exact(&mut long)?;
            u64::from_be_bytes(long)
        }
        short => u64::from(short),
    };
    let mut payload = vec![0; length as usize];
    reader.read_exact(&mut payload)?;
    Ok(payload)
}

/// Returns a text frame as a client sends it, with a mask of zeros.
fn masked(payload: &[u8]) -> Vec<u8> {
    let mut out = vec![0x81, 0x80 | 126];
    out.extend((payload.len() as u16).to_be_bytes());
    out.extend([0; 4]);
    out.extend(payload);
    out
}
