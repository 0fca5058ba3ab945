//! Passes messages that are CDR already through RustDDS, without a serializer.

use ros_messages::cdr::ENCAPSULATION;
use ros2_client::dds::rustdds::RepresentationIdentifier;
use ros2_client::dds::rustdds::bytes::Bytes;
use ros2_client::dds::rustdds::no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};
use std::convert::Infallible;

/// One message as CDR with its encapsulation header. Clones share the bytes.
#[derive(Clone, Debug)]
pub struct SerializedMessage(pub Bytes);

/// Adapts [`SerializedMessage`] to RustDDS's serialization interface.
pub struct CdrPassthrough;

impl SerializerAdapter<SerializedMessage> for CdrPassthrough {
    type Error = Infallible;
    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }
    fn to_bytes(SerializedMessage(bytes): &SerializedMessage) -> Result<Bytes, Infallible> {
        // RustDDS writes the encapsulation header itself.
        Ok(bytes.slice(ENCAPSULATION.len().min(bytes.len())..))
    }
}

impl DeserializerAdapter<SerializedMessage> for CdrPassthrough {
    type Error = Infallible;
    type Decoded = SerializedMessage;
    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE]
    }
    fn transform_decoded(decoded: SerializedMessage) -> SerializedMessage {
        decoded
    }
}

impl DefaultDecoder<SerializedMessage> for CdrPassthrough {
    type Decoder = Copier;
    const DECODER: Copier = Copier;
}

/// Copies the bytes unchecked; the receiver of the message checks them.
#[derive(Clone)]
pub struct Copier;

impl Decode<'_, SerializedMessage> for Copier {
    type Error = Infallible;
    fn decode_bytes(
        self,
        input: &[u8],
        _: RepresentationIdentifier,
    ) -> Result<SerializedMessage, Infallible> {
        Ok(SerializedMessage([&ENCAPSULATION, input].concat().into()))
    }
}
