//! Figures over HTTP.

use crate::api::harness::{Answer, TestServer, upload_simulated as upload};
use axum::http::header::IF_NONE_MATCH;
use resvg::tiny_skia::Pixmap;
use roxmltree::Document;
use serde_json::{Value, json};

/// The names that a thing lists, each of which must answer in every format, with the same numbers in CSV and JSON as in
/// the drawing.
async fn all_of(server: &TestServer, address: &str) -> Vec<String> {
    let list = server.get(&format!("{address}/figures")).await.json(200);
    let mut names = Vec::new();
    for entry in list["figures"].as_array().unwrap() {
        let (name, link) = (entry["name"].as_str().unwrap(), entry["link"].as_str().unwrap());
        assert_eq!(link, format!("{address}/figures/{name}"));
        let svg = server.get(link).await;
        assert_eq!((svg.status.as_u16(), svg.header("content-type")), (200, "image/svg+xml"), "{}", svg.text());
        let text = svg.text();
        let document = Document::parse(&text).unwrap_or_else(|error| panic!("{link}: {error}"));
        assert_eq!(document.root_element().attribute("data-figure"), Some(name));
        assert!(text.len() < 80_000, "{link} has {} bytes", text.len());
        let figure = server.get(&format!("{link}?format=json")).await.json(200);
        assert_eq!(figure["name"], name);
        for key in ["title", "description", "caption", "sampling"] {
            assert!(!figure[key].as_str().unwrap().is_empty(), "{link} has no {key}");
        }
        let numbers: usize = figure["panels"]
            .as_array()
            .unwrap()
            .iter()
            .flat_map(|panel| panel["series"].as_array().unwrap())
            .map(|series| series["x"].as_array().unwrap().len())
            .sum();
        let csv = server.get(&format!("{link}?format=csv")).await;
        assert_eq!(csv.header("content-type"), "text/csv; charset=utf-8; header=present");
        assert_eq!(csv.text().lines().count(), numbers + 1, "{link}");
        let png = server.get(&format!("{link}?format=png&w=320&theme=dark")).await;
        assert_eq!(png.header("content-type"), "image/png");
        assert_eq!(Pixmap::decode_png(&png.bytes).unwrap().width(), 640);
        names.push(name.to_owned());
    }
    names
}

fn etag(answer: &Answer) -> String {
    answer.header("etag").to_owned()
}

#[tokio::test]
async fn trials_are_drawn_as_svg_png_csv_and_json() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = upload(&server, &lab, 1, 1).await;
    let address = format!("/v1/trials/{trial}");
    assert_eq!(all_of(&server, &address).await, ["signals", "plant_check", "spectra"]);

    let signals = format!("{address}/figures/signals");
    let figure = server.get(&format!("{signals}?format=json&from=10&to=12.5&w=299")).await.json(200);
    assert_eq!(figure["x"]["range"], json!([10.0, 12.5]));
    let output = &figure["panels"][0]["series"][1];
    assert_eq!((&output["name"], &output["ink"]), (&json!("y"), &json!("output")));
    // 51 samples from 10 s to 12.5 s, and one beyond each end.
    assert_eq!(output["x"].as_array().unwrap().len(), 53);
    assert_eq!(figure["sampling"], "all 51 samples");
    let whole = server.get(&format!("{address}/signals")).await.text();
    let at = whole.lines().next().unwrap().split(',').position(|name| name == "y").unwrap();
    let row: Vec<&str> = whole.lines().nth(1 + 200).unwrap().split(',').collect();
    assert_eq!(output["y"][1].as_f64().unwrap(), row[at].parse::<f64>().unwrap());
    assert_eq!(output["x"][1], 10.0);
    assert!(figure["caption"].as_str().unwrap().contains("s01, trial 1 on gm: 1201 samples"), "{figure:.400}");
    let check = server.get(&format!("{address}/figures/plant_check?format=json")).await.json(200);
    assert!(check["description"].as_str().unwrap().starts_with("y follows from G·u"), "{check:.400}");
    server.finish().await;
}

