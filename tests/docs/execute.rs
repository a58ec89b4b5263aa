//! Executes the blocks of all pages.

use crate::blocks::{Block, Language, What, blocks};
use crate::{Page, pages, tell};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Names one page to execute, and no other: for whoever writes it.
const ONE_PAGE: &str = "VOLITION_DOCS_PAGE";

/// How long one block may take.
const PATIENCE: Duration = Duration::from_secs(900);

/// The address in the pages, which the server of a page replaces.
const WRITTEN_URL: &str = "http://127.0.0.1:8080";

/// Commands of `sh` blocks that are not executed here, by how they begin, and why.
const NOT_HERE: [(&str, &str); 12] = [
    ("cargo test", "runs the tests that this is one of"),
    ("cargo bench", "takes minutes to hours; that the bench exists is tested"),
    ("cargo build", "builds what runs here"),
    ("cargo fmt", "a step of .ci/run"),
    ("cargo clippy", "a step of .ci/run"),
    ("cargo doc", "a step of .ci/run"),
    ("cargo deny", "needs a program from elsewhere and the list of advisories"),
    (".ci/run", "runs the tests that this is one of"),
    (".ci/house", "reads the checkout; its limits are asserted by the tests of the house"),
    ("fuzz/run.sh", "builds the whole program anew, with other flags"),
    ("docker ", "needs docker, and builds the whole program anew"),
    ("schemathesis ", "needs a program from PyPI"),
];

/// What happened to the blocks and commands.
#[derive(Default)]
struct Tally {
    executed: BTreeMap<&'static str, usize>,
    left_out: BTreeMap<String, usize>,
    /// Entries of [`NOT_HERE`] that some page needs.
    excused: BTreeSet<&'static str>,
    read_only: usize,
}

impl Tally {
    fn executed(&mut self, what: &'static str) {
        *self.executed.entry(what).or_default() += 1;
    }

    fn left_out(&mut self, what: String) {
        *self.left_out.entry(what).or_default() += 1;
    }
}

#[test]
fn every_block_does_what_it_says() {
    let wanted = std::env::var(ONE_PAGE).ok();
    let mut tally = Tally::default();
    let mut failures = Vec::new();
    for page in pages() {
        let list = blocks(&page);
        if wanted.as_ref().is_some_and(|wanted| !page.name.contains(wanted.as_str())) {
            continue;
        }
        let began = Instant::now();
        let mut room = Room::new();
        if let Err(failure) = room.page(&list, &mut tally) {
            failures.push(format!("{}:{failure}", page.name));
        }
        if began.elapsed() > Duration::from_secs(1) {
            tell(&format!("docs: {} took {:.1} s", page.name, began.elapsed().as_secs_f64()));
        }
    }
    let mut text = format!("docs: read {} blocks of text", tally.read_only);
    for (what, count) in &tally.executed {
        write!(text, ", executed {count} {what}").unwrap();
    }
    for (why, count) in &tally.left_out {
        write!(text, "\ndocs: left out {count} × {why}").unwrap();
    }
    tell(&text);
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
    if wanted.is_none() {
        let unused: Vec<_> = NOT_HERE.iter().filter(|(start, _)| !tally.excused.contains(start)).collect();
        assert!(unused.is_empty(), "no page has these commands any more: {unused:?}");
    }
}

/// Where one page is executed: a folder of its own, and a server where the page starts one.
struct Room {
    folder: tempfile::TempDir,
    server: Option<Server>,
    /// Standard output of the blocks of commands before.
    printed: String,
}

struct Server {
    child: Child,
    url: String,
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Room {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let bin = folder.path().join("bin");
        std::fs::create_dir_all(&bin).unwrap();
        std::fs::create_dir_all(folder.path().join("work")).unwrap();
        let program = env!("CARGO_BIN_EXE_volition");
        script(&bin.join("volition"), &format!("exec '{program}' \"$@\""));
        // A refusal ends curl with 0 unless it is told otherwise, and a page with a wrong request would pass.
        if let Some(curl) = found("curl") {
            script(&bin.join("curl"), &format!("exec '{curl}' --fail-with-body \"$@\""));
        }
        Self { folder, server: None, printed: String::new() }
    }

