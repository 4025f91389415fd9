//! A program that is stopped in the air and started again, with what was kept: native, on a machine whose sensors are its true motion and
//! noise.
use control_core::Config;
use control_core::autopilot;
use control_core::estimation::EstimatorConfig;
use control_core::flight::{Arrived, Command, Flight, FlightConfig};
use control_core::frames::{Attitude, Vec3};
use control_core::measurement::{Imu, Measurements, Stamped, Vision};
use control_core::modes::Mode;
use control_core::parameters::Parameters;
use control_core::pilot::{PilotInput, Sticks};
use control_core::restart::{Memory, WORDS};
use sim_host::actuators::Drive;
use sim_host::ground::Ground;
use sim_host::plant::{Actuation, Plant, RigidPlant, Truth};
use sim_host::vehicle::{AirframeName, Vehicle, VehicleKeys};
use sim_host::wind::Gust;
use system_tests::motion::Noise;

const HZ: u32 = 500;
const DT_S: f64 = 1.0 / HZ as f64;
/// What passes between the last step and the first one after a reset, s: the watchdog's time, and more than the boot's.
const GAP_S: f64 = 0.03;

/// A machine, its program and its pilot.
struct Machine {
    flight: Flight,
    plant: RigidPlant,
    actuation: Actuation,
    vehicle: Vehicle,
    noise: Noise,
    pilot: PilotInput,
    steps: u32,
}

fn program(vehicle: &Vehicle) -> Flight {
    let controller = Config::tolerant(vehicle.airframe());
    let regulators = controller.regulators().expect("it spins");
    let config = FlightConfig { controller, regulators: &regulators, estimator: EstimatorConfig::FLIGHT };
    let mut parameters = Parameters::default();
    parameters.set("TKO_HEIGHT", 5.0).expect("it is in its range");
    Flight::try_new(&config, &parameters).expect("shipped gains")
}

impl Machine {
    /// On the ground, just switched on.
    fn new() -> Self {
        let keys = VehicleKeys { linear_drag_n_s_m: 0.1, ..VehicleKeys::default() };
        let vehicle = Vehicle::new(AirframeName::Paper, &keys);
        let ground = Ground { altitude_m: Some(0.0) };
        let drive = Drive { command_n: 0.0, lag_s: keys.motor_lag_s, rate_n_s_max: f64::INFINITY, share: 1.0 };
        Self {
            flight: program(&vehicle),
            plant: RigidPlant::standing(&vehicle, ground, ground.standing_m().expect("there is ground")),
            actuation: Actuation { drives: [drive; 4], gust: Gust::default() },
            vehicle,
            noise: Noise::new(3),
            pilot: PilotInput { sticks: Sticks::NEUTRAL, arm: false, mode: Mode::TakeOff },
            steps: 0,
        }
    }

    /// Taken off to 5 m, in position hold.
    fn hovering() -> Self {
        let mut machine = Self::new();
        machine.fly(5.0);
        machine.pilot.arm = true;
        machine.fly(9.0);
        machine.pilot.mode = Mode::PositionHold;
        machine.fly(2.0);
        assert_eq!(machine.decision().mode, Mode::PositionHold, "{:?}", machine.decision());
        machine
    }

    fn truth(&self) -> Truth {
        self.plant.truth(&self.actuation)
    }

    fn now_us(&self) -> u64 {
        u64::from(self.steps) * 1_000_000 / u64::from(HZ)
    }

    fn decision(&self) -> &autopilot::Command {
        self.flight.helm().decision().expect("it has decided")
    }

    fn fly(&mut self, seconds: f64) {
        for _ in 0..(seconds / DT_S).round() as usize {
            self.step();
        }
    }

