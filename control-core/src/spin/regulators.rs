//! Regulators of the spin: where it settles at each yaw rate, and the gains that hold it there.
//!
//! They are the same for as long as the machine is, so they can be made when a program is compiled: everything here is `const`. On a
//! Cortex-M4 at 168 MHz the 62 regulators take 120 ms, on a host 1 ms.
//!
//! Invariant: a table is for one machine, and is used for no other ([`Regulators::are_for`]).
//!
//! Source: the linear model of `spin.rs`; its gains by `riccati.rs`.
use super::SpinConfig;
use super::riccati::{M, N, Problem, product};
use crate::Scalar;
use crate::airframe::Airframe;

/// Spin up to which gains are tabulated, one a rad/s.
pub(super) const TABLE: usize = 41;
/// The same for two rotors, one each 2 rad/s.
pub(super) const ALONE: usize = 21;
/// Spin at which the limiter begins and at which it has all, rad/s.
const LIMITER_RAD_S: (f32, f32) = (19.0, 29.0);
/// Share of its maximum that a rotor carries at most, so that it can still steer.
const CARRIED_MAX: f32 = 0.9;
/// How scarce the facing rotor is that is gone: the regulator does without it.
const UNAVAILABLE: f32 = 1e3;

/// Where the spin settles at one yaw rate, and how it is held there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trim<S> {
    /// K: a row each for roll and pitch acceleration.
    pub(super) gains: [[S; N]; M],
    /// β_t, rad/s².
    pub(super) push: S,
    /// h_y / h_z.
    pub(super) lean: S,
    /// h_y.
    pub(super) lean_sine: S,
}

impl<S: Scalar> Trim<S> {
    /// Between `self` and `other`.
    pub(super) fn towards(&self, other: &Self, share: S) -> Self {
        let mix = |low: S, high: S| low + share * (high - low);
        Self {
            gains: core::array::from_fn(|i| core::array::from_fn(|j| mix(self.gains[i][j], other.gains[i][j]))),
            push: mix(self.push, other.push),
            lean: mix(self.lean, other.lean),
            lean_sine: mix(self.lean_sine, other.lean_sine),
        }
    }
}

impl Trim<f32> {
    /// The same in the scalar that flies.
    pub(super) fn to_scalar<S: Scalar>(self) -> Trim<S> {
        let s = S::from_f32;
        Trim {
            gains: self.gains.map(|row| row.map(s)),
            push: s(self.push),
            lean: s(self.lean),
            lean_sine: s(self.lean_sine),
        }
    }
}

/// The regulators of one machine.
#[derive(Clone, Debug)]
pub struct Regulators {
    /// At each rad/s.
    pub(super) trims: [Trim<f32>; TABLE],
    /// K's row for pitch where the facing rotor is gone as well, at each second rad/s: there is nothing else.
    pub(super) alone: [[f32; N]; ALONE],
    /// Weights, airframe, lag of a rotor in s, and rate in Hz.
    made_for: (SpinConfig, Airframe, f32, f32),
}

impl Regulators {
    /// Makes them. Nothing is checked: the controller checks what it is built from.
    ///
    /// - `motor_lag_s`: time constant of a rotor's thrust.
    /// - `control_hz`: tick rate.
    pub const fn new(config: &SpinConfig, airframe: &Airframe, motor_lag_s: f32, control_hz: f32) -> Self {
        let machine = Machine::new(airframe, motor_lag_s, control_hz);
        let nothing = Trim { gains: [[0.0; N]; M], push: 0.0, lean: 0.0, lean_sine: 0.0 };
        let (mut trims, mut alone) = ([nothing; TABLE], [[0.0; N]; ALONE]);
        let mut i = 0;
        while i < TABLE {
            trims[i] = machine.regulate(config, false, i as f32);
            i += 1;
        }
        let mut i = 0;
        while i < ALONE {
            let Trim { gains: [_, pitch], .. } = machine.regulate(config, true, 2.0 * i as f32);
            alone[i] = pitch;
            i += 1;
        }
        Self { trims, alone, made_for: (*config, *airframe, motor_lag_s, control_hz) }
    }

