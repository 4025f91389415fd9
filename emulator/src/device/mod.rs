//! Devices behind the chip's pins, one file each.
pub(crate) mod crsf;
pub(crate) mod dps310;
pub(crate) mod esc;
pub(crate) mod inertial_unit;
pub(crate) mod log_flash;
pub(crate) mod qmc5883l;
pub(crate) mod sd_card;
pub(crate) mod sensor_bus;
pub(crate) mod ublox;

/// A device that shows registers. `None` for what of them is not modelled.
pub(crate) trait Registers {
    /// Reads a register at a time, core cycles.
    fn read(&mut self, register: u8, now: u64) -> Option<u8>;
    /// Writes one.
    fn write(&mut self, register: u8, value: u8, now: u64) -> Option<()>;
}
