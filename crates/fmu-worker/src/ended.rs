//! How a process ended, in plain words.

use std::fmt;
use std::process::ExitStatus;
use std::time::Duration;

/// How a process ended. Its text follows a subject: "fmi2DoStep" + " " + "was ended by signal 6, abort".
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// By itself, or by a signal.
    Exited(ExitStatus),
    /// Killed after this time.
    TimedOut(Duration),
    /// Killed when it used this many bytes of memory.
    OutOfMemory(u64),
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exited(status) => f.write_str(&exited(*status)),
            Self::TimedOut(limit) => {
                let seconds = limit.as_secs_f64();
                write!(f, "did not return within {seconds} s and was killed")
            }
            Self::OutOfMemory(bytes) => {
                let gigabytes = *bytes as f64 / 1e9;
                write!(
                    f,
                    "used more than {gigabytes:.1} GB of memory and was killed"
                )
            }
        }
    }
}

fn exited(status: ExitStatus) -> String {
    #[cfg(unix)]
    if let Some(signal) = std::os::unix::process::ExitStatusExt::signal(&status) {
        let name = match signal {
            4 => "illegal instruction",
            5 => "trap",
            6 => "abort",
            8 => "arithmetic error",
            9 => "killed",
            7 | 11 => "illegal memory access",
            15 => "terminated",
            _ => return format!("was ended by signal {signal}"),
        };
        return format!("was ended by signal {signal}, {name}");
    }
    match status.code() {
        // Windows reports a crash as an exit code, such as 0xC0000005 for an access violation.
        Some(code) if cfg!(windows) && code < 0 => {
            format!("was ended by the exception {code:#010X}")
        }
        Some(code) => format!("exited with code {code} before it had finished"),
        None => status.to_string(),
    }
}