    fn step(&mut self) {
        self.steps += 1;
        let (truth, now_us) = (self.truth(), self.now_us());
        let mut noisy = |x: [f64; 3], sigma: f64| {
            let noise = self.noise.normals(sigma);
            Vec3::new((x[0] + noise[0]) as f32, (x[1] + noise[1]) as f32, (x[2] + noise[2]) as f32)
        };
        let value = Imu {
            rate_rad_s: noisy(truth.rate_rad_s.into(), 2e-3),
            specific_force_m_s2: noisy(truth.specific_force_m_s2.into(), 0.03),
        };
        let place = noisy(truth.position_m.into(), 0.002);
        let row = |i| [0, 1, 2].map(|j| truth.attitude[(i, j)] as f32);
        let pose = Vision {
            position_m: Vec3::new(place.x, place.y, place.z),
            attitude: Attitude { rows: [row(0), row(1), row(2)] },
            position_sigma_m: 0.005,
            attitude_sigma_rad: 0.01,
        };
        let seen = self.steps.is_multiple_of(5);
        let measurements = Measurements {
            imu: Some(Stamped { time_us: now_us, value }),
            vision: seen.then_some(Stamped { time_us: now_us, value: pose }),
            ..Measurements::default()
        };
        let command = self.flight.step(
            now_us,
            &Arrived {
                measurements,
                pilot: seen.then_some(Stamped { time_us: now_us, value: self.pilot }),
                self_test_passed: true,
                parameters_valid: true,
                ..Arrived::default()
            },
        );
        let speeds = if let Command::Run(speeds) = command { speeds } else { [0.0; 4] };
        for (drive, speed) in self.actuation.drives.iter_mut().zip(speeds) {
            drive.command_n = f64::from(speed * speed) * self.vehicle.thrust_n_max();
        }
        self.plant.advance(&self.actuation, DT_S, 2);
    }

    /// The program stops, and starts again without a memory; meanwhile the rotors stop, or go on as they were told.
    fn reset(&mut self, rotors_stop: bool) {
        self.flight = program(&self.vehicle);
        if rotors_stop {
            self.actuation.drives.iter_mut().for_each(|drive| drive.command_n = 0.0);
        }
        self.plant.advance(&self.actuation, GAP_S, 30);
        self.steps += (GAP_S / DT_S).round() as u32;
    }

    /// The same, with what was kept.
    fn restart(&mut self, rotors_stop: bool) {
        let memory = self.flight.remember().expect("it flies");
        self.reset(rotors_stop);
        let now_us = self.now_us();
        assert!(self.flight.resume(memory, now_us));
    }

    /// How far it gets from where it is, level and down, and the most it tilts, in the next `seconds`.
    fn strays(&mut self, seconds: f64) -> (f64, f64) {
        let from = self.truth().position_m;
        let (mut far_m, mut tilt_rad) = (0.0_f64, 0.0_f64);
        for _ in 0..(seconds / DT_S).round() as usize {
            self.step();
            let truth = self.truth();
            far_m = far_m.max((truth.position_m - from).norm());
            tilt_rad = tilt_rad.max(truth.tilt_rad());
        }
        (far_m, tilt_rad)
    }

    /// Lands by itself and stands, disarmed.
    fn lands(&mut self) {
        self.pilot.mode = Mode::Land;
        self.fly(25.0);
        let truth = self.truth();
        assert!(truth.touching && truth.impact_m_s < 0.8, "{truth:?}");
        assert!(!self.decision().armed, "{:?}", self.decision());
    }
}

#[test]
fn a_hover_goes_on_after_a_restart_and_lands() {
    for rotors_stop in [true, false] {
        let mut machine = Machine::hovering();
        machine.restart(rotors_stop);
        let (far_m, tilt_rad) = machine.strays(5.0);
        println!("rotors stop {rotors_stop}: {far_m:.3} m, {tilt_rad:.3} rad");
        assert!(far_m < 0.3 && tilt_rad < 0.1, "{far_m} m, {tilt_rad} rad");
        assert_eq!(machine.decision().mode, Mode::PositionHold);
        machine.lands();
    }
}

#[test]
fn so_does_a_flight_that_turns_and_moves() {
    let mut machine = Machine::hovering();
    machine.pilot.sticks = Sticks { clockwise: 1.0, forward: 0.6, ..Sticks::NEUTRAL };
    machine.fly(2.0);
    let before = machine.truth();
    assert!(before.rate_rad_s.z > 1.0 && before.velocity_m_s.norm() > 0.5, "{before:?}");
    machine.restart(true);
    let mut tilt_rad = 0.0_f64;
    for _ in 0..HZ {
        machine.step();
        tilt_rad = tilt_rad.max(machine.truth().tilt_rad());
        let truth = machine.truth();
        let estimate = machine.flight.estimate();
        let heading_rad = |north: f64, east: f64| east.atan2(north);
        let [[n, ..], [e, ..], _] = estimate.attitude.rows;
        let off_rad = heading_rad(truth.attitude[(0, 0)], truth.attitude[(1, 0)]) - heading_rad(n.into(), e.into());
        assert!(off_rad.sin().abs() < 0.1, "{off_rad} rad");
    }
    println!("tilted {tilt_rad:.3} rad");
    assert!(tilt_rad < 0.5, "{tilt_rad} rad");
    machine.pilot.sticks = Sticks::NEUTRAL;
    machine.fly(5.0);
    let (far_m, _) = machine.strays(3.0);
    assert!(far_m < 0.2, "{far_m} m");
    machine.lands();
}

