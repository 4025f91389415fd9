//! The command line as a user meets it: files, exit codes, and one clear line for what is wrong.
use std::path::Path;
use system_tests::{change, sim_host};

/// Changes `flight.toml`, flies it, and gives the one line that is said on stderr; nothing may be left behind.
fn refusal(from: &str, to: &str) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("changed.toml");
    change(&file, from, to);
    refusal_of(&file, folder.path())
}

fn refusal_of(file: &Path, folder: &Path) -> String {
    let out = folder.join("out");
    let path = |path: &Path| path.to_str().expect("a plain path").to_owned();
    let result = sim_host(&["compare", &path(file), "--out", &path(&out)]);
    let line = String::from_utf8(result.stderr).expect("text");
    assert_eq!(result.status.code(), Some(2), "{line}");
    assert_eq!(line.lines().count(), 1, "{line}");
    assert!(result.stdout.is_empty());
    assert!(!out.exists(), "nothing half-written");
    line
}

#[test]
fn bad_scenarios_are_refused_in_one_line_that_names_the_key() {
    for (why, from, to, says) in [
        ("unknown key", "duration_s", "duration_x", ["changed.toml:5", "duration_x", "expected one of"]),
        ("unknown key in a table", "loss    =", "lost    =", ["fault[0].lost", "unknown field", "expected one of"]),
        ("not a number", "loss    = 0.4", "loss    = nan", ["fault[0].loss", "NaN", "a number from 0 to 1"]),
        ("negative mass", "[vehicle]", "[vehicle]\nmass_kg = -0.5", ["vehicle.mass_kg", "-0.5", "from 0.01 to 100"]),
        ("a fifth rotor", "rotors  = [1, 2, 3, 4]", "rotors = [5]", ["fault[0].rotors[0]", "5", "rotors 1 to 4"]),
        ("a negative rotor", "rotors  = [1, 2, 3, 4]", "rotors = [-1]", ["fault[0].rotors[0]", "-1", "rotors 1 to 4"]),
        ("a word for a number", "loss    = 0.4", "loss = \"much\"", ["fault[0].loss", "\"much\"", "expected f64"]),
        ("broken TOML", "[vehicle]", "[vehicle", ["changed.toml:", "[vehicle", "expected"]),
        (
            "gains of nobody",
            "[vehicle]",
            "[controllers.nobody.gains]\n[vehicle]",
            ["controllers", "nobody", "expected one of `default`"],
        ),
        (
            "a gain that is not a number",
            "[vehicle]",
            "[controllers.lgs.gains]\nz = { p = nan }\n[vehicle]",
            ["controllers.lgs.gains.z.p", "NaN", "a number from"],
        ),
    ] {
        let line = refusal(from, to);
        for part in says {
            assert!(line.contains(part), "{why}: `{part}` is not in: {line}");
        }
    }
}

/// The fault of `flight.toml`, whose times the others keep.
const FAULT: &str = "kind    = \"loss_of_effectiveness\"\nrotors  = [1, 2, 3, 4]\nloss    = 0.4\n";

