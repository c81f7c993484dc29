//! A field of a struct, with its attribute checked.

use fmu_description::Unit;
use proc_macro2::Span;
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
    Real,
    Integer,
    Boolean,
    String,
    Choice(Box<Type>),
}

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
    let name = attributes
        .name
        .clone()
        .unwrap_or_else(|| LitStr::new(&plain(ident), ident.span()));
    names::check(&name)?;
    let description = match &attributes.description {
        Some(text) => Some(text.value()),
        None => names::description(&field.attrs).map(|text| without_unit(&text, attributes)),
    };
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
            "not a type of an FMI variable; expected f64, i32, bool, String, an enum with #[derive(Choice)], or an array such as [f64; 3]",
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
            match last.ident.to_string().as_str() {
                "f64" => Ok(Kind::Real),
                "i32" => Ok(Kind::Integer),
                "bool" => Ok(Kind::Boolean),
                "String" => Ok(Kind::String),
                "f32" | "i8" | "i16" | "i64" | "i128" | "isize" | "u8" | "u16" | "u32" | "u64"
                | "u128" | "usize" | "char" | "str" => Err(unsupported()),
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
        if !is_real {
            return Err(Error::new_spanned(
                unit,
                "only an f64 has a unit (a type alias is not recognized)",
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
            "only an output of type f64 has directional derivatives",
        ));
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