#[tokio::test]
async fn drawings_have_tags_that_follow_what_is_drawn() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = upload(&server, &lab, 1, 1).await;
    for address in
        [format!("/v1/trials/{trial}/figures/signals"), format!("/v1/studies/{}/figures/rms_error", lab.study)]
    {
        let first = server.get(&address).await;
        let again = server.send(server.request("GET", &address).header(IF_NONE_MATCH, etag(&first))).await;
        assert_eq!((again.status.as_u16(), again.bytes.len()), (304, 0), "{address}");
        let mut tags = vec![etag(&first)];
        for query in ["?format=json", "?theme=dark", "?theme=page", "?w=400", "?from=0.5", "?to=0.9"] {
            tags.push(etag(&server.get(&format!("{address}{query}")).await));
        }
        // 710 and 720 are one width.
        assert_eq!(etag(&server.get(&format!("{address}?w=710")).await), tags[0]);
        let count = tags.len();
        tags.sort();
        tags.dedup();
        assert_eq!(tags.len(), count, "{address}: {tags:?}");
        // The caption or a note has the subject's code.
        let body = json!({"code": format!("x{}", tags.len())});
        let code = server.patch(&format!("/v1/subjects/{}", lab.subject), &body).await;
        assert_eq!(code.status.as_u16(), 200);
        assert_ne!(etag(&server.get(&address).await), etag(&first), "{address}");
        server.patch(&format!("/v1/subjects/{}", lab.subject), &json!({"code": "s01"})).await.json(200);
    }
    server.finish().await;
}

#[tokio::test]
async fn what_cannot_be_drawn_is_said_with_its_place() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = upload(&server, &lab, 1, 1).await;
    let signals = format!("/v1/trials/{trial}/figures/signals");
    for (query, status, code, place) in [
        ("format=pdf", 400, "malformed", "query parameter format"),
        ("w=279", 400, "malformed", "query parameter w"),
        ("w=2001", 400, "malformed", "query parameter w"),
        ("w=wide", 400, "malformed", "query parameter w"),
        ("theme=sepia", 400, "malformed", "query parameter theme"),
        ("from=nan", 400, "malformed", "query parameter from"),
        ("width=400", 400, "malformed", "query parameter width"),
        ("from=5&to=5", 422, "invalid", "query parameter to"),
        ("from=61", 422, "invalid", "query parameter to"),
        ("from=70&to=80", 422, "invalid", "query parameter from"),
        ("format=png&theme=page", 422, "invalid", "query parameter theme"),
    ] {
        let problem = server.get(&format!("{signals}?{query}")).await.problem(status, code);
        assert_eq!(problem["where"], place, "{query}: {problem}");
    }
    let unknown = |answer: Answer, names: &str| {
        let problem = answer.problem(404, "not_found");
        assert_eq!(problem["where"], "path parameter name", "{problem}");
        assert!(problem["mend"].as_str().unwrap().contains(names), "{problem}");
    };
    unknown(server.get(&format!("/v1/trials/{trial}/figures/bode")).await, "signals, plant_check");
    unknown(server.get(&format!("/v1/studies/{}/figures/signals", lab.study)).await, "mean_abs_error, rms_error");
    let nobody = "0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10";
    for noun in ["trials", "studies", "analyses"] {
        server.get(&format!("/v1/{noun}/{nobody}/figures")).await.problem(404, "not_found");
    }
    server.get(&format!("/v1/trials/{nobody}/figures/signals")).await.problem(404, "not_found");
    let request = json!({"kind": "frequency_response", "inputs": {"trial": trial}, "spec": {}});
    let waiting = server.post("/v1/analyses", &request).await.id(202);
    server.get(&format!("/v1/analyses/{waiting}/figures/response")).await.problem(409, "conflict");
    server.work().await;
    server.finish().await;
}

/// Names from outside stay text in every form of a figure.
#[tokio::test]
async fn names_from_outside_are_text() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let evil = "<script>alert(1)</script>";
    server.patch(&format!("/v1/subjects/{}", lab.subject), &json!({"code": evil, "group": evil})).await.json(200);
    let trial = upload(&server, &lab, 1, 1).await;
    for path in
        [format!("/v1/trials/{trial}/figures/signals"), format!("/v1/studies/{}/figures/mean_abs_error", lab.study)]
    {
        let text = server.get(&path).await.text();
        assert!(!text.contains("<script") && text.contains("&lt;script&gt;alert(1)&lt;/script&gt;"), "{path}");
    }
    server.finish().await;
}

