//! Arrays of SSP 2.0: the lengths of their dimensions, and the names of their elements.

use anyhow::{Result, bail, ensure};
use fmu_description::Variable;
use fmu_description::xml::Element;

use super::vocabulary::DIMENSION;

/// The stated lengths of the dimensions of a connector or parameter; `None` if a length is left to its FMU.
///
/// # Errors
/// A length is invalid.
pub fn dimensions(element: &Element<'_>) -> Result<Vec<Option<usize>>> {
    let length = |dimension: &Element<'_>| {
        let Some(text) = dimension.attribute("size") else { return Ok(None) };
        ensure!(!dimension.has("sizeConnector"), "a Dimension has both a size and a sizeConnector");
        match text.trim().parse() {
            Ok(length) if length > 0 => Ok(Some(length)),
            _ => bail!("the size {text:?} of a Dimension is invalid, expected a positive number"),
        }
    };
    element.children(DIMENSION).map(length).collect()
}

/// The dimensions that two connectors have in common; `None` if they differ.
pub fn common(a: &[Option<usize>], b: &[Option<usize>]) -> Option<Vec<Option<usize>>> {
    let both = |(a, b): (&Option<usize>, &Option<usize>)| match (a, b) {
        (Some(a), Some(b)) => (a == b).then_some(Some(*a)),
        _ => Some(a.or(*b)),
    };
    if a.len() == b.len() { a.iter().zip(b).map(both).collect() } else { None }
}

/// The dimensions as a message shows them.
pub fn shown(dimensions: &[Option<usize>]) -> String {
    let length = |length: &Option<usize>| length.map_or("?".to_owned(), |known| known.to_string());
    match dimensions {
        [] => "a scalar".to_owned(),
        _ => Vec::from_iter(dimensions.iter().map(length)).join(" x "),
    }
}

/// The names of the elements of an array, row by row, or of a scalar.
pub fn element_names(name: &str, dimensions: &[usize]) -> Vec<String> {
    let array = array(dimensions);
    (0..array.element_count()).map(|element| array.element_name(name, element)).collect()
}

/// The name of an element of an array, or of a scalar if there are no indices.
///
/// # Errors
/// The indices are too large.
pub fn element_name(name: &str, indices: &[usize]) -> Result<String> {
    // The last element of an array with these lengths has these indices.
    let last = count(indices)?.saturating_sub(1);
    Ok(array(indices).element_name(name, last))
}

fn array(dimensions: &[usize]) -> Variable {
    Variable { dimensions: dimensions.to_vec(), ..Variable::default() }
}

/// The name of the array of an element.
pub fn array_name(element: &str) -> Option<String> {
    let (array, rest) = element.rsplit_once('[')?;
    let (_, end) = rest.split_once(']')?;
    Some(format!("{array}{end}"))
}

/// The largest number of elements of an array.
const MAX_ELEMENTS: usize = 1 << 22;

/// The number of elements of an array.
///
/// # Errors
/// It is too large.
pub fn count(dimensions: &[usize]) -> Result<usize> {
    let count = dimensions.iter().try_fold(1_usize, |count, length| count.checked_mul(*length));
    match count.filter(|count| *count <= MAX_ELEMENTS) {
        Some(count) => Ok(count),
        None => bail!("an array has more than {MAX_ELEMENTS} elements"),
    }
}
