//! Access to the Float64 of a model that is too large for tables of places, by its rows.

use crate::any_model::AnyModel;
use crate::layout::{Extent, Float64Place, float64_at};
use fmu_description::scalar::variable_named;

/// What a value reference stands for: a scalar or an element of an array in FMI 2.0, a variable with all its elements
/// in FMI 3.0.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    Element,
    Variable,
}

/// Gets Float64. Returns false and writes nothing if a reference has no place, or the number of values is wrong.
pub(crate) fn get(
    model: &mut dyn AnyModel,
    part: Part,
    references: &[u32],
    values: &mut [f64],
) -> bool {
    let has_places = each_place(model, part, references, values.len(), &mut |_, _, place| {
        place.offset != Float64Place::NONE
    });
    has_places
        && each_place(model, part, references, values.len(), &mut |model, i, place| {
            // SAFETY: the place belongs to a Float64 of the model, by the check.
            values[i] = unsafe { *float64_at(model.memory(), place.offset) };
            true
        })
}

/// Sets Float64. Returns false and writes nothing if a variable or value is not allowed between steps.
pub(crate) fn set(
    model: &mut dyn AnyModel,
    part: Part,
    references: &[u32],
    values: &[f64],
) -> bool {
    // The range is empty unless the variable is a Float64 that may be set.
    let are_allowed = each_place(model, part, references, values.len(), &mut |_, i, place| {
        place.min <= values[i] && values[i] <= place.max
    });
    are_allowed
        && each_place(model, part, references, values.len(), &mut |model, i, place| {
            // SAFETY: the place belongs to a Float64 of the model, by the check.
            unsafe { *float64_at(model.memory(), place.offset) = values[i] };
            true
        })
}

/// Calls a function with the place of each of `n` elements and its number, as long as it returns true. Returns whether
/// all are known, and it has always done so.
fn each_place(
    model: &mut dyn AnyModel,
    part: Part,
    references: &[u32],
    n: usize,
    call: &mut dyn FnMut(&mut dyn AnyModel, usize, Float64Place) -> bool,
) -> bool {
    let (mut i, mut found) = (0, None);
    for &reference in references {
        // Hosts access the elements of an array one after the other.
        let is_next = |block: &Block| reference.wrapping_sub(block.first) < block.in_use;
        let Some(block) = found.filter(is_next).or_else(|| Block::at(model, reference)) else {
            return false;
        };
        found = Some(block);
        let element = reference - block.first;
        let elements = match part {
            Part::Element if element < block.in_use => element..element + 1,
            Part::Variable if element == 0 => 0..block.in_use,
            _ => return false,
        };
        for element in elements {
            let mut place = block.place;
            if place.offset != Float64Place::NONE {
                place.offset += element as usize * size_of::<f64>();
            }
            if i == n || !call(model, i, place) {
                return false;
            }
            i += 1;
        }
    }
    i == n
}

/// A variable and its elements.
#[derive(Clone, Copy)]
struct Block {
    /// The value reference of its first element.
    first: u32,
    in_use: u32,
    /// The place of its first element.
    place: Float64Place,
}

impl Block {
    /// The variable of an element.
    fn at(model: &mut dyn AnyModel, reference: u32) -> Option<Self> {
        let mut scalar = model.scalar_at(reference)?;
        let first = reference - std::mem::take(&mut scalar.element) as u32;
        let in_use = model.elements_in_use(first)? as u32;
        let place = Float64Place::from_row(&scalar);
        Some(Self { first, in_use, place })
    }
}

/// The elements of the variable whose first element has the given value reference; `None` for other references.
pub(crate) fn extent(model: &dyn AnyModel, reference: u32) -> Option<Extent> {
    let scalar = model.scalar_at(reference).filter(|scalar| scalar.element == 0)?;
    let count = scalar.variable.element_count() as u32;
    let all = Extent { count, default: count, size: Extent::ALL };
    if scalar.variable.size.is_empty() {
        return Some(all);
    }
    let size = variable_named(model.info().rows, &scalar, scalar.variable.size)?;
    let default = size.variable.start.get(0).value(size.variable.start.of_type())?.as_whole()?;
    let default = u32::try_from(default).unwrap_or(count).min(count);
    Some(Extent { default, size: size.offset_of_size()? as u32, ..all })
}
