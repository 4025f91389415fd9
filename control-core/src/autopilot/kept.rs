//! What of the autopilot's state survives an interruption in the air.
use super::{Arming, AutopilotState, Estimate, Feet, Home, Level, Mode, Pilot, Tape, Trust, believed};

impl AutopilotState {
    /// Whether it is armed, and in the air.
    pub(crate) fn flies(&self) -> bool {
        self.arming == Arming::Armed && !self.landed
    }

    /// What a board that was interrupted goes on from.
    pub(crate) fn pass(&mut self, tape: &mut Tape) {
        let mut aim = self.aim as usize;
        tape.index(&mut aim, Mode::ALL.len());
        self.aim = Mode::ALL.get(aim).copied().unwrap_or(self.aim);
        let Home { place_m, down_m } = self.home;
        let (mut placed, mut levelled) = (place_m.is_some(), down_m.is_some());
        let (mut place_m, mut down_m) = (place_m.unwrap_or_default(), down_m.unwrap_or_default());
        tape.bits([&mut placed, &mut levelled]);
        tape.floats(&mut place_m);
        tape.float(&mut down_m);
        self.home = Home { place_m: placed.then_some(place_m), down_m: levelled.then_some(down_m) };
        self.controller.pass(tape);
    }

    /// Takes what was kept of a board that was interrupted in the air, just after power-up.
    ///
    /// - `estimate`: that of the time.
    /// - `mode`: the pilot's last.
    pub(crate) fn go_on(&mut self, tape: &mut Tape, estimate: &Estimate, mode: Mode) {
        self.pass(tape);
        self.trust = Trust::at(Level::of(&believed(estimate)));
        self.pilot = Pilot::flying(mode);
        self.arming = Arming::Armed;
        (self.feet, self.landed) = (Feet::INTERRUPTED, false);
    }
}
