//! The work beside the scans: loops, graph, map, requests, and what is kept of them.

use super::files::{Done, Job, Loaded, Work};
use super::services::{Services, Waiting};
use super::{News, Order};
use crate::ports::ChannelError;
use crate::process::map_out::MapOut;
use crate::process::submaps_out::SubmapsOut;
use crate::run::Run;
use crate::sessions;
use ::slam::{Back, Front, FrontState, Hint, Identity, Session};
use msg::{RobotId, Role, SlamMode, SlamRequest};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::{Duration, Instant};

/// How often requests are looked for, at least.
const REQUEST_PERIOD: Duration = Duration::from_millis(100);
/// How sure it is where a robot is whose SLAM goes on where another left off: metres, radians.
const CARRIED_SIGMA: [f64; 2] = [0.1, 0.05];
/// Saving takes this part of the time at most: a large map is saved less often.
const SAVING_SHARE_MAX: u32 = 20;

/// Works until the scan path has ended.
pub fn run(
    run: &Run,
    robot: RobotId,
    back: Back,
    inbox: Receiver<News>,
    orders: SyncSender<Order>,
    jobs: SyncSender<Job>,
) -> Result<(), ChannelError> {
    // A presence of its own: shared memory's ports stay on the thread that made them.
    let presence = run.attach_thread(Role::Slam, Some(robot), "map")?;
    let mut map = MapOut::open(&presence, robot)?;
    let mut submaps = SubmapsOut::open(&presence, robot, &run.config.slam)?;
    let mut services = Services::open(&presence, run, robot)?;
    let mut beside = Beside {
        identity: sessions::identity(run, robot),
        autosave: Autosave::new(run, robot),
        back,
        orders,
        jobs,
        replaced: 0,
        anew: false,
        drawing: true,
        waiting: Vec::new(),
    };
    loop {
        let patience = map.patience().min(submaps.patience()).min(REQUEST_PERIOD);
        match inbox.recv_timeout(patience) {
            Ok(News::End(state)) => {
                beside.end(*state);
                return Ok(());
            }
            Ok(news) => beside.hear(news, &mut services),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        }
        services.serve(&mut beside);
        beside.keep();
        if std::mem::take(&mut beside.anew) {
            submaps.begin_again();
        }
        if std::mem::take(&mut beside.drawing) {
            map.news();
            submaps.news(&beside.back);
        }
        map.tend(&mut beside.back);
        submaps.tend(&beside.back);
    }
}

/// The back end, and what goes on around it.
pub struct Beside {
    pub back: Back,
    pub identity: Identity,
    orders: SyncSender<Order>,
    jobs: SyncSender<Job>,
    autosave: Autosave,
    /// How often the scan path was told to be another and has not said so yet: until then, what it says is of
    /// one before.
    replaced: u32,
    /// The back end is another.
    anew: bool,
    /// There is something new to draw.
    drawing: bool,
    /// What is to be done when it is known where the scan path is.
    waiting: Vec<Waiting>,
}

impl Beside {
    fn hear(&mut self, news: News, services: &mut Services) {
        match news {
            News::Node(_) | News::Began(_) | News::State(_) if self.replaced > 0 => {}
            News::Node(node) => {
                let was_found = self.back.map_from_base().is_some();
                let revision = self.back.add(node);
                // The scan path takes orders at each scan, and has room for one for each node that waits.
                let _ = self.orders.try_send(Order::Revise(revision));
                if self.back.mode() != SlamMode::Localization {
                    self.changed();
                }
                // That it was found is worth keeping, even where the map stays as it is.
                self.autosave.changed |= !was_found && self.back.map_from_base().is_some();
            }
            News::Began(map_from_local) => {
                let [sigma_m, sigma_rad] = CARRIED_SIGMA;
                self.back.seek(Some(Hint { map_from_local, sigma_m, sigma_rad }));
            }
            News::State(state) => {
                for waiting in std::mem::take(&mut self.waiting) {
                    services.go_on(self, waiting, &state);
                }
            }
            News::Old(front) => {
                drop(front);
                self.replaced = self.replaced.saturating_sub(1);
                if self.replaced == 0 && !self.waiting.is_empty() {
                    self.order(Order::Tell);
                }
            }
            News::Done(done) if done.request.is_some() => services.done(self, *done),
            News::Done(done) => self.autosave.done(&done),
            // The loop's.
            News::End(_) => {}
        }
    }

