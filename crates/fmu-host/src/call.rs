//! A method for each function of an instance, made from the rows of `fmi-abi` and named by the operation that
//! it performs. Its arrays are slices, from which the method takes the lengths; where a length counts several
//! slices, the shortest one decides.

use fmi_abi::fmi2::*;
use fmi_abi::fmi3::*;
use fmi_abi::{Version, fmi2_functions, fmi3_functions};

use crate::instance::{Instance, State};
use crate::{Cause, Failure, Result};

/// An instance as FMI 2.0 sees it.
pub(crate) struct Fmi2<'a>(pub(crate) &'a mut Instance);

/// An instance as FMI 3.0 sees it.
pub(crate) struct Fmi3<'a>(pub(crate) &'a mut Instance);

/// Defines the methods of a version: the type of each argument first, without the lengths.
macro_rules! methods {
    (
        $inline:ident $version:ident $functions:ident
        Free { $($_0:tt)* }
        $($_1:ident { $($name:ident($($arg:ident: $kind:tt),*) => $operation:ident in $($_3:ident)|+;)* })*
    ) => {
        #[allow(dead_code, clippy::too_many_arguments, reason = "as in the standard")]
        impl $version<'_> {
            $($(method!($inline $version $functions $name $operation [] [$($arg: $kind,)*] $($arg: $kind,)*);)*)*
        }
    };
}

macro_rules! method {
    ($inline:ident $v:ident $f:ident $name:ident $op:ident $done:tt [$n:ident: [len], $($rest:tt)*] $($all:tt)*) => {
        method!($inline $v $f $name $op $done [$($rest)*] $($all)*);
    };
    ($inline:ident $v:ident $f:ident $name:ident $op:ident [$($done:tt)*] [$arg:ident: $kind:tt, $($rest:tt)*] $($all:tt)*) => {
        method!($inline $v $f $name $op [$($done)* $arg: rust_type!($kind),] [$($rest)*] $($all)*);
    };
    ($inline:ident $v:ident $f:ident $name:ident $op:ident [$($param:ident: $type:ty,)*] [] $($arg:ident: $kind:tt,)*) => {
        #[inline($inline)]
        pub(crate) fn $op(self, $($param: $type),*) -> Result {
            let instance = self.0;
            if instance.version != Version::$v {
                return Err(Failure::new(stringify!($name), Cause::OtherVersion));
            }
            $(prepare!($arg $kind);)*
            $(measure!($arg $kind);)*
            let library = &*instance.library;
            // SAFETY: the standard gives the type, the instance is one of this version and not freed,
            // and every pointer is valid for the length passed with it. The rest depends on the foreign
            // binary, as described in the crate documentation.
            let status = unsafe {
                let function = library.function(library.$f.$name, stringify!($name))?;
                function(instance.pointer, $(c_value!($arg $kind)),*)
            };
            library.outcome(stringify!($name), status.0)
        }
    };
}

/// The type of an argument of a method.
macro_rules! rust_type {
    ([in? fmi2Byte; $n:ident]) => {
        &[u8]
    };
    ([out? fmi2Byte; $n:ident]) => {
        &mut [u8]
    };
    ([in? $type:ty; $n:ident]) => {
        &[$type]
    };
    ([in $type:ty; $n:ident]) => {
        &[$type]
    };
    ([out? $type:ty; $n:ident]) => {
        &mut [$type]
    };
    ([out $type:ty; $n:ident]) => {
        &mut [$type]
    };
    ([out? fmi2FMUstate]) => {
        &mut State
    };
    ([out? fmi3FMUState]) => {
        &mut State
    };
    ([out? $type:ty]) => {
        &mut $type
    };
    ([out $type:ty]) => {
        &mut $type
    };
    (fmi2FMUstate) => {
        &State
    };
    (fmi3FMUState) => {
        &State
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

/// What is passed to the function.
macro_rules! c_value {
    ($arg:ident [in $(?)? $type:ident; $n:ident]) => {
        $arg.as_ptr().cast()
    };
    ($arg:ident [out $(?)? $type:ident; $n:ident]) => {
        $arg.as_mut_ptr().cast()
    };
    ($arg:ident [out? fmi2FMUstate]) => {
        &raw mut $arg.0
    };
    ($arg:ident [out? fmi3FMUState]) => {
        &raw mut $arg.0
    };
    ($arg:ident fmi2FMUstate) => {
        $arg.0
    };
    ($arg:ident fmi3FMUState) => {
        $arg.0
    };
    ($arg:ident fmi2Boolean) => {
        $arg.into()
    };
    ($arg:ident fmi3Boolean) => {
        $arg.into()
    };
    ($arg:ident $kind:tt) => {
        $arg
    };
}

// The functions of FMI 3.0 are not inlined, so that the functions of FMI 2.0, which are shorter, are.
fmi2_functions!(methods! always Fmi2 fmi2);
fmi3_functions!(methods! never Fmi3 fmi3);
