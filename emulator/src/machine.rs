//! The machine: a CPU that runs the image, the chip around it, and virtual time between them.
//!
//! Unicorn translates code block by block and asks before each one. There, and only there, time passes: the block before
//! is charged (`block`, `flash_cache`), what is due in the chip happens, and if an exception is to be taken the CPU stops
//! and takes it. So an exception comes up to one block late, some ten cycles, and an access to a peripheral happens at the
//! time its block began.
//!
//! Asleep in WFI or WFE, time jumps to whatever happens next.
use crate::block::{Block, REFILL};
use crate::chip::{Chip, Memory};
use crate::device::crsf;
use crate::exception::{self, ENTRY_CYCLES};
use crate::flash_cache::FlashCache;
use crate::nvic::{HARD_FAULT, Masks, SV_CALL};
use crate::peripheral::flash::FLASH_START;
use crate::{Failure, Image};
use std::cell::RefCell;
use std::rc::Rc;
use unicorn_engine::{Arch, ArmCpuModel, Mode, Prot, RegisterARM as R, Unicorn, uc_error};

const FLASH_BYTES: u32 = 1024 * 1024;
const RAM_START: u32 = 0x2000_0000;
const RAM_BYTES: u32 = 128 * 1024;
/// Unicorn maps whole pages.
const PAGE: u64 = 4096;
/// Peripherals: APB and AHB1, AHB2, the core's own.
const PERIPHERALS: [(u64, u64); 3] = [(0x4000_0000, 0x8_0000), (0x5000_0000, 0x4_0000), (0xe000_0000, 0x10_0000)];

/// Registers of the CPU, and memory.
pub(crate) struct Cpu {
    unicorn: Unicorn<'static, ()>,
}

/// What the CPU has done since reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Load {
    /// Core cycles, sleep included.
    pub cycles: u64,
    /// Core cycles not asleep.
    pub busy: u64,
    /// Instructions; as if each took a cycle, the least that `busy` could be.
    pub instructions: u64,
}

/// What the speed controllers have heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Motors {
    /// What each was told last: a DShot value, or the microseconds of a pulse.
    pub told: [Option<u16>; 4],
    /// Frames and pulses that each has understood.
    pub good: [u32; 4],
    /// Frames that each could not understand.
    pub bad: [u32; 4],
    /// Longest time from a sample of the inertial unit to a frame through after it, core cycles.
    pub latency_max: u64,
}

/// The board, running its image.
pub struct Machine {
    cpu: Cpu,
    state: Rc<RefCell<State>>,
    asleep: Option<Sleep>,
    /// The event register of WFE.
    event: bool,
    faults: Vec<String>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Sleep {
    Interrupt,
    Event,
}

/// All that callbacks from the CPU reach.
struct State {
    chip: Chip,
    cache: FlashCache,
    /// By halfword of flash; decoded when first run.
    blocks: Vec<Option<Box<Block>>>,
    /// The block that runs, with what it has cost so far.
    open: Option<Open>,
    instructions: u64,
    busy: u64,
    /// When to stop.
    until: u64,
    /// Whether the CPU was stopped between two blocks, by this model.
    stopped: bool,
    /// A SEV was run.
    event: bool,
}

#[derive(Clone, Copy)]
struct Open {
    end: u32,
    cost: u64,
    instructions: u32,
    in_it: bool,
}

impl Machine {
    /// A board with `image` in its flash, just switched on.
    ///
    /// # Errors
    /// If the image does not fit, or Unicorn refuses.
    pub fn new(image: &Image) -> Result<Self, Failure> {
        let state = Rc::new(RefCell::new(State {
            chip: Chip::new(),
            cache: FlashCache::new(),
            blocks: vec![None; FLASH_BYTES as usize / 2],
            open: None,
            instructions: 0,
            busy: 0,
            until: 0,
            stopped: false,
            event: false,
        }));
        let unicorn = wire(&state).map_err(|error| Failure(format!("Unicorn does not start: {error:?}")))?;
        let mut machine = Self { cpu: Cpu { unicorn }, state, asleep: None, event: false, faults: Vec::new() };
        for (address, bytes) in &image.segments {
            let fits = (FLASH_START..FLASH_START + FLASH_BYTES).contains(address)
                && bytes.len() <= (FLASH_START + FLASH_BYTES - address) as usize;
            let written = fits && machine.cpu.unicorn.mem_write(u64::from(*address), bytes).is_ok();
            if !written {
                return Err(Failure(format!("a segment of {} bytes at {address:#010x} is not in flash", bytes.len())));
            }
        }
        machine.boot()?;
        Ok(machine)
    }

