//! `cargo fmu diff`: what changes for importers from one FMU to another.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use fmu_description::changes::{Change, Compared, Consequence, changes};
use fmu_file::platform;
use fmu_file::text::plain;
use serde_json::{Value, json};

use super::info::inspect;

/// Maximum number of changes that are shown of each kind.
const SHOWN: usize = 12;
/// Maximum width of a text.
const MAX_WIDTH: usize = 200;

/// The FMUs to compare.
#[derive(Debug, Args)]
pub struct DiffArgs {
    /// The FMU in service, from any vendor
    #[arg(value_name = "OLD.fmu")]
    old: PathBuf,
    /// The FMU that replaces it
    #[arg(value_name = "NEW.fmu")]
    new: PathBuf,
    /// Show all changes, not only the first ones of each kind
    #[arg(long)]
    all: bool,
    /// Print a JSON object
    #[arg(long)]
    json: bool,
}

/// The kinds of changes: title, and name in JSON.
const KINDS: [(Consequence, &str, &str); 4] = [
    (Consequence::Breaks, "breaks scripts, systems and connections", "breaks"),
    (Consequence::MovesReferences, "breaks hosts that store value references", "movesReferences"),
    (Consequence::ChangesResults, "may change results, or refuse values", "changesResults"),
    (Consequence::Informs, "needs no change", "informs"),
];

/// Prints the changes; returns whether an importer needs to change nothing and gets the same results.
///
/// # Errors
/// A file is not a valid FMU, or `out` cannot be written.
pub fn run(args: &DiffArgs, out: &mut impl Write) -> Result<bool> {
    let found = inspect(&args.old, |old, old_archive| {
        inspect(&args.new, |new, new_archive| {
            let platforms = [&old_archive, &new_archive].map(|a| platform::folders(&a.names));
            let [before, after] = platforms;
            let old = Compared { model: old, platforms: before };
            Ok(changes(&old, &Compared { model: new, platforms: after }))
        })
    })?;
    if args.json {
        let groups = KINDS.map(|(kind, _, name)| {
            let of_kind = found.iter().filter(|change| change.consequence == kind);
            (name.to_owned(), of_kind.map(described).collect::<Value>())
        });
        writeln!(out, "{:#}", Value::Object(groups.into_iter().collect()))?;
    } else {
        print(&found, args.all, out)?;
    }
    Ok(found.iter().all(|change| change.consequence == Consequence::Informs))
}

fn described(change: &Change) -> Value {
    json!({
        "subject": change.subject,
        "what": change.what,
        "from": change.from,
        "to": change.to,
    })
}

fn print(found: &[Change], all: bool, out: &mut impl Write) -> Result<()> {
    if found.is_empty() {
        writeln!(out, "no difference")?;
    }
    for (index, (kind, title, _)) in KINDS.iter().enumerate() {
        let of_kind = Vec::from_iter(found.iter().filter(|change| change.consequence == *kind));
        if of_kind.is_empty() {
            continue;
        }
        let is_first = found[0].consequence == *kind;
        let gap = if index > 0 && !is_first { "\n" } else { "" };
        writeln!(out, "{gap}{title}: {}", of_kind.len())?;
        let shown = if all { of_kind.len() } else { SHOWN };
        for change in of_kind.iter().take(shown) {
            writeln!(out, "  {}", plain(&line(change), MAX_WIDTH))?;
        }
        if of_kind.len() > shown {
            writeln!(out, "  and {} more; --all shows them", of_kind.len() - shown)?;
        }
    }
    Ok(())
}

/// A change in a line.
fn line(Change { subject, what, from, to, .. }: &Change) -> String {
    match (&**what, from, to) {
        ("removed", _, Some(other)) => format!("{subject}: removed; see {other}"),
        ("renamed", _, Some(name)) => format!("{subject}: renamed to {name}, and still found"),
        ("alias", _, Some(name)) => format!("{subject}: another name of {name}"),
        ("added", _, Some(causality)) => format!("{subject}: added ({causality})"),
        ("deprecated", None, Some(instead)) if instead == "yes" => format!("{subject}: deprecated"),
        ("deprecated", None, Some(instead)) => format!("{subject}: deprecated: {instead}"),
        ("removed" | "added", ..) => format!("{subject}: {what}"),
        ("same GUID", Some(guid), _) => {
            format!("{subject}: the GUID is still {guid}; importers that cache by it see no change")
        }
        (_, Some(from), Some(to)) => format!("{subject}: {what} {from} -> {to}"),
        (_, None, Some(to)) => format!("{subject}: {what} {to}, none before"),
        (_, Some(from), None) => format!("{subject}: no {what}, {from} before"),
        (_, None, None) => format!("{subject}: {what}"),
    }
}
