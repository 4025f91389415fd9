//! A board whose clock has run for long: the image's time driver is told so before anything asks it for the time.
//!
//! The driver keeps the upper part of the time in a word of RAM, in periods of 2¹⁵ µs; the timer has the lower part. Where in the driver that
//! word is, is not written anywhere: another board is let run, and the word that counts its time is looked for.
use super::Machine;
use crate::{Failure, Image};

/// The image's time driver, and µs in one of its periods.
const DRIVER: &str = "time_driver6driver6DRIVER";
const PERIOD_US: u64 = 1 << 15;
/// How long the other board runs, core cycles: 0.5 s.
const TRIAL: u64 = 84_000_000;
/// Within which the image starts its clock, and steps in which that is looked for, core cycles.
const START_MAX: u64 = 10_000_000;
const STEP: u64 = 20;
/// The timer of the clock among those of the chip: TIM5.
const CLOCK: usize = 4;

impl Machine {
    /// A board just switched on, whose image takes its clock to have run for about `uptime_s` by then.
    ///
    /// # Errors
    /// As for [`Machine::new`]; or if the image's clock is not found.
    pub fn with_uptime(image: &Image, uptime_s: u32) -> Result<Self, Failure> {
        let word = clock_word(image)?;
        let mut machine = Self::new(image)?;
        while !machine.state.borrow().chip.timers[CLOCK].is_on() {
            if machine.now() > START_MAX {
                return Err(Failure("the image does not start its clock".to_owned()));
            }
            machine.run_until(machine.now() + STEP)?;
        }
        // An even number of periods: the driver compares the lowest bit with the timer's upper one.
        let periods = u64::from(uptime_s) * 1_000_000 / PERIOD_US & !1;
        machine.set_word(word, periods as u32)?;
        Ok(machine)
    }
}

/// Where the image counts the periods of its clock.
fn clock_word(image: &Image) -> Result<u32, Failure> {
    let (start, bytes) = image.symbol_with(DRIVER)?;
    let mut trial = Machine::new(image)?;
    trial.run_until(TRIAL)?;
    let counted = TRIAL / (trial.core_hz() / 1_000_000) / PERIOD_US;
    let mut found = Vec::new();
    for address in (start..start + bytes).step_by(4) {
        if (counted.saturating_sub(1)..=counted + 1).contains(&u64::from(trial.word(address)?)) {
            found.push(address);
        }
    }
    match found[..] {
        [address] => Ok(address),
        _ => Err(Failure(format!("{} words of the image's time driver look like its time", found.len()))),
    }
}
