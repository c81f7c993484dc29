//! The C interface of the Functional Mock-up Interface (FMI), for FMU binaries and for the hosts that load
//! them: the C types, and one row for each function of FMI 2.0 and 3.0.
//!
//! A row has the name and the arguments of a function, the operation that it performs, and the states in
//! which it is allowed:
//!
//! ```text
//! fmi2GetReal(references: [in u32; n], n: [len], values: [out f64; n]) => get_float64 in COMPUTED;
//! ```
//!
//! The operations have the names of FMI 3.0: `fmi2GetReal` and `fmi3GetFloat64` both perform `get_float64`. The
//! macros [`fmi2_functions!`] and [`fmi3_functions!`] pass all rows to another macro, which turns them into
//! whatever it needs: entry points, function pointers, names. [`fmi2::Functions`], [`fmi2::calls`] and
//! [`fmi2::FUNCTIONS`] are made in this way, and those in [`fmi3`].
//!
//! # Rows
//!
//! The first group of rows, `Free`, has the functions that have no instance, or are more than a call of one;
//! all their arguments and results are listed. The other groups are named like the variants of
//! [`FunctionGroup`]. Functions in them have an instance as first argument, which is not listed, and return a
//! status. An argument is one of these:
//!
//! | in the row | means | in C |
//! |---|---|---|
//! | `values: [in T; n]` | an array of `n` elements that the FMU reads | `const T values[]` |
//! | `values: [out T; n]` | an array of `n` elements that the FMU writes | `T values[]` |
//! | `n: [len]` | the length of arrays | `size_t n` |
//! | `value: [out T]` | a variable that the FMU writes | `T* value` |
//! | `[in? T; n]`, `[out? T; n]`, `[out? T]` | the same, but the operation itself treats NULL | |
//! | `value: [*const T]` | another pointer | `const T* value` |
//! | `callback: [Option<T>]` | a function, or NULL | `T callback` |
//! | `value: T` | anything else | `T value` |
//!
//! [`c_type!`] turns the second part into the type in C. Programs that generate code in another language
//! find the arguments as data in [`fmi2::SIGNATURES`] and [`fmi3::SIGNATURES`].
#![no_std]
#![forbid(unsafe_code)]

pub mod fmi2;
pub mod fmi3;
pub mod state;

use state::State;

/// The type in C of an argument of a row, such as `[in f64; n]`; see the [crate].
#[macro_export]
macro_rules! c_type {
    ([in? $type:ty; $length:ident]) => { *const $type };
    ([in $type:ty; $length:ident]) => { *const $type };
    ([out? $type:ty; $length:ident]) => { *mut $type };
    ([out $type:ty; $length:ident]) => { *mut $type };
    ([out? $type:ty]) => { *mut $type };
    ([out $type:ty]) => { *mut $type };
    ([len]) => { usize };
    ([*const $type:ty]) => { *const $type };
    ([Option<$type:ty>]) => { ::core::option::Option<$type> };
    ($type:ty) => { $type };
}

/// The [`Argument`] that a row has under a name, such as `values` and `[in f64; n]`; see the [crate].
macro_rules! argument {
    ($name:ident [in? $type:ty; $length:ident]) => { $crate::argument!($name [in $type; $length]) };
    ($name:ident [in $type:ty; $length:ident]) => {
        $crate::argument!(@ $name InArray { element: stringify!($type), length: stringify!($length) })
    };
    ($name:ident [out? $type:ty; $length:ident]) => { $crate::argument!($name [out $type; $length]) };
    ($name:ident [out $type:ty; $length:ident]) => {
        $crate::argument!(@ $name OutArray { element: stringify!($type), length: stringify!($length) })
    };
    ($name:ident [out? $type:ty]) => { $crate::argument!($name [out $type]) };
    ($name:ident [out $type:ty]) => { $crate::argument!(@ $name Out(stringify!($type))) };
    ($name:ident [len]) => { $crate::argument!(@ $name Length) };
    ($name:ident [*const $type:ty]) => { $crate::argument!(@ $name Pointer(stringify!($type))) };
    ($name:ident [Option<$type:ty>]) => { $crate::argument!(@ $name Callback(stringify!($type))) };
    (@ $name:ident $($kind:tt)*) => {
        $crate::Argument { name: stringify!($name), kind: $crate::ArgumentKind::$($kind)* }
    };
    ($name:ident $type:ty) => { $crate::argument!(@ $name Value(stringify!($type))) };
}
pub(crate) use argument;

