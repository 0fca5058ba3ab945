//! Options of an experiment's link: one that has a name, and values that replace its own.

use headset::wireless::{Link, LinkChoice, LinkError};

/// Link behind which the operator is, and with `--world headset` the robots too
#[derive(Clone, Debug, Default, clap::Args)]
pub struct LinkArgs {
    /// Link to the fleet, through a proxy that delays, stalls and interrupts [default: loopback; with --world headset:
    /// busy-wifi]
    #[arg(long, value_name = "LINK", value_enum)]
    pub link: Option<LinkChoice>,
    /// Smallest delay of the link, one way, milliseconds
    #[arg(long, value_name = "MS")]
    pub link_delay_ms: Option<f64>,
    /// Mean of the delay that comes on top, exponentially distributed, milliseconds
    #[arg(long, value_name = "MS")]
    pub link_jitter_ms: Option<f64>,
    /// Throughput of the link in each direction, Mbit/s
    #[arg(long, value_name = "MBIT_S")]
    pub link_mbit_s: Option<f64>,
    /// Share of TCP segments that are lost, 0 to 1
    #[arg(long, value_name = "SHARE")]
    pub link_loss: Option<f64>,
    /// Stall that a lost segment costs until it is sent again, milliseconds
    #[arg(long, value_name = "MS")]
    pub link_stall_ms: Option<f64>,
    /// Outages of the link: their period and their length, seconds
    #[arg(long, value_name = "PERIOD,LENGTH", value_parser = period_and_length)]
    pub link_outages_s: Option<[f64; 2]>,
}

/// Text that is not the period and the length of outages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected a period and a length in seconds, such as 15,1")]
struct OutagesError;

fn period_and_length(text: &str) -> Result<[f64; 2], OutagesError> {
    let both = text
        .split_once(',')
        .and_then(|(period, length)| Some([period.trim().parse().ok()?, length.trim().parse().ok()?]));
    both.ok_or(OutagesError)
}

impl LinkArgs {
    /// Returns the link: that of the name, or of `default`, with the values that are given.
    ///
    /// # Errors
    /// A value is out of its range.
    pub fn link(&self, default: LinkChoice) -> Result<Link, LinkError> {
        let named = self.link.unwrap_or(default).link();
        let [outage_period_s, outage_s] =
            self.link_outages_s.unwrap_or([named.outage_period_s, named.outage_s]);
        let link = Link {
            delay_ms: self.link_delay_ms.unwrap_or(named.delay_ms),
            jitter_ms: self.link_jitter_ms.unwrap_or(named.jitter_ms),
            mbit_s: self.link_mbit_s.unwrap_or(named.mbit_s),
            loss: self.link_loss.unwrap_or(named.loss),
            stall_ms: self.link_stall_ms.unwrap_or(named.stall_ms),
            outage_period_s,
            outage_s,
        };
        link.check().map(|()| link)
    }

    /// Returns the link for people: its name and all its values.
    pub fn describe(&self, default: LinkChoice, link: &Link) -> String {
        let choice = self.link.unwrap_or(default);
        if link.is_transparent() {
            return LinkChoice::Loopback.name().into();
        }
        let name = if *link == choice.link() { choice.name() } else { "a link" };
        let outages = if link.outage_s > 0.0 {
            format!(", outages of {} s each {} s", link.outage_s, link.outage_period_s)
        } else {
            String::new()
        };
        format!(
            "{name} ({} ms and {} ms jitter each way, {} Mbit/s, {} % of segments lost, each a stall of {} ms{outages})",
            link.delay_ms,
            link.jitter_ms,
            link.mbit_s,
            100.0 * link.loss,
            link.stall_ms
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_replace_those_of_the_named_link_and_are_checked() {
        let args = LinkArgs {
            link: Some(LinkChoice::QuietWifi),
            link_jitter_ms: Some(20.0),
            link_outages_s: Some([30.0, 2.0]),
            ..LinkArgs::default()
        };
        let link = args.link(LinkChoice::Loopback).unwrap();
        assert_eq!(link, Link { jitter_ms: 20.0, outage_period_s: 30.0, outage_s: 2.0, ..Link::QUIET_WIFI });
        let text = args.describe(LinkChoice::Loopback, &link);
        assert!(
            text.starts_with("a link (2 ms and 20 ms") && text.contains("outages of 2 s each 30 s"),
            "{text}"
        );
        let none = LinkArgs::default();
        assert_eq!(none.link(LinkChoice::BusyWifi), Ok(Link::BUSY_WIFI));
        assert_eq!(none.describe(LinkChoice::Loopback, &Link::LOOPBACK), "loopback");
        assert_eq!(period_and_length("30, 2.5"), Ok([30.0, 2.5]));
        assert_eq!(period_and_length("30"), Err(OutagesError));
        assert!(LinkArgs { link_loss: Some(-0.1), ..none }.link(LinkChoice::Loopback).is_err());
    }
}
