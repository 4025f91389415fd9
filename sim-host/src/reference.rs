//! Where the machine is told to be, over time.
//!
//! Positions are (north, east, altitude) in metres, as in every scenario key; flights start at (0, 0, 0).
use control_core::frames::Vec3;
use control_core::{GRAVITY_M_S2, Setpoint};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// `[reference]`: the setpoint over time.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reference {
    /// Stay.
    Hover(Hover),
    /// Stay at the origin, then jump.
    Step(Step),
    /// Circle and climb.
    Helix(Helix),
    /// Swing to and fro.
    Weave(Weave),
    /// Jump from point to point.
    Waypoints(Vec<Waypoint>),
}

/// Keys of a hover, which starts in place.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Hover {
    /// Altitude, m; the flight starts there.
    pub altitude_m: f64,
}

/// Keys of a step.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// When it jumps, s.
    pub at_s: f64,
    /// To where: north, east, altitude, m.
    pub position_m: [f64; 3],
    /// To which heading, rad.
    #[serde(default)]
    pub yaw_rad: f64,
}

/// Keys of a helix: still at the origin, then round a centre that lies to the north.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Helix {
    /// When it starts, s.
    pub at_s: f64,
    /// Radius, m.
    pub radius_m: f64,
    /// Horizontal speed, m/s, reached over the first `blend_s`.
    pub speed_m_s: f64,
    /// Climb rate, m/s, likewise.
    #[serde(default)]
    pub climb_m_s: f64,
    /// Time to come up to speed, s.
    #[serde(default = "blend_s")]
    pub blend_s: f64,
}

fn blend_s() -> f64 {
    3.0
}

/// Keys of a weave: still in place, then to and fro along a line, so that the machine tilts as a sine.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Weave {
    /// When it starts, s.
    pub at_s: f64,
    /// Altitude, m; the flight starts there.
    #[serde(default)]
    pub altitude_m: f64,
    /// Largest tilt that it takes, reached over the first `blend_s`, rad.
    pub tilt_rad: f64,
    /// How often, Hz.
    pub frequency_hz: f64,
    /// Direction of the line, from north to east, rad.
    #[serde(default)]
    pub direction_rad: f64,
    /// Time to come up to the whole swing, s.
    #[serde(default = "blend_s")]
    pub blend_s: f64,
}

/// One point of a path.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Waypoint {
    /// When the setpoint jumps there, s.
    pub at_s: f64,
    /// North, east, altitude, m.
    pub position_m: [f64; 3],
    /// Heading, rad.
    #[serde(default)]
    pub yaw_rad: f64,
}

/// A setpoint in f64: north, east, altitude.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Target {
    /// m.
    pub position_m: [f64; 3],
    /// m/s.
    pub velocity_m_s: [f64; 3],
    /// m/s².
    pub acceleration_m_s2: [f64; 3],
    /// rad in −π..=π.
    pub yaw_rad: f64,
}

impl Target {
    fn at(position_m: [f64; 3], yaw_rad: f64) -> Self {
        Self { position_m, yaw_rad: wrap_pi(yaw_rad), ..Self::default() }
    }

    /// What the controller is told.
    pub fn setpoint(&self) -> Setpoint {
        let ned = |[north, east, up]: [f64; 3]| Vec3::new(north as f32, east as f32, -up as f32);
        Setpoint {
            position_m: ned(self.position_m),
            velocity_m_s: ned(self.velocity_m_s),
            acceleration_m_s2: ned(self.acceleration_m_s2),
            yaw_rad: self.yaw_rad as f32,
            yaw_rate_rad_s: 0.0,
        }
    }
}

/// `angle_rad` less whole turns, in −π..π.
pub fn wrap_pi(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(TAU) - PI
}

impl Reference {
    /// The setpoint at `t_s`.
    pub fn target(&self, t_s: f64) -> Target {
        match self {
            Self::Hover(hover) => Target::at([0.0, 0.0, hover.altitude_m], 0.0),
            Self::Step(step) if t_s < step.at_s => Target::default(),
            Self::Step(step) => Target::at(step.position_m, step.yaw_rad),
            Self::Helix(helix) => helix.target(t_s),
            Self::Weave(weave) => weave.target(t_s),
            Self::Waypoints(points) => points
                .iter()
                .rev()
                .find(|point| point.at_s <= t_s)
                .map_or_else(Target::default, |point| Target::at(point.position_m, point.yaw_rad)),
        }
    }

    /// Times at which the setpoint jumps, s, ascending.
    pub fn jumps_s(&self) -> Vec<f64> {
        match self {
            Self::Hover(_) | Self::Helix(_) | Self::Weave(_) => Vec::new(),
            Self::Step(step) => vec![step.at_s],
            Self::Waypoints(points) => points.iter().map(|point| point.at_s).collect(),
        }
    }

    /// Altitude at which the flight starts, m.
    pub fn start_altitude_m(&self) -> f64 {
        match self {
            Self::Hover(hover) => hover.altitude_m,
            Self::Weave(weave) => weave.altitude_m,
            Self::Step(_) | Self::Helix(_) | Self::Waypoints(_) => 0.0,
        }
    }
}

