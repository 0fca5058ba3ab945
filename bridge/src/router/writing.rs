//! Writes the clients' waiting frames to their sockets.

use super::{Client, ClientId, ConnectionEnded, FlushOutcome, TopicRouter, mark_unflushed};
use msg::Monotonic;
use std::io::{IoSlice, Write};

impl TopicRouter {
    /// Returns the time of the clients' sockets: read once for all of them.
    pub(super) fn time(&self) -> Monotonic {
        self.clients().find_map(Client::socket_time).unwrap_or_default()
    }

    /// Lets the next flush try the frames that were held back.
    pub fn retry_held(&mut self) {
        for client in self.clients.iter_mut().flatten().filter(|client| client.outgoing.has_frames()) {
            mark_unflushed(&mut self.unflushed, client);
        }
    }

    /// Writes waiting frames to the sockets, and wakes the tasks of clients whose frames are gathered.
    pub fn flush(&mut self) {
        if self.unflushed.is_empty() {
            return;
        }
        let now = self.time();
        while let Some(slot) = self.unflushed.pop() {
            let Some(client) = self.clients.get_mut(slot).and_then(Option::as_mut) else { continue };
            if client.needs_flush && client.gathers() {
                client.wake();
                continue;
            }
            client.needs_flush = false;
            client.flush(now, &mut self.pool);
        }
    }

    /// Returns whether frames of a client wait until its socket accepts bytes.
    pub fn is_blocked(&self, id: ClientId) -> Result<bool, ConnectionEnded> {
        let client = self.client(id).filter(|client| !client.has_failed).ok_or(ConnectionEnded)?;
        Ok(client.is_blocked)
    }

    /// Returns whether frames of a client are gathered, which its task writes soon.
    pub fn is_gathering(&self, id: ClientId) -> bool {
        self.client(id).is_some_and(|client| client.needs_flush && client.gathers())
    }

    /// Continues writing for one client whose socket accepts bytes again, or whose frames were gathered; returns whether it is
    /// blocked still.
    pub fn flush_client(&mut self, id: ClientId) -> bool {
        let now = self.time();
        let Some(client) = self.clients.get_mut(id.slot).and_then(Option::as_mut).filter(|c| c.id == id)
        else {
            return false;
        };
        (client.is_blocked, client.needs_flush) = (false, false);
        client.flush(now, &mut self.pool);
        client.is_blocked
    }

    /// Appends the waiting frames of a client without a socket to `out`, and removes them from its queue.
    pub fn take_outgoing(&mut self, id: ClientId, out: &mut Vec<u8>) -> Result<(), ConnectionEnded> {
        let client = self.clients.get_mut(id.slot).and_then(Option::as_mut).filter(|client| client.id == id);
        let client = client.filter(|client| !client.has_failed).ok_or(ConnectionEnded)?;
        let mut write = |slices: &[IoSlice<'_>]| out.write_vectored(slices);
        while client.outgoing.flush(&mut write, &mut self.pool).map_err(|_| ConnectionEnded)?
            != FlushOutcome::Complete
        {}
        Ok(())
    }
}
