//! House style that no compiler checks.
use std::path::{Path, PathBuf};
use system_tests::root;

/// A file is read in one sitting; tests beside the code are not counted.
const FILE_LINES_MAX: usize = 400;
/// Crates whose every source file is held to the style.
const CRATES: [&str; 7] = ["control-core", "emulator", "firmware", "sim-host", "tests", "tick-bench", "xtask"];

fn files(folder: &Path, ending: &str, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder of the workspace") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            files(&path, ending, found);
        } else if path.extension().is_some_and(|found| found == ending) {
            found.push(path);
        }
    }
}

fn every_source() -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    for name in CRATES {
        files(&root().join(name), "rs", &mut found);
    }
    assert!(found.len() > 40, "the sources were found");
    found.into_iter().map(|path| (path.clone(), std::fs::read_to_string(path).expect("text"))).collect()
}

#[test]
fn files_are_read_in_one_sitting() {
    for (path, text) in every_source() {
        let code = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
        let lines = code.lines().count();
        assert!(lines <= FILE_LINES_MAX, "{}: {lines} lines", path.display());
    }
}

#[test]
fn files_open_with_what_they_are_for() {
    for (path, text) in every_source() {
        let opens = text.trim_start_matches('\n');
        assert!(opens.starts_with("//!") || opens.starts_with("#!"), "{}", path.display());
    }
}

/// A doc comment that cites a section of a page would not notice that it has been renamed.
#[test]
fn cited_sections_of_the_pages_exist() {
    for (name, least) in [("docs/control-law.md", 6), ("docs/theory.md", 2)] {
        let page = std::fs::read_to_string(root().join(name)).expect("the page");
        let mut cited = 0;
        for (path, text) in every_source() {
            for part in text.split(&format!("{name}, \"")).skip(1) {
                let section = part.split('"').next().unwrap_or_default();
                let heads = page.lines().filter(|line| line.starts_with("## "));
                let found = heads.map(|line| line.replace('`', "")).any(|line| line.contains(section));
                assert!(found, "{}: {section} of {name}", path.display());
                cited += 1;
            }
        }
        assert!(cited >= least, "{name}: {cited}");
    }
}

/// A bound on the page whose test is gone is a bound that nothing holds.
#[test]
fn tests_that_the_theory_cites_exist() {
    let page = std::fs::read_to_string(root().join("docs/theory.md")).expect("the page");
    let sources: String = every_source().into_iter().map(|(_, text)| text).collect();
    // Sentences are tests; shorter names in code type are not.
    let cited: Vec<_> = page.split('`').skip(1).step_by(2).filter(|name| name.matches('_').count() > 3).collect();
    for name in &cited {
        assert!(sources.contains(&format!("fn {name}(")), "{name}");
    }
    assert!(cited.len() > 20, "{cited:?}");
}

#[test]
fn core_has_no_unsafe_no_std_and_no_alloc() {
    let lib = std::fs::read_to_string(root().join("control-core/src/lib.rs")).expect("the core");
    assert!(lib.contains("#![no_std]\n") && lib.contains("#![forbid(unsafe_code)]"));
    assert!(!lib.contains("extern crate alloc"));
}

#[test]
fn only_the_simulator_draws_random_numbers() {
    for name in ["control-core", "firmware"] {
        let manifest = std::fs::read_to_string(root().join(name).join("Cargo.toml")).expect("a manifest");
        let dependencies = manifest.split("[dev-dependencies]").next().unwrap_or_default();
        assert!(!dependencies.lines().any(|line| line.starts_with("rand")), "{name}");
    }
}

#[test]
fn every_shipped_scenario_loads_and_says_what_it_shows() {
    let mut titles = std::collections::BTreeSet::new();
    let mut found = Vec::new();
    files(&root().join("scenarios"), "toml", &mut found);
    let (kits, scenarios): (Vec<_>, Vec<_>) =
        found.into_iter().partition(|path| path.parent().is_some_and(|at| at.ends_with("kits")));
    let base = root().join("scenarios/flight.toml");
    for kit in kits {
        let flown = sim_host::scenario::Scenario::load_with(&base, &[kit]).unwrap_or_else(|error| panic!("{error}"));
        assert!(flown.sensors.is_some_and(|sensors| sensors.flown));
    }
    for path in scenarios {
        let scenario = sim_host::scenario::Scenario::load(&path).unwrap_or_else(|error| panic!("{error}"));
        assert!(!scenario.title.is_empty(), "{}", path.display());
        assert!(titles.insert(scenario.title), "{}: another scenario has its title", path.display());
    }
    assert!(titles.len() >= 20);
}
