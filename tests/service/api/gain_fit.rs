//! From simulated people to the cost that they minimise, over HTTP.

use crate::api::harness::TestServer;
use nalgebra::DMatrix;
use rand::RngExt;
use rand_distr::StandardNormal;
use serde_json::{Value, json};
use volition::control::lqg::lqr;
use volition::control::lyapunov::Clock;
use volition::control::parametric::Realisation;
use volition::control::{Continuous, Discrete, StateSpace};
use volition::num::rng;
use volition::person::state_feedback::{Path, PlantModel, close};
use volition::plants::SeatedBalance;
use volition::plants::seated_balance::{Structure, Values};

/// The weights of the simulated person: `Q = 1e4 I`, `R = 1`.
const WEIGHT: f64 = 1e4;

/// Trials of 30 s on the wobble chair at Table 5.1, by a person without delay who minimises [`WEIGHT`]; a binary torque
/// of ±6 N m as in Priess 2015, §5.2, and noise of 0.5 mrad on both angles. The gain comes too.
fn people(trials: usize, seed: u64) -> (Vec<Value>, DMatrix<f64>) {
    let structure = Structure { delay_order: 0, muscle_lag: false, ..Structure::default() };
    let plant = SeatedBalance::new(structure, Values::table_5_1(), Vec::new()).unwrap();
    let plant = PlantModel::plant::<f64>(&plant, &[]);
    let q = DMatrix::identity(4, 4) * WEIGHT;
    let k = lqr(&plant.a, &plant.b, &q, &DMatrix::identity(1, 1), Clock::Continuous).unwrap().k;
    let closed = close(&plant, &k, &Path::direct());
    let model = StateSpace::new(closed.a, closed.b, closed.c, closed.d, Continuous).unwrap();
    let model = Realisation { model, initial: closed.initial }.sampled(Discrete::new(0.1).unwrap()).unwrap();
    let mut stream = rng::stream(seed, "people on a wobble chair");
    let trials = (0..trials)
        .map(|_| {
            let mut value = 6.0;
            let input = DMatrix::from_fn(300, 1, |i, _| {
                if i % 5 == 0 {
                    value = if stream.random::<bool>() { 6.0 } else { -6.0 };
                }
                value
            });
            let clean = model.respond(&input).unwrap();
            let noisy = clean.map(|v| v + 5e-4 * stream.sample::<f64, _>(StandardNormal));
            let output: Vec<[f64; 2]> = noisy.row_iter().map(|row| [row[0], row[1]]).collect();
            json!({"sample_time_s": 0.1, "input": input.as_slice(), "output": output})
        })
        .collect();
    (trials, k)
}

/// Shares of the true cost along the noise-free trajectories of the trials.
fn true_shares(trials: &Value, k: &DMatrix<f64>) -> Vec<f64> {
    let structure = Structure { delay_order: 0, muscle_lag: false, ..Structure::default() };
    let plant = SeatedBalance::new(structure, Values::table_5_1(), Vec::new()).unwrap();
    let plant = PlantModel::plant::<f64>(&plant, &[]);
    let closed = &plant.a - &plant.b * k;
    let n = closed.nrows();
    let (c, d) = (DMatrix::identity(n, n), DMatrix::zeros(n, 1));
    let model = StateSpace::new(closed, plant.e.clone(), c, d, Continuous).unwrap();
    let model =
        Realisation { model, initial: nalgebra::DVector::zeros(n) }.sampled(Discrete::new(0.1).unwrap()).unwrap();
    let mut paid = vec![0.0; n + 1];
    for trial in trials.as_array().unwrap() {
        let input: Vec<f64> = serde_json::from_value(trial["input"].clone()).unwrap();
        let x = model.respond(&DMatrix::from_column_slice(input.len(), 1, &input)).unwrap();
        for (i, cost) in paid.iter_mut().take(n).enumerate() {
            *cost += WEIGHT * x.column(i).norm_squared();
        }
        paid[n] += (&x * k.transpose()).norm_squared();
    }
    let total: f64 = paid.iter().sum();
    paid.iter().map(|v| v / total).collect()
}

async fn report(server: &TestServer, request: &Value) -> Value {
    let queued = server.post("/v1/analyses", request).await;
    assert_eq!(queued.json(202)["status"], "queued");
    let path = queued.header("location").to_owned();
    server.work().await;
    let finished = server.get(&path).await.json(200);
    assert_eq!(finished["status"], "succeeded", "{finished}");
    assert_eq!(finished["progress"]["done"], finished["progress"]["total"]);
    server.get(&format!("{path}/report")).await.json(200)
}

