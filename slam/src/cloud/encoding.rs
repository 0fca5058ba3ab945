//! Encoding of a cloud in a session: its points without their index, which is built again.

use super::{BEARINGS, Cloud, SurfacePoint};
use crate::encoding::plain;
use msg::BEAMS_MAX;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::borrow::Cow;

#[derive(Serialize, Deserialize)]
struct CloudParts<'a> {
    #[serde(with = "plain")]
    points: Cow<'a, [SurfacePoint]>,
    sensor: [f32; 2],
    centroid_m: [f32; 2],
    #[serde(with = "plain")]
    seen_cm: Cow<'a, [u16]>,
}

impl Serialize for Cloud {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let (points, sensor, centroid_m, seen_cm) = self.parts();
        let (points, seen_cm) = (Cow::Borrowed(points), Cow::Borrowed(&seen_cm[..]));
        CloudParts { points, sensor, centroid_m, seen_cm }.serialize(to)
    }
}

/// Accepts as many points as a scan has beams at most.
impl<'de> Deserialize<'de> for Cloud {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let parts = CloudParts::deserialize(from)?;
        if parts.points.len() > BEAMS_MAX {
            return Err(D::Error::invalid_length(parts.points.len(), &"at most a scan's beams"));
        }
        let bearings = parts.seen_cm.len();
        let seen_cm: Box<[u16; BEARINGS]> = Box::<[u16]>::from(parts.seen_cm)
            .try_into()
            .map_err(|_| D::Error::invalid_length(bearings, &"one range for each bearing"))?;
        Ok(Self::from_parts(parts.points.into_owned(), parts.sensor, parts.centroid_m, seen_cm))
    }
}
