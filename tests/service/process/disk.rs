//! Disks that are full, that fail, and bodies that are bombs, on the real command.

use super::harness::{Process, Server, id, volition};
use serde_json::{Value, json};
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

fn client() -> reqwest::Client {
    reqwest::Client::builder().timeout(Duration::from_secs(120)).build().unwrap()
}

async fn make(client: &reqwest::Client, url: &str, name: &str) -> (u16, Value) {
    let answer = client.post(format!("{url}/v1/studies")).json(&json!({"name": name})).send().await.unwrap();
    (answer.status().as_u16(), answer.json().await.unwrap())
}

async fn status(client: &reqwest::Client, method: &str, url: String) -> u16 {
    let method = reqwest::Method::from_bytes(method.as_bytes()).unwrap();
    client.request(method, url).send().await.unwrap().status().as_u16()
}

/// A file system in memory of so many bytes; `None` where nobody may make one.
struct SmallDisk(tempfile::TempDir);

impl SmallDisk {
    fn mount(size: &str) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new("mount");
        command.args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"]).arg(folder.path());
        let mounted = command.stderr(Stdio::null()).status().is_ok_and(|status| status.success());
        if !mounted {
            let _ = writeln!(std::io::stderr(), "no small disk can be mounted here (not root): its test is left out");
        }
        mounted.then_some(Self(folder))
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    /// Fills it to the last byte.
    fn fill(&self) {
        let mut file = std::fs::File::create(self.path().join("fill")).unwrap();
        let block = [7_u8; 4096];
        while file.write_all(&block).is_ok() {}
        while file.write_all(&[7]).is_ok() {}
    }

    fn clear(&self) {
        std::fs::remove_file(self.path().join("fill")).unwrap();
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(self.path()).status();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_is_said_and_over_when_there_is_room_again() {
    let Some(disk) = SmallDisk::mount("8m") else { return };
    let server = Server::start(&disk.path().join("d.db"), &["--no-worker", "--reserve-mib", "2"]);
    let (client, url) = (client(), server.url.clone());
    let keep = id(&make(&client, &url, "to be kept").await.1);
    let goes = id(&make(&client, &url, "to be deleted").await.1);
    let body = json!({"kind": "inverse_lqr", "inputs": {"a": [[0.0, 1.0], [0.0, 0.0]], "b": [[0.0], [1.0]],
        "k": [[1.0, 1.8]], "sample_time_s": null}, "spec": {}});
    let queued = server.post("/v1/analyses", &body).await;
    for round in 0..3 {
        disk.fill();
        let mut full = 0;
        for k in 0..40 {
            let (status, problem) = make(&client, &url, &format!("{round}: {k}")).await;
            // The log may have a little room left within it.
            if status == 507 {
                assert_eq!(problem["code"], "storage_full", "{problem}");
                full += 1;
            } else {
                assert_eq!((status, full), (201, 0), "{problem}");
            }
        }
        assert!(full >= 10, "round {round}: {full} of 40 met the full disk");
        assert_eq!(status(&client, "GET", format!("{url}/readyz")).await, 503, "round {round}");
        assert_eq!(status(&client, "GET", format!("{url}/healthz")).await, 200);
        assert_eq!(status(&client, "GET", format!("{url}/v1/studies/{keep}")).await, 200, "reading goes on");
        if round == 0 {
            // With the room that is kept for that.
            let cancel = format!("{url}/v1/analyses/{}/cancel", id(&queued));
            assert_eq!(status(&client, "POST", cancel).await, 200);
            assert_eq!(make(&client, &url, "in the room for deleting").await.0, 507);
            assert_eq!(status(&client, "DELETE", format!("{url}/v1/studies/{goes}")).await, 204);
            assert_eq!(status(&client, "GET", format!("{url}/v1/studies/{goes}")).await, 404);
        }
        disk.clear();
        for k in 0..5 {
            let (status, problem) = make(&client, &url, &format!("{round}: after {k}")).await;
            assert_eq!(status, 201, "round {round}: {problem}");
        }
        assert_eq!(status(&client, "GET", format!("{url}/readyz")).await, 200);
    }
    let mut process = server.process;
    assert_eq!(process.interrupt(), Some(0));
    assert!(disk.path().join("d.db.reserve").exists(), "the reserve was not made again");
    let mut verify = Process(volition(&["verify", disk.path().join("d.db").to_str().unwrap()]).spawn().unwrap());
    assert_eq!(verify.finish(), Some(0));
}

/// A limit on the size of files, set on the running process, fails writes with an I/O error: needs no mount.
#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn a_disk_that_fails_is_said_and_over_when_it_works_again() {
    use rustix::process::{Pid, Resource, Rlimit, prlimit};
    let folder = tempfile::tempdir().unwrap();
    let database = folder.path().join("d.db");
    // Whoever ignores the signal gets the error.
    let mut command = Command::new("sh");
    command.args(["-c", "trap '' XFSZ; exec \"$0\" serve --no-worker --listen 127.0.0.1:0 --database \"$1\""]);
    command.arg(env!("CARGO_BIN_EXE_volition")).arg(&database).env("VOLITION_LOG", "off").stdin(Stdio::null());
    let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let mut process = Process(child);
    let url = line.trim().strip_prefix("volition listens on ").unwrap_or_else(|| panic!("{line:?}")).to_owned();
    let client = client();
    let kept = id(&make(&client, &url, "before").await.1);
    let pid = Pid::from_child(&process.0);
    for round in 0..3 {
        prlimit(Some(pid), Resource::Fsize, Rlimit { current: Some(8192), maximum: None }).unwrap();
        for k in 0..20 {
            let (status, problem) = make(&client, &url, &format!("{round}: {k}")).await;
            assert_eq!((status, &problem["code"]), (503, &json!("storage_failed")), "round {round}: {problem}");
        }
        assert_eq!(status(&client, "GET", format!("{url}/readyz")).await, 503);
        assert_eq!(status(&client, "GET", format!("{url}/v1/studies/{kept}")).await, 200);
        prlimit(Some(pid), Resource::Fsize, Rlimit { current: None, maximum: None }).unwrap();
        for k in 0..5 {
            let (status, problem) = make(&client, &url, &format!("{round}: after {k}")).await;
            assert_eq!(status, 201, "round {round}: {problem}");
        }
        assert_eq!(status(&client, "GET", format!("{url}/readyz")).await, 200);
    }
    let listed = client.get(format!("{url}/v1/studies?limit=500")).send().await.unwrap().json::<Value>().await.unwrap();
    assert_eq!(listed["items"].as_array().unwrap().len(), 16, "what was refused is not there, what was taken is");
    assert_eq!(process.interrupt(), Some(0));
    let mut verify = Process(volition(&["verify", database.to_str().unwrap()]).spawn().unwrap());
    assert_eq!(verify.finish(), Some(0));
}

/// The most memory that a process has had, in MiB.
#[cfg(target_os = "linux")]
fn peak_mib(process: &Process) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", process.0.id())).unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() / 1024
}

