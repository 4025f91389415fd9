//! The station's line: parameters are asked for and set over it, in the records of `flight-link`. Below control.
//!
//! A value that is set is stored at once and flies from the next start on. Nothing is stored while a motor may turn, and
//! nothing arms while something is stored: the flash holds up the program for some 16 µs a word. Where a save needs a sector
//! erased, which takes longer than the watchdog waits, the board starts anew and saves before the watchdog runs
//! (`stored.rs`).
use core::sync::atomic::{AtomicBool, Ordering};

use control_core::parameters::{Parameters, TABLE, index_of};
use cortex_m::peripheral::SCB;
use embassy_futures::block_on;
use embassy_stm32::mode::Async;
use embassy_stm32::usart::{RingBufferedUartRx, UartTx};
use embassy_time::Timer;
use firmware::stored::{Loaded, SaveError};
use flight_link::{Decoder, FRAME_BYTES_MAX, Outcome, ParameterName, Record, encode};

use crate::board::Store;
use crate::kept::Kept;

/// A motor may turn.
static RUNS: AtomicBool = AtomicBool::new(false);
/// Something is being stored.
static STORES: AtomicBool = AtomicBool::new(false);
/// Place in [`TABLE`] and value of a parameter that is to be stored at the next start.
#[unsafe(link_section = ".uninit.pending")]
static PENDING: Kept<2> = Kept::uninit();

/// Notes whether a motor may turn. Only the control task calls this.
pub(crate) fn note_motors(run: bool) {
    RUNS.store(run, Ordering::Relaxed);
}

/// Whether something is being stored, and nothing must arm.
pub(crate) fn stores() -> bool {
    STORES.load(Ordering::Relaxed)
}

/// Loads the parameters, and stores one that had to wait for this start. From then on no sector is erased.
pub(crate) fn load(store: &mut Store) -> Loaded {
    let mut loaded = block_on(store.load());
    if let Some([place, bits]) = PENDING.take()
        && let Some(declaration) = TABLE.get(place as usize)
    {
        if block_on(store.save(declaration, f32::from_bits(bits))).is_err() {
            defmt::error!("the flash refuses {=str}", declaration.name);
        }
        loaded = block_on(store.load());
    }
    store.stop_erasing();
    if loaded.is_valid() {
        defmt::info!("{=usize} parameters are set, the others have their defaults", loaded.set);
    } else if loaded.lost {
        defmt::error!("the stored parameters could not be read: defaults hold");
    } else {
        defmt::error!("{=usize} stored parameters are outside their ranges: their defaults hold", loaded.refused);
    }
    loaded
}

/// Listens to the station and answers.
#[embassy_executor::task]
pub(crate) async fn converse(
    mut hear: RingBufferedUartRx<'static>,
    mut say: UartTx<'static, Async>,
    mut store: Store,
    mut parameters: Parameters,
) -> ! {
    let mut decoder = Decoder::new();
    let mut bytes = [0; 64];
    loop {
        // After noise or an overrun the line is listened to anew: frames have checksums.
        let Ok(count) = hear.read(&mut bytes).await else { continue };
        for &byte in &bytes[..count] {
            let wish = decoder.push(byte);
            let Some((name, outcome)) = wish.and_then(|wish| consider(wish, &mut store, &mut parameters)) else {
                continue;
            };
            let value = core::str::from_utf8(&name).ok().and_then(|name| parameters.get(name.trim_end_matches('\0')));
            let answer = Record::Parameter(name, value.unwrap_or(f32::NAN), outcome);
            let mut place = [0; FRAME_BYTES_MAX];
            if let Ok(frame) = encode(&answer, &mut place) {
                // Nobody to tell whom that the line does not work.
                let _ = say.write(frame).await;
            }
            if outcome == Outcome::Restarting {
                // The last two bytes are still on their way.
                Timer::after_millis(1).await;
                SCB::sys_reset();
            }
            STORES.store(false, Ordering::Relaxed);
        }
    }
}

/// Does what a record wishes; returns the parameter it is about and what became of it.
fn consider(wish: Record, store: &mut Store, parameters: &mut Parameters) -> Option<(ParameterName, Outcome)> {
    let (name, value) = match wish {
        Record::SetParameter(name, value) => (name, Some(value)),
        Record::GetParameter(name) => (name, None),
        _ => return None,
    };
    let known = core::str::from_utf8(&name).ok().and_then(|name| index_of(name.trim_end_matches('\0')));
    let outcome = match (known, value) {
        (None, _) => Outcome::Unknown,
        (Some(_), None) => Outcome::Said,
        (Some(place), Some(value)) => set(place, value, store, parameters),
    };
    Some((name, outcome))
}

/// Stores a value, if it may be.
fn set(place: usize, value: f32, store: &mut Store, parameters: &mut Parameters) -> Outcome {
    let mut wanted = *parameters;
    let Some(declaration) = TABLE.get(place).filter(|_| wanted.set_at(place, value).is_ok()) else {
        return Outcome::OutOfRange;
    };
    // In this order: control comes between only as a whole, so either it sees this, or this sees that it runs.
    STORES.store(true, Ordering::SeqCst);
    if RUNS.load(Ordering::SeqCst) {
        return Outcome::Armed;
    }
    match block_on(store.save(declaration, value)) {
        Ok(()) => {
            *parameters = wanted;
            Outcome::Stored
        }
        Err(SaveError::NeedsErase) => {
            PENDING.keep([place as u32, value.to_bits()]);
            Outcome::Restarting
        }
        Err(SaveError::Flash) => Outcome::Failed,
    }
}