#[test]
fn so_does_one_that_knows_of_a_weak_rotor_and_still_knows() {
    let mut machine = Machine::hovering();
    machine.actuation.drives[1].share = 0.6;
    machine.fly(4.0);
    let known = |machine: &Machine| {
        let telemetry = machine.flight.helm().controller().telemetry(&machine.flight.helm().state().controller);
        telemetry.rotors.expect("it watches").shares
    };
    let before = known(&machine);
    assert!((before[1] - 0.6).abs() < 0.1, "{before:?}");
    machine.restart(true);
    machine.step();
    assert_eq!(known(&machine), before);
    let (far_m, tilt_rad) = machine.strays(5.0);
    println!("{far_m:.3} m, {tilt_rad:.3} rad, {:?}", known(&machine));
    assert!(far_m < 0.3 && tilt_rad < 0.2, "{far_m} m, {tilt_rad} rad");
    assert!((known(&machine)[1] - 0.6).abs() < 0.1, "{:?}", known(&machine));
    machine.lands();
}

#[test]
fn so_does_one_that_spins_without_a_rotor() {
    let mut machine = Machine::hovering();
    machine.actuation.drives[0].share = 0.0;
    machine.fly(0.9);
    let telemetry = machine.flight.helm().controller().telemetry(&machine.flight.helm().state().controller);
    assert_eq!(telemetry.rotors.expect("it watches").spinning, Some(0));
    machine.restart(false);
    let mut tilt_rad = 0.0_f64;
    for _ in 0..2 * HZ {
        machine.step();
        tilt_rad = tilt_rad.max(machine.truth().tilt_rad());
    }
    println!("tilted {tilt_rad:.3} rad at {:.1} rad/s", machine.truth().rate_rad_s.z);
    assert!(tilt_rad < 1.2, "{tilt_rad} rad");
    machine.fly(25.0);
    assert!(machine.truth().touching && machine.truth().impact_m_s < 2.5, "{:?}", machine.truth());
}

#[test]
fn nothing_is_kept_of_a_machine_that_does_not_fly() {
    let mut machine = Machine::new();
    for (seconds, arm) in [(1.0, false), (4.0, false)] {
        machine.pilot.arm = arm;
        machine.fly(seconds);
        assert_eq!(machine.flight.remember(), None);
    }
    machine.pilot = PilotInput { sticks: Sticks { throttle: 0.0, ..Sticks::NEUTRAL }, arm: true, mode: Mode::Angle };
    machine.fly(1.0);
    assert!(machine.decision().armed && machine.decision().landed);
    assert_eq!(machine.flight.remember(), None, "armed, on its feet");
    let mut machine = Machine::hovering();
    assert!(machine.flight.remember().is_some());
    machine.lands();
    assert_eq!(machine.flight.remember(), None, "landed");
}

#[test]
fn what_is_not_whole_or_of_another_version_is_not_gone_on_from() {
    let mut machine = Machine::hovering();
    let memory = machine.flight.remember().expect("it flies");
    let refused = |machine: &mut Machine, memory: Memory| {
        machine.reset(true);
        let now_us = machine.now_us();
        let refused = !machine.flight.resume(memory, now_us);
        machine.step();
        refused && !machine.decision().armed
    };
    assert!(refused(&mut machine, [0; WORDS]));
    assert!(refused(&mut machine, [u32::MAX; WORDS]));
    let mut other = memory;
    other[0] += 1;
    assert!(refused(&mut machine, other), "another version");
    let mut crooked = memory;
    // The attitude comes after time, position and velocity.
    crooked[11..20].fill(0.9_f32.to_bits());
    assert!(refused(&mut machine, crooked), "no rotation");
    let mut unreal = memory;
    unreal[5] = f32::NAN.to_bits();
    assert!(refused(&mut machine, unreal), "no position");
}

#[test]
fn a_second_stop_within_ten_seconds_is_the_last() {
    let mut machine = Machine::hovering();
    machine.restart(false);
    machine.fly(9.0);
    let memory = machine.flight.remember().expect("it flies");
    machine.fly(2.0);
    let later = machine.flight.remember().expect("it flies");
    for (memory, goes_on) in [(memory, false), (later, true)] {
        let mut next = program(&machine.vehicle);
        assert_eq!(next.resume(memory, machine.now_us()), goes_on);
    }
}
