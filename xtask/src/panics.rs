//! What the control task, and what interrupts it, can reach in the flight image that panics.
//!
//! ```text
//! disassembly ─► who calls whom ─► all that the control task's poll reaches, ─► its calls into core's panics ─► ALLOWED, or refused
//!                                  and the handlers in the vector table
//! ```
//!
//! What panics has the place in the source at hand as a constant, a `core::panic::Location`: that is the place printed. A panic of `defmt`
//! logs its message first, an interned string whose number is a constant: printed are the package and that. A function of `control-core` that nobody calls by name is called through a pointer, and is a root too. Other calls through pointers are listed by
//! [`INDIRECT`], with where they lead.
use crate::workspace::Workspace;
use allowed::{ALLOWED, Allowed, INDIRECT};
use anyhow::{Context, Result, bail, ensure};
use object::{Object, ObjectSection, ObjectSymbol};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use xshell::cmd;

mod allowed;

/// Where a panic of `defmt` goes, its message being logged.
const DEFMT_PANIC: &str = "_defmt_panic";

/// Instructions before a call in which the place of its panic is loaded.
const LOADED_WITHIN: usize = 12;

/// A call into what panics.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
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
    let image = Image::read(&code, &Constants::new(&file)?, &vectors(&file)?);
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
    println!(
        "the control task and the {} interrupts reach {} places that panic, all of which are excluded by:",
        image.handlers.len(),
        sites.len()
    );
    for Allowed { place, panic, why } in used.into_iter().map(|n| &ALLOWED[n]) {
        println!("  {place} {panic}: {why}");
    }
    ensure!(
        refused.is_empty(),
        "the control task, or an interrupt, reaches (xtask/src/panics.rs):\n{}",
        refused.join("\n")
    );
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
    /// Package and message of each of `defmt`'s panics, by the number of its string.
    messages: BTreeMap<u32, Site>,
}

impl<'a> Constants<'a> {
    fn new(elf: &'a [u8]) -> Result<Self> {
        let file = object::File::parse(elf)?;
        let mut sections = Vec::new();
        for section in file.sections().filter(|section| section.name() == Ok(".rodata")) {
            sections.push((section.address(), section.data()?));
        }
        let mut messages = BTreeMap::new();
        for symbol in file.symbols() {
            // The name is an object of JSON.
            let field = |name: &str, end: &str| {
                let (_, rest) = symbol.name().ok()?.split_once(&format!("\"{name}\":\""))?;
                Some(rest.split_once(end)?.0.to_owned())
            };
            if let (Some(package), Some(message)) = (field("package", "\""), field("data", "\",\"disambiguator\""))
                && (message.starts_with("panicked at") || message.starts_with("Unwrap of"))
            {
                messages.insert(u32::try_from(symbol.address())?, Site { place: package, panic: message });
            }
        }
        Ok(Self { sections, messages })
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

/// The addresses of the handlers in the vector table, but for the reset's, the hard fault's and that of what nobody handles, the NMI's too:
/// after these nothing is flown.
fn vectors(elf: &[u8]) -> Result<BTreeSet<u32>> {
    let file = object::File::parse(elf)?;
    let table = file.section_by_name(".vector_table").context("there is no vector table")?;
    let words: Vec<u32> = table.data()?.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word) & !1).collect();
    let [_, _, unhandled, hard_fault, ..] = words[..] else { bail!("a vector table of {} words", words.len()) };
    Ok(words.into_iter().skip(4).filter(|&word| word != 0 && word != unhandled && word != hard_fault).collect())
}

/// A function: what it calls by name, whether it calls through a pointer, and the places it has at hand where it calls.
#[derive(Default)]
struct Function {
    calls: Vec<(String, Option<String>)>,
    pointers: bool,
    /// What it says where it panics by `defmt`.
    messages: Vec<Site>,
}

struct Image {
    functions: BTreeMap<String, Function>,
    /// Those that interrupts call.
    handlers: BTreeSet<String>,
}