#[test]
fn faults_that_make_no_sense_are_refused_in_one_line() {
    let whole = ["must be step, pulse_train or intermittent with the kind `stopped`", "fault[0].profile = ramp"];
    let second = "kind = \"stuck\"\nrotors = [1, 2]\nfrom_s = 1.0\nuntil_s = 36.0\n[[fault]]\nkind = \"hard_over\"\nrotors = [2]\n";
    for (why, fault, says) in [
        ("an unknown kind", "kind = \"melted\"\nrotors = [1]\n", ["fault[0].kind: \"melted\"", "`stopped`, `stuck`"]),
        ("no kind", "rotors = [1]\n", ["fault[0]", "missing field `kind`"]),
        (
            "no rotor",
            "kind = \"stopped\"\nrotors = []\n",
            ["fault[0].rotors = []", "at least one of the rotors 1 to 4"],
        ),
        (
            "a rotor twice",
            "kind = \"stopped\"\nrotors = [1, 1]\n",
            ["fault[0].rotors: [1, 1]", "rotor 1 must be named once"],
        ),
        (
            "a parameter of another kind",
            "kind = \"stopped\"\nrotors = [1]\nloss = 0.4\n",
            ["loss = 0.4", "must be left out with the kind `stopped`"],
        ),
        (
            "a parameter too few",
            "kind = \"floating\"\nrotors = [1]\n",
            ["spin_down_s = nothing", "must be given with the kind `floating`"],
        ),
        (
            "a parameter out of range",
            "kind = \"reversed\"\nrotors = [1]\nshare = 2.0\n",
            ["fault[0].share = 2", "must be a number from 0 to 1"],
        ),
        ("stopped in part", "kind = \"stopped\"\nrotors = [1]\nprofile = { ramp = { rise_s = 1.0 } }\n", whole),
        (
            "a shape that never is",
            "kind = \"stopped\"\nrotors = [1]\nprofile = { intermittent = { on_mean_s = 0.0, off_mean_s = 1.0 } }\n",
            ["fault[0].profile.intermittent.on_mean_s = 0", "must be a number from 0.001"],
        ),
        (
            "a battery for two",
            "kind = \"battery_sag\"\nrotors = [1, 3]\nsag = 0.2\n",
            ["fault[0].rotors = [1, 3]", "must be [1, 2, 3, 4]"],
        ),
        (
            "more thrust than there is",
            "kind = \"stuck\"\nrotors = [1]\nthrust_n = 9.0\n",
            ["fault[0].thrust_n = 9", "must be a number from 0 to 2.8"],
        ),
        (
            "a rotor that coasts quicker than it is driven",
            "kind = \"floating\"\nrotors = [1]\nspin_down_s = 0.019\n",
            ["fault[0].spin_down_s = 0.019", "must be a number from 0.02"],
        ),
        (
            "a delay below a control period",
            "kind = \"command_delay\"\nrotors = [1]\ndelay_s = 0.001\n",
            ["fault[0].delay_s = 0.001", "must be a number from 0.002"],
        ),
        (
            "wiring that swaps one rotor",
            "kind = \"swapped\"\nrotors = [1]\n",
            ["fault[0].rotors = [1]", "must be a list of two rotors"],
        ),
        (
            "wiring that changes in flight",
            "kind = \"swapped\"\nrotors = [1, 2]\n",
            ["fault[0].from_s = 35", "must be 0 with the kind `swapped`"],
        ),
        (
            "a report of nothing",
            "kind = \"command_delay\"\nrotors = [1]\ndelay_s = 0.01\nreported = true\n",
            ["fault[0].reported = true", "must be false with the kind `command_delay`"],
        ),
        ("two that decide one rotor", second, ["fault[1].kind = hard_over", "than fault[0], `stuck`"]),
    ] {
        let line = refusal(FAULT, fault);
        for part in says.into_iter().chain(["changed.toml"]) {
            assert!(line.contains(part), "{why}: `{part}` is not in: {line}");
        }
    }
}

#[test]
fn the_plant_without_motors_refuses_faults_of_motors() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("changed.toml");
    change(&file, FAULT, "kind = \"hard_over\"\nrotors = [1]\n");
    let text = std::fs::read_to_string(&file).expect("just written");
    std::fs::write(&file, text.replace("\"rigid\"", "\"paper\"")).expect("written");
    let line = refusal_of(&file, folder.path());
    assert!(line.contains("fault[0].kind = hard_over: must be loss_of_effectiveness or swapped"), "{line}");
}