    fn page(&mut self, list: &[Block], tally: &mut Tally) -> Result<(), String> {
        for (position, block) in list.iter().enumerate() {
            let at = |error: String| format!("{}: {error}\n{}", block.line, block.text);
            match block.what {
                What::Commands => self.commands(&block.text, tally).map_err(at)?,
                What::Server => self.serve(&block.text, tally).map_err(at)?,
                What::Request => {
                    self.request(&block.text).map_err(at)?;
                    tally.executed("requests");
                }
                What::Json => {
                    serde_json::from_str::<serde_json::Value>(&block.text).map_err(|error| at(error.to_string()))?;
                    tally.read_only += 1;
                }
                What::Output => {
                    self.was_printed(&block.text).map_err(at)?;
                    tally.executed("outputs compared");
                }
                What::Text => tally.read_only += 1,
                What::Program(language) => {
                    let is_last = !list[position + 1..].iter().any(|later| later.what == block.what);
                    if is_last {
                        let whole: Vec<&str> =
                            list.iter().filter(|b| b.what == block.what).map(|b| b.text.as_str()).collect();
                        self.program(language, &whole.join("\n"), tally).map_err(at)?;
                    }
                }
            }
        }
        Ok(())
    }

    /// The text of a block with the address of the page's server, and the built program in cargo's place.
    fn adapted(&self, text: &str) -> String {
        let text = text.replace("cargo run --release --", "volition");
        match &self.server {
            Some(server) => text.replace(WRITTEN_URL, &server.url),
            None => text,
        }
    }

    fn command(&self, program: &str) -> Command {
        let work = self.folder.path().join("work");
        let path =
            format!("{}:{}", self.folder.path().join("bin").display(), std::env::var("PATH").unwrap_or_default());
        let mut command = Command::new(program);
        command.current_dir(work).env("PATH", path).env("VOLITION_LOG", "error").stdin(Stdio::null());
        command.env("XDG_CACHE_HOME", self.folder.path().join("cache"));
        command
    }

    /// Runs commands in bash, with the variables and functions of the blocks before.
    fn commands(&mut self, text: &str, tally: &mut Tally) -> Result<(), String> {
        let mut kept = String::new();
        let mut any = false;
        for command in whole_commands(text) {
            let begins = |(start, _): &&(&str, &str)| without_variables(&command).starts_with(start);
            match NOT_HERE.iter().find(begins) {
                Some((start, why)) => {
                    tally.excused.insert(start);
                    tally.left_out(format!("`{}`: {why}", start.trim()));
                }
                None => {
                    any |= !command.trim().is_empty() && !command.trim_start().starts_with('#');
                    kept.push_str(&command);
                    kept.push('\n');
                }
            }
        }
        if !any {
            return Ok(());
        }
        for needed in ["bash", "curl"] {
            if (kept.contains("curl ") || needed == "bash") && found(needed).is_none() {
                tally.left_out(format!("commands, since there is no {needed} here"));
                return Ok(());
            }
        }
        let state = self.folder.path().join("state");
        let state = state.display();
        let program = format!(
            "if [ -f '{state}' ]; then . '{state}'; fi\nset -euo pipefail\n{}\n\
             {{ declare -p | grep -Ev '^declare -[a-zA-Z]*r' || true; declare -f; }} > '{state}'\n",
            self.adapted(&kept)
        );
        let (ended_well, out, err) = finish(self.command("bash").args(["-c", &program]), "")?;
        if !ended_well {
            return Err(format!("the commands failed\n{out}\n{err}"));
        }
        self.printed.push_str(&out);
        tally.executed("blocks of commands");
        Ok(())
    }

