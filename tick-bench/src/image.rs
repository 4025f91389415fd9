//! The program: replay, compare, print.
use crate::count::Counter;
use crate::stack::Canvas;
use crate::{estimator, helm, math, record};
use control_core::{Controller, Input, Output, State};
use core::fmt::{self, Display};
use core::hint::black_box;
use core::panic::PanicInfo;
use cortex_m_rt::{ExceptionFrame, entry, exception};
use cortex_m_semihosting::{debug, hprintln};

#[entry]
fn main() -> ! {
    match run() {
        Ok(()) => debug::exit(debug::EXIT_SUCCESS),
        Err(reason) => fail(&reason),
    }
    park()
}

fn run() -> Result<(), &'static str> {
    let peripherals = cortex_m::Peripherals::take().ok_or("the peripherals are taken")?;
    let counter = Counter::new(peripherals.SYST);
    estimator::print(&counter)?;
    helm::print(&counter)?;
    let record::Record { config, ticks } = record::flight().ok_or("no tick record at 0x21000000")?;
    let controller = Controller::try_new(black_box(&config)).map_err(|_| "the flight configuration is refused")?;
    hprintln!("{}", replay(&counter, &controller, ticks));
    math::print(&counter);
    Ok(())
}

/// What the replay of a record found.
#[derive(Default)]
struct Replay {
    ticks: u32,
    instructions: u64,
    /// The most from sample to thrusts, and of a whole tick.
    path: u32,
    worst: u32,
    worst_at: u32,
    stack: u32,
    rejected: u32,
    differing: u32,
    first_differing: Option<u32>,
}

/// Flies the record again from a hover, as the host did.
fn replay(counter: &Counter, controller: &Controller, ticks: &[record::Tick]) -> Replay {
    let mut state = controller.hover_state();
    let mut replay = Replay::default();
    let canvas = Canvas::paint();
    for record in ticks {
        let (input, host_thrust_n) = record.decode();
        let (path, output) = counter.instructions(|| act(controller, &mut state, &input));
        let output = *output;
        let (after, ()) = counter.instructions(|| reflect(controller, &mut state));
        replay.add(path, after, &output, host_thrust_n);
    }
    replay.stack = canvas.depth();
    replay
}

/// From sample to thrusts as a task would call it: not inlined, so that the call is counted too.
#[inline(never)]
fn act<'a>(controller: &Controller, state: &'a mut State, input: &Input) -> &'a Output {
    controller.act(state, input)
}

/// The rest of the tick.
#[inline(never)]
fn reflect(controller: &Controller, state: &mut State) {
    controller.reflect(state);
}

impl Replay {
    fn add(&mut self, path: u32, after: u32, output: &Output, host_thrust_n: [f32; 4]) {
        self.path = path.max(self.path);
        let instructions = path + after;
        if instructions > self.worst {
            (self.worst, self.worst_at) = (instructions, self.ticks);
        }
        if output.thrust_n.map(f32::to_bits) != host_thrust_n.map(f32::to_bits) {
            self.differing += 1;
            self.first_differing.get_or_insert(self.ticks);
        }
        self.rejected += u32::from(output.rejected);
        self.instructions += u64::from(instructions);
        self.ticks += 1;
    }
}

impl Display for Replay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { ticks, instructions, path, worst, worst_at, stack, rejected, differing, first_differing } = self;
        let mean = *instructions as f32 / (*ticks).max(1) as f32;
        write!(
            f,
            "tick ticks={ticks} path={path} worst={worst} mean={mean:.1} worst_at={worst_at} stack={stack} rejected={rejected} \
             differing={differing} first_differing="
        )?;
        match first_differing {
            Some(tick) => write!(f, "{tick}"),
            None => write!(f, "none"),
        }
    }
}

/// Ends the emulation with a failure and its reason.
fn fail(reason: &dyn Display) {
    hprintln!("error: {}", reason);
    debug::exit(debug::EXIT_FAILURE);
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    fail(info);
    park()
}

#[exception]
unsafe fn HardFault(_frame: &ExceptionFrame) -> ! {
    fail(&"hard fault");
    park()
}

/// Only a debugger that refuses to exit gets here.
fn park() -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}
