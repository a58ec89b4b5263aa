//! How many requests were answered, and how fast.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Upper bounds of the latency histogram, in seconds.
const BUCKETS_S: [f64; 8] = [0.001, 0.005, 0.025, 0.1, 0.5, 2.5, 10.0, 60.0];

/// Counts of answered requests.
#[derive(Debug, Default)]
pub(super) struct HttpTelemetry {
    /// By method, route template and status.
    series: Mutex<BTreeMap<(String, String, u16), Series>>,
}

#[derive(Debug, Default, Clone, Copy)]
struct Series {
    count: u64,
    seconds: f64,
    /// Requests within each bound.
    within: [u64; BUCKETS_S.len()],
}

impl HttpTelemetry {
    pub(super) fn observe(&self, method: &str, route: &str, status: u16, elapsed: Duration) {
        const KNOWN: [&str; 7] = ["GET", "HEAD", "POST", "PATCH", "PUT", "DELETE", "OPTIONS"];
        // Methods are the client's choice; unknown ones share a series, or they could fill the memory.
        let method = if KNOWN.contains(&method) { method } else { "other" };
        let seconds = elapsed.as_secs_f64();
        let mut series = self.series.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = series.entry((method.to_owned(), route.to_owned(), status)).or_default();
        entry.count += 1;
        entry.seconds += seconds;
        for (within, bound) in entry.within.iter_mut().zip(BUCKETS_S) {
            *within += u64::from(seconds <= bound);
        }
    }

    pub(super) fn write(&self, out: &mut String) -> std::fmt::Result {
        let series = self.series.lock().unwrap_or_else(PoisonError::into_inner).clone();
        writeln!(
            out,
            "# HELP volition_http_request_duration_seconds Time from a request's head to its answer's head."
        )?;
        writeln!(out, "# TYPE volition_http_request_duration_seconds histogram")?;
        for ((method, route, status), series) in series {
            let labels = format!("method=\"{method}\",route=\"{route}\",status=\"{status}\"");
            for (within, bound) in series.within.iter().zip(BUCKETS_S) {
                writeln!(out, "volition_http_request_duration_seconds_bucket{{{labels},le=\"{bound}\"}} {within}")?;
            }
            let Series { count, seconds, .. } = series;
            writeln!(out, "volition_http_request_duration_seconds_bucket{{{labels},le=\"+Inf\"}} {count}")?;
            writeln!(out, "volition_http_request_duration_seconds_sum{{{labels}}} {seconds}")?;
            writeln!(out, "volition_http_request_duration_seconds_count{{{labels}}} {count}")?;
        }
        Ok(())
    }
}
