//! The tasks, and the lines between them.
//!
//! ```text
//! data ready ─► control, interrupt executor ─┬─► motors
//!                  ▲                         ├─ each step, lock-free queue ─► flight log, thread executor
//!                  │                         └─ one report a second, lock-free queue ─► log, thread executor
//!                  └─ newest of each ─ radio, battery, station and the slow sensors, thread executor
//! ```
//!
//! Control preempts the others at any instruction. What is left to delay it are critical sections of some dozens of cycles.
use core::cell::Cell;
use core::mem::MaybeUninit;
use core::sync::atomic::Ordering;

use control_core::flight::{Arrived, Command, Flight};
use control_core::measurement::{Measurements, Stamped};
use control_core::pilot::PilotInput;
use cortex_m::peripheral::DWT;
use cortex_m::singleton;
use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_stm32::gpio::{Level, Output};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, Ticker};
use heapless::spsc::{Consumer, Producer, Queue};

use crate::black_box;
use crate::board::{
    self, BATTERY_SCALE, BUFFERS, Board, Buffers, Gauge, LOG_ON_CARD, LOG_ON_FLASH, Radio, STATUS_ON, Status, Watchdog,
};
use crate::fault;
use crate::gnss::{GNSS, locate};
use crate::imu::Imu;
use crate::line;
use crate::motors::Motors;
use crate::recorder::{self, Flown, Recorder};
use crate::restart::{self, Before};
use crate::sensors::{BARO_ALTITUDE_M, BAROMETER_FOUND, MAGNETIC_UT, sense};
use crate::station::{self, SNAPSHOT};
use crate::usb;
use crate::vision::{VISION, see};
use firmware::battery::Scale;
use firmware::buzzer::{Buzzer, Facts, LOOKS_HZ};
use firmware::crsf::Receiver;
use firmware::erpm::Heard;
use firmware::flight;
use firmware::flight_log::Resumed;
use firmware::icm42688::SAMPLE_HZ;
use firmware::pilot;
use firmware::record::Record;
use firmware::report::{Report, Tally};
use firmware::telemetry::{Pass, Telemetry};

/// Reports that may wait for the log: it would have to hang for as many seconds to miss one.
const REPORTS: usize = 4;
/// The queue keeps one place free.
type Reports = Queue<Report, { REPORTS + 1 }>;
type Reporter = Producer<'static, Report>;
type Reader = Consumer<'static, Report>;

/// Whom control tells of its steps.
struct Listeners {
    reports: Reporter,
    /// If there is something to keep a log on.
    recorder: Option<Recorder>,
}

/// The newest of what arrives slowly.
pub(crate) type Newest<T> = Signal<CriticalSectionRawMutex, Stamped<T>>;
static PILOT: Newest<PilotInput> = Signal::new();
static BATTERY_V: Newest<f32> = Signal::new();
static BATTERY_A: Newest<f32> = Signal::new();
/// What is to be heard of the machine.
static FACTS: Mutex<CriticalSectionRawMutex, Cell<Facts>> = Mutex::new(Cell::new(Facts::NONE));

/// Time within which a step must be done, once it has begun: its period. One that is not is late.
const STEP_US_MAX: u64 = (1e6 / SAMPLE_HZ) as u64;
/// Time within which it must be done for the watchdog to be fed: the longest period that the law is flown at, 500 Hz
/// (`tests/tolerance.rs`).
const STEP_US_HELD: u64 = 2_000;
/// Bytes of the station that may wait: a frame and a half.
const STATION_BYTES: usize = 256;
/// Answers of a speed controller in a second below which the log tells of it: three of four.
const ANSWERS_MIN: u32 = 3 * SAMPLE_HZ as u32 / 4;
/// Battery readings a second.
const BATTERY_HZ: u64 = 10;

