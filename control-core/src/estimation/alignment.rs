//! The first attitude: down by the accelerometer at rest, north by external vision or the magnetic field.
//!
//! A window of [`WINDOW_S`] is rest if no rate in it exceeds the bias of a part, no force differs from gravity by more than one, and neither
//! wanders by more than noise: a hover in the air does. Its mean rate then is the gyro's bias, its mean force points up. Who waits longer than
//! [`PATIENCE_S`] is not at rest: the machine was switched on, or its board started again, in the air; then the last window's force has to do.
use super::quaternion::{Quaternion, to_body};
use crate::frames::{Attitude, Body, Ned, Vec3};
use crate::measurement::Imu;
use crate::{GRAVITY_M_S2, Scalar};

/// Rest that is averaged, s.
const WINDOW_S: f32 = 0.5;
/// Rest without a heading, or motion, that is borne, s.
const PATIENCE_S: f32 = 3.0;
/// Rate at rest, with the largest bias of a part, rad/s.
const STILL_RAD_S: f32 = 0.15;
/// What the specific force at rest may differ from gravity, m/s².
const STILL_M_S2: f32 = 1.0;

/// Standard deviation over a window, all axes together, that is still noise, rad/s and m/s².
const WANDER_RAD_S: f32 = 0.02;
const WANDER_M_S2: f32 = 0.3;

/// Mean and deviation of a vector, summed from the first sample on, so that squares of gravity do not hide those of noise.
#[derive(Clone, Copy, Debug)]
struct Moments {
    first: Vec3<Body>,
    sum: Vec3<Body>,
    squares: f32,
}

impl Moments {
    const EMPTY: Self = Self { first: Vec3::zero(), sum: Vec3::zero(), squares: 0.0 };

    fn add(&mut self, v: Vec3<Body>, is_first: bool) {
        if is_first {
            self.first = v;
        }
        let off = v - self.first;
        self.sum = self.sum + off;
        self.squares += off.norm_squared();
    }

    fn mean(&self, samples: f32) -> Vec3<Body> {
        self.first + self.sum * (1.0 / samples)
    }

    fn wanders(&self, samples: f32, most: f32) -> bool {
        let mean = self.sum * (1.0 / samples);
        self.squares / samples - mean.norm_squared() > most * most
    }
}

/// Samples of a window, summed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Alignment {
    rates: Moments,
    forces: Moments,
    samples: f32,
    window_s: f32,
    waited_s: f32,
    still: bool,
}

/// What a window says.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rest {
    /// Mean rate: at rest, the gyro's bias, rad/s.
    pub(crate) rate_rad_s: Vec3<Body>,
    /// Mean specific force, m/s².
    pub(crate) force_m_s2: Vec3<Body>,
    /// Whether it was rest at all.
    pub(crate) still: bool,
    /// Whether there has been enough waiting for something better.
    pub(crate) impatient: bool,
}

impl Alignment {
    /// Nothing summed.
    pub(crate) const NEW: Self =
        Self { rates: Moments::EMPTY, forces: Moments::EMPTY, samples: 0.0, window_s: 0.0, waited_s: 0.0, still: true };

    /// Adds a sample; returns what the window says when it is full.
    pub(crate) fn add(&mut self, imu: &Imu, dt_s: f32) -> Option<Rest> {
        let weight = Scalar::sqrt(imu.specific_force_m_s2.norm_squared());
        self.still &=
            imu.rate_rad_s.norm_squared() < STILL_RAD_S * STILL_RAD_S && (weight - GRAVITY_M_S2).abs() < STILL_M_S2;
        let is_first = self.samples == 0.0;
        self.rates.add(imu.rate_rad_s, is_first);
        self.forces.add(imu.specific_force_m_s2, is_first);
        self.samples += 1.0;
        self.window_s += dt_s;
        self.waited_s += dt_s;
        if self.window_s < WINDOW_S {
            return None;
        }
        let n = self.samples;
        let calm = !self.rates.wanders(n, WANDER_RAD_S) && !self.forces.wanders(n, WANDER_M_S2);
        let rest = Rest {
            rate_rad_s: self.rates.mean(n),
            force_m_s2: self.forces.mean(n),
            still: self.still && calm,
            impatient: self.waited_s >= PATIENCE_S,
        };
        *self = Self { waited_s: self.waited_s, ..Self::NEW };
        Some(rest)
    }
}

