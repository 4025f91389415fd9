//! The machine: a CPU that runs the image, the chip around it, and virtual time between them.
//!
//! Unicorn translates code block by block and asks before each one. There, and only there, time passes: the block before
//! is charged (`block`, `flash_cache`), what is due in the chip happens, and if an exception is to be taken the CPU stops
//! and takes it. So an exception comes up to one block late, some ten cycles, and an access to a peripheral happens at the
//! time its block began.
//!
//! Asleep in WFI or WFE, time jumps to whatever happens next. Code in RAM is not modelled.
use crate::board;
use crate::chip::PORRSTF;
use crate::device::esc::Protocol;
use crate::exception::{self, ENTRY_CYCLES, FPCA};
use crate::nvic::{HARD_FAULT, SV_CALL};
use crate::peripheral::flash::FLASH_START;
use crate::{Failure, Image, Task};
use std::cell::RefCell;
use std::rc::Rc;
use unicorn_engine::{RegisterARM as R, uc_error};
use wiring::{FLASH_BYTES, RAM_BYTES, RAM_START, Ram, State, masks, wire};

mod cpu;
mod mishaps;
mod uptime;
mod wiring;
mod world;

pub(crate) use cpu::Cpu;
pub use world::{Line, Part};

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
    /// By what protocol.
    pub protocol: [Option<Protocol>; 4],
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
    power_cuts: u32,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Sleep {
    Interrupt,
    Event,
}