/// Brings up the board and starts the tasks.
///
/// # Panics
/// If the configuration is refused or a task is started twice: both before a motor could turn.
pub(crate) fn start(spawner: Spawner) {
    let buffers = singleton!(: Buffers = BUFFERS).expect("start runs once");
    let board = board::init(buffers);
    let Board { motors, ear, imu_bus, imu_select, imu_ready, radio, sensors, gnss, vision, battery, .. } = board;
    let Board { station, usb, mut store, status, buzzer, watchdog, bitten, browned_out, .. } = board;
    start_cycle_counter();
    defmt::info!("{=str}", board::NAME);
    fault::report();
    if browned_out {
        defmt::error!("the supply was too low: the chip has started anew");
    }
    if bitten {
        defmt::error!("the watchdog has reset the chip: no step ended within 2 ms, or a fault had stopped all");
        if !browned_out {
            black_box::report();
        }
    }

    let before = restart::take(bitten && !browned_out);
    let reports: &'static mut Reports = singleton!(: Reports = Queue::new()).expect("start runs once");
    let (producer, consumer) = reports.split();
    // Before the watchdog runs: it may take seconds.
    let loaded = station::load(&mut store);
    // Not `expect`: printing a float in text would add 30 KB to the image.
    let parameters = before.as_ref().map_or(loaded.parameters, |before| before.parameters);
    restart::keep_parameters(&parameters);
    let place = singleton!(: MaybeUninit<Flight> = MaybeUninit::uninit()).expect("start runs once");
    let flight = flight::boot_in(place, &parameters)
        .unwrap_or_else(|e| defmt::panic!("{=str}.{=str} = {=f32} cannot fly", e.name[0], e.name[1], e.value));
    let imu = Imu::new(imu_bus, imu_select, imu_ready);
    let home = before.as_ref().and_then(|before| before.home);
    let at_us = now_us();
    let before = before.filter(|before| flight.resume(before.memory, at_us));
    let resumed = before.is_some();
    if resumed {
        defmt::error!("it was in the air: the flight goes on");
    }
    let motors = Motors::new(motors, ear, &parameters, resumed);
    let valid = loaded.is_valid();
    let mut listeners = Listeners { reports: producer, recorder: None };
    // The constants say to the linker, too, whether there is a queue.
    if (LOG_ON_CARD || LOG_ON_FLASH)
        && let Some(bus) = board.log_bus
    {
        let before = before.map(|Before { memory, .. }| Resumed { at_us, memory });
        let (recorder, blocks, resumed) = recorder::queue(before);
        spawner.spawn(recorder::keep(bus, Flown { parameters, resumed }, blocks).expect("keep is started once"));
        listeners.recorder = Some(recorder);
    }
    let control = control(flight, resumed, valid, imu, motors, watchdog, listeners).expect("control is started once");
    board::start_control_executor().spawn(control);
    spawner.spawn(listen(radio).expect("listen is started once"));
    spawner.spawn(sense(sensors).expect("sense is started once"));
    spawner.spawn(locate(gnss, home).expect("locate is started once"));
    spawner.spawn(see(vision).expect("see is started once"));
    let (say, hear) = station;
    let buffer = singleton!(: [u8; STATION_BYTES] = [0; STATION_BYTES]).expect("start runs once");
    spawner.spawn(line::hear(hear.into_ring_buffered(buffer)).expect("hear is started once"));
    spawner.spawn(line::speak(say).expect("speak is started once"));
    spawner.spawn(usb::serve(usb).expect("serve is started once"));
    spawner.spawn(station::converse(store, loaded.parameters).expect("converse is started once"));
    spawner
        .spawn(measure_battery(battery, BATTERY_SCALE.set_by(&parameters)).expect("measure_battery is started once"));
    spawner.spawn(sound(buzzer).expect("sound is started once"));
    spawner.spawn(log(consumer, status).expect("log is started once"));
}

/// Reads, calls the core, writes: at each inertial sample, above everything but drivers and the clock.
#[embassy_executor::task]
async fn control(
    flight: &'static mut Flight,
    resumed: bool,
    parameters_valid: bool,
    mut imu: Imu,
    mut motors: Motors,
    mut watchdog: Watchdog,
    mut listeners: Listeners,
) -> ! {
    let found = imu.start(resumed).await;
    let mut tally = Tally::new(SAMPLE_HZ);
    let mut telemetry = Telemetry::new(SAMPLE_HZ);
    let (mut number, mut late) = (0_u32, false);
    watchdog.unleash();
    loop {
        imu.wait().await;
        let (time_us, started) = (now_us(), DWT::cycle_count());
        let sample = imu.read().await;
        let armed = flight.helm().decision().is_some_and(|decision| decision.armed);
        let mut arrived = Arrived {
            measurements: Measurements {
                imu: sample.map(|value| Stamped { time_us, value }),
                battery_v: BATTERY_V.try_take(),
                battery_a: BATTERY_A.try_take(),
                baro_altitude_m: BARO_ALTITUDE_M.try_take(),
                magnetic_ut: MAGNETIC_UT.try_take(),
                gnss: GNSS.try_take(),
                vision: VISION.try_take(),
                rotor_rad_s: motors.take_speeds(),
                ..Measurements::default()
            },
            pilot: PILOT.try_take(),
            offboard: None,
            bench: station::order(time_us, armed, flight.helm().state().bench().is_some()),
            late,
            // What is soldered on; what a builder may leave out is the estimator's to miss. And nothing arms while the flash holds
            // up the program.
            self_test_passed: found && BAROMETER_FOUND.load(Ordering::Relaxed) && !station::stores(),
            parameters_valid,
        };
        let command = flight.act(time_us, &arrived);
        motors.write(command).await;
        let told = DWT::cycle_count().wrapping_sub(started);
        // Meanwhile the station may have begun.
        arrived.self_test_passed &= !station::stores();
        flight.decide(time_us, &arrived);
        let armed = flight.helm().decision().is_some_and(|decision| decision.armed);
        station::note_motors(armed || command != Command::Stop);
        number = number.wrapping_add(1);
        let record = Record { step: number, time_us, arrived, command };
        let words = record.to_words();
        black_box::keep(&words);
        if let Some(recorder) = &mut listeners.recorder {
            recorder.note(&words);
        }
        restart::keep(flight, number, time_us);
        if let Some(decision) = flight.helm().decision() {
            FACTS.lock(|facts| facts.set(facts.get().and(decision)));
            if decision.refused {
                tally.refuse(decision.failing);
            }
        }
        tally.step(sample.is_some(), command, told);
        let took_us = now_us().saturating_sub(time_us);
        late = took_us >= STEP_US_MAX;
        if let Some(snapshot) = telemetry.note(&record, flight, Pass { took_us, late }) {
            SNAPSHOT.signal(snapshot);
        }
        // By what the step took, not by when it came: an inertial unit that is gone is no reason to reset in the air. Nor are late steps,
        // as long as the law can be flown with them: the core lands (`Failsafe::Overrun`).
        if took_us <= STEP_US_HELD {
            watchdog.pet();
        }
        if let Some(report) = tally.close(late) {
            let report = Report { answers: motors.take_heard(), ..report };
            // A full queue means that the log hangs, and then there is nobody to tell.
            let _ = listeners.reports.enqueue(report);
        }
    }
}

