//! What the emulated board is told before its next period: how it moves, what is said over its lines, and what befalls it.
use super::kinds::{Health, Line, Mishap, Part, Telemetry};
use super::{Emulator, Motion};
use control_core::frames::{Attitude, Body, Vec3};
use control_core::geodesy::Geodetic;
use control_core::measurement::{Gnss, Vision};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use std::path::Path;

/// How many satellites a fix is said to be of.
const SATELLITES: u8 = 14;

impl Emulator {
    /// Puts an MPU-6000 in the place of the ICM-42688-P; before the first period.
    pub fn solder_mpu6000(&mut self) {
        self.say(b'i', [1]);
    }

    /// Switches the board on anew; its image takes its clock to have run for so many seconds.
    pub fn begin_after(&mut self, uptime_s: u32) {
        self.say(b'w', uptime_s.to_le_bytes());
    }

    /// Moves the body; holds.
    pub fn move_body(&mut self, motion: &Motion) {
        self.say(b'm', bytes_of(&[motion.force_m_s2, motion.rate_rad_s].concat()));
    }

    /// Sets how fast the rotors turn, rad/s; holds.
    pub fn turn_rotors(&mut self, rotor_rad_s: [f32; 4]) {
        self.say(b'r', bytes_of(&rotor_rad_s));
    }

    /// Sets how the speed controller of a motor, 0 to 3, answers; holds.
    pub fn set_telemetry(&mut self, motor: u8, telemetry: Telemetry) {
        self.say(b'q', [motor, telemetry as u8]);
    }

    /// Sets the battery's voltage, V, and the current out of it, A; holds.
    pub fn set_battery(&mut self, volts: f32, amperes: f32) {
        self.say(b'b', bytes_of(&[volts, amperes]));
    }

    /// Lets the radio receiver send a frame with these channels, 172 to 1811.
    pub fn send_channels(&mut self, channels: [u16; 16]) {
        self.say(b'c', channels.into_iter().flat_map(u16::to_le_bytes));
    }

    /// Sets the air at the barometer: static pressure, Pa, and temperature, °C; holds.
    pub fn set_air(&mut self, pressure_pa: f32, temperature_c: f32) {
        self.say(b'p', bytes_of(&[pressure_pa, temperature_c]));
    }

    /// Sets the magnetic field, µT; holds.
    pub fn set_field(&mut self, field_ut: Vec3<Body>) {
        self.say(b'g', bytes_of(&[field_ut.x, field_ut.y, field_ut.z]));
    }

    /// Lets the satellite receiver send a fix. Of `fix`, the position is left out: it is `place`.
    pub fn send_fix(&mut self, place: &Geodetic, fix: &Gnss) {
        let v = fix.velocity_m_s;
        let values = [place.altitude_m, v.x, v.y, v.z, fix.horizontal_m, fix.vertical_m, fix.speed_m_s];
        let mut numbers: Vec<u8> =
            [place.latitude_e7, place.longitude_e7].into_iter().flat_map(i32::to_le_bytes).collect();
        numbers.extend(bytes_of(&values));
        numbers.extend([if fix.fixed { 3 } else { 0 }, SATELLITES]);
        self.say(b'u', numbers);
    }

    /// Lets the vision computer send a pose that was true `age_us` ago.
    pub fn send_pose(&mut self, age_us: u32, pose: &Vision) {
        let (p, attitude) = (pose.position_m, quaternion(&pose.attitude));
        let mut numbers = age_us.to_le_bytes().to_vec();
        numbers.extend(bytes_of(&[p.x, p.y, p.z]));
        numbers.extend(bytes_of(&attitude));
        numbers.extend(bytes_of(&[pose.position_sigma_m, pose.attitude_sigma_rad]));
        self.say(b'v', numbers);
    }

    /// Sets how a part does; holds.
    pub fn set_health(&mut self, part: Part, health: Health) {
        self.say(b'd', [part as u8, health as u8]);
    }

    /// Lets bytes come over a line, whoever has sent them: up to 255.
    pub fn send_bytes(&mut self, line: Line, bytes: &[u8]) {
        let bytes = &bytes[..bytes.len().min(u8::MAX.into())];
        self.say(b't', [line as u8, bytes.len() as u8].into_iter().chain(bytes.iter().copied()));
    }

    /// Does something to the chip that no program should: see [`Mishap`].
    pub fn inflict(&mut self, mishap: Mishap) {
        self.say(b'f', [mishap as u8]);
    }

    /// From now on all that the core does takes so many percent of the cycles that it should.
    pub fn slow_down(&mut self, percent: u32) {
        self.say(b's', percent.to_le_bytes());
    }

    /// Cuts power, for a moment, after so many words programmed and sectors erased; `within`: the next one is done in part.
    pub fn cut_power_at(&mut self, after: u32, within: bool) {
        self.say(b'k', after.to_le_bytes().into_iter().chain([within.into()]));
    }

    /// Fills flash as somebody may have left it.
    pub fn fill_flash(&mut self, address: u32, bytes: &[u8]) {
        let header = [address, bytes.len() as u32].into_iter().flat_map(u32::to_le_bytes);
        self.say(b'e', header.chain(bytes.iter().copied()));
    }

    /// Puts a card into its slot, whose content is this file, or pulls the one that is there.
    pub fn put_card(&mut self, file: Option<&Path>) {
        self.say_path(b'o', file.unwrap_or(Path::new("")));
    }

    fn say_path(&mut self, kind: u8, file: &Path) {
        let path = file.to_string_lossy();
        let count = path.len() as u32;
        self.say(kind, count.to_le_bytes().into_iter().chain(path.bytes()));
    }

    /// Puts a log flash, whose content is this file of 16 MiB, in the place of the card's slot; before the first period.
    pub fn solder_log_flash(&mut self, file: &Path) {
        self.say_path(b'y', file);
    }

    /// Sets how long the card takes to program a block, or the log flash a page, µs: as a rule, and once in `long_every`.
    pub fn set_log_busy(&mut self, usual_us: u32, long_us: u32, long_every: u32) {
        self.say(b'j', [usual_us, long_us, long_every].into_iter().flat_map(u32::to_le_bytes));
    }

    /// Lets the station send these bytes, at most 255.
    pub fn send_station(&mut self, bytes: &[u8]) {
        self.say(b'l', [bytes.len() as u8].into_iter().chain(bytes.iter().copied()));
    }
}

/// The unit quaternion w, x, y, z of an attitude.
fn quaternion(attitude: &Attitude) -> [f32; 4] {
    let rows = attitude.rows.map(|row| row.map(f64::from));
    let matrix = Matrix3::from_fn(|row, column| rows[row][column]);
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    [q.w, q.i, q.j, q.k].map(|value| value as f32)
}

/// Numbers as the pipe carries them.
fn bytes_of(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}
