//! A parameter set that is used for one FMU by itself, without a system.

use anyhow::{Context, Result};

use super::document::document;
use super::parameters::{converted, read};
use super::system::DefinedUnit;
use super::vocabulary::{self, PARAMETER_SET};
use crate::declarations::units;
use crate::{Fmu, Literal};

/// A parameter of a set.
pub struct SetParameter {
    /// Its name, which is the name of a variable.
    pub name: String,
    /// Its value, in its unit.
    pub value: Literal,
    unit: Option<DefinedUnit>,
}

/// The parameters of the text of a parameter set.
///
/// # Errors
/// It is no parameter set, or a value is invalid.
pub fn parameter_set(text: &str) -> Result<Vec<SetParameter>> {
    let set = document(text, PARAMETER_SET)?;
    let own = units(set.list(vocabulary::UNITS_OF_SET, vocabulary::UNIT), vocabulary::BASE_UNIT);
    let parameters = set.list(vocabulary::PARAMETERS, vocabulary::PARAMETER).map(|parameter| {
        let name = parameter.attribute("name").unwrap_or_default();
        let (value, unit) = read(parameter).with_context(|| format!("parameter {name}"))?;
        let unit = unit
            .filter(|unit| !unit.is_empty())
            .map(|unit| DefinedUnit { name: unit.to_owned(), definition: own.get(unit).cloned() });
        Ok(SetParameter { name: name.to_owned(), value, unit })
    });
    parameters.collect()
}

impl SetParameter {
    /// The value in the unit of the variable of an FMU, by the index of the variable.
    ///
    /// # Errors
    /// It cannot be converted.
    pub(crate) fn in_unit_of(&self, fmu: &Fmu, scalar: usize) -> Result<Literal> {
        let of_variable = fmu.variable(scalar).unit.as_deref().unwrap_or_default();
        let Some(unit) = self.unit.as_ref().filter(|unit| unit.name != of_variable) else {
            return Ok(self.value.clone());
        };
        let definition = |name: &str| fmu.unit(name).map(<[_]>::to_vec);
        let from = DefinedUnit {
            definition: unit.definition.clone().or_else(|| definition(&unit.name)),
            name: unit.name.clone(),
        };
        let to = DefinedUnit { definition: definition(of_variable), name: of_variable.to_owned() };
        let conversion = from.conversion(&to);
        let conversion = conversion.with_context(|| format!("{} [{of_variable}]", self.name))?;
        converted(&self.value, conversion).with_context(|| {
            format!("{}: only a Real can be converted to {of_variable}", self.name)
        })
    }
}
