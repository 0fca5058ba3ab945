//! The operator's page: HTTP and the Foxglove WebSocket protocol on one port, around the same [`crate::Bridge`].
//!
//! ```text
//!   browser ◀─ HTTP: the page ──────────── server ── files given by the caller
//!   browser ◀─ WebSocket: Foxglove ─ encoder ◀─ ros_tcp frames ── the client's queue in the router
//!   browser ── WebSocket: Foxglove ─▶ session ── ros_tcp frames ─▶ Bridge::receive
//! ```
//! To the bridge, a page is a client like one on TCP: permissions, leases, limits and queues are the same. Payloads are
//! the same bytes; only what surrounds them is written anew, without a copy of maps.

mod encoder;
mod http;
mod listeners;
mod origin;
mod protocol;
mod room;
mod server;
mod session;
mod socket;
mod stream;
mod tls;
mod tlx;

pub use http::PageFile;
pub use listeners::PageListeners;
pub use room::{ROOM_BYTES_MAX, SaveRoom};
pub use server::serve_page;
pub use tls::{TlsError, tls_acceptor};
pub use tlx::{SaveTlx, TlxAnswer, TlxError};
pub use tokio_rustls::TlsAcceptor;

/// What the server has beside the bridge.
#[derive(Clone)]
pub struct PageContent {
    /// Files of the page.
    pub files: &'static [PageFile],
    /// Saves the rooms that browsers offer; without it they are refused.
    pub save_room: Option<SaveRoom>,
    /// Saves the answers to the form of workload; without it they are refused.
    pub save_tlx: Option<SaveTlx>,
    /// Identity of the fleet's run, by which a page knows that another run has begun.
    pub run_id: String,
}
