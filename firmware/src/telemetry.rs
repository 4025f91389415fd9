//! Telemetry: what the station is told of a step, ten times a second, in the records of `flight-link`.
//!
//! ```text
//! roll = atan2(r32, r33)        pitch = asin(−r31)        heading = atan2(r21, r11)        of the attitude's matrix
//! ```
//!
//! Nothing is decided here. Of a load, the sum and the longest of the steps since the last snapshot are told.
use control_core::estimate::{Estimate, Health};
use control_core::flight::Flight;
use control_core::frames::Vec3;
use control_core::math::{asin_and_cos, atan2};
use control_core::modes::Mode;
use control_core::wiring::WiringFault;
use flight_link::{Motion, Rotors, Status, Wiring};

use crate::record::Record;

/// Snapshots a second.
pub const TELEMETRY_HZ: f32 = 10.0;

/// One step as the station is told of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Snapshot {
    /// How the machine is; what its line dropped is for the line to say.
    pub status: Status,
    /// How it moves.
    pub motion: Motion,
    /// What its rotors do.
    pub rotors: Rotors,
}

/// How a step went.
#[derive(Clone, Copy, Debug)]
pub struct Pass {
    /// From data ready to its end, µs.
    pub took_us: u64,
    /// Whether it ended late.
    pub late: bool,
}

/// Takes in steps, and makes a [`Snapshot`] of every few.
#[derive(Clone, Copy, Debug)]
pub struct Telemetry {
    steps_per_snapshot: u32,
    left: u32,
    since_us: u64,
    busy_us: u64,
    longest_us: u64,
    late: u32,
}

impl Telemetry {
    /// Before the first of `rate_hz` steps a second.
    pub fn new(rate_hz: f32) -> Self {
        let steps_per_snapshot = ((rate_hz / TELEMETRY_HZ) as u32).max(1);
        Self { steps_per_snapshot, left: steps_per_snapshot, since_us: 0, busy_us: 0, longest_us: 0, late: 0 }
    }

    /// Takes in the step that `flight` has made last; returns a snapshot if one is due.
    pub fn note(&mut self, step: &Record, flight: &Flight, pass: Pass) -> Option<Snapshot> {
        self.busy_us = self.busy_us.saturating_add(pass.took_us);
        self.longest_us = self.longest_us.max(pass.took_us);
        self.late = self.late.saturating_add(pass.late.into());
        self.left = self.left.saturating_sub(1);
        if self.left > 0 {
            return None;
        }
        let snapshot = Snapshot {
            status: self.status(step, flight),
            motion: motion(flight.estimate(), step),
            rotors: rotors(step, flight),
        };
        (self.left, self.since_us) = (self.steps_per_snapshot, step.time_us);
        (self.busy_us, self.longest_us) = (0, 0);
        Some(snapshot)
    }

    fn status(&self, step: &Record, flight: &Flight) -> Status {
        let helm = flight.helm();
        let decision = helm.decision();
        let elapsed_us = step.time_us.saturating_sub(self.since_us).max(1);
        Status {
            time_us: step.time_us,
            armed: decision.is_some_and(|decision| decision.armed),
            landed: decision.is_some_and(|decision| decision.landed),
            aim: decision.map_or(0, |decision| place(decision.aim)),
            mode: decision.map_or(0, |decision| place(decision.mode)),
            failsafes: decision.map_or(0, |decision| decision.failsafes.bits()),
            failing: decision.map_or(0, |decision| decision.failing.bits()),
            wiring: wiring(helm.state().wiring()),
            bench: helm.state().bench().is_some(),
            battery_v: helm.battery().voltage_v(step.time_us).unwrap_or(f32::NAN),
            battery_a: helm.battery().current_a(step.time_us).unwrap_or(f32::NAN),
            used_as: helm.battery().used_as(),
            steps: step.step,
            late: self.late,
            load: self.busy_us as f32 / elapsed_us as f32,
            step_us_max: self.longest_us.min(u32::MAX.into()) as u32,
            dropped: 0,
        }
    }
}

/// Place of a mode in [`Mode::ALL`].
fn place(mode: Mode) -> u8 {
    Mode::ALL.iter().position(|&known| known == mode).unwrap_or(0) as u8
}

fn wiring(verdict: Option<Result<(), WiringFault>>) -> Wiring {
    let number = |rotor: usize| rotor as u8;
    match verdict {
        None => Wiring::Unknown,
        Some(Ok(())) => Wiring::Right,
        Some(Err(WiringFault::AnswersAs { told, answers })) => {
            Wiring::AnswersAs { told: number(told), answers: number(answers) }
        }
        Some(Err(WiringFault::Reversed { rotor })) => Wiring::Reversed(number(rotor)),
        Some(Err(WiringFault::Silent { rotor })) => Wiring::Silent(number(rotor)),
        Some(Err(WiringFault::Tipping { rotor })) => Wiring::Tipping(number(rotor)),
        Some(Err(WiringFault::BadSample { rotor })) => Wiring::BadSample(number(rotor)),
    }
}