#[test]
fn flights_that_come_down_are_counted_apart_from_crashes() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("sinks.toml");
    // A quarter of a metre above the ground, with 0.97 times its weight.
    change(&file, "loss    = 0.4", "loss    = 0.56");
    let path = |path: &Path| path.to_str().expect("a plain path").to_owned();
    let text = std::fs::read_to_string(&file).expect("just written");
    std::fs::write(&file, text.replace("[1.0, 1.0, 2.0]", "[1.0, 1.0, -0.7]")).expect("written");
    let args = ["compare", &path(&file), "--controllers", "lgs", "--seeds", "2", "--out"];
    let out = path(&folder.path().join("out"));
    let table = String::from_utf8(sim_host(&[&args[..], &[&out]].concat()).stdout).expect("text");
    assert!(table.contains("lgs came down in 2 of 2 flights, at worst at "), "{table}");
    let json = sim_host(&[&args[..], &[&out, "--json"]].concat()).stdout;
    let json: serde_json::Value = serde_json::from_slice(&json).expect("JSON");
    let lgs = &json["controllers"]["lgs"];
    assert_eq!((&lgs["survived"], &lgs["came_down"]), (&0.into(), &2.into()));
    assert_eq!(lgs["crashes"].as_array().map(Vec::len), Some(0));
    assert!(lgs["landings"][1]["speed_m_s"].as_f64() < Some(2.0));
}

#[test]
fn a_missing_file_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let line = refusal_of(&folder.path().join("none.toml"), folder.path());
    assert!(line.contains("none.toml") && line.contains("cannot be read"), "{line}");
}

#[test]
fn a_file_in_the_place_of_out_is_refused_before_anything_is_flown() {
    let file = tempfile::NamedTempFile::new().expect("a file");
    let path = file.path().to_str().expect("a plain path");
    let result = sim_host(&["compare", "scenarios/flight.toml", "--seeds", "100000", "--out", path]);
    assert_eq!(result.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&result.stderr).contains("is not a folder"));
}

#[test]
fn compare_writes_its_results_and_prints_only_json_when_asked() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("results");
    let args = ["compare", "scenarios/paper.toml", "--seeds", "1", "--json", "--out"];
    let result = sim_host(&[&args[..], &[out.to_str().expect("a plain path")]].concat());
    assert!(result.status.success());
    let json: serde_json::Value = serde_json::from_slice(&result.stdout).expect("JSON alone");
    assert_eq!(json["scenario"], "paper");
    assert_eq!(json["conditions"]["faults"][0]["loss"], 0.4);
    assert!(json["controllers"]["pid"]["altitude_deviation_max_m"]["median"].as_f64() > Some(0.3));
    assert_eq!(json["controllers"]["raw"]["survived"], 1);

    let mut names: Vec<_> = std::fs::read_dir(&out)
        .expect("results")
        .map(|entry| entry.expect("an entry").file_name().into_string().expect("a name"))
        .collect();
    names.sort();
    let figures = ["commands", "gains", "lyapunov", "overview", "thrusts", "trajectories"];
    for name in figures.map(|name| format!("{name}.png")) {
        assert!(names.contains(&name), "{name} is not in {names:?}");
    }
    for name in ["log_default.csv", "log_lgs.csv", "log_pid.csv", "log_raw.csv", "report.html", "results.json"] {
        assert!(names.iter().any(|found| found == name), "{name} is not in {names:?}");
    }
    assert_eq!(names.len(), figures.len() + 6, "{names:?}");
    let report = std::fs::read_to_string(out.join("report.html")).expect("a report");
    assert!(report.contains("raw limit-cycles"), "the report says what the table hides");
    assert_eq!(report.matches("<svg").count(), figures.len());
    assert!(report.contains("[[fault]]"), "the scenario that reproduces it");
    assert!(!report.contains("src=") && !report.contains("href="), "it opens offline");
}

#[test]
fn refused_flights_are_counted_apart_from_crashes() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().to_str().expect("a plain path");
    let compare = ["compare", "scenarios/faults/swapped.toml", "--controllers", "lgs", "--seeds", "2", "--out", out];
    let table = String::from_utf8(sim_host(&compare).stdout).expect("text");
    assert!(table.contains("lgs never took off in 2 of 2 flights: rotor 1 answers as rotor 2."), "{table}");
    let json = sim_host(&[&compare[..], &["--json"]].concat()).stdout;
    let json: serde_json::Value = serde_json::from_slice(&json).expect("JSON");
    let lgs = &json["controllers"]["lgs"];
    assert_eq!((&lgs["refused"], &lgs["survived"], &lgs["came_down"]), (&2.into(), &0.into(), &0.into()));
    assert_eq!(lgs["crashes"].as_array().map(Vec::len), Some(0));
    assert_eq!(lgs["refusals"][1]["fault"], "rotor 1 answers as rotor 2");
    let flown = sim_host(&["fly", "scenarios/faults/reversed.toml", "--out", out]).stdout;
    assert!(String::from_utf8(flown).expect("text").starts_with("refused to take off: rotor 1 is reversed\n"));
}