#[tokio::test]
async fn studies_and_reports_are_drawn() {
    let server = TestServer::start().await;
    let mut lab = server.lab().await;
    for (seed, code) in [(1, "s01"), (2, "s02"), (3, "s03")] {
        if code != "s01" {
            lab.subject = server.subject(&lab.study, code).await;
        }
        for number in [1, 20] {
            upload(&server, &lab, seed, number).await;
        }
    }
    let thin = json!({"poles": 12, "zeros": 12, "damping": 4, "gains": 6});
    let spec = json!({"pool": {"name": "zhang2015_appendix_c", "thin": thin}, "refine": true});
    let path = format!("/v1/studies/{}/analyses", lab.study);
    let queued = server.post(&path, &json!({"kind": "ssid", "spec": spec})).await.json(202);
    let two = server.post(&path, &json!({"kind": "frequency_response"})).await.json(202);
    let three = server.post(&path, &json!({"kind": "prediction_error"})).await.json(202);
    server.work().await;
    let id = |run: &Value| run["analyses"][0]["id"].as_str().unwrap().to_owned();

    let study = format!("/v1/studies/{}", lab.study);
    assert_eq!(all_of(&server, &study).await.len(), 17);
    let curve = format!("{study}/figures/norm_feedforward_plant_minus_one?format=json");
    let figure = server.get(&curve).await.json(200);
    let curves = server.get(&format!("{study}/learning-curves")).await.json(200);
    let group = &curves["groups"][0];
    let series = figure["panels"][0]["series"].as_array().unwrap();
    let mean = series.iter().find(|one| one["name"] == "gm").unwrap();
    assert_eq!(mean["x"], json!([1.0, 20.0]));
    for (at, point) in group["points"].as_array().unwrap().iter().enumerate() {
        assert_eq!(mean["y"][at], point["metrics"]["norm_feedforward_plant_minus_one"]["mean"]);
    }
    for (subject, code) in group["subjects"].as_array().unwrap().iter().zip(["s01", "s02", "s03"]) {
        let own = series.iter().find(|one| one["name"] == code).unwrap();
        for (at, point) in subject["curve"]["points"].as_array().unwrap().iter().enumerate() {
            assert_eq!(own["y"][at], point["norm_feedforward_plant_minus_one"], "{code}");
        }
    }
    // The command alone: the feedback of no trial is to be used.
    let feedback = server.get(&format!("{study}/figures/norm_feedback?format=json")).await.json(200);
    let crosses = feedback["panels"][0]["series"].as_array().unwrap().iter().find(|one| one["mark"] == "crosses");
    assert_eq!(crosses.unwrap()["x"].as_array().unwrap().len(), 6, "{feedback:.2000}");
    assert!(feedback["description"].as_str().unwrap().contains("no statement"), "{feedback:.600}");
    let other = format!("{study}/figures/norm_feedback?estimator=prediction_error&format=json");
    let bars = server.get(&other).await.json(200);
    assert!(bars["panels"][0]["series"].as_array().unwrap().iter().any(|one| one["mark"] == "bars"), "{bars:.2000}");

    let analysis = format!("/v1/analyses/{}", id(&queued));
    assert_eq!(all_of(&server, &analysis).await, ["bode", "response", "poles", "near_optimal", "simulated"]);
    let report = server.get(&format!("{analysis}/report")).await.json(200);
    let drawn = |name: &str| {
        let address = format!("{analysis}/figures/{name}?format=json");
        let server = &server;
        async move { server.get(&address).await.json(200) }
    };
    let poles = drawn("poles").await;
    let closed = poles["panels"][0]["series"].as_array().unwrap().iter().find(|one| one["mark"] == "plus").unwrap();
    let mut found: Vec<[f64; 2]> = (0..closed["x"].as_array().unwrap().len())
        .map(|at| [closed["x"][at].as_f64().unwrap(), closed["y"][at].as_f64().unwrap()])
        .collect();
    let mut said: Vec<[f64; 2]> = serde_json::from_value(report["result"]["closed_loop_poles"].clone()).unwrap();
    for list in [&mut found, &mut said] {
        list.sort_by(|a, b| a.partial_cmp(b).unwrap());
    }
    assert_eq!(found, said);
    let near = drawn("near_optimal").await;
    let family = report["result"]["near_optimal"]["family"].as_array().unwrap();
    for (panel, name) in [(0, "norm_feedback"), (1, "norm_feedforward_plant_minus_one")] {
        let series = &near["panels"][panel]["series"];
        let mut drawn: Vec<f64> =
            series[0]["y"].as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect();
        let mut said: Vec<f64> = family.iter().map(|own| own[name].as_f64().unwrap()).collect();
        drawn.sort_by(f64::total_cmp);
        said.sort_by(f64::total_cmp);
        assert_eq!(drawn, said, "{name}");
        assert_eq!(series[1]["mark"], "rings");
        assert_eq!(series[1]["y"][0], report["result"]["metrics"][name], "{name}: the chosen one");
    }
    let dots = server.get(&format!("{study}/figures/scatter?format=json")).await.json(200);
    let dots = &dots["panels"][0]["series"][0];
    let mut points: Vec<[f64; 2]> = group["scatter"]["points"]
        .as_array()
        .unwrap()
        .iter()
        .map(|own| ["norm_feedforward_plant_minus_one", "mean_abs_error"].map(|name| own[name].as_f64().unwrap()))
        .collect();
    points.sort_by(|a, b| a[0].total_cmp(&b[0]));
    for (at, [distance, error]) in points.iter().enumerate() {
        assert_eq!((dots["x"][at].as_f64(), dots["y"][at].as_f64()), (Some(*distance), Some(*error)));
    }
    let loop_of = server.get(&format!("{analysis}/figures/response?format=json")).await.json(200);
    let dots = &loop_of["panels"][0]["series"][0];
    // A line at 0 Hz has no place on a logarithmic axis.
    let has_place = |line: &&Value| line["omega_rad_s"].as_f64().unwrap() > 0.0;
    for (at, line) in report["result"]["fit"].as_array().unwrap().iter().filter(has_place).enumerate() {
        let [re, im] = [0, 1].map(|part| line["h"][part].as_f64().unwrap());
        assert!((dots["y"][at].as_f64().unwrap() - 20.0 * re.hypot(im).log10()).abs() < 1e-9);
    }
    // The simulation is the one whose share the report gives.
    let simulated = server.get(&format!("{analysis}/figures/simulated?format=json&w=2000")).await.json(200);
    let series = |name: &str| -> Vec<f64> {
        let all = simulated["panels"][0]["series"].as_array().unwrap();
        let own = all.iter().find(|one| one["name"] == name).unwrap();
        own["y"].as_array().unwrap().iter().map(|y| y.as_f64().unwrap()).collect()
    };
    let (recorded, found) = (series("y, recorded"), series("y, simulated"));
    let mean = recorded.iter().sum::<f64>() / recorded.len() as f64;
    let missed: f64 = recorded.iter().zip(&found).map(|(a, b)| (a - b).powi(2)).sum();
    let share = 1.0 - missed / recorded.iter().map(|y| (y - mean).powi(2)).sum::<f64>();
    let said = report["result"]["simulated_vaf"]["y"].as_f64().unwrap();
    assert!((share - said).abs() < 1e-9, "{share} {said}");
    for run in [&two, &three] {
        assert_eq!(all_of(&server, &format!("/v1/analyses/{}", id(run))).await.len(), 1);
    }
    server.finish().await;
}

