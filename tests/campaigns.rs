//! Suites, detection campaigns and the limit beside the flights, as a user meets them.
use std::path::Path;
use system_tests::{change, sim_host};

#[test]
fn detect_writes_its_results_and_refuses_what_it_cannot_fly() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out");
    let out = out.to_str().expect("a plain path");
    let hover = "scenarios/detection/hover.toml";
    for (args, says) in [
        (vec!["scenarios/flight.toml"], "scenarios/flight.toml: fault: must be left out"),
        (vec!["scenarios/no.toml"], "scenarios/no.toml: cannot be read"),
        (vec![hover, "--alarm-nats", "-1"], "detector.alarm_nats = -1"),
        (vec![hover, "--losses", "0"], "0 is not in 1..=100"),
        (vec![hover, "--torque-rms", "nan"], "must be a number from 0 to 100"),
        (vec![hover, "--healthy-hours", "-1"], "must be a number from 0 to 1000"),
    ] {
        let args = [vec!["detect", "--out", out], args].concat();
        let args: Vec<_> = args.iter().map(|arg| if *arg == "-1" { "=-1" } else { arg }).collect();
        let joined = args.join(" ").replace(" =-1", "=-1");
        let refused = sim_host(&joined.split(' ').collect::<Vec<_>>());
        let line = String::from_utf8(refused.stderr).expect("text");
        assert_eq!(refused.status.code(), Some(2), "{line}");
        assert!(line.contains(says), "{line}");
        assert!(!Path::new(out).exists(), "nothing half-written");
    }
    let flown = sim_host(&[
        "detect",
        hover,
        "--losses",
        "50",
        "--flights",
        "2",
        "--healthy-hours",
        "0.1",
        "--torque-rms",
        "0.012",
        "--out",
        out,
    ]);
    assert!(flown.status.success(), "{}", String::from_utf8_lossy(&flown.stderr));
    let mut names: Vec<_> =
        std::fs::read_dir(out).expect("results").map(|entry| entry.expect("an entry").file_name()).collect();
    names.sort();
    assert_eq!(names, ["detection.html", "detection.json", "roc.png", "roc.svg"]);
    let json = std::fs::read_to_string(Path::new(out).join("detection.json")).expect("text");
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(json["conditions"]["wind"]["torque_rms_nm"], 0.012);
    assert_eq!(json["losses"][0]["flights"], 2);
}

#[test]
fn a_suite_is_one_table_in_a_fixed_order() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |path: &Path| path.to_str().expect("a plain path").to_owned();
    let faults = folder.path().join("faults");
    std::fs::create_dir(&faults).expect("made");
    for (name, loss) in [("weak.toml", "0.4"), ("all_weaker.toml", "0.6")] {
        change(&faults.join(name), "loss    = 0.4", &format!("loss    = {loss}"));
        let text = std::fs::read_to_string(faults.join(name)).expect("just written");
        let short = text.replace("35.0", "5.0").replace("55.0", "6.0").replace("70.0", "10.0");
        std::fs::write(faults.join(name), short).expect("written");
    }
    let out = folder.path().join("out");
    let args = ["suite", &path(&faults), "scenarios/faults/stuck.toml", "--controllers", "lgs,default,lgs", "--seeds"];
    let table = sim_host(&[&args[..], &["2", "--out", &path(&out)]].concat());
    assert!(table.status.success(), "{}", String::from_utf8_lossy(&table.stderr));
    let table = String::from_utf8(table.stdout).expect("text");
    let rows: Vec<Vec<&str>> = table
        .lines()
        .filter(|line| line.contains(" of 2"))
        .map(|line| line.trim_matches(['│', ' ']).split_whitespace().take(2).collect())
        .collect();
    let names = ["all_weaker", "weak", "stuck"].map(|name| [vec![name, "lgs"], vec![name, "default"]]);
    assert_eq!(rows, names.concat());
    for (name, says) in [("all_weaker", "no hover"), ("weak", "with heading"), ("stuck", "with heading")] {
        let row = table.lines().find(|line| line.contains(&format!(" {name} "))).expect("a row");
        assert!(row.contains(says), "{row}");
    }
    let markdown = std::fs::read_to_string(out.join("suite.md")).expect("a table to paste");
    assert!(markdown.starts_with("| scenario ") && markdown.contains("\n|---"), "{markdown}");
    let page = std::fs::read_to_string(out.join("suite.html")).expect("a page");
    assert!(page.contains("sim-host suite ") && page.contains("<td>all_weaker</td>"));
    let json = std::fs::read_to_string(out.join("suite.json")).expect("JSON");
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(json[2]["controllers"]["lgs"]["flights"], 2);
    assert_eq!(json[0]["conditions"]["hover"], "no hover");
}

#[test]
fn a_suite_of_nothing_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let result = sim_host(&["suite", folder.path().to_str().expect("a plain path")]);
    assert_eq!(result.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&result.stderr).contains("has no scenario"));
}

#[test]
fn a_comparison_draws_its_fault_beside_the_limit_and_the_oracle_beside_the_others() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().to_str().expect("a plain path");
    let args =
        ["compare", "scenarios/single_rotor_40.toml", "--controllers", "default,oracle", "--seeds", "1", "--out"];
    let table = String::from_utf8(sim_host(&[&args[..], &[out]].concat()).stdout).expect("text");
    assert!(table.contains("• default is off by ") && table.contains(" in altitude, the oracle by "), "{table}");
    assert!(table.contains(" sideways, the oracle by "), "{table}");
    let svg = std::fs::read_to_string(folder.path().join("limits.svg")).expect("drawn");
    for words in ["Loss of thrust on rotor 1", "flown: 40 %", "survived 1 of 1", "hover with heading"] {
        assert!(svg.contains(words), "{words}");
    }
    let report = std::fs::read_to_string(folder.path().join("report.html")).expect("a report");
    assert!(report.contains("The faults beside what physics allows") && folder.path().join("limits.png").exists());
}