fn motion(estimate: &Estimate, step: &Record) -> Motion {
    let Estimate { position_m, velocity_m_s, attitude, rate_rad_s, health, .. } = *estimate;
    let [[r11, _, _], [r21, _, _], [r31, r32, r33]] = attitude.rows;
    let Health { rates, tilt, heading, altitude, velocity, position } = health;
    let facts = [rates, tilt, heading, altitude, velocity, position];
    Motion {
        time_us: step.time_us,
        attitude_rad: [atan2(r32, r33), asin_and_cos(-r31).0, atan2(r21, r11)],
        rate_rad_s: three(rate_rad_s),
        position_m: three(position_m),
        velocity_m_s: three(velocity_m_s),
        health: facts.iter().rev().fold(0, |bits, &fact| bits << 1 | u8::from(fact)),
    }
}

fn three<F: Copy>(v: Vec3<F>) -> [f32; 3] {
    [v.x, v.y, v.z]
}

fn rotors(step: &Record, flight: &Flight) -> Rotors {
    Rotors { time_us: step.time_us, speeds: step.command.speeds(), believed: flight.helm().state().controller.shares() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight;
    use crate::icm42688::SAMPLE_HZ;
    use control_core::autopilot::BenchOrder;
    use control_core::flight::Arrived;
    use control_core::measurement::{Imu, Measurements, Stamped};
    use control_core::motor_test::MotorTestOrder;
    use control_core::parameters::Parameters;
    use std::vec::Vec;

    /// At rest for `seconds`, with what is asked of the bench in its first step; every snapshot.
    fn rest(seconds: f32, bench: Option<BenchOrder>) -> Vec<Snapshot> {
        let mut flight = flight::boot(&Parameters::default()).unwrap();
        let mut telemetry = Telemetry::new(SAMPLE_HZ);
        let steps = (seconds * SAMPLE_HZ) as u32;
        (1..=steps)
            .filter_map(|step| {
                let time_us = 500 * u64::from(step);
                let noise = (step % 7) as f32 * 1e-3;
                let imu = Imu {
                    rate_rad_s: Vec3::new(noise, -noise, noise),
                    specific_force_m_s2: Vec3::new(noise, noise, -9.81 - noise),
                };
                let arrived = Arrived {
                    measurements: Measurements {
                        imu: Some(Stamped { time_us, value: imu }),
                        battery_v: (step % 200 == 5).then_some(Stamped { time_us, value: 16.2 }),
                        battery_a: (step % 200 == 5).then_some(Stamped { time_us, value: 3.0 }),
                        ..Measurements::default()
                    },
                    bench: bench.filter(|_| step == 1),
                    ..Arrived::default()
                };
                let command = flight.step(time_us, &arrived);
                let record = Record { step, time_us, arrived, command };
                let pass = Pass { took_us: if step % 100 == 3 { 300 } else { 200 }, late: step == 50 };
                telemetry.note(&record, &flight, pass)
            })
            .collect()
    }

    #[test]
    fn ten_snapshots_a_second_say_what_the_steps_since_the_last_took() {
        let snapshots = rest(5.0, None);
        assert_eq!(snapshots.len(), 50);
        for (n, Snapshot { status, motion, rotors }) in (1_u32..).zip(&snapshots) {
            let time_us = 100_000 * u64::from(n);
            assert_eq!([status.time_us, motion.time_us, rotors.time_us], [time_us; 3]);
            assert_eq!((status.steps, status.late, status.step_us_max), (200 * n, 1, 300));
            // 198 steps of 200 µs and two of 300 in 100 ms.
            assert!((status.load - 0.402).abs() < 1e-3, "{}", status.load);
            assert_eq!((status.battery_v, status.battery_a, status.armed), (16.2, 3.0, false));
            assert!((status.used_as - 0.3 * (n - 1) as f32).abs() < 1e-3, "{}", status.used_as);
            assert_eq!(rotors.speeds, [0.0; 4]);
            assert_eq!((rotors.believed, status.wiring), ([1.0; 4], Wiring::Unknown));
        }
        let Motion { attitude_rad: [roll, pitch, _], health, .. } = snapshots[49].motion;
        assert!(roll.abs() < 0.01 && pitch.abs() < 0.01, "{roll} {pitch}");
        assert_eq!(health & 0b11, 0b11, "rates and tilt");
        assert_ne!(snapshots[49].status.failing, 0, "the pilot is not heard");
    }

    #[test]
    fn a_rotor_that_turns_on_the_bench_is_told_and_so_is_its_end() {
        let order = BenchOrder::Motors(MotorTestOrder { rotor: Some(2), share: 0.09, seconds: 0.45 });
        let turning: Vec<_> =
            rest(1.0, Some(order)).iter().map(|snapshot| (snapshot.status.bench, snapshot.rotors.speeds)).collect();
        let [first, .., last] = &turning[..] else { panic!("{turning:?}") };
        assert!(first.0 && (first.1[2] - 0.3).abs() < 1e-6, "the speed is the root of the thrust: {first:?}");
        assert_eq!([first.1[0], first.1[1], first.1[3]], [0.0; 3]);
        assert_eq!(*last, (false, [0.0; 4]));
        assert_eq!(turning.iter().filter(|(bench, _)| *bench).count(), 4);
    }
}
