//! Maps: what a scan costs in a large one, what a closure costs a slice at a time, and the bytes that cross
//! a channel.
//!
//! `cargo bench --bench map`. Times are processor time of the one thread, so that a busy machine shows little.

use msg::tiles::{PatchReceiver, PatchSender};
use msg::{DenseMap, Header, MapTile, PatchHeader, Pose2};
use slam::{Cloud, MapConfig, Node, OccupancyMapper, Rays};
use std::sync::Arc;

/// Cells of beams a slice may draw, as the live process has it.
const SLICE_CELLS: usize = 400_000;
const BEAMS: usize = 360;
/// Nodes that come after the map is there.
const NEW: usize = 200;

fn main() {
    println!("{:<58} {:>8} {:>8} {:>8}", "milliseconds", "p50", "p99", "max");
    for (side_m, range_m) in [(20.0, 3.0), (178.0, 10.0)] {
        map(side_m, range_m);
    }
}

/// A square full of nodes that see a wall all around, `range_m` away.
fn map(side_m: f64, range_m: f32) {
    let along = (side_m / (0.5 * f64::from(range_m))) as usize;
    let place = |index: usize| {
        let at = |k: usize| (k as f64 + 0.5) * side_m / along as f64;
        Pose2::new(at(index % along), at(index / along % along), 0.1 * index as f64)
    };
    let mut nodes: Vec<Node> = (0..along * along).map(|id| node(id, range_m)).collect();
    let mut poses: Vec<Pose2> = (0..nodes.len()).map(place).collect();
    let (mut canvas, mut reader) = (OccupancyMapper::new(MapConfig::default()), Reader::default());
    while canvas.work(&nodes, &poses, usize::MAX) {}
    reader.follow(&canvas);
    let known = *reader.grid.view().header;
    let size = format!("{} x {} cells, {} nodes", known.width, known.height, nodes.len());
    let whole = std::mem::take(&mut reader.bytes);

    let [mut drawn, mut sent, mut taken, mut shown] = [const { Vec::new() }; 4];
    for index in 0..NEW {
        nodes.push(node(nodes.len(), range_m));
        poses.push(place(index * 7919));
        drawn.push(timed(|| while canvas.work(&nodes, &poses, SLICE_CELLS) {}));
        let times = reader.follow(&canvas);
        sent.push(times[0]);
        taken.push(times[1]);
        shown.push(times[2]);
    }
    row(&format!("{size}: a scan drawn"), drawn);
    row("    its tiles found and put into messages", sent);
    row("    taken by a reader", taken);
    row("    brought into one grid", shown);
    println!(
        "    {:.0} kB a scan; the whole as tiles {:.0} kB, as a grid {:.0} kB",
        reader.bytes as f64 / NEW as f64 / 1e3,
        whole as f64 / 1e3,
        (known.width * known.height) as f64 / 1e3
    );

    // A closure: everything moves.
    let bend = |pose: Pose2| Pose2::new(0.05, -0.05, 0.004) * pose;
    let moved: Vec<Pose2> = poses.iter().map(|pose| bend(*pose)).collect();
    let mut slices = Vec::new();
    let mut more = true;
    while more {
        slices.push(timed(|| more = canvas.work(&nodes, &moved, SLICE_CELLS)));
    }
    let (count, sum) = (slices.len(), slices.iter().sum::<f64>());
    row(&format!("    everything moved: {count} slices, {sum:.0} ms in all"), slices);
}

fn node(id: usize, range_m: f32) -> Node {
    let mut rays = Rays::default();
    for beam in 0..BEAMS {
        let (sin, cos) = (beam as f32 * core::f32::consts::TAU / BEAMS as f32).sin_cos();
        let range_m = range_m * (1.0 + 0.1 * ((beam + 31 * id) as f32 * 0.2).sin());
        rays.hits.push([range_m * cos, range_m * sin]);
    }
    Node {
        id: id as u32,
        header: Header { stamp: msg::Stamp(id as i64), ..Default::default() },
        local_from_base: Pose2::IDENTITY,
        previous_from_this: None,
        is_tracked: true,
        odometry_break: false,
        disconnected_component: None,
        uncertain_component: None,
        unmeasured_s: 0.0,
        slip: [0.0; 3],
        possibly_kidnapped: false,
        cloud: Arc::new(Cloud::merged(core::iter::empty(), 1)),
        rays: Arc::new(rays),
        swept_path: slam::SweptPath::default(),
    }
}

/// The other end of a channel, and what crossed it.
#[derive(Default)]
struct Reader {
    outgoing: PatchSender,
    incoming: PatchReceiver,
    grid: DenseMap,
    bytes: usize,
    seq: u64,
}

impl Reader {
    /// Brings the reader up to date: milliseconds to write, to read, to show.
    fn follow(&mut self, canvas: &OccupancyMapper) -> [f64; 3] {
        let mut times = [0.0; 3];
        loop {
            let mut patch = None;
            times[0] += timed(|| patch = self.outgoing.next_patch(canvas.tiles()));
            let Some(mut patch) = patch else { break };
            patch.header.map.header.seq = self.seq;
            self.seq += 1;
            let mut tiles: Vec<MapTile> = Vec::new();
            times[0] += timed(|| tiles = patch.tiles.iter().map(|tile| **tile).collect());
            self.bytes += size_of::<PatchHeader>() + size_of_val(tiles.as_slice());
            times[1] += timed(|| {
                self.incoming.receive(&patch.header, &tiles);
            });
        }
        times[2] = timed(|| {
            self.grid.update(self.incoming.map());
        });
        times
    }
}

/// Milliseconds of processor time.
fn timed(act: impl FnOnce()) -> f64 {
    let start = cpu_s();
    act();
    (cpu_s() - start) * 1e3
}

fn row(name: &str, mut milliseconds: Vec<f64>) {
    milliseconds.sort_by(f64::total_cmp);
    let at = |share: f64| milliseconds[((milliseconds.len() - 1) as f64 * share) as usize];
    println!("{name:<58} {:>8.3} {:>8.3} {:>8.3}", at(0.5), at(0.99), at(1.0));
}

fn cpu_s() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
