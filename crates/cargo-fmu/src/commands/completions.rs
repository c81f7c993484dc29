//! `cargo fmu completions`: completion scripts for shells.

use clap::Command;
use clap_complete::Shell;

/// Bash supports one completion per command, and `cargo` already has one: use ours after
/// `cargo fmu`, else the existing one. (Zsh's completion of `cargo` finds `_cargo-fmu` by itself.)
const BASH: &str = r#"
_cargo_fmu_before=$(complete -p cargo 2>/dev/null | sed -n 's/.* -F \([^ ]*\) .*/\1/p')
_cargo_fmu_after_cargo() {
    if [[ ${COMP_WORDS[1]} == fmu && $COMP_CWORD -gt 1 ]]; then
        COMP_WORDS=(cargo_fmu "${COMP_WORDS[@]:2}")
        COMP_CWORD=$((COMP_CWORD - 1))
        _cargo_fmu cargo_fmu "$2" "$3"
    elif [[ -n $_cargo_fmu_before ]]; then
        "$_cargo_fmu_before" "$@"
    fi
}
complete -F _cargo_fmu_after_cargo -o bashdefault -o default cargo
"#;

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
