//! Pools and trees that one process leaves for the next: the same answers, and nothing believed that is not right.

use rand::RngExt as _;
use serde_json::json;
use std::collections::HashMap;
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Barrier, Mutex};
use std::time::{Duration, SystemTime};
use volition::cache::{ByteStore, CacheStatistics, Key, Origins, ReadBytes, WriteBytes};
use volition::control::{Continuous, System, TransferFunction};
use volition::ctl::{Ctl, StopReason, Stopped};
use volition::identify::pool::{Degrees, PoolError, PoolSpec, Recipe};
use volition::identify::problem::{Lines, Problem};
use volition::identify::search::{Automatic, Method, Optimum, Search};
use volition::identify::ssid::plant_for;
use volition::num::{Complex64, rng};
use volition::worker::{Folder, PoolMemo};

/// A byte store in memory, which remembers everything that it was ever given.
#[derive(Debug, Default)]
struct Memory {
    kept: Mutex<HashMap<Key, Vec<Vec<u8>>>>,
}

impl ByteStore for Memory {
    fn load(&self, key: &Key, read: &mut ReadBytes<'_>) -> bool {
        let Some(bytes) = self.kept.lock().unwrap().get(key).and_then(|all| all.last().cloned()) else { return false };
        let mut from = &bytes[..];
        read(&mut from, bytes.len() as u64).is_ok() && from.is_empty()
    }

    fn save(&self, key: &Key, write: &mut WriteBytes<'_>) {
        let mut bytes = Vec::new();
        write(&mut bytes).unwrap();
        self.kept.lock().unwrap().entry(key.clone()).or_default().push(bytes);
    }
}

/// A pool on a plant, and trials on it.
struct Case {
    recipe: Recipe,
    plant: System,
    problems: Vec<Problem>,
}

/// Trials that no candidate fits.
fn case(name: &str, thin: serde_json::Value, lines: u32, seed: u64) -> Case {
    let spec: PoolSpec = serde_json::from_value(json!({"name": name, "thin": thin})).unwrap();
    let recipe = spec.check(Degrees::default()).unwrap();
    let mut random = rng::stream(seed, "kept");
    let mut draw = || random.random::<f64>();
    let plant = TransferFunction::new(&[2.0, 3.0 + 2.0 * draw()], &[1.0, 1.5 + draw(), 4.0], Continuous).unwrap();
    let plant = plant_for(&recipe, &System::Continuous(plant), Some(0.02)).unwrap();
    let step = 0.025 + 0.01 * draw();
    let omega: Vec<f64> = (0..lines).map(|k| std::f64::consts::TAU * (0.08 + step * f64::from(k))).collect();
    let problems = (0..2).map(|_| {
        let h: Vec<Complex64> = omega
            .iter()
            .map(|w| {
                let noise = Complex64::new(0.1 * (draw() - 0.5), 0.1 * (draw() - 0.5));
                0.9 / (1.0 + Complex64::new(0.0, 0.4 * w)) + noise
            })
            .collect();
        Problem::new(&Lines::new(&plant, &omega, &h, None), recipe.feedforward_numerator_degree).unwrap()
    });
    Case { problems: problems.collect(), plant, recipe }
}

/// Appendix B, listed and clustered, some thousand clusters.
fn listed(seed: u64) -> Case {
    case(
        "zhang2015_appendix_b",
        json!({"poles": 8, "feedforward_poles": 6, "zeros": 8, "damping": 4, "gains": 2}),
        9,
        seed,
    )
}

/// Appendix C, as products.
fn products(seed: u64) -> Case {
    case("zhang2015_appendix_c", json!({"poles": 9, "zeros": 9, "damping": 3, "gains": 2}), 7, seed)
}

/// The answers to the trials of a case, by whoever shares this.
fn answers(case: &Case, pools: &PoolMemo) -> Vec<Optimum> {
    let search = Automatic { method: Method::BranchAndBound, pools };
    let ctl = Ctl::new();
    let answer = |problem: &Problem| {
        let pool = search.pool(&case.recipe, &case.plant, &ctl).unwrap();
        assert!(pool.size() > 200_000, "{} candidates are searched without trees", pool.size());
        assert!(case.recipe.combinations() > 200_000, "{} combinations are counted anew", case.recipe.combinations());
        let found = search.search(problem, &pool, &ctl).unwrap();
        // How much was looked at depends on which thread found what first.
        Optimum { evaluated: 0, bounded: 0, decided_by_qr: 0, ..found }
    };
    case.problems.iter().map(answer).collect()
}

