//! A ROS 2 endpoint that publishes maps of a given size, for measurements: `.ci/interop` starts it.
//!
//! `dds_maps DOMAIN SIDE PERIOD_S COUNT`: COUNT maps of SIDE x SIDE cells on /robot1/map and /merged_map, one each
//! PERIOD_S, then nothing. Map n has stamp n seconds. Prints `map n` when it is published. Ends when its standard
//! input ends.

use bridge::BridgeConfig;
use bridge::dds::{DdsConfig, DdsEndpoint};
use bridge::{FleetMessage, Transport};
use msg::{GridHeader, GridView, Header, Pose2, RobotId, Stamp};
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::{LocalSet, spawn_local};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let numbers: Vec<f64> = std::env::args().skip(1).map(|text| text.parse()).collect::<Result<_, _>>()?;
    let [domain, side, period_s, count] = numbers[..] else {
        return Err("usage: dds_maps DOMAIN SIDE PERIOD_S COUNT".into());
    };
    let dds = DdsConfig { enabled: true, domain: (domain as u16).into(), ..DdsConfig::default() };
    let config = BridgeConfig { dds, ..BridgeConfig::default() };
    let robot = RobotId::new(1).ok_or("robot 1 exists")?;
    std::thread::spawn(|| {
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
        std::process::exit(0);
    });
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    LocalSet::new().block_on(&runtime, async {
        let endpoint = Rc::new(DdsEndpoint::open(&config, 1, false, Arc::default())?);
        spawn_local(endpoint.clone().serve());
        let side = side as usize;
        // Values vary from cell to cell, so that nothing can be compressed or skipped.
        let cells: Vec<i8> =
            (0..side * side).map(|i| (i * 31 % 251) as u8 as i8).map(|c| c.max(-127)).collect();
        for number in 1..=count as i64 {
            let header = Header { stamp: Stamp(number * 1_000_000_000), ..Header::default() };
            let (width, height) = (side as u32, side as u32);
            let (origin, resolution_m) = (Pose2::IDENTITY, 0.05);
            let header = GridHeader { header, origin, resolution_m, width, height, ..GridHeader::default() };
            let map = GridView::new(&header, &cells).ok_or("the grid and its header differ in size")?;
            endpoint.publish(FleetMessage::Map(robot, map));
            endpoint.publish(FleetMessage::MergedMap(map));
            println!("map {number}");
            tokio::time::sleep(Duration::from_secs_f64(period_s)).await;
        }
        std::future::pending::<()>().await;
        Ok(())
    })
}
