//! A machine on the ground with the autopilot and a pilot at hand, fed the true motion: what the flight logic is flown on.
use control_core::autopilot::{Autopilot, AutopilotState, Command, Step, System};
use control_core::estimate::{Estimate, Health, Sigma};
use control_core::frames::{Attitude, Vec3};
use control_core::measurement::Stamped;
use control_core::modes::Mode;
use control_core::parameters::Parameters;
use control_core::pilot::{PilotInput, Sticks};
use control_core::{Config, Input, Setpoint};
use sim_host::actuators::Drive;
use sim_host::ground::Ground;
use sim_host::plant::{Actuation, Plant, RigidPlant, Truth};
use sim_host::vehicle::{AirframeName, Vehicle, VehicleKeys};
use sim_host::wind::Gust;

/// Everything healthy.
pub const HEALTHY: Health =
    Health { rates: true, tilt: true, heading: true, altitude: true, velocity: true, position: true };
/// Control period, s.
pub const DT_S: f64 = 0.002;
/// The same, µs.
const DT_US: u64 = 2000;

/// What may be done to an estimate before the autopilot sees it.
type Spoil = fn(&mut Estimate);

/// The machine, its world and its pilot.
pub struct Rig {
    /// The autopilot.
    pub autopilot: Autopilot,
    /// Its state.
    pub state: AutopilotState,
    /// The machine's limits.
    pub vehicle: Vehicle,
    /// What the pilot does.
    pub pilot: PilotInput,
    /// Whether the pilot is heard.
    pub link: bool,
    /// A setpoint from outside.
    pub offboard: Option<Setpoint>,
    /// What the system says of itself.
    pub system: System,
    /// What the estimate says of itself.
    pub health: Health,
    /// What is done to it.
    pub spoil: Spoil,
    /// Share of its thrust that each rotor makes.
    pub shares: [f64; 4],
    /// Wind, NED, m/s.
    pub wind_m_s: [f64; 2],
    /// The last command.
    pub command: Option<Command>,
    /// Now, µs.
    pub now_us: u64,
    frame: Option<Stamped<PilotInput>>,
    setpoint: Option<Stamped<Setpoint>>,
    plant: RigidPlant,
    actuation: Actuation,
    noise: u32,
}

impl Rig {
    /// Parameters of a take-off to a height from which nothing comes down at once.
    pub const HIGH: [(&str, f32); 2] = [("TKO_HEIGHT", 10.0), ("TKO_SPEED", 4.0)];

    /// On the ground, disarmed, with these parameters.
    ///
    /// # Panics
    /// If a parameter is refused.
    pub fn with(parameters: &[(&str, f32)]) -> Self {
        let mut values = Parameters::default();
        for (name, value) in parameters {
            values.set(name, *value).unwrap_or_else(|error| panic!("{error}"));
        }
        let keys = VehicleKeys { linear_drag_n_s_m: 0.1, ..VehicleKeys::default() };
        let vehicle = Vehicle::new(AirframeName::Paper, &keys);
        let autopilot = Autopilot::try_new(&Config::tolerant(vehicle.airframe()), &values).expect("shipped gains");
        let ground = Ground { altitude_m: Some(0.0) };
        let drive = Drive { command_n: 0.0, lag_s: keys.motor_lag_s, rate_n_s_max: f64::INFINITY, share: 1.0 };
        Self {
            state: autopilot.state(),
            autopilot,
            plant: RigidPlant::standing(&vehicle, ground, ground.standing_m().expect("there is ground")),
            vehicle,
            pilot: PilotInput { sticks: Sticks { throttle: 0.0, ..Sticks::NEUTRAL }, arm: false, mode: Mode::Angle },
            link: true,
            offboard: None,
            system: System::GOOD,
            health: HEALTHY,
            spoil: |_| {},
            shares: [1.0; 4],
            wind_m_s: [0.0; 2],
            command: None,
            now_us: 1_000_000,
            frame: None,
            setpoint: None,
            actuation: Actuation { drives: [drive; 4], gust: Gust::default() },
            noise: 1,
        }
    }

    /// The same with the parameters as shipped.
    pub fn new() -> Self {
        Self::with(&[])
    }

    /// In the air: taken off by itself, then in `mode` with the throttle in its middle.
    ///
    /// # Panics
    /// If it does not get there.
    pub fn hovering(mode: Mode, parameters: &[(&str, f32)]) -> Self {
        let mut rig = Self::with(parameters);
        rig.take_off();
        rig.pilot.mode = mode;
        rig.fly(2.0);
        assert_eq!(rig.mode(), mode);
        rig
    }

    /// In the air at 10 m, 4 m from home, in `mode`, with a battery, a fence at 15 m, and a setpoint from outside where it hovers.
    ///
    /// # Panics
    /// If it does not get there.
    pub fn away(mode: Mode) -> Self {
        let [height, speed] = Self::HIGH;
        let mut rig = Self::with(&[height, speed, ("BAT_CELLS", 4.0), ("FENCE_RADIUS", 15.0)]);
        rig.system.battery_v = Some(16.0);
        rig.take_off();
        rig.pilot.sticks.forward = 1.0;
        rig.fly(1.6);
        rig.pilot.sticks = Sticks::NEUTRAL;
        rig.fly(4.0);
        let position_m = Vec3::new(4.0, 0.0, -10.0);
        rig.offboard = Some(Setpoint { position_m, ..Input::hovering().setpoint });
        rig.pilot.mode = mode;
        rig.fly(2.0);
        assert_eq!(rig.mode(), mode);
        rig
    }

