//! Flight: what the image flies, as the core's [`Flight`] wants it. The same on the board and for whoever repeats its steps.
use core::mem::MaybeUninit;

use control_core::estimation::{EstimatorConfig, GyroConfig};
use control_core::flight::{Checked, Flight, FlightConfig, Unflyable};
use control_core::parameters::Parameters;
use control_core::{Airframe, Config, Regulators, RotorsConfig, SpinConfig};

use crate::icm42688;

/// Thrust over weight of the airframe that is flown.
pub const THRUST_TO_WEIGHT: f32 = 2.2;
/// The airframe that is flown.
const AIRFRAME: Airframe = Airframe::paper(THRUST_TO_WEIGHT);

/// Made by the compiler: the board would take 120 ms.
#[allow(long_running_const_eval, reason = "62 regulators of 12 doublings")]
static REGULATORS: Regulators =
    Regulators::new(&SpinConfig::NOMINAL, &AIRFRAME, RotorsConfig::ESTIMATED.motor_lag_s, icm42688::SAMPLE_HZ);

/// The flight of a board just switched on, with these parameters.
///
/// # Errors
/// [`Unflyable`] names the first value that cannot fly.
pub fn boot(parameters: &Parameters) -> Result<Flight, Unflyable> {
    checked(parameters).map(Checked::flight)
}

/// [`boot`] in its place for good: every move of a flight is 12 kB of the stack.
///
/// # Errors
/// As there.
pub fn boot_in<'a>(place: &'a mut MaybeUninit<Flight>, parameters: &Parameters) -> Result<&'a mut Flight, Unflyable> {
    checked(parameters).map(|checked| begin(place, checked))
}

fn checked(parameters: &Parameters) -> Result<Checked, Unflyable> {
    let gyro = GyroConfig { sample_hz: icm42688::SAMPLE_HZ, ..EstimatorConfig::FLIGHT.gyro };
    let config = FlightConfig {
        controller: Config { control_hz: icm42688::SAMPLE_HZ, ..Config::tolerant(AIRFRAME) },
        regulators: &REGULATORS,
        estimator: EstimatorConfig { gyro, ..EstimatorConfig::FLIGHT },
    };
    Checked::try_new(&config, parameters)
}

// Not inlined: what it takes of the stack must not be there while the flight is checked.
#[inline(never)]
fn begin(place: &mut MaybeUninit<Flight>, checked: Checked) -> &mut Flight {
    place.write(checked.flight())
}
