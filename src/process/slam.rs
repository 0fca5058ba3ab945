//! One robot's SLAM. One thread answers scans and waits for nothing else; another closes loops, solves, draws the
//! map and answers requests beside it (`beside`); a third reads and writes files (`files`).
//!
//! ```text
//!  scans ─▶ scan path ── News: nodes, where it is ──▶ beside ── Job ──▶ files
//!               ▲                                     │    ▲              │
//!               └─ Order: revisions, pause, begin ────┘    └──── Done ────┘
//! ```

mod beside;
mod files;
mod services;

use super::Error;
use super::pulse::{Account, Pulse};
use crate::channel;
use crate::run::Run;
use crate::session_file;
use crate::sessions;
use crate::shared_memory::wait;
use crate::stop::Stop;
use ::slam::{Back, Front, FrontState, NODES_UNDER_WAY_MAX, Node, Revision, SlamConfig, Start};
use msg::{Correction, Header, Odometry, Pose2, RobotId, Role, Scan, SlamMode};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// Orders the scan path may fall behind; at each scan it takes all there are.
const ORDERS_WAITING_MAX: usize = 256;
/// Nodes of a scan path, and of the one before it that was just replaced, and a few other news.
const NEWS_WAITING_MAX: usize = 2 * NODES_UNDER_WAY_MAX + 16;

/// What the scan path tells.
#[expect(clippy::large_enum_variant, reason = "a node goes by value: the scan path does not allocate")]
enum News {
    /// A scan that enters the graph.
    Node(Node),
    /// The scan path has begun here: the map from its frame.
    Began(Pose2),
    /// Where it is, after the nodes told before: the answer to [`Order::Tell`].
    State(Box<FrontState>),
    /// It was replaced; nodes told from now on are its successor's.
    Old(Box<Front>),
    /// It has ended here.
    End(Box<FrontState>),
    /// A file is done with.
    Done(Box<files::Done>),
}

/// What the scan path is told.
enum Order {
    /// What became of a node.
    Revise(Revision),
    /// Whether scans are looked at no more.
    Pause(bool),
    /// Answer with [`News::State`].
    Tell,
    /// Be this one from now on.
    Begin {
        front: Box<Front>,
        /// The robot is where it was, in a map of the same frame.
        in_place: bool,
    },
    /// Where its frame lies in the map, now and not with the next node; none: not known any more.
    Place(Option<Pose2>),
    /// The next scan becomes a node: somebody waits for one.
    WantNode,
}

pub fn run(run: &Run, robot: RobotId, at: Option<Pose2>, stop: &Stop) -> Result<(), Error> {
    let (front, back, carried) = begin(run, robot, at)?;
    let (news, inbox) = sync_channel::<News>(NEWS_WAITING_MAX);
    let (orders, orders_in) = sync_channel::<Order>(ORDERS_WAITING_MAX);
    let (jobs, jobs_in) = sync_channel::<files::Job>(files::JOBS_WAITING_MAX);

    let node = run.attach(Role::Slam, Some(robot))?;
    let mut pulse = Pulse::new(&node, run, Role::Slam, Some(robot))?;
    let mut scans = node.reader(&channel::scan(robot))?;
    let scan_bell = node.listener(&channel::scan(robot))?;
    let mut odometry = node.reader(&channel::odometry(robot))?;
    let mut corrections = node.writer(&channel::correction(robot))?;
    let mut refused = 0;
    std::thread::scope(|scope| {
        let done = news.clone();
        let slam = live(run);
        scope.spawn(move || files::serve(&slam, jobs_in, done));
        let beside = scope.spawn(|| beside::run(run, robot, back, inbox, orders, jobs));
        let mut path = ScanPath::new(front, carried, news, orders_in);
        while !stop.requested() && !beside.is_finished() {
            wait([&scan_bell], pulse.due());
            path.obey();
            while let Some(scan) = scans.receive() {
                while let Some(odometry) = odometry.receive() {
                    path.odometry(&odometry);
                }
                path.obey();
                let (correction, used) = pulse.work(|| path.process(&scan));
                refused += u64::from(!used);
                if let Some(correction) = correction {
                    corrections.send(&correction);
                }
            }
            pulse.beat(|| Account { gaps: scans.gaps(), refused, ..Account::default() });
        }
        path.end();
        beside.join().map_err(|_| "the work beside the scans failed")?.map_err(Error::from)
    })
}

