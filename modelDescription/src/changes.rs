//! What changes for importers from one FMU to another, of any vendor and of either version of FMI.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use crate::describe::text;
use crate::value::{boolean, real};
use crate::{Causality, FmiVersion, Initial, ModelDescription, Type, Value, Variability, Variable};

/// What a change means for those who use the first FMU.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Consequence {
    /// Scripts, systems and connections that name variables no longer work.
    Breaks,
    /// Hosts that store value references access other variables.
    MovesReferences,
    /// A simulation with the same inputs may have other results, or a value is refused.
    ChangesResults,
    /// Nothing has to be changed.
    Informs,
}

/// A difference between two FMUs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Change {
    /// What it means.
    pub consequence: Consequence,
    /// The variable, or another part of the FMU.
    pub subject: String,
    /// Which of its properties changes, such as `unit`; or `added`, `removed`, `renamed` or `alias`.
    pub what: String,
    /// The property in the first FMU, if it has it.
    pub from: Option<String>,
    /// The property in the second FMU, or the new name.
    pub to: Option<String>,
}

/// An FMU to compare.
pub struct Compared<'a> {
    /// Its model description.
    pub model: &'a ModelDescription<'a>,
    /// The platforms that it has binaries for.
    pub platforms: BTreeSet<&'a str>,
}

/// Attributes of the model description that only inform.
const HEADER: [&str; 7] =
    ["modelName", "description", "version", "author", "copyright", "license", "generationTool"];
const INTERFACES: [&str; 3] = ["CoSimulation", "ModelExchange", "ScheduledExecution"];
/// Capabilities that restrict a host.
const RESTRICTIONS: [&str; 2] = ["needsExecutionTool", "canBeInstantiatedOnlyOncePerProcess"];
/// Capabilities that every host has to regard.
const REGARDED: [&str; 6] = [
    "modelIdentifier",
    "canNotUseMemoryManagementFunctions",
    "completedIntegratorStepNotNeeded",
    "needsCompletedIntegratorStep",
    "mightReturnEarlyFromDoStep",
    "recommendedIntermediateInputSmoothness",
];

/// The changes from the first FMU to the second, by their consequences.
pub fn changes(from: &Compared<'_>, to: &Compared<'_>) -> Vec<Change> {
    let is_mixed = from.model.version != to.model.version;
    let mut found = Found::default();
    found.variables(&variables(from.model, is_mixed), &variables(to.model, is_mixed), is_mixed);
    found.structure(from.model, to.model);
    found.interfaces(from.model, to.model);
    // The names of platforms depend on the version.
    if !is_mixed {
        found.sets(Consequence::Breaks, "platform", &from.platforms, &to.platforms);
    }
    for name in ["startTime", "stopTime", "stepSize", "tolerance"] {
        let [from, to] = [from, to].map(|fmu| fmu.model.experiment(name).map(|n| n.to_string()));
        found.property(Consequence::ChangesResults, "default experiment", name, from, to);
    }
    let versions = [from, to].map(|fmu| Some(fmu.model.version.as_str().to_owned()));
    let [before, after] = versions;
    found.property(Consequence::Breaks, "FMU", "FMI version", before, after);
    for name in HEADER {
        let [from, to] = [from, to].map(|fmu| fmu.model.root.attribute(name).map(str::to_owned));
        found.property(Consequence::Informs, "FMU", name, from, to);
    }
    let [before, after] = [from, to].map(|fmu| fmu.model.token().to_owned());
    let changes_interface = found.0.iter().any(|c| c.consequence != Consequence::Informs);
    match before == after {
        // Tools that cache by it keep the first FMU.
        true if changes_interface => {
            found.add(Consequence::MovesReferences, "FMU", "same GUID", Some(before), None);
        }
        true => {}
        false => found.property(Consequence::Informs, "FMU", "GUID", Some(before), Some(after)),
    }
    found.0.sort_by_key(|change| change.consequence);
    found.0
}

/// The variables of a model; the elements of arrays, if the other model is of another version.
fn variables(model: &ModelDescription<'_>, are_elements: bool) -> Vec<Variable> {
    let all = model.variables().map(|(_, v)| v);
    let all = all.filter(|v| v.causality != Causality::Independent);
    all.flat_map(|v| {
        let count = if are_elements { v.element_count() } else { 1 };
        (0..count).map(|element| match are_elements {
            true => Variable {
                name: v.element_name(&v.name, element),
                aliases: v.aliases.iter().map(|name| v.element_name(name, element)).collect(),
                dimensions: Vec::new(),
                start: v.start_of(element).cloned().into_iter().collect(),
                of_type: class(v.of_type),
                ..Variable::clone(v)
            },
            false => Variable::clone(v),
        })
    })
    .collect()
}