    /// Whether they were made for this machine.
    pub(super) fn are_for(&self, config: &SpinConfig, airframe: &Airframe, motor_lag_s: f32, control_hz: f32) -> bool {
        self.made_for == (*config, *airframe, motor_lag_s, control_hz)
    }
}

/// The machine, as the table of trims needs it.
struct Machine {
    /// (Iz − Ix) / Ix.
    ratio: f32,
    inertia_kg_m2: f32,
    /// Roll acceleration per newton of a rotor, 1/(kg m).
    per_newton: f32,
    weight_n: f32,
    thrust_n_max: f32,
    rotor_momentum: f32,
    motor_lag_s: f32,
    dt_s: f32,
}

impl Machine {
    const fn new(airframe: &Airframe, motor_lag_s: f32, control_hz: f32) -> Self {
        let [ix, iy, iz] = airframe.inertia_kg_m2;
        let inertia_kg_m2 = 0.5 * (ix + iy);
        let (mut arms_m, mut thrust_n_max) = (0.0, f32::INFINITY);
        let mut j = 0;
        while j < airframe.rotors.len() {
            let rotor = &airframe.rotors[j];
            arms_m += root(rotor.forward_m * rotor.forward_m + rotor.right_m * rotor.right_m);
            thrust_n_max = thrust_n_max.min(rotor.thrust_n_max);
            j += 1;
        }
        Self {
            ratio: (iz - inertia_kg_m2) / inertia_kg_m2,
            inertia_kg_m2,
            per_newton: 0.25 * arms_m / inertia_kg_m2,
            weight_n: airframe.weight_n(),
            thrust_n_max,
            rotor_momentum: airframe.rotor_momentum,
            motor_lag_s,
            dt_s: 1.0 / control_hz,
        }
    }

    /// Trim at the yaw rate `r`, rad/s, positive: (β_t, h_y / h_z, k r − h / Ix).
    const fn trim(&self, config: &SpinConfig, pair: bool, r: f32) -> (f32, f32, f32) {
        let half_n = self.weight_n / 2.0;
        let over = ((r - LIMITER_RAD_S.0) / (LIMITER_RAD_S.1 - LIMITER_RAD_S.0)).clamp(0.0, 1.0);
        // What the other two cannot carry while they steer, the facing rotor must.
        let short_n = self.weight_n - 2.0 * CARRIED_MAX * self.thrust_n_max;
        let least_n = (half_n * config.trim_max).max(short_n.min(CARRIED_MAX * self.thrust_n_max));
        let most_n = if pair { 0.0 } else { least_n + over * (half_n - least_n).max(0.0) };
        // The rotors turn against the body, so their momentum makes it less stiff; by how much depends on the trim, a little.
        let mut push_n = most_n;
        let mut stiffness = 0.0;
        let mut turn = 0;
        while turn < 4 {
            let pair_n = (self.weight_n - push_n) / 2.0;
            let momentum = self.rotor_momentum * (2.0 * root(pair_n) - root(push_n));
            stiffness = self.ratio * r - momentum / self.inertia_kg_m2;
            let held = stiffness * r * config.lean_max;
            // Not `max`: which zero it chooses, compilers may say.
            push_n = if held > 0.0 { most_n.min(held / self.per_newton) } else { 0.0 };
            turn += 1;
        }
        let push = push_n * self.per_newton;
        let lean = if stiffness * r * config.lean_max > push { push / (stiffness * r) } else { config.lean_max };
        (push, lean, stiffness)
    }

