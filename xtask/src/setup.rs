//! Installs the compiler's board target and components, QEMU, and what builds Unicorn.
use crate::workspace::{TARGET, Workspace};
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};
use std::{env, fs};
use xshell::{Shell, cmd};

const COMPONENTS: [&str; 3] = ["clippy", "llvm-tools", "rustfmt"];
const QEMU: &str = "qemu-system-arm";
const CMAKE: &str = "cmake";
const LIBCLANG: &str = "libclang-dev";

pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    let shell = &workspace.shell;
    // `rust-toolchain.toml` lists these too, but rustup does not install them where RUSTUP_AUTO_INSTALL=0.
    let targets = cmd!(shell, "rustup target list --installed").quiet().read()?;
    if !targets.lines().any(|installed| installed == TARGET) {
        cmd!(shell, "rustup target add {TARGET}").run()?;
    }
    let components = cmd!(shell, "rustup component list --installed").quiet().read()?;
    for component in COMPONENTS {
        // Installed ones are listed with their host triple: `clippy-x86_64-unknown-linux-gnu`.
        if !components.lines().any(|installed| installed.starts_with(component)) {
            cmd!(shell, "rustup component add {component}").run()?;
        }
    }
    let mut missing: Vec<&str> = [QEMU, CMAKE].into_iter().filter(|program| !present(shell, program)).collect();
    if !has_libclang() {
        missing.push(LIBCLANG);
    }
    if !missing.is_empty() {
        install(shell, &missing)?;
    }
    let version = cmd!(shell, "{QEMU} --version").quiet().read()?;
    println!("{TARGET}, {}, {}", COMPONENTS.join(", "), version.lines().next().unwrap_or(QEMU));
    Ok(())
}

/// Only as root and with apt: anywhere else it is the owner's machine and choice.
fn install(shell: &Shell, packages: &[&str]) -> Result<()> {
    let root = cmd!(shell, "id -u").quiet().read().is_ok_and(|id| id == "0");
    if !root || !present(shell, "apt-get") {
        let names = packages.join(" ");
        bail!(
            "missing: {names}; on Debian or Ubuntu: sudo apt-get install {names}, elsewhere what they are called there"
        );
    }
    cmd!(shell, "apt-get update").run()?;
    cmd!(shell, "apt-get install -y --no-install-recommends {packages...}").run()?;
    Ok(())
}

/// Whether the library that reads Unicorn's C headers is where its build looks: LIBCLANG_PATH, or the system's folders.
fn has_libclang() -> bool {
    let holds = |folder: &Path| {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        entries.into_iter().any(|entry| entry.file_name().to_string_lossy().starts_with("libclang"))
    };
    let versions = fs::read_dir("/usr/lib").into_iter().flatten().flatten().map(|entry| entry.path());
    let llvm = versions.filter(|path| path.to_string_lossy().contains("llvm")).map(|path| path.join("lib"));
    let fixed = ["/usr/lib", "/usr/lib64", "/usr/local/lib", "/usr/lib/x86_64-linux-gnu"].map(PathBuf::from);
    env::var_os("LIBCLANG_PATH").map(PathBuf::from).into_iter().chain(fixed).chain(llvm).any(|path| holds(&path))
}

fn present(shell: &Shell, program: &str) -> bool {
    cmd!(shell, "{program} --version").quiet().ignore_stdout().ignore_stderr().run().is_ok()
}