/// Time since boot, or since that of a flight which went on after a reset, µs.
pub(crate) fn now_us() -> u64 {
    restart::started_us() + Instant::now().as_micros()
}

/// Sounds the buzzer.
#[embassy_executor::task]
async fn sound(mut pin: Output<'static>) -> ! {
    let mut ticker = Ticker::every(Duration::from_hz(LOOKS_HZ));
    let mut buzzer = Buzzer::default();
    loop {
        ticker.next().await;
        let facts = FACTS.lock(|facts| facts.replace(Facts { refused: false, ..facts.get() }));
        let sounds = buzzer.look(facts);
        // All boards drive theirs by a transistor that high turns on.
        pin.set_level(if sounds { Level::High } else { Level::Low });
    }
}

/// Listens to the radio receiver.
#[embassy_executor::task]
async fn listen(mut radio: Radio) -> ! {
    let mut receiver = Receiver::new();
    let mut bytes = [0; 64];
    loop {
        // After noise or an overrun the line is listened to anew: frames have checksums.
        if let Ok(count) = radio.read(&mut bytes).await
            && let Some(channels) = receiver.push(&bytes[..count])
        {
            PILOT.signal(Stamped { time_us: now_us(), value: pilot::input(&channels) });
        }
    }
}

/// Measures the battery.
#[embassy_executor::task]
async fn measure_battery(mut battery: Gauge, scale: Scale) -> ! {
    let mut ticker = Ticker::every(Duration::from_hz(BATTERY_HZ));
    loop {
        ticker.next().await;
        // Where there is no reading the next one is waited for.
        let Some([voltage, current]) = battery.read().await else { continue };
        let time_us = now_us();
        if let Some(value) = scale.volts(voltage) {
            BATTERY_V.signal(Stamped { time_us, value });
        }
        if let Some(value) = scale.amperes(current) {
            BATTERY_A.signal(Stamped { time_us, value });
        }
    }
}

/// Writes a line for each report and blinks: below everything.
#[embassy_executor::task]
async fn log(mut reports: Reader, mut status: Status) -> ! {
    let mut second = Ticker::every(Duration::from_secs(1));
    let mut on = false;
    loop {
        second.next().await;
        on = !on;
        status.set_level(if on { STATUS_ON } else { inverse(STATUS_ON) });
        while let Some(report) = reports.dequeue() {
            write(&report);
        }
    }
}

fn inverse(level: Level) -> Level {
    if level == Level::Low { Level::High } else { Level::Low }
}

fn write(report: &Report) {
    let Report { steps, late, blind, cycles_max, hash, command, refused, answers } = *report;
    defmt::info!("steps {=u32}, late {=u32}, blind {=u32}", steps, late, blind);
    defmt::info!("data ready to frames sent: worst {=u32} cycles; commands so far {=u32:08x}", cycles_max, hash);
    for check in refused.iter() {
        defmt::warn!("arming is refused: {=str}", check.text());
    }
    for (n, Heard { understood, garbled }) in (1_u8..).zip(answers.iter().flatten()) {
        if u32::from(*understood) < ANSWERS_MIN {
            let frames = SAMPLE_HZ as u32;
            defmt::warn!(
                "motor {=u8}: of {=u32} frames {=u16} were answered, {=u16} not understood",
                n,
                frames,
                understood,
                garbled
            );
        }
    }
    match command {
        Command::Stop => defmt::info!("motors stand"),
        Command::Run([m1, m2, m3, m4]) | Command::Bench([m1, m2, m3, m4]) => {
            defmt::info!("motors {=f32} {=f32} {=f32} {=f32}", m1, m2, m3, m4);
        }
    }
}

/// Starts the counter behind `DWT::cycle_count`.
fn start_cycle_counter() {
    let mut core = cortex_m::Peripherals::take().expect("start runs once");
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
}