impl Helix {
    /// Along the helix the speed rises as a raised cosine, so position, velocity and acceleration are continuous.
    fn target(&self, t_s: f64) -> Target {
        let since_s = (t_s - self.at_s).max(0.0);
        let share = (since_s / self.blend_s).min(1.0);
        // Distance covered at unit speed, speed and acceleration of the blend.
        let path = self.blend_s * (share / 2.0 - libm::sin(PI * share) / TAU) + (since_s - self.blend_s).max(0.0);
        let pace = 0.5 - 0.5 * libm::cos(PI * share);
        let gain = if share < 1.0 { 0.5 * PI / self.blend_s * libm::sin(PI * share) } else { 0.0 };

        let turn = self.speed_m_s / self.radius_m;
        let (sin, cos) = (libm::sin(turn * path), libm::cos(turn * path));
        let (v, a, centripetal) = (self.speed_m_s * pace, self.speed_m_s * gain, self.speed_m_s * turn * pace * pace);
        Target {
            position_m: [self.radius_m * (1.0 - cos), self.radius_m * sin, self.climb_m_s * path],
            velocity_m_s: [v * sin, v * cos, self.climb_m_s * pace],
            acceleration_m_s2: [a * sin + centripetal * cos, a * cos - centripetal * sin, self.climb_m_s * gain],
            yaw_rad: 0.0,
        }
    }
}

impl Weave {
    /// The swing grows by a polynomial that starts and ends without slope or curvature: the acceleration is continuous.
    fn target(&self, t_s: f64) -> Target {
        let since_s = (t_s - self.at_s).max(0.0);
        let share = (since_s / self.blend_s).min(1.0);
        let rest = 1.0 - share;
        let size = share.powi(3) * (10.0 - 15.0 * share + 6.0 * share * share);
        let growth = 30.0 * (share * rest).powi(2) / self.blend_s;
        let growth_rate = 60.0 * share * rest * (rest - share) / (self.blend_s * self.blend_s);

        let omega = TAU * self.frequency_hz;
        let reach_m = f64::from(GRAVITY_M_S2) * libm::tan(self.tilt_rad) / (omega * omega);
        let (sin, cos) = (libm::sin(omega * since_s), libm::cos(omega * since_s));
        let (north, east) = (libm::cos(self.direction_rad), libm::sin(self.direction_rad));
        let along = |distance: f64| [reach_m * distance * north, reach_m * distance * east, 0.0];
        let [x, y, _] = along(size * sin);
        Target {
            position_m: [x, y, self.altitude_m],
            velocity_m_s: along(growth * sin + size * omega * cos),
            acceleration_m_s2: along(growth_rate * sin + 2.0 * growth * omega * cos - size * omega * omega * sin),
            yaw_rad: 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_smooth(reference: &Reference) {
        let h = 1e-4;
        for t_s in [0.5, 1.7, 2.9, 3.8, 9.0] {
            let [before, here, after] = [t_s - h, t_s, t_s + h].map(|t| reference.target(t));
            for i in 0..3 {
                let slope = (after.position_m[i] - before.position_m[i]) / (2.0 * h);
                let curve = (after.velocity_m_s[i] - before.velocity_m_s[i]) / (2.0 * h);
                assert!((slope - here.velocity_m_s[i]).abs() < 1e-6, "velocity at {t_s}");
                assert!((curve - here.acceleration_m_s2[i]).abs() < 1e-6, "acceleration at {t_s}");
            }
        }
    }

    #[test]
    fn helix_velocity_and_acceleration_are_the_slopes_of_its_position() {
        let helix = Helix { at_s: 1.0, radius_m: 2.0, speed_m_s: 1.5, climb_m_s: 0.2, blend_s: 3.0 };
        assert_smooth(&Reference::Helix(helix));
    }

    const WEAVE: Weave =
        Weave { at_s: 1.0, altitude_m: 10.0, tilt_rad: 0.3, frequency_hz: 0.5, direction_rad: 0.5, blend_s: 3.0 };

    #[test]
    fn weave_velocity_and_acceleration_are_the_slopes_of_its_position() {
        assert_smooth(&Reference::Weave(WEAVE));
    }

    #[test]
    fn weave_starts_in_place_and_takes_the_stated_tilt() {
        let weave = Reference::Weave(WEAVE);
        assert_eq!(weave.target(0.9).position_m, [0.0, 0.0, weave.start_altitude_m()]);
        let tilt_rad = |i: u32| {
            let [north, east, _] = weave.target(4.0 + f64::from(i) * 0.01).acceleration_m_s2;
            libm::atan(libm::hypot(north, east) / f64::from(GRAVITY_M_S2))
        };
        let most = (0..200).map(tilt_rad).fold(0.0, f64::max);
        assert!((most - 0.3).abs() < 1e-3, "{most}");
    }

    #[test]
    fn waypoints_hold_until_the_next() {
        let point = |at_s, north| Waypoint { at_s, position_m: [north, 0.0, 1.0], yaw_rad: 4.0 };
        let path = Reference::Waypoints(vec![point(1.0, 1.0), point(3.0, 2.0)]);
        assert_eq!(path.target(0.5), Target::default());
        assert_eq!(path.target(2.9).position_m[0], 1.0);
        assert_eq!(path.target(3.0).position_m[0], 2.0);
        assert!((path.target(3.0).yaw_rad - (4.0 - TAU)).abs() < 1e-12);
    }
}
