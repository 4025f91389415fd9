//! Flight with one rotor gone: heading is given up, the body spins, and the thrust is pointed by tilting the spin axis.
//!
//! In axes turned so that the dead rotor is on +y, with β and δ the roll and pitch acceleration the rotors make:
//!
//! ```text
//! n = Rᵀ n_d, n_d opposite to the wanted acceleration      target (0, h_y, h_z),  p0 = 0,  q0 = r h_y / h_z
//! ṅ1 = r n2 − h_z q      ṅ2 = h_z p − r n1      ṗ = −k r q + β      q̇ = k r p + δ      k = (Iz − Ix) / Ix
//! β̇ = (β_c − β) / τ      δ̇ = (δ_c − δ) / τ
//! β_t = min(k r² tan_m, share of what half the weight on the facing rotor makes),  h_y / h_z = β_t / (k r²)
//! (β_c, δ_c) = (β_t, 0) − K(|r|) (n1, n2 − h_y, p, q − q0, β − β_t, δ)
//! ```
//!
//! | symbol | code           | unit    | what                                                         |
//! |--------|----------------|---------|--------------------------------------------------------------|
//! | n      | `pointing`     |         | where the down axis should be, seen from the body            |
//! | β_t    | `trim`         | rad/s²  | what the facing rotor must push so that both signs are at hand |
//! | K      | `gains`        |         | regulator, tabulated over the spin                           |
//!
//! The facing rotor can only push one way: the spin axis leans towards the dead rotor, by h_y, so that in trim it pushes half of what it
//! may. Where the facing rotor is gone as well, there is no trim and no lean: pitch alone steers, and the spin brings every direction
//! round to it. A body that turns the other way is its mirror image: n1, q, δ and r change sign, nothing else. Beyond 24 rad/s the trim
//! rises until at 34 rad/s the facing rotor carries half the weight and nothing turns the body further.
//!
//! Source: docs/control-law.md, "One rotor gone"; M. W. Mueller, R. D'Andrea, "Stability and control of a quadrocopter despite
//! the complete loss of one, two, or three propellers", 2014.
use crate::airframe::Airframe;
use crate::config::{ConfigError, positive};
use crate::filter::LowPass;
use crate::frames::{Attitude, Body, Ned, Vec3};
use crate::rotors::Residual;
use crate::signals::Input;
use crate::{GRAVITY_M_S2, Mask, Scalar};
use core::hint::cold_path;
use regulators::{ALONE, TABLE, Trim};
use riccati::N;

mod regulators;
mod riccati;

pub use regulators::Regulators;

/// Tangent of the largest tilt asked for, 0.9 rad.
const TAN_TILT_MAX: f32 = 1.260_158_2;
/// Spin from which on the thrust may be pointed that far, rad/s, and the share of it that is asked for without any: until the body
/// spins, roll goes one way only. A healed machine asks for no more until it has stopped turning, which yields to roll and pitch.
const ABLE_RAD_S: f32 = 12.0;
const LEAST_ABLE: f32 = 0.3;
/// Smallest share of the thrust taken to point up.
const UPRIGHT_MIN: f32 = 0.3;
/// What is wrong with gains of another machine, or none.
const MADE_FOR_IT: &str = "made for this airframe, these weights and this rate (Hz)";

/// What the regulator is made from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpinConfig {
    /// Weights of (n1, n2), and of (p, q) in s²/rad².
    pub weights: [f32; 2],
    /// Weight of the facing rotor's thrust where its trim is small.
    pub one_sided: f32,
    /// Tangent of the largest lean.
    pub lean_max: f32,
    /// Largest trim of the facing rotor, share of half the weight.
    pub trim_max: f32,
    /// Position gain, 1/s², and velocity gain, 1/s.
    pub outer: [f32; 2],
}

impl SpinConfig {
    /// Tuned for the paper's airframe.
    pub const NOMINAL: Self =
        Self { weights: [128.0, 2.9], one_sided: 0.005, lean_max: 0.21, trim_max: 0.22, outer: [1.0, 1.6] };
}

