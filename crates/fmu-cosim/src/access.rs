//! Access to variables of all types of numbers of FMI 2.0 and 3.0, with values in the types of the master.

use fmu_description::{FmiVersion, VariableType};
use fmu_host::{Cause, Failure, Instance, Result};

use crate::recorder::Function;

/// Gets real numbers with the function of a type.
#[inline(always)]
pub(crate) fn get_reals(
    slave: &mut Instance,
    access: VariableType,
    references: &[u32],
    values: &mut [f64],
) -> Result {
    match access {
        VariableType::Float32 => get_singles(slave, references, values),
        _ => slave.get_real(references, values),
    }
}

#[inline(never)]
fn get_singles(slave: &mut Instance, references: &[u32], values: &mut [f64]) -> Result {
    get(values, |own| slave.get_float32(references, own))
}

/// Sets real numbers with the function of a type; those of `f32` are rounded.
#[inline(always)]
pub(crate) fn set_reals(
    slave: &mut Instance,
    access: VariableType,
    references: &[u32],
    values: &[f64],
) -> Result {
    match access {
        VariableType::Float32 => set_singles(slave, references, values),
        _ => slave.set_real(references, values),
    }
}

#[inline(never)]
fn set_singles(slave: &mut Instance, references: &[u32], values: &[f64]) -> Result {
    let own: Vec<f32> = values.iter().map(|value| *value as f32).collect();
    slave.set_float32(references, &own)
}

/// Gets whole numbers or Booleans with the function of a type.
pub(crate) fn get_wholes(
    slave: &mut Instance,
    access: VariableType,
    references: &[u32],
    values: &mut [i128],
) -> Result {
    let r = references;
    match access {
        VariableType::Boolean => get(values, |own| slave.get_boolean(r, own)),
        VariableType::Int8 => get(values, |own| slave.get_int8(r, own)),
        VariableType::UInt8 => get(values, |own| slave.get_uint8(r, own)),
        VariableType::Int16 => get(values, |own| slave.get_int16(r, own)),
        VariableType::UInt16 => get(values, |own| slave.get_uint16(r, own)),
        VariableType::UInt32 => get(values, |own| slave.get_uint32(r, own)),
        VariableType::Int64 => get(values, |own| slave.get_int64(r, own)),
        VariableType::UInt64 => get(values, |own| slave.get_uint64(r, own)),
        _ => get(values, |own| slave.get_integer(r, own)),
    }
}

/// Sets whole numbers or Booleans with the function of a type, unless a value does not fit it.
pub(crate) fn set_wholes(
    slave: &mut Instance,
    access: VariableType,
    references: &[u32],
    values: &[i128],
) -> Result {
    let r = references;
    let too_large = |value: i128| {
        let version = match access {
            VariableType::Boolean | VariableType::Integer => FmiVersion::Fmi2,
            _ => FmiVersion::Fmi3,
        };
        Failure {
            function: Function::set(access).name(version),
            cause: Cause::OutOfRange(value as f64),
        }
    };
    match access {
        VariableType::Boolean => slave.set_boolean(r, &own(values).map_err(too_large)?),
        VariableType::Int8 => slave.set_int8(r, &own(values).map_err(too_large)?),
        VariableType::UInt8 => slave.set_uint8(r, &own(values).map_err(too_large)?),
        VariableType::Int16 => slave.set_int16(r, &own(values).map_err(too_large)?),
        VariableType::UInt16 => slave.set_uint16(r, &own(values).map_err(too_large)?),
        VariableType::UInt32 => slave.set_uint32(r, &own(values).map_err(too_large)?),
        VariableType::Int64 => slave.set_int64(r, &own(values).map_err(too_large)?),
        VariableType::UInt64 => slave.set_uint64(r, &own(values).map_err(too_large)?),
        _ => slave.set_integer(r, &own(values).map_err(too_large)?),
    }
}

/// Gets values of another type.
fn get<V: From<T>, T: Copy + Default>(
    values: &mut [V],
    get: impl FnOnce(&mut [T]) -> Result,
) -> Result {
    let mut own = vec![T::default(); values.len()];
    let outcome = get(&mut own)?;
    for (value, own) in values.iter_mut().zip(own) {
        *value = own.into();
    }
    Ok(outcome)
}

/// Whole numbers in another type, or the first that does not fit it.
fn own<T: TryFrom<i128>>(values: &[i128]) -> std::result::Result<Vec<T>, i128> {
    let own = values.iter().map(|v| T::try_from(*v).map_err(|_| *v));
    own.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_that_do_not_fit_are_not_changed() {
        assert_eq!(own::<u64>(&[0, u64::MAX.into()]), Ok(vec![0, u64::MAX]));
        assert_eq!(own::<i8>(&[-128, 127, 128, 300]), Err(128));
        assert_eq!(own::<u8>(&[-1]), Err(-1));
    }
}
