//! The pipe: another program moves the body, the image answers with its motors, step by step.
//!
//! Each message begins with a byte that says what it is; numbers are little-endian.
//!
//! | to the emulator | then                                                                        |
//! |-----------------|-----------------------------------------------------------------------------|
//! | `m`             | 6 × f32: specific force, m/s², and rate, rad/s, forward, right, down; holds |
//! | `b`             | 2 × f32: battery, V, and the current out of it, A; holds                    |
//! | `c`             | 16 × u16: the radio receiver sends a frame with these channels now          |
//! | `f`             | u8: 0 the core goes where there is no code, 1 the program hangs with interrupts masked, 2 the data-ready line breaks, 3 what runs below interrupts hangs, 4 a panic, 5 the supply drops for a moment, 6 and 7 the inertial unit's data line stays low or high, 8 the unit answers anything, 9 power is off for a moment, 10 the stack is used up, 11 a panic of `defmt`, 12 the satellite receiver refuses the next three messages that ask for more than a speed, 13 each of the converter's next twenty conversions never ends |
//! | `k`             | u32 words programmed and sectors erased after which power is cut, u8 whether the next one is done in part; power comes back at once |
//! | `e`             | u32 address, u32 bytes, and those: fills flash as somebody may have left it |
//! | `o`             | u32 bytes, and those: path, UTF-8, of the file that is the content of a card which is put in now; of none, it is pulled out |
//! | `y`             | u32 bytes, and those: path, UTF-8, of the file that is the content of a log flash in the place of the card's slot; before its first period |
//! | `j`             | 3 × u32: how long the card takes to program a block, or the log flash a page, µs; how long now and then, µs; once in how many blocks that is |
//! | `l`             | u8 bytes, and those: the station sends them now                             |
//! | `h`             | nothing: answers what the station has heard                                 |
//! | `i`             | u8: the board carries 0 an ICM-42688-P, 1 an MPU-6000; before its first period |
//! | `z`             | nothing: answers whether the buzzer sounds                                  |
//! | `a`             | nothing: answers what the tasks have taken, if they are watched             |
//! | `p`             | 2 × f32: static pressure, Pa, and temperature, °C, at the barometer; holds  |
//! | `g`             | 3 × f32: magnetic field, µT, forward, right, down; holds                    |
//! | `u`             | the satellite receiver sends this fix now, unless it was told to send fewer: 2 × i32 latitude and longitude, 1e-7°; 7 × f32 height above the ellipsoid, m, velocity north, east, down, m/s, its own errors horizontal, vertical, m, and of speed, m/s, 1 σ; u8 kind of fix, 3 in three dimensions; u8 satellites |
//! | `v`             | the vision computer sends this pose now: u32 its age, µs; 9 × f32 position north, east, down, m, quaternion w, x, y, z from body to NED, its own errors of position, m, and attitude, rad, 1 σ |
//! | `d`             | u8: 0 the barometer, 1 the magnetometer; u8: 0 it no longer answers, 1 it works again, 2 it holds the bus |
//! | `t`             | u8: 0 the radio receiver's line, 1 the satellite receiver's, 2 the vision computer's; u8 bytes, and those, which come over that line now |
//! | `r`             | 4 × f32: how fast the rotors turn, rad/s; holds                             |
//! | `q`             | u8: a motor, 0 to 3; u8: its speed controller 0 no longer answers, 1 does, 2 does with a bit turned |
//! | `w`             | u32: the board is switched on anew, and its image takes its clock to have run for so many seconds |
//! | `n`             | nothing: run one period of the inertial unit, then answer                   |
//!
//! A period ends [`BEFORE_SAMPLE`] cycles before the next sample, so that whatever is said next is in it.
//!
//! | from it | then                                                                                               |
//! |---------|----------------------------------------------------------------------------------------------------|
//! | `s`     | u64 cycles, u64 busy ones of them, both since reset; u64 longest time from sample to frame, cycles; |
//! |         | 4 × u16 what each motor was told last, 65535 for nothing, and 4 × u8 by what: 0 nothing yet, 1 DShot300, 2 DShot600, 3 pulses, whose microseconds these are; |
//! |         | 4 × u32 frames and pulses that each understood;                                                     |
//! |         | u32 words of the image's record of its last step, and those; u32 bytes of its log since the last answer, and those, UTF-8 |
//! | `h`     | u32 how often power has been off; u32 bytes that the station has heard since it last asked, and those |
//! | `z`     | u8: 1 the buzzer sounds, 0 it does not                                                              |
//! | `a`     | u32 bytes of stack and u32 of these used; u32 tasks, and of each: u32 bytes of its name, and those, UTF-8; u64 longest run without a pause, cycles |
//! | `x`     | u32 bytes of why the run has ended, and those, UTF-8; nothing follows                              |
use crate::{Busy, Failure, Fix, Health, Image, Inertial, Line, Log, Machine, Part, Task, Telemetry};
use flight_link::VisionPose;
use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::path::Path;

