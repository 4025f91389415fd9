//! What stands between a command and the air: wiring, speed controllers, motors, propellers, and their faults.
//!
//! ```text
//! command ─► swapped ─► late ─► taken over ─► lag and rate, in the plant ─► share ─► thrust
//!                              stopped, stuck, hard-over,                  loss, damage, sag,
//!                              floating, desync                            reversed
//! ```
//!
//! | symbol   | code                    | unit |
//! |----------|-------------------------|------|
//! | F_cmd    | [`Drive::command_n`]    | N    |
//! | T        | [`Drive::lag_s`]        | s    |
//! | max Ḟ    | [`Drive::rate_n_s_max`] | N/s  |
//! | 1 − loss | [`Drive::share`]        |      |
//!
//! Everything here changes once a control period; within one the plant integrates with it held. Without faults commands
//! pass as they are, to the bit.
use crate::fault::{Fault, FaultKind, Occurrence};
use crate::vehicle::Vehicle;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use std::array::from_fn;
use std::collections::VecDeque;

/// What a rotor is driven with during one control period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// Thrust that the motor is driven to, N.
    pub command_n: f64,
    /// Time constant of its thrust, s; 0 for none.
    pub lag_s: f64,
    /// Largest change of its thrust, N/s.
    pub rate_n_s_max: f64,
    /// Share of the thrust that reaches the air; negative if it blows upwards.
    pub share: f64,
}

/// What the sensors feel of damaged propellers, body axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vibration {
    /// Added to the specific force, m/s².
    pub specific_force_m_s2: Vector3<f64>,
    /// Added to the body rates, rad/s.
    pub rate_rad_s: Vector3<f64>,
}

impl Vibration {
    /// Of healthy propellers.
    pub const NONE: Self =
        Self { specific_force_m_s2: Vector3::new(0.0, 0.0, 0.0), rate_rad_s: Vector3::new(0.0, 0.0, 0.0) };
}

/// What a controller may be told of the faults, rotor by rotor: the share of a command that the rotor still answers with.
///
/// A rotor that is stopped, floats, has lost its motor, or is stuck or hard-over answers with nothing: 0. One that is reversed
/// answers with a negative share.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Told {
    /// The shares of rotors under a fault that is reported; none for the others.
    pub reported: [Option<f32>; 4],
    /// Every share, true: for an oracle only.
    pub truth: [f32; 4],
}

/// Height of the rotors' plane above the centre of mass, m: what makes an unbalanced rotor shake roll and pitch.
const ROTOR_HEIGHT_M: f64 = 0.05;

/// Commands on their way to one rotor.
#[derive(Clone, Debug)]
struct Line {
    /// The last commands sent, oldest first, N.
    sent_n: VecDeque<f64>,
    /// How many periods ago the command was sent that the rotor has.
    age: usize,
}

impl Line {
    /// Sends `command_n`, and gives what arrives if commands take `delay` periods: what has arrived is never taken back.
    fn pass(&mut self, command_n: f64, delay: usize, capacity: usize) -> f64 {
        self.sent_n.push_back(command_n);
        if self.sent_n.len() > capacity + 1 {
            self.sent_n.pop_front();
        }
        let newest = self.sent_n.len() - 1;
        self.age = (self.age + 1).min(delay).min(newest);
        self.sent_n[newest - self.age]
    }
}

/// One rotor between ticks.
#[derive(Clone, Debug)]
struct Rotor {
    line: Line,
    /// Thrust at which it is stuck, N.
    stuck_n: Option<f64>,
    /// When its motor was last not driven, s.
    lost_s: Option<f64>,
    /// Angle of its rotor, rad.
    angle_rad: f64,
}

/// The actuators of one flight.
pub struct Actuators {
    vehicle: Vehicle,
    faults: Vec<Occurrence>,
    dt_s: f64,
    /// Longest delay of any fault, periods.
    delay_max: usize,
    rotors: [Rotor; 4],
    shares: [f64; 4],
    vibration: Vibration,
    voltage: f64,
    t_s: f64,
}

