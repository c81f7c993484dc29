//! The interface of WebAssembly components: the draft FMI-LS-WASM of the layered standard, whose functions
//! are listed in `component.wit` of the crate `fmu-build`.
//!
//! By the canonical ABI of the component model, a list is a pointer and a length, as in C. So most functions
//! have the arguments of the C function that performs the same operation, and call it. Those that return more
//! than a status return a pointer to an [`Answer`](crate::canonical::Answer). The functions have the names of their operations;
//! `fmu-build` exports them under their names in the interfaces of the component.
//!
//! A component cannot catch a panic. It ends with a trap, after a message to the host.
#![allow(
    missing_docs,
    non_upper_case_globals,
    clippy::missing_safety_doc,
    clippy::too_many_arguments,
    reason = "as in the C interface"
)]

mod call;
mod cycle;
mod instantiate;
mod methods;
mod scratch;
