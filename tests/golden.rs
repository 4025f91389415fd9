//! The table of the README, flown again.
//!
//! `UPDATE_GOLDEN=1 cargo test -p system-tests --test golden` writes it anew, for a reviewer to read in the diff.
use sim_host::controllers::ControllerName;
use sim_host::metrics::{Metric, median_and_worst};
use std::fmt::Write;
use system_tests::{fly, root, shipped};

const GOLDEN: &str = "tests/golden/altitude_deviation.md";
const SCENARIOS: [&str; 10] = [
    "paper",
    "flight",
    "flight_wind",
    "lag_50ms",
    "loss_50",
    "low_thrust",
    "single_rotor_40",
    "single_rotor_60",
    "helix",
    "raw_law_limits",
];

/// Largest altitude deviation in the fault, mm, median of five flights, or how many crashed or came down.
fn cell(scenario: &str, controller: ControllerName) -> String {
    let flights = fly(&shipped(scenario), controller, 1, 5);
    let crashed = flights.iter().filter(|flown| flown.crash.is_some()).count();
    let down = flights.iter().filter(|flown| flown.landing.is_some()).count();
    let deviation = Metric::named("altitude_deviation_max_m").expect("a metric");
    match median_and_worst(&flights, deviation) {
        _ if crashed > 0 && down > 0 => format!("{crashed} of 5 crash, {down} come down"),
        _ if crashed > 0 => format!("{crashed} of 5 crash"),
        _ if down > 0 => format!("{down} of 5 come down"),
        Some((median, _)) => format!("{:.1}", 1000.0 * median),
        None => "–".to_owned(),
    }
}

fn table() -> String {
    let mut table = String::from("| scenario | pid | raw | lgs | default |\n| --- | --: | --: | --: | --: |\n");
    for scenario in SCENARIOS {
        let [pid, raw, lgs, default] = ControllerName::MAIN.map(|controller| cell(scenario, controller));
        writeln!(table, "| `{scenario}` | {pid} | {raw} | {lgs} | {default} |").expect("a string grows");
    }
    table
}

#[test]
fn readme_shows_what_is_flown() {
    let table = table();
    let file = root().join(GOLDEN);
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&file, &table).expect("written");
    }
    let golden = std::fs::read_to_string(file).expect("the golden table");
    assert_eq!(table, golden, "{GOLDEN} differs; UPDATE_GOLDEN=1 writes it anew");
    let readme = std::fs::read_to_string(root().join("README.md")).expect("a README");
    assert!(readme.contains(&golden), "copy {GOLDEN} into README.md");
}
