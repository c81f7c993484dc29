//! An instance, and the functions of both kinds of FMU.

use std::ffi::c_char;
use std::ptr;

use super::{Failure, Library, Result};
use crate::library::text;
use fmu_types::fmi2::{
    fmi2Boolean, fmi2CallbackFunctions, fmi2Component, fmi2FMUstate, fmi2False, fmi2Integer,
    fmi2Real, fmi2String, fmi2ValueReference,
};

/// Calls a function of an instance that gives a status: `call!(self.fmi2DoStep(time as fmi2Real))`.
macro_rules! call {
    ($instance:ident.$name:ident($($value:expr => $type:ty),* $(,)?)) => {
        // SAFETY: the type is that of the standard, the instance is not freed, and every pointer is
        // to as many elements as the function is told. The rest is up to the foreign binary, as the
        // module says.
        unsafe {
            type Function = unsafe extern "C" fn(fmi2Component $(, $type)*) -> std::ffi::c_int;
            let name = stringify!($name);
            let function = $instance.library.function::<Function>(name)?;
            $crate::check(name, function($instance.component $(, $value)*))
        }
    };
}
pub(super) use call;

/// An instance of an FMU, freed when it is dropped.
pub struct Instance<'a> {
    pub(super) library: &'a Library,
    pub(super) component: fmi2Component,
    /// The FMU keeps a pointer to them.
    _callbacks: Box<fmi2CallbackFunctions>,
}

/// A state that an FMU has saved of itself; [`Instance::free_state`] frees it.
pub struct State(fmi2FMUstate);

impl<'a> Instance<'a> {
    pub(super) fn new(
        library: &'a Library,
        component: fmi2Component,
        callbacks: Box<fmi2CallbackFunctions>,
    ) -> Self {
        Self {
            library,
            component,
            _callbacks: callbacks,
        }
    }

    /// `fmi2SetupExperiment`
    pub fn setup_experiment(&mut self, start: f64, stop: Option<f64>) -> Result<()> {
        call!(self.fmi2SetupExperiment(
            fmi2False => fmi2Boolean,
            0.0 => fmi2Real,
            start => fmi2Real,
            fmi2Boolean::from(stop.is_some()) => fmi2Boolean,
            stop.unwrap_or_default() => fmi2Real,
        ))
    }

    /// `fmi2EnterInitializationMode`
    pub fn enter_initialization_mode(&mut self) -> Result<()> {
        call!(self.fmi2EnterInitializationMode())
    }

    /// `fmi2ExitInitializationMode`
    pub fn exit_initialization_mode(&mut self) -> Result<()> {
        call!(self.fmi2ExitInitializationMode())
    }

    /// `fmi2Terminate`
    pub fn terminate(&mut self) -> Result<()> {
        call!(self.fmi2Terminate())
    }

    /// `fmi2Reset`
    pub fn reset(&mut self) -> Result<()> {
        call!(self.fmi2Reset())
    }

    /// `fmi2GetReal`
    pub fn real(&mut self, references: &[u32]) -> Result<Vec<f64>> {
        let mut values = vec![0.0; references.len()];
        call!(self.fmi2GetReal(
            references.as_ptr() => *const fmi2ValueReference,
            references.len() => usize,
            values.as_mut_ptr() => *mut fmi2Real,
        ))?;
        Ok(values)
    }

    /// `fmi2GetInteger`
    pub fn integer(&mut self, references: &[u32]) -> Result<Vec<i32>> {
        let mut values = vec![0; references.len()];
        call!(self.fmi2GetInteger(
            references.as_ptr() => *const fmi2ValueReference,
            references.len() => usize,
            values.as_mut_ptr() => *mut fmi2Integer,
        ))?;
        Ok(values)
    }

    /// `fmi2GetBoolean`: numbers, as the FMU may give other ones than 0 and 1.
    pub fn boolean(&mut self, references: &[u32]) -> Result<Vec<i32>> {
        let mut values = vec![0; references.len()];
        call!(self.fmi2GetBoolean(
            references.as_ptr() => *const fmi2ValueReference,
            references.len() => usize,
            values.as_mut_ptr() => *mut fmi2Boolean,
        ))?;
        Ok(values)
    }

