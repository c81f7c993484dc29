//! The same run in several processes that differ in what must not matter.

use std::path::Path;

use anyhow::Result;

use super::Checker;
use super::rules::{INDEPENDENT, INITIALISED, REPRODUCIBLE};
use super::tests::{HEAP_CHECK, TRACE, TRACE_LOGGING, Test};
use crate::Findings;

/// The last values of a variable may differ by this much, relative to their size, where they differ
/// for reasons such as the alignment of memory.
const ROUNDING: f64 = 1e-9;

/// The digest and the last value of each variable.
struct Trace(Vec<(String, String, String)>);

/// A variable whose digests differ between two runs.
struct Different {
    name: String,
    text: String,
    /// Whether the last values differ, too.
    clearly: bool,
}

/// Runs the FMU in several processes, and compares.
pub fn compare(checker: &mut Checker<'_>, findings: &mut Findings) -> Result<()> {
    // glibc fills memory with a pattern when it is allocated.
    const ZEROS: &[(&str, &str)] = &[];
    const PATTERN: &[(&str, &str)] = &[
        ("MALLOC_PERTURB_", "85"),
        ("GLIBC_TUNABLES", "glibc.malloc.perturb=85"),
    ];
    let Some(expected) = Trace::of(checker, &TRACE, ZEROS, findings)? else {
        return Ok(());
    };
    let Some(again) = Trace::of(checker, &TRACE, ZEROS, findings)? else {
        return Ok(());
    };
    let volatile = again.differences(&expected);
    let names: Vec<String> = volatile
        .iter()
        .map(|variable| variable.name.clone())
        .collect();
    if let Some(variable) = volatile.iter().find(|variable| variable.clearly) {
        let more = volatile.len() - 1;
        let others = if more > 0 {
            format!("; so do {more} more variables")
        } else {
            String::new()
        };
        let text = format!(
            "two equal runs in two processes differ: {}{others}",
            variable.text
        );
        checker.add(&REPRODUCIBLE, text, findings);
    }
    // Such as the time that the FMU has used, or addresses: they differ in all other tests, too.
    checker.workshop.ignore(&names)?;
    check_heap(checker, findings)?;
    for (test, variables, rule, when) in [
        (&TRACE, PATTERN, &INITIALISED, "when new memory is not zero"),
        (
            &TRACE_LOGGING,
            ZEROS,
            &INDEPENDENT,
            "with another instance name and logging",
        ),
    ] {
        let Some(trace) = Trace::of(checker, test, variables, findings)? else {
            continue;
        };
        let expected = expected.without(&names);
        if let Some(variable) = trace.differences(&expected).into_iter().next() {
            checker.add(rule, format!("{when}, {}", variable.text), findings);
        }
    }
    Ok(())
}

/// Runs with the allocator of glibc that checks the heap, where it is installed.
fn check_heap(checker: &mut Checker<'_>, findings: &mut Findings) -> Result<()> {
    const LIBRARY: &str = "libc_malloc_debug.so.0";
    let folders = ["/lib", "/lib64", "/usr/lib", "/usr/lib64"];
    let own = format!("{}-linux-gnu", std::env::consts::ARCH);
    let files = folders.iter().flat_map(|folder| {
        let folder = Path::new(folder);
        [folder.join(LIBRARY), folder.join(&own).join(LIBRARY)]
    });
    let Some(file) = files.into_iter().find(|file| file.is_file()) else {
        return Ok(());
    };
    let variables = [
        ("LD_PRELOAD", file.to_str().unwrap_or_default()),
        ("GLIBC_TUNABLES", "glibc.malloc.check=3"),
    ];
    checker.test_with(&HEAP_CHECK, &variables, findings)?;
    Ok(())
}

impl Trace {
    /// `None` if the run failed, which is a finding of its own.
    fn of(
        checker: &mut Checker<'_>,
        test: &'static Test,
        variables: &[(&str, &str)],
        findings: &mut Findings,
    ) -> Result<Option<Self>> {
        let outcome = checker.test_with(test, variables, findings)?;
        if outcome.fails(test) {
            return Ok(None);
        }
        let lines = outcome.values.iter().filter_map(|line| {
            let mut parts = line.splitn(3, '\t').map(str::to_owned);
            Some((parts.next()?, parts.next()?, parts.next()?))
        });
        Ok(Some(Self(lines.collect())))
    }

    fn without(&self, names: &[String]) -> Self {
        let kept = self.0.iter().filter(|(_, _, name)| !names.contains(name));
        Self(kept.cloned().collect())
    }

    fn differences(&self, expected: &Self) -> Vec<Different> {
        let pairs = self.0.iter().zip(&expected.0);
        pairs
            .filter(|((digest, _, a), (other, _, b))| a == b && digest != other)
            .map(|((_, value, name), (_, expected, _))| Different {
                clearly: is_clear(value, expected),
                text: match value == expected {
                    true => format!("{name:?} differs during the run"),
                    false => format!("{name:?} is {value} at the end, expected {expected}"),
                },
                name: name.clone(),
            })
            .collect()
    }
}

fn is_clear(a: &str, b: &str) -> bool {
    match (a.parse::<f64>(), b.parse::<f64>()) {
        (Ok(a), Ok(b)) => (a - b).abs() > ROUNDING * a.abs().max(b.abs()),
        _ => a != b,
    }
}