    /// Runs until the cycle `until`.
    ///
    /// # Errors
    /// What the image did that is not modelled, with the program counter.
    pub fn run_until(&mut self, until: u64) -> Result<(), Failure> {
        self.state.borrow_mut().until = until;
        loop {
            let (now, reset) = {
                let mut state = self.state.borrow_mut();
                if let Some(what) = state.chip.failure.take() {
                    return Err(self.failure(&what));
                }
                (state.chip.now, state.chip.reset.take())
            };
            if let Some(causes) = reset {
                self.reset(causes)?;
            } else if now >= until {
                return Ok(());
            } else if let Some(sleep) = self.asleep {
                self.doze(sleep, until);
            } else {
                let masks = masks(&self.cpu.unicorn);
                let next = self.state.borrow().chip.nvic.next(masks);
                match next {
                    Some(exception) => self.enter(exception)?,
                    None => self.resume()?,
                }
            }
        }
    }

    /// Core cycles since power-up.
    pub fn now(&self) -> u64 {
        self.state.borrow().chip.now
    }

    /// Frequency of the core, Hz.
    pub fn core_hz(&self) -> u64 {
        self.state.borrow().chip.core_hz()
    }

    /// What the CPU has done.
    pub fn load(&self) -> Load {
        let state = self.state.borrow();
        Load { cycles: state.chip.now, busy: state.busy, instructions: state.instructions }
    }

    /// Tells the inertial unit how the body moves: forward, right, down; m/s² and rad/s.
    pub fn move_body(&mut self, force_m_s2: [f32; 3], rate_rad_s: [f32; 3]) {
        self.state.borrow_mut().chip.board.move_body(force_m_s2, rate_rad_s);
    }

    /// Sets the battery's voltage, V.
    pub fn set_battery(&mut self, volts: f32) {
        self.state.borrow_mut().chip.board.battery_v = volts;
    }

    /// Lets the radio receiver send a frame with these channels, 172 to 1811.
    pub fn send_channels(&mut self, channels: [u16; 16]) {
        self.state.borrow_mut().chip.hear_radio(&crsf::frame(channels));
    }

    /// When the inertial unit has its next sample, core cycles, if it is on.
    pub fn next_sample(&self) -> Option<u64> {
        self.state.borrow().chip.board.imu.next_sample()
    }

    /// Core cycles between samples of the inertial unit.
    pub fn sample_period(&self) -> u64 {
        self.state.borrow().chip.board.imu.period()
    }

    /// What the speed controllers have heard.
    pub fn motors(&self) -> Motors {
        let board = &self.state.borrow().chip.board;
        Motors {
            told: board.told(),
            good: board.escs.map(|esc| esc.good),
            bad: board.escs.map(|esc| esc.bad),
            latency_max: board.latency_max,
        }
    }

    /// Faults that the image has handled.
    pub fn faults(&self) -> &[String] {
        &self.faults
    }

    /// Reads memory.
    ///
    /// # Errors
    /// If there is none.
    pub fn memory(&self, address: u32, bytes: usize) -> Result<Vec<u8>, Failure> {
        let read = self.cpu.unicorn.mem_read_as_vec(u64::from(address), bytes);
        read.map_err(|_| Failure(format!("there is no memory at {address:#010x}")))
    }

    /// Reads a word of memory.
    ///
    /// # Errors
    /// If there is none.
    pub fn word(&self, address: u32) -> Result<u32, Failure> {
        Ok(self.cpu.load(address, 1)?[0])
    }

