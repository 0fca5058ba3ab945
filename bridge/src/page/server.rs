//! The page's server: one task for each connection, on the thread of the bridge.

use super::PageContent;
use super::encoder::Encoder;
use super::http::{HEAD_BYTES_MAX, PageFile, Request, file_response, parse_request, text_response};
use super::protocol::{ENCODING, Metadata, ServerCommand, selfcheck_text};
use super::room::RoomReceiver;
use super::session::{ClientData, OwnedFrame, Session};
use super::socket::{MessageReader, PageSocket};
use super::stream::{flush, respond, send_last_words};
use super::tls::serve_encrypted;
use super::tlx::{self, SaveTlx};
use crate::bridge::Bridge;
use crate::config::PageConfig;
use crate::connection::{Stream, accept_connections, close_gently};
use crate::frame::RosTcpFrame;
use crate::router::ClientId;
use msg::Monotonic;
use std::cell::RefCell;
use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::rc::Rc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::io::Interest;
use tokio::net::TcpListener;
use tokio::sync::Notify;
use tokio::task::yield_now;
use tokio::time::{Instant, sleep_until, timeout};
use tokio_rustls::TlsAcceptor;
use tungstenite::Message;

/// Connections that are no clients yet or never will be, beside the clients; more are dropped.
const REQUESTS_MAX: usize = 32;
/// A request must be complete after this time.
pub(super) const REQUEST_TIMEOUT: Duration = Duration::from_secs(5);
/// Period at which a client is pinged, and told of new topics and the fleet's state. Its answers show that it lives, as keepalives do on TCP.
const UPKEEP_PERIOD: Duration = Duration::from_millis(500);
/// Time for which messages are gathered before they are written: those of all robots that scan at one moment.
const GATHER_PERIOD: Duration = Duration::from_millis(2);
/// Bytes read at a time.
const READ_BYTES: usize = 16 << 10;
/// Bytes of a request read at a time.
const HEAD_READ_BYTES: usize = 4096;
/// Messages of one client that are handled before other clients get their turn.
const MESSAGES_PER_TURN: usize = 64;
/// What the server can do beside subscriptions, in the protocol's words.
const CAPABILITIES: [&str; 4] = ["clientPublish", "parameters", "parametersSubscribe", "services"];
/// Name of the server for people.
const SERVER_NAME: &str = "MR-SLAM";

/// Topic of texts that say what a device can do, as `/selfcheck` finds out; they go to the operator's log alone.
const SELFCHECK_TOPIC: &str = "/mr_slam/selfcheck";
/// Texts of one connection that are logged: a log is no place to fill a disk from.
const SELFCHECKS_MAX: u32 = 4;

/// What all connections share.
pub(super) struct Shared {
    bridge: Rc<Bridge>,
    files: &'static [PageFile],
    rooms: RoomReceiver,
    save_tlx: Option<SaveTlx>,
    origins: Vec<String>,
    clock: fn() -> Monotonic,
    session_id: String,
    run_id: String,
}

impl Shared {
    /// Returns the first message to each client.
    fn greeting(&self) -> ServerCommand<'_> {
        ServerCommand::ServerInfo {
            name: SERVER_NAME,
            capabilities: &CAPABILITIES,
            supported_encodings: &[ENCODING],
            session_id: &self.session_id,
            metadata: Metadata { run: &self.run_id },
        }
    }
}

/// Serves the page and its WebSockets until `stop` is ready: encrypted with a TLS acceptor, otherwise in clear.
///
/// Runs inside a [`tokio::task::LocalSet`] beside [`crate::serve_clients`]. The caller calls [`Bridge::tick`].
pub async fn serve_page(
    bridge: Rc<Bridge>,
    listener: TcpListener,
    encryption: Option<TlsAcceptor>,
    config: &PageConfig,
    content: PageContent,
    clock: fn() -> Monotonic,
    stop: impl Future<Output = ()>,
) {
    let (origins, session_id) = (config.origins.clone(), session_id());
    let PageContent { files, save_room, save_tlx, run_id } = content;
    let rooms = RoomReceiver::new(save_room);
    let shared = Rc::new(Shared {
        bridge: bridge.clone(),
        files,
        rooms,
        save_tlx,
        origins,
        clock,
        session_id,
        run_id,
    });
    let serve = |stream, peer| {
        let (shared, encryption) = (shared.clone(), encryption.clone());
        async move {
            match encryption {
                Some(acceptor) => serve_encrypted(shared, stream, peer, acceptor).await,
                None => serve_connection(shared, stream, peer).await,
            }
        }
    };
    accept_connections(&bridge, listener, REQUESTS_MAX, stop, serve).await;
}

/// Returns a text that is another one after each start.
fn session_id() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    format!("{}-{}", std::process::id(), since.as_nanos())
}

