//! The attributes of structs and fields.

use std::collections::HashSet;

use fmu_description::words::is_identifier;
use proc_macro2::Span;
use syn::meta::ParseNestedMeta;
use syn::parse::ParseStream;
use syn::punctuated::Punctuated;
use syn::spanned::Spanned;
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
    /// Whether the model is described by equations; where the option is written.
    pub continuous: Option<Span>,
    /// Function that takes a step of a model with equations.
    pub step: Option<Path>,
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
            continuous: None,
            step: None,
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
        } else if meta.path.is_ident("continuous") {
            self.continuous = Some(meta.path.span());
        } else if meta.path.is_ident("step") {
            self.step = Some(meta.value()?.parse()?);
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
                "unknown option; expected `name`, `sample_time`, `continuous`, `step`, `stop_time`, `step_size`, `tolerance` or `crate`",
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
    StructuralParameter,
    Local,
    Constant,
    /// The time derivative of a state.
    Derivative,
    EventIndicator,
    Nested,
    /// Not a variable.
    Internal,
}

const ROLES: [(&str, Role); 9] = [
    ("input", Role::Input),
    ("output", Role::Output),
    ("parameter", Role::Parameter),
    ("structural_parameter", Role::StructuralParameter),
    ("local", Role::Local),
    ("constant", Role::Constant),
    ("derivative", Role::Derivative),
    ("event_indicator", Role::EventIndicator),
    ("nested", Role::Nested),
];

/// The attribute of a field.
pub struct FieldAttributes {
    pub role: Role,
    pub name: Option<LitStr>,
    pub description: Option<LitStr>,
    pub unit: Option<LitStr>,
    /// MIME type of a binary.
    pub mime_type: Option<LitStr>,
    pub start: Option<Expr>,
    pub min: Option<Expr>,
    pub max: Option<Expr>,
    /// Name of the structural parameter that is the number of elements in use.
    pub size: Option<LitStr>,
    pub tunable: bool,
    pub discrete: bool,
    /// Whether it is a continuous state.
    pub state: bool,
    /// Nominal value of a state.
    pub nominal: Option<Expr>,
    /// Name of the state of which it is the derivative.
    pub of: Option<LitStr>,
    pub initially_from: Vec<LitStr>,
    /// Where the time derivative of an input is stored.
    pub derivative: Option<Expr>,
    /// Names of inputs, and the derivatives of an output with respect to them.
    pub derivative_by: Vec<(LitStr, Expr)>,
    /// Its terminal and its name there.
    pub terminal: Option<LitStr>,
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
            mime_type: None,
            start: None,
            min: None,
            max: None,
            size: None,
            tunable: false,
            discrete: false,
            state: false,
            nominal: None,
            of: None,
            initially_from: Vec::new(),
            derivative: None,
            derivative_by: Vec::new(),
            terminal: None,
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
                    "a field has one role; expected only one of input, output, parameter, structural_parameter, local, constant, derivative, event_indicator and nested",
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
        use Role::{
            Constant, Derivative, EventIndicator, Input, Local, Nested, Output, Parameter,
            StructuralParameter,
        };
        let role = self.role;
        let option = meta.path.get_ident().map(Ident::to_string);
        match (option.as_deref().unwrap_or_default(), role) {
            ("prefix", Nested) => self.prefix = Some(meta.value()?.parse()?),
            ("flatten", Nested) => self.flatten = true,
            (_, Nested) => {
                return Err(meta.error("not an option of `nested`; expected `prefix` or `flatten`"));
            }
            ("of", Derivative) => self.of = Some(name(meta.value()?)?),
            ("name" | "start" | "min" | "max", Derivative) => {
                return Err(meta.error(
                    "not an option of `derivative`; expected `of`, `description`, `unit` or `derivative_by`",
                ));
            }
            ("name", _) => self.name = Some(meta.value()?.parse()?),
            ("description", _) => self.description = Some(meta.value()?.parse()?),
            ("unit", _) => self.unit = Some(meta.value()?.parse()?),
            ("mime_type", _) => self.mime_type = Some(meta.value()?.parse()?),
            ("start", _) => self.start = Some(expression(meta)?),
            ("min", _) => self.min = Some(expression(meta)?),
            ("max", _) => self.max = Some(expression(meta)?),
            ("size", Input | Output | Parameter | Local | Constant) => {
                self.size = Some(name(meta.value()?)?);
            }
            ("tunable", Parameter | StructuralParameter) => self.tunable = true,
            ("discrete", Input | Output | Local) => self.discrete = true,
            ("state", Output | Local) => self.state = true,
            ("nominal", Output | Local) => self.nominal = Some(expression(meta)?),
            ("initially_from", Output | Local) => {
                let list;
                parenthesized!(list in meta.input);
                let names = Punctuated::<LitStr, Token![,]>::parse_terminated(&list)?;
                self.initially_from.extend(names);
            }
            ("terminal", Input | Output) => self.terminal = Some(terminal(meta.value()?)?),
            ("derivative", Input) => self.derivative = Some(meta.value()?.parse()?),
            ("derivative_by", Output | Derivative | EventIndicator) => {
                let list;
                parenthesized!(list in meta.input);
                while !list.is_empty() {
                    let name = name(&list)?;
                    list.parse::<Token![=]>()?;
                    self.derivative_by.push((name, list.parse()?));
                    if !list.is_empty() {
                        list.parse::<Token![,]>()?;
                    }
                }
            }
            _ => {
                let own = match role {
                    Input => ", `discrete`, `derivative`, `terminal`",
                    Output => {
                        ", `discrete`, `state`, `nominal`, `initially_from`, `derivative_by`, `terminal`"
                    }
                    Parameter | StructuralParameter => ", `tunable`",
                    Local => ", `discrete`, `state`, `nominal`, `initially_from`",
                    Derivative | EventIndicator => ", `derivative_by`",
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

/// A name in quotes, or without if it is an identifier.
fn name(input: ParseStream<'_>) -> Result<LitStr> {
    if input.peek(LitStr) {
        return input.parse();
    }
    let name: Ident = input.parse()?;
    Ok(LitStr::new(&name.to_string(), name.span()))
}

/// The name of a terminal and of a member, separated by a period.
fn terminal(input: ParseStream<'_>) -> Result<LitStr> {
    let names: LitStr = input.parse()?;
    let text = names.value();
    let parts = text.split_once('.');
    if parts.is_some_and(|(terminal, member)| is_identifier(terminal) && is_identifier(member)) {
        return Ok(names);
    }
    Err(Error::new(
        names.span(),
        format!("{text:?} is not the name of a terminal and of a member, such as \"loop.u\""),
    ))
}

/// The value of an option, without the invisible parentheses that `macro_rules!` adds.
fn expression(meta: &ParseNestedMeta<'_>) -> Result<Expr> {
    let mut expression = meta.value()?.parse()?;
    while let Expr::Group(group) = expression {
        expression = *group.expr;
    }
    Ok(expression)
}
