//! What a builder does before a flight: the machine is turned through poses by hand, then held down while its motors run up.
//!
//! The procedure is the core's own ([`Poses`], [`MotorRun`]), and sees the compass and the accelerometer of the flight as anybody would: by their readings, with
//! their noise and registers, some time before. What it leaves is what such a procedure leaves; the truth is nowhere copied.
//!
//! | step   | what                                                                                       |
//! |--------|--------------------------------------------------------------------------------------------|
//! | poses  | each of six faces down, in eight headings, off by what a hand is off; a second of rest each |
//! | motors | loads from nothing to a half, two seconds each                                             |
//! | pause  | [`PAUSE_S`] until it is switched on for the flight, over which offsets wander              |
use super::World;
use super::chance::Chance;
use super::field::MagModel;
use super::imu::{ImuModel, Setup};
use super::keys::SensorKeys;
use super::power::current_a;
use super::suite::Carrier;
use crate::actuators::Vibration;
use crate::flight::{Stream, random_of};
use crate::plant::Truth;
use crate::wind::Gust;
use control_core::GRAVITY_M_S2;
use control_core::compass::{Compass, MotorRun, Poses, PosesFound, Refusal, load};
use control_core::frames::{Body, Vec3};
use control_core::measurement::Measurements;
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// From the calibration to the flight, s.
const PAUSE_S: f64 = 600.0;
/// Faces that are turned down, as turns of a level machine.
const FACES: [[f64; 3]; 6] = [
    [0.0; 3],
    [PI, 0.0, 0.0],
    [FRAC_PI_2, 0.0, 0.0],
    [-FRAC_PI_2, 0.0, 0.0],
    [0.0, FRAC_PI_2, 0.0],
    [0.0, -FRAC_PI_2, 0.0],
];
const HEADINGS: usize = 8;
/// What a hand is off by, each axis, 1 σ, rad.
const HAND_RAD: f64 = 0.25;
/// A pose: how long it takes to come to rest, and to the next, s.
const SETTLED_S: f64 = 0.2;
const POSE_S: f64 = 1.2;
/// Steps of the motors' run: how many, how long, s, and to which share of their thrust.
const RUNS: usize = 8;
const RUN_S: f64 = 2.0;
const RUN_SHARE: f64 = 0.6;
/// Looks at the compass a second while the motors run.
const RUN_HZ: f64 = 100.0;

/// What is known of the sensors of one machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Of the compass.
    pub compass: Compass,
    /// What the first accelerometer reads too much, m/s².
    pub accelerometer_m_s2: Vec3<Body>,
    /// What the poses have said, if they were looked at.
    pub poses: Option<PosesFound>,
}

impl Calibration {
    /// Nothing is known.
    pub const NONE: Self = Self { compass: Compass::AS_BUILT, accelerometer_m_s2: Vec3::zero(), poses: None };

    /// What is found of the sensors that fly. Nothing, if the scenario has none calibrated, or none to calibrate.
    ///
    /// # Errors
    /// [`Refusal`] of the core's procedure.
    pub fn learn(keys: &SensorKeys, carrier: &Carrier) -> Result<Self, Refusal> {
        let (true, Some(mag), Some(imu)) = (keys.calibrated, keys.mag, keys.imu) else { return Ok(Self::NONE) };
        let Carrier { control_hz, seed, .. } = *carrier;
        let another = |index| Chance(random_of(seed, Stream::Calibration, index));
        let mut mag = MagModel::new(mag, keys, &[], seed).at_another_time(PAUSE_S, another(0));
        let setup = Setup { keys, faults: &[], control_hz, index: 1, seed };
        let mut imu = ImuModel::new(imu, &setup).at_another_time(PAUSE_S, [another(1), another(2)]);
        let poses = turn(&mut mag, &mut imu, control_hz, &mut another(3)).solve(keys.earth.field_ut as f32)?;
        let motors = run_up(&mut mag, keys, carrier).solve()?;
        Ok(Self {
            compass: Compass { motors_ut: motors.motors_ut, ..poses.compass },
            accelerometer_m_s2: poses.accelerometer_m_s2,
            poses: Some(poses),
        })
    }

    /// Takes what is known of the compass off its sample, if there is one.
    ///
    /// - `load`: of the motors, as [`load`] has it.
    pub fn correct(&self, measurements: &mut Measurements, load: f32) {
        if let Some(field) = &mut measurements.magnetic_ut {
            field.value = self.compass.correct(field.value, load);
        }
    }
}

/// A machine that is held, rotors at rest.
fn held(attitude: Matrix3<f64>) -> Truth {
    Truth {
        position_m: Vector3::zeros(),
        velocity_m_s: Vector3::zeros(),
        attitude,
        rate_rad_s: Vector3::zeros(),
        specific_force_m_s2: attitude.transpose() * Vector3::z() * -f64::from(GRAVITY_M_S2),
        thrust_n: [0.0; 4],
        impact_m_s: 0.0,
        touching: false,
    }
}

/// What is felt of `truth` in still air.
fn world<'a>(t_s: f64, truth: &'a Truth, rotor_n: &'a [f64; 4]) -> World<'a> {
    static CALM: Gust = Gust::CALM;
    static SMOOTH: Vibration = Vibration::NONE;
    World { t_s, truth, vibration: &SMOOTH, rotor_n, gust: &CALM, voltage: 1.0 }
}

