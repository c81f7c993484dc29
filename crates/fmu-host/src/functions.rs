//! The functions of an instance, made from the rows of `fmi-abi`: each is a method with the arguments in Rust.

use std::sync::Arc;
use std::time::Instant;

use fmi_abi::fmi2::*;
use fmi_abi::fmi3::*;
use fmi_abi::{FmiVersion, fmi2_functions, fmi3_functions};

use crate::library::Library;
use crate::observed::{CallObserver, ToElement, argument, observe};
use crate::outcome::{Cause, Failure, Result};
use crate::types::FmuState;

/// An instance for the functions of its library.
pub(crate) struct Handle {
    pub(crate) library: Arc<Library>,
    /// The component or the instance, as the version of FMI calls it.
    pub(crate) pointer: fmi2Component,
    pub(crate) version: FmiVersion,
    /// Who observes the calls of this instance.
    pub(crate) observer: Option<Arc<dyn CallObserver>>,
    /// The WebAssembly component that is called instead, if the FMU is one.
    #[cfg(feature = "sandbox")]
    pub(crate) component: Option<Box<crate::sandbox::ComponentInstance>>,
}

/// An instance as FMI 2.0 sees it.
pub(crate) struct Fmi2<'a>(pub(crate) &'a mut Handle);

/// An instance as FMI 3.0 sees it.
pub(crate) struct Fmi3<'a>(pub(crate) &'a mut Handle);

/// Defines a method for each function of an instance, made from the rows of `fmi-abi` and named by the operation
/// that it performs. Its arrays are slices, from which the method takes the lengths; where a length counts several
/// slices, the shortest one decides.
macro_rules! functions {
    (
        $inline:ident $version:ident $functions:ident
        Free { $($_0:tt)* }
        $($_1:ident { $($name:ident($($arg:ident: $kind:tt),*) => $operation:ident in $($states:ident)|+;)* })*
    ) => {
        #[allow(dead_code, clippy::too_many_arguments, clippy::useless_conversion, reason = "as in the standard")]
        impl $version<'_> {
            $($(method!($inline $version $functions $name $operation $($states)|+; [] [$($arg: $kind,)*] $($arg: $kind,)*);)*)*
        }
    };
}

macro_rules! method {
    ($inline:ident $v:ident $f:ident $name:ident $op:ident $($s:ident)|+; $done:tt [$n:ident: [len], $($rest:tt)*] $($all:tt)*) => {
        method!($inline $v $f $name $op $($s)|+; $done [$($rest)*] $($all)*);
    };
    ($inline:ident $v:ident $f:ident $name:ident $op:ident $($s:ident)|+; [$($done:tt)*] [$arg:ident: $kind:tt, $($rest:tt)*] $($all:tt)*) => {
        method!($inline $v $f $name $op $($s)|+; [$($done)* $arg: rust_type!($kind),] [$($rest)*] $($all)*);
    };
    ($inline:ident $v:ident $f:ident $name:ident $op:ident $($s:ident)|+; [$($param:ident: $type:ty,)*] [] $($arg:ident: $kind:tt,)*) => {
        #[inline($inline)]
        pub(crate) fn $op(self, $($param: $type),*) -> Result {
            /// Not in the way of the others: the call if it is observed; else the binary lacks the function.
            #[cold]
            #[inline(never)]
            fn observed(handle: &mut Handle, $($param: $type),*) -> Result {
                let name = stringify!($name);
                let missing = || Failure::new(name, Cause::Missing);
                let known = handle.library.observed.as_ref().ok_or_else(missing)?;
                let function = known.$f.$name.ok_or_else(missing)?;
                let observer = handle.observer.as_ref().unwrap_or(&known.observer);
                $(prepare!($arg $kind);)*
                $(measure!($arg $kind);)*
                let status = observe!(
                    observer, name, [$(argument!($arg $kind)),*],
                    // SAFETY: as for a call that is not observed.
                    unsafe { function(handle.pointer, $(c_value!($arg $kind)),*) }.0
                );
                handle.library.outcome(name, status)
            }

            let handle = self.0;
            if handle.version != FmiVersion::$v {
                return Err(Failure::new(stringify!($name), Cause::OtherVersion));
            }
            #[cfg(feature = "sandbox")]
            component!(handle $v $name $op $($s)|+; [$($param),*] $($arg: $kind,)*);
            let library = &*handle.library;
            let Some(function) = library.$f.$name else { return observed(handle, $($param),*) };
            $(prepare!($arg $kind);)*
            $(measure!($arg $kind);)*
            // SAFETY: the standard gives the type, the instance is one of this version and not freed,
            // and every pointer is valid for the length passed with it. The rest depends on the foreign
            // binary, as described in the crate documentation.
            let status = unsafe { function(handle.pointer, $(c_value!($arg $kind)),*) };
            library.outcome(stringify!($name), status.0)
        }
    };
}

