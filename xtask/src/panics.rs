//! What the control task can reach in the flight image that panics.
//!
//! ```text
//! disassembly ─► who calls whom ─► all that the control task's poll reaches ─► its calls into core's panics ─► ALLOWED, or refused
//! ```
//!
//! What panics has the place in the source at hand as a constant, a `core::panic::Location`: that is the place printed. A function of
//! `control-core` that nobody calls by name is called through a pointer, and is a root too. Other calls through pointers are listed by
//! [`INDIRECT`], with where they lead.
use crate::workspace::Workspace;
use anyhow::{Context, Result, bail, ensure};
use object::{Object, ObjectSection};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use xshell::cmd;

/// A panic that may stay: how its place and its kind begin, and why it is not taken. Where no place is at hand it is the function.
struct Allowed {
    place: &'static str,
    panic: &'static str,
    why: &'static str,
}

const ALLOWED: [Allowed; 12] = [
    Allowed {
        place: "",
        panic: "core::panicking::panic_const::panic_const_async_fn_resumed",
        why: "something that has ended is polled again: the executor polls no task that has ended, and await nothing",
    },
    Allowed {
        place: "defmt-rtt/src/lib.rs",
        panic: "core::panicking::panic_fmt",
        why: "a log line within another: lines are written with interrupts masked, and none formats what logs",
    },
    Allowed {
        place: "embassy-executor/src/raw/waker.rs",
        panic: "core::panicking::panic_fmt",
        why: "a waker that is not the executor's: all are",
    },
    Allowed {
        place: "embassy-futures/src/join.rs",
        panic: "",
        why: "the result of a future taken twice: a join ends once",
    },
    Allowed {
        place: "embassy-stm32/src/",
        panic: "",
        why: "a stream, line or channel beyond the chip's, or a bus without its streams: types and `init` fix them, and the first \
              exchange would fail, before a motor can turn",
    },
    Allowed { place: "embassy_stm32::dma::", panic: "", why: "the same" },
    Allowed {
        place: "embassy_executor::raw::TaskStorage",
        panic: "_defmt_panic",
        why: "the same, inlined: the lengths of bursts are constants; of this project's own, only what starts the board calls it",
    },
    Allowed { place: "stm32-metapac/src/", panic: "", why: "a register's field beyond its last: the same" },
    Allowed {
        place: "embassy-time/src/instant.rs",
        panic: "core::option::expect_failed",
        why: "64 bits of microseconds overflow after 584,000 years",
    },
    Allowed {
        place: "embassy_stm32::spi::compute_baud_rate",
        panic: "_defmt_panic",
        why: "a bus that is to be faster than its clock: no board's clock is so slow, and the first setting would fail, before a motor can \
              turn",
    },
    Allowed { place: "embassy_stm32::_generated", panic: "_defmt_panic", why: "a bus without a clock: the same" },
    Allowed {
        place: "heapless/src/spsc.rs",
        panic: "core::panicking::panic_const::panic_const_rem_by_zero",
        why: "a queue without a place: it has five",
    },
];

/// Functions that call through pointers, and where these lead.
const INDIRECT: [(&str, &str); 7] = [
    ("control_core::arming::Facts::failing", "the conditions of the table of checks: roots of their own"),
    ("control_core::autopilot::Autopilot::watch", "the conditions of the failsafe table: roots of their own"),
    ("_$LT$embassy_stm32..dma..dma_bdma..Transfer", "wakers: the executor's"),
    ("_embassy_time_schedule_wake", "wakers: the executor's"),
    ("embassy_executor::raw::TaskStorage", "wakers: the executor's"),
    ("embassy_time_queue_utils::Queue::next_expiration", "wakers: the executor's"),
    ("embassy_sync::waitqueue::atomic_waker::AtomicWaker", "wakers: the executor's"),
];

/// Instructions before a call in which the place of its panic is loaded.
const LOADED_WITHIN: usize = 12;

/// A call into what panics.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Site {
    place: String,
    panic: String,
}

/// Fails if the control task can reach a panic, or calls through a pointer, that is not listed.
pub(crate) fn check(workspace: &Workspace, elf: &Path) -> Result<()> {
    let sysroot = cmd!(workspace.shell, "rustc --print sysroot").quiet().read()?;
    let version = cmd!(workspace.shell, "rustc --version --verbose").quiet().read()?;
    let host = version.lines().find_map(|line| line.strip_prefix("host: ")).context("rustc names no host")?;
    let objdump = Path::new(&sysroot).join("lib/rustlib").join(host).join("bin/llvm-objdump");
    let code = cmd!(workspace.shell, "{objdump} --disassemble --demangle --no-show-raw-insn {elf}").quiet().read()?;
    let file = workspace.shell.read_binary_file(elf)?;
    let image = Image::read(&code, &Constants::new(&file)?);
    let (sites, pointers) = image.reach()?;
    let mut used = BTreeSet::new();
    let mut refused = Vec::new();
    for site in &sites {
        match ALLOWED.iter().position(|allowed| site.matches(allowed)) {
            Some(n) => drop(used.insert(n)),
            None => refused.push(format!("{} at {}", site.panic, site.place)),
        }
    }
    for name in &pointers {
        if !INDIRECT.iter().any(|(caller, _)| name.starts_with(caller)) {
            refused.push(format!("a call through a pointer in {name}"));
        }
    }
    println!("the control task reaches {} places that panic, all of which are excluded by:", sites.len());
    for Allowed { place, panic, why } in used.into_iter().map(|n| &ALLOWED[n]) {
        println!("  {place} {panic}: {why}");
    }
    ensure!(refused.is_empty(), "the control task reaches (xtask/src/panics.rs):\n{}", refused.join("\n"));
    Ok(())
}

