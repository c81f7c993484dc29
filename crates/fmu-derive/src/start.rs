//! Start values and bounds: literals are checked here, constants where the compiler evaluates them.

use fmu_description::words;
use proc_macro2::TokenStream;
use quote::{ToTokens, quote};
use syn::spanned::Spanned;
use syn::{
    Error, Expr, ExprArray, ExprGroup, ExprLit, ExprParen, ExprRepeat, ExprUnary, Lit, LitFloat,
    Result, Type, UnOp,
};

use crate::attributes::{FieldAttributes, Role};
use crate::field::{Field, Kind, Variable, element_type, ungrouped};
use crate::generate::choice;
use crate::spans;

/// Checks the literals in the start value and the bounds of a field.
pub fn check(field: &syn::Field, attributes: &FieldAttributes, kind: &Kind) -> Result<()> {
    let (min, max) = (attributes.min.as_ref(), attributes.max.as_ref());
    for bound in [min, max].into_iter().flatten() {
        if !kind.is_real() && !matches!(kind, Kind::Integer(_)) {
            return Err(Error::new_spanned(bound, "only a number has bounds"));
        }
        check_type(bound, kind)?;
    }
    let bounds = Bounds {
        min: min.and_then(number_of).unwrap_or(f64::NEG_INFINITY),
        max: max.and_then(number_of).unwrap_or(f64::INFINITY),
    };
    if let Some(expression) = max
        && bounds.min > bounds.max
    {
        let message = format!("expected a maximum of at least {}, the minimum", bounds.min);
        return Err(Error::new_spanned(expression, message));
    }
    let has_default = matches!(
        attributes.role,
        Role::Input | Role::Parameter | Role::StructuralParameter
    );
    match &attributes.start {
        Some(start) if is_literal(start) => check_element(start, kind, &bounds),
        Some(start) => check_shape(start, &field.ty, kind, &bounds),
        None if has_default && !bounds.contain(0.0) => Err(Error::new_spanned(
            &field.ident,
            format!("without `start`, it starts at 0; {}", bounds.expected()),
        )),
        None => Ok(()),
    }
}

/// The bounds that are literals; infinite if they are not, or if there are none.
struct Bounds {
    min: f64,
    max: f64,
}

impl Bounds {
    fn contain(&self, value: f64) -> bool {
        self.min <= value && value <= self.max
    }

    /// What is expected of a start value.
    fn expected(&self) -> String {
        format!(
            "expected a start value{}",
            words::bounds(self.min, self.max)
        )
    }
}

/// Checks that an array has the dimensions of the type.
fn check_shape(start: &Expr, ty: &Type, kind: &Kind, bounds: &Bounds) -> Result<()> {
    match (start, ungrouped(ty)) {
        (Expr::Array(array), Type::Array(of)) => {
            let found = array.elems.len();
            if let Some(expected) = number_of(&of.len)
                && expected != found as f64
            {
                let message = format!("expected {expected} elements, found {found}");
                return Err(Error::new_spanned(start, message));
            }
            (array.elems.iter()).try_for_each(|e| check_shape(e, &of.elem, kind, bounds))
        }
        (Expr::Repeat(repeat), Type::Array(of)) => {
            check_shape(&repeat.expr, &of.elem, kind, bounds)
        }
        (Expr::Array(_) | Expr::Repeat(_), _) => {
            Err(Error::new_spanned(start, "expected a single value"))
        }
        (start, Type::Array(_)) if is_literal(start) => Err(Error::new_spanned(
            start,
            "expected an array, or a single value for all elements",
        )),
        (start, _) => check_element(start, kind, bounds),
    }
}

/// Checks the type and the bounds of a single literal.
fn check_element(start: &Expr, kind: &Kind, bounds: &Bounds) -> Result<()> {
    check_type(start, kind)?;
    match number_of(start) {
        Some(value) if !bounds.contain(value) => Err(Error::new_spanned(
            start,
            format!("outside the bounds; {}", bounds.expected()),
        )),
        _ => Ok(()),
    }
}

