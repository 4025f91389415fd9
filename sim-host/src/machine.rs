//! The machine in its air, tick by tick: what faults leave of its rotors, what is true, what the commands do until the next tick.
//!
//! ```text
//! look: faults of this tick ─► truth        act: command ─► drives ─► one control period ─► the next gust
//! ```
//!
//! Who decides between the two is none of its business: a controller, the autopilot, or an image on an emulated chip.
use crate::aboard::Aboard;
use crate::actuators::{Actuators, Drive, Told, Vibration};
use crate::flight::{Flight, Stream, random};
use crate::ground::Ground;
use crate::plant::{Actuation, Plant, RigidPlant, Truth};
use crate::scenario::Scenario;
use crate::sensors::{Carrier, World};
use crate::vehicle::Vehicle;
use crate::wind::{Gust, Gusts};

/// Plant, actuators with their faults, and wind.
pub(crate) struct Machine<'a> {
    scenario: &'a Scenario,
    seed: u64,
    pub(crate) vehicle: Vehicle,
    ground: Ground,
    plant: Box<dyn Plant>,
    gusts: Gusts,
    calm: Gust,
    actuators: Actuators,
    actuation: Actuation,
    /// A tick, s.
    pub(crate) dt_s: f64,
}

/// What is true at a tick.
pub(crate) struct Moment {
    pub(crate) t_s: f64,
    pub(crate) truth: Truth,
    /// Share of its thrust each rotor still makes.
    pub(crate) effectiveness: [f64; 4],
    /// What each rotor's speed would make in thrust, without a fault, N.
    rotor_n: [f64; 4],
}

impl<'a> Machine<'a> {
    /// In a hover where the reference begins.
    pub(crate) fn hovering(flight: &Flight<'a>) -> Self {
        let scenario = flight.scenario;
        let place =
            |vehicle: &Vehicle, ground| scenario.plant.hovering(vehicle, ground, scenario.reference.start_altitude_m());
        Self::new(flight, place, |actuators| actuators, |actuators| actuators.hovering())
    }

    /// On the ground, rotors at rest.
    pub(crate) fn standing(flight: &Flight<'a>) -> Self {
        let place = |vehicle: &Vehicle, ground: Ground| {
            let plant: Box<dyn Plant> =
                Box::new(RigidPlant::standing(vehicle, ground, ground.standing_m().unwrap_or_default()));
            plant
        };
        Self::new(flight, place, Actuators::at_rest, |actuators| actuators.drive([0.0; 4]))
    }

    fn new(
        flight: &Flight<'a>,
        place: impl FnOnce(&Vehicle, Ground) -> Box<dyn Plant>,
        settle: impl FnOnce(Actuators) -> Actuators,
        drive: impl FnOnce(&mut Actuators) -> [Drive; 4],
    ) -> Self {
        let Flight { scenario, seed, .. } = *flight;
        let vehicle = scenario.vehicle();
        let ground = Ground { altitude_m: scenario.ground_altitude_m };
        let dt_s = 1.0 / scenario.control_hz();
        let mut gusts = Gusts::new(scenario.wind, random(seed, Stream::Wind), random(seed, Stream::Torque));
        let mut actuators = settle(Actuators::new(&vehicle, &scenario.fault, dt_s, random(seed, Stream::Fault)));
        Self {
            plant: place(&vehicle, ground),
            actuation: Actuation { drives: drive(&mut actuators), gust: gusts.step(dt_s) },
            scenario,
            seed,
            vehicle,
            ground,
            gusts,
            calm: Gust::default(),
            actuators,
            dt_s,
        }
    }

    /// Ticks of the whole flight.
    pub(crate) fn ticks(&self) -> usize {
        (self.scenario.duration_s * self.scenario.control_hz()).round() as usize
    }

    /// Sensors and estimator, if the scenario names any. Those that are flown have seen the start for a while.
    pub(crate) fn aboard(&self) -> Option<Aboard> {
        let keys = self.scenario.sensors.as_ref()?;
        let mut aboard = Aboard::new(keys, &self.scenario.sensor_fault, &self.carrier());
        aboard.hold(&self.held(&self.start()));
        Some(aboard)
    }

    /// What its sensors are made for.
    pub(crate) fn carrier(&self) -> Carrier<'_> {
        Carrier {
            vehicle: &self.vehicle,
            ground_altitude_m: self.ground.altitude_m,
            control_hz: self.scenario.control_hz(),
            seed: self.seed,
        }
    }

    /// What is true before the flight.
    pub(crate) fn start(&self) -> Truth {
        self.plant.truth(&self.actuation)
    }

    /// What sensors feel while the machine is held as it is at the start, in air that stands.
    pub(crate) fn held<'t>(&'t self, start: &'t Truth) -> World<'t> {
        let (vibration, voltage) = (self.actuators.vibration(), self.actuators.voltage());
        World { t_s: 0.0, truth: start, vibration, rotor_n: &start.thrust_n, gust: &self.calm, voltage }
    }

    /// Lets the faults of this tick act, and looks.
    pub(crate) fn look(&mut self, tick: usize) -> Moment {
        let t_s = tick as f64 * self.dt_s;
        let effectiveness = self.actuators.advance(t_s, &self.plant.rotor_n(&self.actuation));
        for (drive, share) in self.actuation.drives.iter_mut().zip(effectiveness) {
            drive.share = share;
        }
        let (truth, rotor_n) = (self.plant.truth(&self.actuation), self.plant.rotor_n(&self.actuation));
        Moment { t_s, truth, effectiveness, rotor_n }
    }

    /// What sensors feel at a moment.
    pub(crate) fn world<'t>(&'t self, moment: &'t Moment) -> World<'t> {
        World {
            t_s: moment.t_s,
            truth: &moment.truth,
            vibration: self.actuators.vibration(),
            rotor_n: &moment.rotor_n,
            gust: &self.actuation.gust,
            voltage: self.actuators.voltage(),
        }
    }

    /// What is told of the faults, and what an oracle would be.
    pub(crate) fn told(&self) -> Told {
        self.actuators.told()
    }

    /// What damaged propellers shake.
    pub(crate) fn vibration(&self) -> &Vibration {
        self.actuators.vibration()
    }

    /// Flies on under these commands until the next tick; `hand_nm` is how hard a hand then rocks it about its forward axis.
    pub(crate) fn act(&mut self, command_n: [f64; 4], hand_nm: f64) {
        self.actuation.drives = self.actuators.drive(command_n);
        self.plant.advance(&self.actuation, self.dt_s, self.scenario.plant_steps);
        self.actuation.gust = self.gusts.step(self.dt_s);
        self.actuation.gust.torque_nm.x += hand_nm;
    }
}
