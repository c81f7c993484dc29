//! Start values and bounds: literals are checked here, constants where the compiler evaluates them.

use fmu_description::{Type as FmiType, words};
use proc_macro2::TokenStream;
use quote::{ToTokens, quote};
use syn::spanned::Spanned;
use syn::{Expr, Ident, Lit, Result, Type};

use crate::attributes::error;
use crate::expression::{Expression, Form};
use crate::field::{Field, ungrouped};
use crate::generate::at;

/// The bounds of a field that are literals; infinite if they are not, or if there are none.
struct Bounds<'a> {
    field: &'a Field,
    min: f64,
    max: f64,
}

/// Checks the literals in the start value and the bounds of a field.
pub fn check(field: &Field) -> Result<()> {
    let [start, min, max] = ["start", "min", "max"].map(|option| field.options.expression(option));
    for bound in [min, max].into_iter().flatten() {
        if !field.of_type.is_float() && !field.of_type.is_integer() {
            return error(bound, "only a number has bounds");
        }
        check_type(bound, field)?;
    }
    let bounds = Bounds {
        field,
        min: min
            .and_then(Expression::number)
            .unwrap_or(f64::NEG_INFINITY),
        max: max.and_then(Expression::number).unwrap_or(f64::INFINITY),
    };
    if bounds.min > bounds.max {
        let what = format!("expected a maximum of at least {}, the minimum", bounds.min);
        return error(max, what);
    }
    match start {
        Some(start) if start.is_literal() => bounds.check(start),
        Some(start) => bounds.check_shape(start, &field.ty),
        None if field.is_settable() && !bounds.contain(0.0) => error(
            &field.ident,
            format!("without `start`, it starts at 0; {}", bounds.expected()),
        ),
        None => Ok(()),
    }
}

impl Bounds<'_> {
    fn contain(&self, value: f64) -> bool {
        self.min <= value && value <= self.max
    }

    /// What is expected of a start value.
    fn expected(&self) -> String {
        let bounds = words::bounds(self.min, self.max);
        format!("expected a start value{bounds}")
    }

    /// Checks that an array has the dimensions of the type.
    fn check_shape(&self, start: &Expression, ty: &Type) -> Result<()> {
        match (&start.form, ungrouped(ty)) {
            (Form::Array(elements), Type::Array(of)) => match length(&of.len) {
                Some(expected) if expected != elements.len() as f64 => {
                    let found = elements.len();
                    error(
                        start,
                        format!("expected {expected} elements, found {found}"),
                    )
                }
                _ => (elements.iter()).try_for_each(|e| self.check_shape(e, &of.elem)),
            },
            (Form::Repeat(element, _), Type::Array(of)) => self.check_shape(element, &of.elem),
            (Form::Array(_) | Form::Repeat(..), _) => error(start, "expected a single value"),
            (Form::Literal(_), Type::Array(_)) => error(
                start,
                "expected an array, or a single value for all elements",
            ),
            _ => self.check(start),
        }
    }

    /// Checks the type and the bounds of a single literal.
    fn check(&self, start: &Expression) -> Result<()> {
        check_type(start, self.field)?;
        match start.number() {
            Some(value) if !self.contain(value) => {
                error(start, format!("outside the bounds; {}", self.expected()))
            }
            _ => Ok(()),
        }
    }
}

/// The length of an array, if it is a literal.
pub fn length(length: &Expr) -> Option<f64> {
    let length = syn::parse2::<Expression>(length.to_token_stream());
    length.ok()?.number()
}

fn check_type(expression: &Expression, field: &Field) -> Result<()> {
    let Form::Literal(literal) = &expression.form else {
        return Ok(());
    };
    let of_type = field.of_type;
    let expected = match (of_type, literal) {
        (FmiType::Float32, Lit::Int(_) | Lit::Float(_)) => {
            let is_infinite = |number| (number as f32).is_infinite();
            match expression.number().is_some_and(is_infinite) {
                true => "a number in the range of f32",
                false => return Ok(()),
            }
        }
        (of_type, Lit::Int(number)) if of_type.is_integer() => {
            let (min, max) = of_type.range();
            let number = number.base10_parse::<i128>();
            match number.is_ok_and(|number| min <= number && number <= max) {
                true => return Ok(()),
                false => &format!("a whole number from {min} to {max}"),
            }
        }
        (FmiType::Float64, Lit::Int(_) | Lit::Float(_))
        | (FmiType::Boolean, Lit::Bool(_))
        | (FmiType::String, Lit::Str(_))
        | (FmiType::Binary, Lit::ByteStr(_)) => return Ok(()),
        (FmiType::Float32 | FmiType::Float64, _) => "a number",
        (FmiType::Boolean, _) => "`true` or `false`",
        (FmiType::String, _) => "a text in quotes",
        (FmiType::Binary, _) => "bytes such as b\"abc\"",
        (FmiType::Enumeration, _) => {
            &format!("a variant of `{}`", field.element_type().to_token_stream())
        }
        _ => "a whole number",
    };
    error(expression, format!("expected {expected}"))
}

