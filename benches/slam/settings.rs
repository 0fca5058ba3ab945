//! SLAM's configuration in this bench: that of recorded logs, with the numbers that `--scale` changes.

use mr_slam::config::recorded_log_slam;
use serde_json::Value;
use slam::SlamConfig;
use std::sync::OnceLock;

static SCALED: OnceLock<SlamConfig> = OnceLock::new();

/// Returns the configuration that logs are mapped with.
pub fn slam_config() -> SlamConfig {
    SCALED.get().cloned().unwrap_or_else(recorded_log_slam)
}

/// Multiplies numbers of the configuration, for the whole process: `KEY=FACTOR`, as `links.sigma_min_rad=1.3`. A whole number
/// changes by one at least.
pub fn scale(factors: &[String]) -> Result<(), String> {
    let mut config = serde_json::to_value(recorded_log_slam()).map_err(|why| why.to_string())?;
    for text in factors {
        let wrong = |why: &str| format!("--scale {text}: {why}, as links.sigma_min_rad=1.3");
        let (key, factor) = text.split_once('=').ok_or_else(|| wrong("expected KEY=FACTOR"))?;
        let factor: f64 = factor.parse().map_err(|_| wrong("expected a number after ="))?;
        let value = config.pointer_mut(&format!("/{}", key.replace('.', "/")));
        let value =
            value.filter(|value| value.is_number()).ok_or_else(|| wrong("expected a key of a number"))?;
        *value = scaled(value, factor).ok_or_else(|| wrong("expected a factor above 0"))?;
    }
    let config: SlamConfig = serde_json::from_value(config).map_err(|why| why.to_string())?;
    config.validate().map_err(|why| why.to_string())?;
    SCALED.set(config).map_err(|_| "--scale was given before".into())
}

fn scaled(value: &Value, factor: f64) -> Option<Value> {
    if !(factor.is_finite() && factor > 0.0) {
        return None;
    }
    let Some(whole) = value.as_u64() else { return Some((value.as_f64()? * factor).into()) };
    let product = (whole as f64 * factor).round() as u64;
    Some(match product == whole {
        true if factor > 1.0 => (whole + 1).into(),
        true if factor < 1.0 => whole.saturating_sub(1).into(),
        _ => product.into(),
    })
}
