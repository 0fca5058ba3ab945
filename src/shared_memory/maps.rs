//! Maps in shared memory: messages with the tiles that changed, and a bell back to the writer with
//! which a reader asks for the whole. [`msg::tiles`] has the rules, here is the transport.

use super::{BORROWED_MAX, Bell, ChannelError, Gaps, NODES_MAX, Node, Shared, Stamper, failed, service_name};
use crate::channel::Channel;
use crate::clock::now;
use bytemuck::TransparentWrapper;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::event;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use msg::tiles::{PATCH_TILES_MAX, Patch, PatchReceiver, PatchSender};
use msg::{MapTile, Message, Monotonic, PatchHeader, TileMap};
use std::rc::Rc;
use std::time::Duration;

/// Tiles that a message may have before the channel's memory grows: what a scan of 10 m touches.
const TILES_START: usize = 16;
/// A reader that waits for the whole asks again after this.
const ASK_PERIOD_NS: u64 = 500_000_000;

impl Node {
    /// The one writer of a map's channel.
    pub fn map_writer(&self, channel: &Channel<PatchHeader>) -> Result<MapWriter, ChannelError> {
        let publisher = self
            .map_service(channel)?
            .publisher_builder()
            .max_loaned_samples(1)
            .initial_max_slice_len(TILES_START)
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(failed("cannot write channel", &channel.name))?;
        let listener = self.ask_event(channel)?.listener_builder().create();
        let asks = Rc::new(Bell::new(listener.map_err(failed("cannot be asked on", &channel.name))?));
        let (stamper, bell) = (Stamper::new(self.run), self.notifier(channel)?);
        Ok(MapWriter { publisher, stamper, bell, asks, outgoing: PatchSender::default(), bytes: 0 })
    }

    /// A reader of a map's channel.
    pub fn map_reader(&self, channel: &Channel<PatchHeader>) -> Result<MapReader, ChannelError> {
        let subscriber = self
            .map_service(channel)?
            .subscriber_builder()
            .buffer_size(channel.depth)
            .create()
            .map_err(failed("cannot read channel", &channel.name))?;
        let ask = self.ask_event(channel)?.notifier_builder().create();
        let ask = ask.map_err(failed("cannot ask on", &channel.name))?;
        let (gaps, incoming) = (Gaps::default(), PatchReceiver::default());
        Ok(MapReader { subscriber, ask, asked: Monotonic(0), gaps, incoming })
    }

    fn map_service(&self, channel: &Channel<PatchHeader>) -> Result<MapService, ChannelError> {
        self.node
            .service_builder(&service_name(&channel.name)?)
            .publish_subscribe::<[Shared<MapTile>]>()
            .user_header::<Shared<PatchHeader>>()
            .max_publishers(1)
            .max_subscribers(channel.readers)
            .max_nodes(NODES_MAX)
            .history_size(channel.history)
            .subscriber_max_buffer_size(channel.depth)
            .subscriber_max_borrowed_samples(BORROWED_MAX)
            .open_or_create()
            .map_err(failed("cannot open channel", &channel.name))
    }

    /// Readers ring, the writer listens.
    fn ask_event(
        &self,
        channel: &Channel<PatchHeader>,
    ) -> Result<event::PortFactory<ipc::Service>, ChannelError> {
        self.node
            .service_builder(&service_name(&format!("{}/ask", channel.name))?)
            .event()
            .max_listeners(1)
            .max_notifiers(channel.readers)
            .max_nodes(NODES_MAX)
            .open_or_create()
            .map_err(failed("cannot open the bell to the writer of", &channel.name))
    }
}

type MapService = PortFactory<ipc::Service, [Shared<MapTile>], Shared<PatchHeader>>;

/// Writes one map's channel.
pub struct MapWriter {
    publisher: Publisher<ipc::Service, [Shared<MapTile>], Shared<PatchHeader>>,
    stamper: Stamper,
    bell: Option<Notifier<ipc::Service>>,
    asks: Rc<Bell>,
    outgoing: PatchSender,
    bytes: u64,
}

impl MapWriter {
    /// Messages that are sent at a time: with [`MapWriter::PAUSE`], 26 MB a second.
    pub const MESSAGES_MAX: usize = 4;
    /// Between two lots of messages of one version, so that readers keep up.
    pub const PAUSE: Duration = Duration::from_millis(40);

    /// Sends what readers lack of `map`, a bounded part at a time: call it again after
    /// [`MapWriter::PAUSE`] while it returns false, and now and then, as readers may ask for the whole.
    pub fn send(&mut self, map: &TileMap) -> bool {
        let _ = self.publisher.update_connections();
        if self.asks.take() {
            self.outgoing.request_snapshot();
        }
        let mut sent = 0;
        while sent < Self::MESSAGES_MAX
            && let Some(patch) = self.outgoing.next_patch(map)
        {
            if !self.send_one(&patch) {
                self.outgoing.restart();
                break;
            }
            sent += 1;
        }
        if let Some(bell) = self.bell.as_ref().filter(|_| sent > 0) {
            let _ = bell.notify();
        }
        !self.outgoing.has_pending(map)
    }

    /// Rings when a reader asks for the whole.
    pub fn asks(&self) -> Rc<Bell> {
        self.asks.clone()
    }

    /// Bytes written so far.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    fn send_one(&mut self, patch: &Patch) -> bool {
        debug_assert!(patch.tiles.len() <= PATCH_TILES_MAX);
        let mut header = patch.header;
        self.stamper.mark(header.header_mut());
        let Ok(mut sample) = self.publisher.loan_slice_uninit(patch.tiles.len()) else { return false };
        sample.user_header_mut().0 = header;
        self.bytes += (size_of::<PatchHeader>() + size_of_val(sample.payload())) as u64;
        sample.write_from_fn(|index| Shared(*patch.tiles[index])).send().is_ok()
    }
}

/// Reads one map's channel, and has the map.
pub struct MapReader {
    subscriber: Subscriber<ipc::Service, [Shared<MapTile>], Shared<PatchHeader>>,
    ask: Notifier<ipc::Service>,
    asked: Monotonic,
    gaps: Gaps,
    incoming: PatchReceiver,
}

impl MapReader {
    /// Takes in what has come. True if there is a new version of the map.
    pub fn look(&mut self) -> bool {
        let mut new = false;
        while let Ok(Some(sample)) = self.subscriber.receive() {
            let header = &sample.user_header().0;
            self.gaps.count(header.header());
            new |= self.incoming.receive(header, Shared::peel_slice(sample.payload()));
        }
        if self.incoming.needs_snapshot() && now().since(self.asked) >= ASK_PERIOD_NS {
            self.asked = now();
            let _ = self.ask.notify();
        }
        new
    }

    /// The newest complete version; without tiles before the first.
    pub fn map(&self) -> &TileMap {
        self.incoming.map()
    }

    /// What was received and missed so far, in messages.
    pub fn gaps(&self) -> Gaps {
        self.gaps
    }
}
