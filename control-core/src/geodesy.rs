//! From degrees on the ellipsoid to metres from home.
//!
//! ```text
//! north = (M + h) Δφ        east = (N + h) cos φ₀ Δλ        down = h₀ − h
//! M = a (1 − e²) / w³        N = a / w        w² = 1 − e² sin² φ₀
//! ```
//!
//! Differences are taken of integers, 1e-7 degrees each (11 mm), before anything is rounded: `f32` would resolve a longitude to a metre only.
//! The metres of a step are off by 5e-7 of themselves, 0.5 mm at 1 km. The plane is tangent at home. What that neglects grows with the square of the distance d: the bend of the earth, d² / 2R, is not
//! corrected, since heights are above the ellipsoid all the way; the meridians' convergence is 0.08 m at 1 km from home at 45 degrees.
//!
//! Source: WGS 84 (NIMA TR8350.2), a = 6378137 m, e² = 0.006694379990.
use crate::Scalar;
use crate::frames::{Ned, Vec3};
use crate::math::quarter_sin_and_cos;
use core::fmt;

const SEMI_MAJOR_M: f32 = 6_378_137.0;
const ECCENTRICITY_SQUARED: f32 = 0.006_694_38;
/// Radians of 1e-7 degrees.
const RAD: f32 = core::f32::consts::PI / 1.8e9;
/// Latitude beyond which east has no metres any more, 1e-7 degrees.
const LATITUDE_MAX: i32 = 850_000_000;
const LONGITUDE_MAX: i32 = 1_800_000_000;
const TURN: i64 = 3_600_000_000;
/// Lowest and highest places, m.
const ALTITUDE_M: core::ops::RangeInclusive<f32> = -1000.0..=20_000.0;

/// A place as receivers report it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    /// Latitude, 1e-7 degrees, north positive.
    pub latitude_e7: i32,
    /// Longitude, 1e-7 degrees, east positive.
    pub longitude_e7: i32,
    /// Height above the ellipsoid, m.
    pub altitude_m: f32,
}

/// A local frame: north, east and down from home.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    home: Geodetic,
    /// Metres of 1e-7 degrees north, and east.
    north_m: f32,
    east_m: f32,
}

/// A place that no local frame can be laid at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GeodesyError {
    /// Latitude beyond ±85 degrees: east has no length there.
    Latitude(i32),
    /// Longitude beyond ±180 degrees.
    Longitude(i32),
    /// Height out of range, or not a number.
    Altitude(f32),
}

impl fmt::Display for GeodesyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Latitude(e7) => write!(f, "latitude = {e7}e-7 degrees: must be within ±85 degrees"),
            Self::Longitude(e7) => write!(f, "longitude = {e7}e-7 degrees: must be within ±180 degrees"),
            Self::Altitude(m) => write!(f, "altitude = {m} m: must be from -1000 to 20000"),
        }
    }
}

impl core::error::Error for GeodesyError {}

impl Geodetic {
    /// Refuses what is no place to fly.
    fn check(&self) -> Result<(), GeodesyError> {
        if !(-LATITUDE_MAX..=LATITUDE_MAX).contains(&self.latitude_e7) {
            return Err(GeodesyError::Latitude(self.latitude_e7));
        }
        if !(-LONGITUDE_MAX..=LONGITUDE_MAX).contains(&self.longitude_e7) {
            return Err(GeodesyError::Longitude(self.longitude_e7));
        }
        if !ALTITUDE_M.contains(&self.altitude_m) {
            return Err(GeodesyError::Altitude(self.altitude_m));
        }
        Ok(())
    }
}