    /// Writes a word of memory.
    ///
    /// # Errors
    /// If there is none.
    pub fn set_word(&mut self, address: u32, word: u32) -> Result<(), Failure> {
        self.cpu.store(address, &[word])
    }

    fn boot(&mut self) -> Result<(), Failure> {
        let vtor = self.state.borrow().chip.scb.vtor;
        let vectors = self.cpu.load(vtor, 2)?;
        for register in [R::PRIMASK, R::BASEPRI, R::FAULTMASK, R::CONTROL, R::IPSR] {
            self.cpu.set(register, 0);
        }
        self.cpu.set(R::SP, vectors[0]);
        self.cpu.set(R::LR, u32::MAX);
        self.cpu.set(R::PC, vectors[1]);
        Ok(())
    }

    /// Starts the chip anew; RAM keeps what it holds.
    fn reset(&mut self, causes: u32) -> Result<(), Failure> {
        {
            let mut state = self.state.borrow_mut();
            state.chip.restart(causes);
            state.open = None;
        }
        self.asleep = None;
        self.boot()
    }

    /// Lets the CPU run until it stops.
    fn resume(&mut self) -> Result<(), Failure> {
        self.state.borrow_mut().stopped = false;
        let pc = self.cpu.register(R::PC);
        let result = self.cpu.unicorn.emu_start(u64::from(pc | 1), 0, 0, 0);
        if self.state.borrow().stopped {
            return Ok(());
        }
        let pc = self.cpu.register(R::PC);
        if pc >= 0xffff_ff00 {
            self.close(pc);
            return self.leave(pc | 1);
        }
        // The instruction that stopped is before the program counter, but for faults.
        let before = self.opcode(pc - 2);
        match (result, before) {
            (_, 0xbf30) => self.fall_asleep(pc, Sleep::Interrupt),
            (_, 0xbf20) => self.fall_asleep(pc, Sleep::Event),
            (_, op) if op & 0xff00 == 0xdf00 => {
                self.close(pc);
                self.state.borrow_mut().chip.nvic.set_pending(SV_CALL);
            }
            (Err(error), _) => return self.fault(error, pc),
            (Ok(()), _) => return Err(self.failure("the CPU has stopped for no reason that is modelled")),
        }
        Ok(())
    }

    fn fall_asleep(&mut self, pc: u32, sleep: Sleep) {
        self.close(pc);
        self.event |= std::mem::take(&mut self.state.borrow_mut().event);
        if sleep == Sleep::Event && std::mem::take(&mut self.event) {
            return;
        }
        self.asleep = Some(sleep);
    }

    /// Lets time pass until something wakes the CPU.
    fn doze(&mut self, sleep: Sleep, until: u64) {
        let state = &mut *self.state.borrow_mut();
        if state.chip.nvic.is_waiting() || sleep == Sleep::Event && std::mem::take(&mut self.event) {
            self.asleep = None;
            return;
        }
        let next = state.chip.deadline.min(until);
        state.chip.advance(next, &mut Ram(&mut self.cpu.unicorn));
    }

    fn enter(&mut self, exception: u32) -> Result<(), Failure> {
        let (within, vtor) = {
            let chip = &self.state.borrow().chip;
            (chip.nvic.running(), chip.scb.vtor)
        };
        let vector = self.word(vtor + 4 * exception)?;
        exception::enter(&mut self.cpu, exception, within, vector)?;
        self.event = true;
        self.state.borrow_mut().chip.nvic.enter(exception);
        self.charge(ENTRY_CYCLES);
        Ok(())
    }

    fn leave(&mut self, exc_return: u32) -> Result<(), Failure> {
        let into = self.state.borrow_mut().chip.nvic.leave();
        exception::leave(&mut self.cpu, exc_return, into)?;
        self.event = true;
        self.charge(ENTRY_CYCLES);
        Ok(())
    }

