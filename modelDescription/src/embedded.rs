//! Reads the interfaces of models from the copies in a binary, which [`interface`](crate::interface) writes.

use std::ops::Range;

use anyhow::{Context, Result, ensure};

use crate::ExportedModel;
use crate::exported::Supplement;
use crate::hash::checksum;
use crate::interface::{CHECKSUM, MAGIC, SUPPLEMENTED, VERSION};

const DAMAGED: &str = "the description of a model in the binary is damaged";
const HEADER: usize = MAGIC.len() + 2 * size_of::<u32>();

/// Reads the interfaces of all models in a binary, without duplicates: a universal binary has several
/// copies of each.
///
/// # Errors
/// A copy is damaged, or of another version of the format; two variables get the same flat name.
pub fn read_interfaces(binary: &[u8]) -> Result<Vec<ExportedModel>> {
    let mut models = Vec::new();
    let mut end = 0;
    while let Some(copy) = next_copy(binary, end)? {
        end = copy.end;
        let mut model = description(&binary[copy]).context(DAMAGED)?;
        model.write_names()?;
        if !models.contains(&model) {
            models.push(model);
        }
    }
    Ok(models)
}

/// Overwrites the interfaces in a binary that needs them no longer with zeros.
///
/// # Errors
/// As [`read_interfaces`].
pub fn erase_interfaces(binary: &mut [u8]) -> Result<()> {
    let mut end = 0;
    while let Some(copy) = next_copy(binary, end)? {
        end = copy.end;
        binary[copy].fill(0);
    }
    Ok(())
}

/// Where the first copy of an interface after a position is.
fn next_copy(binary: &[u8], from: usize) -> Result<Option<Range<usize>>> {
    let rest = &binary[from..];
    let Some(at) = rest.windows(MAGIC.len()).position(|bytes| bytes == MAGIC) else {
        return Ok(None);
    };
    let (header, _) = rest[at..].split_first_chunk::<HEADER>().context(DAMAGED)?;
    let [.., a, b, c, d, e, f, g, h] = *header;
    let version = u32::from_le_bytes([a, b, c, d]);
    ensure!(
        matches!(version, VERSION | SUPPLEMENTED),
        "the library was built with another version of fmu-export: its format is {version}, expected {VERSION}"
    );
    let length = (u32::from_le_bytes([e, f, g, h]) as usize).max(HEADER);
    ensure!(length <= rest.len() - at, DAMAGED);
    Ok(Some(from + at..from + at + length))
}

fn description(copy: &[u8]) -> Result<ExportedModel> {
    let copy = copy.split_last_chunk::<CHECKSUM>();
    let (content, sum) = copy.context("it ends too early")?;
    let is_whole = checksum(content).to_le_bytes() == *sum;
    ensure!(is_whole, "its checksum is wrong");
    let (header, content) = content.split_at_checked(HEADER).context("it ends too early")?;
    let is_supplemented = header[MAGIC.len()..].starts_with(&SUPPLEMENTED.to_le_bytes());
    let (supplement, content) = match is_supplemented {
        true => {
            postcard::take_from_bytes(content).map(|(it, rest)| (Some::<Supplement>(it), rest))?
        }
        false => (None, content),
    };
    let mut model: ExportedModel = postcard::from_bytes(content)?;
    if let Some(supplement) = supplement {
        model.supplement(supplement);
    }
    let mut ends = Vec::with_capacity(model.variables.len());
    for v in &mut model.variables {
        let mut sizes = v.dimensions.iter();
        let count = sizes.try_fold(1, |count: usize, size| count.checked_mul(*size));
        let count = count.and_then(|count| u32::try_from(count).ok());
        let end = count.and_then(|count| v.reference.checked_add(count));
        ends.push((v.reference, end.context("there are too many variables")?));
        let mut start = v.start.iter();
        let fits = start.all(|value| value.of_type() == v.of_type);
        ensure!(fits, "a start value does not fit its type");
        if let [all] = v.start.as_slice() {
            v.start = vec![all.clone(); v.element_count()];
        }
    }
    ends.sort_unstable();
    let are_distinct = ends.is_sorted_by(|(_, end), (next, _)| end <= next);
    ensure!(are_distinct, "two variables have the same value reference");
    Ok(model)
}
