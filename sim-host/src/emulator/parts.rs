//! What the pipe needs: the emulator, and the image with what it is built with.
use super::EmulatorError;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

/// Executable of the emulator and ELF of the image.
#[derive(Clone)]
pub(super) struct Parts {
    pub(super) emulator: PathBuf,
    pub(super) image: PathBuf,
}

/// Builds them, once for each set of the image's features.
pub(super) fn parts(features: Option<&'static str>) -> Result<Parts, EmulatorError> {
    static PARTS: Mutex<Vec<(Option<&str>, Parts)>> = Mutex::new(Vec::new());
    let mut parts = PARTS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, known)) = parts.iter().find(|(known, _)| *known == features) {
        return Ok(known.clone());
    }
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| workspace.join("target"), PathBuf::from);
    cargo(&workspace, "build --quiet --package emulator --release")?;
    let added = features.map(|features| format!(" --features {features}")).unwrap_or_default();
    cargo(
        &workspace,
        &format!("build --quiet --package firmware --profile image --target thumbv7em-none-eabihf{added}"),
    )?;
    // Each by a name of its own: all images are built into the same place.
    let built = target.join("thumbv7em-none-eabihf/image/firmware");
    let image = built.with_extension(features.unwrap_or("default"));
    std::fs::copy(built, &image)?;
    let built = Parts { emulator: target.join("release/emulator"), image };
    parts.push((features, built.clone()));
    Ok(built)
}

fn cargo(workspace: &Path, arguments: &str) -> Result<(), EmulatorError> {
    let refused = |why: &dyn ToString| EmulatorError::Build(arguments.to_owned(), why.to_string());
    let program = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let status = Command::new(program).args(arguments.split(' ')).current_dir(workspace).status();
    let status = status.map_err(|error| refused(&error))?;
    if status.success() { Ok(()) } else { Err(refused(&status)) }
}
