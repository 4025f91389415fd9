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

/// What a controller may be told of the faults, rotor by rotor: the share of a command that the rotor still answers with.
///
/// A rotor that is stopped, floats, has lost its motor, or is stuck or hard-over answers with nothing: 0.
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
            t_s: 0.0,
        }
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

    /// A rotor that gets stuck keeps the thrust it has then.
    fn hold_stuck_rotors(&mut self, rotor_n: &[f64; 4]) {
        for i in 0..4 {
            let stuck = self.on(i).find_map(|(fault, _)| match fault.fault().kind {
                FaultKind::Stuck { thrust_n } => Some(thrust_n.unwrap_or(rotor_n[i])),
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
        for i in 0..4 {
            let unbalance_kg_m: f64 = self
                .on(i)
                .filter_map(|(fault, level)| match fault.fault().kind {
                    FaultKind::PropellerDamage { unbalance_kg_m, .. } => Some(unbalance_kg_m * level),
                    _ => None,
                })
                .sum();
            let speed_rad_s = libm::sqrt(rotor_n[i].max(0.0) / self.vehicle.thrust_coefficient_n_s2);
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