    /// Comes down within `seconds`, upright and gently, and stands with its rotors stopped.
    ///
    /// # Panics
    /// If it does not.
    pub fn lands(&mut self, seconds: f64) {
        self.until(seconds, |_, command| !command.armed);
        self.fly(1.0);
        let truth = self.truth();
        assert!(truth.touching && truth.tilt_rad() < 0.1 && truth.impact_m_s < 0.8, "{truth:?}");
        assert_eq!(self.command().motors, [0.0; 4]);
    }

    /// Speed over ground, m/s.
    pub fn speed_m_s(&self) -> f64 {
        let velocity = self.truth().velocity_m_s;
        velocity.x.hypot(velocity.y)
    }

    /// Arms in take-off, and waits until it hovers.
    ///
    /// # Panics
    /// If it does not get there.
    pub fn take_off(&mut self) {
        self.pilot.mode = Mode::TakeOff;
        self.pilot.sticks = Sticks::NEUTRAL;
        self.fly(1.5);
        self.pilot.arm = true;
        self.fly(8.0);
        assert_eq!(self.mode(), Mode::PositionHold, "{:?}", self.command);
    }

    /// The truth now.
    pub fn truth(&self) -> Truth {
        self.plant.truth(&self.actuation)
    }

    /// The last command.
    ///
    /// # Panics
    /// Before the first.
    pub fn command(&self) -> &Command {
        self.command.as_ref().expect("flown")
    }

    /// The mode flown.
    pub fn mode(&self) -> Mode {
        self.command().mode
    }

    /// Flies on.
    pub fn fly(&mut self, seconds: f64) {
        self.watch(seconds, &mut |_, _| {});
    }

    /// Flies on until `done`, for `seconds` at most; returns how long it took.
    ///
    /// # Panics
    /// If it is not done by then.
    pub fn until(&mut self, seconds: f64, done: impl Fn(&Truth, &Command) -> bool) -> f64 {
        for tick in 0..(seconds / DT_S).round() as usize {
            let command = self.tick();
            if done(&self.truth(), &command) {
                return tick as f64 * DT_S;
            }
        }
        panic!("not within {seconds} s: {:?}, {:?}", self.command, self.truth());
    }

    /// Flies on; `each` sees every tick.
    pub fn watch(&mut self, seconds: f64, each: &mut dyn FnMut(&Truth, &Command)) {
        for _ in 0..(seconds / DT_S).round() as usize {
            let command = self.tick();
            each(&self.truth(), &command);
        }
    }

    /// White noise of unit variance, nearly: the same in every run.
    fn draw(&mut self) -> f32 {
        let mut sum = 0.0;
        for _ in 0..12 {
            for shift in [13, -17, 5] {
                self.noise ^= if shift > 0 { self.noise << shift } else { self.noise >> -shift };
            }
            sum += (self.noise >> 8) as f32 / (1 << 24) as f32;
        }
        sum - 6.0
    }

    fn estimate(&mut self) -> Estimate {
        let truth = self.truth();
        let v = |x: f64, noise: f32| x as f32 + noise;
        let mut noisy = |x: [f64; 3], sigma: f32| x.map(|x| v(x, sigma * self.draw()));
        let [p, q, r] = noisy(truth.rate_rad_s.into(), 0.01);
        let [fx, fy, fz] = noisy(truth.specific_force_m_s2.into(), 0.2);
        let [x, y, z] = noisy(truth.position_m.into(), 0.005);
        let [vx, vy, vz] = noisy(truth.velocity_m_s.into(), 0.02);
        let row = |i| [0, 1, 2].map(|j| truth.attitude[(i, j)] as f32);
        let mut estimate = Estimate {
            time_us: self.now_us,
            position_m: Vec3::new(x, y, z),
            velocity_m_s: Vec3::new(vx, vy, vz),
            attitude: Attitude { rows: [row(0), row(1), row(2)] },
            rate_rad_s: Vec3::new(p, q, r),
            specific_force_m_s2: Vec3::new(fx, fy, fz),
            gyro_bias_rad_s: Vec3::zero(),
            accelerometer_bias_m_s2: Vec3::zero(),
            sigma: Sigma::default(),
            health: self.health,
        };
        (self.spoil)(&mut estimate);
        estimate
    }

    fn tick(&mut self) -> Command {
        self.now_us += DT_US;
        if self.link {
            self.frame = Some(Stamped { time_us: self.now_us, value: self.pilot });
        }
        if let Some(value) = self.offboard {
            self.setpoint = Some(Stamped { time_us: self.now_us, value });
        }
        let estimate = self.estimate();
        let command = self.autopilot.step(
            &mut self.state,
            &Step {
                now_us: self.now_us,
                dt_s: DT_S as f32,
                estimate: &estimate,
                pilot: self.frame.as_ref(),
                offboard: self.setpoint.as_ref(),
                system: &self.system,
            },
        );
        assert!(command.motors.iter().all(|motor| (0.0..=1.0).contains(motor)), "{command:?}");
        for ((drive, motor), share) in self.actuation.drives.iter_mut().zip(command.motors).zip(self.shares) {
            drive.command_n = f64::from(motor) * self.vehicle.thrust_n_max();
            drive.share = share;
        }
        let [north, east] = self.wind_m_s;
        (self.actuation.gust.velocity_m_s.x, self.actuation.gust.velocity_m_s.y) = (north, east);
        self.plant.advance(&self.actuation, DT_S, 2);
        self.command = Some(command);
        command
    }
}

impl Default for Rig {
    fn default() -> Self {
        Self::new()
    }
}
