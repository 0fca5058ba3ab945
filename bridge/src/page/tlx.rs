//! Raw NASA-TLX: the answers of the form that the page serves at `/tlx`, as they come with `POST /tlx`.
//!
//! Hart and Staveland, Development of NASA-TLX (Task Load Index), 1988. Raw: the mean of the ratings, without weights.

use super::http::text_response;
use super::room::read_body;
use crate::access::{Action, PermissionError};
use crate::bridge::Bridge;
use crate::connection::Stream;
use serde::{Deserialize, Serialize};
use std::future::Future;
use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::rc::Rc;
use std::time::Duration;
use thiserror::Error;
use tokio::time::timeout;

/// Path of the form, and of the request that carries an answer.
pub const TLX_PATH: &str = "/tlx";
/// Largest answer, bytes: six names and numbers are 140.
pub const TLX_BYTES_MAX: usize = 512;
/// An answer must be here after this time.
const TLX_TIMEOUT: Duration = Duration::from_secs(5);
/// Largest rating, and the step of ratings.
const RATING_MAX: u8 = 100;
const RATING_STEP: u8 = 5;

/// Ratings of one person, each 0 to 100 in steps of 5.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TlxAnswer {
    /// How mentally demanding the task was.
    pub mental_demand: u8,
    /// How physically demanding the task was.
    pub physical_demand: u8,
    /// How hurried or rushed its pace was.
    pub temporal_demand: u8,
    /// How successful the person was: 0 is perfect, 100 is failure.
    pub performance: u8,
    /// How hard the person had to work.
    pub effort: u8,
    /// How insecure, discouraged, irritated, stressed and annoyed the person was.
    pub frustration: u8,
}

/// Why an answer is refused.
#[derive(Debug, Error)]
pub enum TlxError {
    /// It is not the JSON that was expected.
    #[error("expected JSON with six ratings: {0}")]
    Json(#[from] serde_json::Error),
    /// A rating is out of range.
    #[error("{scale} is {rating}; expected 0 to {RATING_MAX} in steps of {RATING_STEP}")]
    Rating {
        /// Name of the scale.
        scale: &'static str,
        /// Rating that was given.
        rating: u8,
    },
    /// The address is denied.
    #[error(transparent)]
    Denied(#[from] PermissionError),
    /// It did not come whole.
    #[error("the answer did not come within {} s", TLX_TIMEOUT.as_secs())]
    Slow,
    /// Answers are not kept here.
    #[error("answers are not kept here: no run is under way")]
    NotKept,
    /// The run has as many answers as it keeps.
    #[error("the run has {0} answers already, the limit")]
    Full(usize),
    /// It cannot be saved.
    #[error("the answer cannot be saved: {0}")]
    Save(#[from] io::Error),
}

impl TlxAnswer {
    /// Names of the scales, in the order of the form.
    pub const SCALES: [&'static str; 6] =
        ["mental demand", "physical demand", "temporal demand", "performance", "effort", "frustration"];

    /// Reads an answer as JSON.
    ///
    /// # Errors
    /// A scale is missing, unknown or out of range.
    pub fn parse(json: &[u8]) -> Result<Self, TlxError> {
        let answer: Self = serde_json::from_slice(json)?;
        let wrong = Self::SCALES.into_iter().zip(answer.ratings());
        let wrong =
            wrong.into_iter().find(|(_, rating)| *rating > RATING_MAX || !rating.is_multiple_of(RATING_STEP));
        wrong.map_or(Ok(answer), |(scale, rating)| Err(TlxError::Rating { scale, rating }))
    }

    /// Returns the ratings in the order of [`TlxAnswer::SCALES`].
    pub fn ratings(&self) -> [u8; 6] {
        let Self { mental_demand, physical_demand, temporal_demand, performance, effort, frustration } =
            *self;
        [mental_demand, physical_demand, temporal_demand, performance, effort, frustration]
    }

    /// Returns the mean of the ratings.
    pub fn raw(&self) -> f64 {
        self.ratings().iter().copied().map(f64::from).sum::<f64>() / self.ratings().len() as f64
    }
}

/// Saves an answer. Must not block the thread.
pub type SaveTlx = Rc<dyn Fn(TlxAnswer) -> Pin<Box<dyn Future<Output = Result<(), TlxError>>>>>;

/// Receives an answer of an address, `length` bytes, of which `first` are here already; returns the response.
pub(super) async fn receive(
    (bridge, save): (&Bridge, Option<&SaveTlx>),
    stream: &impl Stream,
    address: IpAddr,
    first: Vec<u8>,
    length: usize,
) -> Vec<u8> {
    let result = async {
        bridge.check_permission(Action::AnswerForm, address)?;
        let save = save.ok_or(TlxError::NotKept)?;
        let body = timeout(TLX_TIMEOUT, read_body(stream, first, length));
        let body = body.await.map_err(|_| TlxError::Slow)?.map_err(|_| TlxError::Slow)?;
        save(TlxAnswer::parse(&body)?).await
    };
    match result.await {
        Ok(()) => text_response("201 Created", "the answer is saved"),
        Err(error) => {
            let status = match error {
                TlxError::Json(_) | TlxError::Rating { .. } => "422 Unprocessable Content",
                TlxError::Denied(_) => "403 Forbidden",
                TlxError::Slow => "408 Request Timeout",
                TlxError::NotKept | TlxError::Full(_) => "409 Conflict",
                TlxError::Save(_) => "500 Internal Server Error",
            };
            text_response(status, &error.to_string())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratings_are_0_to_100_in_steps_of_5_and_all_are_given() {
        let json = |mental: &str| {
            format!(
                r#"{{"mental_demand":{mental},"physical_demand":5,"temporal_demand":40,"performance":20,"effort":60,"frustration":0}}"#
            )
        };
        let answer = TlxAnswer::parse(json("70").as_bytes()).unwrap();
        assert!((answer.raw() - 32.5).abs() < 1e-12);
        for wrong in ["72", "105", "-5", "300", "2.5", "null", "\"50\""] {
            assert!(TlxAnswer::parse(json(wrong).as_bytes()).is_err(), "{wrong}");
        }
        assert!(TlxAnswer::parse(json("50").replace("effort", "effect").as_bytes()).is_err());
        assert!(TlxAnswer::parse(br#"{"mental_demand":50}"#).is_err());
        let why = TlxAnswer::parse(json("72").as_bytes()).unwrap_err().to_string();
        assert!(why.contains("mental demand is 72"), "{why}");
    }
}