    /// The scan path takes orders at every scan, and at least once a second.
    pub fn order(&self, order: Order) {
        let _ = self.orders.send(order);
    }

    /// The map is no longer as it was.
    pub fn changed(&mut self) {
        self.drawing = true;
        self.autosave.changed = true;
    }

    /// Goes on with another map.
    pub fn begin(&mut self, front: Front, back: Back, in_place: bool) {
        // Its scans may be of another time; who reads maps wants them in order.
        let before = self.back.tiles().header;
        self.back = back;
        self.back.date_map(before.header, before.scan_sent);
        (self.replaced, self.anew) = (self.replaced + 1, true);
        self.changed();
        self.order(Order::Begin { front: Box::new(front), in_place });
    }

    /// Goes on with what was loaded.
    pub fn load(&mut self, loaded: Loaded) {
        self.begin(loaded.front, loaded.back, false);
    }

    /// How much waits for the scan path.
    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Does it when it is known where the scan path is.
    pub fn wait_for_state(&mut self, waiting: Waiting) {
        self.waiting.push(waiting);
        if self.replaced == 0 {
            self.order(Order::Tell);
        }
    }

    /// Gives a file something to do; false if there is too much to do already.
    pub fn give(&self, request: Option<&SlamRequest>, path: PathBuf, work: Work) -> bool {
        let request = request.map(|request| Box::new(*request));
        self.jobs.try_send(Job { request, path, work }).is_ok()
    }

    /// All that must be kept, with the scan path at `state`.
    pub fn session(&self, state: &FrontState) -> Session {
        self.back.session(self.identity, Some(state.clone()), &[])
    }

    /// Saves what has changed, if it is time.
    fn keep(&mut self) {
        if self.autosave.is_due() && !self.back.nodes().is_empty() {
            self.autosave.begins();
            self.wait_for_state(Waiting::Autosave);
        }
    }

    /// Saves in the background.
    pub fn autosave(&mut self, state: &FrontState) {
        let session = Box::new(self.session(state));
        if !self.give(None, self.autosave.path.clone(), Work::Save(session)) {
            self.autosave.put_off();
        }
    }

    /// The last word.
    fn end(&mut self, state: FrontState) {
        if self.autosave.wanted() && self.replaced == 0 && !self.back.nodes().is_empty() {
            let work = Work::Save(Box::new(self.session(&state)));
            // After what is being saved now, or the older would take the newer one's place.
            let _ = self.jobs.send(Job { request: None, path: self.autosave.path.clone(), work });
        }
    }
}

/// When SLAM saves its session by itself.
struct Autosave {
    path: PathBuf,
    /// None: never.
    every: Option<Duration>,
    due: Instant,
    /// The map is no longer the one that was saved.
    changed: bool,
    busy: bool,
    /// What was said last: it is not said again.
    said: Option<String>,
}

impl Autosave {
    fn new(run: &Run, robot: RobotId) -> Self {
        let seconds = run.config.sessions.autosave_s;
        let every = (seconds > 0.0).then(|| Duration::from_secs_f64(seconds));
        // The robots' turns are spread, so that a fleet does not save all at once.
        let first = every.unwrap_or_default() * robot.number() as u32 / run.config.fleet.robots as u32;
        Self {
            path: sessions::file(&sessions::folder(run), robot),
            every,
            due: Instant::now() + first,
            changed: false,
            busy: false,
            said: None,
        }
    }

    fn wanted(&self) -> bool {
        self.changed && self.every.is_some()
    }

    fn is_due(&self) -> bool {
        self.wanted() && !self.busy && Instant::now() >= self.due
    }

    fn begins(&mut self) {
        (self.busy, self.changed) = (true, false);
    }

    /// There was no room for it.
    fn put_off(&mut self) {
        (self.busy, self.changed) = (false, true);
        self.due = Instant::now() + self.every.unwrap_or_default();
    }

    fn done(&mut self, done: &Done) {
        self.busy = false;
        self.due = Instant::now() + self.every.unwrap_or_default().max(done.took * SAVING_SHARE_MAX);
        let why = done.result.as_ref().err();
        if let Some(why) = why.filter(|why| self.said.as_ref() != Some(why)) {
            eprintln!("slam: not saved: {why}; tried again later");
        }
        self.changed |= why.is_some();
        self.said = why.cloned();
    }
}
