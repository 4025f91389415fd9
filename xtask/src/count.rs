//! Instructions of a control tick, counted on an emulated Cortex-M4F.
//!
//! `sim-host` flies and records every tick; `tick-bench` repeats the record on QEMU. The board must compute the same
//! thrusts to the bit, and no tick may take more than its budget.
use crate::workspace::{FLIGHT, Workspace};
use anyhow::{Context, Result, bail, ensure};
use std::fs::File;
use std::path::Path;
use std::process::{Command, Stdio};
use std::str::FromStr;
use std::time::{Duration, Instant};
use xshell::cmd;

/// What is counted: who flies, which scenario, and the most instructions of one tick, which is one call of the whole controller.
///
/// At 500 Hz the board has 336,000 for each. `default` is counted where it has most to do: while it watches, finds a lost rotor,
/// spins and comes back, and where it finds several faults at once.
const FLIGHTS: [(&str, &str, u32); 6] = [
    ("lgs", FLIGHT, 900),
    ("default", FLIGHT, 2500),
    ("default", "scenarios/single_rotor_100_low_thrust.toml", 2500),
    ("default", "scenarios/opposite_pair_100.toml", 2500),
    ("default", "scenarios/faults/hard_over.toml", 2500),
    ("default", "scenarios/faults/desync.toml", 2500),
];

/// The most instructions of an estimator step, which is every 4 ms.
const ESTIMATOR_STEP_MAX: u32 = 25_000;
/// The most from an inertial sample to the motors' commands.
const RATE_PATH_MAX: u32 = 2_500;

/// The PSRAM of mps2-an386, where `tick-bench` looks for the record.
const RECORD_ADDRESS: &str = "0x21000000";
/// An instruction takes 2^10 ns of virtual time and nothing else does: see `tick-bench/src/count.rs`.
const ICOUNT: &str = "shift=10,sleep=off";
/// The replay takes about a second; an image that hangs would never end.
const QEMU_SECONDS_MAX: u64 = 120;

pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    let folder = workspace.results("tick-bench")?;
    let (simulator, out) = (workspace.build_simulator(true)?, folder.join("flight"));
    let image = workspace.build_image("tick-bench")?;
    let (mut estimation, mut around, mut control) = (0, 0, 0);
    for (i, (controller, scenario, instructions_max)) in FLIGHTS.into_iter().enumerate() {
        let record = folder.join(format!("{i}.ticks"));
        let fly =
            cmd!(workspace.shell, "{simulator} fly {scenario} --controller {controller} --out {out} --ticks {record}");
        fly.ignore_stdout().run()?;
        let printed = emulate(&image, &record, &folder.join(format!("{i}.txt")))?;
        if i == 0 {
            report_functions(&printed)?;
            estimation = report_estimator(&printed)?;
            around = around_the_controller(&printed)?;
        }
        control = report_tick(&printed, instructions_max)?.max(control);
    }
    let path = estimation + around + control;
    println!(
        "rate path: {path} from an inertial sample to the motors' commands, budget {RATE_PATH_MAX}: estimator {estimation}, helm {around}, \
         controller {control}"
    );
    ensure!(path <= RATE_PATH_MAX, "the rate path takes {path} instructions, budget {RATE_PATH_MAX}");
    Ok(())
}

/// What the helm takes between estimate and motors beside the controller's part.
fn around_the_controller(printed: &str) -> Result<u32> {
    let helm = printed.lines().map(Line).find(|line| line.is("helm")).context("tick-bench printed no helm")?;
    let (flown, act, controller): (u32, u32, u32) =
        (helm.number("flown")?, helm.number("act")?, helm.number("controller")?);
    ensure!(flown > 0, "the helm of tick-bench has not flown");
    act.checked_sub(controller).context("the helm takes less than its controller")
}

