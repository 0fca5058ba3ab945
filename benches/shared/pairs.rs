//! Windows of one fleet with and without something that is attached to it, in turns: what that costs.

use crate::measure::Spread;
use serde::Serialize;

/// Number of pairs. What is attached changes less than two windows of one fleet differ; the mean of many pairs shows it.
pub const PAIRS: usize = 50;
/// Half the width of the mean's interval of 90 % confidence, in standard errors: Student's t for 49 degrees of freedom.
const CONFIDENCE: f64 = 1.677;

/// A figure of a window, such as `|spread| spread.p99_ms`. It is more than 0.
pub type Figure<W> = fn(&W) -> f64;

/// A percentile of jitter.
#[allow(dead_code, reason = "not all benches that share this compare jitter alone")]
pub type Percentile = Figure<Spread>;

/// What was measured in the windows of both kinds. Windows with the same index are a pair.
#[derive(Debug, Serialize)]
pub struct Pairs<W = Spread> {
    /// Windows without it.
    pub without: Vec<W>,
    /// Windows with it.
    pub with: Vec<W>,
}

impl<W> Default for Pairs<W> {
    fn default() -> Self {
        Self { without: Vec::new(), with: Vec::new() }
    }
}

/// Ratio of a figure, with to without: geometric mean of the pairs.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Ratio {
    /// The mean.
    pub mean: f64,
    /// Lower end of its interval of 90 % confidence.
    pub least: f64,
    /// Upper end.
    pub most: f64,
}

impl<W> Pairs<W> {
    /// Compares a figure.
    pub fn ratio(&self, of: Figure<W>) -> Ratio {
        let logs: Vec<f64> = self.without.iter().zip(&self.with).map(|(a, b)| (of(b) / of(a)).ln()).collect();
        let count = logs.len() as f64;
        let mean = logs.iter().sum::<f64>() / count;
        let variance = logs.iter().map(|log| (log - mean).powi(2)).sum::<f64>() / (count - 1.0);
        let half = CONFIDENCE * (variance / count).sqrt();
        Ratio { mean: mean.exp(), least: (mean - half).exp(), most: (mean + half).exp() }
    }

    /// Returns the median of the windows, without and with.
    pub fn medians(&self, of: Figure<W>) -> [f64; 2] {
        [&self.without, &self.with].map(|windows| {
            let mut values: Vec<f64> = windows.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
        })
    }
}

impl Pairs {
    /// Returns the number of messages that were lost, without and with.
    #[allow(dead_code, reason = "not all benches that share this compare jitter alone")]
    pub fn lost(&self) -> [u64; 2] {
        [&self.without, &self.with].map(|windows| windows.iter().map(|window| window.lost).sum())
    }
}

impl std::fmt::Display for Ratio {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let [mean, least, most] = [self.mean, self.least, self.most].map(|ratio| 100.0 * (ratio - 1.0));
        write!(f, "{mean:+.1} % (90 % confidence: {least:+.1} to {most:+.1} %)")
    }
}
