//! A model of a library: its description, and the files of its FMU other than the binaries.

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use fmu_description::xml::Element;
use fmu_description::{
    Causality, ExportedModel, FmiVersion, InterfaceType, ModelDescription, Value, Variable,
    interface, words,
};

use crate::library::ModelLibrary;
use crate::sources::Sources;

/// A model with its description.
pub struct BuiltModel<'a> {
    /// Its library.
    pub library: &'a ModelLibrary,
    /// Its interface.
    pub description: ExportedModel,
    /// The name of the model that it is a variant of, or its own.
    pub base: String,
    /// The version of FMI that it is exported for.
    pub version: FmiVersion,
    /// Its C sources, if they were made.
    pub sources: Option<Sources>,
    /// The text of its `modelDescription.xml`.
    pub xml: String,
    /// Why tools for Modelica cannot import some of its names as they are.
    pub warnings: Vec<String>,
}

impl<'a> BuiltModel<'a> {
    /// A model that was found in the binary of a library.
    ///
    /// # Errors
    /// Its description cannot be written as XML.
    pub fn new(
        library: &'a ModelLibrary,
        description: ExportedModel,
        version: FmiVersion,
    ) -> Result<Self> {
        let base = description.name.clone();
        check_interface_types(&description)?;
        let undescribed = || format!("the model {base} cannot be described");
        let root = description.to_xml(version, &library.origin).with_context(undescribed)?;
        let xml = root.document().with_context(undescribed)?;
        let found = ModelDescription::new(&root);
        let warnings = found.unimportable().into_iter().map(|(_, reason)| reason).collect();
        Ok(Self { library, base, description, version, sources: None, xml, warnings })
    }

