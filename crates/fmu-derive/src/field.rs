//! A field of a struct, with its attribute checked.

use fmu_description::{IntegerKind, Unit};
use proc_macro2::Span;
use quote::{ToTokens, quote};
use syn::{Error, Expr, GenericArgument, Ident, LitStr, PathArguments, Result, Type};

use crate::attributes::{FieldAttributes, Role};
use crate::{names, start};

/// A field.
pub struct Field {
    pub ident: Ident,
    pub ty: Type,
    pub attributes: FieldAttributes,
    pub content: Content,
}

/// What a field contributes to the table.
pub enum Content {
    Variable(Variable),
    Nested { prefix: String },
    Internal,
}

/// A variable: its name, and the type of its elements.
pub struct Variable {
    pub name: LitStr,
    pub description: String,
    pub kind: Kind,
}

/// The type of the elements of a variable.
#[derive(Clone)]
pub enum Kind {
    /// `f64`
    Real,
    /// `f32`
    Single,
    Integer(IntegerKind),
    Boolean,
    String,
    /// `Vec<u8>`
    Binary,
    Choice(Box<Type>),
}

impl Kind {
    /// Whether it is a number with a fraction.
    pub fn is_real(&self) -> bool {
        matches!(self, Self::Real | Self::Single)
    }
}

const INTEGERS: [(&str, IntegerKind); 8] = [
    ("i8", IntegerKind::Int8),
    ("u8", IntegerKind::UInt8),
    ("i16", IntegerKind::Int16),
    ("u16", IntegerKind::UInt16),
    ("i32", IntegerKind::Int32),
    ("u32", IntegerKind::UInt32),
    ("i64", IntegerKind::Int64),
    ("u64", IntegerKind::UInt64),
];

impl Field {
    pub fn of(field: &syn::Field) -> Result<Self> {
        let attributes = FieldAttributes::of(field)?;
        let Some(ident) = field.ident.clone() else {
            return Err(Error::new_spanned(field, "expected a field with a name"));
        };
        let content = match attributes.role {
            Role::Internal => Content::Internal,
            Role::Nested if !matches!(ungrouped(&field.ty), Type::Path(_)) => {
                return Err(Error::new_spanned(
                    &field.ty,
                    "expected a struct with #[derive(Variables)]",
                ));
            }
            Role::Nested => Content::Nested {
                prefix: prefix(&ident, &attributes)?,
            },
            _ => Content::Variable(variable(field, &ident, &attributes)?),
        };
        Ok(Self {
            ident,
            ty: field.ty.clone(),
            attributes,
            content,
        })
    }

    /// Where errors of the field are shown.
    pub fn span(&self) -> Span {
        self.ident.span()
    }

    pub fn variable(&self) -> Option<&Variable> {
        match &self.content {
            Content::Variable(variable) => Some(variable),
            _ => None,
        }
    }

    /// Whether it is the structural parameter that is the number of elements in use of an array.
    pub fn is_size_of(&self, array: &Self) -> bool {
        self.attributes.role == Role::StructuralParameter
            && (self.variable().zip(array.attributes.size.as_ref()))
                .is_some_and(|(variable, size)| variable.name.value() == size.value())
    }

    /// The dimensions of an array; empty for other types.
    pub fn dimensions(&self) -> Vec<&Expr> {
        let mut dimensions = Vec::new();
        let mut ty = ungrouped(&self.ty);
        while let Type::Array(array) = ty {
            dimensions.push(&array.len);
            ty = ungrouped(&array.elem);
        }
        dimensions
    }
}

fn prefix(ident: &Ident, attributes: &FieldAttributes) -> Result<String> {
    match &attributes.prefix {
        Some(prefix) if attributes.flatten => Err(Error::new_spanned(
            prefix,
            "expected either `prefix` or `flatten`",
        )),
        Some(prefix) => {
            names::check(prefix)?;
            Ok(prefix.value())
        }
        None if attributes.flatten => Ok(String::new()),
        None => Ok(plain(ident)),
    }
}

fn variable(field: &syn::Field, ident: &Ident, attributes: &FieldAttributes) -> Result<Variable> {
    let name = name(ident, attributes)?;
    let description = match &attributes.description {
        Some(text) => Some(text.value()),
        None => names::description(&field.attrs).map(|text| without_unit(&text, attributes)),
    };
    let of_state = || Some(format!("Derivative of {}", attributes.of.as_ref()?.value()));
    let description = description.or_else(of_state);
    let description = description.filter(|text| !text.is_empty()).ok_or_else(|| {
        Error::new(
            ident.span(),
            format!("`{ident}` has no description; write a doc comment above it"),
        )
    })?;
    let kind = kind(&field.ty)?;
    check_options(&kind, field, attributes)?;
    Ok(Variable {
        name,
        description,
        kind,
    })
}

/// The name of a variable; that of a derivative is `der(state)`.
fn name(ident: &Ident, attributes: &FieldAttributes) -> Result<LitStr> {
    if attributes.role == Role::Derivative {
        let state = attributes.of.as_ref().ok_or_else(|| {
            Error::new(
                ident.span(),
                "a derivative needs its state; expected `#[derivative(of = ...)]`",
            )
        })?;
        names::check(state)?;
        return Ok(LitStr::new(
            &format!("der({})", state.value()),
            state.span(),
        ));
    }
    let name =
        (attributes.name.clone()).unwrap_or_else(|| LitStr::new(&plain(ident), ident.span()));
    names::check(&name)?;
    Ok(name)
}

