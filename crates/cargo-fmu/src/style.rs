//! Colours of verdicts, for terminals.

use anstyle::{AnsiColor, Style};

/// What failed.
pub const ERROR: Style = AnsiColor::Red.on_default().bold();
/// What deserves a look.
pub const WARNING: Style = AnsiColor::Yellow.on_default().bold();
/// What is as it should be.
pub const OK: Style = AnsiColor::Green.on_default().bold();