/// Answers the connection's one request.
pub(super) async fn serve_connection<S: Stream>(shared: Rc<Shared>, stream: S, peer: SocketAddr) {
    let Ok(local) = stream.tcp().local_addr() else { return };
    let mut received = Vec::new();
    let read = timeout(REQUEST_TIMEOUT, read_request(&stream, &mut received, local, &shared.origins)).await;
    let Ok(Ok(request)) = read else { return };
    let (head, body) = match request {
        Ok((Request::WebSocket { response }, length)) => {
            let first_bytes = received.split_off(length);
            return serve_web_socket(&shared, stream, peer, response, &first_bytes).await;
        }
        Ok((Request::Room { length }, head)) => {
            let first = received.split_off(head);
            let Shared { bridge, rooms, .. } = &*shared;
            (rooms.receive(bridge, &stream, peer.ip(), first, length).await, [].as_slice())
        }
        Ok((Request::Tlx { length }, head)) => {
            let first = received.split_off(head);
            let save = (&*shared.bridge, shared.save_tlx.as_ref());
            (tlx::receive(save, &stream, peer.ip(), first, length).await, [].as_slice())
        }
        Ok((Request::File { path, with_body }, _)) => file_response(shared.files, &path, with_body),
        Err(error) => (error.response(), [].as_slice()),
    };
    respond(&stream, &head, body).await;
}

/// A request and its length, or why it is refused.
type RequestResult = Result<(Request, usize), super::http::RequestError>;

async fn read_request(
    stream: &impl Stream,
    received: &mut Vec<u8>,
    local: SocketAddr,
    origins: &[String],
) -> io::Result<RequestResult> {
    loop {
        match parse_request(received, local.ip(), origins) {
            Ok(Some(request)) => return Ok(Ok(request)),
            Ok(None) => {}
            Err(error) => return Ok(Err(error)),
        }
        stream.ready(Interest::READABLE).await?;
        let mut buffer = [0; HEAD_READ_BYTES];
        let space = buffer.len().min(HEAD_BYTES_MAX - received.len());
        match stream.try_read(&mut buffer[..space]) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => received.extend_from_slice(&buffer[..count]),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) => return Err(error),
        }
    }
}

/// One browser: its connection, and its state.
struct Connection<'a, S> {
    shared: &'a Shared,
    id: ClientId,
    stream: &'a S,
    encoder: &'a RefCell<Encoder>,
    session: Session,
    reader: MessageReader,
    peer: SocketAddr,
    /// Texts for the operator's log that it has sent.
    selfchecks: u32,
    /// Whether the browser has closed the connection; the answer is a reply of the reader.
    has_closed: bool,
}

impl<S> Drop for Connection<'_, S> {
    /// Disconnects the client however its task ends.
    fn drop(&mut self) {
        self.shared.bridge.disconnect(self.id);
    }
}

async fn serve_web_socket(
    shared: &Shared,
    stream: impl Stream,
    peer: SocketAddr,
    response: Vec<u8>,
    first_bytes: &[u8],
) {
    let (stream, wake) = (Rc::new(stream), Rc::new(Notify::new()));
    let encoder = Rc::new(RefCell::new(Encoder::new(response)));
    let socket = PageSocket {
        stream: stream.clone(),
        wake: wake.clone(),
        clock: shared.clock,
        encoder: encoder.clone(),
    };
    if encoder.borrow_mut().send(&shared.greeting()).is_err() {
        return;
    }
    let id = match shared.bridge.connect_socket(peer, Box::new(socket)) {
        Ok(id) => id,
        Err(error) => {
            let refusal = text_response("503 Service Unavailable", &error.to_string());
            return respond(&*stream, &refusal, &[]).await;
        }
    };
    let (session, reader) = (Session::default(), MessageReader::new());
    let mut connection = Connection {
        shared,
        id,
        stream: &*stream,
        encoder: &encoder,
        session,
        reader,
        peer,
        selfchecks: 0,
        has_closed: false,
    };
    // However it ends, the client is told what is left to say.
    let _ = connection.run(&wake, first_bytes).await;
    let has_closed = connection.has_closed;
    drop(connection);
    let unsent = shared.bridge.take_unsent(id);
    let last_words = send_last_words(unsent.filter(|_| !has_closed), &encoder, &*stream, has_closed);
    if let Ok(Ok(())) = timeout(REQUEST_TIMEOUT, last_words).await {
        close_gently(&*stream).await;
    }
}

