//! A model of a library: its description, and the files of its FMU other than the binaries.

use anyhow::{Context, Result, bail, ensure};
use fmu_description::value::{boolean, integer, real};
use fmu_description::{
    Description, FmiVersion, Hexadecimal, StartValue, Type, VariableDescription, interface, words,
};

use crate::library::Library;

/// A model with its description.
pub struct Model<'a> {
    /// Its library.
    pub library: &'a Library,
    /// Its interface.
    pub description: Description,
    /// The name of the model that it is a variant of, or its own.
    pub base: String,
    /// The version of FMI that it is exported for.
    pub version: FmiVersion,
    /// The text of its `modelDescription.xml`.
    pub xml: String,
}

impl<'a> Model<'a> {
    /// A model that was found in the binary of a library.
    ///
    /// # Errors
    /// Its description cannot be written as XML.
    pub fn new(
        library: &'a Library,
        description: Description,
        version: FmiVersion,
    ) -> Result<Self> {
        let xml = description
            .to_xml_of(version, &library.origin)
            .and_then(|xml| Ok(xml.document()?))
            .with_context(|| format!("the model {} cannot be described", description.name))?;
        Ok(Self {
            library,
            base: description.name.clone(),
            description,
            version,
            xml,
        })
    }

    /// Name of the model and of its binary.
    pub fn name(&self) -> &str {
        &self.description.name
    }

    /// Name of its FMU, which tells the version of FMI.
    pub fn file_name(&self) -> String {
        match self.version {
            FmiVersion::Fmi2 => format!("{}.fmu", self.name()),
            FmiVersion::Fmi3 => format!("{}_fmi3.fmu", self.name()),
        }
    }
}

/// A variant of a model: another name, and other start values.
#[derive(Debug, Default)]
pub struct Variant {
    /// Its name; by default, that of the model.
    pub name: Option<String>,
    /// Names of variables, and their start values as text.
    pub settings: Vec<(String, String)>,
}

impl Variant {
    /// Whether it differs from the model.
    pub fn is_some(&self) -> bool {
        self.name.is_some() || !self.settings.is_empty()
    }

    /// The text that `export!` reads from the environment.
    ///
    /// # Errors
    /// The name is not a C identifier, or a start value cannot be set; the message names the variable,
    /// the value and what is expected.
    pub fn text(&self, model: &Description) -> Result<String> {
        let name = self.name.as_deref().unwrap_or(&model.name);
        ensure!(
            words::is_identifier(name),
            "--name {name}: expected letters, digits and underscores, not starting with a digit"
        );
        let mut values = Vec::new();
        for (variable, text) in &self.settings {
            let value = value(model, variable, text)
                .with_context(|| format!("--set {variable}={text} cannot be used"))?;
            values.push(value);
        }
        Ok(interface::variant(&model.name, name, &values))
    }
}

/// The value reference of a variable, and a text as its start value.
fn value<'a>(model: &Description, name: &str, text: &'a str) -> Result<(usize, StartValue<'a>)> {
    let mut scalars = model.scalars();
    let found = scalars.find(|(_, v, element)| v.element_name(*element) == name);
    let Some((reference, variable, _)) = found else {
        let settable = model.scalars().filter(|(_, v, _)| has_start(v));
        let names: Vec<_> = settable
            .map(|(_, v, element)| v.element_name(element))
            .collect();
        bail!(
            "there is no variable {name}; expected one of {}",
            names.join(", ")
        );
    };
    ensure!(
        has_start(variable),
        "{name} has no start value; the model computes it"
    );
    let value = match &variable.of_type {
        Type::Real {
            single,
            min,
            max,
            unit,
            ..
        } => {
            let value = real(text).map(|value| match single {
                true => f64::from(value as f32),
                false => value,
            });
            let value = value.filter(|value| value.is_finite());
            let value = value.filter(|value| min <= value && value <= max);
            StartValue::Real(value.with_context(|| {
                let (bounds, unit) = (words::bounds(*min, *max), words::in_unit(unit));
                format!("expected a number{bounds}{unit}")
            })?)
        }
        Type::Integer { min, max, .. } => {
            let value = text
                .trim()
                .parse()
                .ok()
                .filter(|value| min <= value && value <= max);
            StartValue::Integer(
                value.with_context(|| format!("expected a whole number from {min} to {max}"))?,
            )
        }
        Type::Boolean { .. } => {
            StartValue::Boolean(boolean(text).context("expected true or false")?)
        }
        Type::String { .. } => StartValue::String(text),
        Type::Binary { .. } => StartValue::Binary(
            Hexadecimal::parse(text).context("expected two hexadecimal digits for each byte")?,
        ),
        Type::Enumeration { items, .. } => {
            let item = items
                .iter()
                .find(|(value, item, _)| item == text || integer(text) == Some(*value));
            let names = || {
                let names: Vec<_> = items.iter().map(|(_, name, _)| name.as_str()).collect();
                format!("expected one of {}", names.join(", "))
            };
            StartValue::Integer(item.with_context(names)?.0.into())
        }
    };
    Ok((reference, value))
}

fn has_start(variable: &VariableDescription) -> bool {
    use fmu_description::Causality::{Input, Parameter, StructuralParameter};
    matches!(variable.causality, Input | Parameter | StructuralParameter)
}

#[cfg(test)]
mod tests {
    use fmu_description::{Causality, Dynamics, IntegerKind, Variability};

    use super::*;

