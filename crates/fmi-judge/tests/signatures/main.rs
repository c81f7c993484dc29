//! Proves at compile time that the C interfaces of `fmu-export` and `fmu-host` match the official
//! headers, for which the crate `fmi` provides bindings: all functions of FMI 2.0 and 3.0, the
//! structures, and the status values.
#![allow(non_snake_case, reason = "names of the standard")]

use std::ffi::{c_int, c_uint};

mod fmi2;
mod fmi3;

/// One of our types that has the same C ABI as the type `Official` of the headers.
trait Like<Official> {}

impl<T> Like<T> for T {}
// C enums, which are declared here as integers to accept any value: `fmi2Type` and `fmi2StatusKind`,
// and in the host the status.
impl Like<c_uint> for c_int {}
impl Like<*mut c_uint> for *mut c_int {}

macro_rules! alike {
    ($($check:ident($($mine:ident $official:ident),*);)*) => {
        $(
            const fn $check<$($mine: Like<$official>, $official,)* R: Like<S>, S>(
                _: unsafe extern "C" fn($($mine),*) -> R,
                _: Option<unsafe extern "C" fn($($official),*) -> S>,
            ) {
            }
        )*
    };
}

alike! {
    alike0();
    alike1(A0 B0);
    alike2(A0 B0, A1 B1);
    alike3(A0 B0, A1 B1, A2 B2);
    alike4(A0 B0, A1 B1, A2 B2, A3 B3);
    alike5(A0 B0, A1 B1, A2 B2, A3 B3, A4 B4);
    alike6(A0 B0, A1 B1, A2 B2, A3 B3, A4 B4, A5 B5);
    alike7(A0 B0, A1 B1, A2 B2, A3 B3, A4 B4, A5 B5, A6 B6);
    alike8(A0 B0, A1 B1, A2 B2, A3 B3, A4 B4, A5 B5, A6 B6, A7 B7);
    alike9(A0 B0, A1 B1, A2 B2, A3 B3, A4 B4, A5 B5, A6 B6, A7 B7, A8 B8);
    alike10(A0 B0, A1 B1, A2 B2, A3 B3, A4 B4, A5 B5, A6 B6, A7 B7, A8 B8, A9 B9);
    alike12(A0 B0, A1 B1, A2 B2, A3 B3, A4 B4, A5 B5, A6 B6, A7 B7, A8 B8, A9 B9, A10 B10, A11 B11);
}
