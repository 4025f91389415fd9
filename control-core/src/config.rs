//! What a controller is built from, and the checks it must pass.
//!
//! Two cascades are shipped: [`Config::flight`], the one that flies, and [`Config::paper`], the set-up that reproduces
//! the paper's figures. Both give every law the same starting gains, so that only the law differs.
use crate::airframe::Airframe;
use crate::attitude::AttitudeGains;
use crate::law::{LgsGains, RawGains, TABLE_2_PSI, TABLE_2_X, TABLE_2_Y, TABLE_2_Z};
use crate::rotors::RotorsConfig;
use crate::spin::Regulators;
use crate::{GRAVITY_M_S2, Law};
use core::fmt;

/// How the outer loop commands the inner one, and what carries the weight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cascade {
    /// The paper's: the weight is added to u_z, tilt is commanded over thrust, rotors have no limit.
    Paper,
    /// What flies: the weight rides on the altitude integral, tilt is commanded over gravity, rotors saturate, the
    /// yaw guard and the gyroscopic feed-forward are on.
    Flight,
}

/// Everything about one outer axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisConfig {
    /// Starting gains (k_p, k_i, k_d), command units per unit of error.
    pub k0: [f32; 3],
    /// Robust adaptation; its λ also defines s for a fixed PID's telemetry.
    pub lgs: LgsGains,
    /// The paper's adaptation of k_p, k_i and k_d.
    pub raw: [RawGains; 3],
    /// Bound of |∫e|.
    pub integral_max: f32,
}

/// Gains of every loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// North; commands m/s².
    pub x: AxisConfig,
    /// East; commands m/s².
    pub y: AxisConfig,
    /// Altitude; commands N.
    pub z: AxisConfig,
    /// Heading; commands N m.
    pub psi: AxisConfig,
    /// Roll; commands N m.
    pub phi: AttitudeGains,
    /// Pitch; commands N m.
    pub theta: AttitudeGains,
}

/// A controller's configuration. Plain data; [`crate::Controller::try_new`] checks it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// The machine.
    pub airframe: Airframe,
    /// The law of the outer axes.
    pub law: Law,
    /// How the loops are joined.
    pub cascade: Cascade,
    /// Whether turning the machine turns its thrust: false only for the paper's eq 1, which forgets it.
    pub yaw_turns_thrust: bool,
    /// How the rotors are watched, or not at all.
    pub rotors: Option<RotorsConfig>,
    /// Gains of every loop.
    pub gains: Gains,
    /// Nominal tick rate, Hz.
    pub control_hz: f32,
    /// Corner of the low-pass on ė and ë, Hz.
    pub filter_hz: f32,
}

/// A configuration value that cannot fly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConfigError {
    /// The part it belongs to: an axis, `airframe`, `config`.
    pub part: &'static str,
    /// The field.
    pub field: &'static str,
    /// The value found.
    pub value: f32,
    /// What is allowed.
    pub allowed: &'static str,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { part, field, value, allowed } = self;
        write!(f, "{part}.{field} = {value}: must be {allowed}")
    }
}

impl core::error::Error for ConfigError {}

/// Refuses a value outside `low..=high`, or not a number.
fn within(
    (part, field): (&'static str, &'static str),
    value: f32,
    (low, high): (f32, f32),
    allowed: &'static str,
) -> Result<(), ConfigError> {
    if (low..=high).contains(&value) { Ok(()) } else { Err(ConfigError { part, field, value, allowed }) }
}

/// Largest value of any gain or parameter: the end of Q16.16, with room for a product.
const VALUE_MAX: f32 = 1e4;
/// Smallest value that is not zero: the gains of a machine of 30 g, k_i of its heading 8e-5, with room below.
///
/// Q16.16 resolves 1.5e-5: it flies such a gain coarsely, and one below half of that as zero. Those are for `f32`.
const VALUE_MIN: f32 = 1e-6;

/// Refuses what is not a number from [`VALUE_MIN`] to [`VALUE_MAX`].
pub(crate) fn positive(part: &'static str, field: &'static str, value: f32) -> Result<(), ConfigError> {
    within((part, field), value, (VALUE_MIN, VALUE_MAX), "a number from 0.000001 to 10000")
}

/// Refuses what is not a number from 0 to [`VALUE_MAX`].
fn not_negative(part: &'static str, field: &'static str, value: f32) -> Result<(), ConfigError> {
    within((part, field), value, (0.0, VALUE_MAX), "a number from 0 to 10000")
}