const MADE: CacheStatistics = CacheStatistics {
    pools: Origins { memory: 1, store: 0, made: 1 },
    trees: Origins { memory: 1, store: 0, made: 1 },
};
const READ: CacheStatistics = CacheStatistics {
    pools: Origins { memory: 1, store: 1, made: 0 },
    trees: Origins { memory: 1, store: 1, made: 0 },
};

#[test]
fn what_was_kept_gives_the_same_answer_and_the_same_bytes() {
    for (make, seeds) in [(listed as fn(u64) -> Case, 0..3), (products, 3..5)] {
        for seed in seeds {
            let case = make(seed);
            let memory = Arc::new(Memory::default());
            let first = PoolMemo::with_store(Arc::<Memory>::clone(&memory));
            let expected = answers(&case, &first);
            assert_eq!(first.statistics(), MADE, "seed {seed}");
            assert_eq!(answers(&case, &PoolMemo::default()), expected, "without a store, seed {seed}");

            let second = PoolMemo::with_store(Arc::<Memory>::clone(&memory));
            assert_eq!(answers(&case, &second), expected, "seed {seed}");
            assert_eq!(second.statistics(), READ, "seed {seed}");

            // What was read and is written again is the same, and so is what is made a second time.
            let again = Arc::new(Again { from: Arc::clone(&memory), into: Memory::default() });
            answers(&case, &PoolMemo::with_store(Arc::<Again>::clone(&again)));
            let made: HashMap<Key, Vec<Vec<u8>>> = memory.kept.lock().unwrap().clone();
            assert_eq!(made.len(), 2, "counts and trees");
            assert_eq!(*again.into.kept.lock().unwrap(), made, "seed {seed}");
        }
    }
}

/// Has nothing, and keeps what it is given elsewhere.
#[derive(Debug)]
struct Again {
    from: Arc<Memory>,
    into: Memory,
}

impl ByteStore for Again {
    fn load(&self, key: &Key, _: &mut ReadBytes<'_>) -> bool {
        assert!(self.from.kept.lock().unwrap().contains_key(key), "the same key is asked for");
        false
    }

    fn save(&self, key: &Key, write: &mut WriteBytes<'_>) {
        self.into.save(key, write);
    }
}

#[test]
fn other_plants_lines_degrees_and_recipes_have_other_trees() {
    let memory = Arc::new(Memory::default());
    let ask = |case: &Case| {
        let memo = PoolMemo::with_store(Arc::<Memory>::clone(&memory));
        answers(case, &memo);
        memo.statistics()
    };
    let one = products(3);
    assert_eq!(ask(&one), MADE);
    // Another plant, and other lines.
    assert_eq!(ask(&products(4)), MADE);
    let fewer = {
        let omega = [0.6, 0.9, 1.3, 1.7, 2.2, 2.9];
        let h = omega.map(|w| 0.9 / (1.0 + Complex64::new(0.0, 0.4 * w)));
        let problem = Problem::new(&Lines::new(&one.plant, &omega, &h, None), 2).unwrap();
        Case { recipe: one.recipe.clone(), plant: one.plant.clone(), problems: vec![problem.clone(), problem] }
    };
    let statistics = ask(&fewer);
    assert_eq!((statistics.pools, statistics.trees), (READ.pools, MADE.trees), "the same pool at other lines");
    let mut gains = one.recipe.clone();
    gains.gains.pop();
    assert_eq!(ask(&Case { recipe: gains, ..products(3) }), MADE);
    assert_eq!(ask(&one), READ);
}

