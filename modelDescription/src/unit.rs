//! Units, parsed into the base units of FMI (FMI 2.0.5, section 2.2.2).
//!
//! A unit is a product of factors, optionally divided by a factor or by a product in parentheses:
//! `N.s/m`, `kg.m2`, `m/s2`, `N/(rad.s)`. A factor is a symbol from the table below with an optional
//! exponent; most symbols may have an SI prefix (`mm`, `kN`, `MPa`). `1` is dimensionless.

/// The base units of FMI 2.0.
pub const BASE: [&str; 8] = ["kg", "m", "s", "A", "K", "mol", "cd", "rad"];

/// A unit: `value in base units = factor * value + offset`.
#[derive(Debug, Clone, PartialEq)]
pub struct Unit {
    /// Exponents of the base units, in the order of [`BASE`].
    pub exponents: [i8; 8],
    /// Factor to the base units.
    pub factor: f64,
    /// Offset to the base units; not 0 for `degC` and `degF` only.
    pub offset: f64,
}

/// A named unit: symbol, exponents of the base units, factor, and whether it may have an SI prefix.
type Symbol = (&'static str, [i8; 8], f64, bool);

const DEGREE: f64 = core::f64::consts::PI / 180.0;
const TURN: f64 = 2.0 * core::f64::consts::PI;

#[rustfmt::skip]
const SYMBOLS: &[Symbol] = &[
    //        kg  m  s  A  K mol cd rad
    ("1",    [0,  0,  0,  0, 0, 0, 0, 0], 1.0, false),
    ("%",    [0,  0,  0,  0, 0, 0, 0, 0], 0.01, false),
    ("g",    [1,  0,  0,  0, 0, 0, 0, 0], 1e-3, true),
    ("t",    [1,  0,  0,  0, 0, 0, 0, 0], 1e3, false),
    ("m",    [0,  1,  0,  0, 0, 0, 0, 0], 1.0, true),
    ("s",    [0,  0,  1,  0, 0, 0, 0, 0], 1.0, true),
    ("min",  [0,  0,  1,  0, 0, 0, 0, 0], 60.0, false),
    ("h",    [0,  0,  1,  0, 0, 0, 0, 0], 3600.0, false),
    ("d",    [0,  0,  1,  0, 0, 0, 0, 0], 86400.0, false),
    ("A",    [0,  0,  0,  1, 0, 0, 0, 0], 1.0, true),
    ("K",    [0,  0,  0,  0, 1, 0, 0, 0], 1.0, true),
    ("mol",  [0,  0,  0,  0, 0, 1, 0, 0], 1.0, true),
    ("cd",   [0,  0,  0,  0, 0, 0, 1, 0], 1.0, true),
    ("rad",  [0,  0,  0,  0, 0, 0, 0, 1], 1.0, true),
    ("deg",  [0,  0,  0,  0, 0, 0, 0, 1], DEGREE, false),
    ("rev",  [0,  0,  0,  0, 0, 0, 0, 1], TURN, false),
    ("rpm",  [0,  0, -1,  0, 0, 0, 0, 1], TURN / 60.0, false),
    ("Hz",   [0,  0, -1,  0, 0, 0, 0, 0], 1.0, true),
    ("N",    [1,  1, -2,  0, 0, 0, 0, 0], 1.0, true),
    ("Pa",   [1, -1, -2,  0, 0, 0, 0, 0], 1.0, true),
    ("bar",  [1, -1, -2,  0, 0, 0, 0, 0], 1e5, true),
    ("J",    [1,  2, -2,  0, 0, 0, 0, 0], 1.0, true),
    ("W",    [1,  2, -3,  0, 0, 0, 0, 0], 1.0, true),
    ("C",    [0,  0,  1,  1, 0, 0, 0, 0], 1.0, true),
    ("V",    [1,  2, -3, -1, 0, 0, 0, 0], 1.0, true),
    ("F",    [-1, -2, 4,  2, 0, 0, 0, 0], 1.0, true),
    ("Ohm",  [1,  2, -3, -2, 0, 0, 0, 0], 1.0, true),
    ("S",    [-1, -2, 3,  2, 0, 0, 0, 0], 1.0, true),
    ("Wb",   [1,  2, -2, -1, 0, 0, 0, 0], 1.0, true),
    ("T",    [1,  0, -2, -1, 0, 0, 0, 0], 1.0, true),
    ("H",    [1,  2, -2, -2, 0, 0, 0, 0], 1.0, true),
    ("lm",   [0,  0,  0,  0, 0, 0, 1, 0], 1.0, true),
    ("lx",   [0, -2,  0,  0, 0, 0, 1, 0], 1.0, true),
    ("l",    [0,  3,  0,  0, 0, 0, 0, 0], 1e-3, true),
];

/// Units with an offset, which cannot be factors.
const WITH_OFFSET: [(&str, f64, f64); 2] =
    [("degC", 1.0, 273.15), ("degF", 5.0 / 9.0, 459.67 * 5.0 / 9.0)];
const KELVIN: [i8; 8] = [0, 0, 0, 0, 1, 0, 0, 0];

const PREFIXES: [(&str, f64); 14] = [
    ("da", 1e1),
    ("T", 1e12),
    ("G", 1e9),
    ("M", 1e6),
    ("k", 1e3),
    ("h", 1e2),
    ("d", 1e-1),
    ("c", 1e-2),
    ("m", 1e-3),
    ("u", 1e-6),
    ("\u{b5}", 1e-6),
    ("n", 1e-9),
    ("p", 1e-12),
    ("f", 1e-15),
];

impl Unit {
    const ONE: Self = Self { exponents: [0; 8], factor: 1.0, offset: 0.0 };

    /// Parses a unit.
    ///
    /// # Errors
    /// The part of the text that is not a unit.
    pub fn parse(text: &str) -> Result<Self, String> {
        if let Some((_, factor, offset)) = WITH_OFFSET.iter().find(|(name, ..)| *name == text) {
            return Ok(Self { exponents: KELVIN, factor: *factor, offset: *offset });
        }
        let (above, below) = match text.split_once('/') {
            Some((above, below)) => (above, Some(below)),
            None => (text, None),
        };
        let product = below.and_then(|below| below.strip_prefix('(')?.strip_suffix(')'));
        let divisors = match product {
            Some(product) => product.split('.').collect(),
            None => Vec::from_iter(below),
        };
        let mut unit = Self::ONE;
        for factor in above.split('.') {
            unit.multiply(factor, 1)?;
        }
        for factor in divisors {
            unit.multiply(factor, -1)?;
        }
        Ok(unit)
    }

    /// The customary unit to display values in: degrees for radians.
    pub fn default_display(text: &str) -> Option<String> {
        let rest = text.strip_prefix("rad")?;
        let is_angle = rest.is_empty() || rest == "/s" || rest == "/s2";
        is_angle.then(|| format!("deg{rest}"))
    }

    /// The factor and the offset that convert values to another unit, by `factor * value + offset`; `None` if
    /// the dimensions differ.
    pub fn conversion_to(&self, other: &Self) -> Option<(f64, f64)> {
        let factor = self.factor / other.factor;
        let offset = (self.offset - other.offset) / other.factor;
        (self.exponents == other.exponents).then_some((factor, offset))
    }

    /// The dimension as a product of base units, such as `kg.m.s-2`.
    pub fn dimension(&self) -> String {
        let powers = BASE.iter().zip(self.exponents).filter(|(_, exponent)| *exponent != 0);
        let factors = powers.map(|(base, exponent)| match exponent {
            1 => (*base).to_owned(),
            _ => format!("{base}{exponent}"),
        });
        let product = Vec::from_iter(factors).join(".");
        if product.is_empty() { "1".to_owned() } else { product }
    }

    /// Multiplies by a symbol with an exponent, to the power of `sign`.
    fn multiply(&mut self, factor: &str, sign: i8) -> Result<(), String> {
        let unknown = || format!("{factor:?} is not a unit");
        let end = factor.find(|c: char| c == '-' || c == '+' || c.is_ascii_digit());
        let (symbol, exponent) = match end {
            Some(at) if at > 0 => factor.split_at(at),
            _ => (factor, "1"),
        };
        let power = exponent.parse::<i8>().ok().filter(|p| (-9..=9).contains(p));
        let power = sign * power.ok_or_else(unknown)?;
        let (exponents, scale) = symbol_with_prefix(symbol).ok_or_else(unknown)?;
        for (sum, exponent) in self.exponents.iter_mut().zip(exponents) {
            *sum += exponent * power;
        }
        for _ in 0..power.abs() {
            if power > 0 {
                self.factor *= scale;
            } else {
                self.factor /= scale;
            }
        }
        Ok(())
    }
}

/// The exponents and the factor of a symbol with an optional prefix.
fn symbol_with_prefix(symbol: &str) -> Option<([i8; 8], f64)> {
    let exact = SYMBOLS.iter().find(|(name, ..)| *name == symbol);
    if let Some((_, exponents, factor, _)) = exact {
        return Some((*exponents, *factor));
    }
    PREFIXES.iter().find_map(|(prefix, scale)| {
        let rest = symbol.strip_prefix(prefix)?;
        SYMBOLS
            .iter()
            .find(|(name, _, _, takes_prefix)| *takes_prefix && *name == rest)
            .map(|(_, exponents, factor, _)| (*exponents, scale * factor))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Exponents of the base units, from the definitions of the SI.
    #[test]
    fn units_become_products_of_base_units() {
        for (text, expected) in [
            ("1", "1"),
            ("kg", "kg"),
            ("N", "kg.m/s2"),
            ("N.s/m", "kg/s"),
            ("N/(rad.s)", "kg.m.s-3.rad-1"),
            ("V", "kg.m2/(s3.A)"),
            ("F", "A2.s4/(kg.m2)"),
            ("H", "V.s/A"),
            ("Wb/m2", "T"),
            ("S", "1/Ohm"),
            ("W/(m.K)", "kg.m/(s3.K)"),
            ("Hz", "1/s"),
            ("J", "N.m"),
            ("Pa", "N/m2"),
            ("lx", "cd/m2"),
        ] {
            assert_eq!(Unit::parse(text), Unit::parse(expected), "{text}");
        }
        let newton = Unit::parse("N").unwrap();
        assert_eq!(newton.exponents, [1, 1, -2, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn prefixes_and_other_units_have_factors() {
        for (text, factor) in [
            ("mm", 1e-3),
            ("kN", 1e3),
            ("MPa", 1e6),
            ("\u{b5}s", 1e-6),
            ("cm2", 1e-4),
            ("km/h", 1e3 / 3600.0),
            ("rpm", core::f64::consts::PI / 30.0),
            ("rev/min", core::f64::consts::PI / 30.0),
            ("%", 0.01),
            ("kW.h", 3.6e6),
            ("mol", 1.0),
            ("min", 60.0),
            ("g", 1e-3),
        ] {
            let unit = Unit::parse(text).unwrap();
            assert!((unit.factor / factor - 1.0).abs() < 1e-15, "{text}: {unit:?}");
        }
        let celsius = Unit::parse("degC").unwrap();
        assert_eq!((celsius.factor, celsius.offset), (1.0, 273.15));
    }

    #[test]
    fn angles_are_displayed_in_degrees() {
        assert_eq!(Unit::default_display("rad").as_deref(), Some("deg"));
        assert_eq!(Unit::default_display("rad/s").as_deref(), Some("deg/s"));
        assert_eq!(Unit::default_display("N/rad"), None);
    }

    #[test]
    fn units_of_one_dimension_convert_into_each_other() {
        use core::f64::consts::PI;
        for (unit, other, factor, offset) in [
            ("rad", "deg", 180.0 / PI, 0.0),
            ("rad/s", "rpm", 30.0 / PI, 0.0),
            ("Pa", "bar", 1e-5, 0.0),
            ("m/s", "km/h", 3.6, 0.0),
            ("K", "degC", 1.0, -273.15),
            ("degC", "degF", 1.8, 32.0),
            ("degF", "K", 5.0 / 9.0, 459.67 * 5.0 / 9.0),
        ] {
            let [from, to] = [unit, other].map(|text| Unit::parse(text).unwrap());
            let (found, shift) = from.conversion_to(&to).unwrap();
            assert!((found / factor - 1.0).abs() < 1e-15, "{unit} to {other}: {found}");
            assert!((shift - offset).abs() < 1e-12, "{unit} to {other}: {shift}");
        }
        for (unit, other, dimensions) in
            [("N", "W", ["kg.m.s-2", "kg.m2.s-3"]), ("1", "rad", ["1", "rad"])]
        {
            let both = [unit, other].map(|text| Unit::parse(text).unwrap());
            assert_eq!(both[0].conversion_to(&both[1]), None);
            assert_eq!(both.map(|unit| unit.dimension()), dimensions);
        }
    }

    #[test]
    fn everything_else_is_rejected() {
        for text in [
            "", "Nm", "N*m", "N m", "n", "N/", "/s", "N/m/s", "N/(m", "m^2", "m2.5", "ms99", "kkg",
            "kmin", "degC/s", "radians", "N.", "2", "2m", "m-",
        ] {
            assert!(Unit::parse(text).is_err(), "{text}");
        }
        assert_eq!(Unit::parse("N.foo/s"), Err("\"foo\" is not a unit".into()));
    }
}