impl Airframe {
    /// Refuses a machine the allocation cannot fly.
    pub(crate) fn check(&self) -> Result<(), ConfigError> {
        const PART: &str = "airframe";
        positive(PART, "mass_kg", self.mass_kg)?;
        for inertia in self.inertia_kg_m2 {
            positive(PART, "inertia_kg_m2", inertia)?;
        }
        positive(PART, "torque_per_thrust_m", self.torque_per_thrust_m)?;
        not_negative(PART, "rotor_momentum", self.rotor_momentum)?;
        not_negative(PART, "thrust_n_min", self.thrust_n_min)?;
        for rotor in &self.rotors {
            let above_idle = (self.thrust_n_min.max(VALUE_MIN), VALUE_MAX);
            within((PART, "thrust_n_max"), rotor.thrust_n_max, above_idle, "above the idle thrust, at most 10000 N")?;
        }
        self.check_geometry()
    }

    fn check_geometry(&self) -> Result<(), ConfigError> {
        let [r1, r2, r3, r4] = &self.rotors;
        for (near, far) in [(r1, r3), (r2, r4)] {
            for (field, sum) in
                [("rotors.forward_m", near.forward_m + far.forward_m), ("rotors.right_m", near.right_m + far.right_m)]
            {
                within(("airframe", field), sum, (-1e-4, 1e-4), "opposite for rotors 1 and 3, and for 2 and 4")?;
            }
        }
        // Positive when the rotors are numbered right, front, left, back, or turned from there.
        let area_m2 = r1.right_m * r2.forward_m - r1.forward_m * r2.right_m;
        within(
            ("airframe", "rotors (area of arms 1 and 2, m²)"),
            area_m2,
            (1e-5, VALUE_MAX),
            "positive: arms cross, numbered counter-clockwise seen from above, starting on the right",
        )
    }
}

impl AxisConfig {
    /// Refuses gains that `law` cannot use.
    pub(crate) fn check(&self, part: &'static str, law: Law) -> Result<(), ConfigError> {
        for (field, value) in ["k0.p", "k0.i", "k0.d"].into_iter().zip(self.k0) {
            positive(part, field, value)?;
        }
        positive(part, "integral_max", self.integral_max)?;
        positive(part, "lgs.lambda", self.lgs.lambda)?;
        match law {
            Law::Pid => Ok(()),
            Law::Raw => self.raw.iter().try_for_each(|row| {
                positive(part, "raw.alpha", row.alpha)?;
                positive(part, "raw.beta", row.beta)?;
                positive(part, "raw.eps", row.eps)?;
                positive(part, "raw.lambda", row.lambda)?;
                not_negative(part, "raw.nu", row.nu)
            }),
            Law::Lgs => {
                let LgsGains { nu, alpha, beta, eps, lambda: _, dead_zone, leak_1_s, scale } = self.lgs;
                for (field, value) in ["lgs.nu.p", "lgs.nu.i", "lgs.nu.d"].into_iter().zip(nu) {
                    not_negative(part, field, value)?;
                }
                positive(part, "lgs.alpha", alpha)?;
                positive(part, "lgs.beta", beta)?;
                positive(part, "lgs.eps", eps)?;
                not_negative(part, "lgs.dead_zone", dead_zone)?;
                not_negative(part, "lgs.leak_1_s", leak_1_s)?;
                positive(part, "lgs.scale", scale)
            }
        }
    }
}

/// Mass the tables of docs/control-law.md are for, kg.
const TABLE_MASS_KG: f32 = 0.52;
/// Moments of inertia they are for, kg m²: m l² and 2 m l² of the paper's airframe.
const TABLE_INERTIA_KG_M2: [f32; 3] = [0.027_988_48, 0.027_988_48, 0.055_976_96];

impl AxisConfig {
    /// The same loop on a machine `ratio` times as heavy, or as inert: every command grows with it.
    fn scaled(mut self, ratio: f32) -> Self {
        self.k0 = self.k0.map(|k| k * ratio);
        self.lgs.nu = self.lgs.nu.map(|nu| nu * ratio);
        self.lgs.scale *= ratio;
        for row in &mut self.raw {
            row.nu *= ratio;
        }
        self
    }
}

impl AttitudeGains {
    pub(crate) fn scaled(self, ratio: f32) -> Self {
        Self { kp: self.kp * ratio, ki: self.ki * ratio, kd: self.kd * ratio }
    }
}

impl Gains {
    /// The robust law's table, scaled to the airframe by its mass and inertia.
    ///
    /// # Source
    /// docs/control-law.md, "lgs".
    pub fn flight(airframe: &Airframe) -> Self {
        let mass_ratio = airframe.mass_kg / TABLE_MASS_KG;
        let [ix, iy, iz] = airframe.inertia_kg_m2;
        let [tx, ty, tz] = TABLE_INERTIA_KG_M2;
        let attitude = AttitudeGains { kp: 3.0, ki: 1.0, kd: 0.6 };
        Self {
            x: HORIZONTAL,
            y: AxisConfig { raw: TABLE_2_Y, ..HORIZONTAL },
            z: ALTITUDE.scaled(mass_ratio),
            psi: HEADING.scaled(iz / tz),
            phi: attitude.scaled(ix / tx),
            theta: attitude.scaled(iy / ty),
        }
    }