/// Twelve bodies of 63 MiB at once, each three bytes for a list: refused, within bounds of memory, and nobody waits.
#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn bombs_of_json_stop_and_abort_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("d.db"), &["--no-worker"]);
    let (client, url) = (client(), server.url.clone());
    let study = id(&make(&client, &url, "bombed").await.1);
    let bomb = ["{\"code\":\"x\",\"attributes\":{\"a\":[", &"[],".repeat(22_000_000), "[]]}}"].concat();
    let bomb = bytes::Bytes::from(bomb.into_bytes());
    let mut bombs = tokio::task::JoinSet::new();
    for _ in 0..12 {
        let request = client
            .post(format!("{url}/v1/studies/{study}/subjects"))
            .header("content-type", "application/json")
            .body(bomb.clone());
        bombs.spawn(async move { request.send().await.map(|answer| answer.status().as_u16()) });
    }
    let mut took = Vec::new();
    while !bombs.is_empty() {
        let begin = Instant::now();
        assert_eq!(status(&client, "GET", format!("{url}/v1/studies/{study}")).await, 200);
        took.push(begin.elapsed());
        while let Some(joined) = bombs.try_join_next() {
            assert_eq!(joined.unwrap().unwrap(), 413);
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    took.sort();
    let median = took[took.len() / 2];
    let peak = peak_mib(&server.process);
    eprintln!("12 bombs: {} other answers, median {median:?}, longest {:?}, peak {peak} MiB", took.len(), took.last());
    assert!(peak <= 1024, "{peak} MiB");
    assert!(took.len() >= 5 && median <= Duration::from_millis(100), "{median:?} of {}", took.len());
    // What is merely long is read, and judged by what it says: these attributes are more than a subject may have.
    let long = format!("{{\"code\":\"long\",\"attributes\":{{\"a\":[{}0]}}}}", "0.25,".repeat(200_000));
    let request = client.post(format!("{url}/v1/studies/{study}/subjects")).header("content-type", "application/json");
    assert_eq!(request.body(long).send().await.unwrap().status(), 422);
}

/// A backup while the server runs, on its schedule and by the command, and the restore that the documentation
/// describes.
#[tokio::test(flavor = "multi_thread")]
async fn backups_are_made_on_a_schedule_and_restored() {
    let folder = tempfile::tempdir().unwrap();
    let (database, backups) = (folder.path().join("lab.db"), folder.path().join("backups"));
    let server = Server::start(&database, &["--no-worker", "--backup-folder", backups.to_str().unwrap()]);
    let (study, trials) = server.simulated_study(2).await;
    let newest = || {
        let mut names: Vec<_> = std::fs::read_dir(&backups)
            .into_iter()
            .flatten()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|ending| ending == "db"))
            .collect();
        names.sort();
        names.pop()
    };
    let begin = Instant::now();
    while newest().is_none() {
        assert!(begin.elapsed() < Duration::from_secs(60), "no backup was made");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let arguments = ["backup", backups.to_str().unwrap(), "--keep", "1", "--database", database.to_str().unwrap()];
    let made = volition(&arguments).output().unwrap();
    assert!(made.status.success(), "{made:?}");
    let copy = newest().unwrap();
    let text = String::from_utf8(made.stdout).unwrap();
    assert!(text.contains(copy.to_str().unwrap()) && text.contains("deleted volition-000001"), "{text}");
    drop(server);

    // The disk is lost.
    for ending in ["", "-wal", "-shm", ".reserve"] {
        let _ = std::fs::remove_file(folder.path().join(format!("lab.db{ending}")));
    }
    assert_eq!(volition(&["verify", copy.to_str().unwrap()]).status().unwrap().code(), Some(0));
    std::fs::copy(&copy, &database).unwrap();
    let server = Server::start(&database, &["--no-worker"]);
    let listed = server.get(&format!("/v1/studies/{study}")).await;
    assert_eq!(listed["name"], "simulated");
    for trial in &trials {
        let signals = server.get_bytes(&format!("/v1/trials/{trial}/signals"), "text/csv").await;
        assert!(signals.len() > 1000);
    }
    drop(server);
    // A backup that was changed afterwards is not in order, by its manifest.
    let mut bytes = std::fs::read(&copy).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(&copy, bytes).unwrap();
    let verified = volition(&["verify", copy.to_str().unwrap()]).output().unwrap();
    assert_eq!(verified.status.code(), Some(1), "{verified:?}");
    assert!(String::from_utf8(verified.stdout).unwrap().contains("manifest:"));
}
