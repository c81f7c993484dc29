//! The files of a new package, and what a package has of them.

/// What a package may have: a plant with the closed loop, a controller in C, and a workflow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    Plant,
    C,
    Workflow,
}

/// The files of the package of a controller named `my-controller`, and the part that a file belongs to.
pub const FILES: [(&str, Option<Part>, &str); 10] = [
    // Not Cargo.toml, because cargo leaves folders with such a file out of packages.
    ("Cargo.toml", None, include_str!("template/Cargo.toml.in")),
    ("build.rs", Some(Part::C), include_str!("template/c/build.rs")),
    ("c/pi.h", Some(Part::C), include_str!("template/c/pi.h")),
    ("c/pi.c", Some(Part::C), include_str!("template/c/pi.c")),
    ("src/lib.rs", None, include_str!("template/lib.rs")),
    ("src/plant.rs", Some(Part::Plant), include_str!("template/plant.rs")),
    ("loop.toml", Some(Part::Plant), include_str!("template/loop.toml")),
    ("README.md", None, include_str!("template/README.md")),
    (".gitignore", None, include_str!("template/gitignore")),
    (".github/workflows/fmu.yml", Some(Part::Workflow), include_str!("template/fmu.yml")),
];

/// The lines of a template for a package with some parts. A line `@plant` begins lines for packages with a plant,
/// `@no plant` for the others, and `@end` for all.
pub fn select(template: &str, parts: &[Part]) -> String {
    let mut selected = String::new();
    let mut is_selected = true;
    for line in template.split_inclusive('\n') {
        match line.trim_end().strip_prefix('@') {
            Some("plant") => is_selected = parts.contains(&Part::Plant),
            Some("no plant") => is_selected = !parts.contains(&Part::Plant),
            Some("c") => is_selected = parts.contains(&Part::C),
            Some("no c") => is_selected = !parts.contains(&Part::C),
            Some("workflow") => is_selected = parts.contains(&Part::Workflow),
            Some("end") => is_selected = true,
            _ if is_selected => selected.push_str(line),
            _ => {}
        }
    }
    selected
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_directive_is_left_in_any_package() {
        for parts in [&[][..], &[Part::Plant], &[Part::C], &[Part::Plant, Part::C, Part::Workflow]]
        {
            for (file, _, template) in FILES {
                let text = select(template, parts);
                assert!(!text.lines().any(|line| line.starts_with('@')), "{file}: {text}");
            }
        }
    }

    #[test]
    fn lines_belong_to_a_part_or_to_packages_without_it() {
        let template = "a\n@plant\nb\n@no plant\nc\n@end\nd\n";
        assert_eq!(select(template, &[Part::Plant]), "a\nb\nd\n");
        assert_eq!(select(template, &[Part::C]), "a\nc\nd\n");
    }
}