/// The law of the spin, configured.
#[derive(Clone, Debug)]
pub(crate) struct Spin<S> {
    /// At each rad/s.
    trims: [Trim<S>; TABLE],
    /// K's row for pitch where the facing rotor is gone as well, at each second rad/s: there is nothing else.
    alone: [[S; N]; ALONE],
    /// Unit vector (forward, right) to each rotor.
    towards: [[S; 2]; 4],
    inertia_kg_m2: S,
    outer: [S; 2],
    mass_kg: S,
}

/// A flight that has given its heading up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spinning<S> {
    /// The rotor that is gone, 0 to 3.
    pub(crate) rotor: usize,
    /// Whether the facing rotor is gone as well.
    pub(crate) pair: bool,
    /// Whether it works again: the lean is given up, and the body only has to stop turning.
    pub(crate) healed: bool,
    /// Share of the lean that is held: all, and when healed less and less.
    pub(crate) leaning: S,
    /// Push of the wind, north and east, m/s².
    pub(crate) wind_m_s2: [S; 2],
}

/// How fast the lean is given up, rad/s: at once, it would be a jolt.
const STRAIGHTEN_RAD_S: f32 = 2.0;
/// Corner of the wind's estimate, rad/s: above the gusts, below the spin.
const WIND_RAD_S: f32 = 8.0;

impl<S: Scalar> Spinning<S> {
    /// Begins to spin without `rotor`.
    pub(crate) fn without(rotor: usize) -> Self {
        Self { rotor, pair: false, healed: false, leaning: S::ONE, wind_m_s2: [S::ZERO; 2] }
    }

    /// Straightens up when healed, and takes the force that the rotors do not make for wind.
    pub(crate) fn advance(&mut self, input: &Input<S>, residual: &Residual<S>, dt_s: S) {
        let target = if self.healed { S::ZERO } else { S::ONE };
        LowPass::new(S::from_f32(STRAIGHTEN_RAD_S), dt_s).step(&mut self.leaning, target);
        let Residual([_, _, down]) = *residual;
        let felt = input.specific_force_m_s2;
        let push = input.attitude.to_ned(Vec3::new(felt.x, felt.y, down));
        let low_pass = LowPass::new(S::from_f32(WIND_RAD_S), dt_s);
        low_pass.step(&mut self.wind_m_s2[0], push.x);
        low_pass.step(&mut self.wind_m_s2[1], push.y);
    }
}

/// What is wrong with the position, and what the setpoint does anyway.
pub(crate) struct Wanted<S> {
    pub(crate) error_m: Vec3<Ned, S>,
    pub(crate) error_m_s: Vec3<Ned, S>,
    pub(crate) forward_m_s2: Vec3<Ned, S>,
}

/// What the law needs to know in one tick.
pub(crate) struct SpinInput<S> {
    /// Roll and pitch acceleration the rotors make, body axes, rad/s².
    pub(crate) tilting_rad_s2: [S; 2],
    /// Wanted direction of the body's down axis, body axes, unit length.
    pub(crate) pointing: Vec3<Body, S>,
    pub(crate) rate: Vec3<Body, S>,
}

/// Where `x`, not negative, is in a table of `rows`, two at least: the row below, and the share of the way to the next.
fn between<S: Scalar>(x: S, rows: usize) -> (usize, S) {
    let last = rows - 1;
    let x = x.min(S::from_f32(last as f32));
    let low = (x.to_f32() as usize).min(last - 1);
    (low, x - S::from_f32(low as f32))
}

