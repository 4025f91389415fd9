//! The rates that are flown on: rotor vibration notched out where the rotors say how fast they turn, the rest of the noise low-passed.
//!
//! ```text
//! notch      H = c (1 − 2β z⁻¹ + z⁻²) / (1 − 2β c z⁻¹ + a z⁻²)      β = cos(ω T)    c = (1 + a)/2    a = (1 − t)/(1 + t), t = tan(B T/2)
//! low-pass   Butterworth, second order, by the bilinear transform
//! ```
//!
//! The width B of a notch is constant, so that a rotor's speed enters by β alone: a new speed costs one cosine and no division, and,
//! since the steady state of the notch does not depend on β, no jump. Speeds are followed at a bounded rate.
//!
//! Delay of slow motion: √2/ω_c of the low-pass, B/ω² of each notch; [`GyroChain::delay_s`] adds them up. A rotor that says nothing, or turns
//! too slowly or too fast for the sampling, has no notch.
use crate::frames::{Body, Vec3};
use crate::math::{cos_half_turn, quarter_sin_and_cos};
use core::f32::consts::{SQRT_2, TAU};

/// The filters of the rates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroConfig {
    /// Inertial samples a second.
    pub sample_hz: f32,
    /// Corner of the low-pass, Hz; above 0.4 of the sampling it is left out.
    pub low_pass_hz: f32,
    /// Width of a notch, −3 dB to −3 dB, Hz.
    pub notch_width_hz: f32,
    /// Rotor speed below which there is no notch, Hz: its delay would grow with the square.
    pub notch_hz_min: f32,
}

impl GyroConfig {
    /// For 500 samples a second.
    pub const FLIGHT: Self = Self { sample_hz: 500.0, low_pass_hz: 100.0, notch_width_hz: 10.0, notch_hz_min: 40.0 };
}

/// Largest share of a turn a sample that a notch is set to.
const TURN_MAX: f32 = 0.45;
/// Share of its distance to the rotor's speed that a notch moves in a sample.
const FOLLOW: f32 = 0.1;
/// Samples after which a silent rotor has no notch any more, µs.
const SILENCE_US_MAX: u64 = 100_000;
const ROTORS: usize = 4;

/// A section of second order, transposed: y = b x + s₁.
type Memory = [Vec3<Body>; 2];

/// A notch, of one rotor, on all axes.
#[derive(Clone, Copy, Debug)]
struct Notch {
    /// Where it is, rad a sample; 0 where there is none.
    turn_rad: f32,
    /// 2β c.
    gain: f32,
    memory: Memory,
}

impl Notch {
    const OFF: Self = Self { turn_rad: 0.0, gain: 0.0, memory: [Vec3::zero(); 2] };
}

/// What the filters remember.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GyroState {
    notches: [Notch; ROTORS],
    /// As last told.
    rotor_rad_s: [f32; ROTORS],
    low_pass: Memory,
    /// The notch that follows its rotor next.
    turn: usize,
    heard_us: u64,
    started: bool,
}

impl GyroState {
    /// Nothing filtered yet.
    pub(crate) const NEW: Self = Self {
        notches: [Notch::OFF; ROTORS],
        rotor_rad_s: [0.0; ROTORS],
        low_pass: [Vec3::zero(); 2],
        turn: 0,
        heard_us: 0,
        started: false,
    };
}

/// Coefficients of a low-pass section: `b₁ = 2 b₀`, `b₂ = b₀`.
#[derive(Clone, Copy, Debug)]
struct LowPass {
    b: f32,
    a: [f32; 2],
}

/// The filters, for one rate of sampling.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GyroChain {
    low_pass: Option<LowPass>,
    notch_a: f32,
    sample_s: f32,
    turn_rad_min: f32,
    config: GyroConfig,
}

/// Tangent of an angle in 0..π/2.
fn tan(angle_rad: f32) -> f32 {
    let (sin, cos) = quarter_sin_and_cos(angle_rad);
    sin / cos
}

