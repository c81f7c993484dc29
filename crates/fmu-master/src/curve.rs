//! How a plot draws the recorded variables: which keep their value between rows, and which is the set-point of which.
//!
//! A set-point has the name of one: `r`, `reference`, `setpoint` and the others of `SET_POINTS`, or with such a word
//! before or after a quantity, `speed_ref`. It belongs to another variable of the same unit, by the first of these that
//! finds one:
//!
//! 1. Connections: a component with the input `r` compares it with its input `y` (of `speed_ref`, `speed`; else with the
//!    only other input of the unit). The recorded variables are the inputs themselves or the outputs that feed them.
//! 2. Names: the same component has a recorded variable `y` (`speed`).
//! 3. Units: the set-point is the only one of its unit, and so is the other variable, apart from errors and
//!    disturbances.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};

use fmu_description::{Causality, Variability};

use crate::Plan;
use crate::components::ScalarId;
use crate::table::Column;

/// How a plot draws a recorded variable.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Curve {
    /// Whether it keeps its value until the next row: it is not continuous, or its component is sampled.
    pub is_held: bool,
    /// The index of the recorded variable that is its set-point.
    pub set_point: Option<usize>,
}

/// The names of set-points: of textbooks, and of the block `LimPID` of Modelica.
const SET_POINTS: &[&str] =
    &["r", "w", "ref", "reference", "setpoint", "sp", "target", "desired", "u_s"];
/// The words that make a set-point of a quantity.
const WORDS: &[&str] = &["ref", "reference", "setpoint", "sp", "target", "desired", "set"];
/// The names of what follows a set-point without a quantity.
const MEASURED: &[&str] = &["y", "pv", "measured", "measurement", "feedback", "u_m"];
/// The words after or before a quantity that is measured.
const MEASURING: &[&str] = &["measured", "measurement", "meas", "feedback", "pv", "m"];
/// The names of what is compared with no set-point.
const DEVIATIONS: &[&str] =
    &["e", "err", "error", "control_error", "d", "disturbance", "n", "noise"];

/// How the recorded variables of a plan are drawn.
pub fn of_plan(plan: &Plan) -> Vec<Curve> {
    let components = &plan.components;
    // Where the value of a variable comes from.
    let unchanged = plan.connections.iter().filter(|connection| connection.conversion.is_none());
    let sources: HashMap<_, _> =
        unchanged.map(|connection| (connection.to, connection.from)).collect();
    let source = |id: ScalarId| sources.get(&id).copied().unwrap_or(id);
    // The first recorded variable with the value of a source.
    let recorded = plan.recorded.iter().enumerate().rev();
    let carriers: HashMap<_, _> = recorded.map(|(index, id)| (source(*id), index)).collect();
    let carrier = |input: ScalarId| carriers.get(&source(input)).copied();
    let mut curves = Curves::new(plan.recorded.iter().map(|id| {
        let is_continuous = id.variable(components).variability == Variability::Continuous;
        !is_continuous || components[id.component].sampled
    }));
    for (component, loaded) in components.iter().enumerate() {
        let inputs = (0..loaded.fmu.scalars.len()).map(|scalar| ScalarId { component, scalar });
        let inputs = inputs.filter(|id| {
            let variable = id.variable(components);
            variable.causality == Causality::Input && variable.of_type.is_float()
        });
        let named = inputs.map(|id| {
            let unit = id.variable(components).unit.as_deref().unwrap_or_default();
            (id, unit, loaded.fmu.name(id.scalar))
        });
        let signals = Signals::new(named, |_| "");
        for (input, unit, quantity) in &signals.set_points {
            let follower = signals.named(unit, "", quantity).or(signals.only(unit));
            let found = follower.and_then(|other| Some((carrier(other)?, carrier(*input)?)));
            if let Some((follower, set_point)) = found {
                curves.pair(follower, set_point);
            }
        }
    }
    curves.add_by_names(&plan.columns);
    curves.all
}

/// How the columns of a file are drawn, by their names and units.
pub fn of_columns(columns: &[Column]) -> Vec<Curve> {
    let are_held = columns.iter().map(|column| !column.kind.is_float() || column.optional);
    let mut curves = Curves::new(are_held);
    curves.add_by_names(columns);
    curves.all
}

