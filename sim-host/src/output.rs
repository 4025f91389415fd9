//! Result files, all or none.
use std::io;
use std::path::Path;

/// Files to write together.
#[derive(Default)]
pub struct Files(Vec<(String, Vec<u8>)>);

impl Files {
    /// Adds a file.
    pub fn add(&mut self, name: impl Into<String>, bytes: impl Into<Vec<u8>>) {
        self.0.push((name.into(), bytes.into()));
    }

    /// Writes every file into `folder`, which it makes if needed.
    ///
    /// All are first written beside it, and moved only when complete: a full disk leaves no half-written result.
    pub fn write(&self, folder: &Path) -> io::Result<()> {
        std::fs::create_dir_all(folder)?;
        let staging = tempfile::Builder::new().prefix(".unfinished-").tempdir_in(folder)?;
        for (name, bytes) in &self.0 {
            std::fs::write(staging.path().join(name), bytes)?;
        }
        for (name, _) in &self.0 {
            std::fs::rename(staging.path().join(name), folder.join(name))?;
        }
        Ok(())
    }
}
