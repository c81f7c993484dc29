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

    /// The type of a variable.
    VariableType {
        /// Real numbers.
        Real = "Real",
        /// Whole numbers.
        Integer = "Integer",
        /// True or false.
        Boolean = "Boolean",
        /// A text.
        String = "String",
        /// An item of an enumeration.
        Enumeration = "Enumeration",
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
            (Causality::Parameter, _) | (_, Variability::Constant) => Some(Self::Exact),
            _ => Some(Self::Calculated),
        }
    }
}

impl VariableType {
    /// The type whose functions get and set a variable: an Enumeration is accessed as an Integer
    /// (FMI 2.0.5, section 2.1.7).
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
