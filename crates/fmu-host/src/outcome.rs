//! The outcome of calls.

use std::ffi::c_int;
use std::fmt;

use fmi_abi::FmiVersion;

/// `fmi2Status` or `fmi3Status`, or another integer, as a foreign binary may return any value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names of the standard")]
pub enum Status {
    Ok,
    Warning,
    Discard,
    Error,
    Fatal,
    Pending,
    /// Not a status.
    Unknown(c_int),
}

impl Status {
    /// The status that a function of a version returned; FMI 3.0 does not have `Pending`.
    pub(crate) fn in_version(version: FmiVersion, status: c_int) -> Self {
        match (version, status.into()) {
            (FmiVersion::Fmi3, Self::Pending) => Self::Unknown(status),
            (_, status) => status,
        }
    }
}

impl From<c_int> for Status {
    fn from(status: c_int) -> Self {
        match status {
            0 => Self::Ok,
            1 => Self::Warning,
            2 => Self::Discard,
            3 => Self::Error,
            4 => Self::Fatal,
            5 => Self::Pending,
            other => Self::Unknown(other),
        }
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ok => "fmi2OK",
            Self::Warning => "fmi2Warning",
            Self::Discard => "fmi2Discard",
            Self::Error => "fmi2Error",
            Self::Fatal => "fmi2Fatal",
            Self::Pending => "fmi2Pending",
            Self::Unknown(status) => return write!(f, "{status}, which is not an fmi2Status"),
        })
    }
}

/// A successful call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Success {
    /// `fmi2OK`
    Ok,
    /// `fmi2Warning`, returned by the function of this name.
    Warning(&'static str),
}

/// A failed call.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// The function of FMI.
    pub function: &'static str,
    /// The cause.
    pub cause: Cause,
}

/// The cause of a failed call.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cause {
    /// The binary does not have the function.
    Missing,
    /// The function returned a failure status.
    Returned(Status),
    /// A WebAssembly component has ended in the function, or exceeded a limit. The message that it logs has the reason.
    Trapped,
    /// A function of this program has failed. The message that it logs has the reason.
    Raised,
    /// The function returned success but violated the standard.
    Broke(&'static str),
    /// A string argument contains a zero byte.
    ZeroByte,
    /// The serialized state has more bytes than the caller accepts.
    TooLarge(usize),
    /// The instance is one of another version of FMI, which does not have the function.
    OtherVersion,
    /// The version of FMI of the library has no scheduled execution.
    NotScheduled,
    /// The host does not call the function.
    Unsupported,
    /// The step asked to end the simulation, at this time (s).
    Terminated(f64),
    /// The step ended early, at this time (s), which the host did not allow.
    ReturnedEarly(f64),
    /// The type of the variable cannot represent the value.
    OutOfRange(i128),
}

impl Failure {
    pub(crate) fn new(function: &'static str, cause: Cause) -> Self {
        Self { function, cause }
    }

    /// The cause in words, with the names of the version of FMI that has the function: `returned fmi3Error`.
    pub fn outcome(&self) -> String {
        let outcome = self.cause.to_string();
        match self.cause {
            Cause::Returned(_) if self.function.starts_with("fmi3") => {
                outcome.replace("fmi2", "fmi3")
            }
            _ => outcome,
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing => f.write_str("is missing from the binary"),
            Self::Returned(Status::Pending) => {
                f.write_str("returned fmi2Pending, and asynchronous steps are not supported")
            }
            Self::Returned(status) => write!(f, "returned {status}"),
            Self::Trapped => f.write_str("ended with a trap"),
            Self::Raised => f.write_str("the function failed"),
            Self::Broke(how) => f.write_str(how),
            Self::ZeroByte => f.write_str("cannot take a string that contains a zero byte"),
            Self::OtherVersion => {
                f.write_str("does not exist in the version of FMI of the instance")
            }
            Self::NotScheduled => {
                f.write_str("cannot be called for scheduled execution, which FMI 2.0 does not have")
            }
            Self::Unsupported => f.write_str("is not supported"),
            Self::Terminated(_) => f.write_str("asked to end the simulation"),
            Self::ReturnedEarly(time) => {
                write!(f, "ended the step early at {time:?} s, which was not allowed")
            }
            Self::OutOfRange(value) => write!(f, "cannot take the value {value}"),
            Self::TooLarge(size) => write!(f, "returned a size of {size} bytes"),
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let expected = match self.cause {
            Cause::Returned(_) if self.function.starts_with("fmi3") => ", expected fmi3OK",
            Cause::Returned(_) => ", expected fmi2OK",
            _ => "",
        };
        write!(f, "{} {}{expected}", self.function, self.outcome())
    }
}

impl std::error::Error for Failure {}

/// The result of a call.
pub type Result<T = Success> = std::result::Result<T, Failure>;