impl<S: Stream> Connection<'_, S> {
    /// Reads and writes until the connection ends.
    async fn run(&mut self, wake: &Notify, first_bytes: &[u8]) -> io::Result<()> {
        let (bridge, stream) = (&self.shared.bridge, self.stream);
        self.upkeep()?;
        self.receive(first_bytes).await?;
        let mut upkeep_due = Instant::now() + UPKEEP_PERIOD;
        let mut write_due = None;
        while let Ok(is_blocked) = bridge.is_blocked(self.id)
            && !self.has_closed
        {
            if bridge.is_gathering(self.id) {
                write_due.get_or_insert_with(|| Instant::now() + GATHER_PERIOD);
            }
            let must_write = is_blocked || self.encoder.borrow().has_waiting();
            let interest =
                if must_write { Interest::READABLE | Interest::WRITABLE } else { Interest::READABLE };
            let ready = tokio::select! {
                biased;
                () = sleep_until(write_due.unwrap_or(upkeep_due)), if write_due.is_some() => {
                    write_due = None;
                    bridge.flush_client(self.id);
                    continue;
                }
                ready = stream.ready(interest) => ready?,
                () = wake.notified() => continue,
                () = sleep_until(upkeep_due) => {
                    upkeep_due = Instant::now() + UPKEEP_PERIOD;
                    self.upkeep()?;
                    continue;
                }
            };
            if ready.is_readable() || ready.is_read_closed() {
                let mut buffer = [0; READ_BYTES];
                match stream.try_read(&mut buffer) {
                    Ok(0) => break,
                    Ok(count) => self.receive(&buffer[..count]).await?,
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                    Err(error) => return Err(error),
                }
            }
            if ready.is_writable() {
                flush(self.encoder, stream)?;
                if is_blocked && bridge.flush_client(self.id) {
                    yield_now().await;
                }
            }
        }
        Ok(())
    }

    /// Pings the client, tells it of topics and services that have come and gone, and of the fleet's state.
    fn upkeep(&mut self) -> io::Result<()> {
        let bridge = &self.shared.bridge;
        let topics = bridge.topics();
        self.session.update_channels(&topics, &mut self.encoder.borrow_mut())?;
        self.session.update_services(&bridge.services(), &mut self.encoder.borrow_mut())?;
        let status = || bridge.fleet_status(self.id, (self.shared.clock)());
        self.session.update_status(status, &mut self.encoder.borrow_mut())?;
        self.reader.ping().map_err(io::Error::other)?;
        self.send_replies()
    }

    fn send_replies(&mut self) -> io::Result<()> {
        let replies = self.reader.take_replies();
        self.encoder.borrow_mut().send_frames(&replies)?;
        flush(self.encoder, self.stream)
    }

    /// Handles bytes from the client.
    async fn receive(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.reader.push(bytes);
        let mut messages = 0;
        loop {
            match self.reader.next_message() {
                Ok(Some(message)) => self.handle(message)?,
                Ok(None) => break,
                Err(error) => {
                    self.send_replies()?;
                    return Err(io::Error::other(error));
                }
            }
            messages += 1;
            if messages % MESSAGES_PER_TURN == 0 {
                self.shared.bridge.flush();
                yield_now().await;
            }
        }
        self.shared.bridge.flush();
        self.send_replies()
    }

    fn handle(&mut self, message: Message) -> io::Result<()> {
        let (bridge, now) = (&self.shared.bridge, (self.shared.clock)());
        match message {
            Message::Text(text) => {
                let frames = self.session.receive_text(&text, &mut self.encoder.borrow_mut())?;
                for frame in frames {
                    let frame = RosTcpFrame { name: frame.name.as_bytes(), payload: &frame.payload };
                    bridge.receive(self.id, frame, now);
                }
                let status = || bridge.fleet_status(self.id, now);
                let run_time_s = bridge.run_time_s();
                self.session.answer_request(status, run_time_s, now, &mut self.encoder.borrow_mut())?;
            }
            Message::Binary(bytes) => {
                let found = self.session.receive_binary(&bytes, now, &mut self.encoder.borrow_mut())?;
                match found {
                    Some(ClientData::Message { topic: SELFCHECK_TOPIC, .. })
                        if self.selfchecks >= SELFCHECKS_MAX => {}
                    Some(ClientData::Message { topic: SELFCHECK_TOPIC, payload }) => {
                        self.selfchecks += 1;
                        let text = selfcheck_text(payload);
                        bridge.report_event(format!("self-check of {}: {text}", self.peer.ip()));
                    }
                    Some(ClientData::Message { topic, payload }) => {
                        bridge.receive(self.id, RosTcpFrame { name: topic.as_bytes(), payload }, now);
                    }
                    Some(ClientData::Call { commands, service, payload }) => {
                        for OwnedFrame { name, payload } in &commands {
                            bridge.receive(self.id, RosTcpFrame { name: name.as_bytes(), payload }, now);
                        }
                        bridge.receive(self.id, RosTcpFrame { name: service.as_bytes(), payload }, now);
                    }
                    None => {}
                }
            }
            // Answers to pings: the client lives.
            Message::Ping(_) | Message::Pong(_) => {
                bridge.receive(self.id, RosTcpFrame { name: b"", payload: b"" }, now);
            }
            Message::Close(_) => self.has_closed = true,
            Message::Frame(_) => {}
        }
        Ok(())
    }
}
