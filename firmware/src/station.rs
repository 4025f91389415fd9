//! The station: it is told how the machine is, asks for and sets parameters, and lets rotors turn on the bench, in the records
//! of `flight-link` over the lines of `line.rs`. Below control.
//!
//! ```text
//! control ─► snapshot, ten a second, the newest only ─► lines
//! lines ─► records ─► order for the bench ─► control ─► whether it was obeyed
//! ```
//!
//! A test on the bench ends when no line has brought a record for [`SILENCE_US`]: control looks itself, so that it does
//! even where all below it hangs.
//!
//! A value that is set is stored at once and flies from the next start on. Nothing is stored while a motor may turn, and
//! nothing arms while something is stored: the flash holds up the program for some 16 µs a word. Where a save needs a sector
//! erased, which takes longer than the watchdog waits, the board starts anew and saves before the watchdog runs
//! (`stored.rs`).
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use control_core::autopilot::BenchOrder;
use control_core::motor_test::{MotorTestOrder, SECONDS_MAX, SHARE_MAX};
use control_core::parameters::{Parameters, TABLE, index_of};
use cortex_m::peripheral::SCB;
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, TimeoutError, with_timeout};
use firmware::stored::{Loaded, SaveError};
use firmware::telemetry::Snapshot;
use flight_link::{FromBoard, LogRefusal, MotorTest, Order, Outcome, ParameterName, Status, ToBoard, VERSION, Verdict};

use crate::board::{LOG_ON_CARD, LOG_ON_FLASH, Store};
use crate::kept::Kept;
use crate::line::{Line, RECORDS, SERIAL, USB};
use crate::recorder;
use crate::tasks::now_us;

/// How long no record may come before a test on the bench ends, µs.
const SILENCE_US: u32 = 500_000;
/// How long control may take to look at an order: a hundred steps.
const CONTROL_PATIENCE: Duration = Duration::from_millis(50);

/// The newest snapshot of flight.
pub(crate) static SNAPSHOT: Signal<CriticalSectionRawMutex, Snapshot> = Signal::new();
/// What is asked of the bench, and whether control has done it.
static ORDER: Signal<CriticalSectionRawMutex, BenchOrder> = Signal::new();
static OBEYED: Signal<CriticalSectionRawMutex, bool> = Signal::new();
/// When a record came last, µs, the lower 32 bits.
static HEARD_US: AtomicU32 = AtomicU32::new(0);

/// A motor may turn.
static RUNS: AtomicBool = AtomicBool::new(false);
/// Something is being stored.
static STORES: AtomicBool = AtomicBool::new(false);
/// Place in [`TABLE`] and value of a parameter that is to be stored at the next start.
#[unsafe(link_section = ".uninit.pending")]
static PENDING: Kept<2> = Kept::uninit();

/// Notes whether a motor may turn, right after that was decided. Only the control task calls this.
pub(crate) fn note_motors(run: bool) {
    RUNS.store(run, Ordering::Relaxed);
}

/// Whether a motor may turn.
pub(crate) fn runs() -> bool {
    RUNS.load(Ordering::Relaxed)
}

/// Whether something is being stored, and nothing must arm; to be asked right before that is decided.
pub(crate) fn stores() -> bool {
    STORES.load(Ordering::Relaxed)
}

/// What is asked of the bench now. Only the control task calls this.
///
/// - `armed`: whether it is, so that nothing will be done.
/// - `on_bench`: whether a test runs.
pub(crate) fn order(now_us: u64, armed: bool, on_bench: bool) -> Option<BenchOrder> {
    let order = ORDER.try_take();
    if order.is_some() {
        OBEYED.signal(!armed);
    }
    // A test takes less than the 35 minutes after which this looks like the future, which it is if it was heard while this step read the
    // inertial unit.
    let age_us = (now_us as u32).wrapping_sub(HEARD_US.load(Ordering::Relaxed)).cast_signed();
    let silent = age_us > SILENCE_US.cast_signed();
    order.or((on_bench && silent).then_some(BenchOrder::Stop))
}

/// Loads the parameters, and stores one that had to wait for this start. From then on no sector is erased.
pub(crate) fn load(store: &mut Store) -> Loaded {
    let mut loaded = store.load();
    if let Some([place, bits]) = PENDING.take()
        && let Some(declaration) = TABLE.get(place as usize)
    {
        if store.save(declaration, f32::from_bits(bits)).is_err() {
            defmt::error!("the flash refuses {=str}", declaration.name);
        }
        loaded = store.load();
    }
    store.stop_erasing();
    if loaded.is_valid() {
        defmt::info!("{=usize} parameters are set, the others have their defaults", loaded.set);
    } else if loaded.lost {
        defmt::error!("the stored parameters could not be read: defaults hold");
    } else {
        defmt::error!(
            "{=usize} stored parameters are outside their ranges or of another schema: their defaults hold",
            loaded.refused
        );
    }
    loaded
}

