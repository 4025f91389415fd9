//! What the world does to the board: motion, air, field, what receivers hear, and mishaps.
use super::Machine;
use super::wiring::{LOOP, RAM_START};
use crate::Failure;
use crate::board;
use crate::device::crsf;
use crate::device::esc::Telemetry;
use crate::device::log_flash::LogFlash;
use crate::device::sd_card::Busy;
use crate::device::sensor_bus::Health;
use crate::device::ublox::Fix;
use flight_link::{FRAME_BYTES_MAX, ToBoard, VisionPose, encode};
use std::path::Path;
use unicorn_engine::RegisterARM as R;

/// An address without memory.
const NOWHERE: u32 = 0x6000_0000;

/// A line over which bytes come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// The radio receiver's.
    Radio,
    /// The satellite receiver's.
    Gnss,
    /// The vision computer's.
    Vision,
}

/// A part of the slow sensors' bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The barometer.
    Barometer = 0,
    /// The magnetometer.
    Magnetometer = 1,
}

impl Machine {
    /// Tells the inertial unit how the body moves: forward, right, down; m/s² and rad/s.
    pub fn move_body(&mut self, force_m_s2: [f32; 3], rate_rad_s: [f32; 3]) {
        self.state.borrow_mut().chip.board.move_body(force_m_s2, rate_rad_s);
    }

    /// Sets how fast the rotors turn, rad/s.
    pub fn turn_rotors(&mut self, rotor_rad_s: [f32; 4]) {
        let escs = &mut self.state.borrow_mut().chip.board.escs;
        escs.iter_mut().zip(rotor_rad_s).for_each(|(esc, speed)| esc.rotor_rad_s = speed);
    }

    /// Sets how a motor's speed controller answers; there are four.
    pub fn set_telemetry(&mut self, motor: usize, telemetry: Telemetry) {
        if let Some(esc) = self.state.borrow_mut().chip.board.escs.get_mut(motor) {
            esc.telemetry = telemetry;
        }
    }

    /// Sets the battery's voltage, V, and the current out of it, A.
    pub fn set_battery(&mut self, volts: f32, amperes: f32) {
        self.state.borrow_mut().chip.board.battery = [volts, amperes];
    }

    /// Lets the radio receiver send a frame with these channels, 172 to 1811.
    pub fn send_channels(&mut self, channels: [u16; 16]) {
        self.state.borrow_mut().chip.hear(board::RADIO, &crsf::frame(channels), board::RADIO_BAUD);
    }

    /// Sets the air around the barometer: static pressure, Pa, and temperature, °C.
    pub fn set_air(&mut self, pressure_pa: f32, temperature_c: f32) {
        let chip = &mut self.state.borrow_mut().chip;
        chip.board.sensors.barometer.feel(pressure_pa, temperature_c, chip.now);
    }

    /// Sets the magnetic field: forward, right, down, µT.
    pub fn set_field(&mut self, field_ut: [f32; 3]) {
        let chip = &mut self.state.borrow_mut().chip;
        chip.board.set_field(field_ut, chip.now);
    }

    /// Lets the satellite receiver send a fix, unless it was told to send fewer.
    pub fn send_fix(&mut self, fix: &Fix) {
        let chip = &mut self.state.borrow_mut().chip;
        let bytes = chip.board.gnss.send(fix, chip.now);
        chip.hear(board::GNSS, &bytes, chip.board.gnss.baud);
    }

    /// Lets the vision computer send a pose.
    pub fn send_pose(&mut self, pose: VisionPose) {
        let mut place = [0; FRAME_BYTES_MAX];
        // A pose is far shorter than the longest frame.
        let frame = encode(&ToBoard::VisionPose(pose), &mut place).unwrap_or(&[]);
        self.state.borrow_mut().chip.hear(board::VISION, frame, board::VISION_BAUD);
    }

    /// Lets bytes come over a line, whoever has sent them.
    pub fn send_bytes(&mut self, line: Line, bytes: &[u8]) {
        let chip = &mut self.state.borrow_mut().chip;
        let (port, baud) = match line {
            Line::Radio => (board::RADIO, board::RADIO_BAUD),
            Line::Gnss => (board::GNSS, chip.board.gnss.baud),
            Line::Vision => (board::VISION, board::VISION_BAUD),
        };
        chip.hear(port, bytes, baud);
    }

    /// Sets how a part on its bus does.
    pub fn set_health(&mut self, part: Part, health: Health) {
        self.state.borrow_mut().chip.board.sensors.health[part as usize] = health;
    }

    /// Sends the core where there is no code.
    pub fn derail(&mut self) {
        self.close_here();
        self.cpu.set(R::PC, NOWHERE | 1);
    }

    /// Puts a card into its slot, whose content is this file, or pulls the one that is there.
    ///
    /// # Errors
    /// If the file cannot be opened.
    pub fn put_card(&mut self, file: Option<&Path>) -> Result<(), Failure> {
        let put = self.state.borrow_mut().chip.board.card.put(file);
        put.map_err(|error| Failure(format!("the card, {}: {error}", file.unwrap_or(Path::new("none")).display())))
    }

    /// Puts a log flash, whose content is this file, in the place of the card's slot; to be called before the image runs.
    ///
    /// # Errors
    /// If the file cannot be opened, or is not of the chip's size.
    pub fn solder_log_flash(&mut self, file: &Path) -> Result<(), Failure> {
        let flash = LogFlash::new(file, board::CYCLES_US);
        let flash = flash.map_err(|error| Failure(format!("the log flash, {}: {error}", file.display())))?;
        self.state.borrow_mut().chip.board.log_flash = Some(flash);
        Ok(())
    }

    /// Sets how long the card takes to program a block, or the log flash a page.
    pub fn set_log_busy(&mut self, busy: Busy) {
        let board = &mut self.state.borrow_mut().chip.board;
        match &mut board.log_flash {
            Some(flash) => flash.set_busy(busy),
            None => board.card.set_busy(busy),
        }
    }

    /// Lets the program hang where it is, interrupts masked or not.
    pub fn hang(&mut self, masked: bool) {
        self.close_here();
        self.cpu.set(R::PRIMASK, masked.into());
        self.cpu.set(R::PC, LOOP.0 | 1);
    }

    /// Uses the stack up but for a few words.
    pub fn exhaust_stack(&mut self) {
        self.close_here();
        self.cpu.set(R::SP, RAM_START + 16);
    }

    /// Breaks the inertial unit's data-ready line.
    pub fn break_data_ready(&mut self) {
        self.state.borrow_mut().chip.board.ready_line_broken = true;
    }

    /// Charges what has run, before the core is sent elsewhere.
    pub(super) fn close_here(&mut self) {
        let pc = self.cpu.register(R::PC);
        self.close(pc);
        self.asleep = None;
    }
}