/// Calls the component, if the FMU is one. The host asks components for no dependencies.
#[cfg(feature = "sandbox")]
macro_rules! component {
    ($handle:ident Fmi2 $($rest:tt)*) => {};
    ($handle:ident Fmi3 fmi3GetNumberOfVariableDependencies $($rest:tt)*) => {};
    ($handle:ident Fmi3 fmi3GetVariableDependencies $($rest:tt)*) => {};
    ($handle:ident Fmi3 $name:ident $op:ident $($_0:ident)|*; [$($param:ident),*] $($arg:ident: $kind:tt,)*) => {
        if let Some(component) = &mut $handle.component {
            let status = match &$handle.observer {
                None => component.$op($($param),*).0,
                Some(observer) => {
                    $(prepare!($arg $kind);)*
                    $(measure!($arg $kind);)*
                    observe!(
                        observer, stringify!($name), [$(argument!($arg $kind)),*],
                        component.$op($($param),*).0
                    )
                }
            };
            return $handle.library.outcome(stringify!($name), status);
        }
    };
}

/// The type of an argument of a method.
macro_rules! rust_type {
    ([in $(?)? fmi2Byte; $n:ident]) => {
        &[u8]
    };
    ([out $(?)? fmi2Byte; $n:ident]) => {
        &mut [u8]
    };
    ([in $(?)? $type:ident; $n:ident]) => {
        &[$type]
    };
    ([out $(?)? $type:ident; $n:ident]) => {
        &mut [$type]
    };
    ([out? fmi2FMUstate]) => {
        &mut FmuState
    };
    ([out? fmi3FMUState]) => {
        &mut FmuState
    };
    ([out $(?)? $type:ident]) => {
        &mut $type
    };
    (fmi2FMUstate) => {
        &FmuState
    };
    (fmi3FMUState) => {
        &FmuState
    };
    (fmi2Boolean) => {
        bool
    };
    (fmi3Boolean) => {
        bool
    };
    ($type:ty) => {
        $type
    };
}

/// Declares a length.
macro_rules! prepare {
    ($n:ident [len]) => {
        let mut $n = usize::MAX;
    };
    ($arg:ident $kind:tt) => {};
}

/// Limits a length to the length of an array.
macro_rules! measure {
    ($arg:ident [$way:ident $(?)? $type:ident; $n:ident]) => {
        $n = $n.min($arg.len());
    };
    ($arg:ident $kind:tt) => {};
}

/// The C argument for an argument in Rust.
macro_rules! c_value {
    ($arg:ident [in $(?)? $type:ident; $n:ident]) => {
        $arg.as_ptr().cast()
    };
    ($arg:ident [out $(?)? $type:ident; $n:ident]) => {
        $arg.as_mut_ptr().cast()
    };
    ($arg:ident [out $(?)? $type:ident]) => {
        (&raw mut *$arg).cast()
    };
    ($arg:ident $kind:tt) => {
        $arg.into()
    };
}

// The functions of FMI 3.0 are not inlined, so that the functions of FMI 2.0, which are shorter, are.
fmi2_functions!(functions! always Fmi2 fmi2);
fmi3_functions!(functions! never Fmi3 fmi3);
