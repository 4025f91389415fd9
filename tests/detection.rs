//! The detector's promise in small: the campaign of `sim-host detect` with few flights. docs/detection.md has the whole.
use control_core::DetectorConfig;
use sim_host::detection::{Campaign, Results, Step};
use sim_host::scenario::Scenario;
use system_tests::shipped;

fn campaign(scenario: &Scenario, losses: &[f64]) -> Results {
    let campaign = Campaign {
        scenario,
        detector: DetectorConfig::NOMINAL,
        seed: 77,
        losses: losses.to_vec(),
        flights: 20,
        healthy_flights: 2,
    };
    campaign.fly(&|| {}).expect("the shipped detector is valid")
}

/// Delays that half and 19 of 20 flights stay within, s.
fn delays_s(step: &Step) -> [f64; 2] {
    [0.5, 0.95].map(|share| step.delay_s(share).unwrap_or(f64::INFINITY))
}

#[test]
fn silent_losses_in_a_hover_are_found_in_time_and_nothing_else_is() {
    let mut scenario = shipped("detection/hover");
    scenario.duration_s = 300.0;
    let results = campaign(&scenario, &[0.2, 0.4, 1.0]);
    assert_eq!((results.healthy.alarms, results.healthy.lost), (0, 0), "{:?}", results.healthy);
    let [weak, weaker, lost] = &results.steps[..] else { panic!("three losses") };
    for step in [weak, weaker, lost] {
        assert_eq!((step.missed(), step.wrong(), step.fair().count()), (0, 0, 20), "{}", step.loss);
    }
    assert!(delays_s(weak)[0] <= 0.2, "{:?}", delays_s(weak));
    let [median_s, late_s] = delays_s(weaker);
    assert!(median_s <= 0.05 && late_s <= 0.1, "{median_s} {late_s}");
    assert!(delays_s(lost)[1] <= 0.03, "{:?}", delays_s(lost));
}

#[test]
fn a_campaign_does_not_depend_on_how_many_threads_fly() {
    let mut scenario = shipped("detection/manoeuvre");
    scenario.duration_s = 20.0;
    let fly = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let results = pool.install(|| campaign(&scenario, &[0.4]));
        let outcomes: Vec<_> = results.steps.into_iter().flat_map(|step| step.outcomes).collect();
        (outcomes, results.healthy, results.roc.curve(0.4, 0.1))
    };
    assert_eq!(fly(1), fly(3));
}
