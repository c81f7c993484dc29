//! The words of FMI 2.0 for variables and capabilities.

/// Enums whose variants are the words of an attribute or element.
macro_rules! words {
    ($($(#[$about:meta])* $name:ident { $($(#[$meaning:meta])* $variant:ident = $word:literal,)* })*) => {
        $(
            $(#[$about])*
            #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
            pub enum $name {
                $($(#[$meaning])* $variant,)*
            }

            impl $name {
                /// Every one, in the order of the standard.
                pub const ALL: &[Self] = &[$(Self::$variant),*];

                /// Their words.
                pub const WORDS: &[&str] = &[$($word),*];

                /// The word of the standard.
                pub const fn as_str(self) -> &'static str {
                    match self {
                        $(Self::$variant => $word,)*
                    }
                }

                /// What a word of the standard stands for.
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
    /// Who gives a variable its value (FMI 2.0.4, section 2.2.7).
    Causality {
        /// Set by the host before the simulation, or while it runs if the variability is tunable.
        Parameter = "parameter",
        /// Computed by the model from parameters.
        CalculatedParameter = "calculatedParameter",
        /// Set by the host, mostly from another model's output.
        Input = "input",
        /// Computed by the model, for other models.
        Output = "output",
        /// Computed by the model, for inspection only.
        Local = "local",
        /// The time.
        Independent = "independent",
    }

    /// When a variable may change (FMI 2.0.4, section 2.2.7).
    Variability {
        /// Never.
        Constant = "constant",
        /// Never after the initialization.
        Fixed = "fixed",
        /// When the host sets it, between steps.
        Tunable = "tunable",
        /// At certain instants only.
        Discrete = "discrete",
        /// At any time.
        Continuous = "continuous",
    }

    /// How a variable gets its first value (FMI 2.0.4, section 2.2.7).
    Initial {
        /// It is the start value.
        Exact = "exact",
        /// The start value is a guess.
        Approx = "approx",
        /// It is computed.
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

    /// What a co-simulation slave can do, or needs (FMI 2.0.4, section 4.3.1).
    Capability {
        /// It is a wrapper of a tool, which must be installed.
        NeedsExecutionTool = "needsExecutionTool",
        /// Communication steps may differ.
        CanHandleVariableCommunicationStepSize = "canHandleVariableCommunicationStepSize",
        /// It takes derivatives of inputs.
        CanInterpolateInputs = "canInterpolateInputs",
        /// A step may run in the background; the standard spells it so.
        CanRunAsynchronuously = "canRunAsynchronuously",
        /// A process can have one instance only.
        CanBeInstantiatedOnlyOncePerProcess = "canBeInstantiatedOnlyOncePerProcess",
        /// It does not use the memory callbacks of the host.
        CanNotUseMemoryManagementFunctions = "canNotUseMemoryManagementFunctions",
        /// Its state can be saved and restored.
        CanGetAndSetFMUstate = "canGetAndSetFMUstate",
        /// Its state can be turned into bytes.
        CanSerializeFMUstate = "canSerializeFMUstate",
        /// It computes directional derivatives.
        ProvidesDirectionalDerivative = "providesDirectionalDerivative",
    }
}

impl Initial {
    /// What `initial` means where it is not written (FMI 2.0.4, section 2.2.7): nothing for inputs
    /// and the independent variable.
    pub const fn default_for(causality: Causality, variability: Variability) -> Option<Self> {
        match (causality, variability) {
            (Causality::Input | Causality::Independent, _) => None,
            (Causality::Parameter, _) | (_, Variability::Constant) => Some(Self::Exact),
            _ => Some(Self::Calculated),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_read_as_they_are_written() {
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
