//! The board this image is for, chosen by a feature. Another board is another file here with the same items, a feature in
//! `Cargo.toml`, and its flash and RAM (docs/boards.md).
#[cfg(feature = "orbit-h743")]
mod orbit_h743;
#[cfg(feature = "speedybee-f405-v4")]
mod speedybee_f405_v4;

#[cfg(feature = "orbit-h743")]
pub(crate) use orbit_h743::*;
#[cfg(feature = "speedybee-f405-v4")]
pub(crate) use speedybee_f405_v4::*;
