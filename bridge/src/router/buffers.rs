//! Frame buffers that are used again, so that a message allocates nothing in steady state.

use std::rc::Rc;

/// A whole frame as it goes onto a socket, shared by all clients that it waits for.
pub type SharedFrame = Rc<Vec<u8>>;

/// One size of buffers that the pool keeps.
struct SizeClass {
    /// Capacity of a buffer, bytes.
    capacity: usize,
    /// Free buffers that are kept; more are given back to the system.
    kept_max: usize,
}

/// Sizes from a clock message to a map of 4096 x 4096 cells: 51 MB in all, most of it for two such maps.
const SIZE_CLASSES: [SizeClass; 7] = [
    SizeClass { capacity: 256, kept_max: 1024 },
    SizeClass { capacity: 4 << 10, kept_max: 256 },
    SizeClass { capacity: 64 << 10, kept_max: 32 },
    SizeClass { capacity: 256 << 10, kept_max: 8 },
    SizeClass { capacity: 1 << 20, kept_max: 4 },
    SizeClass { capacity: 4 << 20, kept_max: 2 },
    SizeClass { capacity: 17 << 20, kept_max: 2 },
];
/// A buffer that has grown beyond this is given back to the system, bytes.
const KEPT_CAPACITY_MAX: usize = 2 * SIZE_CLASSES[SIZE_CLASSES.len() - 1].capacity;

/// Free frame buffers, by size.
#[derive(Debug, Default)]
pub struct BufferPool {
    free: [Vec<SharedFrame>; SIZE_CLASSES.len()],
    /// The fewest free buffers of each size since [`BufferPool::release_unused`]: so many were not needed.
    least_free: [usize; SIZE_CLASSES.len()],
    /// Capacity of all free buffers, bytes.
    free_bytes: usize,
}

impl BufferPool {
    /// Returns an empty buffer without other holders, with room for `size` bytes.
    pub fn acquire(&mut self, size: usize) -> SharedFrame {
        match SIZE_CLASSES.iter().position(|class| size <= class.capacity) {
            Some(class) => {
                let Some(buffer) = self.free[class].pop() else {
                    self.least_free[class] = 0;
                    return Rc::new(Vec::with_capacity(SIZE_CLASSES[class].capacity));
                };
                self.least_free[class] = self.least_free[class].min(self.free[class].len());
                self.free_bytes -= buffer.capacity();
                buffer
            }
            None => Rc::new(Vec::with_capacity(size)),
        }
    }

    /// Drops one holder of a buffer, and keeps the buffer for the next frame if that was its last holder.
    pub fn recycle(&mut self, mut frame: SharedFrame) {
        let Some(buffer) = Rc::get_mut(&mut frame) else { return };
        let Some(class) = SIZE_CLASSES.iter().rposition(|class| buffer.capacity() >= class.capacity) else {
            return;
        };
        let oversized = buffer.capacity() > KEPT_CAPACITY_MAX;
        if self.free[class].len() < SIZE_CLASSES[class].kept_max && !oversized {
            buffer.clear();
            self.free_bytes += buffer.capacity();
            self.free[class].push(frame);
        }
    }

    /// Returns the capacity of all free buffers, bytes.
    pub fn free_bytes(&self) -> usize {
        self.free_bytes
    }

    /// Gives back to the system the buffers that no frame has needed since the last call.
    pub fn release_unused(&mut self) {
        for (free, least) in self.free.iter_mut().zip(&mut self.least_free) {
            let unused = (*least).min(free.len());
            self.free_bytes -= free.drain(..unused).map(|buffer| buffer.capacity()).sum::<usize>();
            *least = free.len();
        }
    }

    /// Gives all free buffers back to the system.
    pub fn release_all(&mut self) {
        self.free.iter_mut().for_each(Vec::clear);
        (self.least_free, self.free_bytes) = ([0; SIZE_CLASSES.len()], 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_buffer_is_used_again_once_its_last_holder_recycles_it() {
        let mut pool = BufferPool::default();
        let first = pool.acquire(100);
        let address = first.as_ptr();
        let second_holder = first.clone();
        pool.recycle(first);
        assert_ne!(pool.acquire(100).as_ptr(), address, "still held");
        pool.recycle(second_holder);
        let again = pool.acquire(200);
        assert_eq!(again.as_ptr(), address);
        assert!(again.is_empty() && again.capacity() >= 200);
        assert!(pool.acquire(100_000_000).capacity() >= 100_000_000);
    }

    #[test]
    fn buffers_that_nobody_needs_are_given_back_and_others_kept() {
        let mut pool = BufferPool::default();
        let burst: Vec<SharedFrame> = (0..20).map(|_| pool.acquire(50_000)).collect();
        burst.into_iter().for_each(|frame| pool.recycle(frame));
        assert_eq!(pool.free_bytes(), 20 << 16);
        pool.release_unused();
        assert_eq!(pool.free_bytes(), 20 << 16, "all were in use since the start");
        for _ in 0..3 {
            let two = [pool.acquire(50_000), pool.acquire(50_000)];
            two.into_iter().for_each(|frame| pool.recycle(frame));
            pool.release_unused();
        }
        assert_eq!(pool.free_bytes(), 2 << 16);
        pool.release_all();
        assert_eq!(pool.free_bytes(), 0);
    }
}
