//! The pages on flying say what flies.
use control_core::arming::Check;
use control_core::failsafe::TABLE;
use control_core::modes::Mode;
use control_core::set::Member;
use std::fmt::Write;
use system_tests::{root, sim_host};

/// The table of failsafes as the pages show it.
fn failsafe_table() -> String {
    let mut table = String::from(
        "| failsafe | acts when | for, s | reaction | pilot may overrule |\n| --- | --- | --: | --- | --- |\n",
    );
    for row in &TABLE {
        let overrule = if row.overrule { "yes" } else { "no" };
        writeln!(table, "| {} | {} | {} | {} | {overrule} |", row.name, row.text, row.after_s, row.reaction)
            .expect("a string grows");
    }
    table
}

#[test]
fn the_pages_show_the_tables_that_fly() {
    let page = |name: &str| std::fs::read_to_string(root().join(name)).expect("the page");
    let (flying, architecture) = (page("docs/flying.md"), page("ARCHITECTURE.md"));
    let table = failsafe_table();
    assert!(
        flying.contains(&table) && architecture.contains(&table),
        "copy into docs/flying.md and ARCHITECTURE.md:\n{table}"
    );
    for check in Check::ALL {
        assert!(flying.contains(&format!("\n| {check} |\n")), "docs/flying.md: {check}");
    }
    for mode in Mode::ALL.into_iter().filter(|mode| *mode != Mode::Disarmed) {
        let fallback = mode.fallback().map_or_else(String::new, |mode| format!("{mode} "));
        let (begins, ends) = (format!("| {mode} | "), format!(" | {} | {fallback}|", mode.needs()));
        assert!(
            flying.lines().any(|line| line.starts_with(&begins) && line.ends_with(&ends)),
            "docs/flying.md: {begins}…{ends}"
        );
    }
}

#[test]
fn the_page_of_parameters_is_what_the_command_prints() {
    let printed = sim_host(&["params", "--format", "markdown"]);
    let page = std::fs::read_to_string(root().join("docs/parameters.md")).expect("the page");
    assert_eq!(
        String::from_utf8_lossy(&printed.stdout),
        page,
        "sim-host params --format markdown > docs/parameters.md"
    );
}

#[test]
fn a_parameter_out_of_range_is_refused_on_the_command_line_with_its_range() {
    for (argument, says) in [
        ("FS_LINK_S=100", "FS_LINK_S=100: FS_LINK_S = 100: must be from 0.1 to 10 s"),
        ("FS_LINK_S=fast", "FS_LINK_S = fast: must be a number"),
        ("NO_SUCH=1", "NO_SUCH=1: there is no parameter of this name"),
        ("FS_LINK_S", "FS_LINK_S: must be NAME=VALUE"),
    ] {
        let output = sim_host(&["params", argument]);
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(text.contains(says) && output.status.code() == Some(2), "{text}");
    }
    let set = sim_host(&["params", "FS_LINK_S=2", "--format", "json"]);
    let values: serde_json::Value = serde_json::from_slice(&set.stdout).expect("JSON");
    let link = values.as_array().expect("a list").iter().find(|row| row["name"] == "FS_LINK_S").expect("its row");
    assert!(link["value"] == 2.0 && link["unit"] == "s" && link["max"] == 10.0, "{link}");
}
