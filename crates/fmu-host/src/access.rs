//! Reading and writing values of variables, and derivatives.

use std::ffi::CString;
use std::ptr;

use fmu_types::fmi2::{fmi2Boolean, fmi2Integer, fmi2Real, fmi2String};
use fmu_types::fmi3::{
    fmi3Binary, fmi3Boolean, fmi3Clock, fmi3DependencyKind, fmi3False, fmi3Float32, fmi3Float64,
    fmi3Int8, fmi3Int16, fmi3Int32, fmi3Int64, fmi3String, fmi3UInt8, fmi3UInt16, fmi3UInt32,
    fmi3UInt64,
};

use crate::instance::{call, call_3};
use crate::logger::text;
use crate::{Cause, Failure, Instance, Result, Version};

/// Defines functions that read and write numbers with one function of each version. In FMI 2.0, if the
/// slices differ in length, the rest of the longer one is ignored.
macro_rules! access {
    ($($type:ty: $get:ident $get_2:ident $get_3:ident $set:ident $set_2:ident $set_3:ident;)*) => {
        impl Instance {
            $(
                #[doc = concat!("`", stringify!($get_2), "`, or [`Instance::", stringify!($get_3), "`]")]
                #[inline(always)]
                pub fn $get(&mut self, references: &[u32], values: &mut [$type]) -> Result {
                    let n = references.len().min(values.len());
                    match self.version {
                        Version::Fmi2 => {
                            call!(self.$get_2(references.as_ptr(), n, values.as_mut_ptr()))
                        }
                        Version::Fmi3 => self.$get_3(references, values),
                    }
                }

                #[doc = concat!("`", stringify!($set_2), "`, or [`Instance::", stringify!($set_3), "`]")]
                #[inline(always)]
                pub fn $set(&mut self, references: &[u32], values: &[$type]) -> Result {
                    let n = references.len().min(values.len());
                    match self.version {
                        Version::Fmi2 => {
                            call!(self.$set_2(references.as_ptr(), n, values.as_ptr()))
                        }
                        Version::Fmi3 => self.$set_3(references, values),
                    }
                }
            )*
        }
    };
}

access! {
    fmi2Real: get_real fmi2GetReal get_float64 set_real fmi2SetReal set_float64;
    fmi2Integer: get_integer fmi2GetInteger get_int32 set_integer fmi2SetInteger set_int32;
}

/// Defines functions that read and write numbers of the types of FMI 3.0. They are not inlined, so that
/// those of FMI 2.0 are.
macro_rules! access_3 {
    ($($type:ty: $get:ident $get_3:ident $set:ident $set_3:ident;)*) => {
        impl Instance {
            $(
                #[doc = concat!("`", stringify!($get_3), "`, with the values of all elements")]
                #[inline(never)]
                pub fn $get(&mut self, references: &[u32], values: &mut [$type]) -> Result {
                    let (n, count) = (references.len(), values.len());
                    call_3!(self.$get_3(references.as_ptr(), n, values.as_mut_ptr(), count))
                }

                #[doc = concat!("`", stringify!($set_3), "`, with the values of all elements")]
                #[inline(never)]
                pub fn $set(&mut self, references: &[u32], values: &[$type]) -> Result {
                    let (n, count) = (references.len(), values.len());
                    call_3!(self.$set_3(references.as_ptr(), n, values.as_ptr(), count))
                }
            )*
        }
    };
}

access_3! {
    fmi3Float32: get_float32 fmi3GetFloat32 set_float32 fmi3SetFloat32;
    fmi3Float64: get_float64 fmi3GetFloat64 set_float64 fmi3SetFloat64;
    fmi3Int8: get_int8 fmi3GetInt8 set_int8 fmi3SetInt8;
    fmi3UInt8: get_uint8 fmi3GetUInt8 set_uint8 fmi3SetUInt8;
    fmi3Int16: get_int16 fmi3GetInt16 set_int16 fmi3SetInt16;
    fmi3UInt16: get_uint16 fmi3GetUInt16 set_uint16 fmi3SetUInt16;
    fmi3Int32: get_int32 fmi3GetInt32 set_int32 fmi3SetInt32;
    fmi3UInt32: get_uint32 fmi3GetUInt32 set_uint32 fmi3SetUInt32;
    fmi3Int64: get_int64 fmi3GetInt64 set_int64 fmi3SetInt64;
    fmi3UInt64: get_uint64 fmi3GetUInt64 set_uint64 fmi3SetUInt64;
}

/// A dependency of an element of a variable (FMI 3.0.2, section 2.2.10).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dependency {
    /// The element of the dependent variable, from 1; 0 for all.
    pub element: usize,
    /// The value reference of the variable that it depends on.
    pub independent: u32,
    /// The element of this variable, from 1; 0 for all.
    pub element_of_independent: usize,
    /// `fmi3DependencyKind`
    pub kind: fmi3DependencyKind,
}

