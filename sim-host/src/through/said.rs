//! What is said to the emulated devices: sensors' readings as their parts sense them, sticks and switches as the radio carries them.
use crate::emulator::{Emulator, Health, Motion, Part, Telemetry};
use crate::sensors::{SensorKeys, pressure_pa};
use control_core::geodesy::{GeodesyError, Geodetic, LocalFrame};
use control_core::measurement::{Imu, Measurements};
use control_core::modes::Mode;
use control_core::pilot::{PilotInput, Sticks};

/// Samples of the inertial unit between two frames of the radio: 50 frames a second.
const RADIO_EVERY: u32 = 40;

/// Cycles that a core takes whose steps come late, of those that it should, percent: the image's longest step is a tenth shorter than its
/// period, the mean half.
const LATE_PERCENT: u32 = 400;
/// Temperature of the air, °C: the models of sensors know none.
const AIR_C: f32 = 20.0;
/// Where the world's origin is for a satellite receiver.
const HOME: Geodetic = Geodetic { latitude_e7: 473_977_000, longitude_e7: 85_456_000, altitude_m: 488.0 };

/// What was said, and when again.
pub(super) struct Said {
    samples: u32,
    late: bool,
    world: LocalFrame,
}

impl Said {
    /// Takes off the bus what the machine does not carry, and silences speed controllers that tell nothing.
    pub(super) fn new(emulator: &mut Emulator, keys: &SensorKeys) -> Result<Self, GeodesyError> {
        if keys.mag.is_none() {
            emulator.set_health(Part::Magnetometer, Health::Silent);
        }
        if keys.rotor_speed.is_none() {
            (0..4).for_each(|motor| emulator.set_telemetry(motor, Telemetry::Silent));
        }
        Ok(Self { samples: 0, late: false, world: LocalFrame::try_new(HOME)? })
    }

    /// Says what the sensors have measured at `t_s`, by their clock.
    pub(super) fn measure(&self, emulator: &mut Emulator, t_s: f64, measurements: &Measurements) {
        if let Some(imu) = measurements.imu {
            let Imu { rate_rad_s: r, specific_force_m_s2: f } = imu.value;
            emulator.move_body(&Motion { force_m_s2: [f.x, f.y, f.z], rate_rad_s: [r.x, r.y, r.z] });
        }
        if let Some(baro) = measurements.baro_altitude_m {
            emulator.set_air(pressure_pa(baro.value.into()) as f32, AIR_C);
        }
        if let Some(field) = measurements.magnetic_ut {
            emulator.set_field(field.value);
        }
        if let Some(gnss) = measurements.gnss {
            emulator.send_fix(&self.world.to_geodetic(gnss.value.position_m), &gnss.value);
        }
        if let Some(vision) = measurements.vision {
            let age_us = (1e6 * t_s).round() as u64;
            emulator.send_pose(age_us.saturating_sub(vision.time_us) as u32, &vision.value);
        }
        if let Some(rotors) = measurements.rotor_rad_s {
            emulator.turn_rotors(rotors.value);
        }
        if let (Some(battery_v), Some(battery_a)) = (measurements.battery_v, measurements.battery_a) {
            emulator.set_battery(battery_v.value, battery_a.value);
        }
    }

    /// Slows the core down while its steps are to come late.
    pub(super) fn late(&mut self, emulator: &mut Emulator, late: bool) {
        if late != self.late {
            self.late = late;
            emulator.slow_down(if late { LATE_PERCENT } else { 100 });
        }
    }

    /// Says what the pilot does, if he is heard and a frame is due; to be called once a sample.
    pub(super) fn pilot(&mut self, emulator: &mut Emulator, pilot: Option<PilotInput>) {
        if let Some(pilot) = pilot.filter(|_| self.samples.is_multiple_of(RADIO_EVERY)) {
            emulator.send_channels(channels(&pilot));
        }
        self.samples += 1;
    }
}

/// The receiver's channels as `firmware::pilot` reads them, 172 to 1811.
fn channels(pilot: &PilotInput) -> [u16; 16] {
    let PilotInput { sticks: Sticks { right, forward, clockwise, throttle }, arm, mode } = *pilot;
    let ticks = |position: f32| (992.0 + 819.5 * position.clamp(-1.0, 1.0)).round() as u16;
    let (low, middle, high) = (-1.0, 0.0, 1.0);
    // Those that no switch has are refused with the scenario.
    let (mode, by_itself) = match mode {
        Mode::AltitudeHold => (middle, low),
        Mode::PositionHold => (high, low),
        Mode::TakeOff => (low, middle),
        Mode::Return => (low, high),
        _ => (low, low),
    };
    let mut channels = [ticks(low); 16];
    let arm = if arm { high } else { low };
    let positions = [right, forward, 2.0 * throttle - 1.0, clockwise, arm, mode, by_itself];
    for (channel, position) in channels.iter_mut().zip(positions) {
        *channel = ticks(position);
    }
    channels
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::crsf::Channels;

    #[test]
    fn what_the_pilot_does_is_what_the_image_reads() {
        let sticks = Sticks { right: 0.25, forward: -0.5, clockwise: 1.0, throttle: 0.75 };
        for mode in [Mode::Angle, Mode::AltitudeHold, Mode::PositionHold, Mode::TakeOff, Mode::Return] {
            for arm in [false, true] {
                let sent = channels(&PilotInput { sticks, arm, mode });
                let read = Channels(sent.map(|ticks| ((f32::from(ticks) - 992.0) / 820.0).clamp(-1.0, 1.0)));
                let read = firmware::pilot::input(&read);
                assert_eq!((read.arm, read.mode), (arm, mode));
                let near = |a: f32, b: f32| (a - b).abs() < 2e-3;
                assert!(near(read.sticks.right, 0.25) && near(read.sticks.forward, -0.5), "{read:?}");
                assert!(near(read.sticks.clockwise, 1.0) && near(read.sticks.throttle, 0.75), "{read:?}");
            }
        }
    }
}