fn codes(report: &Value) -> Vec<&str> {
    report["warnings"].as_array().unwrap().iter().map(|w| w["code"].as_str().unwrap()).collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[tokio::test]
async fn trials_go_in_and_the_cost_used_comes_out_with_an_interval_that_covers_it() {
    let server = TestServer::start().await;
    let (trials, k) = people(4, 21);
    let request = json!({
        "kind": "gain_fit",
        "inputs": {"plant": {"name": "seated_balance"}, "trials": trials},
        "spec": {"optimality": {"state_weight": "diagonal", "draws": 200}}
    });
    let fitted = report(&server, &request).await;
    let result = &fitted["result"];
    assert_eq!(fitted["schema"], "volition.gain_fit/3");
    assert_eq!(codes(&fitted), Vec::<&str>::new());
    assert_eq!(result["convergence"]["converged"], true);
    assert!(number(&result["convergence"]["remaining_step"]) < 1e-2);
    for (i, name) in ["k1", "k2", "k3", "k4"].into_iter().enumerate() {
        let parameter = &result["parameters"][i];
        assert_eq!(parameter["name"], name);
        let [low, high] = [0, 1].map(|end| number(&parameter["interval"][end]));
        assert!(low < k[i] && k[i] < high && high - low < 0.5 * k[i], "{name} is {}: {parameter}", k[i]);
    }
    for output in result["outputs"].as_array().unwrap() {
        assert!((number(&output["noise_sd"]) / 5e-4 - 1.0).abs() < 0.1 && number(&output["fit_percent"]) > 90.0);
    }
    let optimality = &result["optimality"];
    assert_eq!(optimality["verdict"], "feasible");
    assert!(number(&optimality["probability"]) > 0.9, "{optimality}");
    let [low, high] = [0, 1].map(|end| number(&optimality["probability_interval"][end]));
    assert!(low < number(&optimality["probability"]) && high <= 1.0);
    assert_eq!(optimality["r"]["estimate"], json!([[1.0]]));
    for i in 0..4 {
        let [low, high] = ["lower", "upper"].map(|end| number(&optimality["q"][end][i][i]));
        assert!(low < WEIGHT && WEIGHT < high, "Q{i}{i}: {low} to {high}");
    }
    // What the person paid for along their own trials: each share sums to one, and the lower angle and the torque are
    // what the cost is made of.
    assert_eq!(optimality["trial_shares"].as_array().unwrap().len(), 4);
    let sum = |shares: &Value| -> f64 {
        ["states", "ports"].iter().flat_map(|part| shares[part].as_array().unwrap()).map(number).sum()
    };
    let truth = true_shares(&request["inputs"]["trials"], &k);
    for shares in optimality["trial_shares"].as_array().unwrap().iter().chain([&optimality["trajectory_shares"]]) {
        assert!((sum(shares) - 1.0).abs() < 1e-12, "{shares}");
    }
    for (i, expected) in truth.iter().take(4).enumerate() {
        let found = number(&optimality["trajectory_shares"]["states"][i]);
        assert!((found - expected).abs() < 0.05, "{i}: {found} {truth:?}");
    }
    assert_eq!(result["inverse_lqr_inputs"]["state_units"], json!(["rad", "rad/s", "rad", "rad/s"]));

    // The same question by hand, with the gain's covariance at hand for a fit.
    let inverse = json!({
        "kind": "inverse_lqr", "inputs": result["inverse_lqr_inputs"],
        "spec": {"state_weight": "diagonal",
                 "fit": {"gain_covariance": result["k_covariance"], "condition_numbers": [1e5]}}
    });
    let inverted = report(&server, &inverse).await;
    assert_eq!(inverted["result"]["verdict"], "feasible");
    let normalised = &inverted["result"]["reading"]["normalised_q"];
    for i in 0..4 {
        let by_hand = number(&normalised[i][i]);
        let here = number(&optimality["q"]["estimate"][i][i]);
        assert!((by_hand / here - 1.0).abs() < 1e-6, "{by_hand} {here}");
    }
    server.finish().await;
}

#[tokio::test]
async fn stored_trials_are_fitted_on_the_plant_they_were_recorded_on() {
    let server = TestServer::start().await;
    let study = server.study().await;
    let plant = json!({"name": "unstable", "model": {
        "a": [[0.0, 1.0], [2.0, 0.0]], "b": [[0.0], [1.0]], "c": [[1.0, 0.0]], "d": [[0.0]], "sample_time_s": null}});
    let plant = server.post(&format!("/v1/studies/{study}/plants"), &plant).await.id(201);
    let subject = server.subject(&study, "s01").await;
    let lab = crate::api::harness::Lab { study, plant, subject };
    let closed = StateSpace::new(
        DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 2.0 - 6.0, -3.0]),
        DMatrix::from_row_slice(2, 1, &[0.0, 1.0]),
        DMatrix::from_row_slice(2, 2, &[1.0, 0.0, -6.0, -3.0]),
        DMatrix::zeros(2, 1),
        Continuous,
    )
    .unwrap();
    let initial = nalgebra::DVector::from_vec(vec![0.3, -0.2]);
    let model = Realisation { model: closed, initial }.sampled(Discrete::new(0.02).unwrap()).unwrap();
    let mut stream = rng::stream(22, "stored");
    let push = DMatrix::from_fn(1000, 1, |i, _| if (i / 40) % 2 == 0 || (i / 90) % 3 == 0 { 1.0 } else { -1.0 });
    let response = model.respond(&push).unwrap();
    let mut csv = "t,r,u,y,d\n".to_owned();
    for i in 0..1000 {
        let y = response[(i, 0)] + 0.005 * stream.sample::<f64, _>(StandardNormal);
        csv.push_str(&format!("{:.2},0,{},{y},{}\n", i as f64 * 0.02, response[(i, 1)], push[(i, 0)]));
    }
    let trial = server.upload_csv(&lab, "&number=1&session=1", csv).await.id(201);
    let request = json!({"kind": "gain_fit", "inputs": {"trial": trial}, "spec": {"optimality": null}});
    let fitted = report(&server, &request).await;
    let result = &fitted["result"];
    for (i, truth) in [6.0, 3.0].into_iter().enumerate() {
        let parameter = &result["parameters"][i];
        let error = number(&parameter["standard_error"]);
        assert!((number(&parameter["value"]) - truth).abs() < 4.0 * error && error < 0.5, "{parameter}");
    }
    assert!((number(&result["initial_states"][0][0]) - 0.3).abs() < 0.02);
    assert!(result["optimality"].is_null());
    assert!(fitted["provenance"]["inputs_sha256"]["/inputs/trial"].is_string());
    server.finish().await;
}