impl Site {
    fn matches(&self, allowed: &Allowed) -> bool {
        self.place.starts_with(allowed.place) && self.panic.starts_with(allowed.panic)
    }
}

/// The image's constants, for the places of panics.
struct Constants<'a> {
    sections: Vec<(u64, &'a [u8])>,
}

impl<'a> Constants<'a> {
    fn new(elf: &'a [u8]) -> Result<Self> {
        let file = object::File::parse(elf)?;
        let mut sections = Vec::new();
        for section in file.sections().filter(|section| section.name() == Ok(".rodata")) {
            sections.push((section.address(), section.data()?));
        }
        Ok(Self { sections })
    }

    fn bytes(&self, address: u32, length: usize) -> Option<&'a [u8]> {
        self.sections.iter().find_map(|(start, data)| {
            let at = usize::try_from(u64::from(address).checked_sub(*start)?).ok()?;
            data.get(at..at.checked_add(length)?)
        })
    }

    /// The place at `address`, if a `Location` is there: a file's name by address and length, then line and column.
    fn place(&self, address: u32) -> Option<String> {
        let location = self.bytes(address, 16)?;
        let [name, length, line, _] = [0, 4, 8, 12]
            .map(|at| u32::from_le_bytes([location[at], location[at + 1], location[at + 2], location[at + 3]]));
        let name = std::str::from_utf8(self.bytes(name, length.try_into().ok()?)?).ok()?;
        // Without the folder of the registry or of the toolchain, and without the version: embassy-stm32/src/spi/mod.rs.
        let after = |folder: &str| Some(name.split_once(folder)?.1.split_once('/')?.1);
        let library = || after("/rustc/")?.strip_prefix("library/");
        let name = after("/registry/src/").or_else(library).unwrap_or(name);
        let (package, path) = name.split_once('/')?;
        let package = package
            .rsplit_once('-')
            .filter(|(_, version)| version.starts_with(|c: char| c.is_ascii_digit()))
            .map_or(package, |(package, _)| package);
        Path::new(name).extension()?.eq("rs").then(|| format!("{package}/{path}:{line}"))
    }
}

/// A function: what it calls by name, whether it calls through a pointer, and the places it has at hand where it calls.
#[derive(Default)]
struct Function {
    calls: Vec<(String, Option<String>)>,
    pointers: bool,
}

struct Image {
    functions: BTreeMap<String, Function>,
}

impl Image {
    fn read(code: &str, constants: &Constants) -> Self {
        let mut functions: BTreeMap<String, Function> = BTreeMap::new();
        let mut name = String::new();
        // Halves of the constants that the last instructions have loaded, by register.
        let mut loaded: Vec<(&str, u32)> = Vec::new();
        for line in code.lines() {
            if let Some(header) = line.strip_suffix(">:").and_then(|line| line.split_once(" <")) {
                header.1.clone_into(&mut name);
                functions.entry(name.clone()).or_default();
                loaded.clear();
                continue;
            }
            let Some((_, instruction)) = line.split_once(":\t").or_else(|| line.split_once(":      \t")) else {
                continue;
            };
            let instruction = instruction.trim_start();
            let (operation, operands) = instruction.split_once('\t').unwrap_or((instruction, ""));
            let stem = operation.split('.').next().unwrap_or(operation);
            let function = functions.entry(name.clone()).or_default();
            match stem {
                "movw" | "movt" => {
                    if let Some((register, value)) = operands.split_once(", #0x")
                        && let Ok(value) = u32::from_str_radix(value.trim(), 16)
                    {
                        loaded.push((register, if stem == "movt" { value << 16 } else { value }));
                        let kept = loaded.len().saturating_sub(LOADED_WITHIN);
                        loaded.drain(..kept);
                    }
                }
                _ if stem.starts_with('b') || stem == "cbz" || stem == "cbnz" => {
                    if let Some(target) = target(operands) {
                        if target != name {
                            function.calls.push((target.to_owned(), place(&loaded, constants)));
                        }
                    } else if stem == "blx" || stem == "bx" && operands.trim() != "lr" {
                        function.pointers = true;
                    }
                }
                _ => {}
            }
        }
        Self { functions }
    }

