//! The attributes of structs and fields.

use std::collections::HashSet;

use syn::meta::ParseNestedMeta;
use syn::punctuated::Punctuated;
use syn::{
    Attribute, Error, Expr, Field, Ident, LitStr, Path, Result, Token, parenthesized, parse_quote,
};

/// The attributes of a struct: `#[variables(...)]` and `#[model(...)]`.
pub struct StructAttributes {
    /// Path of the crate with the traits.
    pub krate: Path,
    /// Whether the struct is created with `Default` instead of field by field.
    pub by_default: bool,
    /// Name of the model.
    pub name: Option<LitStr>,
    /// Sample time (s).
    pub sample_time: Option<Expr>,
    /// Stop time of the default experiment (s).
    pub stop_time: Option<Expr>,
    /// Step size of the default experiment (s).
    pub step_size: Option<Expr>,
    /// Relative tolerance of the integrator.
    pub tolerance: Option<Expr>,
}

impl StructAttributes {
    pub fn of(attributes: &[Attribute]) -> Result<Self> {
        let mut found = Self {
            krate: parse_quote!(::fmu_export),
            by_default: false,
            name: None,
            sample_time: None,
            stop_time: None,
            step_size: None,
            tolerance: None,
        };
        for attribute in attributes {
            if attribute.path().is_ident("variables") {
                attribute.parse_nested_meta(|meta| found.read_group(&meta))?;
            } else if attribute.path().is_ident("model") {
                attribute.parse_nested_meta(|meta| found.read_model(&meta))?;
            }
        }
        Ok(found)
    }

    fn read_group(&mut self, meta: &ParseNestedMeta<'_>) -> Result<()> {
        if meta.path.is_ident("crate") {
            self.krate = meta.value()?.parse()?;
        } else if meta.path.is_ident("default") {
            self.by_default = true;
        } else {
            return Err(meta.error("unknown option; expected `crate` or `default`"));
        }
        Ok(())
    }

    fn read_model(&mut self, meta: &ParseNestedMeta<'_>) -> Result<()> {
        if meta.path.is_ident("name") {
            self.name = Some(meta.value()?.parse()?);
        } else if meta.path.is_ident("sample_time") {
            self.sample_time = Some(meta.value()?.parse()?);
        } else if meta.path.is_ident("stop_time") {
            self.stop_time = Some(meta.value()?.parse()?);
        } else if meta.path.is_ident("step_size") {
            self.step_size = Some(meta.value()?.parse()?);
        } else if meta.path.is_ident("tolerance") {
            self.tolerance = Some(meta.value()?.parse()?);
        } else if meta.path.is_ident("crate") {
            self.krate = meta.value()?.parse()?;
        } else {
            return Err(meta.error(
                "unknown option; expected `name`, `sample_time`, `stop_time`, `step_size`, `tolerance` or `crate`",
            ));
        }
        Ok(())
    }
}

/// What a field is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    Input,
    Output,
    Parameter,
    Local,
    Constant,
    Nested,
    /// Not a variable.
    Internal,
}

const ROLES: [(&str, Role); 6] = [
    ("input", Role::Input),
    ("output", Role::Output),
    ("parameter", Role::Parameter),
    ("local", Role::Local),
    ("constant", Role::Constant),
    ("nested", Role::Nested),
];

/// The attribute of a field.
pub struct FieldAttributes {
    pub role: Role,
    pub name: Option<LitStr>,
    pub description: Option<LitStr>,
    pub unit: Option<LitStr>,
    pub start: Option<Expr>,
    pub min: Option<Expr>,
    pub max: Option<Expr>,
    pub tunable: bool,
    pub discrete: bool,
    pub initially_from: Vec<LitStr>,
    /// Where the time derivative of an input is stored.
    pub derivative: Option<Expr>,
    /// Names of inputs, and the derivatives of an output with respect to them.
    pub derivative_by: Vec<(LitStr, Expr)>,
    pub prefix: Option<LitStr>,
    pub flatten: bool,
}