/// The type of FMI 2.0 for a type of either version.
fn class(of_type: Type) -> Type {
    match of_type.accessed_as(FmiVersion::Fmi2) {
        float if float.is_float() => Type::Float64,
        whole if whole.is_integer() => Type::Int32,
        other => other,
    }
}

#[derive(Default)]
struct Found(Vec<Change>);

impl Found {
    fn add(
        &mut self,
        consequence: Consequence,
        subject: &str,
        what: &str,
        from: Option<String>,
        to: Option<String>,
    ) {
        let (subject, what) = (subject.to_owned(), what.to_owned());
        self.0.push(Change { consequence, subject, what, from, to });
    }

    /// Adds a change of a property, if it changes.
    fn property(
        &mut self,
        consequence: Consequence,
        subject: &str,
        what: &str,
        from: Option<String>,
        to: Option<String>,
    ) {
        if from != to {
            self.add(consequence, subject, what, from, to);
        }
    }

    /// Adds what a set loses, with this consequence, and what it gains.
    fn sets(&mut self, loss: Consequence, kind: &str, from: &BTreeSet<&str>, to: &BTreeSet<&str>) {
        for lost in from.difference(to) {
            self.add(loss, &format!("{kind} {lost}"), "removed", None, None);
        }
        for gained in to.difference(from) {
            self.add(Consequence::Informs, &format!("{kind} {gained}"), "added", None, None);
        }
    }

    fn variables(&mut self, from: &[Variable], to: &[Variable], is_mixed: bool) {
        let value = |v: &Variable| (v.of_type.accessed_as(FmiVersion::Fmi2), v.reference);
        let before: HashMap<&str, &Variable> =
            from.iter().flat_map(|v| v.names().map(move |name| (name, v))).collect();
        let after: HashMap<&str, &Variable> =
            to.iter().flat_map(|v| v.names().map(move |name| (name, v))).collect();
        let mut referred: HashMap<_, &Variable> = HashMap::new();
        for v in to.iter().rev() {
            referred.insert(value(v), v);
        }
        for v in from {
            let Some(new) = after.get(&*v.name).copied() else {
                // Perhaps it has another name, but no alias.
                let other = referred.get(&value(v)).filter(|other| {
                    !is_mixed
                        && other.causality == v.causality
                        && !before.contains_key(&*other.name)
                });
                let other = other.map(|other| other.name.clone());
                self.add(Consequence::Breaks, &v.name, "removed", None, other);
                continue;
            };
            if new.name != v.name {
                self.add(Consequence::Informs, &v.name, "renamed", None, Some(new.name.clone()));
            }
            for alias in v.aliases.iter().filter(|alias| !after.contains_key(&***alias)) {
                self.add(Consequence::Breaks, alias, "removed", None, Some(new.name.clone()));
            }
            self.variable(v, new, is_mixed);
        }
        for v in to.iter().filter(|v| !v.names().any(|name| before.contains_key(name))) {
            // In FMI 2.0, an alias is a variable with the same value reference.
            let mut others = to.iter().filter(|other| value(other) == value(v));
            let of = others.find(|other| before.contains_key(&*other.name));
            match of.filter(|_| !is_mixed) {
                Some(of) => {
                    self.add(Consequence::Informs, &v.name, "alias", None, Some(of.name.clone()));
                }
                None => {
                    let causality = v.causality.as_str().to_owned();
                    self.add(Consequence::Informs, &v.name, "added", None, Some(causality));
                }
            }
        }
    }

