//! The bridge on a thread of this process, for what needs its inside: maps larger than the laboratory's, and the
//! count of allocations. The fleet goes on running beside it.

use crate::client::{Client, EVERYTHING};
use bridge::{Bridge, BridgeConfig, FleetMessage, serve};
use bytemuck::Zeroable;
use mr_slam::clock::now;
use msg::{Clock, GridHeader, GridView, PoseEstimate, RobotId, Scan, Transforms};
use stats_alloc::Region;
use std::error::Error;
use std::net::Ipv4Addr;
use std::rc::Rc;
use std::sync::{Arc, mpsc};
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};
use tokio::task::LocalSet;

type Job = Box<dyn FnOnce(&Bridge) + Send>;
/// Cells along a side: 16 MB.
const SIDE: u32 = 4000;

/// Its port, and where to send what it shall do.
fn start() -> Result<(u16, UnboundedSender<Job>), Box<dyn Error>> {
    let (jobs, mut todo) = unbounded_channel::<Job>();
    let (tell, port) = mpsc::channel();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        LocalSet::new().block_on(&runtime, async move {
            let bridge = Rc::new(Bridge::new(BridgeConfig::default(), 3, |_, _| {}).expect("the default"));
            let listener = tokio::net::TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a port");
            tell.send(listener.local_addr().expect("an address").port()).expect("somebody asked");
            tokio::task::spawn_local(serve(bridge.clone(), listener, now, std::future::pending()));
            while let Some(job) = todo.recv().await {
                job(&bridge);
            }
        });
    });
    Ok((port.recv()?, jobs))
}

/// Milliseconds from a 16 MB map in memory to the client that has all of it, sorted. Like a building: runs of free,
/// occupied and unknown cells, with some noise.
pub fn large_maps(count: usize) -> Result<Vec<f64>, Box<dyn Error>> {
    let (port, jobs) = start()?;
    let mut client = Client::connect(port, &[EVERYTHING[8]])?;
    client.stream.set_read_timeout(None)?;
    let cell = |i: u32| match (i / 700) % 3 {
        0 => -80,
        1 if i.wrapping_mul(2_654_435_761) >> 27 == 0 => 60,
        _ => msg::grid::UNKNOWN,
    };
    let cells: Arc<Vec<i8>> = Arc::new((0..SIDE * SIDE).map(cell).collect());
    let mut times = Vec::new();
    for round in 0..count + 2 {
        let cells = cells.clone();
        let begun = now();
        jobs.send(Box::new(move |bridge| {
            let shape = GridHeader { width: SIDE, height: SIDE, resolution_m: 0.05, ..GridHeader::default() };
            bridge.publish(FleetMessage::MergedMap(
                GridView::new(&shape, &cells).expect("the shape is the cells'"),
            ));
        }))?;
        client.next(|_, payload| payload.len())?.ok_or("the map did not come")?;
        // Two to warm up: fresh memory costs more than the map.
        if round >= 2 {
            times.push(now().since(begun) as f64 * 1e-6);
        }
    }
    times.sort_by(f64::total_cmp);
    Ok(times)
}

/// Allocations in `rounds` rounds of the fleet's messages to two clients, after a warm-up, all threads of this
/// process together; and how many messages that were.
pub fn allocations(rounds: usize) -> Result<(usize, usize), Box<dyn Error>> {
    let (port, jobs) = start()?;
    let wishes = [EVERYTHING[0], EVERYTHING[1], EVERYTHING[2], EVERYTHING[5]];
    let mut clients = [Client::connect(port, &wishes)?, Client::connect(port, &wishes)?];
    let (go, begin) = mpsc::channel::<usize>();
    let (tell, counted) = mpsc::channel();
    // All rounds are one job: handing over jobs allocates, which is the bench's, not the bridge's.
    jobs.send(Box::new(move |bridge| {
        let robot = RobotId::first(1).next().expect("robot 1");
        let scan = Box::new(Scan { len: 180, ..Scan::zeroed() });
        let cells = vec![0; 200 * 200];
        let shape = GridHeader { width: 200, height: 200, resolution_m: 0.05, ..GridHeader::default() };
        let round = || {
            bridge.publish(FleetMessage::Transforms(robot, &Transforms::default()));
            bridge.publish(FleetMessage::PoseEstimate(robot, &PoseEstimate::default()));
            bridge.publish(FleetMessage::Clock(&Clock::default()));
            bridge.publish(FleetMessage::Scan(robot, &scan));
            bridge.publish(FleetMessage::Map(
                robot,
                GridView::new(&shape, &cells).expect("the shape is the cells'"),
            ));
        };
        (0..rounds).for_each(|_| round());
        while let Ok(rounds) = begin.recv() {
            let region = Region::new(crate::ALLOCATOR);
            (0..rounds).for_each(|_| round());
            let change = region.change();
            let _ = tell.send(change.allocations + change.reallocations);
        }
    }))?;
    // They read as long as something comes, and allocate nothing: their parsers have grown by then.
    let readers = clients.each_mut().map(|client| client.stream.try_clone());
    for reader in readers {
        let mut reader = reader?;
        reader.set_read_timeout(None)?;
        std::thread::spawn(move || {
            let mut sink = vec![0; 1 << 20];
            while let Ok(1..) = std::io::Read::read(&mut reader, &mut sink) {}
        });
    }
    go.send(rounds)?;
    let _ = counted.recv()?;
    go.send(rounds)?;
    let count = counted.recv()?;
    drop(go);
    Ok((count, rounds * 5 * clients.len()))
}