    fn model() -> Description {
        let variable = |name: &str, causality, of_type| VariableDescription {
            name: name.into(),
            description: String::new(),
            causality,
            variability: Variability::Fixed,
            has_input_derivative: false,
            dynamics: Dynamics::Algebraic,
            dimensions: Vec::new(),
            size: None,
            initially_from: Vec::new(),
            depends_on: Vec::new(),
            terminal: String::new(),
            of_type,
        };
        let real = |min, max| Type::Real {
            single: false,
            min,
            max,
            unit: "N/rad".into(),
            start: vec![0.0],
        };
        let items = ["own", "supervisor"];
        let items = (1..)
            .zip(items)
            .map(|(i, name)| (i, name.into(), String::new()));
        let parameter = |name, of_type| variable(name, Causality::Parameter, of_type);
        Description {
            name: "Pid".into(),
            description: String::new(),
            guid: String::new(),
            is_sampled: false,
            is_continuous: false,
            default_experiment: (1.0, 0.1),
            tolerance: 0.0,
            variables: vec![
                variable(
                    "u",
                    Causality::Output,
                    real(f64::NEG_INFINITY, f64::INFINITY),
                ),
                parameter("pid.kp", real(0.0, 1e9)),
                VariableDescription {
                    dimensions: vec![2],
                    ..parameter("w", real(f64::NEG_INFINITY, f64::INFINITY))
                },
                parameter(
                    "order",
                    Type::Integer {
                        kind: IntegerKind::Int32,
                        min: 1,
                        max: 4,
                        start: vec![1],
                    },
                ),
                parameter(
                    "seed",
                    Type::Integer {
                        kind: IntegerKind::UInt64,
                        min: 0,
                        max: u64::MAX.into(),
                        start: vec![0],
                    },
                ),
                parameter(
                    "key",
                    Type::Binary {
                        mime_type: "application/octet-stream".into(),
                        start: vec![vec![]],
                    },
                ),
                parameter(
                    "ratio",
                    Type::Real {
                        single: true,
                        min: f64::NEG_INFINITY,
                        max: f64::INFINITY,
                        unit: String::new(),
                        start: vec![0.0],
                    },
                ),
                parameter("anti_windup", Type::Boolean { start: vec![false] }),
                parameter(
                    "file",
                    Type::String {
                        start: vec![String::new()],
                    },
                ),
                parameter(
                    "target",
                    Type::Enumeration {
                        name: "Target".into(),
                        description: String::new(),
                        items: items.collect(),
                        start: vec![1],
                    },
                ),
            ],
        }
    }

    fn value_of(name: &str, text: &'static str) -> Result<(usize, StartValue<'static>), String> {
        value(&model(), name, text).map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn values_of_every_type_are_read() {
        for (name, text, expected) in [
            ("pid.kp", "4e2", (1, StartValue::Real(400.0))),
            ("w[2]", "-0.5", (3, StartValue::Real(-0.5))),
            ("order", "3", (4, StartValue::Integer(3))),
            (
                "seed",
                "18446744073709551615",
                (5, StartValue::Integer(u64::MAX.into())),
            ),
            (
                "key",
                "00Ff",
                (6, StartValue::Binary(Hexadecimal::parse("00Ff").unwrap())),
            ),
            ("ratio", "0.1", (7, StartValue::Real(f64::from(0.1f32)))),
            ("anti_windup", "true", (8, StartValue::Boolean(true))),
            ("file", "a=b", (9, StartValue::String("a=b"))),
            ("target", "supervisor", (10, StartValue::Integer(2))),
            ("target", "2", (10, StartValue::Integer(2))),
        ] {
            assert_eq!(value_of(name, text), Ok(expected), "{name}={text}");
        }
    }

    #[test]
    fn a_value_that_cannot_be_used_is_refused_with_what_is_expected() {
        for (name, text, expected) in [
            (
                "pid.kp",
                "much",
                "expected a number from 0 to 1000000000 [N/rad]",
            ),
            (
                "pid.kp",
                "nan",
                "expected a number from 0 to 1000000000 [N/rad]",
            ),
            (
                "pid.kp",
                "-1",
                "expected a number from 0 to 1000000000 [N/rad]",
            ),
            ("w[2]", "inf", "expected a number [N/rad]"),
            ("order", "5", "expected a whole number from 1 to 4"),
            ("order", "1.5", "expected a whole number from 1 to 4"),
            (
                "seed",
                "-1",
                "expected a whole number from 0 to 18446744073709551615",
            ),
            (
                "key",
                "0x1",
                "expected two hexadecimal digits for each byte",
            ),
            ("ratio", "1e39", "expected a number"),
            ("anti_windup", "yes", "expected true or false"),
            ("target", "neither", "expected one of own, supervisor"),
            ("u", "1", "u has no start value; the model computes it"),
            (
                "kp",
                "1",
                "there is no variable kp; expected one of pid.kp, w[1], w[2], order, seed, key, ratio, anti_windup, file, target",
            ),
        ] {
            assert_eq!(value_of(name, text), Err(expected.into()), "{name}={text}");
        }
    }

    #[test]
    fn the_name_is_an_identifier() {
        for (name, is_valid) in [
            ("Fast_Pid2", true),
            ("2Pid", false),
            ("Fast-Pid", false),
            ("", false),
        ] {
            let variant = Variant {
                name: Some(name.into()),
                settings: Vec::new(),
            };
            assert_eq!(variant.text(&model()).is_ok(), is_valid, "{name}");
        }
    }

    #[test]
    fn the_error_names_the_option() {
        let variant = Variant {
            name: None,
            settings: vec![("order".into(), "5".into())],
        };
        let error = format!("{:#}", variant.text(&model()).unwrap_err());
        assert!(
            error.starts_with("--set order=5 cannot be used: expected"),
            "{error}"
        );
    }
}