/// Cycles between the end of a period and the next sample: longer than any block of code.
const BEFORE_SAMPLE: u64 = 2_000;
/// Cycles after which an image that has not switched its inertial unit on never will: time for a few sectors to be erased.
const BOOT_MAX: u64 = 5 * 168_000_000;
/// The image's record of its last step, a sequence number before it.
const RECORD: &str = "LAST_STEP";

/// The records of the image's steps. One that ends just before its period does is followed by the next within the next period.
struct Records {
    address: u32,
    bytes: usize,
    /// The last that was seen.
    last: Vec<u8>,
    /// Those that the other side has not been told of.
    waiting: VecDeque<Vec<u8>>,
}

impl Records {
    fn of(image: &Image) -> Result<Self, Failure> {
        let (address, bytes) = image.variable(RECORD)?;
        Ok(Self { address, bytes, last: Vec::new(), waiting: VecDeque::new() })
    }

    /// Looks for a new one.
    fn look(&mut self, machine: &Machine) -> Result<(), Failure> {
        let record = machine.memory(self.address, self.bytes)?;
        let whole = record.first().is_some_and(|sequence| sequence.is_multiple_of(2));
        if whole && record != self.last {
            self.last.clone_from(&record);
            self.waiting.push_back(record);
        }
        Ok(())
    }

    /// The oldest that the other side has not been told of, or else the last.
    fn take(&mut self, machine: &Machine) -> Result<Vec<u8>, Failure> {
        self.waiting.pop_front().map_or_else(|| machine.memory(self.address, self.bytes), Ok)
    }
}

