//! A barometer: pressure of the standard atmosphere, with what rotors, wind and weather add to it.
//!
//! ```text
//! p = P(h) + w + p_g 2^(−height/0.25 m) ΣF/(m g) + c ½ ρ |v − v_air|² + σ n,   w a random walk
//! ```
//!
//! h is altitude above the world's origin, where the barometer was switched on; what it reads is P⁻¹ of the register.
use super::World;
use super::broken::Broken;
use super::chance::{Chance, register};
use super::keys::SensorKeys;
use super::line::Line;
use super::parts::{BaroPart, BaroSheet};
use super::stream;
use crate::fault::sensors::{Sensor, SensorFault};
use crate::vehicle::Vehicle;
use control_core::GRAVITY_M_S2;
use control_core::measurement::Stamped;

/// Pressure at sea level in the standard atmosphere, Pa (ISO 2533).
const SEA_LEVEL_PA: f64 = 101_325.0;
/// Lapse rate over the temperature at sea level, 1/m.
const LAPSE_1_M: f64 = 0.0065 / 288.15;
/// g / (R · lapse rate).
const EXPONENT: f64 = 5.255_88;
/// Density at sea level, kg/m³.
const DENSITY_KG_M3: f64 = 1.225;
/// Height over which the pressure under the rotors falls by half, m.
const HALVING_M: f64 = 0.25;

/// Pressure at an altitude in the standard atmosphere, Pa.
pub(crate) fn pressure_pa(altitude_m: f64) -> f64 {
    SEA_LEVEL_PA * libm::pow((1.0 - LAPSE_1_M * altitude_m).max(0.1), EXPONENT)
}

/// Altitude at a pressure in the standard atmosphere, m.
fn altitude_m(pressure_pa: f64) -> f64 {
    (1.0 - libm::pow(pressure_pa / SEA_LEVEL_PA, 1.0 / EXPONENT)) / LAPSE_1_M
}

/// What all barometers of a machine have in common.
pub(super) struct Air {
    pub(super) weight_n: f64,
    pub(super) ground_altitude_m: Option<f64>,
    pub(super) ground_effect_pa: f64,
    pub(super) static_port: f64,
}

impl Air {
    pub(super) fn new(keys: &SensorKeys, vehicle: &Vehicle, ground_altitude_m: Option<f64>) -> Self {
        let weight_n = vehicle.mass_kg * f64::from(GRAVITY_M_S2);
        let SensorKeys { ground_effect_pa, static_port, .. } = *keys;
        Self { weight_n, ground_altitude_m, ground_effect_pa, static_port }
    }

    /// Pressure at the barometer, without its own errors, Pa.
    fn pressure_pa(&self, world: &World) -> f64 {
        let altitude_m = world.truth.altitude_m();
        let air_m_s = world.truth.velocity_m_s - world.gust.velocity_m_s;
        let dynamic_pa = 0.5 * DENSITY_KG_M3 * air_m_s.norm_squared();
        let cushion_pa = self.ground_altitude_m.map_or(0.0, |ground_m| {
            let height_m = (altitude_m - ground_m).max(0.0);
            let thrust_n: f64 = world.truth.thrust_n.iter().sum();
            self.ground_effect_pa * thrust_n / self.weight_n * libm::exp2(-height_m / HALVING_M)
        });
        pressure_pa(altitude_m) + cushion_pa + self.static_port * dynamic_pa
    }
}

/// A barometer in flight.
pub(super) struct BaroModel {
    sheet: BaroSheet,
    line: Line<f32>,
    chance: Chance,
    broken: Broken<[f64; 1]>,
    noise: f64,
    /// Time between samples, s.
    period_s: f64,
    walked_pa: f64,
}

impl BaroModel {
    pub(super) fn new(part: BaroPart, keys: &SensorKeys, faults: &[SensorFault], unit: u8, seed: u64) -> Self {
        let sheet = part.sheet();
        let tuned = keys.tuned(sheet.timing, |each| each.baro);
        let mut chance = stream(seed, Sensor::Baro, unit);
        Self {
            line: Line::new(tuned.timing, chance.even()),
            broken: Broken::new(faults, Sensor::Baro, unit, seed),
            noise: tuned.noise,
            period_s: 1.0 / tuned.timing.rate_hz,
            walked_pa: 0.0,
            chance,
            sheet,
        }
    }

    pub(super) fn sample(&mut self, world: &World, air: &Air) -> Option<Stamped<f32>> {
        if self.line.is_due(world.t_s) {
            let BaroSheet { noise_pa, walk_pa, lsb_pa, span_pa, .. } = self.sheet;
            self.walked_pa += walk_pa * self.noise * libm::sqrt(self.period_s) * self.chance.normal();
            let pressure_pa = air.pressure_pa(world) + self.walked_pa + noise_pa * self.noise * self.chance.normal();
            let read_m = altitude_m(register(pressure_pa, lsb_pa, span_pa));
            let span_m = (altitude_m(span_pa.1), altitude_m(span_pa.0));
            let [read_m] = self.broken.read(world.t_s, [read_m], |_| span_m);
            let read_m = read_m.clamp(span_m.0, span_m.1) as f32;
            let lost = self.broken.is_lost();
            self.line.send(world.t_s, (!lost).then_some(read_m), &mut self.chance);
        }
        self.line.receive(world.t_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_atmosphere_is_the_standard_one() {
        // ISO 2533, table 5: 1000 m and 3000 m.
        assert!((pressure_pa(1000.0) - 89_874.6).abs() < 2.0, "{}", pressure_pa(1000.0));
        assert!((pressure_pa(3000.0) - 70_108.5).abs() < 2.0, "{}", pressure_pa(3000.0));
        for altitude in [-100.0, 0.0, 12.5, 4000.0] {
            assert!((altitude_m(pressure_pa(altitude)) - altitude).abs() < 1e-8);
        }
    }
}
