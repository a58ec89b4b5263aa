//! Pools and trees that another process left, with bytes changed and the end cut off: whatever stands there is read
//! without a panic and without more memory than the file is long, before its checksum decides that it is not believed.
#![no_main]

use libfuzzer_sys::fuzz_target;
use serde_json::json;
use std::collections::HashMap;
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex, OnceLock};
use volition::cache::{ByteStore, Key, ReadBytes, WriteBytes};
use volition::control::{Continuous, System, TransferFunction};
use volition::ctl::{Ctl, StopReason};
use volition::identify::pool::{Degrees, Pool, PoolSpec, Recipe};
use volition::identify::problem::{Lines, Problem};
use volition::identify::search::{Automatic, Method, Search};
use volition::identify::ssid::plant_for;
use volition::num::Complex64;
use volition::worker::PoolMemo;

/// What a search keeps.
#[derive(Debug, Default)]
struct Kept(Mutex<HashMap<Key, Vec<u8>>>);

impl ByteStore for Kept {
    fn load(&self, _: &Key, _: &mut ReadBytes<'_>) -> bool {
        false
    }

    fn save(&self, key: &Key, write: &mut WriteBytes<'_>) {
        let mut bytes = Vec::new();
        write(&mut bytes).unwrap();
        self.0.lock().unwrap().insert(key.clone(), bytes);
    }
}

/// Gives it back with changes, and stops whoever reads it before anything large is made anew.
#[derive(Debug)]
struct Edited {
    edits: Vec<u8>,
    ctl: Arc<Ctl>,
}

impl ByteStore for Edited {
    fn load(&self, key: &Key, read: &mut ReadBytes<'_>) -> bool {
        let mut bytes = Case::get().kept.0.lock().unwrap()[key].clone();
        let (cut, edits) = self.edits.split_at(self.edits.len().min(2));
        for edit in edits.chunks_exact(4) {
            let at = usize::from(u16::from_le_bytes([edit[0], edit[1]])) % bytes.len();
            // Lengths stand near the beginning, and are of eight bytes.
            let many = if edit[2] % 2 == 0 { 1 } else { 8 };
            bytes[at..].iter_mut().take(many).for_each(|byte| *byte ^= edit[3]);
        }
        if let [low, high] = cut {
            bytes.truncate(bytes.len().saturating_sub(usize::from(u16::from_le_bytes([*low, *high]))));
        }
        let mut from = &bytes[..];
        let _ = read(&mut from, bytes.len() as u64);
        self.ctl.stop(StopReason::Cancelled);
        false
    }

    fn save(&self, _: &Key, _: &mut WriteBytes<'_>) {}
}

struct Case {
    recipe: Recipe,
    plant: System,
    pool: Arc<Pool>,
    problem: Problem,
    kept: Arc<Kept>,
    /// Index and cost of the best candidate.
    best: (u64, f64),
}

impl Case {
    fn get() -> &'static Self {
        static CASE: OnceLock<Case> = OnceLock::new();
        CASE.get_or_init(|| {
            let thin = json!({"poles": 9, "zeros": 9, "damping": 3, "gains": 2});
            let spec = json!({"name": "zhang2015_appendix_c", "thin": thin});
            let recipe = serde_json::from_value::<PoolSpec>(spec).unwrap().check(Degrees::default()).unwrap();
            let plant = TransferFunction::new(&[2.0, 4.0], &[1.0, 2.0, 4.0], Continuous).unwrap();
            let plant = plant_for(&recipe, &System::Continuous(plant), Some(0.02)).unwrap();
            let omega: Vec<f64> = (0..7).map(|k| TAU * (0.08 + 0.03 * f64::from(k))).collect();
            let h: Vec<Complex64> = omega.iter().map(|w| 0.9 / Complex64::new(1.0, 0.4 * w)).collect();
            let lines = Lines::new(&plant, &omega, &h, None);
            let problem = Problem::new(&lines, recipe.feedforward_numerator_degree).unwrap();
            let kept = Arc::new(Kept::default());
            let memo = PoolMemo::with_store(Arc::<Kept>::clone(&kept));
            let search = Automatic { method: Method::BranchAndBound, pools: &memo };
            let pool = search.pool(&recipe, &plant, &Ctl::new()).unwrap();
            let best = search.search(&problem, &pool, &Ctl::new()).unwrap();
            let best = (best.index, best.cost);
            assert_eq!(kept.0.lock().unwrap().len(), 2, "counts and trees");
            Self { recipe, plant, pool, problem, kept, best }
        })
    }
}

fuzz_target!(|data: &[u8]| {
    let case = Case::get();
    for of_pool in [true, false] {
        let ctl = Arc::new(Ctl::new());
        let edited = Edited { edits: data.to_vec(), ctl: Arc::clone(&ctl) };
        let memo = PoolMemo::with_store(Arc::new(edited));
        let search = Automatic { method: Method::BranchAndBound, pools: &memo };
        // Whoever ends all the same, before looking whether to stop, found what stands in no file.
        if of_pool {
            let found = search.pool(&case.recipe, &case.plant, &ctl);
            assert!(found.is_err() || found.is_ok_and(|pool| pool.size() == case.pool.size()));
        } else {
            let found = search.search(&case.problem, &case.pool, &ctl);
            assert!(found.is_err() || found.is_ok_and(|found| (found.index, found.cost) == case.best));
        }
    }
});