impl<S: Scalar> Spin<S> {
    /// - `regulators`: made for this very machine.
    pub(crate) fn try_new(
        config: &SpinConfig,
        regulators: Option<&Regulators>,
        airframe: &Airframe,
        motor_lag_s: f32,
        control_hz: f32,
    ) -> Result<Self, ConfigError> {
        let SpinConfig { weights: [point, turn], one_sided, lean_max, trim_max, outer: [kp, kd] } = *config;
        for (field, value) in [
            ("weights.n", point),
            ("weights.rate", turn),
            ("one_sided", one_sided),
            ("lean_max", lean_max),
            ("trim_max", trim_max),
            ("outer.p", kp),
            ("outer.d", kd),
        ] {
            positive("spin", field, value)?;
        }
        let regulators = regulators
            .filter(|regulators| regulators.are_for(config, airframe, motor_lag_s, control_hz))
            .ok_or(ConfigError { part: "spin", field: "regulators", value: control_hz, allowed: MADE_FOR_IT })?;
        let [ix, iy, _] = airframe.inertia_kg_m2;
        let s = S::from_f32;
        let towards = |j: usize| {
            let rotor = airframe.rotors[j];
            let arm_m = libm::sqrtf(rotor.forward_m * rotor.forward_m + rotor.right_m * rotor.right_m);
            [rotor.forward_m, rotor.right_m].map(|x| s(x / arm_m))
        };
        Ok(Self {
            trims: regulators.trims.map(Trim::to_scalar),
            alone: regulators.alone.map(|row| row.map(s)),
            towards: core::array::from_fn(towards),
            inertia_kg_m2: s(0.5 * (ix + iy)),
            outer: [s(kp), s(kd)],
            mass_kg: s(airframe.mass_kg),
        })
    }

    /// The trim at the yaw rate `r`, positive, between the two nearest of the table.
    fn trim(&self, pair: bool, r: S) -> Trim<S> {
        if pair {
            let (low, share) = between(S::from_f32(0.5) * r, ALONE);
            let (from, to) = (&self.alone[low], &self.alone[low + 1]);
            let pitch = core::array::from_fn(|i| from[i] + share * (to[i] - from[i]));
            return Trim { gains: [[S::ZERO; N], pitch], push: S::ZERO, lean: S::ZERO, lean_sine: S::ZERO };
        }
        let (low, share) = between(r, TABLE);
        self.trims[low].towards(&self.trims[low + 1], share)
    }

    /// Where the body's down axis should point, body axes, and the thrust, N.
    pub(crate) fn aim(
        &self,
        spinning: &Spinning<S>,
        wanted: &Wanted<S>,
        up_n: S,
        spin_rad_s: S,
        attitude: &Attitude<S>,
    ) -> (Vec3<Body, S>, S) {
        let [kp, kd] = self.outer;
        let s = S::from_f32;
        let up = (up_n / self.mass_kg).max(s(0.3 * GRAVITY_M_S2));
        let Wanted { error_m, error_m_s, forward_m_s2 } = wanted;
        let mut north = kp * error_m.x + kd * error_m_s.x + forward_m_s2.x - spinning.wind_m_s2[0];
        let mut east = kp * error_m.y + kd * error_m_s.y + forward_m_s2.y - spinning.wind_m_s2[1];
        let able = (spin_rad_s.abs() * s(1.0 / ABLE_RAD_S)).clamp(s(LEAST_ABLE), S::ONE);
        let able = if spinning.healed { s(LEAST_ABLE) } else { able };
        let most = s(TAN_TILT_MAX) * up * able;
        let square = north * north + east * east;
        if (most * most).lt(square).all() {
            cold_path();
            let share = most / square.sqrt();
            (north, east) = (north * share, east * share);
        }
        let inverse = S::ONE / (north * north + east * east + up * up).sqrt();
        let (north, east, down) = (-north * inverse, -east * inverse, up * inverse);
        let [a, b, c] = attitude.rows;
        let pointing = Vec3::new(
            a[0] * north + b[0] * east + c[0] * down,
            a[1] * north + b[1] * east + c[1] * down,
            a[2] * north + b[2] * east + c[2] * down,
        );
        (pointing, self.mass_kg * up / c[2].max(s(UPRIGHT_MIN)))
    }