impl GyroChain {
    /// The filters of a checked configuration.
    pub(crate) fn new(config: &GyroConfig) -> Self {
        let sample_s = 1.0 / config.sample_hz;
        let low_pass = (config.low_pass_hz < 0.4 * config.sample_hz).then(|| {
            let k = tan(0.5 * TAU * config.low_pass_hz * sample_s);
            let unit = 1.0 / (1.0 + SQRT_2 * k + k * k);
            LowPass { b: k * k * unit, a: [2.0 * (k * k - 1.0) * unit, (1.0 - SQRT_2 * k + k * k) * unit] }
        });
        let t = tan(0.5 * TAU * config.notch_width_hz * sample_s);
        let turn_rad_min = TAU * config.notch_hz_min * sample_s;
        Self { low_pass, notch_a: (1.0 - t) / (1.0 + t), sample_s, turn_rad_min, config: *config }
    }

    /// Hears of the rotors' speeds, rad/s.
    pub(crate) fn hear(state: &mut GyroState, rotor_rad_s: &[f32; ROTORS], now_us: u64) {
        (state.heard_us, state.rotor_rad_s) = (now_us, *rotor_rad_s);
    }

    /// Filters a sample.
    pub(crate) fn step(&self, state: &mut GyroState, rate_rad_s: Vec3<Body>, now_us: u64) -> Vec3<Body> {
        if !state.started {
            state.started = true;
            if let Some(LowPass { b, a }) = self.low_pass {
                state.low_pass = [rate_rad_s * (1.0 - b), rate_rad_s * (b - a[1])];
            }
        }
        self.follow_one(state, rate_rad_s, now_us);
        let (a, c) = (self.notch_a, 0.5 * (1.0 + self.notch_a));
        let mut x = rate_rad_s;
        for notch in state.notches.iter_mut().filter(|notch| notch.turn_rad > 0.0) {
            let scaled = x * c;
            let y = scaled + notch.memory[0];
            notch.memory = [(y - x) * notch.gain + notch.memory[1], scaled - y * a];
            x = y;
        }
        let Some(LowPass { b, a }) = self.low_pass else { return x };
        let scaled = x * b;
        let y = scaled + state.low_pass[0];
        state.low_pass = [scaled * 2.0 - y * a[0] + state.low_pass[1], scaled - y * a[1]];
        y
    }

    /// Moves one notch towards its rotor: all of them every four samples.
    fn follow_one(&self, state: &mut GyroState, rate_rad_s: Vec3<Body>, now_us: u64) {
        let heard = now_us.saturating_sub(state.heard_us) <= SILENCE_US_MAX;
        let turn = state.turn;
        state.turn = (turn + 1) % ROTORS;
        let (Some(notch), Some(speed)) = (state.notches.get_mut(turn), state.rotor_rad_s.get(turn)) else { return };
        let wanted_rad = speed.abs() * self.sample_s;
        if !(heard && (self.turn_rad_min..=TURN_MAX * TAU).contains(&wanted_rad)) {
            notch.turn_rad = 0.0;
            return;
        }
        if notch.turn_rad == 0.0 {
            // As if the rate had always been this one.
            let rest = rate_rad_s * (0.5 * (1.0 - self.notch_a));
            (notch.turn_rad, notch.memory) = (wanted_rad, [rest, rest]);
        }
        notch.turn_rad += ROTORS as f32 * FOLLOW * (wanted_rad - notch.turn_rad);
        notch.gain = (1.0 + self.notch_a) * cos_half_turn(notch.turn_rad);
    }

