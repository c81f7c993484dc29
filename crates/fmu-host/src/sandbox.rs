//! WebAssembly components, run by wasmtime: the interface of the draft FMI-LS-WASM, which `component.wit` of the
//! crate `fmu-build` lists.
//!
//! Each operation of FMI 3.0 is here a method, made from the rows of `fmi-abi`, with the arguments of the function in C
//! as slices. It calls the method of the component that performs the operation. Each instance has a component of its
//! own, with its own memory.
//!
//! Components are taken apart by `wasmtime_environ`, wasmtime's own crate for it, and the functions of their modules are
//! called directly. The typed calls of wasmtime's public interface for components (`component::TypedFunc`) are too slow:
//! with wasmtime 48.0.8, a call took 230 to 300 ns, and a step of a controller and a plant, six such calls, 38 times as
//! long as natively. A step here takes five times as long, by a single call for each FMU (`cycle.rs`); even a single
//! typed call for each would take more than ten times as long.

mod abi;
mod compiled;
mod cycle;
mod host_state;
mod imports;
mod instance;
mod link;
mod outcome;

pub(crate) use self::compiled::CompiledComponent;
pub(crate) use self::instance::ComponentInstance;
pub(crate) use self::outcome::cause;
