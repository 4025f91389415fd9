//! A descent without altitude: how hard the rotors pull where nothing knows the speed but the accelerometer.
//!
//! ```text
//! a = g + (R f)_z        v' = a − v / T        a_wanted = k (v_wanted − v)        lack' = k_l (a_wanted − a)
//!
//! thrust = m (g − a_wanted − lack)
//! ```
//!
//! The accelerometer is off, so its sum v fades, and the machine, which is held to v, gains v / T: 0.125 m/s² instead of falling, less or
//! more by what the accelerometer is off. The lack makes up for a thrust that is not what it is believed to be. On the ground, where
//! nothing accelerates, it takes the thrust back until the feet are known to stand.
//!
//! Invariant: the thrust is finite, and from 0.39 to 1.61 of the weight.
use crate::estimate::Estimate;
use crate::{GRAVITY_M_S2, Scalar};

/// v_wanted, m/s, and k, 1/s.
const SINK_M_S: f32 = 0.5;
const HELD_1_S: f32 = 2.0;
/// T, s: an accelerometer that is off by less than v_wanted / T, 0.125 m/s², cannot keep the machine up.
const FADES_S: f32 = 4.0;
/// Largest a_wanted, m/s², and velocity at which it may begin, m/s.
const WANTED_M_S2: f32 = 1.0;
const BEGUN_M_S: f32 = 3.0;
/// k_l, 1/s, and the largest lack, m/s².
const LACK_1_S: f32 = 3.0;
const LACK_M_S2: f32 = 5.0;

/// What it remembers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blind {
    /// v, m/s.
    down_m_s: f32,
    lack_m_s2: f32,
}

impl Blind {
    /// Begins at the last velocity that was believed.
    pub(super) fn begin(estimate: &Estimate) -> Self {
        let down_m_s = estimate.velocity_m_s.z;
        Self { down_m_s: if down_m_s.is_finite() { down_m_s.clamp_abs(BEGUN_M_S) } else { 0.0 }, lack_m_s2: 0.0 }
    }

    /// Thrust over weight for the next `dt_s`.
    pub(super) fn step(&mut self, estimate: &Estimate, dt_s: f32) -> f32 {
        let wanted_m_s2 = (HELD_1_S * (SINK_M_S - self.down_m_s)).clamp_abs(WANTED_M_S2);
        let down_m_s2 = GRAVITY_M_S2 + estimate.attitude.to_ned(estimate.specific_force_m_s2).z;
        if down_m_s2.is_finite() {
            self.down_m_s += (down_m_s2 - self.down_m_s / FADES_S) * dt_s;
            self.lack_m_s2 = (self.lack_m_s2 + LACK_1_S * (wanted_m_s2 - down_m_s2) * dt_s).clamp_abs(LACK_M_S2);
        }
        1.0 - (wanted_m_s2 + self.lack_m_s2) / GRAVITY_M_S2
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Health, Sigma};
    use crate::frames::{Attitude, Vec3};

    const DT_S: f32 = 0.002;

    /// What a level machine at `down_m_s` feels that accelerates at `down_m_s2`.
    fn felt(down_m_s: f32, down_m_s2: f32) -> Estimate {
        Estimate {
            time_us: 0,
            position_m: Vec3::zero(),
            velocity_m_s: Vec3::new(0.0, 0.0, down_m_s),
            attitude: Attitude::level(),
            rate_rad_s: Vec3::zero(),
            specific_force_m_s2: Vec3::new(0.0, 0.0, down_m_s2 - GRAVITY_M_S2),
            gyro_bias_rad_s: Vec3::zero(),
            accelerometer_bias_m_s2: Vec3::zero(),
            sigma: Sigma::default(),
            health: Health::default(),
        }
    }

    /// Time to come down by `height_m`, s, and speed then, m/s: from `begun_m_s`, with an accelerometer that reads `off_m_s2` too much
    /// down and rotors that make `share` of what is asked for.
    fn comes_down(height_m: f32, begun_m_s: f32, off_m_s2: f32, share: f32) -> (f32, f32) {
        let (mut down_m, mut down_m_s) = (0.0, begun_m_s);
        let mut blind = Blind::begin(&felt(begun_m_s, 0.0));
        let (mut weights, mut time_s) = (1.0, 0.0);
        while down_m < height_m && time_s < 100.0 {
            let down_m_s2 = GRAVITY_M_S2 * (1.0 - share * weights);
            weights = blind.step(&felt(f32::NAN, down_m_s2 + off_m_s2), DT_S);
            (down_m_s, time_s) = (down_m_s + down_m_s2 * DT_S, time_s + DT_S);
            down_m += down_m_s * DT_S;
        }
        (time_s, down_m_s)
    }

    #[test]
    fn it_comes_down_slowly_whatever_accelerometer_and_rotors_are_off_by() {
        for (height_m, begun_m_s, off_m_s2, share, most_m_s) in [
            (4.0, 0.0, 0.0, 1.0, 1.2),
            (10.0, 0.0, 0.0, 1.0, 1.8),
            (4.0, -2.0, 0.0, 1.0, 1.5),
            (4.0, 0.0, -0.1, 1.0, 1.6),
            (10.0, 0.0, 0.1, 1.0, 1.1),
            (4.0, 0.0, 0.0, 0.8, 2.0),
            (4.0, 0.0, 0.0, 1.2, 1.2),
        ] {
            let (time_s, down_m_s) = comes_down(height_m, begun_m_s, off_m_s2, share);
            let case = (height_m, begun_m_s, off_m_s2, share);
            assert!(time_s < 60.0 && (0.2..most_m_s).contains(&down_m_s), "{case:?}: {time_s} s, {down_m_s} m/s");
        }
    }

    #[test]
    fn on_the_ground_the_rotors_stop_pulling() {
        let mut blind = Blind::begin(&felt(0.0, 0.0));
        let weights = (0..1000).fold(1.0, |_, _| blind.step(&felt(0.0, 0.0), DT_S));
        assert!((0.38..0.5).contains(&weights), "{weights}");
    }

    #[test]
    fn nothing_that_is_felt_makes_it_other_than_a_number() {
        let mut blind = Blind::begin(&felt(f32::NAN, 0.0));
        for down_m_s2 in [f32::NAN, f32::INFINITY, -1e30, 0.0] {
            let weights = blind.step(&felt(0.0, down_m_s2), DT_S);
            assert!((0.38..1.62).contains(&weights), "{down_m_s2}: {weights}");
        }
    }
}