    /// The flight table with other fixed gains (p, i, d) of x and y, z, psi, and of roll and pitch, scaled alike.
    fn fixed(airframe: &Airframe, outer: [[f32; 3]; 3], inner: AttitudeGains) -> Self {
        let flight = Self::flight(airframe);
        let [horizontal, altitude, heading] = outer;
        let mass_ratio = airframe.mass_kg / TABLE_MASS_KG;
        let [x_ratio, y_ratio, z_ratio] = core::array::from_fn(|i| airframe.inertia_kg_m2[i] / TABLE_INERTIA_KG_M2[i]);
        let with = |axis: AxisConfig, k0: [f32; 3], ratio| AxisConfig { k0: k0.map(|k| ratio * k), ..axis };
        Self {
            x: with(flight.x, horizontal, 1.0),
            y: with(flight.y, horizontal, 1.0),
            z: with(flight.z, altitude, mass_ratio),
            psi: with(flight.psi, heading, z_ratio),
            phi: inner.scaled(x_ratio),
            theta: inner.scaled(y_ratio),
        }
    }

    /// Baseline: gains by linear-quadratic regulation with integral action.
    ///
    /// # Source
    /// docs/control-law.md, "Baselines".
    pub fn lqi(airframe: &Airframe) -> Self {
        let outer = [[5.75, 1.41, 4.64], [27.88, 20.0, 9.43], [1.14, 0.22, 0.65]];
        Self::fixed(airframe, outer, AttitudeGains { kp: 3.0, ki: 1.0, kd: 0.6 })
    }

    /// Baseline: gains that an optimiser found on the fault of `flight.toml`.
    ///
    /// # Source
    /// docs/control-law.md, "Baselines".
    pub fn optimised(airframe: &Airframe) -> Self {
        let outer = [[11.12, 0.01, 7.9], [48.57, 88.8, 16.31], [1.23, 0.01, 0.46]];
        Self::fixed(airframe, outer, AttitudeGains { kp: 3.11, ki: 0.52, kd: 0.67 })
    }

    /// Starting gains of the paper's set-up, whose own are lost, and the inner PIDs of Table 2.
    ///
    /// # Source
    /// docs/control-law.md, "raw"; the paper, Table 2.
    pub fn paper(airframe: &Airframe) -> Self {
        let flight = Self::flight(airframe);
        let start = |axis: AxisConfig, k0| AxisConfig { k0, integral_max: 100.0, ..axis };
        Self {
            x: start(flight.x, [2.0, 0.4, 2.5]),
            y: start(flight.y, [2.0, 0.4, 2.5]),
            z: start(flight.z, [6.0, 3.0, 4.0]),
            psi: start(flight.psi, [0.6, 0.1, 0.4]),
            phi: AttitudeGains { kp: 4.5, ki: 1.5, kd: 1.5 },
            theta: AttitudeGains { kp: 3.5, ki: 0.5, kd: 2.0 },
        }
    }
}

/// x and y; the command is an acceleration, so no airframe scales it.
const HORIZONTAL: AxisConfig = AxisConfig {
    k0: [4.0, 0.5, 3.5],
    lgs: LgsGains {
        nu: [0.18, 0.014, 0.14],
        alpha: 1.0,
        beta: 0.3,
        eps: 0.25,
        lambda: 1.0,
        dead_zone: 0.3,
        leak_1_s: 0.05,
        scale: 3.0,
    },
    raw: TABLE_2_X,
    integral_max: 10.0,
};

const ALTITUDE: AxisConfig = AxisConfig {
    k0: [14.0, 10.0, 7.0],
    lgs: LgsGains {
        nu: [1.96, 90.0, 0.49],
        alpha: 4.0,
        beta: 2.0,
        eps: 0.25,
        lambda: 4.0,
        dead_zone: 0.3,
        leak_1_s: 0.01,
        scale: TABLE_MASS_KG * GRAVITY_M_S2,
    },
    raw: TABLE_2_Z,
    // Three times hover, so that fixed gains can carry the weight on a third of the thrust.
    integral_max: 3.0 * TABLE_MASS_KG * GRAVITY_M_S2 / 10.0,
};

const HEADING: AxisConfig = AxisConfig {
    k0: [1.0, 0.15, 0.45],
    lgs: LgsGains {
        nu: [0.56, 0.063, 0.11],
        alpha: 2.0,
        beta: 0.3,
        eps: 0.25,
        lambda: 2.0,
        dead_zone: 0.5,
        leak_1_s: 0.05,
        scale: 0.1,
    },
    raw: TABLE_2_PSI,
    integral_max: 1.0,
};

