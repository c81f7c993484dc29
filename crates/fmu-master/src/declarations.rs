//! What an FMU declares in its model description, as far as it matters before the FMU is opened.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context, Result};
use fmu_description::value::real;
use fmu_description::xml::{self, Element};
use fmu_description::{Causality, ModelDescription, Type};
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};

/// The declarations of an FMU.
pub(crate) struct Declarations {
    /// The start time, stop time and step size (s) of its default experiment, if it has them.
    pub(crate) experiment: [Option<f64>; 3],
    /// The variables by their names.
    pub(crate) variables: HashMap<String, DeclaredVariable>,
    pub(crate) units: Units,
}

/// What an FMU declares of a variable.
#[derive(Clone)]
pub(crate) struct DeclaredVariable {
    pub(crate) of_type: Type,
    pub(crate) unit: Option<String>,
    pub(crate) mime_type: Option<String>,
    /// Whether it is a clock that the master ticks.
    pub(crate) is_time_based: bool,
    /// The names of the clocks at whose ticks it changes.
    pub(crate) clocks: Vec<String>,
    pub(crate) dimensions: Vec<DeclaredLength>,
}

/// The length of a dimension.
#[derive(Clone)]
pub(crate) struct DeclaredLength {
    /// By default.
    pub(crate) default: usize,
    /// The structural parameter that sets it.
    pub(crate) parameter: Option<String>,
}

impl Declarations {
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let text = Archive::open_sound(path)?.model_description()?;
        let root = xml::parse(&text).with_context(|| MODEL_DESCRIPTION)?;
        let model = ModelDescription::read(&root)?;
        let parameters = model.variables().map(|(_, v)| v);
        let parameters = parameters.filter(|v| v.causality == Causality::StructuralParameter);
        let parameters: HashMap<_, _> =
            parameters.map(|v| (v.reference.to_string(), v.name.clone())).collect();
        let clocks = model.variables().filter(|(_, v)| v.of_type == Type::Clock);
        let clocks: HashMap<u32, _> = clocks.map(|(_, v)| (v.reference, v.name.clone())).collect();
        let named = model.variables().flat_map(|(_, v)| {
            let lengths = v.element.children("Dimension").zip(&v.dimensions);
            let lengths = lengths.map(|(dimension, length)| DeclaredLength {
                default: *length,
                parameter: (dimension.attribute("valueReference"))
                    .and_then(|reference| parameters.get(reference.trim()).cloned()),
            });
            let declared = DeclaredVariable {
                of_type: v.of_type,
                unit: v.unit.clone(),
                mime_type: v.mime_type.clone(),
                is_time_based: v
                    .clock
                    .is_some_and(|clock| clock.interval_variability.is_time_based()),
                clocks: v.clocks.iter().filter_map(|clock| clocks.get(clock).cloned()).collect(),
                dimensions: lengths.collect(),
            };
            v.names().map(|name| (name.to_owned(), declared.clone())).collect::<Vec<_>>()
        });
        Ok(Self {
            experiment: ["startTime", "stopTime", "stepSize"].map(|name| model.experiment(name)),
            variables: named.collect(),
            units: units(root.list("UnitDefinitions", "Unit"), "BaseUnit"),
        })
    }
}

/// The definitions of units by their names.
pub(crate) type Units = HashMap<String, Vec<(String, f64)>>;

/// The definitions of units in base units: exponents, factor and offset that differ from the default.
pub(crate) fn units<'a>(units: impl Iterator<Item = &'a Element<'a>>, base: &str) -> Units {
    units
        .filter_map(|unit| {
            let base = unit.child(base)?;
            let mut parts: Vec<(String, f64)> = base
                .attributes
                .iter()
                .filter_map(|(name, value)| Some(((*name).to_owned(), real(value)?)))
                .filter(|(name, value)| *value != if name == "factor" { 1.0 } else { 0.0 })
                .collect();
            parts.sort_by(|a, b| a.0.cmp(&b.0));
            Some((unit.attribute("name")?.to_owned(), parts))
        })
        .collect()
}
