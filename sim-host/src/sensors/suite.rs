//! All sensors of a flight.
use super::World;
use super::air::{Air, BaroModel};
use super::chance::Chance;
use super::down::{FlowModel, RangeModel, distance_m};
use super::field::MagModel;
use super::gnss::GnssModel;
use super::imu::{ImuModel, Setup, Shake};
use super::keys::SensorKeys;
use super::power::{BatteryModel, RotorSpeedModel, current_a};
use super::vision::VisionModel;
use crate::fault::sensors::SensorFault;
use crate::flight::{Stream, random_of};
use crate::vehicle::Vehicle;
use control_core::measurement::{Measurements, Stamped};
use nalgebra::Vector3;

/// Stream of what all sensors of the machine have in common, apart from those of the sensors.
const COMMON: u8 = u8::MAX;

/// What a suite is made for.
#[derive(Clone, Copy)]
pub struct Carrier<'a> {
    /// The machine.
    pub vehicle: &'a Vehicle,
    /// Altitude of the ground, m; none for a flight in empty space.
    pub ground_altitude_m: Option<f64>,
    /// Ticks a second.
    pub control_hz: f64,
    /// Seed of the flight.
    pub seed: u64,
}

/// The sensors of one flight, their errors and their faults.
pub struct SensorSuite {
    vehicle: Vehicle,
    ground_altitude_m: Option<f64>,
    hover_a: f64,
    shake: Shake,
    imus: [Option<ImuModel>; 2],
    air: Air,
    baros: [Option<BaroModel>; 2],
    mag: Option<MagModel>,
    gnss: Option<GnssModel>,
    range: Option<RangeModel>,
    flow: Option<FlowModel>,
    vision: Option<VisionModel>,
    rotor_speed: Option<RotorSpeedModel>,
    battery: Option<BatteryModel>,
}

impl SensorSuite {
    /// The sensors that `keys` name, with `faults`. Each draws from a stream of its own, and so does each fault: one more
    /// leaves the others as they were.
    pub fn new(keys: &SensorKeys, faults: &[SensorFault], carrier: &Carrier) -> Self {
        let Carrier { vehicle, ground_altitude_m, control_hz, seed } = *carrier;
        let dt_s = 1.0 / control_hz;
        let imu = |index: u8| {
            let part = keys.imu.filter(|_| index <= keys.imus)?;
            Some(ImuModel::new(part, &Setup { keys, faults, control_hz, index, seed }))
        };
        let baro = |unit: u8| {
            let part = keys.baro.filter(|_| unit <= keys.baros)?;
            Some(BaroModel::new(part, keys, faults, unit, seed))
        };
        let mut common = Chance(random_of(seed, Stream::Sensor, COMMON));
        Self {
            hover_a: keys.hover_a,
            shake: Shake::new(keys.rotor_unbalance_kg_m, dt_s, &mut common),
            imus: [imu(1), imu(2)],
            air: Air::new(keys, vehicle, ground_altitude_m),
            baros: [baro(1), baro(2)],
            mag: keys.mag.map(|part| MagModel::new(part, keys, faults, seed)),
            gnss: keys.gnss.map(|part| GnssModel::new(part, keys, faults, seed)),
            range: keys.range.map(|part| RangeModel::new(part, keys, faults, seed)),
            flow: keys.flow.map(|part| FlowModel::new(part, keys, faults, dt_s, seed)),
            vision: keys.vision.map(|part| VisionModel::new(part, keys, faults, seed)),
            rotor_speed: keys.rotor_speed.map(|_| RotorSpeedModel::new(keys, faults, control_hz, seed)),
            battery: keys.battery.map(|battery| BatteryModel::new(battery, keys, faults, dt_s, seed)),
            vehicle: vehicle.clone(),
            ground_altitude_m,
        }
    }

    /// What the first inertial unit reads beyond the truth for a second and longer, vibration and faults apart, body axes: of the
    /// gyro, rad/s, and of the accelerometer, m/s². Bias, and what errors of scale make of a steady motion.
    pub fn inertial_errors(&self) -> Option<[Vector3<f64>; 2]> {
        self.imus[0].as_ref().map(ImuModel::steady_errors)
    }

    /// What has arrived by this tick; to be called once each tick, in order.
    pub fn sample(&mut self, world: &World) -> Measurements {
        let shaken = self.shake.step(&self.vehicle, world.rotor_n);
        let current_a = current_a(&self.vehicle, world.rotor_n, self.hover_a);
        let distance_m = distance_m(world, self.ground_altitude_m);
        let [imu, imu_second] = self.imus.each_mut().map(|imu| imu.as_mut()?.sample(world, &shaken));
        let air = &self.air;
        let [baro, baro_second] = self.baros.each_mut().map(|baro| baro.as_mut()?.sample(world, air));
        let battery = self.battery.as_mut().and_then(|battery| battery.sample(world, current_a));
        let of_battery = |n: usize| battery.map(|at| Stamped { time_us: at.time_us, value: at.value[n] });
        Measurements {
            imu,
            imu_second,
            baro_altitude_m: baro,
            baro_second_altitude_m: baro_second,
            magnetic_ut: self.mag.as_mut().and_then(|mag| mag.sample(world, current_a)),
            gnss: self.gnss.as_mut().and_then(|gnss| gnss.sample(world)),
            range_m: self.range.as_mut().and_then(|range| range.sample(world, distance_m)),
            flow: self.flow.as_mut().and_then(|flow| flow.sample(world, distance_m)),
            vision: self.vision.as_mut().and_then(|vision| vision.sample(world)),
            rotor_rad_s: self.rotor_speed.as_mut().and_then(|rotors| rotors.sample(world, &self.vehicle)),
            battery_v: of_battery(0),
            battery_a: of_battery(1),
        }
    }
}
