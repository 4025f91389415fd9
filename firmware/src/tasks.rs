//! The two tasks, and the line between them.
//!
//! ```text
//! TIM5 ─► control task, interrupt executor ── one report a second, lock-free queue ─► log task, thread executor
//! ```
//!
//! Control preempts the log at any instruction: the queue takes no lock and a log line masks no interrupt. What is left
//! to delay it are the executors' own critical sections, some dozens of cycles.
use control_core::{Airframe, Axis, Config, Controller, Input, Law, Output, State};
use cortex_m::peripheral::DWT;
use cortex_m::singleton;
use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_time::{Duration, Instant, Ticker, Timer};
use heapless::spsc::{Consumer, Producer, Queue};

use crate::board::{self, Board, Motors, Status};
use firmware::pace::Pace;
use firmware::pulse::Pulse;
use firmware::report::{Report, Tally};
use firmware::synthetic;

/// Reports that may wait for the log: it would have to hang for as many seconds to miss one.
const REPORTS: usize = 4;
/// The queue keeps one place free.
type Reports = Queue<Report, { REPORTS + 1 }>;
type Reporter = Producer<'static, Report>;
type Reader = Consumer<'static, Report>;

/// Thrust over weight of the airframe that is flown.
const THRUST_TO_WEIGHT: f32 = 2.2;

/// Brings up the board and starts both tasks.
///
/// # Panics
/// If the configuration is refused or a task is started twice: both before a motor could turn.
pub(crate) fn start(spawner: Spawner) {
    let Board { motors, status } = board::init();
    start_cycle_counter();
    defmt::info!("{=str}: synthetic sensors, no arming: motors are held at the stop pulse", board::NAME);

    let reports: &'static mut Reports = singleton!(: Reports = Queue::new()).expect("start runs once");
    let (producer, consumer) = reports.split();
    let flight = Flight::new();
    let control = control(flight, motors, producer).expect("control is started once");
    board::start_control_executor().spawn(control);
    spawner.spawn(log(consumer, status).expect("log is started once"));
}

/// The core and what it flies.
struct Flight {
    airframe: Airframe,
    control_hz: f32,
    controller: Controller,
    state: State,
}

impl Flight {
    fn new() -> Self {
        let airframe = Airframe::paper(THRUST_TO_WEIGHT);
        // Not `Config::tolerant`: synthetic sensors do not answer the rotors, and it would find them all at fault.
        let config = Config::flight(Law::Lgs, airframe);
        // Not `expect`: printing a float in text would add 30 KB to the image.
        let controller = Controller::try_new(&config).unwrap_or_else(|e| {
            defmt::panic!("{=str}.{=str} = {=f32}, allowed: {=str}", e.part, e.field, e.value, e.allowed)
        });
        let state = controller.hover_state();
        Self { airframe, control_hz: config.control_hz, controller, state }
    }

    /// Ticks the core; returns also what that cost, in cycles.
    fn tick(&mut self, input: &Input) -> (&Output, u32) {
        let start = DWT::cycle_count();
        let output = self.fly(input);
        (output, DWT::cycle_count().wrapping_sub(start))
    }

    fn altitude_gains(&self) -> [f32; 3] {
        self.controller.telemetry(&self.state).axes[Axis::Z as usize].gains
    }

    /// Not inlined, so that the cycle counter's reads enclose all of the tick and nothing else.
    #[inline(never)]
    fn fly(&mut self, input: &Input) -> &Output {
        self.controller.tick(&mut self.state, input)
    }
}

/// Reads, calls the core, writes: at the control rate, above everything but the clock.
#[embassy_executor::task]
async fn control(mut flight: Flight, mut motors: Motors, mut reports: Reporter) -> ! {
    let airframe = flight.airframe;
    let mut tally = Tally::new(flight.control_hz);
    let mut pace = Pace::new(flight.control_hz, now_us());
    loop {
        Timer::at(Instant::from_micros(pace.due_us())).await;
        let time_us = now_us();
        let input = synthetic::sample(time_us, pace.start(time_us));
        let (output, cycles) = flight.tick(&input);
        motors.stop();
        let pulses = Pulse::from_thrusts(output.thrust_n, &airframe);
        tally.tick(&input, output, pulses, cycles);
        if let Some(report) = tally.close(pace.finish(now_us())) {
            let report = Report { altitude_gains: flight.altitude_gains(), ..report };
            // A full queue means that the log hangs, and then there is nobody to tell.
            let _ = reports.enqueue(report);
        }
    }
}

fn now_us() -> u64 {
    Instant::now().as_micros()
}

/// Writes a line for each report and blinks: below everything.
#[embassy_executor::task]
async fn log(mut reports: Reader, mut status: Status) -> ! {
    let mut second = Ticker::every(Duration::from_secs(1));
    loop {
        second.next().await;
        status.toggle();
        while let Some(report) = reports.dequeue() {
            write(&report);
        }
    }
}

fn write(report: &Report) {
    let Report { ticks, late, rejected, cycles_max, altitude_error_m_max, .. } = *report;
    let [k_p, k_i, k_d] = report.altitude_gains;
    let [m1, m2, m3, m4] = report.pulses.map(Pulse::us);
    defmt::info!("ticks {=u32}, late {=u32}, rejected {=u32}, worst {=u32} cycles", ticks, late, rejected, cycles_max);
    defmt::info!("altitude error within {=f32} m, gains {=f32} {=f32} {=f32}", altitude_error_m_max, k_p, k_i, k_d);
    defmt::info!("motors stopped; armed they would get {=u16} {=u16} {=u16} {=u16} us", m1, m2, m3, m4);
}

/// Starts the counter behind `DWT::cycle_count`.
fn start_cycle_counter() {
    let mut core = cortex_m::Peripherals::take().expect("start runs once");
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
}