impl Instance {
    /// `fmi2GetBoolean`, `fmi3GetBoolean`; as integers, since a foreign FMU may return values other than
    /// 0 and 1.
    pub fn get_boolean(&mut self, references: &[u32], values: &mut [fmi2Boolean]) -> Result {
        let (count, n) = (references.len(), values.len());
        match self.version {
            Version::Fmi2 => {
                call!(self.fmi2GetBoolean(references.as_ptr(), count.min(n), values.as_mut_ptr()))
            }
            Version::Fmi3 => {
                let mut bytes: Vec<fmi3Boolean> = vec![fmi3False; n];
                let got = call_3!(self.fmi3GetBoolean(
                    references.as_ptr(),
                    count,
                    bytes.as_mut_ptr(),
                    n
                ))?;
                for (value, byte) in values.iter_mut().zip(bytes) {
                    *value = byte.into();
                }
                Ok(got)
            }
        }
    }

    /// `fmi2SetBoolean`, `fmi3SetBoolean`; in FMI 3.0 every value but 0 is true.
    pub fn set_boolean(&mut self, references: &[u32], values: &[fmi2Boolean]) -> Result {
        let (count, n) = (references.len(), values.len());
        match self.version {
            Version::Fmi2 => {
                call!(self.fmi2SetBoolean(references.as_ptr(), count.min(n), values.as_ptr()))
            }
            Version::Fmi3 => {
                let bytes: Vec<_> = values.iter().map(|v| fmi3Boolean::from(*v != 0)).collect();
                call_3!(self.fmi3SetBoolean(references.as_ptr(), count, bytes.as_ptr(), n))
            }
        }
    }

    /// `fmi2GetString`, `fmi3GetString` of scalars
    pub fn get_string(&mut self, references: &[u32]) -> Result<Vec<String>> {
        let texts = self.get_string_late(references, || ())?;
        let texts: Option<_> = texts.into_iter().collect();
        let function = self.either("fmi2GetString", "fmi3GetString");
        texts.ok_or_else(|| Failure::new(function, Cause::Broke("returned NULL for a string")))
    }

    /// `fmi2GetString`, `fmi3GetString` of scalars, whose strings are copied only after `between` was
    /// called, which is not to call functions of this instance.
    pub fn get_string_late(
        &mut self,
        references: &[u32],
        between: impl FnOnce(),
    ) -> Result<Vec<Option<String>>> {
        self.get_strings(references, references.len(), between)
    }

    /// As [`Instance::get_string_late`], for variables with `n` elements in total.
    pub fn get_strings(
        &mut self,
        references: &[u32],
        n: usize,
        between: impl FnOnce(),
    ) -> Result<Vec<Option<String>>> {
        let mut values: Vec<fmi2String> = vec![ptr::null(); n];
        let (count, pointers) = (references.len(), values.as_mut_ptr());
        match self.version {
            Version::Fmi2 => {
                call!(self.fmi2GetString(references.as_ptr(), count.min(n), pointers))?
            }
            Version::Fmi3 => call_3!(self.fmi3GetString(references.as_ptr(), count, pointers, n))?,
        };
        between();
        // SAFETY: by the standard, the FMU's strings are valid until its next call.
        let texts = values.into_iter().map(|value| unsafe { text(value) });
        Ok(texts.collect())
    }

    /// `fmi2SetString`, `fmi3SetString`
    pub fn set_string(&mut self, references: &[u32], values: &[CString]) -> Result {
        let values: Vec<fmi3String> = values.iter().map(|value| value.as_ptr()).collect();
        let (count, n) = (references.len(), values.len());
        let (references, values) = (references.as_ptr(), values.as_ptr());
        match self.version {
            Version::Fmi2 => call!(self.fmi2SetString(references, count.min(n), values)),
            Version::Fmi3 => call_3!(self.fmi3SetString(references, count, values, n)),
        }
    }

    /// `fmi3GetBinary` of variables with `n` elements in total.
    pub fn get_binary(&mut self, references: &[u32], n: usize) -> Result<Vec<Vec<u8>>> {
        let mut sizes = vec![0; n];
        let mut values: Vec<fmi3Binary> = vec![ptr::null(); n];
        call_3!(self.fmi3GetBinary(
            references.as_ptr(),
            references.len(),
            sizes.as_mut_ptr(),
            values.as_mut_ptr(),
            n,
        ))?;
        let copied = values.iter().zip(sizes).map(|(value, size)| match size {
            0 => Some(Vec::new()),
            _ if value.is_null() => None,
            // SAFETY: not NULL by the check; by the standard, the bytes are valid until the next call.
            _ => Some(unsafe { std::slice::from_raw_parts(*value, size) }.to_vec()),
        });
        let copied: Option<_> = copied.collect();
        let cause = Cause::Broke("returned NULL for a binary that is not empty");
        copied.ok_or_else(|| Failure::new("fmi3GetBinary", cause))
    }

    /// `fmi3SetBinary`
    pub fn set_binary(&mut self, references: &[u32], values: &[&[u8]]) -> Result {
        let sizes: Vec<usize> = values.iter().map(|value| value.len()).collect();
        let pointers: Vec<fmi3Binary> = values.iter().map(|value| value.as_ptr()).collect();
        call_3!(self.fmi3SetBinary(
            references.as_ptr(),
            references.len(),
            sizes.as_ptr(),
            pointers.as_ptr(),
            values.len(),
        ))
    }

