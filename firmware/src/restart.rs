//! Restart: what the flight must not forget, in RAM that no reset clears, and the clock that goes on over one.
//!
//! What is kept, and when a flight goes on from it, says `control_core::restart`. Here are the bytes: two copies in turn, so that one is
//! whole whenever the program is stopped; the parameters in force, since those in flash may be newer; where the satellite receiver has home.
//! Each is taken at the next start, whatever its cause: none is older than that.
use core::sync::atomic::{AtomicU32, Ordering};

use control_core::flight::Flight;
use control_core::geodesy::{Geodetic, LocalFrame};
use control_core::parameters::{COUNT, Parameters};
use control_core::restart::{Memory, WORDS};

use crate::board::WATCHDOG_US;
use crate::kept::Kept;

/// Steps between two that are kept: 4 ms.
const KEEP_EVERY: u32 = 8;
/// A copy, and when it was made, µs, low word first.
const STAMPED: usize = WORDS + 2;

#[unsafe(link_section = ".uninit.flight")]
static FLIGHT: [Kept<STAMPED>; 2] = [const { Kept::uninit() }; 2];
#[unsafe(link_section = ".uninit.parameters")]
static PARAMETERS: Kept<COUNT> = Kept::uninit();
#[unsafe(link_section = ".uninit.home")]
static HOME: Kept<3> = Kept::uninit();
/// What the clock read at this start, ms.
static STARTED_MS: AtomicU32 = AtomicU32::new(0);

/// What was kept over a reset.
pub(crate) struct Before {
    pub(crate) memory: Memory,
    pub(crate) parameters: Parameters,
    pub(crate) home: Option<LocalFrame>,
}

/// Takes what was kept; nothing unless the watchdog has caused this start. The clock goes on then.
#[inline(never)]
pub(crate) fn take(bitten: bool) -> Option<Before> {
    let copies = [FLIGHT[0].take(), FLIGHT[1].take()];
    let (parameters, home) = (PARAMETERS.take(), HOME.take());
    let stamp = |copy: &[u32; STAMPED]| u64::from(copy[1]) << 32 | u64::from(copy[0]);
    let newest = copies.into_iter().flatten().max_by_key(stamp).filter(|_| bitten)?;
    let mut values = Parameters::default();
    for (index, bits) in parameters?.into_iter().enumerate() {
        values.set_at(index, f32::from_bits(bits)).ok()?;
    }
    let lasted_ms = (stamp(&newest) + u64::from(WATCHDOG_US)) / 1000 + 1;
    STARTED_MS.store(u32::try_from(lasted_ms).ok()?, Ordering::Relaxed);
    let place = |[latitude, longitude, altitude]: [u32; 3]| Geodetic {
        latitude_e7: latitude.cast_signed(),
        longitude_e7: longitude.cast_signed(),
        altitude_m: f32::from_bits(altitude),
    };
    let mut memory = [0; WORDS];
    memory.iter_mut().zip(&newest[2..]).for_each(|(place, word)| *place = *word);
    Some(Before { memory, parameters: values, home: home.and_then(|home| LocalFrame::try_new(place(home)).ok()) })
}

/// Keeps the parameters in force.
pub(crate) fn keep_parameters(parameters: &Parameters) {
    let mut words = [0; COUNT];
    words.iter_mut().zip(parameters.iter()).for_each(|(word, (_, value))| *word = value.to_bits());
    PARAMETERS.keep(&words);
}

/// Keeps where home is.
pub(crate) fn keep_home(home: &LocalFrame) {
    let Geodetic { latitude_e7, longitude_e7, altitude_m } = home.home();
    HOME.keep(&[latitude_e7.cast_unsigned(), longitude_e7.cast_unsigned(), altitude_m.to_bits()]);
}

/// Keeps the flight after a step, if it is its turn and there is one. Only the control task calls this.
///
/// - `number`: of the step.
#[inline(never)]
pub(crate) fn keep(flight: &mut Flight, number: u32, now_us: u64) {
    if !number.is_multiple_of(KEEP_EVERY) {
        return;
    }
    let [even, odd] = &FLIGHT;
    if let Some(memory) = flight.remember() {
        let copy = if number.is_multiple_of(2 * KEEP_EVERY) { even } else { odd };
        let mut stamped = [0; STAMPED];
        let words = [now_us as u32, (now_us >> 32) as u32].into_iter().chain(memory);
        stamped.iter_mut().zip(words).for_each(|(place, word)| *place = word);
        copy.keep(&stamped);
    } else {
        even.forget();
        odd.forget();
    }
}

/// What the clock of the flight read when that of the chip began, µs.
pub(crate) fn started_us() -> u64 {
    1000 * u64::from(STARTED_MS.load(Ordering::Relaxed))
}
