//! Stored parameters: those that somebody has set, in two sectors of flash.
//!
//! ```text
//! sector = page of items, seal        item = schema, name, value, checksums        seal = generation, its complement
//! ```
//!
//! The sector of the newest generation counts. Each save appends an item to its page; the newest of a name that is whole counts,
//! so a save that power interrupts leaves the old value or the new one. When the page is full, the newest of each name and what
//! is to be saved are written to the other sector, which is erased before if anything is in it, and sealed when all is there.
//! Bits go from one to zero only, so a seal that was not written whole, or to a sector that is being erased, is not its own
//! complement: until its last bit the old sector counts, and nothing ever harms the sector that counts.
//!
//! A page is [`PAGE`] bytes of its sector: what is in it is searched item by item. What was set under another schema, and not
//! again under this one, is refused like a value outside its range: its default is not what somebody chose. Items of names that
//! are not declared any more mean nothing, and are left behind. Where neither sector has a seal, what is in them is not this
//! file's, nothing can be read, and they are erased.
//!
//! On a chip with one bank of flash the program stands still while a sector is erased, for a second or two, longer than the
//! watchdog waits. So erasing is allowed only until [`Stored::stop_erasing`]; after that, a save that needs it is refused with
//! [`SaveError::NeedsErase`], harms nothing, and succeeds at the next boot.
//!
//! Invariant: what [`Stored::load`] returns is in its ranges.
//!
//! # Source
//! Of a page's layout: the crate `sequential-storage`. Its own way from page to page is not used: power cut while it erases can leave
//! the marks of a full page on one that is half gone, which it then takes for the better one.
use core::ops::Range;

use control_core::parameters::{COUNT, Declaration, NAME_LENGTH_MAX, Parameters, TABLE};
use embassy_futures::block_on;
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind};
use embedded_storage_async::nor_flash as flash_async;
use sequential_storage::Error;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};

/// To be raised when a stored number means something else than it did.
pub const SCHEMA: u8 = 1;

/// Bytes of a sector that hold items.
pub const PAGE: usize = 4_096;

/// Schema and name, filled up with zeros.
type Key = [u8; 1 + NAME_LENGTH_MAX];
/// Of each declared name the newest item: its schema and value.
type Items = [Option<(u8, f32)>; COUNT];
/// Bytes for key and value, and what is missing to a word of the flash, of up to 32.
const BUFFER: usize = 64;
/// Bytes of an item's header.
const HEADER: usize = 8;
/// Bytes of a seal, which begins where the page ends.
const SEAL: usize = 8;