/// A doc comment without the unit in parentheses, which the variable has by itself.
fn without_unit(text: &str, attributes: &FieldAttributes) -> String {
    match &attributes.unit {
        Some(unit) => text.replace(&format!(" ({})", unit.value()), ""),
        None => text.to_owned(),
    }
}

/// The name of a field without `r#`.
fn plain(ident: &Ident) -> String {
    let name = ident.to_string();
    name.strip_prefix("r#").unwrap_or(&name).to_owned()
}

fn kind(ty: &Type) -> Result<Kind> {
    let unsupported = || {
        Error::new_spanned(
            ty,
            "not a type of an FMI variable; expected f64, f32, i8 to i64, u8 to u64, bool, String, Vec<u8>, an enum with #[derive(Choice)], or an array such as [f64; 3]",
        )
    };
    match ungrouped(ty) {
        Type::Array(array) => kind(&array.elem),
        Type::Path(path) => {
            let Some(last) = path.path.segments.last() else {
                return Err(unsupported());
            };
            let has_types = match &last.arguments {
                PathArguments::None => false,
                PathArguments::AngleBracketed(list) => {
                    (list.args.iter()).any(|a| matches!(a, GenericArgument::Type(_)))
                }
                PathArguments::Parenthesized(_) => true,
            };
            let name = last.ident.to_string();
            if let Some((_, kind)) = INTEGERS.iter().find(|(of, _)| *of == name) {
                return Ok(Kind::Integer(*kind));
            }
            match name.as_str() {
                "f64" => Ok(Kind::Real),
                "f32" => Ok(Kind::Single),
                "bool" => Ok(Kind::Boolean),
                "String" => Ok(Kind::String),
                "Vec" if last.to_token_stream().to_string() == quote!(Vec<u8>).to_string() => {
                    Ok(Kind::Binary)
                }
                "i128" | "isize" | "u128" | "usize" | "char" | "str" => Err(unsupported()),
                _ if has_types => Err(unsupported()),
                _ => Ok(Kind::Choice(Box::new(ty.clone()))),
            }
        }
        _ => Err(unsupported()),
    }
}

fn check_options(kind: &Kind, field: &syn::Field, attributes: &FieldAttributes) -> Result<()> {
    let is_real = matches!(kind, Kind::Real);
    let is_array = matches!(ungrouped(&field.ty), Type::Array(_));
    if let Some(unit) = &attributes.unit {
        if !kind.is_real() {
            return Err(Error::new_spanned(
                unit,
                "only an f64 or f32 has a unit (a type alias is not recognized)",
            ));
        }
        if let Err(error) = Unit::parse(&unit.value()) {
            let text = unit.value();
            let which = match error == format!("{text:?} is not a unit") {
                true => String::new(),
                false => format!(": {error}"),
            };
            return Err(Error::new_spanned(
                unit,
                format!(
                    "unknown unit {text:?}{which}; expected a product such as \"N.m\", \"kg.m2\", \"m/s2\" or \"N/(rad.s)\""
                ),
            ));
        }
    }
    if let Some(mime_type) = &attributes.mime_type
        && !matches!(kind, Kind::Binary)
    {
        return Err(Error::new_spanned(
            mime_type,
            "only a Vec<u8> has a MIME type",
        ));
    }
    if attributes.role == Role::StructuralParameter
        && (is_array || !matches!(kind, Kind::Integer(IntegerKind::UInt64)))
    {
        return Err(Error::new_spanned(
            &field.ty,
            "a structural parameter is of type u64",
        ));
    }
    if let Some(size) = &attributes.size {
        let is_list = match ungrouped(&field.ty) {
            Type::Array(array) => !matches!(ungrouped(&array.elem), Type::Array(_)),
            _ => false,
        };
        if !is_list || attributes.state {
            return Err(Error::new_spanned(
                size,
                "only an array of one dimension, and not of states, has a size",
            ));
        }
    }
    if attributes.role == Role::Constant && attributes.start.is_none() {
        return Err(Error::new_spanned(
            &field.ident,
            "a constant needs a value; expected `#[constant(start = ...)]`",
        ));
    }
    start::check(field, attributes, kind)?;
    if let Some(derivative) = &attributes.derivative
        && (!is_real || is_array)
    {
        return Err(Error::new_spanned(
            derivative,
            "only an input of type f64 has an input derivative",
        ));
    }
    if let Some((name, _)) = attributes.derivative_by.first()
        && (!is_real || is_array)
    {
        return Err(Error::new_spanned(
            name,
            "only a variable of type f64 has directional derivatives",
        ));
    }
    let is_of_equations =
        attributes.state || matches!(attributes.role, Role::Derivative | Role::EventIndicator);
    if is_of_equations && (!is_real || attributes.discrete) {
        return Err(Error::new_spanned(
            &field.ident,
            "states, derivatives and event indicators are continuous and of type f64",
        ));
    }
    if let Some(nominal) = &attributes.nominal {
        if !attributes.state {
            return Err(Error::new_spanned(
                nominal,
                "only a state has a nominal value",
            ));
        }
        start::check_positive(nominal)?;
    }
    Ok(())
}

/// The type of the elements of an array of any dimension.
pub fn element_type(ty: &Type) -> &Type {
    match ungrouped(ty) {
        Type::Array(array) => element_type(&array.elem),
        ty => ty,
    }
}

/// The type without parentheses, also those invisible that `macro_rules!` adds.
pub fn ungrouped(ty: &Type) -> &Type {
    match ty {
        Type::Group(inner) => ungrouped(&inner.elem),
        Type::Paren(inner) => ungrouped(&inner.elem),
        ty => ty,
    }
}
