//! What several system tests need: the shipped scenarios, and flights of them.
use sim_host::controllers::ControllerName;
use sim_host::flight::{Flight, NumberFormat, Sample};
use sim_host::metrics::{Flown, Metric, fly_measured, median_and_worst};
use sim_host::scenario::Scenario;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

#[cfg(feature = "emulated")]
pub mod aloft;
pub mod bench;
#[cfg(feature = "emulated")]
pub mod card;
pub mod estimation;
pub mod garbage;
#[cfg(feature = "emulated")]
pub mod host;
#[cfg(feature = "emulated")]
pub mod log_flash;
#[cfg(feature = "emulated")]
pub mod logged;
pub mod motion;
pub mod rig;
pub mod symbols;

/// The root of the workspace.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A shipped scenario by its name.
///
/// # Panics
/// If it cannot be loaded, with the reason.
pub fn shipped(name: &str) -> Scenario {
    let file = root().join(format!("scenarios/{name}.toml"));
    Scenario::load(&file).unwrap_or_else(|error| panic!("{error}"))
}

/// Flies `seeds` flights from seed `base` on.
pub fn fly(scenario: &Scenario, controller: ControllerName, base: u64, seeds: u64) -> Vec<Flown> {
    (base..base + seeds)
        .map(|seed| {
            let flight = Flight { scenario, controller, seed, format: NumberFormat::F32 };
            fly_measured(&flight, &mut |_| {}).expect("shipped gains are valid")
        })
        .collect()
}

/// Flies once in `format` and keeps what `of` says of every tick.
///
/// # Panics
/// If the flight crashes or comes down.
pub fn trace<T>(
    scenario: &Scenario,
    controller: ControllerName,
    format: NumberFormat,
    of: impl Fn(&Sample) -> T,
) -> Vec<T> {
    let mut rows = Vec::new();
    let flight = Flight { scenario, controller, seed: scenario.seed, format };
    let ending = flight.fly(&mut |sample| rows.push(of(sample))).expect("shipped gains are valid");
    assert_eq!(ending, None, "{controller} in {format:?}");
    rows
}

/// Median and worst of a metric over flights that all must have survived.
///
/// # Panics
/// If a flight did not fly to its end, naming its seed, or if there is no such metric to measure.
pub fn metric(flights: &[Flown], name: &str) -> (f64, f64) {
    for flown in flights {
        assert_eq!((flown.crash, flown.landing, flown.refusal), (None, None, None), "seed {}", flown.seed);
    }
    let metric = Metric::named(name).expect("a metric of this name");
    median_and_worst(flights, metric).expect("something to measure")
}

/// The `sim-host` of this profile, built if it is not there yet.
///
/// # Panics
/// If it cannot be built or run.
pub fn sim_host(args: &[&str]) -> Output {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    let binary = BINARY.get_or_init(|| {
        // Tests lie in target/<profile>/deps.
        let test = std::env::current_exe().expect("a test has a path");
        let profile = test.ancestors().nth(2).expect("a target folder").to_owned();
        let mut build = Command::new(env!("CARGO"));
        build.args(["build", "--quiet", "--package", "sim-host", "--target-dir"]).arg(profile.join(".."));
        if profile.ends_with("release") {
            build.arg("--release");
        }
        assert!(build.current_dir(root()).status().expect("cargo runs").success());
        profile.join("sim-host")
    });
    Command::new(binary).args(args).current_dir(root()).output().expect("sim-host runs")
}

/// Writes `flight.toml` to `file` with one change.
///
/// # Panics
/// If there is nothing to change, or the file cannot be written.
pub fn change(file: &Path, from: &str, to: &str) {
    let text = std::fs::read_to_string(root().join("scenarios/flight.toml")).expect("a shipped scenario");
    assert!(text.contains(from), "{from}");
    std::fs::write(file, text.replacen(from, to, 1)).expect("written");
}