/// What was found at boot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loaded {
    /// Values: stored ones where there are any, else defaults.
    pub parameters: Parameters,
    /// How many are stored.
    pub set: usize,
    /// How many of these were refused, outside their range or of another schema: their defaults hold.
    pub refused: usize,
    /// The sectors held something else, or were damaged beyond reading, and were erased.
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
    /// All items, one that is saved anew, and a page's two marks fit a page, in whole words of this flash.
    const FITS: () = {
        let item = HEADER.next_multiple_of(S::WRITE_SIZE) + (size_of::<Key>() + 4).next_multiple_of(S::WRITE_SIZE);
        assert!((COUNT + 1) * item + 2 * S::WRITE_SIZE <= PAGE, "the parameters do not fit a page of this flash");
    };

    /// The parameters in these bytes of a flash: two of its sectors.
    ///
    /// Returns none if they are not two, or too small for a [`PAGE`] and its seal.
    pub fn try_new(flash: S, range: Range<u32>) -> Option<Self> {
        let () = Self::FITS;
        let sector = S::ERASE_SIZE as u32;
        let two = range.start.is_multiple_of(sector) && range.end.checked_sub(range.start) == Some(2 * sector);
        let config = MapConfig::try_new(0..2 * PAGE as u32).ok()?;
        let sectors = Sectors { flash, start: range.start, current: 0, may_erase: true };
        let large = S::ERASE_SIZE >= PAGE + SEAL.next_multiple_of(S::WRITE_SIZE);
        (two && large).then(|| Self { map: MapStorage::new(sectors, config, Cache::new_uncached()) })
    }

    /// Reads all that is stored. Where that cannot be read the sectors are erased, if they may be.
    pub fn load(&mut self) -> Loaded {
        let read = self.read();
        let lost = read.is_err();
        if lost {
            for sector in [0, 1] {
                // If that fails, so does every save.
                let _ = self.map.flash().clear(sector);
            }
        }
        let items = read.unwrap_or([None; COUNT]);
        let mut parameters = Parameters::default();
        let mut holds =
            |(n, (schema, value)): (usize, (u8, f32))| schema == SCHEMA && parameters.set_at(n, value).is_ok();
        let set = items.iter().flatten().count();
        let stored = items.into_iter().enumerate().filter_map(|(n, item)| Some((n, item?)));
        let refused = stored.filter(|&item| !holds(item)).count();
        Loaded { parameters, set, refused, lost }
    }

    /// What the sector that counts holds.
    fn read(&mut self) -> Result<Items, Error<SectorsError<S::Error>>> {
        let mut items = [None; COUNT];
        let sectors = self.map.flash();
        if sectors.turn()?.is_none() {
            let blank = sectors.is_blank(0, PAGE)? && sectors.is_blank(1, PAGE)?;
            return if blank { Ok(items) } else { Err(Error::Corrupted {}) };
        }
        let mut buffer = [0; BUFFER];
        let mut stored = block_on(self.map.fetch_all_items(&mut buffer))?;
        // The newest of a key comes last.
        while let Some((key, value)) = block_on(stored.next::<f32>(&mut buffer))? {
            let place = TABLE.iter().position(|declaration| self::key(key[0], declaration) == key);
            if let Some(item) = place.and_then(|place| items.get_mut(place))
                && (key[0] == SCHEMA || item.is_none_or(|(schema, _)| schema != SCHEMA))
            {
                *item = Some((key[0], value));
            }
        }
        Ok(items)
    }

    /// Saves one value, which must be in its range.
    ///
    /// # Errors
    /// [`SaveError`]; the value before holds then.
    pub fn save(&mut self, declaration: &Declaration, value: f32) -> Result<(), SaveError> {
        match self.append_or_move(declaration, value) {
            Ok(()) => Ok(()),
            Err(Error::Storage { value: SectorsError::MayNotErase, .. }) => Err(SaveError::NeedsErase),
            Err(_) => Err(SaveError::Flash),
        }
    }

    fn append_or_move(&mut self, declaration: &Declaration, value: f32) -> Result<(), Error<SectorsError<S::Error>>> {
        let flash = self.map.flash();
        let sealed = flash.turn()?;
        if sealed.is_none() {
            // Nothing is stored: so says the first one.
            flash.clear(0)?;
            flash.seal(1)?;
        }
        let generation = sealed.unwrap_or(1);
        match self.append(SCHEMA, declaration, value) {
            Err(Error::Storage { value: SectorsError::Full, .. }) => {
                let items = self.read()?;
                let flash = self.map.flash();
                flash.current = 1 - flash.current;
                flash.clear(flash.current)?;
                for (declaration, item) in TABLE.iter().zip(items) {
                    if let Some((schema, value)) = item {
                        self.append(schema, declaration, value)?;
                    }
                }
                self.append(SCHEMA, declaration, value)?;
                Ok(self.map.flash().seal(generation + 1)?)
            }
            result => result,
        }
    }

    fn append(
        &mut self,
        schema: u8,
        declaration: &Declaration,
        value: f32,
    ) -> Result<(), Error<SectorsError<S::Error>>> {
        block_on(self.map.store_item(&mut [0; BUFFER], &key(schema, declaration), &value))
    }

    /// From now on nothing is erased.
    pub fn stop_erasing(&mut self) {
        self.map.flash().may_erase = false;
    }
}

fn key(schema: u8, declaration: &Declaration) -> Key {
    let mut key = [0; 1 + NAME_LENGTH_MAX];
    key[0] = schema;
    for (place, byte) in key[1..].iter_mut().zip(declaration.name.bytes()) {
        *place = byte;
    }
    key
}

/// The two sectors. As a flash they are the current one's page and a second one, which is always empty and takes nothing.
#[derive(Debug)]
struct Sectors<S> {
    flash: S,
    /// Where the first sector begins.
    start: u32,
    /// The one whose page is meant, 0 or 1.
    current: u32,
    may_erase: bool,
}

/// What a [`Sectors`] does not do.
#[derive(Clone, Copy, Debug)]
enum SectorsError<E> {
    Flash(E),
    MayNotErase,
    /// The page is full.
    Full,
}

impl<E: NorFlashError> NorFlashError for SectorsError<E> {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Flash(error) => error.kind(),
            Self::MayNotErase => NorFlashErrorKind::Other,
            Self::Full => NorFlashErrorKind::OutOfBounds,
        }
    }
}

