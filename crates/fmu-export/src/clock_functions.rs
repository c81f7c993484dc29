//! The table of the C functions for clocks, which only models with clocks have.

use fmi_abi::fmi3::{fmi3Clock, fmi3Instance, fmi3IntervalQualifier, fmi3Status};
use fmi_abi::{c_type, fmi3_functions};

macro_rules! clock_functions {
    (
        Free { $($_0:tt)* }
        All { $($_1:tt)* }
        Clocks { $($name:ident($($arg:ident: $kind:tt),*) => $operation:ident in $($_2:ident)|+;)* }
        $($_3:ident { $($_4:tt)* })*
    ) => {
        /// The functions, under the names of their operations, and the activation of a model partition.
        pub(crate) struct ClockFunctions {
            $(pub(crate) $operation: unsafe extern "C" fn(fmi3Instance, $(c_type!($kind)),*) -> fmi3Status,)*
            pub(crate) activate: unsafe fn(fmi3Instance, u32, f64) -> fmi3Status,
        }
    };
}

fmi3_functions!(clock_functions!);