    fn variable(&mut self, v: &Variable, new: &Variable, is_mixed: bool) {
        use Consequence::{Breaks, ChangesResults, Informs, MovesReferences};
        let name = &*v.name;
        let both = [v, new];
        let mut property = |consequence, what, [from, to]: [String; 2]| {
            let given = |text: String| Some(text).filter(|text| !text.is_empty());
            self.property(consequence, name, what, given(from), given(to));
        };
        if !is_mixed {
            property(MovesReferences, "value reference", both.map(|v| v.reference.to_string()));
        }
        property(Breaks, "type", both.map(|v| v.of_type.as_str().to_owned()));
        property(Breaks, "dimensions", both.map(|v| format!("{:?}", v.dimensions)));
        property(Breaks, "causality", both.map(|v| v.causality.as_str().to_owned()));
        let variability = match (v.variability, new.variability) {
            (Variability::Tunable, Variability::Fixed) => Breaks,
            (Variability::Fixed, Variability::Tunable) => Informs,
            _ => ChangesResults,
        };
        property(variability, "variability", both.map(|v| v.variability.as_str().to_owned()));
        if is_settable(v) && !is_settable(new) && v.causality == new.causality {
            property(Breaks, "start value", ["can be set".into(), "is calculated".into()]);
        }
        let units = both.map(|v| v.unit.clone().unwrap_or_default());
        let unit = if units.iter().any(String::is_empty) { Informs } else { Breaks };
        property(unit, "unit", units);
        if v.of_type == new.of_type {
            property(ChangesResults, "start", both.map(start));
            let [before, after] = both.map(bounds);
            let is_narrower = |i: usize, sign: f64| match (before[i], after[i]) {
                (Some(before), Some(after)) => sign * after > sign * before,
                (before, after) => before.is_none() && after.is_some(),
            };
            for (i, what, sign) in [(0, "min", 1.0), (1, "max", -1.0)] {
                let consequence = if is_narrower(i, sign) { ChangesResults } else { Informs };
                let text = |bound: &Option<Value>| bound.as_ref().map(text).unwrap_or_default();
                property(
                    consequence,
                    what,
                    both.map(|v| text(if i == 0 { &v.min } else { &v.max })),
                );
            }
        }
        let items = |v: &Variable| {
            let items = v.items().iter();
            items.map(|item| (item.name.clone(), item.value)).collect::<BTreeMap<_, _>>()
        };
        let [before, after] = both.map(items);
        for (item, number) in &before {
            let new = after.get(item).map(i64::to_string).unwrap_or_default();
            let item = format!("{item} = {number}");
            let to = if new == number.to_string() { item.clone() } else { new };
            property(Breaks, "item", [item, to]);
        }
        for (item, number) in after.iter().filter(|(item, _)| !before.contains_key(*item)) {
            property(Informs, "item", [String::new(), format!("{item} = {number}")]);
        }
        property(
            Informs,
            "deprecated",
            both.map(|v| match v.deprecated() {
                Some("") => "yes".to_owned(),
                instead => instead.unwrap_or_default().to_owned(),
            }),
        );
        property(Informs, "display unit", both.map(|v| v.display_unit.clone().unwrap_or_default()));
        if both.iter().all(|v| v.deprecated().is_none()) {
            property(Informs, "description", both.map(|v| v.description.clone()));
        }
    }

    /// Compares on which variables outputs depend at the same instant, and the continuous states.
    fn structure(&mut self, from: &ModelDescription<'_>, to: &ModelDescription<'_>) {
        let [before, after] = [from, to].map(feedthrough);
        for (name, inputs) in &before {
            if let Some(new) = after.get(name) {
                let [from, to] = [inputs, new].map(|inputs| match inputs {
                    None => "all inputs".to_owned(),
                    Some(inputs) if inputs.is_empty() => "nothing".to_owned(),
                    Some(inputs) => Vec::from_iter(inputs.iter().map(String::as_str)).join(", "),
                });
                let what = "direct dependencies";
                self.property(Consequence::ChangesResults, name, what, Some(from), Some(to));
            }
        }
        let [from, to] = [from, to].map(|model| Some(model.derivatives.len().to_string()));
        self.property(Consequence::ChangesResults, "FMU", "continuous states", from, to);
    }

    fn interfaces(&mut self, from: &ModelDescription<'_>, to: &ModelDescription<'_>) {
        for name in INTERFACES {
            let (old, new) = (from.root.child(name), to.root.child(name));
            let (Some(old), Some(new)) = (old, new) else {
                match (old, new) {
                    (Some(_), _) => self.add(Consequence::Breaks, name, "removed", None, None),
                    (_, Some(_)) => self.add(Consequence::Informs, name, "added", None, None),
                    _ => {}
                }
                continue;
            };
            if from.version != to.version {
                continue;
            }
            let names = old.attributes.iter().chain(&new.attributes).map(|(name, _)| *name);
            for attribute in names.collect::<BTreeSet<_>>() {
                let both =
                    [old, new].map(|interface| interface.attribute(attribute).map(str::trim));
                // An absent flag is false, and an absent number 0.
                let [before, after] = both.map(|text| match text.and_then(boolean) {
                    Some(flag) => f64::from(u8::from(flag)),
                    None => text.and_then(real).unwrap_or_default(),
                });
                let is_text = attribute == "modelIdentifier";
                if before == after && !(is_text && both[0] != both[1]) {
                    continue;
                }
                let is_loss = match RESTRICTIONS.contains(&attribute) {
                    true => after > before,
                    false => after < before && !REGARDED.contains(&attribute),
                };
                let consequence = if is_loss { Consequence::Breaks } else { Consequence::Informs };
                let [from, to] = both.map(|text| text.map(str::to_owned));
                self.add(consequence, name, attribute, from, to);
            }
        }
    }
}

