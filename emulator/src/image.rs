//! The image: an ELF file as it would be flashed.
use crate::Failure;
use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader};
use object::{Endianness, Object, ObjectSymbol};
use std::path::Path;

/// What is flashed, with where it goes.
#[derive(Clone, Debug)]
pub struct Image {
    /// The file's bytes.
    pub elf: Vec<u8>,
    /// Address and bytes of each segment.
    pub(crate) segments: Vec<(u32, Vec<u8>)>,
}

impl Image {
    /// Reads an ELF file.
    ///
    /// # Errors
    /// If the file cannot be read or is no 32-bit ELF.
    pub fn open(path: &Path) -> Result<Self, Failure> {
        let fail = |error: &dyn std::fmt::Display| Failure(format!("{}: {error}", path.display()));
        let elf = std::fs::read(path).map_err(|error| fail(&error))?;
        let segments = segments(&elf).map_err(|error| fail(&error))?;
        Ok(Self { elf, segments })
    }

    /// Address and size of the one symbol whose name contains `part`.
    ///
    /// # Errors
    /// If the image has none, or several.
    pub(crate) fn symbol_with(&self, part: &str) -> Result<(u32, u32), Failure> {
        let file = ElfFile32::<Endianness>::parse(&*self.elf).map_err(|error| Failure(error.to_string()))?;
        let mut found = file.symbols().filter(|symbol| symbol.name().is_ok_and(|name| name.contains(part)));
        match (found.next(), found.next()) {
            (Some(symbol), None) => Ok((symbol.address() as u32, symbol.size() as u32)),
            _ => Err(Failure(format!("the image has not one symbol with {part} in its name"))),
        }
    }

    /// Address of a symbol.
    ///
    /// # Errors
    /// If the image has none of this name.
    pub fn symbol(&self, name: &str) -> Result<u32, Failure> {
        self.variable(name).map(|(address, _)| address)
    }

    /// Address of a variable, and its bytes.
    ///
    /// # Errors
    /// If the image has none of this name.
    pub fn variable(&self, name: &str) -> Result<(u32, usize), Failure> {
        let file = ElfFile32::<Endianness>::parse(&*self.elf).map_err(|error| Failure(error.to_string()))?;
        let found = file.symbols().find(|symbol| symbol.name() == Ok(name));
        let found = found.map(|symbol| (symbol.address() as u32, symbol.size() as usize));
        found.ok_or_else(|| Failure(format!("the image has no symbol {name}")))
    }

    /// Address of the function in the core library that the language calls for an index beyond the end.
    ///
    /// # Errors
    /// If the image never does.
    pub fn panic(&self) -> Result<u32, Failure> {
        const NAME: &str = "9panicking18panic_bounds_check";
        let file = ElfFile32::<Endianness>::parse(&*self.elf).map_err(|error| Failure(error.to_string()))?;
        let found = file.symbols().find(|symbol| symbol.name().is_ok_and(|name| name.contains(NAME)));
        found.map(|symbol| symbol.address() as u32).ok_or_else(|| Failure(format!("the image has no symbol {NAME}")))
    }
}

/// What goes where: the physical addresses, for initial values of variables are flashed too.
fn segments(elf: &[u8]) -> object::Result<Vec<(u32, Vec<u8>)>> {
    let header = FileHeader32::<Endianness>::parse(elf)?;
    let endian = header.endian()?;
    let mut segments = Vec::new();
    for segment in header.program_headers(endian, elf)? {
        let data = segment.data(endian, elf).unwrap_or_default();
        if segment.p_type(endian) == PT_LOAD && !data.is_empty() {
            segments.push((segment.p_paddr(endian), data.to_vec()));
        }
    }
    Ok(segments)
}