impl LocalFrame {
    /// Lays a frame at `home`.
    ///
    /// # Errors
    /// [`GeodesyError`] names what of `home` is out of range.
    pub fn try_new(home: Geodetic) -> Result<Self, GeodesyError> {
        home.check()?;
        // From the pole, since there the cosine is small and must be known to a share of itself.
        let from_pole_rad = (TURN / 4 - i64::from(home.latitude_e7).abs()) as f32 * RAD;
        let (cos, sin) = quarter_sin_and_cos(from_pole_rad);
        let w2 = 1.0 - ECCENTRICITY_SQUARED * sin * sin;
        let normal_m = SEMI_MAJOR_M / Scalar::sqrt(w2);
        let meridian_m = normal_m * (1.0 - ECCENTRICITY_SQUARED) / w2;
        Ok(Self {
            home,
            north_m: (meridian_m + home.altitude_m) * RAD,
            east_m: (normal_m + home.altitude_m) * cos * RAD,
        })
    }

    /// Where it was laid.
    pub fn home(&self) -> Geodetic {
        self.home
    }

    /// Where `place` is from home, m; the short way over the date line.
    ///
    /// # Errors
    /// [`GeodesyError`] names what of `place` is out of range.
    pub fn to_ned(&self, place: &Geodetic) -> Result<Vec3<Ned>, GeodesyError> {
        place.check()?;
        let north = i64::from(place.latitude_e7) - i64::from(self.home.latitude_e7);
        let east = i64::from(place.longitude_e7) - i64::from(self.home.longitude_e7);
        let east = (east + TURN / 2).rem_euclid(TURN) - TURN / 2;
        Ok(Vec3::new(north as f32 * self.north_m, east as f32 * self.east_m, self.home.altitude_m - place.altitude_m))
    }