#[test]
fn a_search_that_is_stopped_keeps_nothing_and_says_so() {
    let case = listed(0);
    let memory = Arc::new(Memory::default());
    answers(&case, &PoolMemo::with_store(Arc::<Memory>::clone(&memory)));
    let memo = PoolMemo::with_store(Arc::<Memory>::clone(&memory));
    let search = Automatic { method: Method::BranchAndBound, pools: &memo };
    let ctl = Ctl::new();
    ctl.stop(StopReason::Shutdown);
    let stopped = Stopped(StopReason::Shutdown);
    assert_eq!(search.pool(&case.recipe, &case.plant, &ctl).unwrap_err(), PoolError::Stopped(stopped));
    let pool = search.pool(&case.recipe, &case.plant, &Ctl::new()).unwrap();
    assert_eq!(search.search(&case.problems[0], &pool, &ctl).unwrap_err(), stopped);
    assert_eq!(memo.statistics().trees, Origins::default());
    assert!(memory.kept.lock().unwrap().values().all(|saved| saved.len() == 1));
}

/// The files of the cache, with how many bytes they have, and nothing else that may lie there.
fn kept(folder: &Path) -> Vec<(PathBuf, u64)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.extension().and_then(|ending| ending.to_str()) {
            Some("kept") => found.push((path.clone(), fs::metadata(&path).unwrap().len())),
            Some("TAG") => {}
            _ => panic!("{} is left behind", path.display()),
        }
    }
    found.sort();
    found
}

fn in_folder(path: &Path, most_bytes: u64) -> PoolMemo {
    PoolMemo::with_store(Arc::new(Folder::new(path, most_bytes)))
}

#[test]
fn a_folder_keeps_pools_and_trees_for_the_next_process() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep/cache");
    for case in [listed(1), products(4)] {
        let first = in_folder(&path, 1 << 30);
        let expected = answers(&case, &first);
        assert_eq!(first.statistics(), MADE);
        let second = in_folder(&path, 1 << 30);
        assert_eq!(answers(&case, &second), expected);
        assert_eq!(second.statistics(), READ);
    }
    assert_eq!(kept(&path).len(), 4);
}

/// Something small by key, through the store's own interface.
fn put(folder: &Folder, key: &Key, text: &[u8]) {
    folder.save(key, &mut |to: &mut dyn Write| to.write_all(text));
}

fn get(folder: &Folder, key: &Key) -> Option<Vec<u8>> {
    let mut text = Vec::new();
    let mut read = |from: &mut (dyn Read + Send), length: u64| -> io::Result<()> {
        from.take(length).read_to_end(&mut text).map(drop)
    };
    folder.load(key, &mut read).then_some(text)
}

/// Keys that a search asked for.
fn keys() -> Vec<Key> {
    let memory = Arc::new(Memory::default());
    for seed in [3, 4] {
        answers(&products(seed), &PoolMemo::with_store(Arc::<Memory>::clone(&memory)));
    }
    let mut keys: Vec<Key> = memory.kept.lock().unwrap().keys().cloned().collect();
    keys.sort_by_key(Key::hexadecimal);
    assert_eq!(keys.len(), 4);
    keys
}

#[test]
fn a_damaged_file_is_never_believed() {
    let keys = keys();
    let folder = tempfile::tempdir().unwrap();
    let store = Folder::new(folder.path(), 1 << 20);
    let text: Vec<u8> = (0..200).collect();
    put(&store, &keys[0], &text);
    assert_eq!(get(&store, &keys[0]), Some(text.clone()));
    let path = kept(folder.path())[0].0.clone();
    let whole = fs::read(&path).unwrap();
    for at in 0..whole.len() {
        for flip in [1, 0x80, 0xff] {
            let mut damaged = whole.clone();
            damaged[at] ^= flip;
            fs::write(&path, damaged).unwrap();
            assert_eq!(get(&store, &keys[0]), None, "byte {at}");
        }
        fs::write(&path, &whole[..at]).unwrap();
        assert_eq!(get(&store, &keys[0]), None, "cut at {at}");
    }
    let longer: Vec<u8> = whole.iter().copied().chain([0]).collect();
    for foreign in [longer, Vec::new(), vec![0; 500], whole[44..].to_vec()] {
        fs::write(&path, foreign).unwrap();
        assert_eq!(get(&store, &keys[0]), None);
    }
    // Whole, but of something else.
    fs::write(&path, &whole).unwrap();
    let other = path.with_file_name(format!("{}-{}.kept", keys[1].kind(), keys[1].hexadecimal()));
    fs::rename(&path, &other).unwrap();
    assert_eq!((get(&store, &keys[0]), get(&store, &keys[1])), (None, None));
    // Whoever reads less than everything, or cannot make sense of it, is not to believe it either.
    fs::rename(&other, &path).unwrap();
    assert!(!store.load(&keys[0], &mut |_, _| Ok(())));
    assert!(!store.load(&keys[0], &mut |from, length| {
        from.take(length).read_to_end(&mut Vec::new())?;
        Err(io::Error::other("nonsense"))
    }));
    // And it is replaced.
    fs::write(&path, b"nothing").unwrap();
    put(&store, &keys[0], &text);
    assert_eq!(get(&store, &keys[0]), Some(text));
    assert_eq!(kept(folder.path()).len(), 1);
}

