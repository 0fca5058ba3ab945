//! Windows of one fleet with and without something that is attached to it, in turns: what that costs.

use crate::measure::Spread;
use serde::Serialize;
use std::error::Error;

/// Number of pairs. What is attached changes less than two windows of one fleet differ; the mean of many pairs shows it.
pub const PAIRS: usize = 50;
/// 95 % quantile of the normal distribution: an interval of 90 % confidence ends there, in standard errors, if there are many pairs.
const QUANTILE: f64 = 1.6449;

/// A figure of a window, such as `|spread| spread.p99_ms`. It is more than 0.
pub type Figure<W = Spread> = fn(&W) -> f64;

/// Measures the windows of so many pairs: `window` is told whether it is one with what is attached. Now the one of a pair comes first,
/// now the other: what changes with time hits both.
///
/// # Errors
/// A window's error ends it.
pub fn in_turns(
    pairs: usize,
    mut window: impl FnMut(bool) -> Result<(), Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    for pair in 0..pairs {
        for is_with in [pair % 2 == 0, pair % 2 == 1] {
            window(is_with)?;
        }
        eprint!("\r{} of {pairs} pairs ", pair + 1);
    }
    eprintln!();
    Ok(())
}

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
    /// Adds a window.
    pub fn push(&mut self, is_with: bool, window: W) {
        if is_with { &mut self.with } else { &mut self.without }.push(window);
    }

    /// Compares a figure.
    pub fn ratio(&self, of: Figure<W>) -> Ratio {
        let logs: Vec<f64> = self.without.iter().zip(&self.with).map(|(a, b)| (of(b) / of(a)).ln()).collect();
        let count = logs.len() as f64;
        let mean = logs.iter().sum::<f64>() / count;
        let variance = logs.iter().map(|log| (log - mean).powi(2)).sum::<f64>() / (count - 1.0);
        let half = student_t(count - 1.0) * (variance / count).sqrt();
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

    /// Returns the sum of a count over the windows, without and with.
    pub fn sums(&self, of: fn(&W) -> u64) -> [u64; 2] {
        [&self.without, &self.with].map(|windows| windows.iter().map(of).sum())
    }
}

/// 95 % quantile of Student's t distribution: Abramowitz and Stegun, Handbook of Mathematical Functions, 26.7.5.
fn student_t(degrees_of_freedom: f64) -> f64 {
    let x = QUANTILE;
    let first = (x.powi(3) + x) / 4.0;
    let second = (5.0 * x.powi(5) + 16.0 * x.powi(3) + 3.0 * x) / 96.0;
    x + first / degrees_of_freedom + second / degrees_of_freedom.powi(2)
}

impl std::fmt::Display for Ratio {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let [mean, least, most] = [self.mean, self.least, self.most].map(|ratio| 100.0 * (ratio - 1.0));
        write!(f, "{mean:+.1} % (90 % confidence: {least:+.1} to {most:+.1} %)")
    }
}