    /// The place at `position_m` from home; the inverse of [`Self::to_ned`], to within 1e-7 degrees within 10 km.
    pub fn to_geodetic(&self, position_m: Vec3<Ned>) -> Geodetic {
        let step = |home: i32, m: f32, unit_m: f32| i64::from(home) + libm::roundf(m / unit_m) as i64;
        let longitude = step(self.home.longitude_e7, position_m.y, self.east_m);
        Geodetic {
            latitude_e7: step(self.home.latitude_e7, position_m.x, self.north_m) as i32,
            longitude_e7: ((longitude + TURN / 2).rem_euclid(TURN) - TURN / 2) as i32,
            altitude_m: self.home.altitude_m - position_m.z,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    /// Earth-centred coordinates in f64, the textbook's closed form.
    fn centred(place: &Geodetic) -> [f64; 3] {
        let (a, e2) = (6_378_137.0_f64, 0.006_694_379_990);
        let rad = core::f64::consts::PI / 1.8e9;
        let (phi, lambda) = (f64::from(place.latitude_e7) * rad, f64::from(place.longitude_e7) * rad);
        let (h, n) = (f64::from(place.altitude_m), a / libm::sqrt(1.0 - e2 * libm::sin(phi) * libm::sin(phi)));
        [
            (n + h) * libm::cos(phi) * libm::cos(lambda),
            (n + h) * libm::cos(phi) * libm::sin(lambda),
            (n * (1.0 - e2) + h) * libm::sin(phi),
        ]
    }

    /// North and east in the tangent plane, in f64.
    fn tangent(home: &Geodetic, place: &Geodetic) -> [f64; 2] {
        let rad = core::f64::consts::PI / 1.8e9;
        let (phi, lambda) = (f64::from(home.latitude_e7) * rad, f64::from(home.longitude_e7) * rad);
        let (p, h) = (centred(place), centred(home));
        let [x, y, z] = core::array::from_fn(|i| p[i] - h[i]);
        let (sp, cp, sl, cl) = (libm::sin(phi), libm::cos(phi), libm::sin(lambda), libm::cos(lambda));
        [-sp * cl * x - sp * sl * y + cp * z, -sl * x + cl * y]
    }

    #[test]
    fn a_kilometre_is_a_kilometre_wherever_home_is() {
        for latitude_e7 in [-700_000_000, -337_000_000, 0, 481_234_567, 800_000_000] {
            let home = Geodetic { latitude_e7, longitude_e7: 115_678_901, altitude_m: 450.0 };
            let frame = LocalFrame::try_new(home).expect("a place");
            for (north, east) in [(1000.0, 0.0), (0.0, 1000.0), (-700.0, 700.0), (1.0, -1.0)] {
                let place = frame.to_geodetic(Vec3::new(north, east, -30.0));
                let found = frame.to_ned(&place).expect("a place");
                assert!((found.x - north).abs() < 0.02 && (found.y - east).abs() < 0.02, "{found:?}");
                let want = tangent(&home, &place);
                let off = (f64::from(found.x) - want[0]).abs().max((f64::from(found.y) - want[1]).abs());
                assert!(off < 0.5, "{latitude_e7} {north} {east}: {off}");
            }
        }
    }

    #[test]
    fn metres_of_a_step_are_off_by_half_a_millimetre_at_a_kilometre() {
        let (a, e2, rad) = (6_378_137.0_f64, 0.006_694_379_990, core::f64::consts::PI / 1.8e9);
        let mut worst = 0.0_f64;
        for step in -8_500..=8_500_i32 {
            let home = Geodetic {
                latitude_e7: 100_000 * step + 12_345 * (1 - step.signum()),
                longitude_e7: 0,
                altitude_m: 300.0,
            };
            let Ok(LocalFrame { north_m, east_m, .. }) = LocalFrame::try_new(home) else { continue };
            let (sin, cos) =
                (libm::sin(f64::from(home.latitude_e7) * rad), libm::cos(f64::from(home.latitude_e7) * rad));
            let w2 = 1.0 - e2 * sin * sin;
            let normal_m = a / libm::sqrt(w2);
            let north = (normal_m * (1.0 - e2) / w2 + 300.0) * rad;
            let east = (normal_m + 300.0) * cos * rad;
            let off = (f64::from(north_m) / north - 1.0).abs().max((f64::from(east_m) / east - 1.0).abs());
            worst = worst.max(off);
        }
        assert!(worst < 5e-7, "{worst}");
    }

    #[test]
    fn a_step_of_the_receiver_is_a_step_of_the_frame() {
        let home = Geodetic { latitude_e7: 481_234_567, longitude_e7: 115_678_901, altitude_m: 450.0 };
        let frame = LocalFrame::try_new(home).expect("a place");
        let next = frame.to_ned(&Geodetic { longitude_e7: home.longitude_e7 + 1, ..home }).expect("a place");
        assert!((next.y - 0.0074).abs() < 1e-4, "{next:?}");
    }

    #[test]
    fn the_date_line_is_crossed_the_short_way() {
        let home = Geodetic { latitude_e7: 0, longitude_e7: 1_799_999_990, altitude_m: 0.0 };
        let frame = LocalFrame::try_new(home).expect("a place");
        let over = Geodetic { longitude_e7: -1_799_999_990, ..home };
        assert!((frame.to_ned(&over).expect("a place").y - 0.2226).abs() < 1e-3);
        assert_eq!(frame.to_geodetic(Vec3::new(0.0, 0.2226, 0.0)).longitude_e7, over.longitude_e7);
    }

    #[test]
    fn places_that_are_none_are_refused_by_name() {
        let good = Geodetic { latitude_e7: 0, longitude_e7: 0, altitude_m: 0.0 };
        for (bad, says) in [
            (Geodetic { latitude_e7: i32::MAX, ..good }, "latitude = 2147483647e-7 degrees: must be within ±85"),
            (Geodetic { longitude_e7: i32::MIN, ..good }, "longitude = -2147483648e-7 degrees"),
            (Geodetic { altitude_m: f32::NAN, ..good }, "altitude = NaN m: must be from -1000 to 20000"),
        ] {
            assert!(LocalFrame::try_new(bad).expect_err(says).to_string().contains(says), "{says}");
        }
    }
}