impl Actuators {
    /// Actuators in a hover, driven every `dt_s`.
    pub fn new(vehicle: &Vehicle, faults: &[Fault], dt_s: f64, mut random: Pcg64) -> Self {
        let hover_n = f64::from(vehicle.airframe().weight_n()) / 4.0;
        let line = Line { sent_n: VecDeque::from([hover_n]), age: 0 };
        let rotor = Rotor { line, stuck_n: None, lost_s: None, angle_rad: 0.0 };
        // Each fault draws from a stream of its own: another fault leaves it as it was.
        let faults: Vec<_> = faults.iter().map(|&fault| Occurrence::new(fault, Pcg64::from_rng(&mut random))).collect();
        let delay_max_s: f64 = faults.iter().map(|fault| delay_s_max(fault.fault().kind)).sum();
        Self {
            vehicle: vehicle.clone(),
            faults,
            dt_s,
            delay_max: (delay_max_s / dt_s).ceil() as usize,
            rotors: from_fn(|_| rotor.clone()),
            shares: [1.0; 4],
            vibration: Vibration::default(),
            voltage: 1.0,
            t_s: 0.0,
        }
    }

    /// The same before take-off: no command is under way.
    #[must_use]
    pub fn at_rest(mut self) -> Self {
        for rotor in &mut self.rotors {
            rotor.line.sent_n.iter_mut().for_each(|sent_n| *sent_n = 0.0);
        }
        self
    }

    /// What the rotors are driven with before the first tick.
    pub fn hovering(&self) -> [Drive; 4] {
        let hover_n = f64::from(self.vehicle.airframe().weight_n()) / 4.0;
        [Drive { command_n: hover_n, lag_s: self.vehicle.motor_lag_s, rate_n_s_max: f64::INFINITY, share: 1.0 }; 4]
    }

    /// Brings the faults to `t_s`, and gives the share of its thrust that each rotor makes then.
    ///
    /// - `rotor_n`: what each rotor's speed would make in thrust, without a fault, N.
    pub fn advance(&mut self, t_s: f64, rotor_n: &[f64; 4]) -> [f64; 4] {
        self.t_s = t_s;
        for fault in &mut self.faults {
            fault.advance(t_s);
        }
        self.shares = self.shares_now(rotor_n);
        self.voltage = self.voltage_now(rotor_n);
        self.hold_stuck_rotors(rotor_n);
        self.vibration = self.shake(rotor_n);
        self.shares
    }

    /// Faults that rotor `i` has now, with how much of each is there.
    fn on(&self, i: usize) -> impl Iterator<Item = (&Occurrence, f64)> {
        let there = self.faults.iter().filter(move |fault| fault.fault().rotors.has(i) && fault.level() > 0.0);
        there.map(|fault| (fault, fault.level()))
    }

    fn shares_now(&self, rotor_n: &[f64; 4]) -> [f64; 4] {
        let load = rotor_n.iter().sum::<f64>() / (4.0 * self.vehicle.thrust_n_max());
        from_fn(|i| {
            self.on(i).fold(1.0, |share, (fault, level)| match fault.fault().kind {
                FaultKind::LossOfEffectiveness { loss } | FaultKind::PropellerDamage { loss, .. } => {
                    share * (1.0 - loss * level)
                }
                FaultKind::BatterySag { sag } => {
                    let voltage = 1.0 - sag * level * load;
                    share * voltage * voltage
                }
                FaultKind::Reversed { share: backwards } => -backwards * share,
                _ => share,
            })
        })
    }

    /// Voltage that is left of a healthy battery's under this load, a share.
    fn voltage_now(&self, rotor_n: &[f64; 4]) -> f64 {
        let load = rotor_n.iter().sum::<f64>() / (4.0 * self.vehicle.thrust_n_max());
        // Its faults are of all rotors.
        self.on(0).fold(1.0, |voltage, (fault, level)| match fault.fault().kind {
            FaultKind::BatterySag { sag } => voltage * (1.0 - sag * level * load),
            _ => voltage,
        })
    }

