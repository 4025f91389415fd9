//! Stored parameters: those that somebody has set, in two sectors of flash.
//!
//! ```text
//! key = schema, name        value = f32
//! ```
//!
//! Each save appends an item with checksums of its own; the newest that is whole counts. So a save that power interrupts
//! leaves the old value or the new one. When a sector is full, the newest of each key move to the other one and the full one
//! is erased. A sector counts as full at [`PAGE`] bytes: what is in it is searched item by item, for each item when they move.
//! What was set under another schema, and not again under this one, is refused like a value outside its range: its default is
//! not what somebody chose. Items of names that are not declared any more mean nothing.
//!
//! On a chip with one bank of flash the program stands still while a sector is erased, for a second or two, longer than the
//! watchdog waits. So erasing is allowed only until [`Stored::stop_erasing`]; after that, a save that needs it is refused with
//! [`SaveError::NeedsErase`], harms nothing, and succeeds at the next boot.
//!
//! Sectors that are damaged, or full of items that mean nothing, are erased both before the values are written again: power that
//! is cut then, for up to four seconds, loses them, and the next start finds defaults.
//!
//! Invariant: what [`Stored::load`] returns is in its ranges.
//!
//! # Source
//! Of the layout in flash: the crate `sequential-storage`.
use core::ops::Range;

use control_core::parameters::{COUNT, Declaration, NAME_LENGTH_MAX, Parameters};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use sequential_storage::Error;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};

/// To be raised when a stored number means something else than it did.
pub const SCHEMA: u8 = 1;

/// Bytes of a sector that are used.
pub const PAGE: usize = 4_096;

/// Schema and name, filled up with zeros.
type Key = [u8; 1 + NAME_LENGTH_MAX];
/// Bytes for key and value, and what is missing to a word of the flash, of up to 32.
const BUFFER: usize = 64;
/// Bytes of an item's header.
const HEADER: usize = 8;

/// What was found at boot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loaded {
    /// Values: stored ones where there are any, else defaults.
    pub parameters: Parameters,
    /// How many are stored.
    pub set: usize,
    /// How many of these were refused, outside their range or of another schema: their defaults hold.
    pub refused: usize,
    /// The sectors held something else, or were damaged beyond repair, and were erased.
    pub lost: bool,
}

impl Loaded {
    /// Whether everything that was stored holds.
    pub fn is_valid(&self) -> bool {
        self.refused == 0 && !self.lost
    }
}

/// Why a value was not saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SaveError {
    /// A sector must be erased first, which is not allowed any more.
    NeedsErase,
    /// The flash does not do what it should.
    Flash,
}

/// The parameters' sectors.
pub struct Stored<S: NorFlash> {
    map: MapStorage<Key, Sectors<S>, Cache<Uncached, Uncached, Uncached, Key>>,
}

impl<S: NorFlash> Stored<S> {
    /// All items, one that is saved anew, and a sector's two marks fit a page, in whole words of this flash.
    const FITS: () = {
        let item = HEADER.next_multiple_of(S::WRITE_SIZE) + (size_of::<Key>() + 4).next_multiple_of(S::WRITE_SIZE);
        assert!((COUNT + 1) * item + 2 * S::WRITE_SIZE <= PAGE, "the parameters do not fit a page of this flash");
    };

    /// The parameters in these bytes of a flash: two of its sectors.
    ///
    /// Returns none if they are not two, or smaller than a [`PAGE`].
    pub fn try_new(flash: S, range: Range<u32>) -> Option<Self> {
        let () = Self::FITS;
        let sector = S::ERASE_SIZE as u32;
        let two = range.start.is_multiple_of(sector) && range.end.checked_sub(range.start) == Some(2 * sector);
        let config = MapConfig::try_new(0..2 * PAGE as u32).ok()?;
        let sectors = Sectors { flash, start: range.start, may_erase: true };
        (two && S::ERASE_SIZE >= PAGE).then(|| Self { map: MapStorage::new(sectors, config, Cache::new_uncached()) })
    }

    /// Reads all that is stored. Where that cannot be read the sectors are erased, if they may be.
    pub async fn load(&mut self) -> Loaded {
        if let Some(loaded) = self.read().await {
            return loaded;
        }
        // If that fails, so does every save.
        let _ = self.map.erase_all().await;
        Loaded { parameters: Parameters::default(), set: 0, refused: 0, lost: true }
    }

    async fn read(&mut self) -> Option<Loaded> {
        let mut buffer = [0; BUFFER];
        let mut parameters = Parameters::default();
        let mut found = [None; COUNT];
        let mut items = self.map.fetch_all_items(&mut buffer).await.ok()?;
        // The newest of a key comes last.
        while let Some((key, value)) = items.next::<f32>(&mut buffer).await.ok()? {
            let place = parameters.iter().position(|(declaration, _)| self::key(declaration)[1..] == key[1..]);
            if let Some(found) = place.and_then(|place| found.get_mut(place)) {
                // Of another schema is something, and no number.
                *found = if key[0] == SCHEMA { Some(value) } else { found.or(Some(f32::NAN)) };
            }
        }
        let values = found.into_iter().enumerate();
        let refused = values.filter(|&(n, v)| v.is_some_and(|v| parameters.set_at(n, v).is_err())).count();
        Some(Loaded { parameters, set: found.iter().flatten().count(), refused, lost: false })
    }