#[test]
fn crashed_flights_are_counted_and_their_metrics_are_null() {
    let folder = tempfile::tempdir().expect("a folder");
    // Named twice, flown once.
    let args =
        ["compare", "scenarios/raw_law_limits.toml", "--controllers", "raw,raw", "--seeds", "2", "--json", "--out"];
    let result = sim_host(&[&args[..], &[folder.path().to_str().expect("a plain path")]].concat());
    let json: serde_json::Value = serde_json::from_slice(&result.stdout).expect("JSON");
    let raw = &json["controllers"]["raw"];
    assert_eq!((&raw["flights"], &raw["survived"]), (&2.into(), &0.into()));
    assert!(raw["altitude_deviation_max_m"]["median"].is_null());
    assert_eq!(raw["crashes"].as_array().map(Vec::len), Some(2));
}

#[test]
fn schema_documents_every_key() {
    let result = sim_host(&["schema"]);
    let schema: serde_json::Value = serde_json::from_slice(&result.stdout).expect("JSON");
    let mut keys = 0;
    assert_documented("", &schema, &mut keys);
    assert!(keys > 50, "{keys}");
}

/// Every property of every object has a description, its own or that of the type it refers to.
fn assert_documented(path: &str, schema: &serde_json::Value, keys: &mut usize) {
    if let Some(properties) = schema["properties"].as_object() {
        for (key, property) in properties {
            *keys += 1;
            // A variant of an enum is described once, beside its only property.
            let described = [&property["description"], &schema["description"]];
            assert!(described.iter().any(|text| text.is_string()), "{path}.{key}");
        }
    }
    match schema {
        serde_json::Value::Object(map) => {
            for (key, value) in map {
                assert_documented(&format!("{path}.{key}"), value, keys);
            }
        }
        serde_json::Value::Array(items) => {
            for item in items {
                assert_documented(path, item, keys);
            }
        }
        _ => {}
    }
}

#[test]
fn estimate_judges_a_flight_on_sensors_and_refuses_one_on_the_truth() {
    let output = sim_host(&["estimate", "scenarios/flight.toml"]);
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("scenarios/flight.toml: sensors.flown") && said.contains("must be true"), "{said}");

    let kit = ["--with", "scenarios/kits/mocap.toml", "--seeds", "2", "--json"];
    let output = sim_host(&[&["estimate", "scenarios/flight.toml"][..], &kit].concat());
    assert!(output.status.success());
    let judged: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let tilt_deg = judged["quantities"]["tilt_rms_deg"]["median"].as_f64().expect("a figure");
    assert!((1e-3..1.0).contains(&tilt_deg), "{tilt_deg}");
    assert_eq!(judged["flights"].as_array().map(Vec::len), Some(2));
}

#[test]
fn what_the_image_cannot_fly_is_refused_by_name() {
    let through = ["--through", "emulator"];
    for (command, scenario, said) in [
        ("fly", "flight", "scenarios/flight.toml: autopilot = nothing: must be a table"),
        ("fly", "sorties/offboard_stale", "scenarios/sorties/offboard_stale.toml: event["),
        ("fly", "sorties/arming_pilot", "scenarios/sorties/arming_pilot.toml: "),
        ("compare", "image/hop_by_hand", "controllers = pid: must be `default` alone"),
    ] {
        let output = sim_host(&[&[command, &format!("scenarios/{scenario}.toml")][..], &through].concat());
        assert_eq!(output.status.code(), Some(2), "{scenario}");
        let line = String::from_utf8_lossy(&output.stderr);
        assert!(line.contains(said) && line.contains("(--through emulator)"), "{line}");
    }
}
