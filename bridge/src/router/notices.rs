//! Text for the person at a client: refusals with their reason, warnings, and news.

use super::{ClientId, FrameKind, RefusalKind, TopicId, TopicRouter};
use crate::command::{Notice, name};
use crate::frame::Side;
use msg::Monotonic;

impl TopicRouter {
    /// Counts a refusal and sends the client its reason.
    pub fn refuse(&mut self, id: ClientId, text: String) {
        self.counted.refused += 1;
        self.send_notice(id, name::ERROR, text);
    }

    /// Counts the refusal of a data frame and sends the client its reason, the same one once a second.
    pub fn refuse_data(
        &mut self,
        id: ClientId,
        kind: RefusalKind,
        topic: Option<TopicId>,
        now: Monotonic,
        text: impl FnOnce() -> String,
    ) {
        self.counted.refused += 1;
        if self.client_mut(id).is_some_and(|client| client.should_report(kind, topic, now)) {
            self.send_notice(id, name::ERROR, text());
        }
    }

    /// Sends a client text for a person: [`name::LOG`], [`name::WARN`] or [`name::ERROR`].
    pub fn send_notice(&mut self, id: ClientId, kind: &str, text: String) {
        let notice = Notice { text };
        self.send_frames(id, FrameKind::Notice, |out| Side::Server.write_command(out, kind, &notice));
    }
}
