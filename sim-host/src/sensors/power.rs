//! What the power train tells: motor current, battery voltage and current, and rotor speeds.
//!
//! ```text
//! I = I_hover Σ (F_i / F_hover)^1.5 / 4      V = k (cells · ocv(charge) − R I) + σ n      Ω = √(F / b)
//! ```
//!
//! k is what a battery fault leaves. A rotor's power goes with the 1.5th power of its thrust (momentum theory), and its current with its power. A speed
//! controller tells the period of an electric turn in µs, as nine bits shifted left by up to seven: the grid of the reading.
use super::World;
use super::broken::Broken;
use super::chance::{Chance, register};
use super::keys::{BatteryKeys, SensorKeys};
use super::line::{Line, Timing};
use super::stream;
use crate::fault::sensors::{Sensor, SensorFault};
use crate::vehicle::Vehicle;
use control_core::GRAVITY_M_S2;
use control_core::measurement::Stamped;
use std::f64::consts::TAU;

/// Voltage of a cell at rest over its charge: a lithium-polymer cell's curve, in straight lines.
const CELL: [(f64, f64); 6] = [(0.0, 3.0), (0.05, 3.5), (0.2, 3.7), (0.5, 3.82), (0.8, 4.0), (1.0, 4.2)];
/// Step of a twelve-bit converter behind a divider of eleven, V.
const VOLTAGE_LSB_V: f64 = 3.3 * 11.0 / 4096.0;
/// Largest voltage behind that divider, V.
const VOLTAGE_MAX_V: f64 = 36.3;
/// Step of that converter behind a sensor of 25 A/V, and the largest current there, A.
const CURRENT_LSB_A: f64 = 3.3 * 25.0 / 4096.0;
const CURRENT_MAX_A: f64 = 82.5;
/// Noise of a voltage sample, 1 σ, V.
const VOLTAGE_NOISE_V: f64 = 0.02;
/// Electric turns of a motor a mechanical one: fourteen magnets.
const POLE_PAIRS: f64 = 7.0;
/// Largest mantissa and shift of a period.
const PERIOD: (f64, i32) = (511.0, 7);
/// Noise of an electric period, as a share, 1 σ.
const PERIOD_NOISE: f64 = 2e-3;
/// Highest speed that garbage makes, rad/s.
const SPEED_MAX_RAD_S: f64 = 3000.0;

/// Current of all motors, A.
pub(super) fn current_a(vehicle: &Vehicle, rotor_n: &[f64; 4], hover_a: f64) -> f64 {
    let hover_n = vehicle.mass_kg * f64::from(GRAVITY_M_S2) / 4.0;
    let powers = rotor_n.map(|thrust_n| libm::pow(thrust_n.max(0.0) / hover_n, 1.5));
    hover_a * powers.iter().sum::<f64>() / 4.0
}

/// Voltage of a cell at rest, V.
fn cell_v(charge: f64) -> f64 {
    let above = CELL.iter().position(|&(there, _)| charge <= there).unwrap_or(CELL.len() - 1).max(1);
    let ((c0, v0), (c1, v1)) = (CELL[above - 1], CELL[above]);
    v0 + (v1 - v0) * ((charge - c0) / (c1 - c0)).clamp(0.0, 1.0)
}

/// A battery in flight, and the sensor of its voltage and current.
pub(super) struct BatteryModel {
    keys: BatteryKeys,
    line: Line<[f32; 2]>,
    chance: Chance,
    broken: Broken<[f64; 1]>,
    noise: f64,
    charge: f64,
    dt_s: f64,
}

impl BatteryModel {
    pub(super) fn new(battery: BatteryKeys, keys: &SensorKeys, faults: &[SensorFault], dt_s: f64, seed: u64) -> Self {
        let timing = Timing { rate_hz: 50.0, latency_s: 0.0, jitter_s: 1e-4 };
        let tuned = keys.tuned(timing, |each| each.battery);
        let mut chance = stream(seed, Sensor::Battery, 1);
        Self {
            line: Line::new(tuned.timing, chance.even()),
            broken: Broken::new(faults, Sensor::Battery, 1, seed),
            noise: tuned.noise,
            charge: battery.charge,
            keys: battery,
            chance,
            dt_s,
        }
    }