/// The attitude in which `force_m_s2` points up and `towards`, in body axes, lies over the horizontal direction `heading`.
///
/// - `heading`: unit vector north and east.
/// - Returns `None` where a vector vanishes or both are parallel.
pub(crate) fn attitude(force_m_s2: Vec3<Body>, towards: Vec3<Body>, heading: [f32; 2]) -> Option<Quaternion> {
    let down = unit(-force_m_s2)?;
    let right = unit(down.cross(towards))?;
    let ahead = right.cross(down);
    let [north, east] = heading;
    let blend = |a: f32, b: f32| ahead * a + right * b;
    let (n, e) = (blend(north, -east), blend(east, north));
    Some(Quaternion::of(&Attitude { rows: [[n.x, n.y, n.z], [e.x, e.y, e.z], [down.x, down.y, down.z]] }))
}

/// The attitude in which `force_m_s2` points up and the nose points as in `seen`.
pub(crate) fn attitude_as_seen(force_m_s2: Vec3<Body>, seen: &Attitude) -> Option<Quaternion> {
    attitude(force_m_s2, to_body(seen, Vec3::<Ned>::new(1.0, 0.0, 0.0)), [1.0, 0.0])
}

fn unit<F: Copy>(v: Vec3<F>) -> Option<Vec3<F>> {
    let square = v.norm_squared();
    (square > 1e-6 && square < 1e12).then(|| v * (1.0 / Scalar::sqrt(square)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turned(x: f32, y: f32, z: f32) -> Quaternion {
        Quaternion::exp(Vec3::<Ned>::new(x, y, z))
    }

    #[test]
    fn force_and_field_give_the_attitude_they_were_seen_in() {
        let earth = Vec3::<Ned>::new(20.0, 4.0, 44.0);
        let length = libm::sqrtf(20.0 * 20.0 + 4.0 * 4.0);
        for q in [turned(0.0, 0.0, 0.0), turned(0.3, -0.2, 0.9), turned(0.0, 0.0, 0.9).after(turned(0.2, 0.0, 0.9))] {
            let a = q.attitude();
            let force = to_body(&a, Vec3::new(0.0, 0.0, -GRAVITY_M_S2));
            let by_field = attitude(force, to_body(&a, earth), [20.0 / length, 4.0 / length]).expect("two directions");
            let by_sight = attitude_as_seen(force, &a).expect("two directions");
            for found in [by_field, by_sight] {
                let off = found.after(q.inverse()).small_angle::<Ned>();
                assert!(off.norm_squared() < 1e-11, "{off:?}");
            }
        }
        assert!(attitude(Vec3::zero(), Vec3::new(1.0, 0.0, 0.0), [1.0, 0.0]).is_none());
        assert!(attitude(Vec3::new(0.0, 0.0, -9.8), Vec3::new(0.0, 0.0, 1.0), [1.0, 0.0]).is_none());
    }

    #[test]
    fn rest_is_told_from_motion() {
        // What a window of half a second shows in which every fifth sample is odd.
        let imu = |rate: f32, force: f32| Imu {
            rate_rad_s: Vec3::new(rate, 0.0, 0.0),
            specific_force_m_s2: Vec3::new(0.0, 0.0, -force),
        };
        for (why, odd, still) in [
            ("at rest", imu(0.01, 9.8), true),
            ("a turn within", imu(0.3, 9.8), false),
            ("a push within", imu(0.01, 12.0), false),
            ("a turn no larger than a bias, that comes and goes", imu(0.1, 9.8), false),
            ("a sway of a hover", imu(0.01, 9.0), false),
            ("noise", imu(0.03, 9.9), true),
        ] {
            let mut alignment = Alignment::NEW;
            let window = (0..260).find_map(|i| alignment.add(&if i % 5 == 1 { odd } else { imu(0.01, 9.8) }, 0.002));
            assert_eq!(window.expect("half a second").still, still, "{why}");
        }
    }
}