    /// A rotor that gets stuck keeps the thrust it has then.
    fn hold_stuck_rotors(&mut self, rotor_n: &[f64; 4]) {
        for (i, &now_n) in rotor_n.iter().enumerate() {
            let stuck = self.on(i).find_map(|(fault, _)| match fault.fault().kind {
                FaultKind::Stuck { thrust_n } => Some(thrust_n.unwrap_or(now_n)),
                _ => None,
            });
            let rotor = &mut self.rotors[i];
            rotor.stuck_n = stuck.map(|thrust_n| rotor.stuck_n.unwrap_or(thrust_n));
        }
    }

    /// Unbalance times the squared speed, turning with the rotor: it pushes the frame, and turns it by its arm.
    fn shake(&mut self, rotor_n: &[f64; 4]) -> Vibration {
        let mut vibration = Vibration::default();
        let inertia = Vector3::from(self.vehicle.inertia_kg_m2);
        for (i, &thrust_n) in rotor_n.iter().enumerate() {
            let unbalance_kg_m: f64 = self
                .on(i)
                .filter_map(|(fault, level)| match fault.fault().kind {
                    FaultKind::PropellerDamage { unbalance_kg_m, .. } => Some(unbalance_kg_m * level),
                    _ => None,
                })
                .sum();
            let speed_rad_s = libm::sqrt(thrust_n.max(0.0) / self.vehicle.thrust_coefficient_n_s2);
            // Rotors 1 and 3 turn counter-clockwise seen from above, against body z.
            let turn_rad_s = if i % 2 == 0 { -speed_rad_s } else { speed_rad_s };
            let angle_rad = &mut self.rotors[i].angle_rad;
            *angle_rad = (*angle_rad + turn_rad_s * self.dt_s) % std::f64::consts::TAU;
            if unbalance_kg_m == 0.0 || speed_rad_s == 0.0 {
                continue;
            }
            let [forward, right] = self.vehicle.arms_m[i];
            let arm = Vector3::new(forward, right, -ROTOR_HEIGHT_M);
            let (sin, cos) = (libm::sin(*angle_rad), libm::cos(*angle_rad));
            let force_n = Vector3::new(cos, sin, 0.0) * (unbalance_kg_m * speed_rad_s * speed_rad_s);
            // The integral over time of a force that turns at this speed.
            let impulse_n_s = Vector3::new(sin, -cos, 0.0) * (unbalance_kg_m * turn_rad_s);
            vibration.specific_force_m_s2 += force_n / self.vehicle.mass_kg;
            vibration.rate_rad_s += arm.cross(&impulse_n_s).component_div(&inertia);
        }
        vibration
    }

    /// What the sensors feel of it.
    pub fn vibration(&self) -> &Vibration {
        &self.vibration
    }

    /// Voltage that is left of a healthy battery's, a share.
    pub fn voltage(&self) -> f64 {
        self.voltage
    }

    /// What a controller may be told.
    pub fn told(&self) -> Told {
        let answers = |i: usize| {
            let driven = !self.on(i).any(|(fault, _)| match fault.fault().kind {
                FaultKind::EscDesync { .. } => fault.has_dropped_out(),
                FaultKind::Reversed { .. } => false,
                kind => kind.takes_over(),
            });
            if driven { self.shares[i] as f32 } else { 0.0 }
        };
        Told {
            reported: from_fn(|i| self.on(i).any(|(fault, _)| fault.fault().reported).then(|| answers(i))),
            truth: from_fn(answers),
        }
    }

    /// What the rotors are driven with when `command_n` is sent to them.
    pub fn drive(&mut self, command_n: [f64; 4]) -> [Drive; 4] {
        let mut sent_n = command_n;
        for fault in self.faults.iter().filter(|fault| fault.fault().kind == FaultKind::Swapped && fault.level() > 0.0)
        {
            let mut pair = fault.fault().rotors.indices();
            if let (Some(one), Some(other)) = (pair.next(), pair.next()) {
                sent_n.swap(one, other);
            }
        }
        from_fn(|i| self.drive_rotor(i, sent_n[i]))
    }