impl<E> From<SectorsError<E>> for Error<SectorsError<E>> {
    fn from(value: SectorsError<E>) -> Self {
        Self::Storage { value }
    }
}

impl<S: NorFlash> Sectors<S> {
    /// Where in the flash a sector begins.
    fn begin(&self, sector: u32) -> u32 {
        self.start + sector * S::ERASE_SIZE as u32
    }

    /// Turns to the sector that counts; returns its generation, or none if neither is sealed.
    fn turn(&mut self) -> Result<Option<u32>, SectorsError<S::Error>> {
        let (first, second) = (self.generation(0)?, self.generation(1)?);
        self.current = u32::from(second > first);
        Ok(first.max(second))
    }

    /// What a sector's seal says, if it is whole.
    fn generation(&mut self, sector: u32) -> Result<Option<u32>, SectorsError<S::Error>> {
        let mut seal = [0; SEAL];
        self.flash.read(self.begin(sector) + PAGE as u32, &mut seal).map_err(SectorsError::Flash)?;
        let seal = u64::from_le_bytes(seal);
        let (generation, complement) = (seal as u32, (seal >> 32) as u32);
        Ok((generation == !complement).then_some(generation))
    }

    /// From now on the current sector counts, if this is the newest generation.
    fn seal(&mut self, generation: u32) -> Result<(), SectorsError<S::Error>> {
        let mut words = [0xff; BUFFER];
        words[..SEAL].copy_from_slice(&(u64::from(!generation) << 32 | u64::from(generation)).to_le_bytes());
        let place = self.begin(self.current) + PAGE as u32;
        let words = &words[..SEAL.next_multiple_of(S::WRITE_SIZE)];
        self.flash.write(place, words).map_err(SectorsError::Flash)
    }

    /// Whether nothing is in the first bytes of a sector.
    fn is_blank(&mut self, sector: u32, bytes: usize) -> Result<bool, SectorsError<S::Error>> {
        let mut buffer = [0; BUFFER];
        for offset in (0..bytes).step_by(BUFFER) {
            let some = &mut buffer[..BUFFER.min(bytes - offset)];
            self.flash.read(self.begin(sector) + offset as u32, some).map_err(SectorsError::Flash)?;
            if some.iter().any(|&byte| byte != 0xff) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Erases a sector if anything is in it.
    fn clear(&mut self, sector: u32) -> Result<(), SectorsError<S::Error>> {
        if self.is_blank(sector, PAGE + SEAL.next_multiple_of(S::WRITE_SIZE))? {
            return Ok(());
        }
        if !self.may_erase {
            return Err(SectorsError::MayNotErase);
        }
        let begin = self.begin(sector);
        self.flash.erase(begin, begin + S::ERASE_SIZE as u32).map_err(SectorsError::Flash)
    }
}

impl<S: ErrorType> ErrorType for Sectors<S> {
    type Error = SectorsError<S::Error>;
}

impl<S: NorFlash> flash_async::ReadNorFlash for Sectors<S> {
    const READ_SIZE: usize = S::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        if offset >= PAGE as u32 {
            bytes.fill(0xff);
            return Ok(());
        }
        self.flash.read(self.begin(self.current) + offset, bytes).map_err(SectorsError::Flash)
    }

    fn capacity(&self) -> usize {
        2 * PAGE
    }
}

impl<S: NorFlash> flash_async::NorFlash for Sectors<S> {
    const WRITE_SIZE: usize = S::WRITE_SIZE;
    const ERASE_SIZE: usize = PAGE;