#[test]
fn damaged_trees_are_made_again_and_replaced() {
    let mut random = rng::stream(11, "damage");
    for case in [listed(2), products(3)] {
        let folder = tempfile::tempdir().unwrap();
        let expected = answers(&case, &in_folder(folder.path(), 1 << 30));
        let whole: Vec<(PathBuf, Vec<u8>)> =
            kept(folder.path()).into_iter().map(|(path, _)| (path.clone(), fs::read(path).unwrap())).collect();
        for round in 0..6 {
            for (path, bytes) in &whole {
                let at = random.random_range(0..bytes.len());
                let mut damaged = bytes.clone();
                match round % 3 {
                    0 => damaged[at] ^= 1 << random.random_range(0..8),
                    1 => damaged.truncate(at),
                    _ => damaged[44..].fill(0xff),
                }
                fs::write(path, damaged).unwrap();
            }
            let memo = in_folder(folder.path(), 1 << 30);
            assert_eq!(answers(&case, &memo), expected);
            assert_eq!(memo.statistics(), MADE, "round {round}");
            for (path, bytes) in &whole {
                assert!(fs::read(path).unwrap() == *bytes, "{} is whole again", path.display());
            }
        }
    }
}

/// The bytes that a tree is made of are damaged behind a hash that is right: nothing of the kind comes from a disk, but
/// reading must neither panic nor ask for more memory than the bytes justify.
#[test]
fn no_bytes_make_the_reader_panic() {
    let mut random = rng::stream(12, "bytes");
    for case in [listed(0), products(3)] {
        let memory = Arc::new(Memory::default());
        answers(&case, &PoolMemo::with_store(Arc::<Memory>::clone(&memory)));
        let whole = memory.kept.lock().unwrap().clone();
        let mut refused = 0;
        for round in 0..60 {
            for (key, saved) in whole.iter().filter(|(key, _)| key.kind() == "trees") {
                let mut bytes = saved[0].clone();
                // Lengths stand near the beginning; further on it is numbers mostly.
                let reach = if round % 2 == 0 { bytes.len().min(64) } else { bytes.len() };
                let at = random.random_range(0..reach);
                match round % 5 {
                    0 | 1 => bytes[at] ^= 1 << random.random_range(0..8),
                    2 | 3 => bytes[at..].iter_mut().take(8).for_each(|b| *b = 0xff),
                    _ => bytes.truncate(at),
                }
                memory.kept.lock().unwrap().insert(key.clone(), vec![bytes]);
            }
            let ctl = Arc::new(Ctl::new());
            let stopping = Arc::new(Stopping { memory: Arc::clone(&memory), ctl: Arc::clone(&ctl), refused: 0.into() });
            let memo = PoolMemo::with_store(Arc::<Stopping>::clone(&stopping));
            let search = Automatic { method: Method::BranchAndBound, pools: &memo };
            let pool = search.pool(&case.recipe, &case.plant, &ctl).unwrap();
            let stopped = search.search(&case.problems[0], &pool, &ctl).unwrap_err();
            assert_eq!(stopped, Stopped(StopReason::Cancelled));
            refused += stopping.refused.load(Ordering::SeqCst);
        }
        assert!(refused > 10, "{refused} of 60 were refused");
    }
}