    /// Adds C sources, which a description of FMI 2.0 lists.
    ///
    /// # Errors
    /// Its description cannot be written as XML.
    pub fn add_sources(&mut self, sources: Sources) -> Result<()> {
        if self.version == FmiVersion::Fmi2 {
            let mut root = self.description.to_xml(self.version, &self.library.origin)?;
            let is_interface = |name| ["CoSimulation", "ModelExchange"].contains(&name);
            for interface in root.children.iter_mut().filter(|child| is_interface(child.name)) {
                // C sources take their memory from the host, if it has the functions.
                let of_memory = "canNotUseMemoryManagementFunctions";
                interface.attributes.retain(|(name, _)| *name != of_memory);
                let files = sources.compiled.iter();
                let files = files.map(|name| Element::new("File").with("name", name));
                interface.children.push(Element::new("SourceFiles").holding_all(files));
            }
            self.xml = root.document()?;
        }
        self.sources = Some(sources);
        Ok(())
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

/// Checks that a model has the interface types that are to be exported.
fn check_interface_types(model: &ExportedModel) -> Result<()> {
    let is_wanted = model.interface_types.contains(&InterfaceType::ScheduledExecution);
    if is_wanted && !model.is_for_scheduled_execution() {
        ensure!(
            !model.is_sampled,
            "the samples of the model {} are model partitions only if it has no other interface type; expected --interface scheduled-execution alone",
            model.name
        );
        bail!(
            "the model {} is not for scheduled execution, as it has neither sample times nor clocks; expected --interface co-simulation{}",
            model.name,
            if model.has_events() { " or model-exchange" } else { "" }
        );
    }
    ensure!(
        is_wanted || model.is_for_co_simulation() || model.is_for_model_exchange(),
        "the model {} is not for model exchange, as it has neither a sample time nor equations; expected --interface co-simulation",
        model.name
    );
    Ok(())
}

/// The variables of a model that a version of FMI cannot express, as a list for messages; `None` if there are none.
///
/// # Errors
/// There are some, and they may not be left out, or a variant sets one of them.
pub fn omitted(
    model: &ExportedModel,
    version: FmiVersion,
    variant: &Variant,
    may_omit: bool,
) -> Result<Option<String>> {
    let variables = model.inexpressible(version);
    for (v, reason) in &variables {
        let is_set = |(name, _): &&(String, String)| {
            let name = model.naming.write(name.clone());
            (0..v.element_count()).any(|element| v.element_name(&v.name, element) == name)
        };
        if let Some((name, text)) = variant.settings.iter().find(is_set) {
            bail!(
                "--set {name}={text} cannot be used: FMI {} cannot express {name} ({reason}); expected --fmi 3.0",
                version.as_str()
            );
        }
    }
    let names: Vec<_> = variables.iter().map(|(v, why)| format!("{} ({why})", v.name)).collect();
    let names = names.join(", ");
    ensure!(
        may_omit || names.is_empty(),
        "FMI {} cannot express variables of {}: {names}; expected --fmi 3.0, or --omit-unsupported to leave them out",
        version.as_str(),
        model.name
    );
    let consequence = match (version, model.is_clocked) {
        (FmiVersion::Fmi2, true) => "; without clocks, it never acts",
        (FmiVersion::Fmi2, false) if model.has_clocks() => "; its clocks never tick",
        _ => "",
    };
    Ok((!names.is_empty()).then(|| names + consequence))
}

/// A variant of a model: another name, and other start values.
#[derive(Debug, Default, Args)]
pub struct Variant {
    /// Name of a variant of the model, with other start values
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Start value of a variable in a variant; may be repeated
    #[arg(long = "set", value_name = "VARIABLE=VALUE", value_parser = setting)]
    pub settings: Vec<(String, String)>,
}

fn setting(text: &str) -> Result<(String, String)> {
    let parts = text.split_once('=').filter(|(variable, _)| !variable.is_empty());
    let (variable, value) = parts.context("expected VARIABLE=VALUE")?;
    Ok((variable.to_owned(), value.to_owned()))
}

impl Variant {
    /// Whether it differs from the model.
    pub fn is_some(&self) -> bool {
        self.name.is_some() || !self.settings.is_empty()
    }

    /// The text that `export!` reads from the environment.
    ///
    /// # Errors
    /// The name is not a C identifier, or a start value cannot be set or is set twice; the message names the
    /// variable, the value and what is expected.
    pub fn text(&self, model: &ExportedModel) -> Result<String> {
        let name = self.name.as_deref().unwrap_or(&model.name);
        ensure!(
            words::is_identifier(name),
            "--name {name}: expected letters, digits and underscores, not starting with a digit"
        );
        let mut values = Vec::new();
        for (variable, text) in &self.settings {
            let cannot = || format!("--set {variable}={text} cannot be used");
            let (reference, value) = value(model, variable, text).with_context(cannot)?;
            let mut others = values.iter();
            let is_new = others.all(|(other, _)| *other != reference);
            ensure!(is_new, "{}: it is set twice, expected one value", cannot());
            values.push((reference, value));
        }
        Ok(interface::variant(&model.name, name, &values))
    }
}

/// The value reference of a variable with this name, structured or as the model writes it, and its start value from
/// a text.
fn value(model: &ExportedModel, name: &str, text: &str) -> Result<(usize, Value)> {
    let written = model.naming.write(name.to_owned());
    let mut scalars = model.scalars();
    let found = scalars
        .find(|(_, v, element)| v.names().any(|known| v.element_name(known, *element) == written));
    let Some((reference, variable, _)) = found else {
        let settable = model.scalars().filter(|(_, v, _)| has_start(v));
        let names: Vec<_> =
            settable.map(|(_, v, element)| v.element_name(&v.name, element)).collect();
        bail!("there is no variable {name}; expected one of {}", names.join(", "));
    };
    ensure!(has_start(variable), "{name} is no input or parameter");
    let value = variable.value(text).filter(|value| variable.allows(value));
    let value = value.with_context(|| format!("expected {}", variable.expected()))?;
    Ok((reference, value))
}

fn has_start(variable: &Variable) -> bool {
    variable.causality == Causality::Input || variable.is_parameter()
}

#[cfg(test)]
mod tests {
    use fmu_description::{Naming, Type, xml};

    use super::*;

    const XML: &str = "<fmiModelDescription fmiVersion='3.0'><TypeDefinitions>
        <EnumerationType name='Target'><Item name='own' value='1'/><Item name='supervisor' value='2'/></EnumerationType>
        </TypeDefinitions><ModelVariables>
        <Float64 name='u' valueReference='0' causality='output'/>
        <Float64 name='pid.kp' valueReference='1' causality='parameter' min='0' max='1e9' unit='N/rad'/>
        <Float64 name='w' valueReference='2' causality='parameter' unit='N/rad'><Dimension start='2'/></Float64>
        <Int32 name='order' valueReference='4' causality='parameter' min='1' max='4'/>
        <UInt64 name='seed' valueReference='5' causality='parameter'/>
        <Binary name='key' valueReference='6' causality='parameter'/>
        <Float32 name='ratio' valueReference='7' causality='parameter'/>
        <Boolean name='anti_windup' valueReference='8' causality='parameter'/>
        <String name='file' valueReference='9' causality='parameter'/>
        <Enumeration name='target' valueReference='10' causality='parameter' declaredType='Target'/>
        </ModelVariables></fmiModelDescription>";

    fn model() -> ExportedModel {
        let root = xml::parse(XML).unwrap();
        let read = ModelDescription::read(&root).unwrap();
        let variables = read.variables().map(|(_, v)| Variable::clone(v));
        ExportedModel {
            name: "Pid".into(),
            variables: variables.collect(),
            ..ExportedModel::default()
        }
    }

    fn value_of(name: &str, text: &str) -> Result<(usize, Value), String> {
        value(&model(), name, text).map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn values_of_every_type_are_read() {
        for (name, text, expected) in [
            ("pid.kp", "4e2", (1, Value::Float64(400.0))),
            ("w[2]", "-0.5", (3, Value::Float64(-0.5))),
            ("order", "3", (4, Value::Int32(3))),
            ("seed", "18446744073709551615", (5, Value::UInt64(u64::MAX))),
            ("key", "00Ff", (6, Value::Binary(vec![0, 0xff]))),
            ("ratio", "0.1", (7, Value::Float32(0.1))),
            ("anti_windup", "true", (8, Value::Boolean(true))),
            ("file", "a=b", (9, Value::String("a=b".into()))),
            ("target", "supervisor", (10, Value::Enumeration(2))),
            ("target", "2", (10, Value::Enumeration(2))),
        ] {
            assert_eq!(value_of(name, text), Ok(expected), "{name}={text}");
        }
    }

    #[test]
    fn a_variable_of_a_model_with_flat_names_has_two_names() {
        let mut model = model();
        model.naming = Naming::Flat;
        for v in &mut model.variables {
            v.name = Naming::Flat.write(v.name.clone());
            v.exported.naming = Naming::Flat;
        }
        for (name, reference) in [("pid.kp", 1), ("pid_kp", 1), ("w[2]", 3), ("w_2", 3)] {
            let found = value(&model, name, "1").unwrap();
            assert_eq!(found, (reference, Value::Float64(1.0)), "{name}");
        }
    }

    #[test]
    fn a_value_that_cannot_be_used_is_refused_with_what_is_expected() {
        const GAIN: &str = "expected a number from 0 to 1000000000 [N/rad]";
        for (name, text, expected) in [
            ("pid.kp", "much", GAIN),
            ("pid.kp", "nan", GAIN),
            ("pid.kp", "-1", GAIN),
            ("w[2]", "inf", "expected a number [N/rad]"),
            ("order", "5", "expected a whole number from 1 to 4"),
            ("order", "1.5", "expected a whole number from 1 to 4"),
            ("seed", "-1", "expected a whole number from 0 to 18446744073709551615"),
            ("key", "0x1", "expected two hexadecimal digits for each byte"),
            ("ratio", "1e39", "expected a number"),
            ("anti_windup", "yes", "expected true or false"),
            ("target", "neither", "expected one of own, supervisor"),
            ("u", "1", "u is no input or parameter"),
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
    fn a_model_without_the_interface_type_is_refused() {
        use InterfaceType::{CoSimulation, ModelExchange, ScheduledExecution};
        for (chosen, is_sampled, has_sample_clocks, expected) in [
            (&[][..], false, false, ""),
            (&[CoSimulation], true, false, ""),
            (&[ModelExchange], true, false, ""),
            (&[ModelExchange, CoSimulation], false, false, ""),
            (&[ScheduledExecution], true, true, ""),
            (
                &[ModelExchange],
                false,
                false,
                "the model Pid is not for model exchange, as it has neither a sample time nor equations; expected --interface co-simulation",
            ),
            (
                &[ScheduledExecution],
                false,
                false,
                "the model Pid is not for scheduled execution, as it has neither sample times nor clocks; expected --interface co-simulation",
            ),
            (
                &[CoSimulation, ScheduledExecution],
                true,
                false,
                "the samples of the model Pid are model partitions only if it has no other interface type; expected --interface scheduled-execution alone",
            ),
        ] {
            let is_clocked = has_sample_clocks;
            let interface_types = chosen.to_vec();
            let model = ExportedModel {
                interface_types,
                is_sampled,
                is_clocked,
                has_sample_clocks,
                ..model()
            };
            let checked = check_interface_types(&model).map_err(|error| error.to_string());
            let expected = if expected.is_empty() { Ok(()) } else { Err(expected.to_owned()) };
            assert_eq!(checked, expected, "{chosen:?} {is_sampled}");
        }
    }

    #[test]
    fn what_fmi_2_cannot_express_is_left_out_only_on_demand() {
        let mut model = model();
        let seed = model.variables.iter_mut().find(|v| v.name == "seed").unwrap();
        seed.start = vec![Value::UInt64(1 << 31)];
        let mut variant = Variant::default();
        let omitted = |variant: &Variant, version, may_omit| {
            omitted(&model, version, variant, may_omit).map_err(|error| error.to_string())
        };
        const NAMES: &str = "seed (beyond the 32 bits of an Integer), key (a Binary)";
        assert_eq!(omitted(&variant, FmiVersion::Fmi3, false), Ok(None));
        assert_eq!(omitted(&variant, FmiVersion::Fmi2, true), Ok(Some(NAMES.into())));
        let refusal = omitted(&variant, FmiVersion::Fmi2, false).unwrap_err();
        assert!(refusal.contains(NAMES) && refusal.contains("--omit-unsupported"), "{refusal}");
        variant.settings = vec![("key".into(), "00".into())];
        let refusal = omitted(&variant, FmiVersion::Fmi2, true).unwrap_err();
        assert!(refusal.starts_with("--set key=00 cannot be used: FMI 2.0"), "{refusal}");
        assert_eq!(omitted(&variant, FmiVersion::Fmi3, true), Ok(None));
    }

    #[test]
    fn clocks_and_what_they_change_are_left_out_together() {
        let variable = |name: &str, of_type, clocks| Variable {
            name: name.into(),
            of_type,
            clocks,
            ..Variable::default()
        };
        let variables =
            vec![variable("tick", Type::Clock, vec![]), variable("y", Type::Float64, vec![0])];
        for (is_clocked, end) in
            [(true, "without clocks, it never acts"), (false, "its clocks never tick")]
        {
            let model = ExportedModel { is_clocked, variables: variables.clone(), ..model() };
            let left_out = omitted(&model, FmiVersion::Fmi2, &Variant::default(), true).unwrap();
            let expected = format!("tick (a Clock), y (changes at the ticks of a Clock); {end}");
            assert_eq!(left_out, Some(expected));
            let refusal = omitted(&model, FmiVersion::Fmi2, &Variant::default(), false);
            assert!(refusal.unwrap_err().to_string().contains("tick (a Clock)"));
        }
    }

    #[test]
    fn the_name_is_an_identifier() {
        for (name, is_valid) in
            [("Fast_Pid2", true), ("2Pid", false), ("Fast-Pid", false), ("", false)]
        {
            let variant = Variant { name: Some(name.into()), settings: Vec::new() };
            assert_eq!(variant.text(&model()).is_ok(), is_valid, "{name}");
        }
    }

    #[test]
    fn the_error_names_the_option() {
        for (values, expected) in [
            (&["5"][..], "--set order=5 cannot be used: expected"),
            (&["2", "3"], "--set order=3 cannot be used: it is set twice"),
        ] {
            let settings = values.iter().map(|value| ("order".to_owned(), (*value).to_owned()));
            let variant = Variant { name: None, settings: settings.collect() };
            let error = format!("{:#}", variant.text(&model()).unwrap_err());
            assert!(error.starts_with(expected), "{error}");
        }
    }
}