/// Checks an option that is a time, a tolerance or a nominal value.
pub fn check_positive(expression: &Expression) -> Result<()> {
    let is_positive = expression.number().is_some_and(|value| value > 0.0);
    match expression.is_literal() && !is_positive {
        true => error(expression, "expected a positive number"),
        false => Ok(()),
    }
}

impl Field {
    /// An expression as a value of the type, in which whole numbers may stand for real ones, and items for their
    /// numbers.
    fn value(&self, expression: &Expression) -> TokenStream {
        match (&expression.form, self.of_type) {
            (_, of_type) if of_type.is_float() => expression.real(),
            (Form::Array(elements), FmiType::Enumeration) => {
                let elements = elements.iter().map(|element| self.value(element));
                quote!([#(#elements),*])
            }
            (Form::Repeat(element, length), FmiType::Enumeration) => {
                let element = self.value(element);
                quote!([#element; #length])
            }
            (_, FmiType::Enumeration) => {
                let (ty, base) = (self.element_type(), self.choice(&quote!(BASE)));
                quote!({ let item: #ty = #expression; item as i32 + #base })
            }
            _ => expression.to_token_stream(),
        }
    }

    /// The bounds, each written in the type of the field.
    pub fn bounds(&self) -> TokenStream {
        let ty = self.element_type();
        let common = match self.of_type {
            of_type if of_type.is_float() => quote!(f64),
            of_type if of_type.is_integer() => quote!(i128),
            _ => return quote!(None),
        };
        let bound = |option, real, whole| match self.options.expression(option) {
            Some(bound) => {
                let bound = self.value(bound);
                quote!({ let bound: #ty = #bound; bound as #common })
            }
            None if self.of_type.is_float() => real,
            None => quote!(#ty::#whole as i128),
        };
        let min = bound("min", quote!(f64::NEG_INFINITY), quote!(MIN));
        let max = bound("max", quote!(f64::INFINITY), quote!(MAX));
        match self.of_type.is_float() {
            true => quote!(Real(#min, #max)),
            false => quote!(Whole(#min, #max)),
        }
    }

    /// The type with the start values, which the compiler checks against the bounds.
    pub fn start(&self, bounds: &TokenStream) -> TokenStream {
        let (krate, values) = (&self.krate, self.values());
        if self.of_type == FmiType::Enumeration {
            let items = self.choice(&quote!(ENUMERATION));
            return quote!(#krate::Start::Enumeration(#values, &#items));
        }
        let place = self.options.expression("start").map(Spanned::span);
        let place = place.unwrap_or(self.span());
        let name = self.name.value();
        let message = format!("the start value of `{name}` is outside its bounds");
        let of_type = Ident::new(self.of_type.as_str(), place);
        let start = quote!(#krate::Start::#of_type(#values));
        at(
            place,
            quote!(#krate::checked(#start, #krate::Bounds::#bounds, #message)),
        )
    }

    /// The start values as a constant slice; empty if the model calculates them.
    fn values(&self) -> TokenStream {
        let Some(start) = self.options.expression("start") else {
            let zero = match self.of_type {
                _ if !self.is_settable() => return quote!(&[]),
                FmiType::Float32 | FmiType::Float64 => quote!(0.0),
                FmiType::Boolean => quote!(false),
                FmiType::String => quote!(""),
                FmiType::Binary => quote!(b""),
                FmiType::Enumeration => {
                    let enumeration = self.choice(&quote!(ENUMERATION));
                    quote!(#enumeration.items[0].value)
                }
                _ => quote!(0),
            };
            return self.slice(&zero, true);
        };
        // An item cannot be distinguished from a constant array, and a constant array of items is unusual.
        let is_item = self.of_type == FmiType::Enumeration && matches!(start.form, Form::Other);
        self.slice(&self.value(start), start.is_literal() || is_item)
    }

    /// A value as a constant slice of all scalars; `is_scalar` if an array has it in all elements.
    fn slice(&self, value: &TokenStream, is_scalar: bool) -> TokenStream {
        let dimensions = self.dimensions();
        if dimensions.is_empty() {
            return quote!(&[#value]);
        }
        let repeated = |value| {
            let lengths = dimensions.iter().rev();
            lengths.fold(value, |inner, length| quote!([#inner; #length]))
        };
        let array = match is_scalar {
            true => repeated(value.clone()),
            false => value.clone(),
        };
        let array = match self.options.expression("start") {
            // An error of its type is shown there.
            Some(start) => at(start.span(), quote!(&#array)),
            None => quote!(&#array),
        };
        // In a start value, numbers stand for items, and string slices for strings.
        let ty = repeated(match self.of_type {
            FmiType::Enumeration => quote!(i32),
            FmiType::String => quote!(&'static str),
            FmiType::Binary => quote!(&'static [u8]),
            _ => self.element_type().to_token_stream(),
        });
        let flatten = (1..dimensions.len()).map(|_| quote!(.as_flattened()));
        quote!({ let start: &'static #ty = const { #array }; start #(#flatten)* })
    }
}
