//! Frame buffers that are used again: in steady state a message allocates nothing.

use std::rc::Rc;

/// A whole frame as it goes onto a socket, shared by all clients it waits for.
pub type Bytes = Rc<Vec<u8>>;

/// Buffers by capacity (bytes) and how many of each size are kept at most: 43 MB in all, most of it for two maps
/// of the largest size.
const CLASSES: [(usize, usize); 5] =
    [(256, 1024), (4 << 10, 256), (64 << 10, 64), (1 << 20, 4), (17 << 20, 2)];

/// Free buffers, by size.
#[derive(Debug, Default)]
pub struct Pool {
    free: [Vec<Bytes>; CLASSES.len()],
}

impl Pool {
    /// An empty buffer that nobody else holds, with room for `size` bytes if that is not beyond all bounds.
    pub fn take(&mut self, size: usize) -> Bytes {
        match CLASSES.iter().position(|(capacity, _)| size <= *capacity) {
            Some(class) => {
                self.free[class].pop().unwrap_or_else(|| Rc::new(Vec::with_capacity(CLASSES[class].0)))
            }
            None => Rc::new(Vec::with_capacity(size)),
        }
    }

    /// Takes a buffer back if this was its last holder.
    pub fn give_back(&mut self, mut bytes: Bytes) {
        let Some(buffer) = Rc::get_mut(&mut bytes) else { return };
        let Some(class) = CLASSES.iter().rposition(|(capacity, _)| buffer.capacity() >= *capacity) else {
            return;
        };
        let oversized = buffer.capacity() > 2 * CLASSES[CLASSES.len() - 1].0;
        if self.free[class].len() < CLASSES[class].1 && !oversized {
            buffer.clear();
            self.free[class].push(bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_come_back_when_the_last_holder_lets_go() {
        let mut pool = Pool::default();
        let first = pool.take(100);
        let address = first.as_ptr();
        let second_holder = first.clone();
        pool.give_back(first);
        assert_ne!(pool.take(100).as_ptr(), address, "still held");
        pool.give_back(second_holder);
        let again = pool.take(200);
        assert_eq!(again.as_ptr(), address);
        assert!(again.is_empty() && again.capacity() >= 200);
        assert!(pool.take(100_000_000).capacity() >= 100_000_000);
    }
}
