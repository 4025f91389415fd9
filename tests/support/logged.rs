//! What tests of the flight log share, whatever it is on.
use crate::aloft::{Aloft, Hands};
use sim_host::replay::{Replay, Start, replay, starts};

/// Stands on the ground until `until_s`; returns what the image logs meanwhile.
pub fn stand(aloft: &mut Aloft, until_s: f64) -> String {
    let mut log = String::new();
    while aloft.time_s() < until_s {
        aloft.step(&Hands::default());
        if !aloft.answer.log.is_empty() {
            log += &aloft.answer.log;
            log.push('\n');
        }
    }
    log
}

/// What is in a file, start by start; no command differs in any.
///
/// # Panics
/// If one does, or it is none.
pub fn read(log: &[u8]) -> Vec<Replay> {
    let part = |Start { offset, bytes }| &log[offset as usize..(offset + bytes) as usize];
    let told = |start| replay(part(start), &mut |_, _| {}).expect("a log");
    let all: Vec<Replay> = starts(&mut &*log).expect("logs").into_iter().map(told).collect();
    for told in &all {
        assert_eq!(told.verdict.parting.filter(|_| told.gaps.is_empty()), None, "{:?}", told.verdict);
    }
    all
}

/// Steps that were logged, of which none may be missing.
///
/// # Panics
/// If one is.
pub fn whole(told: &Replay) -> u64 {
    assert_eq!((told.gaps.as_slice(), told.damage.as_slice()), (&[][..], &[][..]), "{} steps", told.steps);
    assert_eq!(u64::from(told.verdict.commands), told.steps);
    told.steps
}

/// No step may end late, nor a sample be missed, whatever the medium does.
///
/// - `reports`: at least as many are in the log.
///
/// # Panics
/// If one does.
pub fn assert_on_time(log: &str, reports: usize) {
    let lines: Vec<&str> = log.lines().filter(|line| line.contains("steps ")).collect();
    assert!(lines.len() >= reports && lines.iter().all(|line| line.contains("late 0, blind 0")), "{log}");
}
