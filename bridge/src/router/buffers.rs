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

/// Sizes from a clock message to a map of 4096 x 4096 cells: 43 MB in all, most of it for two such maps.
const SIZE_CLASSES: [SizeClass; 5] = [
    SizeClass { capacity: 256, kept_max: 1024 },
    SizeClass { capacity: 4 << 10, kept_max: 256 },
    SizeClass { capacity: 64 << 10, kept_max: 64 },
    SizeClass { capacity: 1 << 20, kept_max: 4 },
    SizeClass { capacity: 17 << 20, kept_max: 2 },
];
/// A buffer that has grown beyond this is given back to the system, bytes.
const KEPT_CAPACITY_MAX: usize = 2 * SIZE_CLASSES[SIZE_CLASSES.len() - 1].capacity;

/// Free frame buffers, by size.
#[derive(Debug, Default)]
pub struct BufferPool {
    free: [Vec<SharedFrame>; SIZE_CLASSES.len()],
}

impl BufferPool {
    /// Returns an empty buffer without other holders, with room for `size` bytes.
    pub fn acquire(&mut self, size: usize) -> SharedFrame {
        match SIZE_CLASSES.iter().position(|class| size <= class.capacity) {
            Some(class) => {
                let fresh = || Rc::new(Vec::with_capacity(SIZE_CLASSES[class].capacity));
                self.free[class].pop().unwrap_or_else(fresh)
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
            self.free[class].push(frame);
        }
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
}
