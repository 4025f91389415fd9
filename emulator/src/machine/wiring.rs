//! Between Unicorn and the chip: what is called before each block of code, at each access to a peripheral, and at each
//! store to flash; and what a block costs.
use crate::block::{Block, REFILL};
use crate::chip::{Chip, Memory};
use crate::flash_cache::FlashCache;
use crate::nvic::Masks;
use crate::peripheral::flash::{Extent, FLASH_START};
use crate::tasks::Tasks;
use std::cell::RefCell;
use std::ops::Range;
use std::rc::Rc;
use unicorn_engine::{
    Arch, ArmCpuModel, HookType, MemType, Mode, Prot, RegisterARM as R, TlbEntry, TlbType, Unicorn, uc_error,
};

pub(super) const FLASH_BYTES: u32 = 1024 * 1024;
const FLASH: Range<u64> = FLASH_START as u64..(FLASH_START + FLASH_BYTES) as u64;
/// Above the image and below what it stores: a branch to itself, for [`super::Machine::hang`].
pub(super) const LOOP: (u32, [u8; 2]) = (FLASH_START + 768 * 1024 - 2, [0xfe, 0xe7]);
pub(super) const RAM_START: u32 = 0x2000_0000;
pub(super) const RAM_BYTES: u32 = 128 * 1024;
/// RAM of the core alone: no DMA reaches it.
const CORE_RAM: (u64, u64) = (0x1000_0000, 64 * 1024);
/// Unicorn maps whole pages.
const PAGE: u64 = 4096;
/// Peripherals: APB and AHB1, AHB2, the core's own.
const PERIPHERALS: [(u64, u64); 3] = [(0x4000_0000, 0x8_0000), (0x5000_0000, 0x4_0000), (0xe000_0000, 0x10_0000)];

/// All that callbacks from the CPU reach.
pub(super) struct State {
    pub(super) chip: Chip,
    cache: FlashCache,
    /// By halfword of flash; decoded when first run.
    blocks: Vec<Option<Box<Block>>>,
    /// The block that runs, with what it has cost so far.
    pub(super) open: Option<Open>,
    pub(super) instructions: u64,
    pub(super) busy: u64,
    /// How many times the cycles that it should take the core takes for everything, in percent.
    pub(super) slowness_percent: u64,
    /// When to stop.
    pub(super) until: u64,
    /// Whether the CPU was stopped between two blocks, by this model.
    pub(super) stopped: bool,
    /// A SEV was run.
    pub(super) event: bool,
    pub(super) tasks: Tasks,
}

/// A block that has begun.
#[derive(Clone, Copy)]
pub(super) struct Open {
    end: u32,
    cost: u64,
    instructions: u32,
}

impl State {
    /// Before the first instruction.
    pub(super) fn new() -> Self {
        Self {
            chip: Chip::new(),
            cache: FlashCache::new(),
            blocks: vec![None; FLASH_BYTES as usize / 2],
            open: None,
            instructions: 0,
            busy: 0,
            slowness_percent: 100,
            until: 0,
            stopped: false,
            event: false,
            tasks: Tasks::default(),
        }
    }

