//! Terminal colours of verdicts.

use anstyle::{AnsiColor, Style};

/// Failures.
pub const ERROR: Style = AnsiColor::Red.on_default().bold();
/// Warnings.
pub const WARNING: Style = AnsiColor::Yellow.on_default().bold();
/// Success.
pub const OK: Style = AnsiColor::Green.on_default().bold();
