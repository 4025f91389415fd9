//! Every metric: its name, what it says, and where it is.
use super::Metrics;

/// One metric: its name in JSON, what it is, and where it is.
pub struct Metric {
    /// Name with unit, as in JSON.
    pub name: &'static str,
    /// What it says, in words.
    pub title: &'static str,
    /// Its value in a flight; none if the flight has nothing to measure it on.
    pub of: fn(&Metrics) -> Option<f64>,
}

/// Every metric, in the order of tables.
pub static METRICS: [Metric; 19] = [
    Metric {
        name: "altitude_deviation_max_m",
        title: "largest |altitude error| during the faults",
        of: |m| m.altitude_deviation_max_m,
    },
    Metric {
        name: "lateral_deviation_max_m",
        title: "largest |north error| or |east error| during the faults",
        of: |m| m.lateral_deviation_max_m,
    },
    Metric {
        name: "yaw_deviation_max_rad",
        title: "largest |heading error| during the faults",
        of: |m| m.yaw_deviation_max_rad,
    },
    Metric {
        name: "altitude_rebound_max_m",
        title: "largest |altitude error| after the last fault has ended",
        of: |m| m.altitude_rebound_max_m,
    },
    Metric {
        name: "altitude_iae_m_s",
        title: "integral of |altitude error| from the first onset to the end of the flight",
        of: |m| m.altitude_iae_m_s,
    },
    Metric {
        name: "altitude_recovery_s",
        title: "from an onset to the last time outside ±0.1 m before the next; the longest, 0 if it never left",
        of: |m| m.altitude_recovery_s,
    },
    Metric {
        name: "altitude_overshoot_m",
        title: "largest overshoot of the first altitude step",
        of: |m| m.altitude_overshoot_m,
    },
    Metric {
        name: "motor_total_variation_n_s",
        title: "sum over rotors of |change of commanded thrust| per second of fault, N/s",
        of: |m| m.motor_total_variation_n_s,
    },
    Metric {
        name: "ki_ratio_z",
        title: "mean k_i of altitude in the last 5 s of the first fault over that in the last 5 s before it",
        of: |m| m.ki_ratio_z,
    },
    Metric {
        name: "lateral_limit_cycle_m",
        title: "half the peak-to-peak of the worse of north and east in the last 10 s before the first fault",
        of: |m| m.lateral_limit_cycle_m,
    },
    Metric {
        name: "altitude_drop_max_m",
        title: "farthest below the altitude setpoint during the faults",
        of: |m| m.altitude_drop_max_m,
    },
    Metric {
        name: "horizontal_excursion_max_m",
        title: "farthest from the setpoint in the horizontal plane during the faults",
        of: |m| m.horizontal_excursion_max_m,
    },
    Metric {
        name: "position_error_settled_m",
        title: "largest distance from the setpoint from 5 s after an onset until that fault's end",
        of: |m| m.position_error_settled_m,
    },
    Metric {
        name: "position_error_end_m",
        title: "distance from the setpoint 20 s after the last fault's end, or at the end of the flight if that is sooner",
        of: |m| m.position_error_end_m,
    },
    Metric {
        name: "tilt_max_rad",
        title: "largest angle of the rotors' axis to the vertical from the first onset on",
        of: |m| m.tilt_max_rad,
    },
    Metric {
        name: "yaw_rate_max_rad_s",
        title: "largest |yaw rate| from the first onset on",
        of: |m| m.yaw_rate_max_rad_s,
    },
    Metric {
        name: "lyapunov_rising_share",
        title: "share of the faults' time with V of altitude rising outside the boundary layer",
        of: |m| m.lyapunov_rising_share,
    },
    Metric {
        name: "gain_at_bound_share",
        title: "share of the flight with any gain on, or beyond, a bound of the robust law",
        of: |m| m.gain_at_bound_share,
    },
    Metric {
        name: "refused_share",
        title: "share of the faults' time with thrust, roll or pitch refused by the allocation",
        of: |m| m.refused_share,
    },
];

impl Metric {
    /// The metric of this JSON name.
    pub fn named(name: &str) -> Option<&'static Self> {
        METRICS.iter().find(|metric| metric.name == name)
    }
}