fn check_type(expression: &Expr, kind: &Kind) -> Result<()> {
    let Some(literal) = literal(expression) else {
        return Ok(());
    };
    let expected = match (kind, literal) {
        (Kind::Single, Lit::Int(_) | Lit::Float(_))
            if number_of(expression).is_some_and(|n| (n as f32).is_infinite()) =>
        {
            "a number in the range of f32"
        }
        (Kind::Integer(kind), Lit::Int(_)) => {
            let (min, max) = kind.range();
            match whole_of(expression) {
                Some(number) if min <= number && number <= max => return Ok(()),
                _ => &format!("a whole number from {min} to {max}"),
            }
        }
        (Kind::Real | Kind::Single, Lit::Int(_) | Lit::Float(_))
        | (Kind::Boolean, Lit::Bool(_))
        | (Kind::String, Lit::Str(_))
        | (Kind::Binary, Lit::ByteStr(_)) => return Ok(()),
        (Kind::Real | Kind::Single, _) => "a number",
        (Kind::Integer(_), _) => "a whole number",
        (Kind::Boolean, _) => "`true` or `false`",
        (Kind::String, _) => "a text in quotes",
        (Kind::Binary, _) => "bytes such as b\"abc\"",
        (Kind::Choice(ty), _) => {
            let ty = element_type(ty).to_token_stream();
            let message = format!("expected a variant of `{ty}`");
            return Err(Error::new_spanned(expression, message));
        }
    };
    Err(Error::new_spanned(
        expression,
        format!("expected {expected}"),
    ))
}

/// Checks an option of the model that is a time or a tolerance.
pub fn check_positive(expression: &Expr) -> Result<()> {
    let is_positive = number_of(expression).is_some_and(|value| value > 0.0);
    match is_literal(expression) && !is_positive {
        true => Err(Error::new_spanned(expression, "expected a positive number")),
        false => Ok(()),
    }
}

/// The literal, of which the sign is removed.
fn literal(expression: &Expr) -> Option<&Lit> {
    match expression {
        Expr::Lit(ExprLit { lit, .. }) => Some(lit),
        Expr::Unary(ExprUnary {
            op: UnOp::Neg(_),
            expr,
            ..
        })
        | Expr::Paren(ExprParen { expr, .. })
        | Expr::Group(ExprGroup { expr, .. }) => literal(expr),
        _ => None,
    }
}

/// Whether an expression is a single literal value.
fn is_literal(expression: &Expr) -> bool {
    literal(expression).is_some()
}

/// The value of a literal number.
pub fn number_of(expression: &Expr) -> Option<f64> {
    match expression {
        Expr::Unary(ExprUnary {
            op: UnOp::Neg(_),
            expr,
            ..
        }) => number_of(expr).map(|value| -value),
        Expr::Paren(ExprParen { expr, .. }) | Expr::Group(ExprGroup { expr, .. }) => {
            number_of(expr)
        }
        Expr::Lit(ExprLit { lit, .. }) => match lit {
            Lit::Int(number) => number.base10_parse().ok(),
            Lit::Float(number) => number.base10_parse().ok(),
            _ => None,
        },
        _ => None,
    }
}

/// The value of a literal whole number.
fn whole_of(expression: &Expr) -> Option<i128> {
    match expression {
        Expr::Unary(ExprUnary {
            op: UnOp::Neg(_),
            expr,
            ..
        }) => whole_of(expr).map(|value| -value),
        Expr::Paren(ExprParen { expr, .. }) | Expr::Group(ExprGroup { expr, .. }) => whole_of(expr),
        Expr::Lit(ExprLit {
            lit: Lit::Int(number),
            ..
        }) => number.base10_parse().ok(),
        _ => None,
    }
}

/// An expression of the attribute as a value of the type: whole numbers become numbers of type f64 or f32.
pub fn number(expression: &Expr, kind: &Kind) -> Expr {
    let mut expression = expression.clone();
    if kind.is_real() {
        make_real(&mut expression);
    }
    expression
}

fn make_real(expression: &mut Expr) {
    match expression {
        Expr::Lit(ExprLit { lit, .. }) => {
            if let Lit::Int(number) = lit
                && number.suffix().is_empty()
            {
                *lit = LitFloat::new(&format!("{number}.0"), number.span()).into();
            }
        }
        Expr::Unary(ExprUnary {
            op: UnOp::Neg(_),
            expr,
            ..
        }) => make_real(expr),
        Expr::Array(ExprArray { elems, .. }) => elems.iter_mut().for_each(make_real),
        Expr::Repeat(ExprRepeat { expr, .. }) => make_real(expr),
        _ => {}
    }
}

