//! The keywords of FMI 2.0 for variables and capabilities.

use std::ffi::CStr;

/// Defines enums whose variants are the keywords of an attribute or element.
macro_rules! words {
    ($($(#[$about:meta])* $name:ident { $($(#[$meaning:meta])* $variant:ident = $word:literal,)* })*) => {
        $(
            $(#[$about])*
            #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
            pub enum $name {
                $($(#[$meaning])* $variant,)*
            }

            impl $name {
                /// All variants, in the order of the standard.
                pub const ALL: &[Self] = &[$(Self::$variant),*];

                /// Their keywords.
                pub const WORDS: &[&str] = &[$($word),*];

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
        Continuous = "continuous",
    }

    /// How a variable is initialized (FMI 2.0.5, section 2.2.7).
    Initial {
        /// The initial value is the start value.
        Exact = "exact",
        /// The start value is an initial guess.
        Approx = "approx",
        /// The initial value is computed.
        Calculated = "calculated",
    }

    /// The type of a variable (FMI 2.0.5, section 2.2.7; FMI 3.0.2, section 2.4.7.4).
    VariableType {
        /// Real numbers of FMI 2.0.
        Real = "Real",
        /// Whole numbers of FMI 2.0.
        Integer = "Integer",
        /// True or false.
        Boolean = "Boolean",
        /// A text.
        String = "String",
        /// An item of an enumeration.
        Enumeration = "Enumeration",
        /// `f32`
        Float32 = "Float32",
        /// `f64`
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
        /// Bytes.
        Binary = "Binary",
        /// A clock, which is active or not.
        Clock = "Clock",
    }

    /// The type of a whole number (FMI 3.0.2, section 2.2.3). FMI 2.0 has only that of 32 bits.
    IntegerKind {
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
    }

    /// Capability flags of a co-simulation slave (FMI 2.0.5, section 4.3.1).
    Capability {
        /// The FMU is a wrapper of a tool that must be installed.
        NeedsExecutionTool = "needsExecutionTool",
        /// The communication step size may vary.
        CanHandleVariableCommunicationStepSize = "canHandleVariableCommunicationStepSize",
        /// The slave accepts input derivatives.
        CanInterpolateInputs = "canInterpolateInputs",
        /// A step may run in the background. The spelling is the standard's.
        CanRunAsynchronuously = "canRunAsynchronuously",
        /// Only one instance per process is possible.
        CanBeInstantiatedOnlyOncePerProcess = "canBeInstantiatedOnlyOncePerProcess",
        /// The FMU does not use the memory callbacks of the host.
        CanNotUseMemoryManagementFunctions = "canNotUseMemoryManagementFunctions",
        /// Its state can be saved and restored.
        CanGetAndSetFMUstate = "canGetAndSetFMUstate",
        /// Its state can be serialized.
        CanSerializeFMUstate = "canSerializeFMUstate",
        /// It computes directional derivatives.
        ProvidesDirectionalDerivative = "providesDirectionalDerivative",
    }
}

/// Names and descriptions of the log categories of FMUs that `fmu-export` makes (FMI 2.0.5, section
/// 2.2.4).
pub const LOG_CATEGORIES: [(&CStr, &str); 6] = [
    (c"logStatusError", "calls and steps that failed"),
    (c"logStatusWarning", "calls that are unusual, but worked"),
    (
        c"logStatusDiscard",
        "steps that were discarded, and changed nothing",
    ),
    (
        c"logStatusFatal",
        "failures after which the instance is dead",
    ),
    (c"logEvents", "changes of the slave's state"),
    (c"logAll", "all messages"),
];

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

impl IntegerKind {
    /// The smallest and the largest value.
    pub const fn range(self) -> (i128, i128) {
        match self {
            Self::Int8 => (i8::MIN as i128, i8::MAX as i128),
            Self::UInt8 => (0, u8::MAX as i128),
            Self::Int16 => (i16::MIN as i128, i16::MAX as i128),
            Self::UInt16 => (0, u16::MAX as i128),
            Self::Int32 => (i32::MIN as i128, i32::MAX as i128),
            Self::UInt32 => (0, u32::MAX as i128),
            Self::Int64 => (i64::MIN as i128, i64::MAX as i128),
            Self::UInt64 => (0, u64::MAX as i128),
        }
    }
}

impl VariableType {
    /// The types of a version of FMI.
    #[cfg(feature = "xml")]
    pub fn of(version: crate::FmiVersion) -> impl Iterator<Item = Self> {
        let of_both = [Self::Boolean, Self::String, Self::Enumeration];
        let is_of_2 = |kind| matches!(kind, Self::Real | Self::Integer);
        let all = Self::ALL.iter().copied();
        all.filter(move |kind| {
            of_both.contains(kind) || is_of_2(*kind) == (version == crate::FmiVersion::Fmi2)
        })
    }

    /// Whether it is a type of real numbers.
    pub const fn is_float(self) -> bool {
        matches!(self, Self::Real | Self::Float32 | Self::Float64)
    }

    /// The type of a whole number, if it is one; that of an Enumeration in FMI 3.0 is Int64, of which
    /// the Integer of FMI 2.0 is a part.
    pub fn integer(self) -> Option<IntegerKind> {
        match self {
            Self::Integer => Some(IntegerKind::Int32),
            Self::Enumeration => Some(IntegerKind::Int64),
            other => IntegerKind::parse(other.as_str()),
        }
    }

    /// The type whose functions get and set a variable of FMI 2.0: an Enumeration is accessed as an
    /// Integer (FMI 2.0.5, section 2.1.7).
    pub fn accessed_as(self) -> Self {
        match self {
            Self::Enumeration => Self::Integer,
            other => other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keywords_round_trip() {
        for &causality in Causality::ALL {
            assert_eq!(Causality::parse(causality.as_str()), Some(causality));
        }
        assert_eq!(
            Variability::parse("continuous"),
            Some(Variability::Continuous)
        );
        assert_eq!(Initial::parse("Exact"), None);
    }
}