/// Signals of the type Float: set-points, and others by what they may follow.
struct Signals<'a, T> {
    /// The set-points, with the unit and the quantity of each.
    set_points: Vec<(T, &'a str, String)>,
    /// The first of the others, by unit, component and quantity.
    followers: HashMap<(&'a str, String, String), T>,
    /// The others of each unit.
    others: HashMap<&'a str, Vec<T>>,
}

impl<'a, T: Copy> Signals<'a, T> {
    /// Signals, with the unit and the name of each; `component` finds the component of a name.
    fn new<N: AsRef<str>>(
        all: impl Iterator<Item = (T, &'a str, N)>,
        component: impl Fn(&str) -> &str,
    ) -> Self {
        let mut signals =
            Self { set_points: Vec::new(), followers: HashMap::new(), others: HashMap::new() };
        for (signal, unit, name) in all {
            let name = name.as_ref();
            if let Some(quantity) = quantity(name) {
                signals.set_points.push((signal, unit, quantity));
                continue;
            }
            for quantity in followed(name) {
                let key = (unit, component(name).to_owned(), quantity);
                signals.followers.entry(key).or_insert(signal);
            }
            signals.others.entry(unit).or_default().push(signal);
        }
        signals
    }

    /// The first signal of a component that follows the set-point of a quantity by its name.
    fn named(&self, unit: &'a str, component: &str, quantity: &str) -> Option<T> {
        self.followers.get(&(unit, component.to_owned(), quantity.to_owned())).copied()
    }

    /// The only other signal of a unit.
    fn only(&self, unit: &str) -> Option<T> {
        match self.others.get(unit)?[..] {
            [only] => Some(only),
            _ => None,
        }
    }
}

/// The curves, and which are set-points of others.
struct Curves {
    all: Vec<Curve>,
    are_set_points: Vec<bool>,
}

impl Curves {
    fn new(are_held: impl Iterator<Item = bool>) -> Self {
        let all = Vec::from_iter(are_held.map(|is_held| Curve { is_held, set_point: None }));
        Self { are_set_points: vec![false; all.len()], all }
    }

    /// Notes what follows a set-point, unless it follows another one, or the set-point follows one itself.
    fn pair(&mut self, follower: usize, set_point: usize) {
        let is_free =
            [follower, set_point].iter().all(|index| self.all[*index].set_point.is_none());
        if is_free && !self.are_set_points[follower] && follower != set_point {
            self.all[follower].set_point = Some(set_point);
            self.are_set_points[set_point] = true;
        }
    }

    /// Finds what follows the set-points that have nothing yet, by names, then by units.
    fn add_by_names(&mut self, columns: &[Column]) {
        let floats = columns.iter().enumerate().filter(|(_, column)| column.kind.is_float());
        let floats = floats.map(|(index, column)| (index, &*column.unit, &*column.name));
        let signals = Signals::new(floats.clone(), component);
        // What may be compared with a set-point because nothing else has its unit.
        let compared = floats.filter(|(_, _, name)| !DEVIATIONS.contains(&&*last(name)));
        let compared = Signals::new(compared, component);
        let mut rivals: HashMap<&str, usize> = HashMap::new();
        for (_, unit, _) in &signals.set_points {
            *rivals.entry(unit).or_default() += 1;
        }
        for (set_point, unit, quantity) in &signals.set_points {
            if self.are_set_points[*set_point] {
                continue;
            }
            let component = component(&columns[*set_point].name);
            let only = || match rivals[unit] {
                1 if !unit.is_empty() => compared.only(unit),
                _ => None,
            };
            if let Some(follower) = signals.named(unit, component, quantity).or_else(only) {
                self.pair(follower, *set_point);
            }
        }
    }
}

/// The component of a variable, with its dot.
fn component(name: &str) -> &str {
    name.rfind('.').map_or("", |dot| &name[..=dot])
}

/// The last part of a name, in lower case and with underlines.
fn last(name: &str) -> String {
    let last = name[component(name).len()..].to_lowercase().replace('-', "_");
    last.replace("set_point", "setpoint")
}

/// The quantity of which a name is the set-point, empty for one such as `r`.
fn quantity(name: &str) -> Option<String> {
    let last = last(name);
    if SET_POINTS.contains(&&*last) {
        return Some(String::new());
    }
    WORDS.iter().find_map(|word| without(&last, word))
}

/// The quantities whose set-points a name may follow.
fn followed(name: &str) -> impl Iterator<Item = String> {
    let last = last(name);
    let measured = MEASURED.contains(&&*last).then(String::new);
    let parts = MEASURING.iter().filter_map(|word| without(&last, word));
    let all = Vec::from_iter(measured.into_iter().chain(parts));
    [last].into_iter().chain(all)
}

/// A name without a word before or after it.
fn without(name: &str, word: &str) -> Option<String> {
    let before = name.strip_suffix(word).and_then(|name| name.strip_suffix('_'));
    let after = || name.strip_prefix(word).and_then(|name| name.strip_prefix('_'));
    before.or_else(after).filter(|name| !name.is_empty()).map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use fmu_description::Type;

    use super::*;

    /// The set-points of columns, which are `name [unit]`.
    fn set_points(titles: &[&str]) -> Vec<Option<usize>> {
        let columns = titles.iter().map(|title| {
            let (name, unit) = title.split_once(' ').unwrap_or((title, ""));
            Column::new(name, unit.trim_matches(['[', ']']), Type::Float64)
        });
        let curves = of_columns(&Vec::from_iter(columns));
        curves.into_iter().map(|curve| curve.set_point).collect()
    }

    #[test]
    fn a_set_point_belongs_to_the_variable_with_its_name_or_the_only_one_with_its_unit() {
        for (titles, expected) in [
            (&["y", "r"][..], &[Some(1), None][..]),
            (&["a.speed_ref [m/s]", "a.speed [m/s]", "a.x [m]"], &[None, Some(0), None]),
            (&["a.Speed_SetPoint", "a.speed_measured"], &[None, Some(0)]),
            // Of another component, only if nothing else has the unit.
            (
                &["s.r [rad]", "p.theta [rad]", "c.e [rad]", "s.d [rad]"],
                &[None, Some(0), None, None],
            ),
            (&["s.r [rad]", "p.theta [rad]", "p.phi [rad]"], &[None; 3]),
            (&["s.r [rad]", "t.r [rad]", "p.theta [rad]"], &[None; 3]),
            (&["s.r", "p.theta"], &[None; 2]),
            // An array has no set-point in its name, nor has a word within another one.
            (&["w[1] [N]", "u [N]"], &[None; 2]),
            (&["prefer [N]", "u [N]"], &[None; 2]),
        ] {
            assert_eq!(set_points(titles), expected, "{titles:?}");
        }
    }
}
