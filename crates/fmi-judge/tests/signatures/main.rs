//! Proves at compile time that the C interfaces of `fmu-export` and `fmu-host`, which are both made from the
//! rows of `fmi-abi`, match the official headers, for which the crate `fmi` provides bindings: all functions
//! of FMI 2.0 and 3.0, the structures, and the status values.
#![allow(non_snake_case, reason = "names of the standard")]

use std::ffi::{c_int, c_uint};

mod fmi2;
mod fmi3;

/// One of our types that has the same C ABI as the type `Official` of the headers.
trait Like<Official> {}

impl<T> Like<T> for T {}
// C enums, which are declared here as integers to accept any value: `fmi2Type` and `fmi2StatusKind`.
impl Like<c_uint> for c_int {}
impl Like<*mut c_uint> for *mut c_int {}

/// Functions are alike if their arguments and results are.
macro_rules! functions {
    ($($mine:ident $official:ident,)*) => {
        impl<$($mine: Like<$official>, $official,)* R: Like<S>, S>
            Like<Option<unsafe extern "C" fn($($official),*) -> S>>
            for unsafe extern "C" fn($($mine),*) -> R
        {
        }
        functions!(@fewer $($mine $official,)*);
    };
    (@fewer) => {};
    (@fewer $first:ident $second:ident, $($rest:tt)*) => { functions!($($rest)*); };
}

functions!(A0 B0, A1 B1, A2 B2, A3 B3, A4 B4, A5 B5, A6 B6, A7 B7, A8 B8, A9 B9, A10 B10, A11 B11,);

/// Compiles if the types are alike.
fn alike<Mine: Like<Official>, Official>(_: Option<Mine>, _: Official) {}

/// Compares the functions of a version with the bindings of the same names, followed by `TYPE`. Never called:
/// compiling it is the proof.
macro_rules! proofs {
    (
        $functions:ident $headers:ident
        Free { $($free:ident($($_0:tt)*) $(-> $_1:ty)? => $_2:ident;)* }
        $($_3:ident { $($name:ident($($_4:tt)*) => $_5:ident in $($_6:ident)|+;)* })*
    ) => {
        paste::paste! {
            const _: fn(&$functions) = |mine| {
                $(crate::alike(mine.$free, None as $headers::[<$free TYPE>]);)*
                $($(crate::alike(mine.$name, None as $headers::[<$name TYPE>]);)*)*
            };
        }
    };
}
pub(crate) use proofs;