impl Image {
    fn read(code: &str, constants: &Constants, vectors: &BTreeSet<u32>) -> Self {
        let mut handlers = BTreeSet::new();
        let mut functions: BTreeMap<String, Function> = BTreeMap::new();
        let mut name = String::new();
        // Halves of the constants that the last instructions have loaded, by register.
        let mut loaded: Vec<(&str, u32)> = Vec::new();
        for line in code.lines() {
            if let Some(header) = line.strip_suffix(">:").and_then(|line| line.split_once(" <")) {
                header.1.clone_into(&mut name);
                if u32::from_str_radix(header.0, 16).is_ok_and(|address| vectors.contains(&address)) {
                    handlers.insert(name.clone());
                }
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
                        if stem == "movt"
                            && let Some(number) = constant(&loaded)
                            && let Some(message) = constants.messages.get(&number)
                        {
                            function.messages.push(message.clone());
                        }
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
        Self { functions, handlers }
    }

    /// The calls into what panics that the control task and the interrupts reach, and the functions on the way that call through pointers.
    fn reach(&self) -> Result<(BTreeSet<Site>, BTreeSet<String>)> {
        let polls = self.functions.keys().filter(|name| name.contains("TaskStorage") && name.contains("::poll::"));
        let control: Vec<&str> =
            polls.map(String::as_str).filter(|poll| self.walk([*poll]).iter().any(|name| is_step(name))).collect();
        let [control] = control[..] else { bail!("{} tasks decide a flight, where one should", control.len()) };
        let called: BTreeSet<&str> =
            self.functions.values().flat_map(|f| f.calls.iter().map(|(name, _)| name.as_str())).collect();
        let by_pointer =
            self.functions.keys().map(String::as_str).filter(|name| is_core(name) && !called.contains(name));
        let handlers = self.handlers.iter().map(String::as_str);
        let reached = self.walk(std::iter::once(control).chain(by_pointer).chain(handlers));
        let (mut sites, mut pointers) = (BTreeSet::new(), BTreeSet::new());
        for name in reached {
            let function = &self.functions[name];
            for (panic, place) in function.calls.iter().filter(|(callee, _)| panics(callee)) {
                if panic == DEFMT_PANIC && !function.messages.is_empty() {
                    sites.extend(function.messages.iter().cloned());
                } else {
                    let place = place.clone().filter(|_| panic != DEFMT_PANIC).unwrap_or_else(|| name.to_owned());
                    sites.insert(Site { place, panic: panic.clone() });
                }
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

/// The constant whose upper half was loaded last.
fn constant(loaded: &[(&str, u32)]) -> Option<u32> {
    let (&(register, upper), before) = loaded.split_last()?;
    before.iter().rev().find_map(|&(other, lower)| (other == register).then_some(upper | lower))
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
        DEFMT_PANIC,
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

    /// The control task's poll, with a function that it calls.
    const CONTROL: &str = "08000000 <embassy_executor::raw::TaskStorage$LT$F$GT$::poll::h1>:\n 8000000:      \tbl\t0x8000100 \
         <control_core::flight::Flight::decide::h2> @ imm = #0x100\n\n\
         08000100 <control_core::flight::Flight::decide::h2>:\nSTEP 8000110:      \tbx\tlr\n";

    /// The same; a location at 0x1000 of a file named at 0x1010, and a message of the number 0x7a.
    fn image(step: &str) -> Image {
        let code = CONTROL.replace("STEP", step);
        let mut rodata = Vec::new();
        for word in [0x1010_u32, 17, 7, 1] {
            rodata.extend(word.to_le_bytes());
        }
        rodata.extend(b"core-1.2/src/a.rs");
        let message = Site { place: "hal".to_owned(), panic: "panicked at 'no'".to_owned() };
        let messages = BTreeMap::from([(0x7a, message)]);
        Image::read(&code, &Constants { sections: vec![(0x1000, &rodata)], messages }, &BTreeSet::new())
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
    fn a_panic_of_defmt_is_known_by_what_it_says() {
        let panics = " 8000104:      \tmovw\tr0, #0x7a\n 8000108:      \tmovt\tr0, #0x0\n 800010c:      \tbl\t0x8000200 \
                      <_defmt_panic> @ imm = #0xf0\n";
        let (sites, _) = image(panics).reach().unwrap();
        let site = Site { place: "hal".to_owned(), panic: "panicked at 'no'".to_owned() };
        assert_eq!(sites.into_iter().collect::<Vec<_>>(), [site]);
    }

    #[test]
    fn what_interrupts_reach_counts_and_other_tasks_do_not() {
        let panics = " 8000304:      \tbl\t0x8000200 <core::panicking::panic> @ imm = #0xf0\n";
        let code = format!("{}08000300 <EXTI4>:\n{panics}", CONTROL.replace("STEP", ""));
        let found = |vectors: &[u32]| {
            let vectors = vectors.iter().copied().collect();
            let constants = Constants { sections: Vec::new(), messages: BTreeMap::new() };
            Image::read(&code, &constants, &vectors).reach().unwrap().0.len()
        };
        assert_eq!((found(&[0x0800_0300]), found(&[])), (1, 0));
    }

    #[test]
    fn a_call_through_a_pointer_is_found_and_a_return_is_none() {
        let (_, pointers) = image(" 8000104:      \tblx\tr3\n").reach().unwrap();
        assert_eq!(pointers.into_iter().collect::<Vec<_>>(), ["control_core::flight::Flight::decide::h2"]);
    }

    #[test]
    fn an_image_without_a_control_task_is_refused() {
        let image = Image::read(
            "08000000 <main>:\n",
            &Constants { sections: Vec::new(), messages: BTreeMap::new() },
            &BTreeSet::new(),
        );
        assert!(image.reach().is_err());
    }
}
