//! The emulated board's parameters, as its image's own code stores them.
use super::Emulator;
use control_core::parameters::{TABLE, index_of};
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use firmware::stored::{SaveError, Stored};
use std::convert::Infallible;

/// Where they begin (firmware/src/board/speedybee_f405_v4.rs).
const START: u32 = 0x080c_0000;
/// Bytes of each of their two sectors.
pub const SECTOR_BYTES: usize = 128 * 1024;

/// The two sectors that hold them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Store(pub Vec<u8>);

impl Store {
    /// As a factory leaves them.
    pub fn erased() -> Self {
        Self(vec![0xff; 2 * SECTOR_BYTES])
    }

    /// As these saves leave them, each of a parameter's name and a value. A name that there is not is left out.
    ///
    /// # Errors
    /// [`SaveError`], which no such flash gives.
    pub fn after<'a>(saves: impl IntoIterator<Item = (&'a str, f32)>) -> Result<Self, SaveError> {
        let mut store = Self::erased();
        let mut stored = Stored::try_new(&mut store, 0..2 * SECTOR_BYTES as u32).ok_or(SaveError::Flash)?;
        for (name, value) in saves {
            if let Some(place) = index_of(name) {
                stored.save(&TABLE[place], value)?;
            }
        }
        Ok(store)
    }
}

impl Emulator {
    /// Fills the parameters' sectors, for the image to find when it starts.
    pub fn fill_store(&mut self, store: &Store) {
        self.fill_flash(START, &store.0);
    }
}

impl ErrorType for &mut Store {
    type Error = Infallible;
}

impl ReadNorFlash for &mut Store {
    const READ_SIZE: usize = 1;
    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        bytes.copy_from_slice(&self.0[offset as usize..][..bytes.len()]);
        Ok(())
    }
    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for &mut Store {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR_BYTES;
    fn erase(&mut self, from: u32, to: u32) -> Result<(), Infallible> {
        self.0[from as usize..to as usize].fill(0xff);
        Ok(())
    }
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        self.0[offset as usize..][..bytes.len()].copy_from_slice(bytes);
        Ok(())
    }
}