/// Turns the machine through the poses.
fn turn(mag: &mut MagModel, imu: &mut ImuModel, control_hz: f64, hand: &mut Chance) -> Poses {
    let (mut poses, mut t_s) = (Poses::default(), 0.0);
    for face in FACES {
        for heading in 0..HEADINGS {
            let about_down = Rotation3::from_scaled_axis(Vector3::z() * (TAU * heading as f64 / HEADINGS as f64));
            let off = Rotation3::from_scaled_axis(hand.normals() * HAND_RAD);
            let truth = held((about_down * Rotation3::from_scaled_axis(Vector3::from(face)) * off).into_inner());
            for tick in 0..(POSE_S * control_hz) as usize {
                let world = world(t_s, &truth, &[0.0; 4]);
                let force = imu.sample(&world, &[Vector3::zeros(); 2]);
                let field = mag.sample(&world, 0.0);
                if let (Some(field), Some(force), true) = (field, force, tick as f64 > SETTLED_S * control_hz) {
                    poses.note(field.value, force.value.specific_force_m_s2);
                }
                t_s += 1.0 / control_hz;
            }
        }
    }
    poses
}

/// Holds the machine down and runs its motors up.
fn run_up(mag: &mut MagModel, keys: &SensorKeys, carrier: &Carrier) -> MotorRun {
    let truth = held(Matrix3::identity());
    let mut run = MotorRun::default();
    // Long after the poses, so that nothing of them is still under way.
    let began_s = PAUSE_S;
    for step in 0..RUNS {
        let share = RUN_SHARE * step as f64 / (RUNS - 1) as f64;
        let rotor_n = [share * carrier.vehicle.thrust_n_max(); 4];
        let current_a = current_a(carrier.vehicle, &rotor_n, keys.hover_a);
        for tick in 0..(RUN_S * RUN_HZ) as usize {
            let t_s = began_s + step as f64 * RUN_S + tick as f64 / RUN_HZ;
            let field = mag.sample(&world(t_s, &truth, &rotor_n), current_a);
            if let (Some(field), true) = (field, tick as f64 > SETTLED_S * RUN_HZ) {
                run.note(field.value, load(&[share as f32; 4]));
            }
        }
    }
    run
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensors::{EarthKeys, ImuPart, MagPart};
    use crate::vehicle::{AirframeName, Vehicle, VehicleKeys};

    /// How wrong the heading of a level machine in a hover is right after the pause, rms over a turn, rad.
    fn heading_error_rad(keys: &SensorKeys, carrier: &Carrier, calibration: &Calibration) -> f64 {
        let mut mag = MagModel::new(keys.mag.unwrap(), keys, &[], carrier.seed);
        let hover_n = [carrier.vehicle.mass_kg * f64::from(GRAVITY_M_S2) / 4.0; 4];
        let hover_load = load(&hover_n.map(|n| (n / carrier.vehicle.thrust_n_max()) as f32));
        let mut squares = 0.0;
        for heading in 0..16 {
            let turned = Rotation3::from_scaled_axis(Vector3::z() * (TAU * f64::from(heading) / 16.0));
            let truth = held(turned.into_inner());
            let mut sum = Vector3::zeros();
            for tick in 0..200 {
                let t_s = f64::from(heading) * 4.0 + f64::from(tick) * 0.02;
                if let Some(field) = mag.sample(&world(t_s, &truth, &hover_n), keys.hover_a)
                    && tick > 5
                {
                    let v = calibration.compass.correct(field.value, hover_load);
                    sum += turned * Vector3::from([v.x, v.y, v.z].map(f64::from));
                }
            }
            squares += libm::atan2(sum.y, sum.x).powi(2);
        }
        libm::sqrt(squares / 16.0)
    }

    /// `cargo test --release -p sim-host --lib calibrated_compass -- --nocapture` prints the figures of docs/sensors.md.
    #[test]
    fn a_calibrated_compass_errs_by_half_a_degree_where_it_erred_by_tens() {
        let vehicle = Vehicle::new(AirframeName::Paper, &VehicleKeys::default());
        let keys = SensorKeys { imu: Some(ImuPart::Icm42688p), mag: Some(MagPart::Ist8310), ..SensorKeys::default() };
        let errors = (1..=40).map(|seed| {
            let carrier = Carrier { vehicle: &vehicle, ground_altitude_m: None, control_hz: 500.0, seed };
            let known = Calibration::learn(&keys, &carrier).expect("it was turned well");
            [Calibration::NONE, known].map(|known| heading_error_rad(&keys, &carrier, &known).to_degrees())
        });
        let (mut built, mut known): (Vec<f64>, Vec<f64>) = errors.map(|[built, known]| (built, known)).unzip();
        for found in [&mut built, &mut known] {
            found.sort_by(f64::total_cmp);
        }
        for (what, found) in [("as built", &built), ("calibrated", &known)] {
            println!("{what}: heading off by {:.2} degrees in the median, {:.2} at worst", found[20], found[39]);
        }
        assert!(built[20] > 10.0 && known[20] < 0.5 && known[39] < 1.2, "{built:?} {known:?}");
    }

    #[test]
    fn a_compass_that_is_not_calibrated_is_left_as_it_is() {
        let vehicle = Vehicle::new(AirframeName::Paper, &VehicleKeys::default());
        let carrier = Carrier { vehicle: &vehicle, ground_altitude_m: None, control_hz: 500.0, seed: 1 };
        let all = SensorKeys { imu: Some(ImuPart::Icm42688p), mag: Some(MagPart::Ist8310), ..SensorKeys::default() };
        for keys in [
            SensorKeys { calibrated: false, ..all.clone() },
            SensorKeys { mag: None, ..all.clone() },
            SensorKeys { imu: None, ..all.clone() },
        ] {
            assert_eq!(Calibration::learn(&keys, &carrier), Ok(Calibration::NONE));
        }
        let level = EarthKeys { inclination_rad: 0.05, ..all.earth };
        let refused = Calibration::learn(&SensorKeys { earth: level, ..all }, &carrier);
        assert!(matches!(refused, Err(Refusal::TooLevel { .. })), "{refused:?}");
    }
}