    /// The regulator about the trim at `r`.
    const fn regulate(&self, config: &SpinConfig, pair: bool, r: f32) -> Trim<f32> {
        let (push, lean, stiffness) = self.trim(config, pair, r);
        let upright = 1.0 / root(1.0 + lean * lean);
        let quarter = self.weight_n / 4.0 * self.per_newton;
        let scarce = if pair { UNAVAILABLE } else { quarter / push.max(0.02 * quarter) };
        let lag = -1.0 / self.motor_lag_s;
        let slope: [[f32; N]; N] = [
            [0.0, r, 0.0, -upright, 0.0, 0.0],
            [-r, 0.0, upright, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, -stiffness, 1.0, 0.0],
            [0.0, 0.0, stiffness, 0.0, 0.0, 1.0],
            [0.0, 0.0, 0.0, 0.0, lag, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, lag],
        ];
        // Second order in dt, for A and for B.
        let dt_s = self.dt_s;
        let square = product(&slope, &slope);
        let (mut a, mut b) = ([[0.0; N]; N], [[0.0; M]; N]);
        let mut i = 0;
        while i < N {
            let mut j = 0;
            while j < N {
                let identity = if i == j { 1.0 } else { 0.0 };
                a[i][j] = identity + dt_s * (slope[i][j] + 0.5 * dt_s * square[i][j]);
                if j >= N - M {
                    b[i][j - (N - M)] = -lag * dt_s * (identity + 0.5 * dt_s * slope[i][j]);
                }
                j += 1;
            }
            i += 1;
        }
        let [point, turn] = config.weights;
        let cost = 1.0 / (self.per_newton * self.per_newton);
        let r = [cost * (1.0 + config.one_sided * scarce * scarce), cost];
        let problem = Problem { a, b, q: [point, point, turn, turn, 0.0, 0.0], r };
        Trim { gains: problem.gains(), push, lean, lean_sine: lean * upright }
    }
}

/// Square root of what is not negative, correctly rounded: by Newton's rule in twice the digits, since none is `const` yet.
const fn root(x: f32) -> f32 {
    let x = x as f64;
    if !(x > 0.0 && x < f64::INFINITY) {
        return x as f32;
    }
    // Half the exponent: within 7 %, which five steps make less than a unit in the last place.
    let mut root = f64::from_bits(u64::midpoint(x.to_bits(), 1.0_f64.to_bits()));
    let mut step = 0;
    while step < 5 {
        root = 0.5 * (root + x / root);
        step += 1;
    }
    root as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[allow(long_running_const_eval, reason = "62 regulators of 12 doublings")]
    static COMPILED: Regulators = Regulators::new(&SpinConfig::NOMINAL, &Airframe::paper(2.2), 0.02, 2000.0);

    fn same_bits<const I: usize>(a: &[f32; I], b: &[f32; I]) -> bool {
        a.map(f32::to_bits) == b.map(f32::to_bits)
    }

    #[test]
    fn the_compiler_makes_the_same_regulators_to_the_bit() {
        let airframe = core::hint::black_box(Airframe::paper(2.2));
        let made = Regulators::new(&SpinConfig::NOMINAL, &airframe, 0.02, 2000.0);
        for (a, b) in COMPILED.trims.iter().zip(&made.trims) {
            assert!(a.gains.iter().zip(&b.gains).all(|(a, b)| same_bits(a, b)));
            assert!(same_bits(&[a.push, a.lean, a.lean_sine], &[b.push, b.lean, b.lean_sine]));
        }
        assert!(COMPILED.alone.iter().zip(&made.alone).all(|(a, b)| same_bits(a, b)));
    }

    #[test]
    fn the_root_is_correctly_rounded() {
        for n in 0..1_000_000_u32 {
            let x = f32::from_bits(0x0080_0000 + n * 2_039);
            assert_eq!(root(x).to_bits(), libm::sqrtf(x).to_bits(), "{x:e}");
        }
        assert_eq!(root(0.0), 0.0);
        assert!(root(f32::NAN).is_nan());
    }
}