#[tokio::test]
async fn nonsense_is_a_problem_that_names_its_place() {
    let server = TestServer::start().await;
    let (trials, _) = people(1, 23);
    let request = |plant: Value, spec: Value| -> Value {
        json!({"kind": "gain_fit", "inputs": {"plant": plant, "trials": trials}, "spec": spec})
    };
    let seated = json!({"name": "seated_balance"});
    for (request, place, words) in [
        (request(json!({"a": [[1, 2]], "b": [[1]]}), json!({})), "/inputs/plant/a", "A is 1x2 and must be square"),
        (request(json!({"a": [[1e300]], "b": [[1]]}), json!({})), "/inputs/plant/a/0/0", "1e300"),
        (request(seated.clone(), json!({"free": ["k_x"]})), "/spec/free/0", "k_x"),
        (request(seated.clone(), json!({"bounds": {"k1": [5, 4]}})), "/spec/bounds/k1", "cross"),
        (
            request(json!({"name": "seated_balance", "outputs": ["bend"]}), json!({})),
            "/inputs/trials/0/output",
            "must have 1",
        ),
    ] {
        let problem = server.post("/v1/analyses", &request).await.problem(422, "invalid");
        assert_eq!(problem["where"], place, "{problem}");
        assert!(problem["detail"].as_str().unwrap().contains(words), "{problem}");
    }
    // What only the computation finds is a failed analysis with its reason.
    let request = request(seated, json!({"bounds": {"k3": [-2, -1]}}));
    let queued = server.post("/v1/analyses", &request).await;
    let path = queued.header("location").to_owned();
    server.work().await;
    let failed = server.get(&path).await.json(200);
    assert_eq!(failed["status"], "failed");
    assert_eq!(failed["problem"]["code"], "not_identifiable", "{failed}");
    server.finish().await;
}