    /// Starts the page's server on a free port.
    fn serve(&mut self, text: &str, tally: &mut Tally) -> Result<(), String> {
        let commands: Vec<String> = whole_commands(&self.adapted(text)).filter(|c| !c.trim().is_empty()).collect();
        let [command] = commands.as_slice() else { return Err("a block `sh server` is one command".to_owned()) };
        let words: Vec<&str> = command.split('#').next().unwrap_or_default().split_whitespace().collect();
        if words.get(..2) != Some(&["volition", "serve"]) {
            return Err("a block `sh server` starts `volition serve`".to_owned());
        }
        self.server = None;
        let mut child = self
            .command(env!("CARGO_BIN_EXE_volition"))
            .args(&words[1..])
            .env("VOLITION_LISTEN", "127.0.0.1:0")
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| error.to_string())?;
        let mut line = String::new();
        let out = child.stdout.take().unwrap();
        BufReader::new(out).read_line(&mut line).map_err(|error| error.to_string())?;
        let url = line.trim().strip_prefix("volition listens on ").map(str::to_owned);
        self.server = url.map(|url| Server { child, url });
        if self.server.is_none() {
            return Err(format!("the server does not say where it listens: {line:?}"));
        }
        tally.executed("servers");
        Ok(())
    }

    fn request(&self, text: &str) -> Result<(), String> {
        let mut command = self.command(env!("CARGO_BIN_EXE_volition"));
        let (ended_well, _, err) = finish(command.args(["run", "-"]), text)?;
        if ended_well { Ok(()) } else { Err(format!("the request is refused: {err}")) }
    }

    /// Whether every line was printed by the commands before. Spaces at the ends do not count; a line `…` stands for
    /// any.
    fn was_printed(&self, text: &str) -> Result<(), String> {
        let printed: Vec<&str> = self.printed.lines().map(str::trim).collect();
        let missing = text.lines().map(str::trim).find(|l| !l.is_empty() && *l != "…" && !printed.contains(l));
        match missing {
            None => Ok(()),
            Some(line) => Err(format!("the commands before do not print '{line}', but\n{}", self.printed)),
        }
    }

    fn program(&self, language: Language, text: &str, tally: &mut Tally) -> Result<(), String> {
        // Octave reads MATLAB's language, and two functions stand in for what its own cannot send.
        let stand_in = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/docs/octave");
        let octave = ["--norc", "--path", stand_in, "program.m"];
        // Programs that need more than the language itself find it where it was installed for them.
        let with_tables = concat!(env!("CARGO_MANIFEST_DIR"), "/target/exchange/bin/python");
        let ways: &[Way<'_>] = match language {
            Language::Python if text.contains("import pandas") => &[Way {
                name: "Python programs with pandas and python-control",
                program: with_tables,
                arguments: &["program.py"],
                ready: &["-c", "import pandas, statsmodels, control"],
            }],
            Language::Python => &[Way {
                name: "Python programs",
                program: "python3",
                arguments: &["program.py"],
                ready: &["-c", "import json, urllib.request"],
            }],
            Language::R => &[Way {
                name: "R programs",
                program: "Rscript",
                arguments: &["program.R"],
                ready: &["-e", "library(httr2); library(jsonlite)"],
            }],
            Language::Matlab => &[
                Way {
                    name: "MATLAB programs",
                    program: "matlab",
                    arguments: &["-batch", "program"],
                    ready: &["-batch", "1;"],
                },
                Way {
                    name: "MATLAB programs by Octave",
                    program: "octave-cli",
                    arguments: &octave,
                    ready: &["--norc", "--eval", "if system('curl --version'), exit(1), end, jsonencode(1);"],
                },
            ],
        };
        let is_ready = |way: &&Way<'_>| {
            found(way.program).is_some()
                && self.command(way.program).args(way.ready).output().is_ok_and(|output| output.status.success())
        };
        let Some(Way { name, program, arguments, .. }) = ways.iter().find(is_ready) else {
            let needed: Vec<String> =
                ways.iter().map(|way| format!("`{} {}`", way.program, way.ready.join(" "))).collect();
            tally.left_out(format!("{}, since {} does not work here", ways[0].name, needed.join(" or ")));
            return Ok(());
        };
        let file = match language {
            Language::Python => "program.py",
            Language::R => "program.R",
            Language::Matlab => "program.m",
        };
        std::fs::write(self.folder.path().join("work").join(file), self.adapted(text)).map_err(|e| e.to_string())?;
        let (ended_well, out, err) = finish(self.command(program).args(*arguments), "")?;
        if !ended_well {
            return Err(format!("{program} failed\n{out}\n{err}"));
        }
        tally.executed(name);
        Ok(())
    }
}

