use crate::api::harness::{TestServer, gzip, recording};
use reqwest::multipart::{Form, Part};
use serde_json::{Value, json};

fn codes(trial: &Value) -> Vec<&str> {
    trial["warnings"].as_array().unwrap().iter().map(|w| w["code"].as_str().unwrap()).collect()
}

#[tokio::test]
async fn csv_in_trial_out() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let csv = "t,r,u,y,note\n0.0,1,0.1,0.5,7\n0.1,1,0.2,2,7\n0.2,-1,-0.2,-1,7\n0.3,0,0,0,7\n";
    let answer = server.upload_csv(&lab, "&number=3&session=1", csv).await;
    let trial = answer.json(201);
    assert_eq!(answer.header("location"), format!("/v1/trials/{}", trial["id"].as_str().unwrap()));
    assert_eq!((&trial["number"], &trial["session"], &trial["samples"]), (&json!(3), &json!(1), &json!(4)));
    assert_eq!(trial["sample_time_s"], 0.1);
    // |r − y|: 0.5, 1, 0, 0
    assert_eq!(trial["metrics"]["mean_abs_error"], 0.375);
    let rms = trial["metrics"]["rms_error"].as_f64().unwrap();
    assert!((rms - (1.25_f64 / 4.0).sqrt()).abs() < 1e-15);
    assert_eq!(trial["metrics"]["divergent"], false);
    assert_eq!(trial["ignored_columns"], json!(["note"]));
    assert_eq!(trial["sha256"].as_str().unwrap().len(), 64);
    assert_eq!((&trial["duplicate"], &trial["number_assigned"]), (&json!(false), &json!(false)));

    let stored = server.get(answer.header("location")).await.json(200);
    for (key, value) in stored.as_object().unwrap() {
        assert_eq!(&trial[key], value, "{key}");
    }
    let listed = server.get(&format!("/v1/subjects/{}/trials", lab.subject)).await.json(200);
    assert_eq!(listed["items"], json!([stored]));
    server.finish().await;
}

#[tokio::test]
async fn the_same_content_is_recognised_however_it_comes() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let csv = "t,r,u,y\n0,1,0.1,0.5\n0.5,1,0.2,2\n1,-1,-0.2,-1\n";
    let first = server.upload_csv(&lab, "&number=3", csv).await.json(201);
    let path = format!("/v1/subjects/{}/trials?plant={}", lab.subject, lab.plant);

    let same = server.upload_csv(&lab, "&number=3", csv).await.json(200);
    let shuffled = server.upload_csv(&lab, "", "y, U ,r,t\n0.5,0.1,1,0\n2,0.2,1,0.5\n-1,-0.2,-1,1\r\n").await.json(200);
    let body = json!({"t": [0, 0.5, 1], "r": [1, 1, -1], "u": [0.1, 0.2, -0.2], "y": [0.5, 2, -1]});
    let as_json = server.post(&path, &body).await.json(200);
    let packed = server.request("POST", &path).header("content-type", "text/csv").header("content-encoding", "gzip");
    let packed = server.send(packed.body(gzip(csv.as_bytes()))).await.json(200);
    for again in [same, shuffled, as_json, packed] {
        assert_eq!((&again["duplicate"], &again["id"]), (&json!(true), &first["id"]), "{again}");
        assert_eq!(codes(&again), ["duplicate_content"]);
    }
    // Under another number it is still the same recording, and the difference is said.
    let other = server.upload_csv(&lab, "&number=9&session=2", csv).await.json(200);
    assert_eq!(other["number"], 3);
    assert!(other["warnings"].to_string().contains("were not used"), "{other}");
    assert_eq!(server.census().await[3], 1);

    // Another subject may have it, with a warning.
    let second = server.subject(&lab.study, "s02").await;
    let path = format!("/v1/subjects/{second}/trials?plant={}&number=1", lab.plant);
    let copied =
        server.send(server.request("POST", &path).header("content-type", "text/csv").body(csv)).await.json(201);
    assert_eq!(codes(&copied), ["content_of_another_subject"]);
    assert_eq!(server.census().await[3], 2);
    server.finish().await;
}

