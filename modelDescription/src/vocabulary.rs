//! The keywords of FMI for variables and capabilities.

use std::ffi::{CStr, c_int};

use fmi_abi::FmiVersion;

/// Defines enums whose variants are the keywords of an attribute or element.
macro_rules! words {
    ($($(#[$about:meta])* $name:ident { $($(#[$meaning:meta])* $variant:ident = $word:literal,)* })*) => {
        $(
            $(#[$about])*
            #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
            #[cfg_attr(feature = "xml", derive(serde::Serialize, serde::Deserialize))]
            pub enum $name {
                $($(#[$meaning])* $variant,)*
            }

            impl $name {
                /// The keyword of the standard.
                pub const fn as_str(self) -> &'static str {
                    match self {
                        $(Self::$variant => $word,)*
                    }
                }

                /// Parses a keyword of the standard.
                pub fn parse(word: &str) -> Option<Self> {
                    match word {
                        $($word => Some(Self::$variant),)*
                        _ => None,
                    }
                }
            }
        )*
    };
}

words! {
    /// What determines a variable's value (FMI 2.0.5, section 2.2.7).
    Causality {
        /// Set by the host before the simulation, or also during it if the variability is tunable.
        Parameter = "parameter",
        /// Computed by the model from parameters.
        CalculatedParameter = "calculatedParameter",
        /// Set by the host, usually from another model's output.
        Input = "input",
        /// Computed by the model, for other models.
        Output = "output",
        /// Computed by the model, for inspection only.
        #[default]
        Local = "local",
        /// The independent variable, usually time.
        Independent = "independent",
        /// Sizes arrays; set by the host in configuration mode (FMI 3.0.2, section 2.4.7.4).
        StructuralParameter = "structuralParameter",
    }

    /// When a variable may change (FMI 2.0.5, section 2.2.7).
    Variability {
        /// Never.
        Constant = "constant",
        /// Never after initialization.
        Fixed = "fixed",
        /// When the host sets it, between steps.
        Tunable = "tunable",
        /// At certain instants only.
        Discrete = "discrete",
        /// At any time.
        #[default]
        Continuous = "continuous",
    }

    /// How a variable is initialized (FMI 2.0.5, section 2.2.7).
    Initial {
        /// The initial value is the start value.
        #[default]
        Exact = "exact",
        /// The start value is an initial guess.
        Approx = "approx",
        /// The initial value is computed.
        Calculated = "calculated",
    }

    /// The kind of a clock: how the interval between its ticks is known (FMI 3.0.2, section 2.2.9).
    IntervalVariability {
        /// The interval is constant.
        Constant = "constant",
        /// The host may set the interval during initialization.
        Fixed = "fixed",
        /// The FMU calculates the interval during initialization. In a model description, such a clock is fixed, and has
        /// no interval.
        Calculated = "calculated",
        /// The interval changes with tunable parameters, or the host may set it during the simulation, if a model
        /// description has one.
        Tunable = "tunable",
        /// The FMU says at each tick when the next one is.
        Changing = "changing",
        /// The FMU says at any event when the next tick is.
        Countdown = "countdown",
        /// The clock ticks at instants that are not known in advance.
        #[default]
        Triggered = "triggered",
    }

    /// How the names of variables are written (FMI 2.0.5, section 2.2.9).
    Naming {
        /// With periods between parts, and indices in brackets: `pid.kp`, `rbf.w[1]`.
        #[default]
        Structured = "structured",
        /// Without a structure: `pid_kp`, `rbf_w_1`.
        Flat = "flat",
    }

    /// The type of a variable (FMI 3.0.2, section 2.2.3). A Real of FMI 2.0 is a Float64, and an Integer an
    /// Int32.
    Type {
        /// `f32`
        Float32 = "Float32",
        /// `f64`
        #[default]
        Float64 = "Float64",
        /// `i8`
        Int8 = "Int8",
        /// `u8`
        UInt8 = "UInt8",
        /// `i16`
        Int16 = "Int16",
        /// `u16`
        UInt16 = "UInt16",
        /// `i32`
        Int32 = "Int32",
        /// `u32`
        UInt32 = "UInt32",
        /// `i64`
        Int64 = "Int64",
        /// `u64`
        UInt64 = "UInt64",
        /// True or false.
        Boolean = "Boolean",
        /// A text.
        String = "String",
        /// Bytes.
        Binary = "Binary",
        /// An item of an enumeration.
        Enumeration = "Enumeration",
        /// A clock, which is active or not.
        Clock = "Clock",
    }
}

/// Calls a macro with the types of real numbers, the types of whole numbers, and the other types but Enumeration
/// and Clock, each with its type in Rust.
#[doc(hidden)]
#[macro_export]
macro_rules! types {
    ($($callback:tt)*) => {
        $($callback)* {
            Float32: f32, Float64: f64;
            Int8: i8, UInt8: u8, Int16: i16, UInt16: u16, Int32: i32, UInt32: u32, Int64: i64, UInt64: u64;
            Boolean: bool, String: String, Binary: Vec<u8>
        }
    };
}

/// A log category of FMUs that `fmu-export` makes (FMI 2.0.5, section 2.2.4), in the order of the XML.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "they have descriptions")]
pub enum LogCategory {
    Error,
    Warning,
    Discard,
    Fatal,
    Events,
    Model,
    All,
}

/// A log category that a model declares for messages of its own.
#[derive(Debug, Clone, Copy)]
pub struct OwnCategory {
    /// Its name.
    pub name: &'static CStr,
    /// Its description in the XML.
    pub description: &'static str,
}

impl OwnCategory {
    /// How many a model may have.
    pub const MAX: usize = 24;

    /// The category with a name, which ends with a zero byte.
    pub const fn new(name: &'static str, description: &'static str) -> Self {
        match CStr::from_bytes_with_nul(name.as_bytes()) {
            Ok(name) => Self { name, description },
            Err(_) => panic!("the name of a log category has no zero byte, or several"),
        }
    }
}

impl LogCategory {
    /// The categories of a model: only one with a log of its own has the category for it.
    pub fn of_model(has_log: bool) -> impl Iterator<Item = Self> {
        use LogCategory::{All, Discard, Error, Events, Fatal, Model, Warning};
        let all = [Error, Warning, Discard, Fatal, Events, Model, All];
        all.into_iter().filter(move |category| has_log || *category != Model)
    }

    /// Its name.
    pub const fn name(self) -> &'static CStr {
        match self {
            Self::Error => c"logStatusError",
            Self::Warning => c"logStatusWarning",
            Self::Discard => c"logStatusDiscard",
            Self::Fatal => c"logStatusFatal",
            Self::Events => c"logEvents",
            Self::Model => c"logModel",
            Self::All => c"logAll",
        }
    }

    /// The status that goes with its messages, with the number that it has in both versions of FMI.
    pub const fn status(self) -> c_int {
        match self {
            Self::Events | Self::Model | Self::All => 0,
            Self::Warning => 1,
            Self::Discard => 2,
            Self::Error => 3,
            Self::Fatal => 4,
        }
    }

    /// Its description in the XML.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Error => "calls and steps that failed",
            Self::Warning => "calls that are unusual, but worked",
            Self::Discard => "steps that were discarded, and changed nothing",
            Self::Fatal => "failures after which the instance is dead",
            Self::Events => "state changes of the FMU",
            Self::Model => "messages of the model",
            Self::All => "all messages",
        }
    }
}

impl Initial {
    /// The default of a missing `initial` (FMI 2.0.5, section 2.2.7); `None` for inputs and the
    /// independent variable.
    pub const fn default_for(causality: Causality, variability: Variability) -> Option<Self> {
        match (causality, variability) {
            (Causality::Input | Causality::Independent, _) => None,
            (Causality::Parameter | Causality::StructuralParameter, _)
            | (_, Variability::Constant) => Some(Self::Exact),
            _ => Some(Self::Calculated),
        }
    }
}

impl IntervalVariability {
    /// Whether the clock is periodic: it ticks at a constant or tunable interval.
    pub const fn is_periodic(self) -> bool {
        matches!(self, Self::Constant | Self::Fixed | Self::Calculated | Self::Tunable)
    }

    /// Whether the clock is time-based: its ticks are known in advance.
    pub const fn is_time_based(self) -> bool {
        !matches!(self, Self::Triggered)
    }

    /// The keyword in a model description, which has no word of its own for a calculated interval.
    pub const fn keyword(self) -> &'static str {
        match self {
            Self::Calculated => Self::Fixed.as_str(),
            other => other.as_str(),
        }
    }
}