/// Runs the image on the record; returns what it printed.
fn emulate(image: &Path, record: &Path, output: &Path) -> Result<String> {
    let mut qemu = Command::new("qemu-system-arm");
    qemu.args(["-M", "mps2-an386", "-display", "none", "-monitor", "none", "-serial", "none"])
        .args(["-icount", ICOUNT, "-semihosting-config", "enable=on,target=native"])
        .arg("-device")
        .arg(format!("loader,file={},addr={RECORD_ADDRESS},force-raw=on", record.display()))
        .arg("-kernel")
        .arg(image)
        .stdin(Stdio::null())
        .stdout(File::create(output)?);
    println!("$ {}", format!("{qemu:?}").replace('"', ""));
    let mut child = qemu.spawn().context("qemu-system-arm does not start (`cargo xtask setup` installs it)")?;
    let started = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if started.elapsed() > Duration::from_secs(QEMU_SECONDS_MAX) {
            child.kill()?;
            child.wait()?;
            bail!("tick-bench was still running after {QEMU_SECONDS_MAX} s");
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    let printed = std::fs::read_to_string(output)?;
    ensure!(status.success(), "tick-bench failed: {}", printed.trim());
    Ok(printed)
}

/// Prints what the elementary functions take.
fn report_functions(printed: &str) -> Result<()> {
    println!("{:<10} {:>6} {:>6} {:>10}   instructions a call", "function", "core", "libm", "micromath");
    for line in printed.lines().map(Line).filter(|line| line.is("math")) {
        let [function, core, libm, micromath] = ["function", "core", "libm", "micromath"].map(|key| line.text(key));
        println!("{:<10} {:>6} {:>6} {:>10}", function?, core?, libm?, micromath?);
    }
    Ok(())
}

/// Prints what the estimator takes, with whatever arrives, and judges it; returns what a sample takes before the motors are told.
fn report_estimator(printed: &str) -> Result<u32> {
    println!(
        "{:<10} {:>6} {:>6} {:>6}   instructions of an inertial sample, and of a whole step of the estimator; bytes of stack",
        "arrival", "path", "step", "stack"
    );
    let mut dearest = 0;
    for line in printed.lines().map(Line).filter(|line| line.is("estimator")) {
        let (arrival, path, step): (_, u32, u32) = (line.text("arrival")?, line.number("path")?, line.number("step")?);
        println!("{arrival:<10} {path:>6} {step:>6} {:>6}", line.text("stack")?);
        ensure!(step <= ESTIMATOR_STEP_MAX, "an estimator step takes {step} instructions, budget {ESTIMATOR_STEP_MAX}");
        dearest = path.max(dearest);
    }
    ensure!(dearest > 0, "tick-bench printed no estimator");
    let sizes = printed.lines().find_map(|line| line.strip_prefix("bytes ")).context("tick-bench printed no sizes")?;
    println!("bytes: {sizes}");
    Ok(dearest)
}

/// Prints what a tick takes, and judges it; returns what of it is before the thrusts.
fn report_tick(printed: &str, instructions_max: u32) -> Result<u32> {
    let tick = printed.lines().map(Line).find(|line| line.is("tick")).context("tick-bench printed no tick")?;
    let (ticks, worst, differing): (u32, u32, u32) =
        (tick.number("ticks")?, tick.number("worst")?, tick.number("differing")?);
    let (path, rejected): (u32, u32) = (tick.number("path")?, tick.number("rejected")?);
    println!(
        "tick: {path} to the thrusts; worst {worst} at {}, mean {}, budget {instructions_max}; {} bytes of stack; {ticks} ticks, {rejected} rejected, \
         {differing} differ from the host",
        tick.text("worst_at")?,
        tick.text("mean")?,
        tick.text("stack")?,
    );
    ensure!(ticks > rejected, "no tick was counted");
    ensure!(
        differing == 0,
        "{differing} of {ticks} ticks differ between host and board, first tick {}",
        tick.text("first_differing")?
    );
    ensure!(worst <= instructions_max, "a tick takes {worst} instructions, budget {instructions_max}");
    Ok(path)
}

/// A printed line: `kind key=value key=value`.
#[derive(Clone, Copy)]
struct Line<'a>(&'a str);

impl<'a> Line<'a> {
    fn is(self, kind: &str) -> bool {
        self.0.split_whitespace().next() == Some(kind)
    }

    fn text(self, key: &str) -> Result<&'a str> {
        let mut pairs = self.0.split_whitespace().filter_map(|word| word.split_once('='));
        let found = pairs.find(|(found, _)| *found == key);
        Ok(found.with_context(|| format!("tick-bench printed no {key} in `{}`", self.0))?.1)
    }

    fn number<T: FromStr>(self, key: &str) -> Result<T> {
        let text = self.text(key)?;
        text.parse().ok().with_context(|| format!("tick-bench printed {key}={text}, which is no number"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn printed(ticks: u32, worst: u32, differing: u32) -> String {
        format!(
            "tick ticks={ticks} path=800 worst={worst} mean=1.5 worst_at=3 stack=500 rejected=0 differing={differing} \
             first_differing=none\nmath function=tanh core=33 libm=108 micromath=84\n"
        )
    }

    #[test]
    fn an_estimator_is_judged() {
        let text = |step: u32| format!("estimator arrival=gnss path=900 step={step} stack=900\nbytes estimator=200\n");
        assert!(report_estimator(&text(ESTIMATOR_STEP_MAX)).is_ok());
        assert!(report_estimator(&text(ESTIMATOR_STEP_MAX + 1)).is_err());
        assert!(report_estimator("").is_err());
    }

    #[test]
    fn a_measurement_is_judged() {
        for (why, text, good) in [
            ("all is well", printed(9, 900, 0), true),
            ("too slow", printed(9, 901, 0), false),
            ("a thrust differs", printed(9, 1, 1), false),
            ("nothing flew", printed(0, 0, 0), false),
            ("no tick line", String::new(), false),
            ("a key is missing", "tick ticks=9".to_owned(), false),
        ] {
            assert_eq!(report_tick(&text, 900).is_ok(), good, "{why}");
        }
    }
}
