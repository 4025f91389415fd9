//! A log flash: a file with all that is in the chip.
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const BYTES: usize = 16 << 20;
const BLOCK: usize = 512;

/// The chip.
pub struct LogFlash {
    file: PathBuf,
    _folder: TempDir,
}

impl LogFlash {
    /// One as it is sold.
    ///
    /// # Panics
    /// If it cannot be written here.
    pub fn blank() -> Self {
        Self::filled(&[])
    }

    /// One that begins with something.
    ///
    /// # Panics
    /// If it cannot be written here, or is too long.
    pub fn filled(content: &[u8]) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let flash = Self { file: folder.path().join("log_flash.bin"), _folder: folder };
        let mut bytes = vec![u8::MAX; BYTES];
        bytes[..content.len()].copy_from_slice(content);
        fs::write(&flash.file, bytes).expect("written");
        flash
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.file
    }

    /// What is written, to its last block.
    ///
    /// # Panics
    /// If it cannot be read.
    pub fn log(&self) -> Vec<u8> {
        let mut bytes = fs::read(&self.file).expect("it is there");
        let written = bytes.chunks(BLOCK).rposition(|block| block.iter().any(|&byte| byte != u8::MAX));
        bytes.truncate(written.map_or(0, |last| (last + 1) * BLOCK));
        bytes
    }
}