    fn drive_rotor(&mut self, i: usize, sent_n: f64) -> Drive {
        let delay = self.delay(i);
        let arrived_n = self.rotors[i].line.pass(sent_n, delay, self.delay_max);
        let lag_s = self.vehicle.motor_lag_s;
        let mut drive = Drive { command_n: arrived_n, lag_s, rate_n_s_max: f64::INFINITY, share: self.shares[i] };
        let mut lost_s = self.rotors[i].lost_s;
        for (fault, level) in self.on(i) {
            match fault.fault().kind {
                FaultKind::Stopped => drive.command_n = 0.0,
                FaultKind::Stuck { .. } => drive.command_n = self.rotors[i].stuck_n.unwrap_or(arrived_n),
                FaultKind::HardOver => drive.command_n = self.vehicle.thrust_n_max(),
                FaultKind::Floating { spin_down_s } => {
                    drive.command_n = 0.0;
                    drive.lag_s = spin_down_s;
                }
                FaultKind::SlowMotor { lag_factor, rate_n_s_max } => {
                    drive.lag_s *= 1.0 + (lag_factor - 1.0) * level;
                    // Half of the fault is twice the rate.
                    drive.rate_n_s_max = drive.rate_n_s_max.min(rate_n_s_max.unwrap_or(f64::INFINITY) / level);
                }
                FaultKind::EscDesync { restart_s, .. } => {
                    if fault.has_dropped_out() {
                        lost_s = Some(self.t_s);
                    }
                    let since_s = lost_s.map_or(f64::INFINITY, |lost_s| self.t_s - lost_s);
                    if since_s < restart_s.max(self.dt_s / 2.0) {
                        drive.command_n *= if restart_s > 0.0 { since_s / restart_s } else { 0.0 };
                    }
                }
                _ => {}
            }
        }
        self.rotors[i].lost_s = lost_s;
        drive
    }

    /// How long a command to rotor `i` takes now, control periods.
    fn delay(&self, i: usize) -> usize {
        let delay_s: f64 = self.on(i).map(|(fault, _)| fault.delay_s(i)).sum();
        (delay_s / self.dt_s).round() as usize
    }
}