    /// Voltage, V, and current, A.
    pub(super) fn sample(&mut self, world: &World, current_a: f64) -> Option<Stamped<[f32; 2]>> {
        let BatteryKeys { cells, capacity_ah, resistance_ohm, .. } = self.keys;
        self.charge = (self.charge - current_a * self.dt_s / (3600.0 * capacity_ah)).max(0.0);
        if self.line.is_due(world.t_s) {
            let rest_v = f64::from(cells) * cell_v(self.charge);
            let there_v = world.voltage * (rest_v - resistance_ohm * current_a)
                + VOLTAGE_NOISE_V * self.noise * self.chance.normal();
            let span_v = (0.0, VOLTAGE_MAX_V);
            let [read_v] = self.broken.read(world.t_s, [there_v], |_| span_v);
            let lost = self.broken.is_lost();
            let read_v = register(read_v, VOLTAGE_LSB_V, span_v) as f32;
            let read_a = register(current_a, CURRENT_LSB_A, (0.0, CURRENT_MAX_A)) as f32;
            self.line.send(world.t_s, (!lost).then_some([read_v, read_a]), &mut self.chance);
        }
        self.line.receive(world.t_s)
    }
}

/// Speed that a period of nine bits and a shift stands for, rad/s; none is told of a rotor that hardly turns: 0.
fn told_rad_s(speed_rad_s: f64) -> f64 {
    let period_us = TAU * 1e6 / (POLE_PAIRS * speed_rad_s.max(1e-9));
    let shift = (0..=PERIOD.1).find(|&shift| period_us < (PERIOD.0 + 0.5) * libm::ldexp(1.0, shift));
    shift.map_or(0.0, |shift| {
        let step_us = libm::ldexp(1.0, shift);
        TAU * 1e6 / (POLE_PAIRS * libm::round(period_us / step_us).max(1.0) * step_us)
    })
}

/// Rotor-speed telemetry in flight.
pub(super) struct RotorSpeedModel {
    line: Line<[f32; 4]>,
    chance: Chance,
    broken: Broken<[f64; 4]>,
    noise: f64,
}

impl RotorSpeedModel {
    pub(super) fn new(keys: &SensorKeys, faults: &[SensorFault], control_hz: f64, seed: u64) -> Self {
        // Each command is answered, and the answer of one tick is there at the next.
        let timing = Timing { rate_hz: control_hz, latency_s: 1e-3, jitter_s: 2e-5 };
        let tuned = keys.tuned(timing, |each| each.rotor_speed);
        Self {
            line: Line::new(tuned.timing, 0.0),
            chance: stream(seed, Sensor::RotorSpeed, 1),
            broken: Broken::new(faults, Sensor::RotorSpeed, 1, seed),
            noise: tuned.noise,
        }
    }

    pub(super) fn sample(&mut self, world: &World, vehicle: &Vehicle) -> Option<Stamped<[f32; 4]>> {
        if self.line.is_due(world.t_s) {
            let there = world.rotor_n.map(|thrust_n| {
                let speed_rad_s = libm::sqrt(thrust_n.max(0.0) / vehicle.thrust_coefficient_n_s2);
                speed_rad_s * (1.0 + PERIOD_NOISE * self.noise * self.chance.normal())
            });
            let read = self.broken.read(world.t_s, there, |_| (0.0, SPEED_MAX_RAD_S));
            let lost = self.broken.is_lost();
            let told = read.map(|speed_rad_s| told_rad_s(speed_rad_s) as f32);
            self.line.send(world.t_s, (!lost).then_some(told), &mut self.chance);
        }
        self.line.receive(world.t_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_are_told_as_nine_bits_and_a_shift() {
        // 200 rad/s and seven pole pairs: 4488 µs, in steps of 16.
        let told = told_rad_s(200.0);
        let period_us = TAU * 1e6 / (7.0 * told);
        assert!((period_us / 16.0 - libm::round(period_us / 16.0)).abs() < 1e-6 && (period_us - 4488.0).abs() <= 8.0);
        assert_eq!(told_rad_s(0.0), 0.0);
        assert!(told_rad_s(13.0) == 0.0 && told_rad_s(14.0) > 13.0, "the longest period is 65 ms");
    }

    #[test]
    fn a_cell_falls_with_its_charge() {
        assert_eq!((cell_v(1.0), cell_v(0.0), cell_v(-1.0)), (4.2, 3.0, 3.0));
        assert!((cell_v(0.35) - 3.76).abs() < 1e-12, "{}", cell_v(0.35));
    }
}
