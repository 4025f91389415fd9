//! Synthetic sensors: a machine that sways gently around its hover, so that every term of the law has work.
//!
//! ```text
//! p_i = A_i sin(2π n_i t / T)      v = p'      a = p''      j = p'''
//! f = a − g e_down                 b₃ = −f / |f|            b₂ ∝ b₃ × (cos ψ, sin ψ, 0)      b₁ = b₂ × b₃
//! b₃' = ω_y b₁ − ω_x b₂
//! ```
//!
//! | symbol      | meaning                                             |
//! |-------------|-----------------------------------------------------|
//! | p, v, a, j  | position and its derivatives, NED                   |
//! | f           | specific force; a quadrotor's is along its own axis |
//! | b₁, b₂, b₃  | body axes in NED: the columns of the attitude       |
//! | ω           | body rates                                          |
//!
//! Position, velocity, attitude, rates and specific force belong to one motion, but for the sine's error
//! (`control_core::math`). Nobody closes the loop: the setpoint stays at the origin and the sway goes on whatever the
//! law commands.
//!
//! # Source
//! Differential flatness: Mellinger and Kumar, "Minimum snap trajectory generation and control for quadrotors",
//! ICRA 2011, section III; the yaw rate is exact here.
use control_core::frames::{Attitude, Body, Ned, Vec3};
use control_core::math::{cos, sin};
use control_core::{GRAVITY_M_S2, Input, Scalar};
use core::f32::consts::TAU;

/// Period after which the whole motion repeats, so that its phase keeps its resolution in `f32` for ever, µs.
const PERIOD_US: u64 = 8_000_000;

/// Sway of one coordinate: `amplitude · sin(2π harmonic t / period)`.
struct Sway {
    amplitude: f32,
    harmonic: u8,
}

// Large enough that every axis leaves its dead zone, small enough that no rotor saturates.
const NORTH: Sway = Sway::new(0.10, 2);
const EAST: Sway = Sway::new(0.06, 3);
const DOWN: Sway = Sway::new(0.01, 4);
const YAW: Sway = Sway::new(0.04, 3);

impl Sway {
    const fn new(amplitude: f32, harmonic: u8) -> Self {
        Self { amplitude, harmonic }
    }

    /// Value and first three time derivatives, `time_s` into the period.
    fn at(&self, time_s: f32) -> [f32; 4] {
        let omega = TAU * f32::from(self.harmonic) * 1e6 / PERIOD_US as f32;
        let (s, c) = (sin(omega * time_s), cos(omega * time_s));
        let first = self.amplitude * omega;
        [self.amplitude * s, first * c, -first * omega * s, -first * omega * omega * c]
    }
}

/// What the sensors of the swaying machine read at `time_us`, and the order to stay at the origin.
///
/// - `dt_s`: time since the last sample, passed on.
pub fn sample(time_us: u64, dt_s: f32) -> Input {
    let time_s = (time_us % PERIOD_US) as f32 * 1e-6;
    let [north, east, down] = [NORTH, EAST, DOWN].map(|sway| sway.at(time_s));
    let derivative = |n: usize| Vec3::new(north[n], east[n], down[n]);
    let [yaw_rad, yaw_rate_rad_s, ..] = YAW.at(time_s);

    let specific_force = derivative(2) - Vec3::new(0.0, 0.0, GRAVITY_M_S2);
    let pose = Pose::of(specific_force, yaw_rad);
    Input {
        dt_s,
        position_m: derivative(0),
        velocity_m_s: derivative(1),
        attitude: pose.attitude(),
        rate_rad_s: pose.rates(derivative(3), yaw_rad, yaw_rate_rad_s),
        specific_force_m_s2: Vec3::new(0.0, 0.0, -pose.thrust_m_s2),
        ..Input::hovering()
    }
}

/// Body axes in NED, and thrust over mass.
struct Pose {
    forward: Vec3<Ned>,
    right: Vec3<Ned>,
    down: Vec3<Ned>,
    thrust_m_s2: f32,
}

impl Pose {
    /// The pose whose rotors make `specific_force` with the nose at `yaw_rad`.
    fn of(specific_force: Vec3<Ned>, yaw_rad: f32) -> Self {
        let thrust_m_s2 = norm(specific_force);
        let down = specific_force * (-1.0 / thrust_m_s2);
        let across = down.cross(heading(yaw_rad));
        let right = across * (1.0 / norm(across));
        Self { forward: right.cross(down), right, down, thrust_m_s2 }
    }

    fn attitude(&self) -> Attitude {
        let (f, r, d) = (self.forward, self.right, self.down);
        Attitude { rows: [[f.x, r.x, d.x], [f.y, r.y, d.y], [f.z, r.z, d.z]] }
    }