/// Reports of the kinds that need no trial; the numbers drawn are those of the report.
#[tokio::test]
async fn reports_about_costs_excitations_and_designs_are_drawn() {
    let server = TestServer::start().await;
    let about = |kind: &str| volition::analysis::registry::kinds().find(|own| own.kind.name() == kind).unwrap();
    let mut reports = std::collections::BTreeMap::new();
    for (kind, change) in [
        ("inverse_lqr", json!({})),
        ("simulate", json!({})),
        ("inverse_lqg", json!({})),
        ("gain_fit", json!({})),
        ("excitation_quality", json!({"include_samples": true})),
        ("compensator_design", json!({"sweep": {"count": 20}})),
        (
            "input_design",
            json!({"limits": {"input": 1.5, "outputs": {"position": 0.8}, "autocorrelation": {"tolerance": 0.3}}}),
        ),
    ] {
        let mut request: Value = serde_json::from_str(about(kind).example).unwrap();
        for (key, value) in change.as_object().unwrap() {
            request["spec"][key] = value.clone();
        }
        let id = server.post("/v1/analyses", &request).await.id(202);
        reports.insert(kind, (format!("/v1/analyses/{id}"), request));
    }
    server.work().await;
    let mut drawn = std::collections::BTreeMap::new();
    for (kind, (address, request)) in &reports {
        let report = server.get(&format!("{address}/report")).await.json(200);
        for name in all_of(&server, address).await {
            let figure = server.get(&format!("{address}/figures/{name}?format=json&w=2000")).await.json(200);
            drawn.insert(format!("{kind} {name}"), (figure, report.clone(), request.clone()));
        }
    }
    let names: Vec<&str> = drawn.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "compensator_design compensator",
            "excitation_quality autocorrelation",
            "excitation_quality flatness",
            "excitation_quality signal",
            "excitation_quality spectrum",
            "gain_fit return_difference",
            "input_design autocorrelation",
            "input_design deviations",
            "input_design improvement",
            "input_design input",
            "input_design outputs",
            "inverse_lqg cost",
            "inverse_lqr cost",
            "inverse_lqr return_difference",
            "simulate bode",
            "simulate signals",
            "simulate step",
        ]
    );
    let numbers = |value: &Value| -> Vec<f64> { value.as_array().unwrap().iter().filter_map(Value::as_f64).collect() };
    let series = |name: &str, panel: usize, at: usize| drawn[name].0["panels"][panel]["series"][at].clone();
    let result = |name: &str| drawn[name].1["result"].clone();

    let spectrum = result("excitation_quality spectrum");
    assert_eq!(numbers(&series("excitation_quality spectrum", 0, 0)["x"]), numbers(&spectrum["lines"]["frequency_hz"]));
    assert_eq!(numbers(&series("excitation_quality spectrum", 0, 0)["y"]), numbers(&spectrum["lines"]["power"]));
    let correlation = series("excitation_quality autocorrelation", 0, 0);
    let lags = numbers(&spectrum["autocorrelation"]["lag_s"]);
    // Lines are thinned out to what a pixel can show, and what is left is there.
    for (x, y) in numbers(&correlation["x"]).iter().zip(numbers(&correlation["y"])) {
        let at = lags.iter().position(|lag| lag == x).unwrap();
        assert_eq!(spectrum["autocorrelation"]["value"][at].as_f64(), Some(y));
    }
    let flat = series("excitation_quality flatness", 0, 0);
    let said: Vec<f64> =
        spectrum["flatness"].as_array().unwrap().iter().map(|own| own["sfm"].as_f64().unwrap()).collect();
    let mut found = numbers(&flat["y"]);
    found.sort_by(f64::total_cmp);
    let mut said = said;
    said.sort_by(f64::total_cmp);
    assert_eq!(found, said);

    let design = result("input_design input");
    for (at, name) in [(0, "start_input"), (1, "input")] {
        assert_eq!(numbers(&series("input_design input", 0, at)["y"]), numbers(&design[name]));
    }
    let ratios = numbers(&series("input_design deviations", 0, 0)["y"]);
    for (ratio, parameter) in ratios.iter().zip(design["parameters"].as_array().unwrap()) {
        assert!((ratio.powi(2) / parameter["variance_ratio"].as_f64().unwrap() - 1.0).abs() < 1e-9, "{parameter}");
    }

    assert_eq!(numbers(&series("input_design improvement", 0, 0)["y"]), numbers(&design["history"]));
    for (panel, course) in design["courses"].as_array().unwrap().iter().enumerate() {
        for (at, name) in [(0, "before"), (1, "after")] {
            assert_eq!(numbers(&series("input_design outputs", panel, at)["y"]), numbers(&course[name]));
        }
        // What is drawn reaches what the proof of its limit says.
        let name = &course["name"];
        let limit = design["limits"].as_array().unwrap().iter().find(|own| own["name"] == *name);
        if let Some(limit) = limit {
            let most = numbers(&course["after"]).into_iter().fold(f64::NEG_INFINITY, f64::max);
            assert!((most - limit["reached"][1].as_f64().unwrap()).abs() <= 1e-12 * most.abs(), "{name}");
        }
    }
    assert_eq!(
        numbers(&series("input_design autocorrelation", 0, 2)["y"]),
        numbers(&design["autocorrelation"]["after"])
    );
    let simulated = result("simulate signals");
    let drawn_y = numbers(&series("simulate signals", 0, 1)["y"]);
    let simulated_y = numbers(&simulated["signals"]["y"]);
    assert!(!drawn_y.is_empty() && drawn_y.iter().all(|y| simulated_y.contains(y)));
    let gain = series("simulate bode", 0, 0);
    assert_eq!(numbers(&gain["y"]), numbers(&simulated["frequency_responses"]["feedforward"]["gain_db"]));

    let sweep = result("compensator_design compensator")["sweep"][0].clone();
    // Where the loop is not stable there is nothing to draw.
    let drawable = |of: &Value| {
        let kept = of.as_array().unwrap().iter().zip(sweep["blsfg"].as_array().unwrap()).filter(|(_, y)| !y.is_null());
        kept.map(|(value, _)| value.as_f64().unwrap()).collect::<Vec<f64>>()
    };
    let line = series("compensator_design compensator", 0, 0);
    assert!(!drawable(&sweep["gain"]).is_empty());
    let known: (Vec<f64>, Vec<f64>) = {
        let points = line["x"].as_array().unwrap().iter().zip(line["y"].as_array().unwrap());
        points.filter_map(|(x, y)| x.as_f64().zip(y.as_f64())).unzip()
    };
    assert_eq!(known, (drawable(&sweep["gain"]), drawable(&sweep["blsfg"])));

    let cost = result("inverse_lqr cost");
    let shares: Vec<f64> = [0, 1].iter().flat_map(|at| numbers(&series("inverse_lqr cost", 0, *at)["y"])).collect();
    let sum: f64 = shares.iter().sum();
    assert!((sum - 100.0).abs() < 1e-6 || !cost["reading"]["stationary_shares"].is_object(), "{shares:?}");
    assert_eq!(drawn["inverse_lqr cost"].0["x"]["names"], json!(["angle", "rate", "torque"]));
    // Kalman's inequality as the proof of the report has it: the least value lies above 0 dB.
    let margin = numbers(&series("inverse_lqr return_difference", 0, 0)["y"]).into_iter().fold(f64::INFINITY, f64::min);
    assert!(margin > -1e-9 && cost["verdict"] == "feasible", "{margin}");
    server.finish().await;
}