/// Tells the station how the machine is, and does what it asks for.
#[embassy_executor::task]
pub(crate) async fn converse(mut store: Store, mut parameters: Parameters) -> ! {
    loop {
        match select(RECORDS.receive(), SNAPSHOT.wait()).await {
            Either::First((line, record)) => {
                HEARD_US.store(now_us() as u32, Ordering::Relaxed);
                answer(line, record, &mut store, &mut parameters).await;
            }
            Either::Second(snapshot) => [&SERIAL, &USB].into_iter().for_each(|line| tell(line, &snapshot)),
        }
    }
}

/// Says how the machine is.
fn tell(line: &Line, snapshot: &Snapshot) {
    let Snapshot { status, motion, rotors } = *snapshot;
    line.say(&FromBoard::Status(Status { dropped: line.dropped(), ..status }));
    line.say(&FromBoard::Motion(motion));
    line.say(&FromBoard::Rotors(rotors));
}

async fn answer(line: &'static Line, record: ToBoard, store: &mut Store, parameters: &mut Parameters) {
    let (restarts, record) = match record {
        ToBoard::SetParameter(name, value) => consider(name, Some(value), store, parameters),
        ToBoard::GetParameter(name) => consider(name, None, store, parameters),
        ToBoard::Hello => (false, FromBoard::Hello(VERSION)),
        ToBoard::Order(order) => {
            let verdict = obey(order).await;
            (order == Order::Restart && verdict == Verdict::Done, FromBoard::Ordered(verdict))
        }
        ToBoard::Log(_) if runs() => (false, FromBoard::LogRefused(LogRefusal::Armed)),
        ToBoard::Log(_) if !(LOG_ON_CARD || LOG_ON_FLASH) => (false, FromBoard::LogRefused(LogRefusal::Absent)),
        ToBoard::Log(wish) => return recorder::WISH.signal((line, wish)),
        ToBoard::VisionPose(_) => return,
    };
    line.say(&record);
    if restarts {
        line.drain().await;
        SCB::sys_reset();
    }
    STORES.store(false, Ordering::Relaxed);
}

/// Does what is ordered; returns what became of it.
async fn obey(order: Order) -> Verdict {
    let order = match order {
        Order::MotorTest(MotorTest { rotor, share, seconds }) => {
            let within = |x: f32, most: f32| x > 0.0 && x <= most;
            if rotor.is_some_and(|rotor| rotor > 3) || !within(share, SHARE_MAX) || !within(seconds, SECONDS_MAX) {
                return Verdict::OutOfRange;
            }
            BenchOrder::Motors(MotorTestOrder { rotor: rotor.map(usize::from), share, seconds })
        }
        Order::WiringCheck => BenchOrder::Wiring,
        Order::Stop => BenchOrder::Stop,
        Order::Restart => {
            // As for storing: nothing arms between this and the reset.
            STORES.store(true, Ordering::SeqCst);
            return if RUNS.load(Ordering::SeqCst) { Verdict::Armed } else { Verdict::Done };
        }
    };
    OBEYED.reset();
    ORDER.signal(order);
    match with_timeout(CONTROL_PATIENCE, OBEYED.wait()).await {
        Ok(true) => Verdict::Done,
        Ok(false) => Verdict::Armed,
        Err(TimeoutError) => {
            ORDER.reset();
            Verdict::Unheard
        }
    }
}

/// Says a parameter, or keeps a value of it; whether the board starts anew then, and the answer.
fn consider(
    name: ParameterName,
    value: Option<f32>,
    store: &mut Store,
    parameters: &mut Parameters,
) -> (bool, FromBoard) {
    let known = core::str::from_utf8(&name).ok().and_then(|name| index_of(name.trim_end_matches('\0')));
    let outcome = match (known, value) {
        (None, _) => Outcome::Unknown,
        (Some(_), None) => Outcome::Said,
        (Some(place), Some(value)) => set(place, value, store, parameters),
    };
    let value = known.and_then(|place| parameters.iter().nth(place)).map_or(f32::NAN, |(_, value)| value);
    (outcome == Outcome::Restarting, FromBoard::Parameter(name, value, outcome))
}

/// Stores a value, if it may be.
fn set(place: usize, value: f32, store: &mut Store, parameters: &mut Parameters) -> Outcome {
    let mut wanted = *parameters;
    let Some(declaration) = TABLE.get(place).filter(|_| wanted.set_at(place, value).is_ok()) else {
        return Outcome::OutOfRange;
    };
    // In this order: control decides and says so without a pause, so either it has seen this, or this sees that it is armed.
    STORES.store(true, Ordering::SeqCst);
    if RUNS.load(Ordering::SeqCst) {
        return Outcome::Armed;
    }
    match store.save(declaration, value) {
        Ok(()) => {
            *parameters = wanted;
            Outcome::Stored
        }
        Err(SaveError::NeedsErase) => {
            PENDING.keep(&[place as u32, value.to_bits()]);
            Outcome::Restarting
        }
        Err(SaveError::Flash) => Outcome::Failed,
    }
}