impl Machine {
    /// A board with `image` in its flash, just switched on.
    ///
    /// # Errors
    /// If the image does not fit, or Unicorn refuses.
    pub fn new(image: &Image) -> Result<Self, Failure> {
        let state = Rc::new(RefCell::new(State::new()));
        let unicorn = wire(&state).map_err(|error| Failure(format!("Unicorn does not start: {error:?}")))?;
        let mut machine =
            Self { cpu: Cpu { unicorn }, state, asleep: None, event: false, faults: Vec::new(), power_cuts: 0 };
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

    /// When the inertial unit is to be read next, core cycles, if it is on.
    pub fn next_sample(&self) -> Option<u64> {
        self.state.borrow().chip.board.imu.next_ready()
    }

    /// Core cycles from one time that the inertial unit is to be read to the next.
    pub fn sample_period(&self) -> u64 {
        self.state.borrow().chip.board.imu.period()
    }

    /// The same, which times these tasks from now on.
    #[must_use]
    pub fn watching(self, tasks: &[Task]) -> Self {
        self.state.borrow_mut().tasks.watch(tasks.to_vec());
        self
    }

    /// The tasks that are timed.
    pub fn tasks(&self) -> Vec<Task> {
        self.state.borrow().tasks.all().to_vec()
    }

    /// What the speed controllers have heard.
    pub fn motors(&self) -> Motors {
        let board = &self.state.borrow().chip.board;
        Motors {
            told: board.told(),
            protocol: board.escs.map(|esc| esc.protocol),
            good: board.escs.map(|esc| esc.good),
            bad: board.escs.map(|esc| esc.bad),
            latency_max: board.latency_max,
        }
    }

    /// Whether the buzzer sounds.
    pub fn sounds(&self) -> bool {
        let (port, pin) = board::BUZZER;
        self.state.borrow().chip.gpio[port].level(pin)
    }

    /// Bytes of the lowest RAM, where the image has its stack, and how many of them were ever written.
    ///
    /// # Errors
    /// If there is no image.
    pub fn stack(&self) -> Result<(u32, u32), Failure> {
        let bytes = self.word(FLASH_START)? - RAM_START;
        let memory = self.memory(RAM_START, bytes as usize)?;
        // RAM begins as zeros here.
        let untouched = memory.iter().position(|&byte| byte != 0).unwrap_or(memory.len());
        Ok((bytes, bytes - untouched as u32))
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
        for register in [R::PRIMASK, R::BASEPRI, R::FAULTMASK, R::FPSCR, R::IPSR] {
            self.cpu.set(register, 0);
        }
        self.cpu.set(R::CONTROL, FPCA);
        self.cpu.set(R::SP, vectors[0]);
        self.cpu.set(R::LR, u32::MAX);
        self.cpu.set(R::PC, vectors[1]);
        Ok(())
    }

    /// Starts the chip anew; RAM keeps what it holds unless power was lost.
    fn reset(&mut self, causes: u32) -> Result<(), Failure> {
        {
            let mut state = self.state.borrow_mut();
            state.chip.restart(causes);
            state.open = None;
            state.tasks.reset();
        }
        if causes & PORRSTF != 0 {
            self.power_cuts += 1;
            // What it comes up with is anything.
            let junk: Vec<u32> = (1..=RAM_BYTES / 4).map(|n| n.wrapping_mul(0x9e37_79b9)).collect();
            self.cpu.store(RAM_START, &junk)?;
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
        if !exception::enter(&mut self.cpu, exception, within, vector)? {
            // STKERR; the exception stays pending.
            return self.escalate(1 << 12, &format!("no stack for exception {exception}"));
        }
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
        if (RAM_START..RAM_START + RAM_BYTES).contains(&pc) {
            return Err(self.failure("code in RAM, which is not modelled"));
        }
        let lr = self.cpu.register(R::LR);
        self.close(pc);
        // UNDEFINSTR, or a precise data access violation.
        let cause = if error == uc_error::INSN_INVALID { 1 << 16 } else { 1 << 9 };
        self.escalate(cause, &format!("{error:?} at {pc:#010x}, called from {lr:#010x}"))
    }

    /// HardFault, with its cause in CFSR.
    fn escalate(&mut self, cause: u32, what: &str) -> Result<(), Failure> {
        {
            let chip = &mut self.state.borrow_mut().chip;
            if chip.nvic.active_priority() <= -1 {
                return Err(Failure(format!("the core locks up: a fault within HardFault, {what}")));
            }
            chip.scb.fault(cause);
        }
        self.faults.push(what.to_owned());
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

#[cfg(test)]
mod tests {
    use super::*;

    /// An image of hand-assembled code after a vector table whose handlers are given by number, as indices into the code.
    fn image(handlers: &[(usize, u32)], code: &[u16]) -> Image {
        const CODE: u32 = FLASH_START + 0x200;
        let mut words = vec![0_u32; 0x80];
        words[0] = RAM_START + 0x1000;
        words[1] = CODE | 1;
        for &(exception, index) in handlers {
            words[exception] = (CODE + 2 * index) | 1;
        }
        let mut bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        bytes.extend(code.iter().flat_map(|half| half.to_le_bytes()));
        Image { elf: Vec::new(), segments: vec![(FLASH_START, bytes)] }
    }

    fn run(handlers: &[(usize, u32)], code: &[u16]) -> Machine {
        let mut machine = Machine::new(&image(handlers, code)).unwrap();
        machine.run_until(10_000).unwrap();
        machine
    }

    #[test]
    fn a_supervisor_call_runs_its_handler_and_comes_back() {
        let machine = run(
            &[(11, 6)],
            &[
                0x2005, // movs r0, #5
                0xdf00, // svc 0
                0x3001, // adds r0, #1
                0xbf30, // wfi
                0xe7fd, // b back to it
                0xbf00, // nop
                // The handler: r0 on the stack is what it returns.
                0x9900, // ldr r1, [sp]
                0x310a, // adds r1, #10
                0x9100, // str r1, [sp]
                0x4770, // bx lr
            ],
        );
        assert_eq!(machine.cpu.register(R::R0), 16);
        assert_eq!(machine.cpu.register(R::SP), RAM_START + 0x1000);
        assert!(machine.load().busy < 200, "it sleeps: {:?}", machine.load());
    }

    #[test]
    fn a_handler_that_uses_the_fpu_does_not_spoil_the_programs_numbers() {
        let machine = run(
            &[(11, 12)],
            &[
                0x2007, 0xee00, 0x0a10, // movs r0, #7; vmov s0, r0
                0xdf00, // svc 0
                0xee10, 0x1a10, // vmov r1, s0
                0xbf30, // wfi
                0xe7fd, // b back to it
                0xbf00, 0xbf00, 0xbf00, 0xbf00, // nops
                // The handler.
                0x2009, 0xee00, 0x0a10, // movs r0, #9; vmov s0, r0
                0x4770, // bx lr
            ],
        );
        assert_eq!(machine.cpu.register(R::R1), 7);
        assert_eq!(machine.cpu.register(R::SP), RAM_START + 0x1000);
    }

    #[test]
    fn nor_where_the_programs_first_fpu_instruction_was_skipped() {
        let machine = run(
            &[(11, 14)],
            &[
                0x2000, 0x2801, // movs r0, #0; cmp r0, #1
                0xbf08, 0xee00, 0x0a10, // it eq; vmoveq s0, r0
                0x2007, 0xee00, 0x0a10, // movs r0, #7; vmov s0, r0
                0xdf00, // svc 0
                0xee10, 0x1a10, // vmov r1, s0
                0xbf30, // wfi
                0xe7fd, // b back to it
                0xbf00, // nop
                // The handler.
                0x2009, 0xee00, 0x0a10, // movs r0, #9; vmov s0, r0
                0x4770, // bx lr
            ],
        );
        assert_eq!(machine.cpu.register(R::R1), 7);
    }

    #[test]
    fn an_undefined_instruction_is_a_hard_fault_that_is_noted() {
        let machine = run(&[(3, 4)], &[0xde00, 0xbf00, 0xbf00, 0xbf00, 0x2203, 0xbf30, 0xe7fd]);
        assert_eq!(machine.cpu.register(R::R2), 3);
        assert_eq!(machine.faults().len(), 1, "{:?}", machine.faults());
        assert!(machine.faults()[0].contains("0x08000200"), "{:?}", machine.faults());
    }

    #[test]
    fn a_fault_within_the_fault_handler_locks_up() {
        let mut machine = Machine::new(&image(&[(3, 0)], &[0xde00])).unwrap();
        let failure = machine.run_until(10_000).unwrap_err();
        assert!(failure.0.contains("locks up"), "{failure}");
    }

    #[test]
    fn a_register_that_is_not_modelled_ends_the_run_and_is_named() {
        // ldr r0, =0x40006400 (CAN1); ldr r0, [r0]
        let mut machine = Machine::new(&image(&[], &[0x4801, 0x6800, 0xbf30, 0xe7fd, 0x6400, 0x4000])).unwrap();
        let failure = machine.run_until(10_000).unwrap_err();
        assert!(failure.0.contains("0x40006400"), "{failure}");
    }

    #[test]
    fn code_in_ram_ends_the_run_and_is_named() {
        // ldr r0, =0x20000001; bx r0
        let mut machine = Machine::new(&image(&[], &[0x4800, 0x4700, 0x0001, 0x2000])).unwrap();
        let failure = machine.run_until(10_000).unwrap_err();
        assert!(failure.0.contains("code in RAM") && failure.0.contains("0x20000000"), "{failure}");
    }

    #[test]
    fn programming_only_clears_bits_and_only_when_unlocked() {
        let store = |unlock: bool| {
            let mut machine = Machine::new(&image(
                &[],
                &[
                    // ldr r0, =address; ldr r1, =value; str r1, [r0]; wfi
                    0x4802, 0x4903, 0x6001, 0xbf30, 0xe7fd, 0xbf00, 0x0000, 0x080c, 0x00ff, 0xff0f,
                ],
            ))
            .unwrap();
            machine.cpu.unicorn.mem_write(0x080c_0000, &0x1234_5678_u32.to_le_bytes()).unwrap();
            if unlock {
                let flash = &mut machine.state.borrow_mut().chip.flash;
                for (offset, value) in [(0x04, 0x4567_0123), (0x04, 0xcdef_89ab), (0x10, 0x201)] {
                    flash.write(offset, value, 0, HSI_HZ).unwrap();
                }
            }
            machine.run_until(10_000).map(|()| machine.word(0x080c_0000).unwrap())
        };
        assert_eq!(store(true).unwrap(), 0x1234_5678 & 0xff0f_00ff);
        assert!(store(false).unwrap_err().0.contains("0x080c0000"));
    }

    const HSI_HZ: u64 = 16_000_000;
}
