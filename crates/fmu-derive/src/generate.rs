//! The implementation of `Variables`: the table, and the access to the fields.

use proc_macro2::{Span, TokenStream};
use quote::quote;
use syn::spanned::Spanned;
use syn::{Expr, Ident, LitStr, Type, parse_quote};

use crate::attributes::{FieldAttributes, Role};
use crate::field::{Content, Field, Kind, Variable, element_type};
use crate::{spans, start};

/// An item of `Choice` for a type. That it is not implemented is reported once, at the type, if all
/// code that needs it reads the same.
pub fn choice(ty: &Type, item: &TokenStream, krate: &TokenStream) -> TokenStream {
    spans::at(ty.span(), quote!(<#ty as #krate::Choice>::#item))
}

/// An item of `Variables` for a nested struct, as [`choice`].
fn nested(field: &Field, item: &TokenStream, krate: &TokenStream) -> TokenStream {
    let ty = &field.ty;
    spans::at(ty.span(), quote!(<#ty as #krate::Variables>::#item))
}

/// The row of a field; none if it is internal.
pub fn row(field: &Field, krate: &TokenStream) -> Option<TokenStream> {
    match &field.content {
        Content::Variable(variable) => Some(variable_row(field, variable, krate)),
        Content::Nested { prefix } => {
            let (ident, rows) = (&field.ident, nested(field, &quote!(ROWS), krate));
            Some(quote! {
                #krate::Row::Group {
                    prefix: #prefix,
                    offset: ::core::mem::offset_of!(Self, #ident),
                    rows: #rows,
                }
            })
        }
        Content::Internal => None,
    }
}

fn variable_row(field: &Field, variable: &Variable, krate: &TokenStream) -> TokenStream {
    let (name, description) = (&variable.name, &variable.description);
    let ident = &field.ident;
    let attributes = &field.attributes;
    let is_real = variable.kind.is_real();
    let (causality, variability) = match attributes.role {
        Role::Parameter if attributes.tunable => (quote!(Parameter), quote!(Tunable)),
        Role::Parameter => (quote!(Parameter), quote!(Fixed)),
        Role::StructuralParameter if attributes.tunable => {
            (quote!(StructuralParameter), quote!(Tunable))
        }
        Role::StructuralParameter => (quote!(StructuralParameter), quote!(Fixed)),
        Role::Constant => (quote!(Local), quote!(Constant)),
        role => {
            let causality = match role {
                Role::Input => quote!(Input),
                Role::Output => quote!(Output),
                _ => quote!(Local),
            };
            match is_real && !attributes.discrete {
                true => (causality, quote!(Continuous)),
                false => (causality, quote!(Discrete)),
            }
        }
    };
    let dimensions = field.dimensions();
    let domain = domain(field, variable, krate);
    let size = attributes
        .size
        .as_ref()
        .map(LitStr::value)
        .unwrap_or_default();
    let initially_from = &attributes.initially_from;
    let has_input_derivative = attributes.derivative.is_some();
    let terminal = attributes
        .terminal
        .as_ref()
        .map_or_else(String::new, LitStr::value);
    let depends_on = attributes.derivative_by.iter().map(|(name, _)| name);
    let dynamics = dynamics(attributes);
    quote! {
        #krate::Row::Variable(#krate::Variable {
            name: #name,
            description: #description,
            offset: ::core::mem::offset_of!(Self, #ident),
            causality: #krate::Causality::#causality,
            variability: #krate::Variability::#variability,
            dimensions: &[#(#dimensions),*],
            size: #size,
            domain: #domain,
            initially_from: &[#(#initially_from),*],
            dynamics: #krate::Dynamics::#dynamics,
            depends_on: &[#(#depends_on),*],
            has_input_derivative: #has_input_derivative,
            terminal: #terminal,
        })
    }
}

/// The part of a field in the differential equations.
fn dynamics(attributes: &FieldAttributes) -> TokenStream {
    match (attributes.role, &attributes.of) {
        (Role::Derivative, Some(of)) => quote!(Derivative { of: #of }),
        (Role::EventIndicator, _) => quote!(EventIndicator),
        _ if attributes.state => {
            let nominal = match &attributes.nominal {
                Some(nominal) => start::number(nominal, &Kind::Real),
                None => parse_quote!(1.0),
            };
            quote!(State { nominal: #nominal })
        }
        _ => quote!(Algebraic),
    }
}

fn domain(field: &Field, variable: &Variable, krate: &TokenStream) -> TokenStream {
    let start = start::start(field, variable, krate);
    // A bound in the type of the field, as the common type of all such numbers.
    let ty = element_type(&field.ty);
    let bound = |bound: &Option<Expr>, unbounded: TokenStream, common: TokenStream| match bound {
        Some(bound) => {
            let bound = start::number(bound, &variable.kind);
            quote!({ let bound: #ty = #bound; bound as #common })
        }
        None => unbounded,
    };
    let (min, max) = (&field.attributes.min, &field.attributes.max);
    let place = match &field.attributes.start {
        Some(start) => start.span(),
        None => field.span(),
    };
    let message = format!(
        "the start value of `{}` is outside its bounds",
        variable.name.value()
    );
    match &variable.kind {
        Kind::Real | Kind::Single => {
            let min = bound(min, quote!(f64::NEG_INFINITY), quote!(f64));
            let max = bound(max, quote!(f64::INFINITY), quote!(f64));
            let start = match variable.kind {
                Kind::Single => quote!(#krate::Reals::Float32(#start)),
                _ => quote!(#krate::Reals::Float64(#start)),
            };
            let unit = match &field.attributes.unit {
                Some(unit) => unit.clone(),
                None => LitStr::new("", Span::call_site()),
            };
            let checked = spans::at(place, quote!(#krate::reals(#start, (#min, #max), #message)));
            quote!(#krate::Domain::Real { start: #checked, min: #min, max: #max, unit: #unit })
        }
        Kind::Integer(kind) => {
            let min = bound(min, quote!(#ty::MIN as i128), quote!(i128));
            let max = bound(max, quote!(#ty::MAX as i128), quote!(i128));
            let kind = Ident::new(kind.as_str(), place);
            let start = quote!(#krate::Integers::#kind(#start));
            let checked = spans::at(
                place,
                quote!(#krate::integers(#start, (#min, #max), #message)),
            );
            quote!(#krate::Domain::Integer { start: #checked, min: #min, max: #max })
        }
        Kind::Boolean => quote!(#krate::Domain::Boolean { start: #start }),
        Kind::String => quote!(#krate::Domain::String { start: #start }),
        Kind::Binary => {
            let mime_type = match &field.attributes.mime_type {
                Some(mime_type) => mime_type.value(),
                None => "application/octet-stream".into(),
            };
            quote!(#krate::Domain::Binary { start: #start, mime_type: #mime_type })
        }
        Kind::Choice(ty) => {
            let items = choice(ty, &quote!(ENUMERATION), krate);
            quote!(#krate::Domain::Enumeration { start: #start, items: &#items })
        }
    }
}

/// Numbers of the first scalar of each field: a literal, and the counts of arrays and nested structs.
#[derive(Clone)]
pub struct Position {
    literal: usize,
    counts: Vec<TokenStream>,
}

impl Position {
    pub const START: Self = Self {
        literal: 0,
        counts: Vec::new(),
    };

    /// The position as a constant expression.
    pub fn tokens(&self) -> TokenStream {
        let (literal, counts) = (self.literal, &self.counts);
        match counts.len() {
            0 => quote!(#literal),
            _ => quote!(const { #literal #(+ #counts)* }),
        }
    }

    /// Moves on to the next field.
    pub fn advance(&mut self, field: &Field, krate: &TokenStream) {
        match count(field, krate) {
            Some(count) => self.counts.push(count),
            None => self.literal += usize::from(field.variable().is_some()),
        }
    }
}

/// Number of scalars of an array or a nested struct.
fn count(field: &Field, krate: &TokenStream) -> Option<TokenStream> {
    match &field.content {
        Content::Nested { .. } => Some(nested(field, &quote!(COUNT), krate)),
        Content::Variable(_) => {
            let dimensions = field.dimensions();
            (!dimensions.is_empty()).then(|| quote!(1 #(* (#dimensions))*))
        }
        Content::Internal => None,
    }
}

/// The condition that `index` is a number of the field, which starts at `at`.
fn is_of(field: &Field, at: &TokenStream, krate: &TokenStream) -> TokenStream {
    match count(field, krate) {
        Some(count) => quote!(index.wrapping_sub(#at) < const { #count }),
        None => quote!(index == #at),
    }
}

/// The scalar of a variable at `index`: a place.
fn scalar(field: &Field, at: &TokenStream) -> TokenStream {
    let ident = &field.ident;
    match field.dimensions().len() {
        0 => quote!(&mut self.#ident),
        dimensions => {
            let flatten = (1..dimensions).map(|_| quote!(.as_flattened_mut()));
            quote!(&mut self.#ident #(#flatten)* [index.wrapping_sub(#at)])
        }
    }
}

/// The arm of `value` for a field.
pub fn value_arm(field: &Field, at: &Position, krate: &TokenStream) -> Option<TokenStream> {
    let at = at.tokens();
    let guard = is_of(field, &at, krate);
    let value = match &field.content {
        Content::Nested { .. } => {
            let ident = &field.ident;
            let value = nested(field, &quote!(value), krate);
            quote!(#value(&mut self.#ident, index.wrapping_sub(#at)))
        }
        Content::Variable(variable) => {
            let scalar = scalar(field, &at);
            let value = match &variable.kind {
                Kind::Choice(ty) => {
                    let any = choice(ty, &quote!(any), krate);
                    quote!(#krate::ValueMut::Choice(#any(#scalar)))
                }
                _ => quote!(#krate::Element::access(#scalar)),
            };
            quote!(::core::option::Option::Some(#value))
        }
        Content::Internal => return None,
    };
    Some(quote!(_ if #guard => #value,))
}

/// The arm of `input_derivative` for a field.
pub fn input_derivative_arm(
    field: &Field,
    at: &Position,
    krate: &TokenStream,
) -> Option<TokenStream> {
    let at = at.tokens();
    let guard = is_of(field, &at, krate);
    let value = match (&field.content, &field.attributes.derivative) {
        (Content::Nested { .. }, _) => {
            let ident = &field.ident;
            let derivative = nested(field, &quote!(input_derivative), krate);
            quote!(#derivative(&mut self.#ident, index.wrapping_sub(#at)))
        }
        (_, Some(place)) => quote!(::core::option::Option::Some(&mut #place)),
        _ => return None,
    };
    Some(quote!(_ if #guard => #value,))
}

/// The arms of `directional_derivative` for a field; `knowns` are the inputs and states of the struct.
pub fn directional_derivative_arms(
    field: &Field,
    at: &Position,
    knowns: &[(String, TokenStream)],
    krate: &TokenStream,
) -> TokenStream {
    let at = at.tokens();
    if let Content::Nested { .. } = field.content {
        let ident = &field.ident;
        let count = nested(field, &quote!(COUNT), krate);
        let derivative = nested(field, &quote!(directional_derivative), krate);
        let (unknown, known) = (
            quote!(unknown.wrapping_sub(#at)),
            quote!(known.wrapping_sub(#at)),
        );
        return quote! {
            _ if #unknown < const { #count } && #known < const { #count } => {
                #derivative(&self.#ident, #unknown, #known)
            }
        };
    }
    let arms = field
        .attributes
        .derivative_by
        .iter()
        .filter_map(|(name, value)| {
            let (_, known) = knowns.iter().find(|(known, _)| *known == name.value())?;
            Some(quote!(_ if unknown == #at && known == #known => #value,))
        });
    quote!(#(#arms)*)
}

/// The statement of `add_outputs` for a field of a struct; of an array, it adds the elements in use.
pub fn add_outputs(field: &Field, fields: &[Field], krate: &TokenStream) -> Option<TokenStream> {
    let ident = &field.ident;
    match &field.content {
        Content::Nested { .. } => {
            let add = nested(field, &quote!(add_outputs), krate);
            Some(quote!(let sum = #add(&self.#ident, sum);))
        }
        Content::Variable(variable)
            if field.attributes.role == Role::Output && variable.kind.is_real() =>
        {
            let dimensions = field.dimensions().len();
            let size = fields.iter().find(|parameter| parameter.is_size_of(field));
            Some(match (dimensions, size) {
                (0, _) => quote!(let sum = sum + f64::from(self.#ident);),
                (_, Some(size)) => {
                    let size = &size.ident;
                    quote!(let sum = sum + #krate::sum(#krate::in_use(&self.#ident, self.#size));)
                }
                _ => {
                    let flatten = (1..dimensions).map(|_| quote!(.as_flattened()));
                    quote!(let sum = sum + #krate::sum(&self.#ident #(#flatten)*);)
                }
            })
        }
        _ => None,
    }
}

/// An item of the trait that copies and saves the elements of a field, as [`choice`].
fn element(field: &Field, item: &TokenStream, krate: &TokenStream) -> TokenStream {
    match &field.content {
        Content::Variable(Variable {
            kind: Kind::Choice(ty),
            ..
        }) => choice(ty, item, krate),
        Content::Nested { .. } => nested(field, item, krate),
        _ => {
            let ty = element_type(&field.ty);
            spans::at(ty.span(), quote!(<#ty as #krate::Internal>::#item))
        }
    }
}

/// The default value of a field.
pub fn unset(field: &Field, krate: &TokenStream) -> TokenStream {
    let ident = &field.ident;
    let value = element(field, &quote!(unset()), krate);
    // `Default` and `Deserialize` end at 32 elements.
    let value = (field.dimensions().iter())
        .fold(value, |value, _| quote!(::core::array::from_fn(|_| #value)));
    quote!(#ident: #value)
}

/// The scalars of a variable as a mutable slice.
fn scalars(field: &Field) -> TokenStream {
    let ident = &field.ident;
    match field.dimensions().len() {
        0 => quote!(::core::slice::from_mut(&mut self.#ident)),
        dimensions => {
            let flatten = (1..dimensions).map(|_| quote!(.as_flattened_mut()));
            quote!(&mut self.#ident #(#flatten)* [..])
        }
    }
}

/// The statement that sets a field to its start values; `row` is its index in the table.
pub fn set_start_values(field: &Field, row: usize, krate: &TokenStream) -> Option<TokenStream> {
    let ident = &field.ident;
    match &field.content {
        Content::Nested { .. } => {
            let set = nested(field, &quote!(set_start_values), krate);
            Some(quote!(#set(&mut self.#ident);))
        }
        Content::Variable(variable) => {
            let scalars = scalars(field);
            let row = quote!(const { &Self::ROWS[#row] });
            Some(match &variable.kind {
                Kind::Choice(ty) => {
                    let item = choice(ty, &quote!(from_number), krate);
                    quote!(#krate::set_choices(#scalars, #row, #item);)
                }
                _ => quote!(#krate::Element::set_start_values(#scalars, #row);),
            })
        }
        Content::Internal => None,
    }
}

/// The statement that copies a field that the host may set.
pub fn copy_settable(field: &Field, krate: &TokenStream) -> Option<TokenStream> {
    let ident = &field.ident;
    match (&field.content, field.attributes.role) {
        (Content::Nested { .. }, _) => {
            let copy = nested(field, &quote!(copy_settable), krate);
            Some(quote!(#copy(&mut self.#ident, &from.#ident);))
        }
        (_, Role::Input | Role::Parameter | Role::StructuralParameter) => {
            Some(quote!(::core::clone::Clone::clone_from(&mut self.#ident, &from.#ident);))
        }
        _ => None,
    }
}

/// A copy of a field.
pub fn copy(field: &Field, krate: &TokenStream) -> TokenStream {
    let ident = &field.ident;
    let copy = match field.dimensions().is_empty() {
        true => element(field, &quote!(copy), krate),
        false => spans::at(field.span(), quote!(::core::clone::Clone::clone)),
    };
    quote!(#ident: #copy(&self.#ident))
}

/// The statement that copies a field into the same field of this struct.
pub fn copy_from(field: &Field, krate: &TokenStream) -> TokenStream {
    let ident = &field.ident;
    let copy = match field.dimensions().is_empty() {
        true => element(field, &quote!(copy_from), krate),
        false => spans::at(field.span(), quote!(::core::clone::Clone::clone_from)),
    };
    quote!(#copy(&mut self.#ident, &from.#ident);)
}

/// The statement that saves a field.
pub fn save(field: &Field, krate: &TokenStream) -> TokenStream {
    let ident = &field.ident;
    let item = element(field, &quote!(save(item, to)?;), krate);
    let items =
        (field.dimensions().iter()).fold(item, |item, _| quote!(for item in item { #item }));
    quote!({ let item = &self.#ident; #items })
}

/// A field loaded.
pub fn load(field: &Field, krate: &TokenStream) -> TokenStream {
    let ident = &field.ident;
    let item = element(field, &quote!(load(from)), krate);
    let item = (field.dimensions().iter()).fold(item, |item, _| quote!(from.array(|from| #item)));
    quote!(#ident: #item?)
}
