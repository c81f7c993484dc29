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
    let source = |id: ScalarId| {
        let connection = plan.connections.iter().find(|c| c.to == id && c.conversion.is_none());
        connection.map_or(id, |connection| connection.from)
    };
    let carrier =
        |input: ScalarId| plan.recorded.iter().position(|id| source(*id) == source(input));
    let quantity_of = |id: &ScalarId| quantity(&components[id.component].fmu.name(id.scalar));
    let mut curves = Vec::from_iter(plan.recorded.iter().map(|id| {
        let variable = id.variable(components);
        let is_continuous = variable.variability == Variability::Continuous;
        Curve { is_held: !is_continuous || components[id.component].sampled, set_point: None }
    }));
    let unit = |id: &ScalarId| id.variable(components).unit.as_deref();
    for (component, loaded) in components.iter().enumerate() {
        let inputs = (0..loaded.fmu.scalars.len()).map(|scalar| ScalarId { component, scalar });
        let inputs = Vec::from_iter(inputs.filter(|id| {
            let variable = id.variable(components);
            variable.causality == Causality::Input && variable.of_type.is_float()
        }));
        for input in &inputs {
            let Some(quantity) = quantity_of(input) else { continue };
            let others = inputs.iter().filter(|other| unit(other) == unit(input));
            let others = Vec::from_iter(others.filter(|other| quantity_of(other).is_none()));
            let named = |id: &&&ScalarId| follows(&loaded.fmu.name(id.scalar), &quantity);
            let follower = others.iter().find(named).or(match &others[..] {
                [only] => Some(only),
                _ => None,
            });
            let found = follower.and_then(|other| Some((carrier(**other)?, carrier(*input)?)));
            if let Some((follower, set_point)) = found {
                pair(&mut curves, follower, set_point);
            }
        }
    }
    add_by_names(&plan.columns, &mut curves);
    curves
}

/// How the columns of a file are drawn, by their names and units.
pub fn of_columns(columns: &[Column]) -> Vec<Curve> {
    let is_held = |column: &Column| !column.kind.is_float();
    let mut curves = Vec::from_iter(
        columns.iter().map(|column| Curve { is_held: is_held(column), set_point: None }),
    );
    add_by_names(columns, &mut curves);
    curves
}

/// Notes what follows a set-point, unless it follows another one, or the set-point follows one itself.
fn pair(curves: &mut [Curve], follower: usize, set_point: usize) {
    let is_free = curves[follower].set_point.is_none() && curves[set_point].set_point.is_none();
    let is_set_point = curves.iter().any(|curve| curve.set_point == Some(follower));
    if is_free && !is_set_point && follower != set_point {
        curves[follower].set_point = Some(set_point);
    }
}

/// Finds what follows the set-points that have nothing yet, by names, then by units.
fn add_by_names(columns: &[Column], curves: &mut [Curve]) {
    let quantities = Vec::from_iter(
        columns.iter().map(|column| quantity(&column.name).filter(|_| column.kind.is_float())),
    );
    for (index, set_point) in columns.iter().enumerate() {
        let Some(quantity) = &quantities[index] else { continue };
        if curves.iter().any(|curve| curve.set_point == Some(index)) {
            continue;
        }
        let others = (0..columns.len()).filter(|other| {
            let column = &columns[*other];
            column.unit == set_point.unit && column.kind.is_float() && *other != index
        });
        let (rivals, others): (Vec<_>, Vec<_>) =
            others.partition(|other| quantities[*other].is_some());
        let component = component(&set_point.name);
        let in_component = |other: &&usize| {
            let name = &columns[**other].name;
            self::component(name) == component && follows(name, quantity)
        };
        let compared =
            others.iter().filter(|other| !DEVIATIONS.contains(&&*last(&columns[**other].name)));
        let only = match &Vec::from_iter(compared)[..] {
            [only] if rivals.is_empty() && !set_point.unit.is_empty() => Some(**only),
            _ => None,
        };
        if let Some(follower) = others.iter().find(in_component).copied().or(only) {
            pair(curves, follower, index);
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

/// Whether a name is of what follows the set-point of a quantity.
fn follows(name: &str, quantity: &str) -> bool {
    let last = last(name);
    match quantity {
        "" => MEASURED.contains(&&*last),
        _ => {
            last == quantity
                || MEASURING.iter().any(|word| without(&last, word).as_deref() == Some(quantity))
        }
    }
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
