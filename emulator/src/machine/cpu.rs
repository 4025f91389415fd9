//! The CPU as the model sees it between two blocks of code.
use crate::Failure;
use unicorn_engine::{RegisterARM as R, Unicorn};

/// Registers of the CPU, and memory.
pub(crate) struct Cpu {
    pub(super) unicorn: Unicorn<'static, ()>,
}

impl Cpu {
    pub(crate) fn register(&self, register: R) -> u32 {
        self.wide(register) as u32
    }

    pub(crate) fn wide(&self, register: R) -> u64 {
        // A register of the CPU can always be read.
        self.unicorn.reg_read(register).unwrap_or(0)
    }

    pub(crate) fn set(&mut self, register: R, value: u32) {
        self.set_wide(register, value.into());
    }

    pub(crate) fn set_wide(&mut self, register: R, value: u64) {
        // And written.
        let _ = self.unicorn.reg_write(register, value);
    }

    pub(crate) fn load(&self, address: u32, words: usize) -> Result<Vec<u32>, Failure> {
        let bytes = self.unicorn.mem_read_as_vec(u64::from(address), 4 * words);
        let bytes = bytes.map_err(|_| Failure(format!("there is no memory at {address:#010x}")))?;
        Ok(bytes.chunks_exact(4).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]])).collect())
    }

    pub(crate) fn store(&mut self, address: u32, words: &[u32]) -> Result<(), Failure> {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let written = self.unicorn.mem_write(u64::from(address), &bytes);
        written.map_err(|_| Failure(format!("there is no memory at {address:#010x}")))
    }
}
