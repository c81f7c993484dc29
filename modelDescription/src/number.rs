//! Floating-point numbers in messages: the text of `std`, from a fifth of its code.
//!
//! `std` has much code for speed, and for any number of digits. It would be a tenth of the C sources of a small model,
//! which shows a number only when something is wrong.

use std::cmp::Ordering;
use std::fmt::{self, Write};

/// A number that is shown as `std` shows it by `{}` and `{:?}`; flags such as a width have no effect.
#[derive(Clone, Copy)]
pub struct Number<T>(pub T);

macro_rules! show {
    ($($float:ident)*) => { $(
        impl fmt::Display for Number<$float> {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                Binary::from(self.0).show(f, Style::Display)
            }
        }

        impl fmt::Debug for Number<$float> {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                Binary::from(self.0).show(f, Style::Debug)
            }
        }

        impl From<$float> for Binary {
            fn from(number: $float) -> Self {
                Self {
                    is_negative: number.is_sign_negative(),
                    bits: number.abs().to_bits().into(),
                    fraction_bits: $float::MANTISSA_DIGITS - 1,
                    bias: $float::MAX_EXP - 1,
                }
            }
        }
    )* };
}
show!(f32 f64);

#[derive(Clone, Copy, PartialEq)]
enum Style {
    /// All digits.
    Display,
    /// Large and small numbers with an exponent, whole numbers with a `.0`.
    Debug,
}

/// A number of any type as IEEE 754 encodes it.
struct Binary {
    is_negative: bool,
    /// The bits of its absolute value.
    bits: u64,
    fraction_bits: u32,
    /// What is added to exponents.
    bias: i32,
}

impl Binary {
    fn show(&self, f: &mut fmt::Formatter<'_>, style: Style) -> fmt::Result {
        let infinity = (2 * self.bias as u64 + 1) << self.fraction_bits;
        if self.bits > infinity {
            return f.write_str("NaN");
        }
        if self.is_negative {
            f.write_char('-')?;
        }
        if self.bits == infinity {
            return f.write_str("inf");
        }
        let Decimal { digits, len, point } = self.shortest();
        let is_debug = style == Style::Debug;
        let (point, exponent) = match is_debug && !(-3..=16).contains(&point) {
            true => (1, Some(point - 1)),
            false => (point, None),
        };
        let least = point + i32::from(is_debug && exponent.is_none());
        for place in (point - 1).min(0)..least.max(len) {
            if place == point {
                f.write_char('.')?;
            }
            let digit = usize::try_from(place).ok().and_then(|place| digits.get(place));
            f.write_char(char::from(b'0' + digit.unwrap_or(&0)))?;
        }
        match exponent {
            Some(exponent) => write!(f, "e{exponent}"),
            None => Ok(()),
        }
    }

    /// The fewest digits that read back as this number, which is finite, and of these the nearest to it: the algorithm of
    /// Steele and White, <https://doi.org/10.1145/93542.93559>, with the ends of the range as in Burger and Dybvig,
    /// <https://doi.org/10.1145/231379.231397>.
    fn shortest(&self) -> Decimal {
        let mut decimal = Decimal { digits: [0; 17], len: 0, point: 0 };
        if self.bits == 0 {
            return Decimal { len: 1, point: 1, ..decimal };
        }
        let exponent = (self.bits >> self.fraction_bits) as i32;
        let fraction = self.bits & ((1 << self.fraction_bits) - 1);
        // The number is mantissa * 2^power.
        let mantissa = fraction | u64::from(exponent > 0) << self.fraction_bits;
        let power = exponent.max(1) - self.bias - self.fraction_bits as i32;
        // The number is rest / scale. The numbers that read back as it are from (rest - below) / scale to
        // (rest + above) / scale, half the distance to its neighbours; the one below a power of 2 is nearer.
        let below = if fraction == 0 && exponent > 1 { 1 } else { 2 };
        let [mut rest, mut below, mut above, mut scale] =
            [4 * mantissa, below, 2, 4].map(Natural::from);
        for shift in shifts(power) {
            for natural in [&mut rest, &mut below, &mut above] {
                natural.multiply(1 << shift);
            }
        }
        for shift in shifts(-power) {
            scale.multiply(1 << shift);
        }
        // What is half-way between two numbers reads as the one whose mantissa is even.
        let reaches =
            |order: Ordering| order.is_gt() || order.is_eq() && mantissa.is_multiple_of(2);
        while reaches(rest.plus(&above).order(&scale)) {
            scale.multiply(10);
            decimal.point += 1;
        }
        loop {
            for natural in [&mut rest, &mut below, &mut above] {
                natural.multiply(10);
            }
            let mut digit = 0;
            while rest.order(&scale).is_ge() {
                rest.subtract(&scale);
                digit += 1;
            }
            let may_end = reaches(below.order(&rest));
            let may_round_up = reaches(rest.plus(&above).order(&scale));
            let is_upper_half = rest.plus(&rest).order(&scale).is_ge();
            digit += u8::from(may_round_up && (is_upper_half || !may_end));
            if digit == 0 && decimal.len == 0 {
                decimal.point -= 1;
                continue;
            }
            decimal.digits[decimal.len as usize] = digit;
            decimal.len += 1;
            if may_end || may_round_up {
                return decimal;
            }
        }
    }
}

