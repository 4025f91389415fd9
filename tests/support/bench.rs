//! A bench for sensors: moves them about, and keeps what they say.
use control_core::measurement::{Measurements, Stamped};
use nalgebra::{Matrix3, Vector3};
use sim_host::actuators::Vibration;
use sim_host::fault::sensors::SensorFault;
use sim_host::plant::Truth;
use sim_host::sensors::{
    BaroPart, BatteryKeys, Carrier, FlowPart, GnssPart, ImuPart, MagPart, RangePart, RotorSpeedPart, SensorKeys,
    SensorSuite, VisionPart, World,
};
use sim_host::vehicle::{AirframeName, Vehicle, VehicleKeys};
use sim_host::wind::Gust;

/// Ticks a second.
pub const HZ: f64 = 500.0;
/// Gravity, m/s².
pub const G: f64 = 9.81;

/// Every part there is.
pub fn all() -> SensorKeys {
    SensorKeys {
        imu: Some(ImuPart::Icm42688p),
        baro: Some(BaroPart::Bmp388),
        mag: Some(MagPart::Ist8310),
        gnss: Some(GnssPart::M10),
        range: Some(RangePart::Vl53l1x),
        flow: Some(FlowPart::Pmw3901),
        vision: Some(VisionPart::Mocap),
        rotor_speed: Some(RotorSpeedPart::Dshot),
        battery: Some(BatteryKeys::default()),
        ..SensorKeys::default()
    }
}

/// A satellite receiver alone.
pub fn receiver() -> SensorKeys {
    SensorKeys { gnss: Some(GnssPart::M10), ..SensorKeys::default() }
}

/// Level and still, 2 m above the origin.
pub fn still() -> Truth {
    Truth {
        position_m: Vector3::new(0.0, 0.0, -2.0),
        velocity_m_s: Vector3::zeros(),
        attitude: Matrix3::identity(),
        rate_rad_s: Vector3::zeros(),
        specific_force_m_s2: Vector3::new(0.0, 0.0, -G),
        thrust_n: [0.0; 4],
        impact_m_s: 0.0,
        touching: false,
    }
}

/// Moves north, east and up at once, without turning.
pub fn moving(t_s: f64) -> Truth {
    let velocity_m_s = Vector3::new(2.0, -1.0, -0.1);
    Truth { position_m: Vector3::new(0.0, 0.0, -1.0) + velocity_m_s * t_s, velocity_m_s, ..still() }
}

/// The machine that carries the sensors.
pub fn vehicle() -> Vehicle {
    Vehicle::new(AirframeName::Os4, &VehicleKeys::default())
}

/// What a bench does to the sensors.
pub struct Bench<'a> {
    /// What is on it.
    pub keys: SensorKeys,
    /// What is broken.
    pub faults: &'a [SensorFault],
    /// Seed of the sensors.
    pub seed: u64,
    /// What the rotors' speeds make in thrust, N.
    pub rotor_n: [f64; 4],
    /// What damaged propellers shake, over time.
    pub vibration: &'a dyn Fn(f64) -> Vibration,
    /// How it moves, over time.
    pub truth: &'a dyn Fn(f64) -> Truth,
}

impl Default for Bench<'_> {
    fn default() -> Self {
        let (vibration, truth) = (&|_: f64| Vibration::default(), &|_: f64| still());
        Bench { keys: all(), faults: &[], seed: 1, rotor_n: [0.0; 4], vibration, truth }
    }
}

impl Bench<'_> {
    /// Runs for `duration_s` above ground at altitude 0; `see` gets the time of each tick and what arrived.
    pub fn run(&self, duration_s: f64, mut see: impl FnMut(f64, &Measurements)) {
        let vehicle = vehicle();
        let carrier = Carrier { vehicle: &vehicle, ground_altitude_m: Some(0.0), control_hz: HZ, seed: self.seed };
        let mut suite = SensorSuite::new(&self.keys, self.faults, &carrier);
        for tick in 0..(duration_s * HZ) as u32 {
            let t_s = f64::from(tick) / HZ;
            let (truth, vibration) = ((self.truth)(t_s), (self.vibration)(t_s));
            let world = World {
                t_s,
                truth: &truth,
                vibration: &vibration,
                rotor_n: &self.rotor_n,
                gust: &Gust::default(),
                voltage: 1.0,
            };
            see(t_s, &suite.sample(&world));
        }
    }

    /// What `pick` picks of all that arrives, with its time of arrival.
    pub fn take<T>(&self, duration_s: f64, pick: impl Fn(&Measurements) -> Option<T>) -> Vec<(f64, T)> {
        let mut taken = Vec::new();
        self.run(duration_s, |t_s, m| taken.extend(pick(m).map(|x| (t_s, x))));
        taken
    }
}

/// The time stamp, s.
pub fn at_s<T>(sample: &Stamped<T>) -> f64 {
    sample.time_us as f64 * 1e-6
}

/// The mean.
pub fn mean(x: &[f64]) -> f64 {
    x.iter().sum::<f64>() / x.len() as f64
}

/// The standard deviation.
pub fn deviation(x: &[f64]) -> f64 {
    let middle = mean(x);
    mean(&x.iter().map(|x| (x - middle) * (x - middle)).collect::<Vec<_>>()).sqrt()
}

/// What a bench reads of the inertial unit: three axes of the gyro, then three of the accelerometer.
///
/// # Panics
/// If there is no sample at some tick.
pub fn inertial(bench: &Bench, duration_s: f64) -> [Vec<f64>; 6] {
    let mut axes: [Vec<f64>; 6] = Default::default();
    bench.run(duration_s, |_, m| {
        let imu = m.imu.expect("a sample each tick").value;
        let (w, a) = (imu.rate_rad_s, imu.specific_force_m_s2);
        for (axis, x) in axes.iter_mut().zip([w.x, w.y, w.z, a.x, a.y, a.z]) {
            axis.push(f64::from(x));
        }
    });
    axes
}