/// A way to execute a program, and how to see whether it can be gone.
struct Way<'a> {
    name: &'static str,
    program: &'static str,
    arguments: &'a [&'a str],
    ready: &'a [&'a str],
}

/// The commands of a block: lines, with those that a backslash, a quote or a document in place carries on.
fn whole_commands(text: &str) -> impl Iterator<Item = String> {
    let mut commands = Vec::new();
    let mut open = String::new();
    for line in text.lines() {
        if !open.is_empty() {
            open.push('\n');
        }
        open.push_str(line);
        let is_open = line.ends_with('\\') || open.matches('\'').count() % 2 == 1;
        if !is_open {
            commands.push(std::mem::take(&mut open));
        }
    }
    commands.push(open);
    commands.into_iter()
}

/// A command without the variables that are set for it alone.
fn without_variables(command: &str) -> &str {
    let mut rest = command.trim_start();
    while let Some((word, more)) = rest.split_once(' ') {
        let is_name = |name: &str| name.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_');
        if !word.split_once('=').is_some_and(|(name, _)| is_name(name)) {
            break;
        }
        rest = more.trim_start();
    }
    rest
}

/// Runs a command to its end: whether it ended well, and what it wrote.
fn finish(command: &mut Command, input: &str) -> Result<(bool, String, String), String> {
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(|error| format!("{command:?}: {error}"))?;
    let mut writer = child.stdin.take().unwrap();
    let (out, err) = (child.stdout.take().unwrap(), child.stderr.take().unwrap());
    let input = input.to_owned();
    // A program that does not read its input ends before all is written.
    let writing = std::thread::spawn(move || drop(writer.write_all(input.as_bytes())));
    let (out, err) = (std::thread::spawn(move || read_all(out)), std::thread::spawn(move || read_all(err)));
    let began = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().map_err(|error| error.to_string())? {
            break status;
        }
        if began.elapsed() > PATIENCE {
            let _ = child.kill();
            let _ = child.wait();
            return Err(format!("it did not end within {} s", PATIENCE.as_secs()));
        }
        std::thread::sleep(Duration::from_millis(10));
    };
    let _ = writing.join();
    Ok((status.success(), out.join().unwrap_or_default(), err.join().unwrap_or_default()))
}

fn read_all(mut from: impl std::io::Read) -> String {
    let mut bytes = Vec::new();
    let _ = from.read_to_end(&mut bytes);
    String::from_utf8_lossy(&bytes).into_owned()
}

/// The path of a program, if it is installed.
fn found(program: &str) -> Option<String> {
    let path = std::env::var("PATH").unwrap_or_default();
    std::env::split_paths(&path)
        .map(|folder| folder.join(program))
        .find(|file| file.is_file())
        .map(|file| file.display().to_string())
}

fn script(path: &Path, text: &str) {
    std::fs::write(path, format!("#!/bin/sh\n{text}\n")).unwrap();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }
}

/// Benches and test executables that a page names exist.
#[test]
fn commands_name_targets_that_exist() {
    let manifest = std::fs::read_to_string(crate::root().join("Cargo.toml")).unwrap();
    for Page { name, text } in pages() {
        for (flag, folder) in [("--bench ", "benches"), ("--test ", "tests")] {
            for (position, _) in text.match_indices(flag) {
                let rest = &text[position + flag.len()..];
                let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
                let target = &rest[..rest.find(|c| !is_name(c)).unwrap_or(rest.len())];
                if target.is_empty() || target.chars().all(|c| c.is_ascii_uppercase()) {
                    continue;
                }
                let there = [format!("{folder}/{target}.rs"), format!("{folder}/{target}/main.rs")]
                    .iter()
                    .any(|path| crate::root().join(path).is_file())
                    || manifest.contains(&format!("name = \"{target}\""));
                assert!(there, "{name} names `{flag}{target}`, which does not exist");
            }
        }
    }
}
