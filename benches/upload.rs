//! What it takes to store a recording: one upload over HTTP, from the first byte sent to the answer.
//!
//! `cargo bench --bench upload` starts the real command on a database of its own, sends recordings of 40,001 samples
//! (the chirp of Zhang 2015, section 3.2) as CSV, one after another over one connection, each with other numbers, and
//! asserts that the median takes 60 ms at most: r, u and y with the sample time said beside them, and t, r, u and y.
//! Reading, checks, metrics, hashes, packing and the write to disk are all of it. `-- --smoke` asserts no times.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use serde_json::{Value, json};
use std::fmt::Write as _;
use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::Instant;
use volition::simulate::reference_signals::chirp80;

/// Uploads of which the median is told.
const RUNS: usize = 21;

/// Uploads before, for caches of the system and of the allocator.
const BEFORE: usize = 3;

/// The median may take so long, in seconds.
const TARGET_S: f64 = 0.060;

const SAMPLE_TIME_S: f64 = 0.002;

/// The server, killed when it is not needed any more.
struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A recording as text: a person of one lag, with noise that differs from one to the next.
fn recording(command: &[f64], number: usize, with_time: bool) -> String {
    let (mut u, mut y) = (0.0_f64, 0.0_f64);
    let mut text = String::from(if with_time { "t,r,u,y\n" } else { "r,u,y\n" });
    for (k, r) in command.iter().enumerate() {
        if with_time {
            let _ = write!(text, "{:.3},", k as f64 * SAMPLE_TIME_S);
        }
        let _ = writeln!(text, "{r},{u},{y}");
        let phase = k as f64 * k as f64 * 0.37 + number as f64;
        u += 0.02 * (1.4 * (r - y) - u) + 1e-3 * phase.sin();
        y += SAMPLE_TIME_S * u;
    }
    text
}

#[tokio::main(flavor = "current_thread")]
async fn main() {
    let is_strict = !std::env::args().any(|argument| argument == "--smoke");
    let runs = if is_strict { RUNS } else { 3 };
    let folder = tempfile::tempdir().unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_volition"))
        .args(["serve", "--listen", "127.0.0.1:0", "--database"])
        .arg(folder.path().join("bench.db"))
        .env("VOLITION_LOG", "error")
        .env("XDG_CACHE_HOME", folder.path())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let _server = Server(child);
    let url = line.trim().strip_prefix("volition listens on ").unwrap_or_else(|| panic!("{line:?}")).to_owned();
    let client = reqwest::Client::new();
    let made = async |path: String, body: Value| -> String {
        let answer = client.post(format!("{url}{path}")).json(&body).send().await.unwrap();
        let body: Value = answer.error_for_status().unwrap().json().await.unwrap();
        body["id"].as_str().unwrap().to_owned()
    };
    let study = made("/v1/studies".into(), json!({"name": "uploads"})).await;
    let model = json!({"num": [1], "den": [1, 0], "sample_time_s": null});
    let plant = made(format!("/v1/studies/{study}/plants"), json!({"name": "1/s", "model": model})).await;
    let command = chirp80(SAMPLE_TIME_S);
    for with_time in [false, true] {
        let code = if with_time { "timed" } else { "plain" };
        let subject = made(format!("/v1/studies/{study}/subjects"), json!({"code": code})).await;
        let mut path = format!("{url}/v1/subjects/{subject}/trials?plant={plant}");
        if !with_time {
            let _ = write!(path, "&sample_time_s={SAMPLE_TIME_S}");
        }
        let (mut times, mut bytes) = (Vec::new(), 0);
        for number in 1..=BEFORE + runs {
            let text = recording(&command, number, with_time);
            bytes = text.len();
            let request = client.post(format!("{path}&number={number}")).header("content-type", "text/csv").body(text);
            let begin = Instant::now();
            let answer = request.send().await.unwrap();
            let status = answer.status();
            let body = answer.text().await.unwrap();
            times.push(begin.elapsed().as_secs_f64());
            assert_eq!(status, 201, "{body}");
        }
        times.drain(..BEFORE);
        times.sort_by(f64::total_cmp);
        let (fastest, median, slowest) = (times[0], times[times.len() / 2], times[times.len() - 1]);
        println!(
            "{} × {} samples, {:.1} MB: median {:.1} ms of {} uploads, {:.1} to {:.1} (target {:.0})",
            command.len(),
            if with_time { 4 } else { 3 },
            bytes as f64 / 1e6,
            1e3 * median,
            times.len(),
            1e3 * fastest,
            1e3 * slowest,
            1e3 * TARGET_S
        );
        assert!(!is_strict || median <= TARGET_S, "the median upload takes {median} s");
    }
}
