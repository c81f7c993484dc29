//! Functions that the model description declares as unsupported. Importers bind them anyway, so each
//! returns `fmi2Error` and logs the reason.

use super::{fmi2Component, fmi2Integer, fmi2Status, fmi2StatusKind, fmi2String, with};

const SYNCHRONOUS: &str = "the slave steps synchronously: canRunAsynchronuously is false";

macro_rules! unsupported {
    ($($function:ident($($argument:ty),*): $reason:expr;)*) => {
        $(
            #[doc = concat!("`", stringify!($function), "`")]
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $function(c: fmi2Component, $(_: $argument),*) -> fmi2Status {
                // SAFETY: the caller's promise.
                unsafe { with(c, |component| component.refuse(stringify!($function), $reason)) }
            }
        )*
    };
}

unsupported! {
    fmi2CancelStep(): SYNCHRONOUS;
    fmi2GetStatus(fmi2StatusKind, *mut fmi2Status): SYNCHRONOUS;
    fmi2GetIntegerStatus(fmi2StatusKind, *mut fmi2Integer): SYNCHRONOUS;
    fmi2GetStringStatus(fmi2StatusKind, *mut fmi2String): SYNCHRONOUS;
}