impl Config {
    /// The cascade that flies, at 500 Hz, with gains for `airframe`.
    pub fn flight(law: Law, airframe: Airframe) -> Self {
        Self {
            airframe,
            law,
            cascade: Cascade::Flight,
            yaw_turns_thrust: true,
            rotors: None,
            gains: Gains::flight(&airframe),
            control_hz: 500.0,
            filter_hz: 25.0,
        }
    }

    /// What flies a machine that may lose a rotor: the robust law on an incremental inner loop, which finds out how much thrust each rotor
    /// makes, and spins without one that makes too little. The controller `default`.
    pub fn tolerant(airframe: Airframe) -> Self {
        Self { rotors: Some(RotorsConfig::ESTIMATED), ..Self::flight(Law::Lgs, airframe) }
    }

    /// The set-up that reproduces the paper's figures, at 1 kHz.
    pub fn paper(law: Law, airframe: Airframe) -> Self {
        Self {
            cascade: Cascade::Paper,
            yaw_turns_thrust: false,
            gains: Gains::paper(&airframe),
            control_hz: 1000.0,
            ..Self::flight(law, airframe)
        }
    }

    /// The regulators with which it flies without a rotor, if it does: what takes longest of building a controller.
    pub fn regulators(&self) -> Option<Regulators> {
        let rotors = self.rotors?;
        Some(Regulators::new(&rotors.spin?, &self.airframe, rotors.motor_lag_s, self.control_hz))
    }

    /// Refuses rates that make no sense; parts check themselves.
    pub(crate) fn check_rates(&self) -> Result<(), ConfigError> {
        within(("config", "control_hz"), self.control_hz, (50.0, 8000.0), "from 50 to 8000 Hz")?;
        within(("config", "filter_hz"), self.filter_hz, (1.0, 2000.0), "from 1 to 2000 Hz")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Controller;
    use std::string::ToString;

    type Change = fn(&mut Config);

    #[test]
    fn the_first_value_that_cannot_fly_is_named() {
        let rows: [(&str, Change, &str); 8] = [
            ("a rate of zero", |c| c.control_hz = 0.0, "config.control_hz = 0: must be from 50 to 8000 Hz"),
            ("no mass", |c| c.airframe.mass_kg = f32::NAN, "airframe.mass_kg = NaN"),
            ("a rotor that cannot pull", |c| c.airframe.rotors[2].thrust_n_max = 0.0, "airframe.thrust_n_max = 0"),
            ("a rotor out of line", |c| c.airframe.rotors[3].forward_m = 0.1, "opposite for rotors 1 and 3"),
            ("rotors in the wrong order", |c| c.airframe.rotors.swap(1, 3), "counter-clockwise"),
            ("a negative gain", |c| c.gains.z.k0[1] = -1.0, "z.k0.i = -1"),
            ("no boundary layer", |c| c.gains.psi.lgs.eps = 0.0, "psi.lgs.eps = 0"),
            ("an infinite attitude gain", |c| c.gains.phi.kd = f32::INFINITY, "phi.kd = inf"),
        ];
        for (why, change, says) in rows {
            let mut config = Config::flight(Law::Lgs, Airframe::paper(2.2));
            change(&mut config);
            let error = Controller::<f32>::try_new(&config).map(|_| ()).expect_err(why).to_string();
            assert!(error.contains(says), "{why}: {error}");
        }
    }

    #[test]
    fn gains_of_a_small_machine_are_accepted_and_smaller_ones_named() {
        let mut config = Config::flight(Law::Lgs, Airframe::paper(2.2));
        config.gains.psi.k0[1] = 7.8e-5;
        assert!(Controller::<f32>::try_new(&config).is_ok());
        config.gains.psi.k0[1] = 9e-7;
        let error = Controller::<f32>::try_new(&config).map(|_| ()).expect_err("below the range").to_string();
        assert!(error.contains("psi.k0.i") && error.contains("from 0.000001 to 10000"), "{error}");
    }

    #[test]
    fn commands_scale_with_mass_and_inertia() {
        let mut heavy = Airframe::paper(2.2);
        heavy.mass_kg *= 2.0;
        let (light, heavy) = (Gains::flight(&Airframe::paper(2.2)), Gains::flight(&heavy));
        assert_eq!(heavy.z.k0, light.z.k0.map(|k| 2.0 * k));
        assert_eq!(heavy.x, light.x, "an acceleration does not depend on mass");
        assert!(Gains::flight(&Airframe::os4(2.2)).phi.kp < 0.25 * light.phi.kp);
    }
}