/// Serves a program until it ends its side, and watches these tasks.
///
/// # Errors
/// If the pipe breaks, or a message is none. What the image does wrong goes to the other side.
pub fn serve(image: &Image, tasks: &[Task], mut input: impl Read, mut output: impl Write) -> io::Result<()> {
    let start = || Ok((Machine::new(image)?.watching(tasks), Log::new(image)?, Records::of(image)?));
    let (mut machine, mut log, mut records) = match start() {
        Ok(parts) => parts,
        Err(failure) => return refuse(&mut output, &failure),
    };
    loop {
        let [kind] = match bytes(&mut input) {
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(()),
            other => other?,
        };
        match kind {
            b'm' => {
                let [fx, fy, fz, rx, ry, rz] = floats(&mut input)?;
                machine.move_body([fx, fy, fz], [rx, ry, rz]);
            }
            b'b' => {
                let [volts, amperes] = floats(&mut input)?;
                machine.set_battery(volts, amperes);
            }
            b'c' => machine.send_channels(channels(&mut input)?),
            b'f' => {
                let [mishap] = bytes(&mut input)?;
                if let Err(failure) = befall(&mut machine, image, mishap)? {
                    return refuse(&mut output, &failure);
                }
            }
            b'i' => {
                let [part] = bytes(&mut input)?;
                machine.solder(known(&[Inertial::Icm42688, Inertial::Mpu6000], part, "inertial unit")?);
            }
            b's' => machine.slow_down(number(&mut input)?),
            b'z' => output.write_all(&[b'z', machine.sounds().into()])?,
            b'r' => machine.turn_rotors(floats(&mut input)?),
            b'q' => {
                let [motor, telemetry] = bytes(&mut input)?;
                let telemetry =
                    known(&[Telemetry::Silent, Telemetry::Well, Telemetry::Garbled], telemetry, "telemetry")?;
                machine.set_telemetry(known(&[0, 1, 2, 3], motor, "motor")?, telemetry);
            }
            b'p' => {
                let [pressure_pa, temperature_c] = floats(&mut input)?;
                machine.set_air(pressure_pa, temperature_c);
            }
            b'g' => machine.set_field(floats(&mut input)?),
            b'u' => machine.send_fix(&fix(&mut input)?),
            b'v' => machine.send_pose(pose(&mut input)?),
            b'd' => {
                let [part, health] = bytes(&mut input)?;
                let part = known(&[Part::Barometer, Part::Magnetometer], part, "part")?;
                let health = known(&[Health::Silent, Health::Well, Health::HoldsClock], health, "health")?;
                machine.set_health(part, health);
            }
            b't' => {
                let [line, count] = bytes(&mut input)?;
                let line = known(&[Line::Radio, Line::Gnss, Line::Vision], line, "line")?;
                let mut noise = vec![0; count.into()];
                input.read_exact(&mut noise)?;
                machine.send_bytes(line, &noise);
            }
            b'w' => match Machine::with_uptime(image, number(&mut input)?) {
                Ok(begun) => machine = begun.watching(tasks),
                Err(failure) => return refuse(&mut output, &failure),
            },
            b'k' => {
                let (after, [within]) = (number(&mut input)?, bytes(&mut input)?);
                machine.cut_power_at(after, within != 0);
            }
            b'e' | b'o' | b'y' => {
                if let Err(failure) = fill(kind, &mut machine, &mut input)? {
                    return refuse(&mut output, &failure);
                }
            }
            b'j' => machine.set_log_busy(busy(&mut input)?),
            b'l' => {
                let [count] = bytes(&mut input)?;
                machine.hear_station(&many(&mut input, count.into())?);
            }
            b'h' => {
                let told = machine.told_station();
                output.write_all(b"h")?;
                output.write_all(&machine.power_cuts().to_le_bytes())?;
                output.write_all(&(told.len() as u32).to_le_bytes())?;
                output.write_all(&told)?;
            }
            b'a' => match taken(&machine) {
                Ok(answer) => output.write_all(&answer)?,
                Err(failure) => return refuse(&mut output, &failure),
            },
            b'n' => match step(&mut machine, &mut log, &mut records) {
                Ok(answer) => output.write_all(&answer)?,
                Err(failure) => return refuse(&mut output, &failure),
            },
            other => {
                return Err(io::Error::new(ErrorKind::InvalidData, format!("no message begins with {other:#04x}")));
            }
        }
        output.flush()?;
    }
}

/// Fills flash as somebody may have left it, solders a log flash on, or puts a card into its slot, or pulls the one that is there.
fn fill(kind: u8, machine: &mut Machine, input: &mut impl Read) -> io::Result<Result<(), Failure>> {
    let address = if kind == b'e' { number(input)? } else { 0 };
    let count = number(input)?;
    let content = many(input, count as usize)?;
    if kind == b'e' {
        return Ok(machine.fill_flash(address, &content));
    }
    let file = String::from_utf8(content).map_err(io::Error::other)?;
    let file = Path::new(&file);
    Ok(if kind == b'y' { machine.solder_log_flash(file) } else { machine.put_card(Some(file).filter(|_| count > 0)) })
}

fn busy(input: &mut impl Read) -> io::Result<Busy> {
    Ok(Busy { usual_us: number(input)?, long_us: number(input)?, long_every: number(input)? })
}

/// Lets a mishap happen, by its number; the image may be without what that takes.
fn befall(machine: &mut Machine, image: &Image, mishap: u8) -> io::Result<Result<(), Failure>> {
    match mishap {
        0 => machine.derail(),
        1 => machine.hang(true),
        2 => machine.break_data_ready(),
        3 => machine.hang(false),
        4 => return Ok(image.panic().and_then(|function| machine.panic(function))),
        5 => machine.brown_out(),
        6 | 7 => machine.short_inertial_unit(mishap == 7),
        8 => machine.garble_inertial_unit(),
        9 => machine.cut_power(),
        10 => machine.exhaust_stack(),
        11 => return Ok(image.symbol("_defmt_panic").and_then(|function| machine.panic(function))),
        12 => machine.refuse_setup(3),
        13 => machine.lose_conversions(20),
        other => return Err(io::Error::new(ErrorKind::InvalidData, format!("there is no mishap {other}"))),
    }
    Ok(Ok(()))
}

fn refuse(output: &mut impl Write, failure: &Failure) -> io::Result<()> {
    output.write_all(b"x")?;
    text(output, &failure.0)?;
    output.flush()
}

