//! Passes messages that are CDR already through RustDDS, without a serializer.

use ros_messages::cdr::ENCAPSULATION;
use ros2_client::dds::rustdds::RepresentationIdentifier;
use ros2_client::dds::rustdds::bytes::Bytes;
use ros2_client::dds::rustdds::no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};
use std::convert::Infallible;

/// One message as CDR with its encapsulation header. Clones share the bytes.
#[derive(Clone, Debug)]
pub struct Raw(pub Bytes);

/// Adapts [`Raw`] to RustDDS's serialization interface.
pub struct Adapter;

impl SerializerAdapter<Raw> for Adapter {
    type Error = Infallible;
    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }
    fn to_bytes(Raw(bytes): &Raw) -> Result<Bytes, Infallible> {
        // RustDDS writes the encapsulation header itself.
        Ok(bytes.slice(ENCAPSULATION.len().min(bytes.len())..))
    }
}

impl DeserializerAdapter<Raw> for Adapter {
    type Error = Infallible;
    type Decoded = Raw;
    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE]
    }
    fn transform_decoded(decoded: Raw) -> Raw {
        decoded
    }
}

impl DefaultDecoder<Raw> for Adapter {
    type Decoder = Copier;
    const DECODER: Copier = Copier;
}

/// Copies the bytes unchecked; the receiver of the message checks them.
#[derive(Clone)]
pub struct Copier;

impl Decode<'_, Raw> for Copier {
    type Error = Infallible;
    fn decode_bytes(self, input: &[u8], _: RepresentationIdentifier) -> Result<Raw, Infallible> {
        Ok(Raw([&ENCAPSULATION, input].concat().into()))
    }
}
