//! Units with their base units (FMI 2.0.4, section 2.2.2).

/// A unit: a product of powers of the SI base units and the radian, without factor or offset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    /// The unit's name in the XML, such as `N.s/m`.
    pub name: &'static str,
    /// Exponents of the base units, in the order of [`BASE`].
    pub exponents: [i8; 8],
    /// Display unit: its name, and the factor that converts a value from this unit.
    pub display: Option<(&'static str, f64)>,
}

/// The base units of FMI 2.0.
pub const BASE: [&str; 8] = ["kg", "m", "s", "A", "K", "mol", "cd", "rad"];

const fn mechanical(name: &'static str, kg: i8, m: i8, s: i8, rad: i8) -> Unit {
    Unit {
        name,
        exponents: [kg, m, s, 0, 0, 0, 0, rad],
        display: None,
    }
}

impl Unit {
    const fn shown_as(self, name: &'static str, factor: f64) -> Self {
        Self {
            display: Some((name, factor)),
            ..self
        }
    }
}

const DEGREES: f64 = 180.0 / core::f64::consts::PI;

/// Dimensionless.
pub const ONE: Unit = mechanical("1", 0, 0, 0, 0);
/// Second.
pub const SECOND: Unit = mechanical("s", 0, 0, 1, 0);
/// Hertz.
pub const HERTZ: Unit = mechanical("Hz", 0, 0, -1, 0);
/// Kilogram.
pub const KILOGRAM: Unit = mechanical("kg", 1, 0, 0, 0);
/// Metre.
pub const METRE: Unit = mechanical("m", 0, 1, 0, 0);
/// Metre per second.
pub const METRE_PER_SECOND: Unit = mechanical("m/s", 0, 1, -1, 0);
/// Metre per second squared.
pub const METRE_PER_SECOND_SQUARED: Unit = mechanical("m/s2", 0, 1, -2, 0);
/// Kilogram metre squared.
pub const KILOGRAM_METRE_SQUARED: Unit = mechanical("kg.m2", 1, 2, 0, 0);
/// Radian, shown in degrees.
pub const RADIAN: Unit = mechanical("rad", 0, 0, 0, 1).shown_as("deg", DEGREES);
/// Radian per second, shown in degrees per second.
pub const RADIAN_PER_SECOND: Unit = mechanical("rad/s", 0, 0, -1, 1).shown_as("deg/s", DEGREES);
/// Newton.
pub const NEWTON: Unit = mechanical("N", 1, 1, -2, 0);
/// Newton second per metre.
pub const NEWTON_SECOND_PER_METRE: Unit = mechanical("N.s/m", 1, 0, -1, 0);
/// Newton per radian.
pub const NEWTON_PER_RADIAN: Unit = mechanical("N/rad", 1, 1, -2, -1);
/// Newton per radian and second.
pub const NEWTON_PER_RADIAN_SECOND: Unit = mechanical("N/(rad.s)", 1, 1, -3, -1);
/// Newton second per radian.
pub const NEWTON_SECOND_PER_RADIAN: Unit = mechanical("N.s/rad", 1, 1, -1, -1);