/// The start values of a variable as a constant slice; empty if the model calculates the value.
pub fn start(field: &Field, variable: &Variable, krate: &TokenStream) -> TokenStream {
    let Some(expression) = &field.attributes.start else {
        return default_start(field, variable, krate);
    };
    let expression = number(expression, &variable.kind);
    let value = match &variable.kind {
        Kind::Choice(ty) => numbers(&expression, element_type(ty), krate),
        _ => quote!(#expression),
    };
    let is_array = matches!(expression, Expr::Array(_) | Expr::Repeat(_));
    // An item cannot be distinguished from a constant array, and a constant array of items is unusual.
    let is_scalar = !is_array && (is_literal(&expression) || is_choice(variable));
    if field.dimensions().is_empty() {
        quote!(&[#value])
    } else if is_scalar {
        repeated(field, variable, &value)
    } else {
        slice(field, &start_type(field, variable), &value)
    }
}

/// Items, or arrays of them, as their numbers.
fn numbers(expression: &Expr, ty: &Type, krate: &TokenStream) -> TokenStream {
    match expression {
        Expr::Array(array) => {
            let elements = array.elems.iter().map(|e| numbers(e, ty, krate));
            quote!([#(#elements),*])
        }
        Expr::Repeat(repeat) => {
            let (element, length) = (numbers(&repeat.expr, ty, krate), &repeat.len);
            quote!([#element; #length])
        }
        item => {
            let base = choice(ty, &quote!(BASE), krate);
            quote!({ let item: #ty = #item; item as i32 + #base })
        }
    }
}

/// An array as a constant slice of its scalars.
fn slice(field: &Field, ty: &TokenStream, array: &TokenStream) -> TokenStream {
    let flatten = field
        .dimensions()
        .into_iter()
        .skip(1)
        .map(|_| quote!(.as_flattened()));
    let array = match &field.attributes.start {
        // An error of its type is shown there.
        Some(start) => spans::at(start.span(), quote!(&#array)),
        None => quote!(&#array),
    };
    quote!({ let start: &'static #ty = const { #array }; start #(#flatten)* })
}

/// An array of equal values as a constant slice.
fn repeated(field: &Field, variable: &Variable, value: &TokenStream) -> TokenStream {
    let array = (field.dimensions().iter().rev())
        .fold(value.clone(), |inner, length| quote!([#inner; #length]));
    slice(field, &start_type(field, variable), &array)
}

fn is_choice(variable: &Variable) -> bool {
    matches!(variable.kind, Kind::Choice(_))
}

/// Inputs and parameters start at zero, outputs and local variables are calculated.
fn default_start(field: &Field, variable: &Variable, krate: &TokenStream) -> TokenStream {
    if !matches!(
        field.attributes.role,
        Role::Input | Role::Parameter | Role::StructuralParameter
    ) {
        return quote!(&[]);
    }
    let zero = match &variable.kind {
        Kind::Real | Kind::Single => quote!(0.0),
        Kind::Integer(_) => quote!(0),
        Kind::Boolean => quote!(false),
        Kind::String => quote!(""),
        Kind::Binary => quote!(b""),
        Kind::Choice(ty) => {
            let enumeration = choice(ty, &quote!(ENUMERATION), krate);
            quote!(#enumeration.items[0].value)
        }
    };
    match field.dimensions().len() {
        0 => quote!(&[#zero]),
        _ => repeated(field, variable, &zero),
    }
}

/// The type of the start value of an array, in which numbers stand for items, and string slices for
/// strings.
fn start_type(field: &Field, variable: &Variable) -> TokenStream {
    let element = match &variable.kind {
        Kind::Choice(_) => quote!(i32),
        Kind::String => quote!(&'static str),
        Kind::Binary => quote!(&'static [u8]),
        _ => element_type(&field.ty).to_token_stream(),
    };
    let dimensions = field.dimensions();
    dimensions
        .iter()
        .rev()
        .fold(element, |inner, length| quote!([#inner; #length]))
}
