//! The board this image is for. Another board is another file here with the same items, selected below; its flash and
//! RAM go to `memory.x`.
mod speedybee_f405_v4;

pub(crate) use speedybee_f405_v4::*;