    /// The instruction at `pc` cannot be run: HardFault.
    fn fault(&mut self, error: uc_error, pc: u32) -> Result<(), Failure> {
        let lr = self.cpu.register(R::LR);
        let what = format!("{error:?} at {pc:#010x}, called from {lr:#010x}");
        self.close(pc);
        {
            let chip = &mut self.state.borrow_mut().chip;
            if chip.nvic.active_priority() <= -1 {
                return Err(Failure(format!("the core locks up: a fault within HardFault, {what}")));
            }
            // UNDEFINSTR, or a precise data access violation.
            chip.scb.fault(if error == uc_error::INSN_INVALID { 1 << 16 } else { 1 << 9 });
        }
        self.faults.push(what);
        self.enter(HARD_FAULT)
    }

    /// Charges the block that has ended with the CPU about to run `next`.
    fn close(&mut self, next: u32) {
        self.state.borrow_mut().close(next, &mut Ram(&mut self.cpu.unicorn));
    }

    fn charge(&mut self, cycles: u64) {
        self.state.borrow_mut().charge(cycles, &mut Ram(&mut self.cpu.unicorn));
    }

    fn opcode(&self, address: u32) -> u32 {
        let mut bytes = [0; 2];
        // Where there is no code there is no opcode, and a fault follows.
        let _ = self.cpu.unicorn.mem_read(u64::from(address), &mut bytes);
        u16::from_le_bytes(bytes).into()
    }

    fn failure(&self, what: &str) -> Failure {
        let (pc, lr) = (self.cpu.register(R::PC), self.cpu.register(R::LR));
        Failure(format!("{what}; before pc {pc:#010x}, called from {lr:#010x}"))
    }
}

impl State {
    /// The CPU is about to run a block; whether it must stop instead.
    fn on_block(&mut self, address: u32, size: u32, unicorn: &mut Unicorn<'_, ()>) -> bool {
        let in_it = self.open.is_some_and(|open| open.in_it);
        self.close(address, &mut Ram(unicorn));
        let chip = &self.chip;
        self.stopped = chip.failure.is_some()
            || chip.reset.is_some()
            || chip.now >= self.until
            || !in_it && chip.nvic.is_waiting() && chip.nvic.next(masks(unicorn)).is_some();
        if !self.stopped {
            self.open(address, size, unicorn);
        }
        self.stopped
    }

    fn open(&mut self, address: u32, size: u32, unicorn: &Unicorn<'_, ()>) {
        let place = address.wrapping_sub(FLASH_START) as usize / 2;
        let Some(known) = self.blocks.get_mut(place) else {
            return self.chip.fail(format!("code at {address:#010x}, which is not flash"));
        };
        let block = match known {
            Some(block) if block.end == address + size => block,
            _ => {
                let code = unicorn.mem_read_as_vec(u64::from(address), size as usize).unwrap_or_default();
                known.insert(Box::new(Block::decode(address, &code)))
            }
        };
        let cost = u64::from(block.cycles) + self.cache.fetch(address, block.end) + self.cache.load(&block.literals);
        self.event |= block.sends_event;
        self.open = Some(Open { end: block.end, cost, instructions: block.instructions, in_it: block.in_it });
    }

    fn close(&mut self, next: u32, memory: &mut dyn Memory) {
        let Some(open) = self.open.take() else { return };
        self.instructions += u64::from(open.instructions);
        let refill = if next == open.end { 0 } else { REFILL };
        let waited = std::mem::take(&mut self.chip.bus_wait);
        self.charge(open.cost + refill + waited, memory);
    }

