//! `cargo fmu completions`: completion scripts for shells.

use clap::Command;
use clap_complete::Shell;

/// Bash supports one completion per command, and `cargo` already has one: use ours after
/// `cargo fmu`, else the existing one. (Zsh's completion of `cargo` finds `_cargo-fmu` by itself.)
const BASH: &str = include_str!("completions.bash");

/// The completion script for a shell.
pub fn script(shell: Shell, command: Command) -> Vec<u8> {
    // With a hyphen in the name, clap's Bash script lacks the options of subcommands.
    let name = match shell {
        Shell::Bash => "cargo_fmu",
        _ => "cargo-fmu",
    };
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut command.bin_name(name), name, &mut script);
    if shell == Shell::Bash {
        script.extend_from_slice(BASH.as_bytes());
    }
    script
}
