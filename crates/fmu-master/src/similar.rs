//! What may be meant by the name of a variable, or by a file, that does not exist.

use std::path::Path;

use anyhow::{Error, anyhow};

/// The known names most similar to an unknown one, or that end with it, as `pid.kp` does with `kp`; if there are none,
/// those that are similar in another case.
pub(crate) fn similar<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let known = Vec::from_iter(known);
    let found = similar_in_case(name, known.iter().map(|known| (*known, *known)));
    // A letter in another case is another variable, such as M and m.
    if !found.is_empty() || name.chars().count() < 2 {
        return found;
    }
    let (lower, name) = (known.iter().map(|known| known.to_lowercase()), name.to_lowercase());
    let lower = Vec::from_iter(lower);
    let all = || lower.iter().map(String::as_str).zip(known.iter().copied());
    match all().find(|(lower, _)| *lower == name) {
        Some((_, same)) => vec![same],
        None => similar_in_case(&name, all()),
    }
}

/// The names most similar to an unknown one; each known one is compared by the first of its texts.
fn similar_in_case<'a, 'b>(
    name: &str,
    known: impl Iterator<Item = (&'b str, &'a str)>,
) -> Vec<&'a str> {
    const MIN_SIMILARITY: f64 = 0.85;
    let mut scored: Vec<(f64, &str)> = known
        .map(|(compared, known)| match compared.strip_suffix(name) {
            Some(rest) if rest.ends_with('.') => (1.0, known),
            _ => (strsim::jaro_winkler(name, compared), known),
        })
        .filter(|(score, _)| *score >= MIN_SIMILARITY)
        .collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored.into_iter().take(3).map(|(_, known)| known).collect()
}

/// Adds the file that may be meant to an error, unless the file exists: one beside it with the same ending, or one that has
/// an ending.
pub(crate) fn with_similar_file(error: Error, file: &Path) -> Error {
    let meant = if file.exists() { None } else { similar_file(file) };
    match meant {
        Some(name) => anyhow!("{error:#}; did you mean {name}?"),
        None => error,
    }
}

fn similar_file(file: &Path) -> Option<String> {
    let stem = file.file_stem()?.to_str()?;
    let folder = file.parent().filter(|folder| *folder != Path::new(""));
    let entries = folder.unwrap_or(Path::new(".")).read_dir().ok()?.flatten();
    let others = entries.map(|entry| entry.file_name()).filter(|other| {
        let ending = Path::new(other).extension();
        match file.extension() {
            None => {
                ["fmu", "toml", "ssp", "ssd"].iter().any(|known| ending == Some(known.as_ref()))
            }
            own => ending == own,
        }
    });
    let mut others = Vec::from_iter(others.filter_map(|other| other.into_string().ok()));
    others.sort();
    let stems = others.iter().filter_map(|other| Path::new(other).file_stem()?.to_str());
    let meant = *similar(stem, stems).first()?;
    others.iter().find(|other| Path::new(other).file_stem().is_some_and(|s| s == meant)).cloned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_in_another_case_or_the_end_of_a_name_is_meant() {
        let known = ["pid.kp", "pid.ki", "limit"];
        let meant = |name| similar(name, known.into_iter());
        assert_eq!(meant("PID.KP"), ["pid.kp"]);
        assert_eq!(meant("kp"), ["pid.kp"]);
        assert_eq!(meant("Limits"), ["limit"]);
        assert!(meant("speed").is_empty());
        assert!(similar("M", ["m"].into_iter()).is_empty());
    }

    #[test]
    fn a_file_beside_a_missing_one_is_meant_if_their_endings_agree() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["Pendulum.fmu", "Pendulum.csv"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let meant = |name| similar_file(&folder.path().join(name));
        assert_eq!(meant("Pendulun.fmu").as_deref(), Some("Pendulum.fmu"));
        assert_eq!(meant("Pendulum").as_deref(), Some("Pendulum.fmu"));
        assert_eq!(meant("Motor.fmu"), None);
        assert_eq!(meant("Pendulum.toml"), None);
        let there = with_similar_file(anyhow!("damaged"), &folder.path().join("Pendulum.fmu"));
        assert_eq!(there.to_string(), "damaged");
    }
}
