//! The loop of a process that also waits for sockets: one thread, on which functions are called when their channel is
//! written, or when they are due.
//!
//! All functions share one timer. A timer of its own for each would be set again with every message.

use crate::clock::now;
use crate::shared_memory::Listener;
use msg::Monotonic;
use std::cell::{Cell, RefCell};
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::rc::Rc;
use std::time::Duration;
use tokio::sync::Notify;
use tokio::task::{JoinHandle, LocalSet, spawn_local};
use tokio::time::Instant;

/// What is called when a channel is written or it is due; returns when it is due next.
pub type Pass = Box<dyn FnMut() -> Monotonic>;

/// A future that ends a loop, with its result.
pub type LoopFuture<'a, T> = Pin<Box<dyn Future<Output = T> + 'a>>;

/// Runs a future, and the tasks that it starts, on this thread until the future ends.
///
/// # Errors
/// The system gives no descriptor to wait for sockets and timers with.
pub fn run(future: LoopFuture<'_, ()>) -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    LocalSet::new().block_on(&runtime, future);
    Ok(())
}

/// Waits until a moment; a moment in the past is now.
pub async fn sleep_until(at: Monotonic) {
    tokio::time::sleep_until(Instant::now() + Duration::from_nanos(at.since(now()))).await;
}

/// Starts tasks that call each function when its channel is written and when it is due. The first call is at once.
///
/// Call it inside [`run`]. Dropping the tasks does not end them: abort them.
///
/// # Errors
/// A channel's descriptor cannot be waited for.
pub fn start(passes: Vec<(Listener, Pass)>) -> io::Result<Vec<JoinHandle<()>>> {
    let (listeners, passes): (Vec<_>, Vec<_>) = passes.into_iter().unzip();
    let schedule = Rc::new(Schedule::new(passes));
    let mut tasks = Vec::with_capacity(listeners.len() + 1);
    for (index, listener) in listeners.into_iter().enumerate() {
        tasks.push(spawn_local(call_when_written(schedule.clone(), index, listener.into_async()?)));
    }
    tasks.push(spawn_local(call_when_due(schedule)));
    Ok(tasks)
}

/// Functions with the moments at which they are due.
struct Schedule {
    passes: Vec<RefCell<Pass>>,
    due: Vec<Cell<Monotonic>>,
    /// When the timer wakes.
    wakes_at: Cell<Monotonic>,
    /// Something is due before the timer wakes.
    is_earlier: Notify,
}

impl Schedule {
    fn new(passes: Vec<Pass>) -> Self {
        Self {
            due: passes.iter().map(|_| Cell::new(Monotonic(0))).collect(),
            passes: passes.into_iter().map(RefCell::new).collect(),
            wakes_at: Cell::new(Monotonic(0)),
            is_earlier: Notify::new(),
        }
    }

    /// Calls a function, and has the timer wake in time for its next call.
    fn call(&self, index: usize) {
        let due = (self.passes[index].borrow_mut())();
        self.due[index].set(due);
        if due < self.wakes_at.get() {
            self.is_earlier.notify_one();
        }
    }

    /// Calls the functions that are due, and returns when the next one is.
    fn call_due(&self, now: Monotonic) -> Monotonic {
        for index in 0..self.passes.len() {
            if self.due[index].get() <= now {
                self.call(index);
            }
        }
        self.due.iter().map(Cell::get).min().unwrap_or(Monotonic(u64::MAX))
    }
}

async fn call_when_due(schedule: Rc<Schedule>) {
    loop {
        let next = schedule.call_due(now());
        schedule.wakes_at.set(next);
        tokio::select! {
            () = sleep_until(next), if next.0 < u64::MAX => {}
            () = schedule.is_earlier.notified() => {}
        }
    }
}

async fn call_when_written(
    schedule: Rc<Schedule>,
    index: usize,
    listener: tokio::io::unix::AsyncFd<Listener>,
) {
    // It fails when the runtime ends.
    while let Ok(mut ready) = listener.readable().await {
        listener.get_ref().drain();
        ready.clear_ready();
        schedule.call(index);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A function that counts its calls, and is due again when `due` says.
    fn counted(calls: &Rc<Cell<u32>>, due: &Rc<Cell<Monotonic>>) -> Pass {
        let (calls, due) = (calls.clone(), due.clone());
        Box::new(move || {
            calls.set(calls.get() + 1);
            due.get()
        })
    }

    #[test]
    fn functions_are_called_when_they_are_due_and_only_then() {
        let never = Monotonic(u64::MAX);
        let [first, second] = [(); 2].map(|()| (Rc::new(Cell::new(0)), Rc::new(Cell::new(never))));
        second.1.set(Monotonic(100));
        let schedule = Schedule::new(vec![counted(&first.0, &first.1), counted(&second.0, &second.1)]);
        assert_eq!(schedule.call_due(Monotonic(10)), Monotonic(100), "both are due at the start");
        assert_eq!((first.0.get(), second.0.get()), (1, 1));
        assert_eq!(schedule.call_due(Monotonic(99)), Monotonic(100));
        assert_eq!((first.0.get(), second.0.get()), (1, 1));
        second.1.set(never);
        assert_eq!(schedule.call_due(Monotonic(100)), never);
        assert_eq!((first.0.get(), second.0.get()), (1, 2));
    }

    #[test]
    fn a_call_that_makes_a_function_due_earlier_wakes_the_timer() {
        let (calls, due) = (Rc::new(Cell::new(0)), Rc::new(Cell::new(Monotonic(500))));
        let schedule = Schedule::new(vec![counted(&calls, &due)]);
        schedule.wakes_at.set(schedule.call_due(Monotonic(0)));
        schedule.call(0);
        let wakes = || {
            let mut notified = std::pin::pin!(schedule.is_earlier.notified());
            notified.as_mut().enable()
        };
        assert!(!wakes(), "no earlier than the timer");
        due.set(Monotonic(200));
        schedule.call(0);
        assert!(wakes());
    }

    #[test]
    fn the_loop_calls_a_function_again_and_again_until_its_future_ends() {
        let (calls, done) = (Rc::new(Cell::new(0)), Rc::new(Notify::new()));
        let (count, tell) = (calls.clone(), done.clone());
        let pass: Pass = Box::new(move || {
            count.set(count.get() + 1);
            if count.get() == 3 {
                tell.notify_one();
            }
            now() + Duration::from_millis(1)
        });
        run(Box::pin(async move {
            let timer = spawn_local(call_when_due(Rc::new(Schedule::new(vec![pass]))));
            done.notified().await;
            timer.abort();
        }))
        .unwrap();
        assert!(calls.get() >= 3);
    }
}
