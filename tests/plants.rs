//! Simulated subjects and studies.
#![allow(clippy::unwrap_used)]
use volition::plants::catalogue::Plant;
use volition::plants::commands;
use volition::plants::{SimulatedStudy, SimulatedSubject};
#[test]
fn look() {
    for plant in Plant::ALL {
        for seed in 0..3 {
            let s = SimulatedSubject::new(&plant.transfer_function(), 0.02, seed).unwrap();
            let r = commands::chirp60(0.02);
            print!("{} K={:.3} ", plant.name(), s.feedback_gain());
            for n in [1, 2, 5, 10, 20, 40] {
                let t = s.trial(n, &r, None).unwrap();
                let e = t.error();
                let m = e.iter().map(|x| x.abs()).sum::<f64>() / e.len() as f64;
                let y = t.signals.output.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
                print!(" {n}:{m:.3}({y:.2})");
            }
            println!();
        }
    }
    let t = std::time::Instant::now();
    let study = SimulatedStudy::two_groups(11, 40, 1).unwrap();
    for g in &study.groups {
        let mut first = 0.0;
        let mut last = 0.0;
        for m in &g.members {
            for n in 1..=40 {
                let t = study.trial(m, n).unwrap();
                let e = t.error();
                let v = e.iter().map(|x| x.abs()).sum::<f64>() / e.len() as f64;
                if n == 1 {
                    first += v / 11.0;
                }
                if n == 40 {
                    last += v / 11.0;
                }
            }
        }
        println!("{} {first} {last}", g.name);
    }
    println!("{:?}", t.elapsed());
}