    /// `fmi3GetClock`: whether each clock is active.
    pub fn get_clock(&mut self, references: &[u32]) -> Result<Vec<bool>> {
        let mut values: Vec<fmi3Clock> = vec![fmi3False; references.len()];
        let n = references.len();
        call_3!(self.fmi3GetClock(references.as_ptr(), n, values.as_mut_ptr()))?;
        Ok(values.into_iter().map(|value| value != fmi3False).collect())
    }

    /// `fmi3SetClock`: activates clocks.
    pub fn set_clock(&mut self, references: &[u32], active: bool) -> Result {
        let values: Vec<fmi3Clock> = vec![active.into(); references.len()];
        call_3!(self.fmi3SetClock(references.as_ptr(), references.len(), values.as_ptr()))
    }

    /// `fmi2GetReal` and `fmi2SetReal`, or those of FMI 3.0, of no variables, with NULL for both arrays.
    pub fn get_and_set_nothing(&mut self) -> Result {
        match self.version {
            Version::Fmi2 => {
                call!(self.fmi2GetReal(ptr::null(), 0, ptr::null_mut()))?;
                call!(self.fmi2SetReal(ptr::null(), 0, ptr::null()))
            }
            Version::Fmi3 => {
                call_3!(self.fmi3GetFloat64(ptr::null(), 0, ptr::null_mut(), 0))?;
                call_3!(self.fmi3SetFloat64(ptr::null(), 0, ptr::null(), 0))
            }
        }
    }

    /// `fmi2GetDirectionalDerivative`, `fmi3GetDirectionalDerivative` of scalars `unknowns` with respect to
    /// `knowns` in the direction `seed`.
    pub fn directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        seed: &[f64],
    ) -> Result<Vec<f64>> {
        match self.version {
            Version::Fmi2 => {
                let mut values = vec![0.0; unknowns.len()];
                call!(self.fmi2GetDirectionalDerivative(
                    unknowns.as_ptr(),
                    unknowns.len(),
                    knowns.as_ptr(),
                    knowns.len().min(seed.len()),
                    seed.as_ptr(),
                    values.as_mut_ptr(),
                ))?;
                Ok(values)
            }
            Version::Fmi3 => self.directional_derivatives(unknowns, unknowns.len(), knowns, seed),
        }
    }

    /// `fmi3GetDirectionalDerivative` of `unknowns` with `n` elements in total with respect to `knowns` in
    /// the direction `seed`.
    pub fn directional_derivatives(
        &mut self,
        unknowns: &[u32],
        n: usize,
        knowns: &[u32],
        seed: &[f64],
    ) -> Result<Vec<f64>> {
        let mut values = vec![0.0; n];
        call_3!(self.fmi3GetDirectionalDerivative(
            unknowns.as_ptr(),
            unknowns.len(),
            knowns.as_ptr(),
            knowns.len(),
            seed.as_ptr(),
            seed.len(),
            values.as_mut_ptr(),
            n,
        ))?;
        Ok(values)
    }

    /// `fmi3GetAdjointDerivative` of `unknowns`, whose seed is given, with respect to `knowns` with `n`
    /// elements in total.
    pub fn adjoint_derivatives(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        n: usize,
        seed: &[f64],
    ) -> Result<Vec<f64>> {
        let mut values = vec![0.0; n];
        call_3!(self.fmi3GetAdjointDerivative(
            unknowns.as_ptr(),
            unknowns.len(),
            knowns.as_ptr(),
            knowns.len(),
            seed.as_ptr(),
            seed.len(),
            values.as_mut_ptr(),
            n,
        ))?;
        Ok(values)
    }

    /// `fmi3GetNumberOfVariableDependencies` and `fmi3GetVariableDependencies`
    pub fn variable_dependencies(&mut self, dependent: u32) -> Result<Vec<Dependency>> {
        let mut n = 0;
        call_3!(self.fmi3GetNumberOfVariableDependencies(dependent, &raw mut n))?;
        // More are a mistake of the FMU, and would take the memory of the machine.
        const MAX: usize = 1 << 24;
        if n > MAX {
            let cause = Cause::TooLarge(n);
            return Err(Failure::new("fmi3GetNumberOfVariableDependencies", cause));
        }
        let (mut elements, mut of_independents) = (vec![0; n], vec![0; n]);
        let (mut independents, mut kinds) = (vec![0; n], vec![0; n]);
        call_3!(self.fmi3GetVariableDependencies(
            dependent,
            elements.as_mut_ptr(),
            independents.as_mut_ptr(),
            of_independents.as_mut_ptr(),
            kinds.as_mut_ptr(),
            n,
        ))?;
        let dependency = |i: usize| Dependency {
            element: elements[i],
            independent: independents[i],
            element_of_independent: of_independents[i],
            kind: kinds[i],
        };
        Ok((0..n).map(dependency).collect())
    }
}