#[tokio::test]
async fn numbers_are_taken_once_per_session() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    server.upload_csv(&lab, "&number=3&session=1", recording(8, 1.0)).await.json(201);
    let taken = server.upload_csv(&lab, "&number=3&session=1", recording(8, 2.0)).await.problem(409, "conflict");
    assert_eq!(taken["where"], "query parameter number");
    server.upload_csv(&lab, "&number=3&session=2", recording(8, 2.0)).await.json(201);
    server.upload_csv(&lab, "&number=3", recording(8, 3.0)).await.json(201);
    let next = server.upload_csv(&lab, "&session=1", recording(8, 4.0)).await.json(201);
    assert_eq!((&next["number"], &next["number_assigned"]), (&json!(4), &json!(true)));
    assert_eq!(codes(&next), ["number_assigned"]);
    let first = server.upload_csv(&lab, "&session=9", recording(8, 5.0)).await.json(201);
    assert_eq!(first["number"], 1);
    server.finish().await;
}

#[tokio::test]
async fn uploads_at_the_same_time_get_numbers_of_their_own() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let answers =
        futures::future::join_all((0..6).map(|i| server.upload_csv(&lab, "", recording(8, f64::from(i))))).await;
    let mut numbers: Vec<i64> = answers.iter().map(|a| a.json(201)["number"].as_i64().unwrap()).collect();
    numbers.sort_unstable();
    assert_eq!(numbers, [1, 2, 3, 4, 5, 6]);
    server.finish().await;
}

#[tokio::test]
async fn columns_are_mapped_and_sample_times_given() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let csv = "target,stick,cursor\n1,0.1,0.5\n1,0.2,2\n-1,-0.2,-1\n";
    let query = "&columns=command:target,u:stick,output:cursor&sample_time_s=0.02";
    let made = server.upload_csv(&lab, query, csv).await.json(201);
    assert_eq!((&made["sample_time_s"], &made["samples"]), (&json!(0.02), &json!(3)));
    assert_eq!(made["ignored_columns"], json!([]));
    let refused = server.upload_csv(&lab, "&sample_time_s=0.02", csv).await.problem(400, "malformed");
    assert!(refused["detail"].as_str().unwrap().contains("cursor"), "{refused}");
    server.finish().await;
}

#[tokio::test]
async fn a_sampled_plant_at_another_rate_is_said() {
    let server = TestServer::start().await;
    let mut lab = server.lab().await;
    let body = json!({"name": "sampled", "model": {"num": [1.0], "den": [1.0, -0.5], "sample_time_s": 0.05}});
    lab.plant = server.post(&format!("/v1/studies/{}/plants", lab.study), &body).await.id(201);
    let made = server.upload_csv(&lab, "&number=1", recording(8, 1.0)).await.json(201);
    assert_eq!(codes(&made), ["sample_time_differs"]);
    server.finish().await;
}

fn file(name: &str, bytes: impl Into<Vec<u8>>) -> Part {
    Part::bytes(bytes.into()).file_name(name.to_owned())
}

#[tokio::test]
async fn a_form_stores_many_files() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let metadata = json!([
        {"file": "b.csv.gz", "number": 12, "session": 2},
        {"file": "a.csv", "number": 11},
    ]);
    let form = Form::new()
        .part("metadata", Part::text(metadata.to_string()).mime_str("application/json").unwrap())
        .part("file", file("a.csv", recording(8, 1.0)))
        .part("file", file("b.csv.gz", gzip(recording(8, 2.0).as_bytes())))
        .part("another", file("c.csv", recording(8, 3.0)))
        .part("file", file("copy of c.csv", recording(8, 3.0)));
    let path = format!("/v1/subjects/{}/trials?plant={}&session=1", lab.subject, lab.plant);
    let answer = server.send(server.request("POST", &path).multipart(form)).await.json(201);
    let rows: Vec<(&str, i64, i64, bool)> = answer["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(|t| {
            let integer = |key: &str| t[key].as_i64().unwrap();
            (t["file"].as_str().unwrap(), integer("number"), integer("session"), t["duplicate"].as_bool().unwrap())
        })
        .collect();
    assert_eq!(
        rows,
        [("a.csv", 11, 1, false), ("b.csv.gz", 12, 2, false), ("c.csv", 12, 1, false), ("copy of c.csv", 12, 1, true)]
    );
    assert_eq!(server.census().await[3], 3);

    // Sent once more, everything is recognised.
    let form =
        Form::new().part("file", file("a.csv", recording(8, 1.0))).part("file", file("b.csv", recording(8, 2.0)));
    let again = server.send(server.request("POST", &path).multipart(form)).await.json(200);
    assert!(again["items"].as_array().unwrap().iter().all(|t| t["duplicate"] == true));
    assert_eq!(server.census().await[3], 3);
    server.finish().await;
}