    async fn erase(&mut self, _: u32, _: u32) -> Result<(), Self::Error> {
        Err(SectorsError::Full)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        if offset >= PAGE as u32 {
            return Err(SectorsError::Full);
        }
        self.flash.write(self.begin(self.current) + offset, bytes).map_err(SectorsError::Flash)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_storage::nor_flash::ReadNorFlash;
    use std::vec;
    use std::vec::Vec;

    /// A sector that is not theirs, and two that are.
    const SECTOR: usize = 2 * PAGE;

    /// How power fails.
    #[derive(Clone, Copy, Debug)]
    struct Cut {
        /// Words programmed and sectors erased before it.
        after: u32,
        /// Of what chance the next one is done in part; none: it is not done at all.
        part: Option<u32>,
    }

    #[derive(Clone)]
    struct Ram {
        bytes: Vec<u8>,
        cut: Option<Cut>,
        /// Power has failed.
        off: bool,
    }

    #[derive(Debug)]
    struct Off;

    impl NorFlashError for Off {
        fn kind(&self) -> NorFlashErrorKind {
            NorFlashErrorKind::Other
        }
    }

    impl ErrorType for Ram {
        type Error = Off;
    }

    /// Mixes the bits of a number: the finalizer of MurmurHash3.
    fn mix(x: u32) -> u32 {
        let x = (x ^ x >> 16).wrapping_mul(0x85eb_ca6b);
        let x = (x ^ x >> 13).wrapping_mul(0xc2b2_ae35);
        x ^ x >> 16
    }

    impl Ram {
        /// One operation: which bits of a word at a place are changed.
        fn operate(&mut self) -> Result<impl Fn(usize) -> u32 + use<>, Off> {
            if self.off {
                return Err(Off);
            }
            let part = match &mut self.cut {
                Some(Cut { after: 0, part }) => {
                    self.off = true;
                    Some(part.ok_or(Off)?)
                }
                Some(cut) => {
                    cut.after -= 1;
                    None
                }
                None => None,
            };
            Ok(move |place| {
                part.map_or(u32::MAX, |chance| match mix(chance ^ place as u32) % 4 {
                    0 => 0,
                    1 => u32::MAX,
                    mixed => mix(mixed ^ chance ^ place as u32),
                })
            })
        }

        fn change(&mut self, place: usize, to: u32, bits: u32) {
            let word = &mut self.bytes[place..][..4];
            let before = u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
            word.copy_from_slice(&(before & !bits | to & bits).to_le_bytes());
        }
    }

    impl ReadNorFlash for Ram {
        const READ_SIZE: usize = 1;
        fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Off> {
            bytes.copy_from_slice(&self.bytes[offset as usize..][..bytes.len()]);
            Ok(())
        }
        fn capacity(&self) -> usize {
            self.bytes.len()
        }
    }

    impl NorFlash for Ram {
        const WRITE_SIZE: usize = 4;
        const ERASE_SIZE: usize = SECTOR;
        fn erase(&mut self, from: u32, to: u32) -> Result<(), Off> {
            assert_eq!(to - from, SECTOR as u32);
            let changes = self.operate()?;
            (from as usize..to as usize).step_by(4).for_each(|place| self.change(place, u32::MAX, changes(place)));
            Ok(())
        }
        fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Off> {
            for (place, word) in (offset as usize..).step_by(4).zip(bytes.chunks_exact(4)) {
                let changes = self.operate()?;
                let before = u32::from_le_bytes(self.bytes[place..][..4].try_into().expect("four"));
                let to = before & u32::from_le_bytes(word.try_into().expect("four"));
                self.change(place, to, changes(place));
            }
            Ok(())
        }
    }

    fn stored(bytes: Vec<u8>) -> Stored<Ram> {
        cut_short(bytes, None)
    }

    fn cut_short(bytes: Vec<u8>, cut: Option<Cut>) -> Stored<Ram> {
        let range = SECTOR as u32..3 * SECTOR as u32;
        Stored::try_new(Ram { bytes, cut, off: false }, range).expect("two sectors")
    }

    fn bytes(stored: Stored<Ram>) -> Vec<u8> {
        stored.map.destroy().0.flash.bytes
    }

    /// Anything.
    fn garbage(n: u32) -> u8 {
        mix(n) as u8
    }

    #[test]
    fn only_two_whole_sectors_will_do() {
        let one = SECTOR as u32;
        for range in [0..one, 0..3 * one, 1..2 * one + 1, one..0] {
            assert!(
                Stored::try_new(Ram { bytes: Vec::new(), cut: None, off: false }, range.clone()).is_none(),
                "{range:?}"
            );
        }
    }

    #[test]
    fn what_is_saved_is_loaded_at_the_next_boot_and_the_rest_are_defaults() {
        let mut first = stored(vec![0xff; 3 * SECTOR]);
        assert_eq!(first.load().set, 0);
        for (n, value) in [(6, 2.5), (20, 0.7), (6, 3.5)] {
            first.save(&TABLE[n], value).expect("there is room");
        }
        let loaded = stored(bytes(first)).load();
        let mut want = Parameters::default();
        want.set_at(6, 3.5).expect("in its range");
        want.set_at(20, 0.7).expect("in its range");
        assert_eq!((loaded.parameters, loaded.set, loaded.is_valid()), (want, 2, true));
    }

    #[test]
    fn a_full_page_is_left_for_the_other_and_loses_nothing() {
        let mut it = stored(vec![0xff; 3 * SECTOR]);
        it.save(&TABLE[0], 0.1).expect("there is room");
        for n in 0..500_u16 {
            it.save(&TABLE[6], 1.0 + f32::from(n % 100) / 100.0).expect("it may erase");
        }
        let loaded = stored(bytes(it)).load();
        let saved = [0, 6].map(|n: usize| loaded.parameters.get(TABLE[n].name));
        assert_eq!(saved, [Some(0.1), Some(1.99)]);
    }

    #[test]
    fn without_leave_to_erase_the_second_full_page_refuses_until_the_next_boot() {
        let mut it = stored(vec![0xff; 3 * SECTOR]);
        it.stop_erasing();
        let mut last = 0.0;
        // The first page and the second.
        let refused = (0..300_u16).map(|n| 1.0 + f32::from(n) / 100.0).find_map(|value| {
            let error = it.save(&TABLE[6], value).err();
            last = if error.is_none() { value } else { last };
            error
        });
        assert_eq!(refused, Some(SaveError::NeedsErase));
        let mut next = stored(bytes(it));
        assert_eq!(next.load().parameters.get(TABLE[6].name), Some(last));
        assert_eq!(next.save(&TABLE[6], 3.5), Ok(()));
        assert_eq!(next.load().parameters.get(TABLE[6].name), Some(3.5));
    }

    #[test]
    fn a_value_outside_its_range_is_refused() {
        let mut it = stored(vec![0xff; 3 * SECTOR]);
        it.save(&TABLE[6], 1e9).expect("there is room");
        let loaded = it.load();
        assert_eq!((loaded.parameters, loaded.set, loaded.refused), (Parameters::default(), 1, 1));
        assert!(!loaded.is_valid());
    }

    #[test]
    fn a_value_of_another_schema_is_refused_until_it_is_set_again_and_one_of_no_name_means_nothing() {
        let mut it = stored(vec![0xff; 3 * SECTOR]);
        let (other, unknown) =
            (key(SCHEMA + 1, &TABLE[6]), key(SCHEMA, &Declaration { name: "NO_LONGER", ..TABLE[6] }));
        it.save(&TABLE[7], 1.0).expect("there is room");
        for key in [&other, &unknown] {
            block_on(it.map.store_item(&mut [0; BUFFER], key, &2.5_f32)).expect("there is room");
        }
        let loaded = it.load();
        assert_eq!((loaded.parameters.get(TABLE[6].name), loaded.set, loaded.refused), (Some(TABLE[6].default), 2, 1));
        assert!(!loaded.is_valid());
        it.save(&TABLE[6], 3.5).expect("there is room");
        // Older images stay about: what they store after it changes nothing.
        block_on(it.map.store_item(&mut [0; BUFFER], &other, &2.5_f32)).expect("there is room");
        let loaded = it.load();
        assert_eq!((loaded.parameters.get(TABLE[6].name), loaded.is_valid()), (Some(3.5), true));
    }

    #[test]
    fn sectors_with_anything_else_in_them_are_erased_and_told_of() {
        let mut it = stored((0..3 * SECTOR as u32).map(garbage).collect());
        let loaded = it.load();
        assert_eq!((loaded.parameters, loaded.set, loaded.lost), (Parameters::default(), 0, true));
        assert!(it.load().is_valid(), "told of once");
        it.save(&TABLE[6], 2.0).expect("they work again");
        assert_eq!(it.load().parameters.get(TABLE[6].name), Some(2.0));
        let left = bytes(it);
        assert!((0..SECTOR).all(|n| left[n] == garbage(n as u32)), "nobody else's is touched");
    }

    /// What a save must not touch, one of them of another schema; what it changes, from and to; what is saved afterwards.
    const KEPT: (usize, f32) = (0, 0.1);
    const OTHER: (usize, f32) = (9, 20.0);
    const SAVED: (usize, [f32; 3]) = (6, [1.5, 2.5, 3.5]);

    /// Sectors with [`KEPT`], [`OTHER`] and the first of [`SAVED`]; if `fills`, their page is full of items
    /// besides, of a name that means nothing.
    fn set_up(before: Vec<u8>, fills: bool) -> Vec<u8> {
        let mut it = stored(before);
        it.save(&TABLE[KEPT.0], KEPT.1).expect("there is room");
        it.append(SCHEMA + 1, &TABLE[OTHER.0], OTHER.1).expect("there is room");
        it.save(&TABLE[SAVED.0], SAVED.1[0]).expect("there is room");
        let mut full = bytes(it);
        let mut room = fills;
        while room {
            let mut it = stored(full.clone());
            it.load();
            room = block_on(it.map.store_item(&mut [0; BUFFER], &[b'X'; 1 + NAME_LENGTH_MAX], &1.0_f32)).is_ok();
            full = if room { bytes(it) } else { full };
        }
        full
    }

    fn check(bytes: Vec<u8>, saved: &[f32], why: &str) {
        let loaded = stored(bytes).load();
        let [kept, changed] = [KEPT.0, SAVED.0].map(|n| loaded.parameters.get(TABLE[n].name));
        assert_eq!((loaded.refused, loaded.lost, kept), (1, false, Some(KEPT.1)), "{why}");
        assert!(saved.iter().any(|&value| changed == Some(value)), "{why}: {changed:?}");
    }

    /// Saves with power cut at each operation, before it and in part, several ways; calls `then` with what is left each time.
    /// Returns how many operations a save has.
    fn save_with_every_cut(bytes_before: &[u8], value: f32, ways: u32, mut then: impl FnMut(Vec<u8>, &str)) -> u32 {
        for after in 0.. {
            for part in [None].into_iter().chain((0..ways).map(|way| Some(mix(97 * after + way)))) {
                let cut = Cut { after, part };
                let mut it = cut_short(bytes_before.to_vec(), Some(cut));
                let saved = it.save(&TABLE[SAVED.0], value);
                if !it.map.flash().flash.off {
                    assert_eq!(saved, Ok(()));
                    return after;
                }
                then(bytes(it), &std::format!("{cut:?}"));
            }
        }
        unreachable!("a save ends")
    }

    #[test]
    fn power_cut_at_any_operation_of_any_save_leaves_the_old_value_or_the_new_one_and_all_others() {
        let blank = vec![0xff; 3 * SECTOR];
        let [old, new, later] = SAVED.1;
        // The second sector in use, the first one full of what was before; and the first one in use, the second one anything.
        let mut used = stored(set_up(blank.clone(), true));
        used.save(&TABLE[SAVED.0], old).expect("there is room");
        let mut strange = set_up(blank.clone(), true);
        (2 * SECTOR..3 * SECTOR).for_each(|n| strange[n] = garbage(n as u32));
        for (why, before, operations) in [
            ("appended", set_up(blank.clone(), false), 8),
            ("moved to a blank sector", set_up(blank.clone(), true), 36),
            ("moved to a used sector", set_up(bytes(used), true), 37),
            ("moved to a sector full of anything", strange, 37),
        ] {
            check(before.clone(), &[old], why);
            let count = save_with_every_cut(&before, new, 8, |left, cut| {
                let why = std::format!("{why}, {cut}");
                check(left.clone(), &[old, new], &why);
                let mut it = stored(left);
                it.save(&TABLE[SAVED.0], later).unwrap_or_else(|error| panic!("{why}: {error:?}"));
                check(bytes(it), &[later], &why);
            });
            assert_eq!(count, operations, "{why}");
        }
    }

    #[test]
    fn nor_does_a_second_cut_in_the_save_after_the_first_harm_anything() {
        let [old, new, later] = SAVED.1;
        let full = set_up(vec![0xff; 3 * SECTOR], true);
        save_with_every_cut(&full, new, 1, |left, first| {
            save_with_every_cut(&left, later, 1, |left, second| {
                check(left, &[old, new, later], &std::format!("{first}, then {second}"));
            });
        });
    }

    #[test]
    fn power_cut_in_the_very_first_save_leaves_the_default_or_the_value_and_nothing_to_tell_of() {
        let value = SAVED.1[0];
        let operations = save_with_every_cut(&vec![0xff; 3 * SECTOR], value, 8, |left, why| {
            let mut it = stored(left);
            let loaded = it.load();
            let found = loaded.parameters.get(TABLE[SAVED.0].name);
            assert!(loaded.is_valid(), "{why}");
            assert!([value, TABLE[SAVED.0].default].map(Some).contains(&found), "{why}: {found:?}");
            it.save(&TABLE[SAVED.0], SAVED.1[1]).expect("there is room");
            assert_eq!(it.load().parameters.get(TABLE[SAVED.0].name), Some(SAVED.1[1]), "{why}");
        });
        assert!(operations > 8, "a seal and an item: {operations} operations");
    }
}
