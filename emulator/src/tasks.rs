//! How long each of the image's tasks runs without a pause: from the call of its poll to the return from it.
//!
//! Interrupts on the way are counted in, and what other tasks do meanwhile is not: that is theirs. A task is found by the debug
//! information of its poll function, whose symbol is the same for all; or, where the compiler has left a body outside its poll, by the body.
use crate::{Failure, Image};
use addr2line::Loader;
use object::{Object, ObjectSymbol};
use std::borrow::Cow;
use std::path::Path;

/// What the symbols of the executor's poll functions contain, and what their debug information calls a task's body.
const POLL: &str = "TaskStorage$LT$F$GT$4poll";
const BODY: &str = "_task_inner_function";

/// A task, and the longest it ran.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Task {
    /// Its function.
    pub name: String,
    /// Where its poll begins.
    entry: u32,
    /// The most core cycles without a pause.
    pub cycles_max: u64,
}

/// A poll that has begun.
#[derive(Clone, Copy, Debug)]
struct Running {
    task: usize,
    /// Where it returns to, and the stack pointer there.
    back: (u32, u32),
    /// When it began, later by what others did since.
    since: u64,
}

/// The tasks that are watched.
#[derive(Debug, Default)]
pub(crate) struct Tasks {
    all: Vec<Task>,
    /// A bit for each address, modulo 64 halfwords, at which one begins: most blocks are none, and there are many.
    begin: u64,
    /// The innermost last: it preempts the others.
    running: Vec<Running>,
}

impl Task {
    /// The tasks of the image in this file.
    ///
    /// # Errors
    /// If the file cannot be read, or a poll function cannot be told from the others.
    pub fn all(path: &Path, image: &Image) -> Result<Vec<Self>, Failure> {
        let fail = |error: &dyn std::fmt::Display| Failure(format!("{}: {error}", path.display()));
        let loader = Loader::new(path).map_err(|error| fail(&error))?;
        let file = object::File::parse(&*image.elf).map_err(|error| fail(&error))?;
        let (mut tasks, mut hollow, mut outside) = (Vec::new(), 0, 0);
        for symbol in file.symbols().filter(|symbol| symbol.size() > 0) {
            let of = |kind: &str| symbol.name().is_ok_and(|name| name.starts_with("_ZN") && name.contains(kind));
            if of(POLL) || of(BODY) {
                let entry = symbol.address() & !1;
                let name = (entry..entry + symbol.size()).step_by(2).find_map(|address| body(&loader, address));
                (hollow, outside) = (hollow + u32::from(name.is_none()), outside + u32::from(of(BODY)));
                tasks.extend(name.map(|name| Self { name, entry: entry as u32, cycles_max: 0 }));
            }
        }
        if hollow == outside {
            Ok(tasks)
        } else {
            Err(fail(&format!("{hollow} polls are without their body, but {outside} bodies are outside a poll")))
        }
    }
}

/// The task whose body the code at `address` is part of.
fn body(loader: &Loader, address: u64) -> Option<String> {
    let mut frames = loader.find_frames(address).ok()?;
    while let Ok(Some(frame)) = frames.next() {
        let name = frame.function.as_ref().and_then(|function| function.demangle().ok().map(Cow::into_owned));
        if let Some((path, _)) = name.as_deref().and_then(|name| name.split_once(BODY)) {
            return path.rsplit("::").next().map(|name| name.trim_start_matches('_').to_owned());
        }
    }
    None
}

impl Tasks {
    /// Watches these from now on.
    pub(crate) fn watch(&mut self, tasks: Vec<Task>) {
        self.begin = tasks.iter().fold(0, |bits, task| bits | bit(task.entry));
        self.all = tasks;
    }

    /// The core is about to run a block at `address`; `registers` are the link register and the stack pointer.
    pub(crate) fn block(&mut self, address: u32, now: u64, registers: impl FnOnce() -> (u32, u32)) {
        let may_begin = self.begin & bit(address) != 0;
        let begins = self.all.iter().position(|task| may_begin && task.entry == address);
        let ends = self.running.last().is_some_and(|running| running.back.0 == address);
        if begins.is_none() && !ends {
            return;
        }
        let (link, stack) = registers();
        if let Some(task) = begins {
            self.running.push(Running { task, back: (link & !1, stack), since: now });
        } else if let Some(&Running { task, back, since }) = self.running.last()
            && back.1 == stack
        {
            self.running.pop();
            let took = now - since;
            self.all[task].cycles_max = self.all[task].cycles_max.max(took);
            for outer in &mut self.running {
                outer.since += took;
            }
        }
    }

    /// The chip was reset.
    pub(crate) fn reset(&mut self) {
        self.running.clear();
    }

    pub(crate) fn all(&self) -> &[Task] {
        &self.all
    }
}

fn bit(address: u32) -> u64 {
    1 << (address / 2 % 64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_poll_is_timed_without_what_preempts_it() {
        let task = |name: &str, entry| Task { name: name.to_owned(), entry, cycles_max: 0 };
        let mut tasks = Tasks::default();
        tasks.watch(vec![task("slow", 0x100), task("quick", 0x200)]);
        let mut at = |address, now, link, stack| tasks.block(address, now, || (link, stack));
        at(0x100, 1_000, 0x51, 0x2000);
        at(0x104, 1_010, 0x51, 0x1f00);
        at(0x200, 1_020, 0x61, 0x1e00);
        // The slow one's return address, while the quick one runs, and the quick one's, deeper: neither is a return.
        at(0x50, 1_030, 0, 0x1d00);
        at(0x60, 1_040, 0, 0x1d00);
        at(0x60, 1_050, 0, 0x1e00);
        at(0x50, 1_090, 0, 0x2000);
        let took: Vec<u64> = tasks.all().iter().map(|task| task.cycles_max).collect();
        assert_eq!(took, [60, 30]);
    }
}