    /// Saves one value, which must be in its range.
    ///
    /// # Errors
    /// [`SaveError`]; the value before holds then.
    pub async fn save(&mut self, declaration: &Declaration, value: f32) -> Result<(), SaveError> {
        match self.append(declaration, value).await {
            Ok(()) => Ok(()),
            Err(Error::Corrupted { .. } | Error::FullStorage) if self.map.flash().may_erase => {
                self.start_anew(declaration, value).await.map_err(|_| SaveError::Flash)
            }
            Err(
                Error::Corrupted { .. } | Error::FullStorage | Error::Storage { value: SectorsError::MayNotErase, .. },
            ) => Err(SaveError::NeedsErase),
            Err(_) => Err(SaveError::Flash),
        }
    }

    async fn append(&mut self, declaration: &Declaration, value: f32) -> Result<(), Error<SectorsError<S::Error>>> {
        self.map.store_item(&mut [0; BUFFER], &key(declaration), &value).await
    }

    /// Erases sectors that cannot be written any more, and saves all that can be read from them again.
    async fn start_anew(&mut self, declaration: &Declaration, value: f32) -> Result<(), Error<SectorsError<S::Error>>> {
        let before = self.read().await.map_or_else(Parameters::default, |loaded| loaded.parameters);
        self.map.erase_all().await?;
        for (known, kept) in before.iter().filter(|(known, kept)| known.default != *kept) {
            self.append(known, kept).await?;
        }
        self.append(declaration, value).await
    }

    /// From now on nothing is erased.
    pub fn stop_erasing(&mut self) {
        self.map.flash().may_erase = false;
    }
}

fn key(declaration: &Declaration) -> Key {
    let mut key = [0; 1 + NAME_LENGTH_MAX];
    key[0] = SCHEMA;
    for (place, byte) in key[1..].iter_mut().zip(declaration.name.bytes()) {
        *place = byte;
    }
    key
}

/// The first [`PAGE`] bytes of each of the sectors, one after the other; erased only while that may be.
#[derive(Debug)]
struct Sectors<S> {
    flash: S,
    /// Where the first sector begins.
    start: u32,
    may_erase: bool,
}

/// What a [`Sectors`] does not do.
#[derive(Clone, Copy, Debug)]
enum SectorsError<E> {
    Flash(E),
    MayNotErase,
}

impl<E: NorFlashError> NorFlashError for SectorsError<E> {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Flash(error) => error.kind(),
            Self::MayNotErase => NorFlashErrorKind::Other,
        }
    }
}

impl<S: NorFlash> Sectors<S> {
    /// Where in the flash a place is.
    fn place(&self, offset: u32) -> u32 {
        let page = PAGE as u32;
        self.start + offset / page * S::ERASE_SIZE as u32 + offset % page
    }
}

impl<S: ErrorType> ErrorType for Sectors<S> {
    type Error = SectorsError<S::Error>;
}

impl<S: NorFlash> ReadNorFlash for Sectors<S> {
    const READ_SIZE: usize = S::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.flash.read(self.place(offset), bytes).await.map_err(SectorsError::Flash)
    }

    fn capacity(&self) -> usize {
        2 * PAGE
    }
}

