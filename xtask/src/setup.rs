//! Installs the compiler's board target and components, and QEMU.
use crate::workspace::{TARGET, Workspace};
use anyhow::{Result, bail};
use xshell::{Shell, cmd};

const COMPONENTS: [&str; 3] = ["clippy", "llvm-tools", "rustfmt"];
const QEMU: &str = "qemu-system-arm";

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
    if !present(shell, QEMU) {
        install_qemu(shell)?;
    }
    let version = cmd!(shell, "{QEMU} --version").quiet().read()?;
    println!("{TARGET}, {}, {}", COMPONENTS.join(", "), version.lines().next().unwrap_or(QEMU));
    Ok(())
}

/// Only as root and with apt: anywhere else it is the owner's machine and choice.
fn install_qemu(shell: &Shell) -> Result<()> {
    let root = cmd!(shell, "id -u").quiet().read().is_ok_and(|id| id == "0");
    if !root || !present(shell, "apt-get") {
        bail!(
            "{QEMU} is missing; on Debian or Ubuntu: sudo apt-get install {QEMU}, elsewhere QEMU's ARM system emulator"
        );
    }
    cmd!(shell, "apt-get update").run()?;
    cmd!(shell, "apt-get install -y --no-install-recommends {QEMU}").run()?;
    Ok(())
}

fn present(shell: &Shell, program: &str) -> bool {
    cmd!(shell, "{program} --version").quiet().ignore_stdout().ignore_stderr().run().is_ok()
}