#[tokio::test]
async fn a_form_is_stored_whole_or_not_at_all() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let path = format!("/v1/subjects/{}/trials?plant={}&number=1", lab.subject, lab.plant);
    let good = || file("good.csv", recording(8, 1.0));
    let text = |value: Value| Part::text(value.to_string());
    let cases: Vec<(Form, u16, &str, &str)> = vec![
        (
            Form::new().part("f", good()).part("f", file("bad.csv", "t,r,u,y\n0,1,1,1\n0.1,1,x,1\n")),
            422,
            "bad_signal",
            "file 'bad.csv', row 3, column u",
        ),
        (Form::new().part("f", good()).part("f", file("bad.csv.gz", "t,r")), 400, "malformed", "file 'bad.csv.gz'"),
        (Form::new().part("f", good()).part("f", good()), 400, "malformed", "file 'good.csv'"),
        (Form::new().part("f", good()).part("note", Part::text("hello")), 400, "malformed", "part note"),
        (Form::new(), 400, "malformed", "body"),
        (Form::new().part("metadata", text(json!([]))), 400, "malformed", "body"),
        (
            Form::new().part("f", good()).part("metadata", text(json!([{"file": "other.csv"}]))),
            422,
            "invalid",
            "part metadata, /0/file",
        ),
        (
            Form::new().part("f", good()).part("metadata", text(json!([{"file": "good.csv", "nmber": 2}]))),
            422,
            "invalid",
            "part metadata, /0/nmber",
        ),
        (
            Form::new().part("f", good()).part("metadata", text(json!([{"file": "good.csv", "number": 0}]))),
            422,
            "invalid",
            "part metadata, /0/number",
        ),
        (
            Form::new().part("f", good()).part("metadata", text(json!([{"file": "good.csv"}, {"file": "good.csv"}]))),
            422,
            "invalid",
            "part metadata, /1/file",
        ),
        (
            Form::new().part("f", good()).part("metadata", Part::text("[{")),
            400,
            "malformed",
            "part metadata, body, line 1, column 2",
        ),
    ];
    for (form, status, code, place) in cases {
        let answer = server.send(server.request("POST", &path).multipart(form)).await;
        assert_eq!(answer.problem(status, code)["where"], place, "{}", answer.text());
    }
    // Two files of the same number within one form.
    let metadata = json!([{"file": "a.csv", "number": 5}, {"file": "b.csv", "number": 5}]);
    let form = Form::new()
        .part("f", file("a.csv", recording(8, 1.0)))
        .part("f", file("b.csv", recording(8, 2.0)))
        .part("metadata", text(metadata));
    server.send(server.request("POST", &path).multipart(form)).await.problem(409, "conflict");
    assert_eq!(server.census().await[3], 0, "nothing was stored");
    server.finish().await;
}

#[tokio::test]
async fn plants_come_from_the_metadata_too() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let path = format!("/v1/subjects/{}/trials", lab.subject);
    let form = |plant: &str| {
        let metadata = json!([{"file": "a.csv", "plant": plant}]).to_string();
        Form::new().part("f", file("a.csv", recording(8, 1.0))).part("metadata", Part::text(metadata))
    };
    let stranger = server.study().await;
    let stranger = server.plant(&stranger).await;
    let refused = server.send(server.request("POST", &path).multipart(form(&stranger))).await.problem(422, "invalid");
    assert_eq!(refused["where"], "part metadata, /0/plant");
    let made = server.send(server.request("POST", &path).multipart(form(&lab.plant))).await.json(201);
    assert_eq!(made["items"][0]["plant"], json!(lab.plant));
    server.finish().await;
}