impl Type {
    /// Its name in a version of FMI.
    pub const fn name(self, version: FmiVersion) -> &'static str {
        match (version, self) {
            (FmiVersion::Fmi2, kind) if kind.is_float() => "Real",
            (FmiVersion::Fmi2, kind) if kind.is_integer() => "Integer",
            _ => self.as_str(),
        }
    }

    /// The type with a name in a version of FMI.
    pub fn of_name(name: &str, version: FmiVersion) -> Option<Self> {
        match (version, name) {
            (FmiVersion::Fmi2, "Real") => Some(Self::Float64),
            (FmiVersion::Fmi2, "Integer") => Some(Self::Int32),
            (FmiVersion::Fmi2, "Binary" | "Clock") => None,
            (_, name) => Self::parse(name).filter(|kind| kind.name(version) == name),
        }
    }

    /// Whether it is a type of real numbers.
    pub const fn is_float(self) -> bool {
        matches!(self, Self::Float32 | Self::Float64)
    }

    /// Whether it is a type of whole numbers; an Enumeration is none.
    pub const fn is_integer(self) -> bool {
        self as u8 >= Self::Int8 as u8 && self as u8 <= Self::UInt64 as u8
    }

    /// The type whose functions get and set a variable: those of an Enumeration are those of an Integer
    /// (FMI 2.0.5, section 2.1.7), or in FMI 3.0 of an Int64.
    pub const fn accessed_as(self, version: FmiVersion) -> Self {
        match (version, self) {
            (FmiVersion::Fmi2, Self::Enumeration) => Self::Int32,
            (FmiVersion::Fmi3, Self::Enumeration) => Self::Int64,
            _ => self,
        }
    }
}