/// Whether a host can set a variable or its start value.
fn is_settable(v: &Variable) -> bool {
    let has_start = matches!(v.initial, Some(Initial::Exact | Initial::Approx));
    v.causality == Causality::Input || has_start && v.variability != Variability::Constant
}

/// The start values; one, if all elements have the same.
fn start(v: &Variable) -> String {
    let mut start = Vec::from_iter(v.start.iter().map(text));
    start.dedup();
    start.join(" ")
}

/// The smallest and the largest value as numbers, for comparison.
fn bounds(v: &Variable) -> [Option<f64>; 2] {
    let number = |value: &Value| value.as_real().or(value.as_whole().map(|whole| whole as f64));
    [&v.min, &v.max].map(|bound| bound.as_ref().and_then(number))
}

/// The outputs, and the variables on which each depends at the same instant; `None` for all inputs.
fn feedthrough(model: &ModelDescription<'_>) -> BTreeMap<String, Option<BTreeSet<String>>> {
    let name = |number: u32| Some(model.variable(model.index(number))?.name.clone());
    let outputs = model.outputs.iter().filter_map(|output| {
        let inputs = output.dependencies.as_ref();
        let inputs = inputs.map(|all| all.iter().filter_map(|number| name(*number)).collect());
        Some((model.variable(output.index)?.name.clone(), inputs))
    });
    outputs.collect()
}

#[cfg(test)]
mod tests {
    use super::Consequence::{Breaks, ChangesResults, Informs, MovesReferences};
    use super::*;
    use crate::xml::parse;

    /// The changes between two models of FMI 3.0 with these variables: consequence, and the rest as a text.
    fn between(from: &str, to: &str) -> Vec<(Consequence, String)> {
        let document = |variables: &str| match variables.starts_with("<fmi") {
            true => variables.to_owned(),
            false => format!(
                "<fmiModelDescription fmiVersion='3.0' instantiationToken='{}'><ModelVariables>{variables}\
                 </ModelVariables></fmiModelDescription>",
                variables.len()
            ),
        };
        let documents = [from, to].map(document);
        let roots = documents.each_ref().map(|document| parse(document).unwrap());
        let models = roots.each_ref().map(|root| ModelDescription::read(root).unwrap());
        let [from, to] =
            models.each_ref().map(|model| Compared { model, platforms: BTreeSet::new() });
        let text = |change: Change| {
            let [from, to] = [change.from, change.to].map(Option::unwrap_or_default);
            (change.consequence, format!("{} {}: {from} -> {to}", change.subject, change.what))
        };
        changes(&from, &to)
            .into_iter()
            .map(text)
            .filter(|(_, text)| !text.contains("GUID"))
            .collect()
    }

    /// Asserts what is found between two variables with these attributes and this name.
    #[track_caller]
    fn assert_change(from: &str, to: &str, expected: &[(Consequence, &str)]) {
        let variable = |attributes: &str| match attributes.contains('<') {
            true => attributes.to_owned(),
            false => format!("<Float64 name='k' valueReference='1' {attributes}/>"),
        };
        let found = between(&variable(from), &variable(to));
        let found = Vec::from_iter(found.iter().map(|(consequence, text)| (*consequence, &**text)));
        assert_eq!(found, expected, "{from} -> {to}");
    }

    #[test]
    fn what_hosts_name_breaks() {
        const INPUT: &str = "causality='input' start='0'";
        for (from, to, expected) in [
            (INPUT, "causality='output'", "k causality: input -> output"),
            ("causality='output' unit='N'", "causality='output' unit='kN'", "k unit: N -> kN"),
            (
                "causality='parameter' variability='tunable' start='1'",
                "causality='parameter' start='1'",
                "k variability: tunable -> fixed",
            ),
            ("initial='exact' start='1'", "", "k start value: can be set -> is calculated"),
        ] {
            assert!(
                between_variables(from, to).contains(&(Breaks, expected.to_owned())),
                "{expected}"
            );
        }
        assert_change(
            "",
            "<Float32 name='k' valueReference='1'/>",
            &[(Breaks, "k type: Float64 -> Float32")],
        );
        assert_change(
            "<Float64 name='k' valueReference='1'><Dimension start='2'/></Float64>",
            "<Float64 name='k' valueReference='1'><Dimension start='3'/></Float64>",
            &[(Breaks, "k dimensions: [2] -> [3]")],
        );
        assert_change(
            "",
            "<Float64 name='kp' valueReference='1'/>",
            &[(Breaks, "k removed:  -> kp"), (Informs, "kp added:  -> local")],
        );
    }