/// Turns the rows of a version of FMI into `Functions`, `calls`, `FUNCTIONS` and `SIGNATURES`.
macro_rules! define {
    (
        $instance:ident $status:ident
        Free { $($free:ident($($free_arg:ident: $free_kind:tt),*) $(-> $result:ty)? => $free_operation:ident;)* }
        $($group:ident {
            $($name:ident($($arg:ident: $kind:tt),*) => $operation:ident in $($states:ident)|+;)*
        })*
    ) => {
        /// Pointers to all functions, under their names; `None` for those that a binary lacks.
        #[derive(Debug, Clone, Copy, Default)]
        pub struct Functions {
            $(pub $free: Option<unsafe extern "C" fn($($crate::c_type!($free_kind)),*) $(-> $result)?>,)*
            $($(
                pub $name: Option<unsafe extern "C" fn($instance $(, $crate::c_type!($kind))*) -> $status>,
            )*)*
        }

        /// Each function that is a call of an instance, under its name.
        pub mod calls {
            use $crate::state::*;
            use $crate::{FmiFunction, FunctionGroup};

            $($(
                pub const $name: FmiFunction = FmiFunction {
                    name: stringify!($name),
                    group: FunctionGroup::$group,
                    states: $($states)|+,
                };
            )*)*
        }

        /// All functions, each with the operation that it performs.
        pub const FUNCTIONS: &[($crate::FmiFunction, &str)] = &[
            $(($crate::FmiFunction::free(stringify!($free)), stringify!($free_operation)),)*
            $($((calls::$name, stringify!($operation)),)*)*
        ];

        /// All functions with their arguments. Those of instances have the instance as another one, before these.
        pub const SIGNATURES: &[$crate::Signature] = &[
            $($crate::Signature {
                function: $crate::FmiFunction::free(stringify!($free)),
                has_instance: false,
                arguments: &[$($crate::argument!($free_arg $free_kind)),*],
            },)*
            $($($crate::Signature {
                function: calls::$name,
                has_instance: true,
                arguments: &[$($crate::argument!($arg $kind)),*],
            },)*)*
        ];
    };
}
pub(crate) use define;

/// A version of FMI.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[allow(missing_docs, reason = "their names say it")]
pub enum FmiVersion {
    #[default]
    Fmi2,
    Fmi3,
}

impl FmiVersion {
    /// All versions.
    pub const ALL: [Self; 2] = [Self::Fmi2, Self::Fmi3];

    /// The version that the attribute `fmiVersion` names; `None` if it is another one. All versions 3.x have
    /// the same interface (FMI 3.0.2, section 2.4.1), and a model description without it is of FMI 2.0.
    pub fn named(attribute: Option<&str>) -> Option<Self> {
        match attribute {
            None | Some("2.0") => Some(Self::Fmi2),
            Some(version) => version.starts_with("3.").then_some(Self::Fmi3),
        }
    }

    /// Its number.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Fmi2 => "2.0",
            Self::Fmi3 => "3.0",
        }
    }

    /// The functions of this version, each with the operation that it performs.
    pub const fn functions(self) -> &'static [(FmiFunction, &'static str)] {
        match self {
            Self::Fmi2 => fmi2::FUNCTIONS,
            Self::Fmi3 => fmi3::FUNCTIONS,
        }
    }

    /// The functions of this version with their arguments.
    pub const fn signatures(self) -> &'static [Signature] {
        match self {
            Self::Fmi2 => fmi2::SIGNATURES,
            Self::Fmi3 => fmi3::SIGNATURES,
        }
    }

    /// The function of this version that performs an operation, such as `get_float64`.
    pub fn function(self, operation: &str) -> Option<&'static str> {
        let mut functions = self.functions().iter();
        let (call, _) = functions.find(|(_, performed)| *performed == operation)?;
        Some(call.name)
    }
}

