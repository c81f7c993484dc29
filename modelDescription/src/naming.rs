//! Naming conventions: how the names of variables are written (FMI 2.0.5, section 2.2.9).

use crate::vocabulary::Naming;

impl Naming {
    /// A structured name in this convention. Flat names are identifiers: `pid.kp` is `pid_kp`, `a[1,2]` is `a_1_2`,
    /// and `der(x)` is `der_x`.
    pub fn write(self, structured: String) -> String {
        match self {
            Self::Structured => structured,
            Self::Flat => structured
                .chars()
                .filter(|c| !matches!(c, ']' | ')'))
                .map(|c| if matches!(c, '.' | '[' | ',' | '(') { '_' } else { c })
                .collect(),
        }
    }

    /// The convention that the exporter chooses, by the text that it passes to the compiler: for the models that
    /// choose none, if the text begins with `package:`, else for all.
    pub const fn chosen(text: Option<&str>, of_model: Option<Self>) -> Self {
        let text = match text {
            Some(text) => text.as_bytes(),
            None => b"",
        };
        match (text, of_model) {
            (b"flat", _) | (b"package:flat", None) => Self::Flat,
            (b"structured", _) => Self::Structured,
            (_, Some(own)) => own,
            _ => Self::Structured,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Naming::{Flat, Structured};
    use super::*;

    #[test]
    fn flat_names_are_identifiers() {
        for (structured, flat) in [
            ("u", "u"),
            ("pid.kp", "pid_kp"),
            ("rbf.w[1]", "rbf_w_1"),
            ("a[1,12]", "a_1_12"),
            ("motor[2].shaft.w", "motor_2_shaft_w"),
            ("der(mass.x[3])", "der_mass_x_3"),
        ] {
            assert_eq!(Flat.write(structured.into()), flat);
            assert_eq!(Flat.write(flat.into()), flat);
            assert_eq!(Structured.write(structured.into()), structured);
        }
    }

    #[test]
    fn the_command_line_comes_before_the_model_and_the_model_before_the_package() {
        for (text, of_model, expected) in [
            (None, None, Structured),
            (None, Some(Flat), Flat),
            (Some("flat"), None, Flat),
            (Some("flat"), Some(Structured), Flat),
            (Some("structured"), Some(Flat), Structured),
            (Some("package:flat"), None, Flat),
            (Some("package:flat"), Some(Structured), Structured),
            (Some("package:structured"), Some(Flat), Flat),
        ] {
            assert_eq!(Naming::chosen(text, of_model), expected, "{text:?} {of_model:?}");
        }
    }
}
