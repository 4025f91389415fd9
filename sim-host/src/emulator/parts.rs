//! What the pipe needs: the emulator, and the image with what it is built with.
use super::EmulatorError;
use super::sources::fingerprint;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

/// Executable of the emulator and ELF of the image.
#[derive(Clone)]
pub(super) struct Parts {
    pub(super) emulator: PathBuf,
    pub(super) image: PathBuf,
}

/// Builds them, once.
pub(super) fn parts() -> Result<Parts, EmulatorError> {
    static PARTS: Mutex<Option<Parts>> = Mutex::new(None);
    let mut parts = PARTS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = &*parts {
        return Ok(known.clone());
    }
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    refuse_others(&workspace)?;
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| workspace.join("target"), PathBuf::from);
    cargo(&workspace, "build --quiet --package emulator --release")?;
    cargo(&workspace, "build --quiet --package firmware --profile image --target thumbv7em-none-eabihf")?;
    let image = target.join("thumbv7em-none-eabihf/image/firmware");
    let built = Parts { emulator: target.join("release/emulator"), image };
    Ok(parts.insert(built).clone())
}

/// Refuses to watch an image of which this is not the twin.
fn refuse_others(workspace: &Path) -> Result<(), EmulatorError> {
    let now = fingerprint(workspace).map_err(EmulatorError::Sources)?;
    if format!("{now:016x}") == env!("DECIDES_BY") { Ok(()) } else { Err(EmulatorError::Stale) }
}

fn cargo(workspace: &Path, arguments: &str) -> Result<(), EmulatorError> {
    let refused = |why: &dyn ToString| EmulatorError::Build(arguments.to_owned(), why.to_string());
    let program = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let status = Command::new(program).args(arguments.split(' ')).current_dir(workspace).status();
    let status = status.map_err(|error| refused(&error))?;
    if status.success() { Ok(()) } else { Err(refused(&status)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulator::sources::SOURCES;
    use std::fs;

    fn copy(from: &Path, to: &Path) {
        if from.is_dir() {
            fs::create_dir_all(to).unwrap();
            for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
                copy(&entry.path(), &to.join(entry.file_name()));
            }
        } else {
            fs::create_dir_all(to.parent().unwrap()).unwrap();
            fs::copy(from, to).unwrap();
        }
    }

    #[test]
    fn an_image_of_other_sources_than_its_twins_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        for source in SOURCES {
            copy(&workspace.join(source), &folder.path().join(source));
        }
        assert!(refuse_others(folder.path()).is_ok());

        let (core, elsewhere) =
            ["lib.rs", "other.rs"].map(|name| folder.path().join("control-core/src").join(name)).into();
        let text = fs::read_to_string(&core).unwrap();
        fs::write(&core, format!("{text}\n")).unwrap();
        assert!(matches!(refuse_others(folder.path()), Err(EmulatorError::Stale)));
        fs::write(&core, text).unwrap();
        assert!(refuse_others(folder.path()).is_ok());

        fs::rename(&core, &elsewhere).unwrap();
        assert!(matches!(refuse_others(folder.path()), Err(EmulatorError::Stale)));
        fs::remove_file(folder.path().join(SOURCES[1])).unwrap();
        assert!(matches!(refuse_others(folder.path()), Err(EmulatorError::Sources(_))));
    }
}
