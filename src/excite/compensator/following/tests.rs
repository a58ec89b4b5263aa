use super::*;
use crate::ctl::Ctl;
use crate::excite::compensator::{Design, DesignLimits};
use crate::num::rng::stream;
use rand::RngExt as _;

/// Peaks of random stable loops against the simulation sample by sample, of references with and without pieces.
#[test]
fn peaks_are_those_of_the_simulation() {
    let time = Discrete::new(0.01).unwrap();
    let mut random = stream(20_261_130, "compensator/following");
    let chips: Vec<f64> = (0..60).map(|_| f64::from(random.random_range(-1..=1_i32))).collect();
    let held: Vec<f64> = chips.iter().flat_map(|r| [0.02 * r; 20]).collect();
    let free: Vec<f64> = (0..600).map(|k| 0.02 * (0.07 * f64::from(k)).sin() + 1e-3 * random.random::<f64>()).collect();
    for reference in [held, free] {
        for plant in [
            SampledPlant::mass_damper(10.0, 50.0, time).unwrap(),
            SampledPlant::mass_damper(10.0, 50.0, time).unwrap().delayed(0.034).unwrap(),
        ] {
            let following = Following::new(&plant, reference.clone()).unwrap();
            let design = Design::new(plant, &[1.0, 2.0], &[1.0, 1.0], reference.clone());
            let mut looked = 0;
            for _ in 0..400 {
                let mut log = |low: f64, high: f64| (low.ln() + (high / low).ln() * random.random::<f64>()).exp();
                let gain = log(10.0, 4000.0);
                let first = Section::First { zero_hz: log(0.05, 20.0), pole_hz: log(0.05, 20.0) };
                let second = Section::Second {
                    zero_hz: log(0.2, 20.0),
                    zero_damping: log(0.1, 2.0),
                    pole_hz: log(0.2, 20.0),
                    pole_damping: log(0.1, 2.0),
                };
                let sections = [vec![], vec![first], vec![second], vec![first, second]];
                let sections = sections[random.random_range(0..4_usize)].clone();
                let compensator = Compensator { gain, sections };
                if !design.is_stable(&compensator, 0.05) {
                    continue;
                }
                looked += 1;
                let judged = design.judge(&compensator, &DesignLimits::default(), &Ctl::new()).unwrap();
                let found = following.with(&compensator).unwrap();
                let motion = judged.motion;
                for (limited, expected) in [
                    (Limited::Force, motion.force),
                    (Limited::Position, motion.position),
                    (Limited::Velocity, motion.velocity),
                    (Limited::Acceleration, motion.acceleration),
                    (Limited::Power, motion.power),
                ] {
                    if !following.knows(limited) {
                        continue;
                    }
                    let (peak, expected) = (found.peak(limited, f64::INFINITY), expected.unwrap().peak);
                    let error = (peak / expected - 1.0).abs();
                    // The reference is a filter in powers of z, whose rounded coefficients move peaks by some 1e-8.
                    assert!(error < 1e-7, "{limited:?} {peak} {expected} {compensator:?}");
                    // Enough is enough.
                    assert!(found.peak(limited, 0.5 * expected) > 0.5 * expected);
                    assert!(found.peak(limited, 0.999_999 * peak) > 0.999_999 * peak);
                    assert!(found.peak(limited, 1.000_001 * peak) <= peak);
                }
            }
            assert!(looked > 30, "{looked}");
        }
    }
}
