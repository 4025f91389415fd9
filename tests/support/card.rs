//! A microSD card: a file with a partition table and one FAT partition, as cards are sold.
use fatfs::{FatType, FileSystem, FormatVolumeOptions, FsOptions};
use fscommon::StreamSlice;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const BLOCK: u64 = 512;
/// Where the partition begins, in blocks.
const START: u64 = 2_048;

/// Its size, in blocks: 320 MiB, of which the file here takes what is written. FAT32 begins at 260.
const BLOCKS: u64 = 655_360;
/// The log's file, and its size in bytes: of half a minute's flight many times over.
const LOG: &str = "FLIGHT.LOG";
const LOG_BYTES: usize = 16 << 20;

/// The card.
pub struct Card {
    file: PathBuf,
    _folder: TempDir,
}

type Partition = FileSystem<StreamSlice<File>>;

impl Card {
    /// One as `sim-host card` leaves it: a file of zeros in it, and another one before that.
    ///
    /// # Panics
    /// If it cannot be written here.
    pub fn prepared() -> Self {
        Self::with_room_for(LOG_BYTES)
    }

    /// The same, of a smaller file.
    ///
    /// # Panics
    /// If it cannot be written here.
    pub fn with_room_for(bytes: usize) -> Self {
        let card = Self::formatted();
        card.write("README.TXT", b"Of somebody else.");
        card.write(LOG, &vec![0; bytes]);
        card
    }

    /// One as it is sold.
    ///
    /// # Panics
    /// If it cannot be written here.
    pub fn formatted() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let card = Self { file: folder.path().join("card.img"), _folder: folder };
        let mut image = File::create(&card.file).expect("a file");
        image.set_len(BLOCK * (START + BLOCKS)).expect("room");
        let mut table = [0; BLOCK as usize];
        // With block addresses; nobody counts cylinders.
        table[450] = 0x0c;
        table[454..458].copy_from_slice(&(START as u32).to_le_bytes());
        table[458..462].copy_from_slice(&(BLOCKS as u32).to_le_bytes());
        table[510..].copy_from_slice(&[0x55, 0xaa]);
        image.write_all(&table).expect("written");
        let options = FormatVolumeOptions::new().fat_type(FatType::Fat32).bytes_per_cluster(4_096);
        fatfs::format_volume(card.slice(), options).expect("formatted");
        card
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.file
    }

    fn slice(&self) -> StreamSlice<File> {
        let image = File::options().read(true).write(true).open(&self.file).expect("it is there");
        StreamSlice::new(image, BLOCK * START, BLOCK * (START + BLOCKS)).expect("within the file")
    }

    fn partition(&self) -> Partition {
        FileSystem::new(self.slice(), FsOptions::new()).expect("a FAT")
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        let partition = self.partition();
        partition.root_dir().create_file(name).and_then(|mut file| file.write_all(bytes)).expect("there is room");
    }

    /// The log's file, up to its first block of zeros, as a PC reads it.
    ///
    /// # Panics
    /// If it cannot be read, or the other file is not what it was: a PC would find that too.
    pub fn log(&self) -> Vec<u8> {
        let partition = self.partition();
        let read = |name: &str| {
            let mut content = Vec::new();
            let file = partition.root_dir().open_file(name);
            file.and_then(|mut file| file.read_to_end(&mut content)).expect("it can be read");
            content
        };
        assert_eq!(read("README.TXT"), b"Of somebody else.");
        let mut log = read(LOG);
        let written = log.chunks(BLOCK as usize).take_while(|block| block.iter().any(|&byte| byte != 0)).count();
        log.truncate(written * BLOCK as usize);
        log
    }
}
