//! Devices behind the chip's pins, one file each.
pub(crate) mod crsf;
pub(crate) mod esc;
pub(crate) mod icm42688;