    /// How much later slow motion leaves the filters than it enters them, s.
    pub(crate) fn delay_s(&self, state: &GyroState) -> f32 {
        let low_pass = if self.low_pass.is_some() { SQRT_2 / (TAU * self.config.low_pass_hz) } else { 0.0 };
        let notch = |notch: &Notch| {
            let omega = notch.turn_rad / self.sample_s;
            TAU * self.config.notch_width_hz / (omega * omega)
        };
        low_pass + state.notches.iter().filter(|notch| notch.turn_rad > 0.0).map(notch).sum::<f32>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Amplitude after four seconds of a sine of `hz` about x, and the state, with the rotors at `rotor_hz`.
    fn passes(hz: f32, rotor_hz: Option<f32>) -> (f32, GyroState) {
        let chain = GyroChain::new(&GyroConfig::FLIGHT);
        let mut state = GyroState::NEW;
        let mut peak = 0.0_f32;
        for i in 0..2000_u16 {
            let now_us = u64::from(i) * 2000;
            if let Some(rotor_hz) = rotor_hz {
                GyroChain::hear(&mut state, &[TAU * rotor_hz; ROTORS], now_us);
            }
            let x = libm::sinf(TAU * libm::fmodf(hz * f32::from(i) * 0.002, 1.0));
            let y = chain.step(&mut state, Vec3::new(x, 0.0, 0.0), now_us);
            if i > 1500 {
                peak = peak.max(y.x.abs());
            }
        }
        (peak, state)
    }

    #[test]
    fn a_rotor_is_silenced_where_it_turns_and_nowhere_else() {
        let (at_rotor, _) = passes(83.0, Some(83.0));
        let (unheard, _) = passes(83.0, None);
        assert!(at_rotor < 0.002, "{at_rotor}");
        assert!(unheard > 0.6, "{unheard}");
        let (slow, _) = passes(5.0, Some(83.0));
        assert!((slow - 1.0).abs() < 0.01, "{slow}");
        let (beside, _) = passes(60.0, Some(83.0));
        assert!(beside > 0.6, "{beside}");
    }

    #[test]
    fn the_low_pass_halves_the_power_at_its_corner() {
        let (corner, _) = passes(100.0, None);
        assert!((corner - core::f32::consts::FRAC_1_SQRT_2).abs() < 0.01, "{corner}");
        assert!(passes(200.0, None).0 < 0.12);
    }

    #[test]
    fn the_delay_of_a_ramp_is_the_one_documented() {
        let chain = GyroChain::new(&GyroConfig::FLIGHT);
        for rotor_hz in [None, Some(83.0), Some(120.0)] {
            let mut state = GyroState::NEW;
            let mut late_s = 0.0;
            for i in 0..1500_u16 {
                let now_us = u64::from(i) * 2000;
                if let Some(hz) = rotor_hz {
                    GyroChain::hear(&mut state, &[TAU * hz; ROTORS], now_us);
                }
                let x = f32::from(i) * 0.002;
                late_s = x - chain.step(&mut state, Vec3::new(x, 0.0, 0.0), now_us).x;
            }
            let documented_s = chain.delay_s(&state);
            // The bilinear transform shortens the delays of what is near the sampling by the ratio of tan x to x.
            assert!((0.75..=1.01).contains(&(late_s / documented_s)), "{rotor_hz:?}: {late_s} {documented_s}");
        }
    }

    #[test]
    fn a_notch_that_comes_and_goes_does_not_kick() {
        let chain = GyroChain::new(&GyroConfig::FLIGHT);
        let mut state = GyroState::NEW;
        let mut worst = 0.0_f32;
        for i in 0..4000_u64 {
            let now_us = i * 2000;
            if (i / 500) % 2 == 1 {
                GyroChain::hear(&mut state, &[300.0 + i as f32 * 0.1; ROTORS], now_us);
            }
            let y = chain.step(&mut state, Vec3::new(1.0, -2.0, 35.0), now_us);
            worst = worst.max((y.z - 35.0).abs());
        }
        assert!(worst < 1e-3, "{worst}");
    }

    #[test]
    fn a_notch_follows_its_rotor() {
        let chain = GyroChain::new(&GyroConfig::FLIGHT);
        let mut state = GyroState::NEW;
        let (mut phase, mut worst) = (0.0_f32, 0.0_f32);
        for i in 0..3000_u16 {
            // 60 to 120 Hz in six seconds.
            let hz = 60.0 + f32::from(i) * 0.02;
            phase = libm::fmodf(phase + hz * 0.002, 1.0);
            GyroChain::hear(&mut state, &[TAU * hz; ROTORS], u64::from(i) * 2000);
            let y = chain.step(&mut state, Vec3::new(libm::sinf(TAU * phase), 0.0, 0.0), u64::from(i) * 2000);
            if i > 200 {
                worst = worst.max(y.x.abs());
            }
        }
        assert!(worst < 0.02, "{worst}");
    }

    #[test]
    fn speeds_that_are_no_numbers_or_too_fast_have_no_notch() {
        let chain = GyroChain::new(&GyroConfig::FLIGHT);
        let mut state = GyroState::NEW;
        for i in 0..20_u64 {
            GyroChain::hear(&mut state, &[f32::NAN, f32::INFINITY, 1e9, 1.0], i * 2000);
            let y = chain.step(&mut state, Vec3::new(1.0, 1.0, 1.0), i * 2000);
            assert!((y.x - 1.0).abs() < 1e-5);
        }
        assert!(state.notches.iter().all(|notch| notch.turn_rad == 0.0));
    }
}