    /// Body rates: roll and pitch from the turn of the thrust axis, yaw from `b₂ · heading = 0`, which holds always.
    fn rates(&self, jerk: Vec3<Ned>, yaw_rad: f32, yaw_rate_rad_s: f32) -> Vec3<Body> {
        let turn = (jerk - self.down * dot(jerk, self.down)) * (-1.0 / self.thrust_m_s2);
        let roll = -dot(self.right, turn);
        let pitch = dot(self.forward, turn);
        let ahead = heading(yaw_rad);
        let aside = Vec3::new(-ahead.y, ahead.x, 0.0);
        let yaw = (roll * dot(self.down, ahead) + yaw_rate_rad_s * dot(self.right, aside)) / dot(self.forward, ahead);
        Vec3::new(roll, pitch, yaw)
    }
}

/// The horizontal direction of the nose.
fn heading(yaw_rad: f32) -> Vec3<Ned> {
    Vec3::new(cos(yaw_rad), sin(yaw_rad), 0.0)
}

fn dot(a: Vec3<Ned>, b: Vec3<Ned>) -> f32 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

fn norm(v: Vec3<Ned>) -> f32 {
    Scalar::sqrt(dot(v, v))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pulse::Pulse;
    use control_core::{Airframe, Config, Controller, Law};

    const STEP_US: u64 = 20_000;

    /// Samples over one period, each with its neighbours `STEP_US` before and after.
    fn triples() -> impl Iterator<Item = [Input; 3]> {
        let at = |time_us| sample(time_us, 0.002);
        (0..PERIOD_US).step_by(10_000).map(move |t| [at(t + PERIOD_US - STEP_US), at(t), at(t + STEP_US)])
    }

    /// Half the difference of the neighbours, over the step.
    fn slope(before: Vec3<Ned>, after: Vec3<Ned>) -> Vec3<Ned> {
        (after - before) * (0.5e6 / STEP_US as f32)
    }

    #[test]
    fn velocity_and_specific_force_are_the_derivatives_of_position() {
        // Twice micromath's 1.2e-3 over the step, times the amplitude; and the parabola's remainder.
        for [before, now, after] in triples() {
            let error = slope(before.position_m, after.position_m) - now.velocity_m_s;
            assert!(norm(error) < 0.02, "{error:?}");
            let acceleration = now.attitude.to_ned(now.specific_force_m_s2) + Vec3::new(0.0, 0.0, GRAVITY_M_S2);
            let error = slope(before.velocity_m_s, after.velocity_m_s) - acceleration;
            assert!(norm(error) < 0.05, "{error:?}");
        }
    }

    #[test]
    fn attitude_is_a_rotation_and_turns_at_the_body_rates() {
        let axis = |input: &Input, n: usize| {
            let [x, y, z] = input.attitude.rows.map(|row| row[n]);
            Vec3::<Ned>::new(x, y, z)
        };
        for [before, now, after] in triples() {
            let [f, r, d] = [0, 1, 2].map(|n| axis(&now, n));
            assert!(norm(f.cross(r) - d) < 1e-6);
            assert!((norm(f) - 1.0).abs() < 1e-6 && dot(f, r).abs() < 1e-6);
            let rates = now.attitude.to_ned(now.rate_rad_s);
            for n in 0..3 {
                let error = slope(axis(&before, n), axis(&after, n)) - rates.cross(axis(&now, n));
                assert!(norm(error) < 0.02, "{error:?}");
            }
        }
    }

    #[test]
    fn a_minute_of_sway_moves_the_gains_and_no_rotor_leaves_its_range() {
        let airframe = Airframe::paper(2.2);
        let config = Config::flight(Law::Lgs, airframe);
        let controller = Controller::<f32>::try_new(&config).unwrap();
        let mut state = controller.hover_state();
        let mut moved = [0.0_f32; 4];
        for tick in 0..30_000 {
            let output = *controller.tick(&mut state, &sample(tick * 2_000, 0.002));
            assert!(!output.rejected);
            for (moved, axis) in moved.iter_mut().zip(&controller.telemetry(&state).axes) {
                let share = |j: usize| (axis.gain_ratios[j] - 1.0).abs();
                *moved = moved.max(share(0)).max(share(1)).max(share(2));
            }
            for pulse in Pulse::from_thrusts(output.thrust_n, &airframe) {
                assert!(Pulse::STOP < pulse && pulse < Pulse::FULL, "{pulse:?}");
            }
        }
        assert!(moved.iter().all(|&share| share > 1e-3), "{moved:?}");
    }
}
