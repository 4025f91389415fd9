//! Before take-off: the machine stands on its feet in still air, and the core's wiring check pulses its rotors.
//!
//! Its faults are those of the flight's first instant, held. Nothing here touches the flight's random numbers: the gyro's
//! noise has a stream of its own.
use crate::actuators::Actuators;
use crate::flight::{Stream, random};
use crate::ground::Ground;
use crate::plant::{Actuation, Plant, RigidPlant, Truth};
use crate::scenario::Scenario;
use crate::sensors::Sensors;
use crate::wind::Gust;
use control_core::{WiringCheck, WiringFault};

/// Pulses every rotor of the standing machine; `observe` sees every tick. There is no check without ground.
///
/// # Errors
/// What is wrong with the wiring.
pub fn check(scenario: &Scenario, seed: u64, observe: &mut dyn FnMut(&Truth)) -> Result<(), WiringFault> {
    let ground = Ground { altitude_m: scenario.ground_altitude_m };
    let Some(altitude_m) = ground.standing_m() else { return Ok(()) };
    let vehicle = scenario.vehicle();
    let dt_s = 1.0 / scenario.control_hz();
    let mut plant = RigidPlant::standing(&vehicle, ground, altitude_m);
    let mut sensors = Sensors::new(scenario.noise, random(seed, Stream::Preflight));
    let mut actuators = Actuators::new(&vehicle, &scenario.fault, dt_s, random(seed, Stream::Fault)).at_rest();
    let mut actuation = Actuation { drives: actuators.drive([0.0; 4]), gust: Gust::default() };
    let target = scenario.reference.target(0.0);
    let mut check = WiringCheck::new(&vehicle.airframe());
    loop {
        let shares = actuators.advance(0.0, &plant.rotor_n(&actuation));
        for (drive, share) in actuation.drives.iter_mut().zip(shares) {
            drive.share = share;
        }
        let truth = plant.truth(&actuation);
        observe(&truth);
        let input = sensors.sample(&truth, actuators.vibration(), &target, dt_s);
        let thrust_n = check.tick(input.rate_rad_s, input.dt_s);
        if let Some(verdict) = check.verdict() {
            return verdict;
        }
        actuation.drives = actuators.drive(thrust_n.map(f64::from));
        plant.advance(&actuation, dt_s, scenario.plant_steps);
    }
}