impl FieldAttributes {
    pub fn of(field: &Field) -> Result<Self> {
        let mut found = Self {
            role: Role::Internal,
            name: None,
            description: None,
            unit: None,
            start: None,
            min: None,
            max: None,
            tunable: false,
            discrete: false,
            initially_from: Vec::new(),
            derivative: None,
            derivative_by: Vec::new(),
            prefix: None,
            flatten: false,
        };
        for attribute in &field.attrs {
            let role = ROLES
                .iter()
                .find(|(name, _)| attribute.path().is_ident(name));
            let Some((name, role)) = role else {
                continue;
            };
            if found.role != Role::Internal {
                return Err(Error::new_spanned(
                    attribute,
                    "a field has one role; expected only one of input, output, parameter, local, constant and nested",
                ));
            }
            found.role = *role;
            let mut options = HashSet::new();
            if attribute.meta.require_path_only().is_err() {
                attribute.parse_nested_meta(|meta| {
                    match options.insert(meta.path.get_ident().cloned()) {
                        true => found.read(name, &meta),
                        false => Err(meta.error("this option is given twice")),
                    }
                })?;
            }
        }
        Ok(found)
    }

    fn read(&mut self, role_name: &str, meta: &ParseNestedMeta<'_>) -> Result<()> {
        use Role::{Constant, Input, Local, Nested, Output, Parameter};
        let role = self.role;
        let option = meta.path.get_ident().map(Ident::to_string);
        match (option.as_deref().unwrap_or_default(), role) {
            ("prefix", Nested) => self.prefix = Some(meta.value()?.parse()?),
            ("flatten", Nested) => self.flatten = true,
            (_, Nested) => {
                return Err(meta.error("not an option of `nested`; expected `prefix` or `flatten`"));
            }
            ("name", _) => self.name = Some(meta.value()?.parse()?),
            ("description", _) => self.description = Some(meta.value()?.parse()?),
            ("unit", _) => self.unit = Some(meta.value()?.parse()?),
            ("start", _) => self.start = Some(expression(meta)?),
            ("min", _) => self.min = Some(expression(meta)?),
            ("max", _) => self.max = Some(expression(meta)?),
            ("tunable", Parameter) => self.tunable = true,
            ("discrete", Input | Output | Local) => self.discrete = true,
            ("initially_from", Output) => {
                let list;
                parenthesized!(list in meta.input);
                let names = Punctuated::<LitStr, Token![,]>::parse_terminated(&list)?;
                self.initially_from.extend(names);
            }
            ("derivative", Input) => self.derivative = Some(meta.value()?.parse()?),
            ("derivative_by", Output) => {
                let list;
                parenthesized!(list in meta.input);
                while !list.is_empty() {
                    let name = match list.peek(LitStr) {
                        true => list.parse()?,
                        false => {
                            let name: Ident = list.parse()?;
                            LitStr::new(&name.to_string(), name.span())
                        }
                    };
                    list.parse::<Token![=]>()?;
                    self.derivative_by.push((name, list.parse()?));
                    if !list.is_empty() {
                        list.parse::<Token![,]>()?;
                    }
                }
            }
            _ => {
                let own = match role {
                    Input => ", `discrete`, `derivative`",
                    Output => ", `discrete`, `initially_from`, `derivative_by`",
                    Parameter => ", `tunable`",
                    Local => ", `discrete`",
                    Constant | Nested | Role::Internal => "",
                };
                return Err(meta.error(format!(
                    "not an option of `{role_name}`; expected `name`, `description`, `unit`, `start`, `min`, `max`{own}"
                )));
            }
        }
        Ok(())
    }
}

/// The value of an option, without the invisible parentheses that `macro_rules!` adds.
fn expression(meta: &ParseNestedMeta<'_>) -> Result<Expr> {
    let mut expression = meta.value()?.parse()?;
    while let Expr::Group(group) = expression {
        expression = *group.expr;
    }
    Ok(expression)
}