    /// The CPU is about to run a block; whether it must stop instead.
    fn on_block(&mut self, address: u32, size: u32, unicorn: &mut Unicorn<'_, ()>) -> bool {
        self.close(address, &mut Ram(unicorn));
        let chip = &self.chip;
        let wanted = chip.failure.is_some()
            || chip.reset.is_some()
            || chip.now >= self.until
            || chip.nvic.is_waiting() && chip.nvic.next(masks(unicorn)).is_some();
        // Unicorn cannot be told the state of an IT block, so nothing may come between its instructions.
        self.stopped = wanted && !is_in_it(unicorn);
        if !self.stopped {
            self.tasks.block(address, self.chip.now, || registers(unicorn));
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
        self.open = Some(Open { end: block.end, cost, instructions: block.instructions });
    }

    /// Charges the block that has ended with the CPU about to run `next`.
    pub(super) fn close(&mut self, next: u32, memory: &mut dyn Memory) {
        let Some(open) = self.open.take() else { return };
        self.instructions += u64::from(open.instructions);
        let refill = if next == open.end { 0 } else { REFILL };
        let waited = std::mem::take(&mut self.chip.bus_wait);
        self.charge(open.cost + refill + waited, memory);
    }

    /// Lets the core be busy for some cycles.
    pub(super) fn charge(&mut self, cycles: u64, memory: &mut dyn Memory) {
        let cycles = if self.slowness_percent == 100 { cycles } else { cycles * self.slowness_percent / 100 };
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
pub(super) fn wire(state: &Rc<RefCell<State>>) -> Result<Unicorn<'static, ()>, uc_error> {
    let mut unicorn = Unicorn::new(Arch::ARM, Mode::MCLASS)?;
    unicorn.ctl_set_cpu_model(ArmCpuModel::CORTEX_M4 as i32)?;
    // Pages that code may be in are searched for it at each store; here only flash is, and what a fetch goes to.
    unicorn.ctl_set_tlb_type(TlbType::VIRTUAL)?;
    unicorn.add_tlb_hook(1, 0, |_, address, access| {
        let code = FLASH.contains(&address) || access == MemType::FETCH;
        Some(TlbEntry { paddr: address, perms: if code { Prot::ALL } else { Prot::READ | Prot::WRITE } })
    })?;
    // No address ends the run.
    unicorn.ctl_exits_enable()?;
    unicorn.mem_map(FLASH_START.into(), FLASH_BYTES.into(), Prot::READ | Prot::EXEC)?;
    // As it leaves the factory.
    unicorn.mem_write(FLASH_START.into(), &vec![0xff; FLASH_BYTES as usize])?;
    unicorn.mem_write(LOOP.0.into(), &LOOP.1)?;
    unicorn.mem_map(RAM_START.into(), RAM_BYTES.into(), Prot::READ | Prot::WRITE)?;
    unicorn.mem_map(CORE_RAM.0, CORE_RAM.1, Prot::READ | Prot::WRITE)?;
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
    let programmer = Rc::clone(state);
    unicorn.add_mem_hook(
        HookType::MEM_WRITE_PROT,
        FLASH.start,
        FLASH.end - 1,
        move |unicorn, _, address, bytes, value| {
            let chip = &mut programmer.borrow_mut().chip;
            let (now, core_hz) = (chip.now, chip.core_hz());
            match chip.flash.program(now, core_hz) {
                Some(extent) if bytes == 4 => clear_bits(unicorn, address as u32, value as u32, extent),
                _ => chip.fail(format!("{value:#x} stored at {address:#010x}, in flash that is locked or busy")),
            }
            chip.wait_for_flash();
            // Go on: the store itself does nothing, or this run ends.
            true
        },
    )?;
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

/// Programs a word of flash: bits only ever go to zero.
fn clear_bits(unicorn: &mut Unicorn<'_, ()>, address: u32, value: u32, extent: Extent) {
    let mut bytes = [0; 4];
    // Neither can fail: it is flash that was stored to.
    let _ = unicorn.mem_read(address.into(), &mut bytes);
    let before = u32::from_le_bytes(bytes);
    let _ = unicorn.mem_write(address.into(), &extent.of(address, before, before & value).to_le_bytes());
}

/// RAM and flash, as DMA sees them.
pub(super) struct Ram<'a, 'b>(pub(super) &'a mut Unicorn<'b, ()>);

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

    fn erase(&mut self, address: u32, bytes: u32, extent: Extent) {
        // Sectors are within flash.
        let before = self.0.mem_read_as_vec(address.into(), bytes as usize).unwrap_or_default();
        let words = before.chunks_exact(4).zip((address..).step_by(4));
        let after = words.flat_map(|(word, address)| {
            let before = u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
            extent.of(address, before, u32::MAX).to_le_bytes()
        });
        let _ = self.0.mem_write(address.into(), &after.collect::<Vec<u8>>());
    }
}

/// Whether the CPU is within an IT block: ITSTATE in xPSR.
fn is_in_it(unicorn: &Unicorn<'_, ()>) -> bool {
    // A register of the CPU can always be read.
    unicorn.reg_read(R::XPSR).unwrap_or(0) & 0x0600_fc00 != 0
}

/// The link register and the stack pointer.
fn registers(unicorn: &Unicorn<'_, ()>) -> (u32, u32) {
    // A register of the CPU can always be read.
    let read = |register: R| unicorn.reg_read(register).unwrap_or(0) as u32;
    (read(R::LR), read(R::SP))
}

pub(super) fn masks(unicorn: &Unicorn<'_, ()>) -> Masks {
    // A register of the CPU can always be read.
    let read = |register: R| unicorn.reg_read(register).unwrap_or(0);
    Masks { primask: read(R::PRIMASK) != 0, faultmask: read(R::FAULTMASK) != 0, basepri: read(R::BASEPRI) as u8 }
}
