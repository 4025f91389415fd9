//! The flight image of each board: its size against its budgets, and what in its control task panics.
use crate::panics;
use crate::workspace::Workspace;
use anyhow::{Context, Result, bail, ensure};
use object::elf::{SHF_ALLOC, SHF_WRITE, SHT_NOBITS};
use object::{Object, ObjectSection, ObjectSymbol, SectionFlags};

const KIB: u64 = 1024;

/// A memory, and how much of it the image may take.
struct Budget {
    name: &'static str,
    /// What it may ever take.
    bytes_max: u64,
    /// Little above what it takes now: growth is a decision, made here.
    ratchet: u64,
}

/// A board, with what its image may take. RAM is the stack's too, all that is kept for it.
pub(crate) struct Board {
    /// Its feature of the package `firmware`.
    pub(crate) feature: &'static str,
    flash: Budget,
    ram: Budget,
}

/// Every board, the default one last, for all leave their image in the same place.
pub(crate) const BOARDS: [Board; 3] = [
    // Half of the STM32F722's flash: the other half keeps the parameters.
    Board {
        feature: "foxeer-f722-v4",
        flash: Budget { name: "flash", bytes_max: 256 * KIB, ratchet: 254 * KIB },
        ram: Budget { name: "RAM", bytes_max: 128 * KIB, ratchet: 94 * KIB },
    },
    Board {
        feature: "orbit-h743",
        flash: Budget { name: "flash", bytes_max: 512 * KIB, ratchet: 250 * KIB },
        ram: Budget { name: "RAM", bytes_max: 128 * KIB, ratchet: 92 * KIB },
    },
    // A quarter of the STM32F405's flash, half of its RAM.
    Board {
        feature: "speedybee-f405-v4",
        flash: Budget { name: "flash", bytes_max: 256 * KIB, ratchet: 250 * KIB },
        ram: Budget { name: "RAM", bytes_max: 64 * KIB, ratchet: 64 * KIB },
    },
];

/// Without these there is no image: a linker script that was not found leaves an ELF all the same.
const REQUIRED: [&str; 2] = [".vector_table", ".text"];

/// The flight log's queue, in RAM of its own; it counts against no budget.
const LOG_QUEUE: &str = ".log";

/// Bytes of a section in each memory.
struct Footprint {
    name: String,
    flash: u64,
    ram: u64,
}

pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    BOARDS.iter().try_for_each(|board| weigh(workspace, board).with_context(|| board.feature))
}

fn weigh(workspace: &Workspace, board: &Board) -> Result<()> {
    let elf = workspace.build_image_with("firmware", &["--no-default-features", "--features", board.feature])?;
    let bytes = workspace.shell.read_binary_file(&elf)?;
    let mut footprints = footprints(&bytes).with_context(|| format!("{} cannot be read", elf.display()))?;
    for required in REQUIRED {
        let found = footprints.iter().any(|section| section.name == required);
        ensure!(found, "{} has no {required}: it would not boot", elf.display());
    }
    footprints.push(Footprint { name: "stack".to_owned(), flash: 0, ram: stack_below(&bytes)? });
    println!("{:<20} {:>8} {:>8}", board.feature, board.flash.name, board.ram.name);
    for Footprint { name, flash, ram } in &footprints {
        println!("{name:<20} {flash:>8} {ram:>8}");
    }
    board.flash.check(footprints.iter().map(|section| section.flash).sum())?;
    board.ram.check(footprints.iter().map(|section| section.ram).sum())?;
    panics::check(workspace, &elf)
}

/// Bytes of the stack, which must lie below all that is in RAM: there an overflow is a fault.
fn stack_below(elf: &[u8]) -> Result<u64> {
    let file = object::File::parse(elf)?;
    let symbol =
        |name: &str| file.symbol_by_name(name).map(|symbol| symbol.address()).with_context(|| format!("no {name}"));
    let (bottom, top) = (symbol("_stack_end")?, symbol("_stack_start")?);
    for section in file.sections() {
        let within = bottom..top;
        ensure!(!within.contains(&section.address()) || section.size() == 0, "{} lies in the stack", section.name()?);
    }
    ensure!(symbol("__sdata")? >= top, "the stack lies above what it can overflow into");
    Ok(top - bottom)
}

/// The sections that take memory on the board.
fn footprints(elf: &[u8]) -> Result<Vec<Footprint>> {
    let file = object::File::parse(elf)?;
    file.sections().filter_map(|section| footprint(&section).transpose()).collect()
}

/// Flash holds what is loaded, initial values of variables included; RAM what can be written.
fn footprint<'a>(section: &impl ObjectSection<'a>) -> Result<Option<Footprint>> {
    let SectionFlags::Elf { sh_type, sh_flags } = section.flags() else {
        bail!("not an ELF file");
    };
    let size = section.size();
    let takes = |holds: bool| if holds { size } else { 0 };
    let allocated = sh_flags.contains(SHF_ALLOC) && size > 0;
    let name = section.name()?.to_owned();
    Ok(allocated.then_some(Footprint {
        flash: takes(sh_type != SHT_NOBITS),
        ram: takes(sh_flags.contains(SHF_WRITE) && name != LOG_QUEUE),
        name,
    }))
}

impl Budget {
    fn check(&self, bytes: u64) -> Result<()> {
        let Self { name, bytes_max, ratchet } = self;
        println!("{name}: {bytes} bytes of {ratchet}, which may be raised to {bytes_max}");
        ensure!(bytes <= *ratchet, "{name}: {bytes} bytes, budget {ratchet} (xtask/src/fw.rs)");
        Ok(())
    }
}