/// Longest delay of commands, s.
fn delay_s_max(kind: FaultKind) -> f64 {
    match kind {
        FaultKind::CommandDelay { delay_s } => delay_s,
        FaultKind::CommandJitter { delay_s_max } => delay_s_max,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::{Profile, PulseTrain, Recurrence, Rotors};
    use crate::vehicle::{AirframeName, VehicleKeys};

    const DT_S: f64 = 0.002;
    const ONE: Rotors = Rotors::new([true, false, false, false]);

    fn fault(kind: FaultKind, rotors: Rotors) -> Fault {
        Fault { kind, rotors, from_s: 0.1, until_s: 0.9, profile: Profile::Step, reported: false }
    }

    fn actuators(faults: &[Fault]) -> Actuators {
        let vehicle = Vehicle::new(AirframeName::Paper, &VehicleKeys::default());
        Actuators::new(&vehicle, faults, DT_S, Pcg64::seed_from_u64(1))
    }

    /// Drives of every tick of a second, the command of tick i being i N for rotor 1, the rotors at `rotor_n`.
    fn drives(faults: &[Fault], rotor_n: f64) -> Vec<[Drive; 4]> {
        let mut actuators = actuators(faults);
        let tick = |i: u32| {
            actuators.advance(f64::from(i) * DT_S, &[rotor_n; 4]);
            actuators.drive([f64::from(i), 0.1, 0.2, 0.3])
        };
        (0..500).map(tick).collect()
    }

    #[test]
    fn healthy_rotors_get_their_commands_as_they_are() {
        for (i, drives) in drives(&[], 1.0).iter().enumerate() {
            let drive = |command_n| Drive { command_n, lag_s: 0.02, rate_n_s_max: f64::INFINITY, share: 1.0 };
            assert_eq!(*drives, [i as f64, 0.1, 0.2, 0.3].map(drive));
        }
    }

    #[test]
    fn faults_take_commands_over_while_they_last() {
        let full_n = Vehicle::new(AirframeName::Paper, &VehicleKeys::default()).thrust_n_max();
        for (kind, want_n) in [
            (FaultKind::Stopped, 0.0),
            (FaultKind::Floating { spin_down_s: 0.2 }, 0.0),
            (FaultKind::HardOver, full_n),
            (FaultKind::Stuck { thrust_n: None }, 1.5),
            (FaultKind::Stuck { thrust_n: Some(0.7) }, 0.7),
        ] {
            let drives = drives(&[fault(kind, ONE)], 1.5);
            for (i, drives) in drives.iter().enumerate() {
                let active = (50..450).contains(&i);
                assert_eq!(drives[0].command_n, if active { want_n } else { i as f64 }, "{kind:?} at {i}");
                assert_eq!(drives[1].command_n, 0.1, "other rotors are left alone");
            }
        }
        assert_eq!(drives(&[fault(FaultKind::Floating { spin_down_s: 0.2 }, ONE)], 1.5)[100][0].lag_s, 0.2);
    }

    #[test]
    fn a_rotor_keeps_the_thrust_at_which_it_gets_stuck_each_time() {
        let pulse = Profile::PulseTrain(PulseTrain { period_s: 0.4, duty: 0.5 });
        let stuck = Fault { profile: pulse, ..fault(FaultKind::Stuck { thrust_n: None }, ONE) };
        let mut actuators = actuators(&[stuck]);
        let mut command_n = |t_s: f64, rotor_n: f64| {
            actuators.advance(t_s, &[rotor_n; 4]);
            actuators.drive([9.0; 4])[0].command_n
        };
        assert_eq!([command_n(0.1, 1.0), command_n(0.2, 2.0), command_n(0.35, 3.0)], [1.0, 1.0, 9.0]);
        assert_eq!(command_n(0.55, 4.0), 4.0);
    }

    #[test]
    fn shares_follow_loss_damage_sag_and_reversal() {
        let loss = fault(FaultKind::LossOfEffectiveness { loss: 0.4 }, ONE);
        let damage = fault(FaultKind::PropellerDamage { loss: 0.5, unbalance_kg_m: 0.0 }, ONE);
        let sag = fault(FaultKind::BatterySag { sag: 0.2 }, Rotors::ALL);
        let reversed = fault(FaultKind::Reversed { share: 0.5 }, ONE);
        let half_n = Vehicle::new(AirframeName::Paper, &VehicleKeys::default()).thrust_n_max() / 2.0;
        for (why, faults, want) in [
            ("faults on one rotor multiply", &[loss, damage][..], [0.3, 1.0, 1.0, 1.0]),
            ("thrust falls with the square of a voltage that falls with load", &[sag], [0.81; 4]),
            ("a reversed rotor thrusts downwards", &[reversed, loss], [-0.3, 1.0, 1.0, 1.0]),
        ] {
            let shares = actuators(faults).advance(0.5, &[half_n; 4]);
            for (share, want) in shares.iter().zip(want) {
                assert!((share - want).abs() < 1e-12, "{why}: {shares:?}");
            }
        }
        assert_eq!(actuators(&[loss, sag]).advance(0.95, &[half_n; 4]), [1.0; 4]);
    }

    #[test]
    fn late_commands_arrive_in_order_and_none_is_taken_back() {
        let delayed = drives(&[fault(FaultKind::CommandDelay { delay_s: 0.02 }, ONE)], 1.0);
        let arrived = |i: usize| delayed[i][0].command_n;
        assert_eq!([arrived(49), arrived(50), arrived(58)], [49.0; 3], "the line falls behind");
        assert_eq!([arrived(60), arrived(300), arrived(449)], [50.0, 290.0, 439.0]);
        assert_eq!(arrived(450), 450.0, "it is repaired");

        let jittered = drives(&[fault(FaultKind::CommandJitter { delay_s_max: 0.02 }, ONE)], 1.0);
        let ages: Vec<_> = (60..450).map(|i| i as f64 - jittered[i][0].command_n).collect();
        assert!(ages.iter().all(|age| (0.0..=10.0).contains(age)));
        assert!(ages.iter().any(|&age| age >= 5.0) && ages.contains(&0.0), "{ages:?}");
        assert!(jittered.windows(2).all(|pair| pair[0][0].command_n <= pair[1][0].command_n));
    }

    #[test]
    fn a_slow_motor_has_more_lag_and_a_rate_limit() {
        let slow = FaultKind::SlowMotor { lag_factor: 3.0, rate_n_s_max: Some(5.0) };
        let at = |i: usize| drives(&[fault(slow, ONE)], 1.0)[i][0];
        assert!((at(100).lag_s - 0.06).abs() < 1e-12);
        assert_eq!((at(100).rate_n_s_max, at(460).rate_n_s_max, at(460).lag_s), (5.0, f64::INFINITY, 0.02));
    }

    #[test]
    fn desync_drops_out_and_restarts_by_a_ramp() {
        let recurrence = Recurrence::Period { period_s: 0.4 };
        let desync = fault(FaultKind::EscDesync { dropout_s: 0.1, restart_s: 0.2, recurrence }, ONE);
        let drives = drives(&[desync], 1.0);
        let share = |t_s: f64| {
            let i = (t_s / DT_S).round() as usize;
            drives[i][0].command_n / i as f64
        };
        assert_eq!([share(0.05), share(0.11), share(0.19)], [1.0, 0.0, 0.0]);
        assert!((share(0.3) - 0.5).abs() < 0.02, "{}", share(0.3));
        assert_eq!([share(0.42), share(0.55), share(0.95)], [1.0, 0.0, 1.0]);
    }

    #[test]
    fn swapped_rotors_get_each_others_commands() {
        let pair = Rotors::new([false, true, false, true]);
        let swapped = Fault { from_s: 0.0, ..fault(FaultKind::Swapped, pair) };
        let commands = drives(&[swapped], 1.0)[10].map(|drive| drive.command_n);
        assert_eq!(commands, [10.0, 0.3, 0.2, 0.1]);
    }

    #[test]
    fn a_damaged_propeller_shakes_the_sensors_once_a_revolution() {
        let damage = fault(FaultKind::PropellerDamage { loss: 0.0, unbalance_kg_m: 1e-4 }, ONE);
        let mut actuators = actuators(&[damage]);
        // 202 rad/s, 32 Hz.
        let rotor_n = 1.275;
        let speed_rad_s = libm::sqrt(rotor_n / 3.13e-5);
        let mut crossings = 0;
        let (mut last, mut largest): (f64, f64) = (0.0, 0.0);
        for i in 0..500 {
            actuators.advance(f64::from(i) * DT_S, &[rotor_n; 4]);
            let felt = actuators.vibration();
            let active = (50..450).contains(&i);
            assert_eq!(felt == &Vibration::default(), !active, "tick {i}");
            if last < 0.0 && felt.specific_force_m_s2.x >= 0.0 && active {
                crossings += 1;
            }
            last = felt.specific_force_m_s2.x;
            largest = largest.max(felt.specific_force_m_s2.norm());
            let arms_m = felt.rate_rad_s.norm() / libm::hypot(0.232, ROTOR_HEIGHT_M);
            assert!(arms_m <= 1e-4 * speed_rad_s / 0.0279, "the gyro feels the same force by its arm");
        }
        assert!((largest - 1e-4 * speed_rad_s * speed_rad_s / 0.52).abs() < 1e-9, "{largest}");
        let revolutions = 0.8 * speed_rad_s / std::f64::consts::TAU;
        assert!((f64::from(crossings) - revolutions).abs() <= 1.0, "{crossings} of {revolutions}");
    }

    #[test]
    fn the_reported_are_told_and_the_silent_are_not() {
        let loss = Fault { reported: true, ..fault(FaultKind::LossOfEffectiveness { loss: 0.4 }, ONE) };
        let stuck = fault(FaultKind::Stuck { thrust_n: None }, Rotors::new([false, true, false, false]));
        let stopped = Fault { reported: true, ..fault(FaultKind::Stopped, Rotors::new([false, false, true, false])) };
        let mut actuators = actuators(&[loss, stuck, stopped]);
        actuators.advance(0.05, &[1.0; 4]);
        assert_eq!(actuators.told(), Told { reported: [None; 4], truth: [1.0; 4] });
        actuators.advance(0.5, &[1.0; 4]);
        let told = Told { reported: [Some(0.6), None, Some(0.0), None], truth: [0.6, 0.0, 0.0, 1.0] };
        assert_eq!(actuators.told(), told);
    }
}