    /// `fmi2GetString`
    pub fn string(&mut self, references: &[u32]) -> Result<Vec<String>> {
        let mut values: Vec<fmi2String> = vec![ptr::null(); references.len()];
        call!(self.fmi2GetString(
            references.as_ptr() => *const fmi2ValueReference,
            references.len() => usize,
            values.as_mut_ptr() => *mut fmi2String,
        ))?;
        values
            .into_iter()
            // SAFETY: the FMU's texts live until its next call, by the standard.
            .map(|value| unsafe { text(value) })
            .collect::<Option<_>>()
            .ok_or_else(|| Failure::new("fmi2GetString", "gave NULL for a text"))
    }

    /// `fmi2SetReal`
    pub fn set_real(&mut self, references: &[u32], values: &[f64]) -> Result<()> {
        let n = references.len().min(values.len());
        call!(self.fmi2SetReal(
            references.as_ptr() => *const fmi2ValueReference,
            n => usize,
            values.as_ptr() => *const fmi2Real,
        ))
    }

    /// `fmi2GetFMUstate`
    pub fn state(&mut self) -> Result<State> {
        let mut state = State(ptr::null_mut());
        call!(self.fmi2GetFMUstate(&raw mut state.0 => *mut fmi2FMUstate))?;
        if state.0.is_null() {
            return Err(Failure::new("fmi2GetFMUstate", "gave fmi2OK and no state"));
        }
        Ok(state)
    }

    /// `fmi2SetFMUstate`
    pub fn set_state(&mut self, state: &State) -> Result<()> {
        call!(self.fmi2SetFMUstate(state.0 => fmi2FMUstate))
    }

    /// `fmi2FreeFMUstate`
    pub fn free_state(&mut self, mut state: State) -> Result<()> {
        call!(self.fmi2FreeFMUstate(&raw mut state.0 => *mut fmi2FMUstate))?;
        if state.0.is_null() {
            Ok(())
        } else {
            Err(Failure::new(
                "fmi2FreeFMUstate",
                "did not set the state to NULL",
            ))
        }
    }

    /// `fmi2SerializedFMUstateSize` and `fmi2SerializeFMUstate`; more bytes than `most` are refused.
    pub fn serialize(&mut self, state: &State, most: usize) -> Result<Vec<u8>> {
        let mut size = 0;
        call!(self.fmi2SerializedFMUstateSize(
            state.0 => fmi2FMUstate,
            &raw mut size => *mut usize,
        ))?;
        if size > most {
            let what = format_args!("gave {size} bytes");
            return Err(Failure::new("fmi2SerializedFMUstateSize", what));
        }
        let mut bytes = vec![0; size];
        call!(self.fmi2SerializeFMUstate(
            state.0 => fmi2FMUstate,
            bytes.as_mut_ptr().cast() => *mut c_char,
            size => usize,
        ))?;
        Ok(bytes)
    }

    /// `fmi2DeSerializeFMUstate`
    pub fn deserialize(&mut self, bytes: &[u8]) -> Result<State> {
        let mut state = State(ptr::null_mut());
        call!(self.fmi2DeSerializeFMUstate(
            bytes.as_ptr().cast() => *const c_char,
            bytes.len() => usize,
            &raw mut state.0 => *mut fmi2FMUstate,
        ))?;
        Ok(state)
    }

    /// `fmi2GetDirectionalDerivative`: of `unknowns` by `knowns` in the direction `seed`.
    pub fn directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        seed: &[f64],
    ) -> Result<Vec<f64>> {
        let mut values = vec![0.0; unknowns.len()];
        call!(self.fmi2GetDirectionalDerivative(
            unknowns.as_ptr() => *const fmi2ValueReference,
            unknowns.len() => usize,
            knowns.as_ptr() => *const fmi2ValueReference,
            knowns.len().min(seed.len()) => usize,
            seed.as_ptr() => *const fmi2Real,
            values.as_mut_ptr() => *mut fmi2Real,
        ))?;
        Ok(values)
    }
}

impl Drop for Instance<'_> {
    fn drop(&mut self) {
        type Free = unsafe extern "C" fn(fmi2Component);
        // SAFETY: the type is that of the standard, and nobody uses the instance any more.
        unsafe {
            if let Ok(free) = self.library.function::<Free>("fmi2FreeInstance") {
                free(self.component);
            }
        }
    }
}