/// The parts of a shift that fit into a word, none if it is negative.
fn shifts(mut by: i32) -> impl Iterator<Item = i32> {
    std::iter::from_fn(move || {
        let part = by.min(31);
        by -= part;
        (part > 0).then_some(part)
    })
}

/// A number as 0.d1 d2 d3 ... * 10^point.
struct Decimal {
    digits: [u8; 17],
    /// How many digits there are.
    len: i32,
    point: i32,
}

/// A whole number below 2^1120, in words of 32 bits, the lowest first. The largest here is below 20 * 2^1076.
#[derive(Clone, Copy)]
struct Natural([u32; 35]);

impl From<u64> for Natural {
    fn from(number: u64) -> Self {
        let mut words = [0; 35];
        [words[0], words[1]] = [number as u32, (number >> 32) as u32];
        Self(words)
    }
}

impl Natural {
    fn multiply(&mut self, factor: u32) {
        let mut carry = 0;
        for word in &mut self.0 {
            carry += u64::from(*word) * u64::from(factor);
            *word = carry as u32;
            carry >>= 32;
        }
    }

    fn plus(&self, other: &Self) -> Self {
        let mut sum = *self;
        let mut carry = 0;
        for (word, &added) in sum.0.iter_mut().zip(&other.0) {
            carry += u64::from(*word) + u64::from(added);
            *word = carry as u32;
            carry >>= 32;
        }
        sum
    }

    /// Subtracts a number that is not larger.
    fn subtract(&mut self, other: &Self) {
        let mut borrow = 0;
        for (word, &subtracted) in self.0.iter_mut().zip(&other.0) {
            borrow += i64::from(*word) - i64::from(subtracted);
            *word = borrow as u32;
            borrow >>= 32;
        }
    }

    fn order(&self, other: &Self) -> Ordering {
        self.0.iter().rev().cmp(other.0.iter().rev())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    macro_rules! assert_text_of_std {
        ($number:expr) => {{
            let number = $number;
            assert_eq!(Number(number).to_string(), number.to_string());
            assert_eq!(format!("{:?}", Number(number)), format!("{number:?}"));
        }};
    }

    /// Numbers at the ends of the ranges of the algorithm.
    macro_rules! assert_text_at_ends {
        ($float:ident) => {
            // Where the distance between numbers changes.
            for power in
                ($float::MIN_EXP - $float::MANTISSA_DIGITS as i32..$float::MAX_EXP).step_by(3)
            {
                let number = $float::powi(2.0, power);
                for number in [number.next_down(), number, number.next_up()] {
                    assert_text_of_std!(number);
                }
            }
            for power in -20..30 {
                let number: $float = format!("1e{power}").parse().unwrap();
                for number in [number.next_down(), number, number.next_up()] {
                    assert_text_of_std!(number);
                }
            }
            for number in [0.0, $float::MIN_POSITIVE, $float::MAX, $float::INFINITY, $float::NAN] {
                for number in [number, -number] {
                    assert_text_of_std!(number);
                }
            }
        };
    }

    #[test]
    fn special_numbers_have_the_text_of_std() {
        assert_text_at_ends!(f32);
        assert_text_at_ends!(f64);
    }

    proptest! {
        #[test]
        fn all_bits_have_the_text_of_std(bits: u64) {
            assert_text_of_std!(f64::from_bits(bits));
            assert_text_of_std!(f32::from_bits(bits as u32));
        }

        #[test]
        fn fractions_half_way_between_two_decimals_have_the_text_of_std(digits in 0u64..1 << 53, power in 0..16) {
            assert_text_of_std!(digits as f64 / f64::from(1 << power));
            assert_text_of_std!((digits >> 29) as f32 / (1 << power) as f32);
        }

        #[test]
        fn short_decimals_have_the_text_of_std(digits in 0i32..100_000, exponent in -20..20) {
            assert_text_of_std!(format!("{digits}e{exponent}").parse::<f64>().unwrap());
            assert_text_of_std!(format!("{digits}e{exponent}").parse::<f32>().unwrap());
        }
    }
}