#[tokio::test]
async fn the_queue_is_drawn() {
    let server = TestServer::start().await;
    let request: Value = serde_json::from_str(volition::analysis::registry::kinds().next().unwrap().example).unwrap();
    server.post("/v1/analyses", &request).await.id(202);
    let before = server.get("/v1/figures/queue?format=json").await.json(200);
    assert!(before["description"].as_str().unwrap().starts_with("1 wait and 0 run now"), "{before}");
    server.work().await;
    let after = server.get("/v1/figures/queue?format=json").await.json(200);
    assert_eq!(after["description"], "0 wait and 0 run now; 1 ended and 0 failed in 24 hours.");
    assert!(server.get("/v1/figures/queue").await.text().starts_with("<svg"));
    server.finish().await;
}

/// Units of a plant stand at the axes, those of a trial before them.
#[tokio::test]
async fn figures_have_the_units_that_the_lab_gave() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = upload(&server, &lab, 1, 1).await;
    let plant = format!("/v1/plants/{}", lab.plant);
    let changed = server.patch(&plant, &json!({"units": {"output": "cm", "control": "N"}})).await.json(200);
    assert_eq!(changed["units"], json!({"output": "cm", "control": "N"}));
    let label = |figure: &Value, panel: usize| figure["panels"][panel]["y"]["unit"].as_str().unwrap().to_owned();
    let address = format!("/v1/trials/{trial}/figures/signals?format=json");
    let figure = server.get(&address).await.json(200);
    assert_eq!([label(&figure, 0), label(&figure, 1), label(&figure, 2)], ["cm", "N", "cm"]);
    let of_study = format!("/v1/studies/{}/figures/norm_feedback?format=json", lab.study);
    assert_eq!(label(&server.get(&of_study).await.json(200), 0), "N / cm");
    let own = server.patch(&format!("/v1/trials/{trial}"), &json!({"units": {"control": "mN"}})).await.json(200);
    assert_eq!(own["units"], json!({"output": null, "control": "mN"}));
    let figure = server.get(&address).await.json(200);
    assert_eq!([label(&figure, 0), label(&figure, 1)], ["cm", "mN"]);
    let taken = server.patch(&plant, &json!({"units": {"output": null}})).await.json(200);
    assert_eq!(taken["units"], json!({"output": null, "control": "N"}));
    assert_eq!(label(&server.get(&address).await.json(200), 0), "unit of y");
    let long = server.patch(&plant, &json!({"units": {"output": "x".repeat(41)}})).await.problem(422, "invalid");
    assert_eq!(long["where"], "/units/output");
    let unknown = server.patch(&plant, &json!({"units": {"time": "s"}})).await;
    assert!(unknown.status.is_client_error(), "{}", unknown.text());
    server.finish().await;
}