/// What SLAM begins with: what an earlier worker of this run kept; else the session that the fleet begins with; else
/// nothing. And, if it is not the scan path itself that goes on, where `odom` lies in the map, as was seen last.
fn begin(run: &Run, robot: RobotId, at: Option<Pose2>) -> Result<(Front, Back, Option<Pose2>), Error> {
    let config = live(run);
    let own = sessions::file(&sessions::folder(run), robot);
    let identity = sessions::identity(run, robot);
    match session_file::read(&own, &identity) {
        Ok(kept) if kept.identity.run == identity.run => {
            let mode = kept.mode;
            // A robot that was localized is looked for where it was; one that was looked for, everywhere.
            let carried = at.filter(|_| kept.front.is_none() && mode == SlamMode::Localization);
            let (front, back) = ::slam::begin(config, Some(kept), mode, Start::GoOn);
            return Ok((front, back, carried));
        }
        Err(why) if !why.is_missing() => eprintln!("slam of {robot}: {why}; goes on without it"),
        // Of another run in the same folder.
        _ => {}
    }
    let first = sessions::first(&run.config, robot)?;
    let mode = sessions::first_mode(&run.config, first.is_some());
    let (front, mut back) = ::slam::begin(config, first, mode, Start::Unknown);
    // No scan of this run is in it yet.
    back.date_map(Header::default(), crate::clock::now());
    // Whether the robot had been found in it is not known.
    let carried = at.filter(|_| back.nodes().is_empty());
    Ok((front, back, carried))
}

/// The fleet's configuration of SLAM, for a process without end: nobody asks it for all poses since it began.
fn live(run: &Run) -> SlamConfig {
    let mut config = run.config.slam.clone();
    config.graph.trajectory_max = 0;
    config
}

/// The scan path in its process.
struct ScanPath {
    front: Box<Front>,
    paused: bool,
    /// The first scan is to be where `odom` lies here in the map: what came before is gone on with.
    carried: Option<Pose2>,
    last: Option<Correction>,
    odom_from_base: Pose2,
    news: SyncSender<News>,
    orders: Receiver<Order>,
}

impl ScanPath {
    fn new(front: Front, carried: Option<Pose2>, news: SyncSender<News>, orders: Receiver<Order>) -> Self {
        Self {
            front: Box::new(front),
            paused: false,
            carried,
            last: None,
            odom_from_base: Pose2::IDENTITY,
            news,
            orders,
        }
    }

    /// There is room for all that the scan path says: it never waits here.
    fn tell(&self, news: News) {
        let _ = self.news.try_send(news);
    }

    fn obey(&mut self) {
        while let Ok(order) = self.orders.try_recv() {
            match order {
                Order::Revise(revision) => self.front.revise(revision),
                Order::Pause(paused) => self.paused = paused,
                Order::Tell => self.tell(News::State(Box::new(self.front.state()))),
                Order::Begin { front, in_place } => {
                    let old = core::mem::replace(&mut self.front, front);
                    self.carried = self.last.filter(|_| in_place).map(|last| last.map_from_odom);
                    self.tell(News::Old(old));
                }
                Order::Place(map_from_local) => self.front.place(map_from_local),
                Order::WantNode => self.front.want_node(),
            }
        }
    }

    fn odometry(&mut self, odometry: &Odometry) {
        self.odom_from_base = odometry.odom_from_base;
        self.front.odometry(odometry);
    }

    /// The answer to a scan, if there is one, and whether the scan was sound.
    fn process(&mut self, scan: &Scan) -> (Option<Correction>, bool) {
        if self.paused {
            self.last = self.last.map(|last| self.dead_reckoned(last, scan));
            return (self.last, true);
        }
        let mut step = self.front.process(scan);
        if step.refused.is_none()
            && let Some(map_from_odom) = self.carried.take()
        {
            let map_from_local = map_from_odom * step.correction.map_from_odom.inverse();
            self.front.place(Some(map_from_local));
            step.correction.map_from_base = map_from_local * step.correction.map_from_base;
            step.correction.map_from_odom = map_from_odom;
            self.tell(News::Began(map_from_local));
        }
        if let Some(node) = step.node {
            self.tell(News::Node(node));
        }
        self.last = Some(step.correction);
        (self.last, step.refused.is_none())
    }

    /// Where the wheels say that a robot is whose scans nobody looks at.
    fn dead_reckoned(&self, last: Correction, scan: &Scan) -> Correction {
        Correction {
            header: Header { stamp: scan.header.stamp, ..Default::default() },
            scan_seq: scan.header.seq,
            scan_sent: scan.header.sent,
            map_from_base: last.map_from_odom * self.odom_from_base,
            ..last
        }
    }

    fn end(self) {
        self.tell(News::End(Box::new(self.front.state())));
    }
}