/// Runs one period; returns the answer.
fn step(machine: &mut Machine, log: &mut Log, records: &mut Records) -> Result<Vec<u8>, Failure> {
    let until = match machine.next_sample() {
        Some(sample) => sample + machine.sample_period() - BEFORE_SAMPLE,
        None => boot(machine)?,
    };
    machine.run_until(until.saturating_sub(machine.sample_period() / 2))?;
    records.look(machine)?;
    machine.run_until(until)?;
    records.look(machine)?;
    let (load, motors) = (machine.load(), machine.motors());
    let mut answer = vec![b's'];
    for number in [load.cycles, load.busy, motors.latency_max] {
        answer.extend(number.to_le_bytes());
    }
    for told in motors.told {
        answer.extend(told.unwrap_or(u16::MAX).to_le_bytes());
    }
    answer.extend(motors.protocol.map(|protocol| protocol.map_or(0, |protocol| protocol as u8)));
    for good in motors.good {
        answer.extend(good.to_le_bytes());
    }
    let record = records.take(machine)?;
    answer.extend((record.len() as u32 / 4).to_le_bytes());
    answer.extend(record);
    // Writing to a vector cannot fail.
    let _ = text(&mut answer, &log.lines(machine)?.join("\n"));
    Ok(answer)
}

/// What stack and tasks have taken.
fn taken(machine: &Machine) -> Result<Vec<u8>, Failure> {
    let (bytes, used) = machine.stack()?;
    let tasks = machine.tasks();
    let mut answer = vec![b'a'];
    for number in [bytes, used, tasks.len() as u32] {
        answer.extend(number.to_le_bytes());
    }
    for Task { name, cycles_max, .. } in &tasks {
        // Writing to a vector cannot fail.
        let _ = text(&mut answer, name);
        answer.extend(cycles_max.to_le_bytes());
    }
    Ok(answer)
}

/// Runs until the inertial unit is on; returns the end of the period before its first sample.
fn boot(machine: &mut Machine) -> Result<u64, Failure> {
    let latest = machine.now() + BOOT_MAX;
    while machine.next_sample().is_none() {
        if machine.now() > latest {
            return Err(Failure("the image does not switch its inertial unit on".to_owned()));
        }
        machine.run_until(machine.now() + BEFORE_SAMPLE)?;
    }
    Ok(machine.next_sample().unwrap_or(0) - BEFORE_SAMPLE)
}

fn number(input: &mut impl Read) -> io::Result<u32> {
    bytes(input).map(u32::from_le_bytes)
}

fn many(input: &mut impl Read, count: usize) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; count];
    input.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn bytes<const N: usize>(input: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    input.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn floats<const N: usize>(input: &mut impl Read) -> io::Result<[f32; N]> {
    let mut values = [0.0; N];
    for value in &mut values {
        *value = f32::from_le_bytes(bytes(input)?);
    }
    Ok(values)
}

fn fix(input: &mut impl Read) -> io::Result<Fix> {
    let place_e7 = [i32::from_le_bytes(bytes(input)?), i32::from_le_bytes(bytes(input)?)];
    let values = floats(input)?;
    let [kind, satellites] = bytes(input)?;
    Ok(Fix { place_e7, values, kind, satellites })
}

fn pose(input: &mut impl Read) -> io::Result<VisionPose> {
    let age_us = u32::from_le_bytes(bytes(input)?);
    let (position_m, attitude, [position_sigma_m, attitude_sigma_rad]) =
        (floats(input)?, floats(input)?, floats(input)?);
    Ok(VisionPose { age_us, position_m, attitude, position_sigma_m, attitude_sigma_rad })
}

/// The `place`-th of what there is.
fn known<T: Copy>(all: &[T], place: u8, kind: &str) -> io::Result<T> {
    let found = all.get(usize::from(place)).copied();
    found.ok_or_else(|| io::Error::new(ErrorKind::InvalidData, format!("there is no {kind} {place}")))
}

fn channels(input: &mut impl Read) -> io::Result<[u16; 16]> {
    let bytes: [u8; 32] = bytes(input)?;
    Ok(std::array::from_fn(|n| u16::from_le_bytes([bytes[2 * n], bytes[2 * n + 1]])))
}

fn text(output: &mut impl Write, text: &str) -> io::Result<()> {
    output.write_all(&(text.len() as u32).to_le_bytes())?;
    output.write_all(text.as_bytes())
}
