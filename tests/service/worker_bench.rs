//! A worker whose analyses are scripts of the tests' own.

use serde_json::json;
use std::collections::HashMap;
use std::future::Future;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use volition::analysis::ids::{AnalysisId, TrialId};
use volition::analysis::{Analysis as _, Code, Failure, Library, Problem, References, Report, Request, ssid};
use volition::ctl::Ctl;
use volition::store::{AnalysisRecord, NewAnalysis, Store};
use volition::worker::{Drained, Execute, Work, Worker, WorkerSettings};

pub type Script = Arc<dyn Fn(&Library, &Ctl) -> Result<Report, Failure> + Send + Sync>;

/// Runs the script that a request names.
#[derive(Default)]
pub struct Scripts {
    scripts: Mutex<HashMap<String, Script>>,
}

pub struct Scripted {
    script: Script,
    references: References,
}

impl Execute for Scripts {
    fn plan(&self, request: &Request) -> Result<Box<dyn Work>, Problem> {
        let name = request.spec["script"].as_str().unwrap();
        assert_ne!(name, "panic while planning");
        let script = self.scripts.lock().unwrap().get(name).cloned();
        let script = script.ok_or_else(|| Problem::new(Code::Invalid, "no script", name).at("/spec/script"))?;
        let trials: Vec<TrialId> = serde_json::from_value(request.inputs["trials"].clone()).unwrap();
        Ok(Box::new(Scripted { script, references: References { trials, ..References::default() } }))
    }
}

impl Work for Scripted {
    fn references(&self) -> References {
        self.references.clone()
    }

    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        (self.script)(library, ctl)
    }
}

pub fn report(answer: &str) -> Report {
    Report::new(ssid::Plan::KIND, 1, json!({"answer": answer}), Vec::new(), json!({}), [].into(), None)
}

pub fn new_analysis(script: &str) -> NewAnalysis {
    NewAnalysis {
        study: None,
        kind: ssid::Plan::KIND,
        request: Request { kind: "ssid".into(), inputs: json!({"trials": []}), spec: json!({"script": script}) },
        spec_sha256: "0".repeat(64),
        trials: Vec::new(),
        plants: Vec::new(),
        analyses: Vec::new(),
    }
}

pub fn quick() -> WorkerSettings {
    WorkerSettings {
        worker_name: "test".into(),
        compute_threads: 2,
        lease_s: 2.0,
        heartbeat_s: 0.05,
        poll_s: 0.05,
        drain_s: 20.0,
        ..WorkerSettings::default()
    }
}

/// A store and scripts, and workers to start on them. Dropping it with a job left behind fails the test.
pub struct Bench {
    pub store: Store,
    pub scripts: Arc<Scripts>,
}

pub struct Started {
    pub shutdown: CancellationToken,
    pub task: tokio::task::JoinHandle<Drained>,
}

impl Started {
    pub async fn stop(self) -> Drained {
        self.shutdown.cancel();
        in_time(self.task).await.unwrap()
    }
}

/// Nothing here takes longer than a minute unless it is broken.
pub async fn in_time<F: Future>(future: F) -> F::Output {
    tokio::time::timeout(Duration::from_secs(60), future).await.expect("it took longer than a minute")
}

impl Bench {
    pub async fn new() -> Self {
        Self { store: Store::open(None).await.unwrap(), scripts: Arc::default() }
    }

    pub fn script(
        &self,
        name: &str,
        script: impl Fn(&Library, &Ctl) -> Result<Report, Failure> + Send + Sync + 'static,
    ) -> &Self {
        self.scripts.scripts.lock().unwrap().insert(name.into(), Arc::new(script));
        self
    }

    /// A script that says that it began, waits for a word, and obeys `ctl` meanwhile.
    pub fn waiting(&self, name: &str) -> (Receiver<()>, Sender<()>) {
        let (began, has_began) = channel();
        let (go_on, may_go_on) = channel();
        let may_go_on = Mutex::new(may_go_on);
        self.script(name, move |_, ctl| {
            began.send(()).unwrap();
            loop {
                ctl.check()?;
                if may_go_on.lock().unwrap().recv_timeout(Duration::from_millis(2)).is_ok() {
                    return Ok(report("went on"));
                }
            }
        });
        (has_began, go_on)
    }

    pub async fn queue(&self, script: &str) -> AnalysisId {
        self.store.create_analysis(new_analysis(script), None).await.unwrap().into_inner().id
    }

    pub fn start(&self, settings: WorkerSettings) -> Started {
        let worker = Worker::new(self.store.clone(), self.scripts.clone(), settings).unwrap();
        let shutdown = CancellationToken::new();
        let token = shutdown.clone();
        Started { shutdown, task: tokio::spawn(async move { worker.run(token).await }) }
    }

    /// The record as soon as it is as wanted.
    pub async fn until(&self, id: AnalysisId, wanted: impl Fn(&AnalysisRecord) -> bool) -> AnalysisRecord {
        in_time(async {
            loop {
                let record = self.store.analysis(id).await.unwrap();
                if wanted(&record) {
                    return record;
                }
                tokio::time::sleep(Duration::from_millis(3)).await;
            }
        })
        .await
    }

    pub async fn finished(&self, id: AnalysisId) -> AnalysisRecord {
        self.until(id, |record| record.status.is_final()).await
    }

    pub async fn report(&self, id: AnalysisId) -> Report {
        serde_json::from_str(&self.store.report_json(id).await.unwrap().unwrap()).unwrap()
    }

    pub async fn assert_nothing_left(&self) {
        for (status, count) in self.store.count_by_status().await.unwrap() {
            assert!(status.is_final() || count == 0, "{count} analyses were left {status}");
        }
    }
}

/// Waits for a word from a script without blocking the runtime.
pub async fn hear(receiver: Receiver<()>) -> Receiver<()> {
    in_time(tokio::task::spawn_blocking(move || {
        receiver.recv_timeout(Duration::from_secs(50)).unwrap();
        receiver
    }))
    .await
    .unwrap()
}