    /// The calls into what panics that the control task reaches, and the functions on the way that call through pointers.
    fn reach(&self) -> Result<(BTreeSet<Site>, BTreeSet<String>)> {
        let polls = self.functions.keys().filter(|name| name.contains("TaskStorage") && name.contains("::poll::"));
        let control: Vec<&str> =
            polls.map(String::as_str).filter(|poll| self.walk([*poll]).iter().any(|name| is_step(name))).collect();
        let [control] = control[..] else { bail!("{} tasks decide a flight, where one should", control.len()) };
        let called: BTreeSet<&str> =
            self.functions.values().flat_map(|f| f.calls.iter().map(|(name, _)| name.as_str())).collect();
        let by_pointer =
            self.functions.keys().map(String::as_str).filter(|name| is_core(name) && !called.contains(name));
        let reached = self.walk(std::iter::once(control).chain(by_pointer));
        let (mut sites, mut pointers) = (BTreeSet::new(), BTreeSet::new());
        for name in reached {
            let function = &self.functions[name];
            for (panic, place) in function.calls.iter().filter(|(callee, _)| panics(callee)) {
                let place = place.clone().unwrap_or_else(|| name.to_owned());
                sites.insert(Site { place, panic: panic.clone() });
            }
            if function.pointers {
                pointers.insert(name.to_owned());
            }
        }
        Ok((sites, pointers))
    }

    /// All functions that can be reached from `roots`, those that panic left out.
    fn walk<'a>(&'a self, roots: impl IntoIterator<Item = &'a str>) -> BTreeSet<&'a str> {
        let mut waiting: Vec<&str> = roots.into_iter().collect();
        let mut reached = BTreeSet::new();
        while let Some(name) = waiting.pop() {
            if let Some(function) = self.functions.get(name)
                && reached.insert(name)
            {
                waiting
                    .extend(function.calls.iter().map(|(callee, _)| callee.as_str()).filter(|callee| !panics(callee)));
            }
        }
        reached
    }
}

/// The function that a branch goes to: `0x8021ff8 <core::panicking::panic+0x4> @ imm = #0x1adf0`.
fn target(operands: &str) -> Option<&str> {
    let (_, name) = operands.split_once('<')?;
    let name = name.split(" @ ").next().unwrap_or(name).trim_end().strip_suffix('>')?;
    Some(name.rsplit_once("+0x").map_or(name, |(name, _)| name))
}

/// The last place among the constants that are loaded.
fn place(loaded: &[(&str, u32)], constants: &Constants) -> Option<String> {
    loaded.iter().enumerate().rev().find_map(|(n, &(register, half))| {
        let other = loaded[..n].iter().rev().find(|(other, _)| *other == register)?;
        constants.place(half | other.1)
    })
}

fn panics(name: &str) -> bool {
    const PANICS: [&str; 8] = [
        "core::panicking::",
        "core::option::",
        "core::result::",
        "core::cell::panic",
        "core::slice::",
        "core::str::",
        "_defmt_panic",
        "rust_begin_unwind",
    ];
    PANICS.iter().any(|panic| name.starts_with(panic))
}

fn is_core(name: &str) -> bool {
    name.contains("control_core..") || name.contains("control_core::")
}

fn is_step(name: &str) -> bool {
    name.starts_with("control_core::flight::Flight::decide")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The control task's poll, with a function that it calls; a location at 0x1000 of a file named at 0x1010.
    fn image(step: &str) -> Image {
        let code = format!(
            "08000000 <embassy_executor::raw::TaskStorage$LT$F$GT$::poll::h1>:\n 8000000:      \tbl\t0x8000100 \
             <control_core::flight::Flight::decide::h2> @ imm = #0x100\n\n\
             08000100 <control_core::flight::Flight::decide::h2>:\n{step} 8000110:      \tbx\tlr\n"
        );
        let mut rodata = Vec::new();
        for word in [0x1010_u32, 17, 7, 1] {
            rodata.extend(word.to_le_bytes());
        }
        rodata.extend(b"core-1.2/src/a.rs");
        Image::read(&code, &Constants { sections: vec![(0x1000, &rodata)] })
    }

    #[test]
    fn a_panic_is_found_with_its_place_and_one_that_nobody_reaches_is_not() {
        let panics = " 8000104:      \tmovw\tr2, #0x1000\n 8000108:      \tmovt\tr2, #0x0\n 800010c:      \tbl\t0x8000200 \
                      <core::panicking::panic_bounds_check> @ imm = #0xf0\n";
        let (sites, pointers) = image(panics).reach().unwrap();
        let site =
            Site { place: "core/src/a.rs:7".to_owned(), panic: "core::panicking::panic_bounds_check".to_owned() };
        assert_eq!((sites.into_iter().collect::<Vec<_>>(), pointers.len()), (vec![site], 0));
        assert_eq!(image("").reach().unwrap().0.len(), 0);
    }

    #[test]
    fn a_call_through_a_pointer_is_found_and_a_return_is_none() {
        let (_, pointers) = image(" 8000104:      \tblx\tr3\n").reach().unwrap();
        assert_eq!(pointers.into_iter().collect::<Vec<_>>(), ["control_core::flight::Flight::decide::h2"]);
    }

    #[test]
    fn an_image_without_a_control_task_is_refused() {
        let image = Image::read("08000000 <main>:\n", &Constants { sections: Vec::new() });
        assert!(image.reach().is_err());
    }
}