    fn between_variables(from: &str, to: &str) -> Vec<(Consequence, String)> {
        let variable = |attributes| format!("<Float64 name='k' valueReference='1' {attributes}/>");
        between(&variable(from), &variable(to))
    }

    #[test]
    fn an_alias_keeps_the_former_name() {
        assert_change(
            "",
            "<Float64 name='kp' valueReference='1'><Alias name='k'/></Float64>",
            &[(Informs, "k renamed:  -> kp")],
        );
        assert_change(
            "<Float64 name='kp' valueReference='1'><Alias name='k'/></Float64>",
            "<Float64 name='kp' valueReference='1'/>",
            &[(Breaks, "k removed:  -> kp")],
        );
        let of_2 = |variables: &str| {
            format!(
                "<fmiModelDescription fmiVersion='2.0'><ModelVariables>{variables}</ModelVariables></fmiModelDescription>"
            )
        };
        const K: &str = "<ScalarVariable name='k' valueReference='1'><Real/></ScalarVariable>";
        let both = K.to_owned() + &K.replace("'k'", "'kp'");
        assert_eq!(between(&of_2(K), &of_2(&both)), [(Informs, "kp alias:  -> k".to_owned())]);
    }

    #[test]
    fn other_consequences_are_told_apart() {
        for (from, to, expected) in [
            ("start='1'", "start='2'", (ChangesResults, "k start: 1 -> 2")),
            ("", "min='0'", (ChangesResults, "k min:  -> 0")),
            ("min='0'", "min='-1'", (Informs, "k min: 0 -> -1")),
            ("max='2'", "max='1'", (ChangesResults, "k max: 2 -> 1")),
            ("max='2'", "", (Informs, "k max: 2 -> ")),
            ("", "unit='N'", (Informs, "k unit:  -> N")),
            (
                "variability='continuous'",
                "variability='discrete'",
                (ChangesResults, "k variability: continuous -> discrete"),
            ),
            ("", "description='gain'", (Informs, "k description:  -> gain")),
            ("", "description='gain (deprecated: use kp)'", (Informs, "k deprecated:  -> use kp")),
        ] {
            let expected = (expected.0, expected.1);
            assert_change(from, to, &[expected]);
        }
        assert_change(
            "",
            "<Float64 name='k' valueReference='2'/>",
            &[(MovesReferences, "k value reference: 1 -> 2")],
        );
        assert_change("", "", &[]);
    }

    #[test]
    fn versions_of_fmi_compare_by_elements() {
        let of_2 = "<fmiModelDescription fmiVersion='2.0'><ModelVariables>
            <ScalarVariable name='w[1]' valueReference='4'><Real start='1'/></ScalarVariable>
            <ScalarVariable name='w[2]' valueReference='5'><Real start='1'/></ScalarVariable>
            </ModelVariables></fmiModelDescription>";
        let of_3 =
            "<Float32 name='w' valueReference='9' start='1 3'><Dimension start='3'/></Float32>";
        let found = between(of_2, of_3);
        let expected = [
            (Breaks, "FMU FMI version: 2.0 -> 3.0"),
            (ChangesResults, "w[2] start: 1 -> 3"),
            (Informs, "w[3] added:  -> local"),
        ];
        assert_eq!(found, expected.map(|(consequence, text)| (consequence, text.to_owned())));
    }

    #[test]
    fn capabilities_that_are_lost_and_restrictions_that_are_gained_break() {
        let with = |attributes: &str| {
            format!(
                "<fmiModelDescription fmiVersion='3.0'><CoSimulation modelIdentifier='m' {attributes}/></fmiModelDescription>"
            )
        };
        for (from, to, expected) in [
            ("hasEventMode='true'", "", Breaks),
            ("", "hasEventMode='1'", Informs),
            ("maxOutputDerivativeOrder='1'", "maxOutputDerivativeOrder='0'", Breaks),
            ("", "needsExecutionTool='true'", Breaks),
            ("needsExecutionTool='true'", "", Informs),
            ("mightReturnEarlyFromDoStep='true'", "", Informs),
        ] {
            let found = between(&with(from), &with(to));
            // The GUID stays the same, which is a finding for tools that cache by it.
            assert_eq!(found.len(), 1, "{found:?}");
            assert_eq!(found[0].0, expected, "{from} -> {to}");
        }
        assert_eq!(between(&with("hasEventMode='false'"), &with("")), []);
    }
}
