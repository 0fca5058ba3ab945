//! How a service's requests and responses carry the request's identity on DDS.
//!
//! Fast DDS and RustDDS have it beside the payload: the sample's own number, and the requester's reader or writer as
//! related sample identity (DDS-RPC's enhanced mapping). ROS 2's CycloneDDS has it in the payload, before the fields: 8
//! bytes that the requester chose, and its number of the call (rmw_cyclonedds, serdata.hpp).

use super::raw::SerializedMessage;
use crate::relay::RosRequestId;
use ros_messages::cdr::ENCAPSULATION;
use ros2_client::MessageInfo;
use ros2_client::dds::rustdds::bytes::Bytes;
use ros2_client::dds::rustdds::no_key::DeserializedCacheChange;
use ros2_client::dds::rustdds::{GUID, SampleIdentity, SequenceNumber};

/// The first bytes of the identifiers of CycloneDDS's participants: its vendor number (OMG).
const CYCLONE_VENDOR: [u8; 2] = [0x01, 0x10];
/// Length of CycloneDDS's header in the payload, bytes.
const HEADER_BYTES: usize = 16;

/// Returns whether a reader or writer belongs to CycloneDDS.
pub fn is_cyclone(guid: &GUID) -> bool {
    guid.to_bytes().starts_with(&CYCLONE_VENDOR)
}

/// Returns the beginning of the identifier of the participant that sent a request.
pub fn participant(id: &RosRequestId) -> &[u8] {
    if id.is_in_payload { &id.requester[8..] } else { &id.requester[..8] }
}

/// Returns the identity of a request and its payload without it; `None` if the payload is too short.
pub fn read_request(sample: DeserializedCacheChange<SerializedMessage>) -> Option<(RosRequestId, Bytes)> {
    let (info, writer) = (MessageInfo::from(&sample), sample.writer_guid());
    let SerializedMessage(payload) = sample.into_value();
    if is_cyclone(&writer) {
        let (header, payload) = split_header(&payload)?;
        let mut requester = [0; 16];
        requester[..8].copy_from_slice(&header[..8]);
        requester[8..].copy_from_slice(&writer.to_bytes()[..8]);
        let number = i64::from_le_bytes(*header.last_chunk()?);
        return Some((RosRequestId { requester, number, is_in_payload: true }, payload));
    }
    let number = SequenceNumber::from(info.sequence_number());
    // Fast DDS sends the identity of its reply reader beside the request, without the sequence number.
    let identity = match info.related_request_id().map(SampleIdentity::from) {
        Some(named) if named.sequence_number != SequenceNumber::UNKNOWN => named,
        Some(named) => SampleIdentity { sequence_number: number, ..named },
        None => SampleIdentity { writer_guid: writer, sequence_number: number },
    };
    let (requester, number) = (identity.writer_guid.to_bytes(), identity.sequence_number.into());
    Some((RosRequestId { requester, number, is_in_payload: false }, payload))
}

/// Returns a response's payload with its request's identity in it, or beside it.
pub fn write_response(id: &RosRequestId, payload: Bytes) -> (Bytes, Option<SampleIdentity>) {
    if id.is_in_payload {
        let mut header = [0; HEADER_BYTES];
        header[..8].copy_from_slice(&id.requester[..8]);
        header[8..].copy_from_slice(&id.number.to_le_bytes());
        return (join_header(&header, &payload), None);
    }
    let writer_guid = GUID::from_bytes(id.requester);
    (payload, Some(SampleIdentity { writer_guid, sequence_number: id.number.into() }))
}

/// Returns a request's payload for CycloneDDS. `writer`: of the request. `number`: what the response must carry.
pub fn write_cyclone_request(writer: &GUID, number: i64, payload: &[u8]) -> Bytes {
    let mut header = [0; HEADER_BYTES];
    header[..8].copy_from_slice(&writer.to_bytes()[8..]);
    header[8..].copy_from_slice(&number.to_le_bytes());
    join_header(&header, payload)
}

/// What a response answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RequestNumber {
    /// The request sample's number.
    Sample(i64),
    /// The number in the request's payload.
    InPayload(i64),
}

/// Returns which request of ours a response answers, and its payload; `None` if it answers somebody else's.
///
/// `writer` and `reader`: of our requests and of the responses to them.
pub fn read_response(
    sample: DeserializedCacheChange<SerializedMessage>,
    writer: &GUID,
    reader: &GUID,
) -> Option<(RequestNumber, Bytes)> {
    let (info, is_cyclone) = (MessageInfo::from(&sample), is_cyclone(&sample.writer_guid()));
    let SerializedMessage(payload) = sample.into_value();
    if is_cyclone {
        let (header, payload) = split_header(&payload)?;
        let number = RequestNumber::InPayload(i64::from_le_bytes(*header.last_chunk()?));
        return (header[..8] == writer.to_bytes()[8..]).then_some((number, payload));
    }
    let answered = SampleIdentity::from(info.related_request_id()?);
    let is_ours = answered.writer_guid == *writer || answered.writer_guid == *reader;
    is_ours.then(|| (RequestNumber::Sample(answered.sequence_number.into()), payload))
}

/// Splits CycloneDDS's header from a payload with encapsulation header.
fn split_header(payload: &[u8]) -> Option<(&[u8], Bytes)> {
    let (encapsulation, rest) = payload.split_at_checked(ENCAPSULATION.len())?;
    let (header, fields) = rest.split_at_checked(HEADER_BYTES)?;
    Some((header, [encapsulation, fields].concat().into()))
}

fn join_header(header: &[u8; HEADER_BYTES], payload: &[u8]) -> Bytes {
    let fields = payload.get(ENCAPSULATION.len()..).unwrap_or_default();
    [&ENCAPSULATION, &header[..], fields].concat().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cyclones_header_stands_between_encapsulation_and_fields() {
        let writer = GUID::from_bytes([1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16]);
        let request = write_cyclone_request(&writer, 258, &[0, 1, 0, 0, 42]);
        let expected = [0, 1, 0, 0, 9, 10, 11, 12, 13, 14, 15, 16, 2, 1, 0, 0, 0, 0, 0, 0, 42];
        assert_eq!(request, &expected[..]);
        let (header, payload) = split_header(&request).unwrap();
        assert_eq!((header, &payload[..]), (&expected[4..20], &[0, 1, 0, 0, 42][..]));
        assert_eq!(split_header(&request[..19]), None);
        let id = RosRequestId { requester: [9; 16], number: 258, is_in_payload: true };
        let (response, beside) = write_response(&id, Bytes::from_static(&[0, 1, 0, 0, 1]));
        assert_eq!((&response[4..14], beside), (&[9, 9, 9, 9, 9, 9, 9, 9, 2, 1][..], None));
    }
}