/// Ends a search as soon as its trees have been read: over trees that make no sense it would mean nothing.
#[derive(Debug)]
struct Stopping {
    memory: Arc<Memory>,
    ctl: Arc<Ctl>,
    refused: AtomicUsize,
}

impl ByteStore for Stopping {
    fn load(&self, key: &Key, read: &mut ReadBytes<'_>) -> bool {
        let believed = self.memory.load(key, read);
        if key.kind() == "trees" {
            self.refused.fetch_add(usize::from(!believed), Ordering::SeqCst);
            self.ctl.stop(StopReason::Cancelled);
        }
        believed
    }

    fn save(&self, _: &Key, _: &mut WriteBytes<'_>) {}
}

#[test]
fn two_that_make_the_same_at_once_are_both_right() {
    let case = listed(1);
    let folder = tempfile::tempdir().unwrap();
    let expected = answers(&case, &PoolMemo::default());
    let together = Barrier::new(2);
    std::thread::scope(|scope| {
        let both: Vec<_> = (0..2)
            .map(|_| {
                scope.spawn(|| {
                    // As two processes have it: a folder each, with nothing in common but the path.
                    let memo = in_folder(folder.path(), 1 << 30);
                    together.wait();
                    answers(&case, &memo)
                })
            })
            .collect();
        for one in both {
            assert_eq!(one.join().unwrap(), expected);
        }
    });
    assert_eq!(kept(folder.path()).len(), 2);
    let third = in_folder(folder.path(), 1 << 30);
    assert_eq!(answers(&case, &third), expected);
    assert_eq!(third.statistics(), READ);
}

#[test]
fn what_was_not_used_for_longest_goes_first() {
    let keys = keys();
    let folder = tempfile::tempdir().unwrap();
    // Room for three files of 276 bytes.
    let store = Folder::new(folder.path(), 900);
    let age = |key: &Key, minutes: u64| {
        let path = folder.path().join(format!("{}-{}.kept", key.kind(), key.hexadecimal()));
        let file = fs::File::options().write(true).open(path).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(60 * minutes)).unwrap();
    };
    for (key, minutes) in keys[..3].iter().zip([30, 20, 10]) {
        put(&store, key, &[7; 200]);
        age(key, minutes);
    }
    assert_eq!(kept(folder.path()).len(), 3);
    // The oldest is used, so the second oldest goes.
    assert!(get(&store, &keys[0]).is_some());
    let left_over = folder.path().join("dead.unfinished");
    fs::write(&left_over, [0; 100]).unwrap();
    fs::File::options().write(true).open(&left_over).unwrap().set_modified(SystemTime::UNIX_EPOCH).unwrap();
    fs::write(folder.path().join("notes.TAG"), [0; 2000]).unwrap();
    put(&store, &keys[3], &[7; 200]);
    let there: Vec<bool> = keys.iter().map(|key| get(&store, key).is_some()).collect();
    assert_eq!(there, [true, false, true, true]);
    assert!(!left_over.exists(), "what a dead process left goes too");
    assert!(folder.path().join("notes.TAG").exists(), "what is not ours stays");
    // One that is larger than everything may be is not kept, and pushes nothing out.
    put(&store, &keys[1], &[7; 1000]);
    assert_eq!((get(&store, &keys[1]), kept(folder.path()).len()), (None, 3));
    // In place of itself it needs no more room.
    put(&store, &keys[3], &[8; 200]);
    assert_eq!(kept(folder.path()).len(), 3);
}

#[test]
fn without_a_folder_to_write_to_everything_works_as_before() {
    let case = products(3);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a file");
    fs::write(&file, "in the way").unwrap();
    for path in [file.clone(), file.join("below"), PathBuf::from("/proc/volition-cannot-write-here")] {
        let memo = in_folder(&path, 1 << 30);
        assert_eq!(answers(&case, &memo), answers(&case, &PoolMemo::default()));
        assert_eq!(memo.statistics(), MADE);
    }
    assert_eq!(fs::read_to_string(&file).unwrap(), "in the way");
    // A disk that is full in the middle of a file leaves nothing behind.
    let full = folder.path().join("full");
    let memo = in_folder(&full, 10_000);
    answers(&case, &memo);
    assert!(kept(&full).iter().all(|(_, bytes)| *bytes <= 10_000));
}
