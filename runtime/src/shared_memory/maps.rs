//! Maps in shared memory: messages with the tiles that changed, and an event back to the writer with
//! which a reader requests the whole map. [`msg::tiles`] defines the messages; this file transports them.

use super::{BORROWED_MAX, Listener, PARTICIPANTS_MAX, Participant, Shared, failed, service_name};
use crate::channel::{Channel, Direction, MAP_MESSAGES_MAX};
use crate::clock::now;
use crate::held_signals::HeldSignals;
use crate::ports::{
    ChannelError, MAP_REQUEST_PERIOD, MessageSequencer, ReadMapPort, ReceiveCounts, WriteMapPort,
};
use bytemuck::TransparentWrapper;
use iceoryx2::port::listener::ListenerCreateError;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::event;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use msg::tiles::{PATCH_TILES_MAX, Patch, PatchReceiver, PatchSender};
use msg::{MapTile, Message, Monotonic, PatchHeader, TileMap};

/// Tiles of a message for which memory is reserved at first: as many as a scan of 10 m touches.
const TILES_START: usize = 16;

impl Participant {
    /// Opens a map's channel to write.
    pub fn map_writer(&self, channel: &Channel<PatchHeader>) -> Result<MapWriter, ChannelError> {
        channel.check(self.opener, Direction::Write)?;
        let _held = HeldSignals::hold();
        let service = self.map_service(channel)?;
        let open = || {
            let publisher =
                service.publisher_builder().max_loaned_samples(1).initial_max_slice_len(TILES_START);
            let publisher = publisher.allocation_strategy(AllocationStrategy::PowerOfTwo);
            publisher.backpressure_strategy(BackpressureStrategy::DiscardData).create()
        };
        let is_full = |why: &_| matches!(why, PublisherCreateError::ExceedsMaxSupportedPublishers);
        let publisher = self.domain.open_writer(is_full, open);
        let publisher = publisher.map_err(failed("cannot write channel", &channel.name))?;
        let ask_event = self.ask_event(channel)?;
        let is_full = |why: &_| matches!(why, ListenerCreateError::ExceedsMaxSupportedListeners);
        let listener = self.domain.open_writer(is_full, || ask_event.listener_builder().create());
        let requests = Listener::new(listener.map_err(failed("cannot be asked on", &channel.name))?);
        let (stamper, notifier) = (MessageSequencer::new(self.run), self.notifier(channel)?);
        Ok(MapWriter { publisher, stamper, notifier, requests, outgoing: PatchSender::default(), bytes: 0 })
    }

    /// Opens a map's channel to read.
    pub fn map_reader(&self, channel: &Channel<PatchHeader>) -> Result<MapReader, ChannelError> {
        channel.check(self.opener, Direction::Read)?;
        let _held = HeldSignals::hold();
        let subscriber = self
            .map_service(channel)?
            .subscriber_builder()
            .buffer_size(channel.row.depth)
            .create()
            .map_err(failed("cannot read channel", &channel.name))?;
        let ask = self.ask_event(channel)?.notifier_builder().create();
        let ask = ask.map_err(failed("cannot ask on", &channel.name))?;
        let (receive_counts, incoming) = (ReceiveCounts::default(), PatchReceiver::default());
        Ok(MapReader { subscriber, ask, asked: Monotonic(0), receive_counts, incoming })
    }

    fn map_service(&self, channel: &Channel<PatchHeader>) -> Result<MapService, ChannelError> {
        self.node
            .service_builder(&service_name(&channel.name)?)
            .publish_subscribe::<[Shared<MapTile>]>()
            .user_header::<Shared<PatchHeader>>()
            .max_publishers(1)
            .max_subscribers(channel.row.readers_max)
            .max_nodes(PARTICIPANTS_MAX)
            .history_size(channel.row.history)
            .subscriber_max_buffer_size(channel.row.depth)
            .subscriber_max_borrowed_samples(BORROWED_MAX)
            .open_or_create()
            .map_err(failed("cannot open channel", &channel.name))
    }

    /// Readers notify, the writer listens.
    fn ask_event(
        &self,
        channel: &Channel<PatchHeader>,
    ) -> Result<event::PortFactory<ipc::Service>, ChannelError> {
        self.node
            .service_builder(&service_name(&format!("{}/ask", channel.name))?)
            .event()
            .max_listeners(1)
            .max_notifiers(channel.row.readers_max)
            .max_nodes(PARTICIPANTS_MAX)
            .open_or_create()
            .map_err(failed("cannot open the event to the writer of", &channel.name))
    }
}

type MapService = PortFactory<ipc::Service, [Shared<MapTile>], Shared<PatchHeader>>;

/// Writes one map's channel.
pub struct MapWriter {
    publisher: Publisher<ipc::Service, [Shared<MapTile>], Shared<PatchHeader>>,
    stamper: MessageSequencer,
    notifier: Option<Notifier<ipc::Service>>,
    requests: Listener,
    outgoing: PatchSender,
    bytes: u64,
}

impl WriteMapPort for MapWriter {
    type Listener = Listener;

    fn send(&mut self, map: &TileMap) -> bool {
        let _ = self.publisher.update_connections();
        if self.requests.take() {
            self.outgoing.request_snapshot();
        }
        let mut sent = 0;
        while sent < MAP_MESSAGES_MAX
            && let Some(patch) = self.outgoing.next_patch(map)
        {
            if !self.send_one(&patch) {
                self.outgoing.restart();
                break;
            }
            sent += 1;
        }
        if let Some(notifier) = self.notifier.as_ref().filter(|_| sent > 0) {
            let _ = notifier.notify();
        }
        !self.outgoing.has_pending(map)
    }

    fn requests(&self) -> &Listener {
        &self.requests
    }

    fn bytes(&self) -> u64 {
        self.bytes
    }
}

impl MapWriter {
    fn send_one(&mut self, patch: &Patch) -> bool {
        debug_assert!(patch.tiles.len() <= PATCH_TILES_MAX);
        let mut header = patch.header;
        self.stamper.mark(header.header_mut(), now());
        let Ok(mut sample) = self.publisher.loan_slice_uninit(patch.tiles.len()) else { return false };
        sample.user_header_mut().0 = header;
        self.bytes += (size_of::<PatchHeader>() + size_of_val(sample.payload())) as u64;
        sample.write_from_fn(|index| Shared(*patch.tiles[index])).send().is_ok()
    }
}

/// Reads one map's channel and keeps the map.
pub struct MapReader {
    subscriber: Subscriber<ipc::Service, [Shared<MapTile>], Shared<PatchHeader>>,
    ask: Notifier<ipc::Service>,
    asked: Monotonic,
    receive_counts: ReceiveCounts,
    incoming: PatchReceiver,
}

impl ReadMapPort for MapReader {
    fn poll(&mut self) -> bool {
        let mut new = false;
        while let Ok(Some(sample)) = self.subscriber.receive() {
            let header = &sample.user_header().0;
            self.receive_counts.count(header.header());
            new |= self.incoming.receive(header, Shared::peel_slice(sample.payload()));
        }
        if self.incoming.needs_snapshot() && now().since(self.asked) >= MAP_REQUEST_PERIOD.as_nanos() as u64 {
            self.asked = now();
            let _ = self.ask.notify();
        }
        new
    }

    fn map(&self) -> &TileMap {
        self.incoming.map()
    }

    fn receive_counts(&self) -> ReceiveCounts {
        self.receive_counts
    }
}