impl<S: NorFlash> NorFlash for Sectors<S> {
    const WRITE_SIZE: usize = S::WRITE_SIZE;
    const ERASE_SIZE: usize = PAGE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        if !self.may_erase {
            return Err(SectorsError::MayNotErase);
        }
        for page in (from..to).step_by(PAGE) {
            let sector = self.place(page);
            self.flash.erase(sector, sector + S::ERASE_SIZE as u32).await.map_err(SectorsError::Flash)?;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        self.flash.write(self.place(offset), bytes).await.map_err(SectorsError::Flash)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use control_core::parameters::TABLE;
    use embassy_futures::block_on;
    use std::vec;
    use std::vec::Vec;

    /// A sector that is not theirs, and two that are.
    const SECTOR: usize = 2 * PAGE;

    struct Ram(Vec<u8>);

    #[derive(Debug)]
    struct Never;

    impl NorFlashError for Never {
        fn kind(&self) -> NorFlashErrorKind {
            NorFlashErrorKind::Other
        }
    }

    impl ErrorType for Ram {
        type Error = Never;
    }

    impl ReadNorFlash for Ram {
        const READ_SIZE: usize = 1;
        async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Never> {
            bytes.copy_from_slice(&self.0[offset as usize..][..bytes.len()]);
            Ok(())
        }
        fn capacity(&self) -> usize {
            self.0.len()
        }
    }

    impl NorFlash for Ram {
        const WRITE_SIZE: usize = 4;
        const ERASE_SIZE: usize = SECTOR;
        async fn erase(&mut self, from: u32, to: u32) -> Result<(), Never> {
            self.0[from as usize..to as usize].fill(0xff);
            Ok(())
        }
        async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Never> {
            for (place, byte) in self.0[offset as usize..].iter_mut().zip(bytes) {
                *place &= byte;
            }
            Ok(())
        }
    }

    fn stored(bytes: Vec<u8>) -> Stored<Ram> {
        Stored::try_new(Ram(bytes), SECTOR as u32..3 * SECTOR as u32).expect("two sectors")
    }

    fn bytes(stored: Stored<Ram>) -> Vec<u8> {
        stored.map.destroy().0.flash.0
    }

    #[test]
    fn only_two_whole_sectors_will_do() {
        let one = SECTOR as u32;
        for range in [0..one, 0..3 * one, 1..2 * one + 1, one..0] {
            assert!(Stored::try_new(Ram(Vec::new()), range.clone()).is_none(), "{range:?}");
        }
    }

    #[test]
    fn what_is_saved_is_loaded_at_the_next_boot_and_the_rest_are_defaults() {
        let mut first = stored(vec![0xff; 3 * SECTOR]);
        assert_eq!(block_on(first.load()).set, 0);
        for (n, value) in [(6, 2.5), (20, 0.7), (6, 3.5)] {
            block_on(first.save(&TABLE[n], value)).expect("there is room");
        }
        let loaded = block_on(stored(bytes(first)).load());
        let mut want = Parameters::default();
        want.set_at(6, 3.5).expect("in its range");
        want.set_at(20, 0.7).expect("in its range");
        assert_eq!((loaded.parameters, loaded.set, loaded.is_valid()), (want, 2, true));
    }

    #[test]
    fn a_full_sector_is_left_for_the_other_and_loses_nothing() {
        let mut it = stored(vec![0xff; 3 * SECTOR]);
        block_on(it.save(&TABLE[0], 0.1)).expect("there is room");
        for n in 0..500_u16 {
            block_on(it.save(&TABLE[6], 1.0 + f32::from(n % 100) / 100.0)).expect("it may erase");
        }
        let loaded = block_on(stored(bytes(it)).load());
        let saved = [0, 6].map(|n: usize| loaded.parameters.get(TABLE[n].name));
        assert_eq!(saved, [Some(0.1), Some(1.99)]);
    }

    #[test]
    fn without_leave_to_erase_a_full_sector_refuses_until_the_next_boot() {
        let mut it = stored(vec![0xff; 3 * SECTOR]);
        it.stop_erasing();
        let mut last = 0.0;
        // The first sector and the second.
        let refused = (0..200_u8).map(|n| 1.0 + f32::from(n) / 100.0).find_map(|value| {
            let error = block_on(it.save(&TABLE[6], value)).err();
            last = if error.is_none() { value } else { last };
            error
        });
        assert_eq!(refused, Some(SaveError::NeedsErase));
        let mut next = stored(bytes(it));
        assert_eq!(block_on(next.load()).parameters.get(TABLE[6].name), Some(last));
        assert_eq!(block_on(next.save(&TABLE[6], 3.5)), Ok(()));
        assert_eq!(block_on(next.load()).parameters.get(TABLE[6].name), Some(3.5));
    }

    #[test]
    fn a_value_outside_its_range_is_refused() {
        let mut it = stored(vec![0xff; 3 * SECTOR]);
        block_on(it.save(&TABLE[6], 1e9)).expect("there is room");
        let loaded = block_on(it.load());
        assert_eq!((loaded.parameters, loaded.set, loaded.refused), (Parameters::default(), 1, 1));
        assert!(!loaded.is_valid());
    }

    #[test]
    fn a_value_of_another_schema_is_refused_until_it_is_set_again_and_one_of_no_name_means_nothing() {
        let mut it = stored(vec![0xff; 3 * SECTOR]);
        let (mut other, mut unknown) = (key(&TABLE[6]), [b'X'; 1 + NAME_LENGTH_MAX]);
        (other[0], unknown[0]) = (SCHEMA + 1, SCHEMA);
        for key in [&other, &unknown] {
            block_on(it.map.store_item(&mut [0; BUFFER], key, &2.5_f32)).expect("there is room");
        }
        let loaded = block_on(it.load());
        assert_eq!((loaded.parameters, loaded.set, loaded.refused), (Parameters::default(), 1, 1));
        assert!(!loaded.is_valid());
        block_on(it.save(&TABLE[6], 3.5)).expect("there is room");
        // Older images stay about: what they store after it changes nothing.
        block_on(it.map.store_item(&mut [0; BUFFER], &other, &2.5_f32)).expect("there is room");
        let loaded = block_on(it.load());
        assert_eq!((loaded.parameters.get(TABLE[6].name), loaded.is_valid()), (Some(3.5), true));
    }

    #[test]
    fn sectors_with_anything_else_in_them_are_erased_and_told_of() {
        let mut it = stored((0..3 * SECTOR as u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 13) as u8).collect());
        let loaded = block_on(it.load());
        assert_eq!(loaded.parameters, Parameters::default());
        block_on(it.save(&TABLE[6], 2.0)).expect("they work again");
        assert_eq!(block_on(it.load()).parameters.get(TABLE[6].name), Some(2.0));
    }
}