/// An interface type: how a host simulates an FMU.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "kebab-case")
)]
pub enum InterfaceType {
    /// The FMU computes each step.
    #[default]
    CoSimulation = 1,
    /// The host integrates the equations of the FMU.
    ModelExchange = 0,
    /// The host activates the model partitions of the FMU. FMI 2.0 does not have it.
    ScheduledExecution = 2,
}

impl InterfaceType {
    /// All types.
    pub const ALL: [Self; 3] = [Self::CoSimulation, Self::ModelExchange, Self::ScheduledExecution];

    /// Its name in the standard.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::ModelExchange => "model exchange",
            Self::CoSimulation => "co-simulation",
            Self::ScheduledExecution => "scheduled execution",
        }
    }

    /// Its name among options: its name in the standard, as one word.
    pub const fn option_name(self) -> &'static str {
        match self {
            Self::ModelExchange => "model-exchange",
            Self::CoSimulation => "co-simulation",
            Self::ScheduledExecution => "scheduled-execution",
        }
    }

    /// The function of a version that instantiates FMUs of this type.
    pub const fn instantiation(self, version: FmiVersion) -> &'static str {
        match (version, self) {
            (FmiVersion::Fmi2, _) => "fmi2Instantiate",
            (FmiVersion::Fmi3, Self::ModelExchange) => "fmi3InstantiateModelExchange",
            (FmiVersion::Fmi3, Self::CoSimulation) => "fmi3InstantiateCoSimulation",
            (FmiVersion::Fmi3, Self::ScheduledExecution) => "fmi3InstantiateScheduledExecution",
        }
    }

    /// The type with this [name among options](Self::option_name).
    pub fn named(name: &str) -> Option<Self> {
        let mut all = Self::ALL.into_iter();
        all.find(|interface_type| interface_type.option_name() == name)
    }
}

/// A group of rows: the interface types that have its functions, or the models that do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names of the standard")]
pub enum FunctionGroup {
    All,
    /// Models with clocks.
    Clocks,
    ModelExchange,
    CoSimulation,
    ScheduledExecution,
}

/// A function, and the states in which an instance allows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FmiFunction {
    /// Its name in C.
    pub name: &'static str,
    /// The interface types or models that have it.
    pub group: FunctionGroup,
    /// A set of states; see [`state`].
    pub states: u16,
}

impl FmiFunction {
    /// A function that no state forbids.
    const fn free(name: &'static str) -> Self {
        Self { name, group: FunctionGroup::All, states: u16::MAX }
    }

    /// Whether the function is allowed in a state.
    pub const fn is_allowed(&self, state: State) -> bool {
        self.states & state as u16 != 0
    }
}

/// A function with its arguments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Signature {
    /// The function.
    pub function: FmiFunction,
    /// Whether it is a call of an instance, which is its first argument, and returns a status.
    pub has_instance: bool,
    /// The arguments that its row lists.
    pub arguments: &'static [Argument],
}

/// An argument of a function.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Argument {
    /// Its name in the row.
    pub name: &'static str,
    /// What it is.
    pub kind: ArgumentKind,
}

/// What an argument is. Types have their names in the row, such as `f64` or `fmi3String`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ArgumentKind {
    /// An array that the FMU reads.
    InArray {
        /// The type of its elements.
        element: &'static str,
        /// The argument with their number.
        length: &'static str,
    },
    /// An array that the FMU writes.
    OutArray {
        /// The type of its elements.
        element: &'static str,
        /// The argument with their number.
        length: &'static str,
    },
    /// The length of arrays.
    Length,
    /// A variable of this type that the FMU writes.
    Out(&'static str),
    /// A pointer to a constant of this type.
    Pointer(&'static str),
    /// A function of this type, or NULL.
    Callback(&'static str),
    /// A value of this type.
    Value(&'static str),
}