    fn charge(&mut self, cycles: u64, memory: &mut dyn Memory) {
        self.busy += cycles;
        let to = self.chip.now + cycles;
        if self.chip.deadline <= to {
            self.chip.advance(to, memory);
        } else {
            self.chip.now = to;
        }
    }
}

/// Sets up Unicorn: memory, and its calls into `state`.
fn wire(state: &Rc<RefCell<State>>) -> Result<Unicorn<'static, ()>, uc_error> {
    let mut unicorn = Unicorn::new(Arch::ARM, Mode::MCLASS)?;
    unicorn.ctl_set_cpu_model(ArmCpuModel::CORTEX_M4 as i32)?;
    // No address ends the run.
    unicorn.ctl_exits_enable()?;
    unicorn.mem_map(FLASH_START.into(), FLASH_BYTES.into(), Prot::READ | Prot::EXEC)?;
    unicorn.mem_map(RAM_START.into(), RAM_BYTES.into(), Prot::ALL)?;
    for (base, bytes) in PERIPHERALS {
        debug_assert!(bytes % PAGE == 0);
        let (reader, writer) = (Rc::clone(state), Rc::clone(state));
        let read = move |unicorn: &mut Unicorn<'_, ()>, offset: u64, bytes: usize| {
            let chip = &mut reader.borrow_mut().chip;
            u64::from(chip.read((base + offset) as u32, bytes, &mut Ram(unicorn)))
        };
        let write = move |unicorn: &mut Unicorn<'_, ()>, offset: u64, bytes: usize, value: u64| {
            let state = &mut *writer.borrow_mut();
            state.chip.write((base + offset) as u32, bytes, value as u32, &mut Ram(unicorn));
            let (latency, instructions, data) = state.chip.flash.wait_states();
            state.cache.configure(latency, instructions, data);
        };
        unicorn.mmio_map(base, bytes, Some(read), Some(write))?;
    }
    let blocks = Rc::clone(state);
    // From 1 to 0: everywhere.
    unicorn.add_block_hook(1, 0, move |unicorn, address, size| {
        let stop = blocks.borrow_mut().on_block(address as u32, size, unicorn);
        if stop {
            // Cannot fail: the CPU runs.
            let _ = unicorn.emu_stop();
        }
    })?;
    Ok(unicorn)
}

/// RAM and flash, as DMA sees them.
struct Ram<'a, 'b>(&'a mut Unicorn<'b, ()>);

impl Ram<'_, '_> {
    fn has(address: u32, length: usize) -> bool {
        (RAM_START..RAM_START + RAM_BYTES).contains(&address) && length <= (RAM_START + RAM_BYTES - address) as usize
    }
}

impl Memory for Ram<'_, '_> {
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> bool {
        let in_flash = (FLASH_START..FLASH_START + FLASH_BYTES).contains(&address);
        (in_flash || Self::has(address, bytes.len())) && self.0.mem_read(address.into(), bytes).is_ok()
    }

    fn write(&mut self, address: u32, bytes: &[u8]) -> bool {
        Self::has(address, bytes.len()) && self.0.mem_write(address.into(), bytes).is_ok()
    }
}

fn masks(unicorn: &Unicorn<'_, ()>) -> Masks {
    // A register of the CPU can always be read.
    let read = |register: R| unicorn.reg_read(register).unwrap_or(0);
    Masks { primask: read(R::PRIMASK) != 0, faultmask: read(R::FAULTMASK) != 0, basepri: read(R::BASEPRI) as u8 }
}

impl Cpu {
    pub(crate) fn register(&self, register: R) -> u32 {
        self.wide(register) as u32
    }

    pub(crate) fn wide(&self, register: R) -> u64 {
        // A register of the CPU can always be read.
        self.unicorn.reg_read(register).unwrap_or(0)
    }

    pub(crate) fn set(&mut self, register: R, value: u32) {
        self.set_wide(register, value.into());
    }

    pub(crate) fn set_wide(&mut self, register: R, value: u64) {
        // And written.
        let _ = self.unicorn.reg_write(register, value);
    }

    pub(crate) fn load(&self, address: u32, words: usize) -> Result<Vec<u32>, Failure> {
        let bytes = self.unicorn.mem_read_as_vec(u64::from(address), 4 * words);
        let bytes = bytes.map_err(|_| Failure(format!("there is no memory at {address:#010x}")))?;
        Ok(bytes.chunks_exact(4).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]])).collect())
    }

    pub(crate) fn store(&mut self, address: u32, words: &[u32]) -> Result<(), Failure> {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let written = self.unicorn.mem_write(u64::from(address), &bytes);
        written.map_err(|_| Failure(format!("there is no memory at {address:#010x}")))
    }
}
