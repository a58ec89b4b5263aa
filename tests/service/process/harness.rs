//! Starts the real command, talks to it over HTTP, and leaves nothing behind.

use serde_json::{Value, json};
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use volition::simulate::SimulatedStudy;
use volition::trial::{Trial, write};

/// How long anything here may take before the test counts as stuck.
pub const PATIENCE: Duration = Duration::from_secs(240);

/// The command with the database of this test.
pub fn volition(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_volition"));
    command.args(arguments).env("VOLITION_LOG", "error").stdin(Stdio::null());
    // Nothing is left in the folders of whoever runs the tests, nor read from there.
    command.env("XDG_CACHE_HOME", concat!(env!("CARGO_TARGET_TMPDIR"), "/user-cache"));
    command
}

/// A process that is killed when the test forgets it.
pub struct Process(pub Child);

impl Process {
    pub fn worker(database: &Path, lease_s: f64, more: &[&str]) -> Self {
        let lease = lease_s.to_string();
        let mut arguments = vec!["worker", "--lease-s", &lease, "--database", database.to_str().unwrap()];
        arguments.extend(more);
        Self(volition(&arguments).spawn().unwrap())
    }

    /// SIGKILL: no handler runs, nothing is written any more.
    pub fn kill(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }

    /// SIGINT, then the exit code.
    pub fn interrupt(&mut self) -> Option<i32> {
        let pid = rustix::process::Pid::from_child(&self.0);
        rustix::process::kill_process(pid, rustix::process::Signal::INT).unwrap();
        self.finish()
    }

    /// Waits for the end.
    pub fn finish(&mut self) -> Option<i32> {
        let begin = Instant::now();
        loop {
            if let Some(status) = self.0.try_wait().unwrap() {
                return status.code();
            }
            assert!(begin.elapsed() < PATIENCE, "the process does not end");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A server process.
pub struct Server {
    pub process: Process,
    pub url: String,
    client: reqwest::Client,
}

impl Server {
    pub fn start(database: &Path, more: &[&str]) -> Self {
        let mut arguments = vec!["serve", "--listen", "127.0.0.1:0", "--database", database.to_str().unwrap()];
        arguments.extend(more);
        let mut child = volition(&arguments).stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = line.trim().strip_prefix("volition listens on ").unwrap_or_else(|| panic!("{line:?}")).to_owned();
        Self { process: Process(child), url, client: reqwest::Client::new() }
    }

    pub async fn get(&self, path: &str) -> Value {
        let answer = self.client.get(format!("{}{path}", self.url)).send().await.unwrap();
        let status = answer.status();
        let text = answer.text().await.unwrap();
        assert!(status.is_success(), "GET {path}: {status} {text}");
        serde_json::from_str(&text).unwrap()
    }

    pub async fn get_bytes(&self, path: &str, accept: &str) -> Vec<u8> {
        let request = self.client.get(format!("{}{path}", self.url)).header("accept", accept);
        let answer = request.send().await.unwrap();
        assert!(answer.status().is_success(), "GET {path}: {}", answer.status());
        answer.bytes().await.unwrap().to_vec()
    }

    pub async fn post(&self, path: &str, body: &Value) -> Value {
        let answer = self.client.post(format!("{}{path}", self.url)).json(body).send().await.unwrap();
        let status = answer.status();
        let text = answer.text().await.unwrap();
        assert!(status.is_success(), "POST {path}: {status} {text}");
        serde_json::from_str(&text).unwrap()
    }

    async fn upload(&self, subject: &str, plant: &str, number: u32, trial: &Trial) -> Value {
        let mut csv = Vec::new();
        write::csv(trial, &mut csv).unwrap();
        let path = format!("{}/v1/subjects/{subject}/trials?plant={plant}&number={number}&session=1", self.url);
        let answer = self.client.post(path).header("content-type", "text/csv").body(csv).send().await.unwrap();
        assert_eq!(answer.status(), 201);
        answer.json().await.unwrap()
    }

    /// A study with one simulated subject and so many trials; the ids of the study and of the trials in order.
    pub async fn simulated_study(&self, trials: u32) -> (String, Vec<String>) {
        let simulated = SimulatedStudy::two_groups(1, trials, 20).unwrap();
        let member = &simulated.groups[0].members[0];
        let study = id(&self.post("/v1/studies", &json!({"name": "simulated", "display_limit": 8.0})).await);
        let model = json!({"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0], "sample_time_s": null});
        let plant =
            id(&self.post(&format!("/v1/studies/{study}/plants"), &json!({"name": "gm", "model": model})).await);
        let subject = id(&self.post(&format!("/v1/studies/{study}/subjects"), &json!({"code": "S1"})).await);
        let mut ids = Vec::new();
        for number in 1..=trials {
            let trial = simulated.trial(member, number).unwrap();
            ids.push(id(&self.upload(&subject, &plant, number, &trial).await));
        }
        (study, ids)
    }

    /// Waits until no analysis of the study is queued or running, and returns them all.
    pub async fn settled(&self, study: &str) -> Vec<Value> {
        let begin = Instant::now();
        loop {
            let listed = self.get(&format!("/v1/analyses?study={study}&limit=500")).await;
            let items = listed["items"].as_array().unwrap().clone();
            if items.iter().all(|item| !matches!(item["status"].as_str(), Some("queued" | "running"))) {
                return items;
            }
            assert!(begin.elapsed() < PATIENCE, "the analyses do not finish");
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }
}

pub fn id(resource: &Value) -> String {
    resource["id"].as_str().unwrap().to_owned()
}

/// An `ssid` request's spec that takes a fraction of a second for each trial.
pub fn quick_spec() -> Value {
    json!({
        "pool": {"name": "zhang2015_appendix_c", "thin": {"poles": 10, "zeros": 10, "damping": 2, "gains": 2}},
        "feedforward_numerator_degree": 2,
        "feedforward_denominator_degree": 2
    })
}