    /// Roll and pitch torques, N m.
    pub(crate) fn torque_nm(&self, spinning: &Spinning<S>, input: &SpinInput<S>) -> [S; 2] {
        let [forward, right] = self.towards[spinning.rotor % 4];
        // Turned so that the dead rotor is on +y, and mirrored so that the spin is positive.
        let mirrored = input.rate.z.lt(S::ZERO);
        let flip = |x: S| S::select(mirrored, -x, x);
        let turned = |x: S, y: S| (right * x - forward * y, forward * x + right * y);
        let (n1, n2) = turned(input.pointing.x, input.pointing.y);
        let (p, q) = turned(input.rate.x, input.rate.y);
        let (roll, pitch) = turned(input.tilting_rad_s2[0], input.tilting_rad_s2[1]);
        let r = input.rate.z.abs();
        let Trim { gains, push, lean, lean_sine } = self.trim(spinning.pair, r);
        let [push, lean, lean_sine] = [push, lean, lean_sine].map(|x| x * spinning.leaning);
        let state = [flip(n1), n2 - lean_sine, p, flip(q) - r * lean, roll - push, flip(pitch)];
        let fed = |row: &[S; N]| row.iter().zip(state).fold(S::ZERO, |sum, (&k, x)| sum + k * x);
        let (roll, pitch) = (push - fed(&gains[0]), flip(-fed(&gains[1])));
        [self.inertia_kg_m2 * (right * roll + forward * pitch), self.inertia_kg_m2 * (right * pitch - forward * roll)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAG_S: f32 = 0.02;

    fn spin(airframe: &Airframe) -> Spin<f32> {
        let config = SpinConfig::NOMINAL;
        let regulators = Regulators::new(&config, airframe, LAG_S, 500.0);
        Spin::try_new(&config, Some(&regulators), airframe, LAG_S, 500.0).expect("the shipped weights")
    }

    /// How far the linear spin at `r` of `airframe`, disturbed, is off its trim after four seconds.
    fn left_after_four_seconds(airframe: &Airframe, pair: bool, r: f32) -> f32 {
        let spin = spin(airframe);
        let trim = spin.trim(pair, r);
        let [ix, _, iz] = airframe.inertia_kg_m2;
        let momentum = airframe.rotor_momentum
            * (2.0 * libm::sqrtf(airframe.weight_n() / 2.0) - libm::sqrtf(airframe.weight_n() / 8.0));
        let k = (iz - ix) / ix * r - momentum / ix;
        let upright = libm::sqrtf(1.0 - trim.lean_sine * trim.lean_sine);
        // Short: Euler's steps would feed the precession.
        let dt_s = 0.000_05;
        let mut x = [0.05_f32, -0.05, 0.2, 0.2, 0.0, 0.0];
        for _ in 0..80_000 {
            let fed = trim.gains.map(|row| row.iter().zip(x).map(|(k, x)| k * x).sum::<f32>());
            let [n1, n2, p, q, b, d] = x;
            let slope = [
                r * n2 - upright * q,
                upright * p - r * n1,
                b - k * q,
                d + k * p,
                (-fed[0] - b) / LAG_S,
                (-fed[1] - d) / LAG_S,
            ];
            x = core::array::from_fn(|i| x[i] + dt_s * slope[i]);
        }
        x.iter().map(|x| x.abs()).fold(0.0, f32::max)
    }

    #[test]
    fn the_regulator_calms_the_spin_at_every_rate_it_flies() {
        for airframe in [Airframe::paper(3.0), Airframe::os4(3.0)] {
            for r in [8.0, 12.0, 20.0, 28.0, 36.0] {
                let left = left_after_four_seconds(&airframe, false, r);
                assert!(left < 0.1, "{r} rad/s: {left} of 0.2");
            }
        }
    }

    /// Where Iz = Ix + Iy it cannot: nothing fixed to the body moves its angular momentum.
    #[test]
    fn on_two_rotors_the_spin_is_calmed_where_inertia_allows() {
        for r in [8.0, 12.0, 20.0, 28.0, 36.0] {
            let left = left_after_four_seconds(&Airframe::os4(3.0), true, r);
            assert!(left < 0.035, "{r} rad/s: {left} of 0.2");
        }
        let flat = left_after_four_seconds(&Airframe { rotor_momentum: 0.0, ..Airframe::paper(3.0) }, true, 20.0);
        assert!(flat > 0.04, "of what it pointed wrong, 0.05 on each axis, it keeps {flat}");
    }

    #[test]
    fn with_little_thrust_the_facing_rotor_carries_what_the_others_cannot() {
        let airframe = Airframe::paper(1.8);
        let per_newton = 0.232 / airframe.inertia_kg_m2[0];
        let push_n = spin(&airframe).trim(false, 15.0).push / per_newton;
        assert!((push_n / airframe.weight_n() - 0.19).abs() < 0.01, "{push_n}");
    }

    #[test]
    fn trim_is_what_the_facing_rotor_can_push_and_stops_the_spin_from_growing() {
        for airframe in [Airframe::paper(2.2), Airframe::os4(3.0)] {
            let spin = spin(&airframe);
            let half = 0.232 * airframe.weight_n() / 2.0 / airframe.inertia_kg_m2[0];
            for r in 0..40 {
                let Trim { push, lean, .. } = spin.trim(false, r as f32);
                assert!((0.0..=half * 1.001).contains(&push), "{r}: {push}");
                assert!((0.0..=0.211).contains(&lean), "{r}: {lean}");
            }
            assert!((spin.trim(false, 29.0).push / half - 1.0).abs() < 1e-3, "half the weight");
        }
    }

    #[test]
    fn the_other_sense_of_rotation_is_the_mirror_image() {
        let spin = spin(&Airframe::paper(3.0));
        let torque = |turn: f32| {
            let input = SpinInput {
                tilting_rad_s2: [3.0, turn * 2.0],
                pointing: Vec3::new(turn * 0.1, 0.2, 0.97),
                rate: Vec3::new(0.5, turn * 1.5, turn * 20.0),
            };
            spin.torque_nm(&Spinning::without(0), &input)
        };
        let ([roll, pitch], [mirrored_roll, mirrored_pitch]) = (torque(1.0), torque(-1.0));
        assert!((roll - mirrored_roll).abs() < 1e-6 && (pitch + mirrored_pitch).abs() < 1e-6);
    }

    #[test]
    fn every_rotor_is_flown_without_alike() {
        let spin = spin(&Airframe::paper(3.0));
        // The same situation, a quarter of a turn on: rotor 1 on the right, then rotor 4 at the back.
        let input = |x: f32, y: f32| (x, y);
        let turn = |(x, y): (f32, f32)| (-y, x);
        let at = |rotor, n: (f32, f32), w: (f32, f32), t: (f32, f32)| {
            let [x, y] = spin.torque_nm(
                &Spinning::without(rotor),
                &SpinInput {
                    tilting_rad_s2: [t.0, t.1],
                    pointing: Vec3::new(n.0, n.1, 0.97),
                    rate: Vec3::new(w.0, w.1, -20.0),
                },
            );
            (x, y)
        };
        let (n, w, t) = (input(0.1, 0.2), input(0.5, -1.5), input(3.0, 2.0));
        let (x, y) = turn(at(0, n, w, t));
        let (found_x, found_y) = at(3, turn(n), turn(w), turn(t));
        assert!((x - found_x).abs() < 1e-6 && (y - found_y).abs() < 1e-6, "{x} {y}, {found_x} {found_y}");
    }

    #[test]
    fn regulators_of_another_machine_or_none_are_refused() {
        let (config, airframe) = (SpinConfig::NOMINAL, Airframe::paper(3.0));
        let good = Regulators::new(&config, &airframe, LAG_S, 500.0);
        let fly = |config: &SpinConfig, regulators, airframe: &Airframe, lag_s, hz| {
            Spin::<f32>::try_new(config, regulators, airframe, lag_s, hz).err().map(|error| error.field)
        };
        assert_eq!(fly(&config, Some(&good), &airframe, LAG_S, 500.0), None);
        let shy = SpinConfig { lean_max: 0.2, ..config };
        for (why, refused) in [
            ("none", fly(&config, None, &airframe, LAG_S, 500.0)),
            ("other weights", fly(&shy, Some(&good), &airframe, LAG_S, 500.0)),
            ("another airframe", fly(&config, Some(&good), &Airframe::os4(3.0), LAG_S, 500.0)),
            ("another lag", fly(&config, Some(&good), &airframe, 0.03, 500.0)),
            ("another rate", fly(&config, Some(&good), &airframe, LAG_S, 2000.0)),
        ] {
            assert_eq!(refused, Some("regulators"), "{why}");
        }
        let nan = SpinConfig { weights: [f32::NAN, 1.0], ..config };
        let of_nan = Regulators::new(&nan, &airframe, LAG_S, 500.0);
        assert_eq!(fly(&nan, Some(&of_nan), &airframe, LAG_S, 500.0), Some("weights.n"));
    }
}
