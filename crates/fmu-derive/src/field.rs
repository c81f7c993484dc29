//! A field of a struct, with its attribute checked.

use fmu_description::words::is_identifier;
use fmu_description::{LogCategory, Type as FmiType, Unit};
use proc_macro2::{Span, TokenStream};
use quote::ToTokens;
use syn::spanned::Spanned;
use syn::{
    Attribute, Expr, ExprLit, GenericArgument, Ident, Lit, LitStr, Meta, MetaNameValue, Result,
    Type,
};

use crate::attributes::{Options, Role, error, ident_name};
use crate::expression::Expression;

/// A field.
pub struct Field {
    pub ident: Ident,
    pub ty: Type,
    pub role: Role,
    pub options: Options,
    /// The name of a variable, or the prefix of a nested struct.
    pub name: LitStr,
    pub description: String,
    /// What to do instead of using a variable; empty if it is not deprecated.
    pub deprecated: String,
    /// The type of a variable, or of the elements of an array.
    pub of_type: FmiType,
    /// The index of its row in the table; an internal field has the index of the next row.
    pub row: usize,
    /// The path of the traits.
    pub krate: TokenStream,
}

macro_rules! types {
    ($($($name:ident: $type:ty),*);*) => {
        /// The types of Rust that are types of variables, by their names.
        const TYPES: &[(&str, FmiType)] = &[$($((stringify!($type), FmiType::$name),)*)*];
    };
}
fmu_description::types!(types!);

impl Field {
    pub fn new(field: &syn::Field, krate: &TokenStream) -> Result<Self> {
        let (role, options) = Options::of_field(field, is_clock(&field.ty))?;
        let Some(ident) = field.ident.clone() else {
            return error(field, "expected a field with a name");
        };
        let mut found = Self {
            name: ident_name(&ident),
            description: String::new(),
            deprecated: String::new(),
            of_type: FmiType::Boolean,
            row: 0,
            krate: krate.clone(),
            ty: field.ty.clone(),
            ident,
            role,
            options,
        };
        if let (Some(fresh), false) = (found.options.expression("fresh"), role.is_internal()) {
            let what = match role {
                Role::Nested => "a nested struct sets its own fields; expected no `fresh`",
                _ => "only an internal field has a fresh value; that of a variable is `start`",
            };
            return error(fresh, what);
        }
        match role {
            Role::Saved if !found.options.has("with") => {
                let what = "expected a module with the functions `save` and `load`, as in `#[saved(with = module)]`";
                return error(&found.ident, what);
            }
            Role::Log => {
                if let Some(category) = found.options.text("category") {
                    found.name = log_category(category.clone())?;
                    found.description = required_description(&field.attrs, &found.ident)?;
                }
            }
            _ if !role.has_rows() => {}
            Role::Nested if !matches!(found.element_type(), Type::Path(_)) => {
                return error(&field.ty, "expected a struct with #[derive(Variables)]");
            }
            Role::Nested if found.row_count() == 0 => {
                let what =
                    "expected an array of one dimension with a literal length, such as [Motor; 3]";
                return error(&field.ty, what);
            }
            Role::Nested => {
                found.name = found.prefix()?;
                let mut units = found.options.variables().filter_map(|(_, of)| of.text("unit"));
                units.try_for_each(|unit| check_unit(unit).map(|_| ()))?;
            }
            _ => {
                found.name = found.variable_name()?;
                found.description = found.variable_description(&field.attrs)?;
                found.of_type = fmi_type(&field.ty)?;
                found.check_aliases()?;
                found.deprecated = found.deprecated(&field.attrs)?;
                found.check()?;
            }
        }
        Ok(found)
    }

    /// The category of a log, if it has one of its own.
    pub fn log_category(&self) -> Option<&LitStr> {
        self.options.text("category")
    }

    /// Where errors of the field are shown.
    pub fn span(&self) -> Span {
        self.ident.span()
    }

    pub fn is_variable(&self) -> bool {
        self.role != Role::Nested && self.role.has_rows()
    }

    /// Whether it is a clock.
    pub fn is_clock(&self) -> bool {
        self.of_type == FmiType::Clock
    }

    /// Whether it is a variable of this name.
    pub fn is_named(&self, name: &LitStr) -> bool {
        self.is_variable() && self.name.value() == name.value()
    }

    /// Whether it is the structural parameter that is the number of elements in use of an array.
    pub fn is_size_of(&self, array: &Self) -> bool {
        let size = array.options.text("size");
        self.role == Role::StructuralParameter && size.is_some_and(|size| self.is_named(size))
    }

    /// Whether it is an input or a state that is a scalar of type f64, with respect to which derivatives may
    /// be known.
    pub fn is_known(&self) -> bool {
        let is_scalar = self.of_type == FmiType::Float64 && self.dimensions().is_empty();
        is_scalar && (self.role == Role::Input || self.options.has("state"))
    }

    /// Whether the host sets it, so that it has a start value in any case.
    pub fn is_settable(&self) -> bool {
        use Role::{Input, Parameter, StructuralParameter};
        matches!(self.role, Input | Parameter | StructuralParameter)
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

    /// The type of the elements of an array of any dimension, or its own.
    pub fn element_type(&self) -> &Type {
        let mut ty = ungrouped(&self.ty);
        while let Type::Array(array) = ty {
            ty = ungrouped(&array.elem);
        }
        ty
    }

    /// Number of rows in the table: the length of an array of nested structs (0 if it is no literal), otherwise one,
    /// or 0 without a variable.
    pub fn row_count(&self) -> usize {
        match (self.role, &*self.dimensions()) {
            (Role::Nested, [length_of]) => length(length_of).map_or(0, |length| length as usize),
            (Role::Nested, [_, _, ..]) => 0,
            (role, _) => usize::from(role.has_rows()),
        }
    }

    fn prefix(&self) -> Result<LitStr> {
        match (self.options.text("prefix"), self.options.has("flatten")) {
            (Some(prefix), true) => error(prefix, "expected either `prefix` or `flatten`"),
            (Some(prefix), false) => structured(prefix.clone()),
            (None, true) if !self.dimensions().is_empty() => {
                error(&self.ident, "the elements of an array need a prefix; expected no `flatten`")
            }
            (None, true) => Ok(LitStr::new("", self.span())),
            (None, false) => Ok(self.name.clone()),
        }
    }

    /// The name of a variable; a derivative has the name `der(state)`.
    fn variable_name(&self) -> Result<LitStr> {
        if self.role != Role::Derivative {
            let name = self.options.text("name").unwrap_or(&self.name);
            return structured(name.clone());
        }
        let Some(state) = self.options.text("of") else {
            let what = "a derivative needs its state; expected `#[derivative(of = ...)]`";
            return error(&self.ident, what);
        };
        let state = structured(state.clone())?;
        Ok(LitStr::new(&format!("der({})", state.value()), state.span()))
    }

    /// The former names of a variable, which have the form of names.
    fn check_aliases(&self) -> Result<()> {
        for alias in self.options.names("alias") {
            let alias = structured(alias.clone())?;
            if alias.value() == "time" {
                return error(alias, "\"time\" is the independent variable; expected another name");
            }
        }
        Ok(())
    }

    /// What to do instead of using the variable, by its option or by Rust's own attribute.
    fn deprecated(&self, attributes: &[Attribute]) -> Result<String> {
        let mut instead = self.options.text("deprecated").cloned();
        for attribute in attributes.iter().filter(|a| a.path().is_ident("deprecated")) {
            if let Meta::NameValue(MetaNameValue { value, .. }) = &attribute.meta {
                instead = Some(syn::parse2(value.to_token_stream())?);
            }
            if let Meta::List(_) = &attribute.meta {
                attribute.parse_nested_meta(|meta| {
                    let text = meta.value()?.parse()?;
                    instead = if meta.path.is_ident("note") { Some(text) } else { instead.take() };
                    Ok(())
                })?;
            }
            instead.get_or_insert_with(|| LitStr::new("it will be removed", attribute.span()));
        }
        match instead {
            Some(text) if text.value().is_empty() => {
                error(text, "expected what to do instead, such as \"use pid.kp\"")
            }
            instead => Ok(instead.map(|text| text.value()).unwrap_or_default()),
        }
    }

    /// The description, without the unit, which the variable has by itself.
    fn variable_description(&self, attributes: &[Attribute]) -> Result<String> {
        let given = self.options.text("description").map(LitStr::value);
        let unit = self.options.text("unit").map(LitStr::value);
        let unit = unit.map_or(String::new(), |unit| format!(" ({unit})"));
        let comment = || Some(doc_comment(attributes)?.replace(&unit, ""));
        let state = self.options.text("of").map(LitStr::value);
        let of_state = || Some(format!("Derivative of {}", state?));
        require(given.or_else(comment).or_else(of_state), &self.ident)
    }

    /// The unit to display values in; empty if it is the unit of the variable.
    pub fn display_unit(&self) -> String {
        let text = |option| self.options.text(option).map(LitStr::value).unwrap_or_default();
        let (unit, display) = (text("unit"), text("display"));
        match display.is_empty() {
            true => Unit::default_display(&unit).unwrap_or_default(),
            false if display == unit => String::new(),
            false => display,
        }
    }

    /// Checks that the options go with the type and with each other. Their values are checked by the compiler.
    fn check(&self) -> Result<()> {
        let (options, of_type) = (&self.options, self.of_type);
        let dimensions = self.dimensions().len();
        let is_array = dimensions > 0;
        let is_real = of_type == FmiType::Float64;
        let is_state = options.has("state");
        let is_of_equations =
            is_state || matches!(self.role, Role::Derivative | Role::EventIndicator);
        refuse(
            options.text("unit"),
            !of_type.is_float(),
            "only an f64 or f32 has a unit (a type alias is not recognized)",
        )?;
        let unit = options.text("unit").map(check_unit).transpose()?;
        if let Some(display) = options.text("display") {
            check_display(display, options.text("unit").zip(unit))?;
        }
        refuse(
            options.text("mime_type"),
            of_type != FmiType::Binary,
            "only a Vec<u8> has a MIME type",
        )?;
        refuse(
            options.expression("max_size"),
            of_type != FmiType::Binary,
            "only a Vec<u8> has a maximum size",
        )?;
        let network = options.text("network");
        let fits = match network.map(LitStr::value).as_deref() {
            None => true,
            Some("Rx_Data") => (self.role, of_type) == (Role::Input, FmiType::Binary),
            Some("Tx_Data") => (self.role, of_type) == (Role::Output, FmiType::Binary),
            Some("Rx_Clock") => (self.role, of_type) == (Role::Input, FmiType::Clock),
            Some("Tx_Clock") => of_type == FmiType::Clock,
            Some(_) => matches!(self.role, Role::Parameter | Role::StructuralParameter),
        };
        refuse(
            network,
            !fits || is_array,
            "in the terminal of a network, data is a Vec<u8> that comes in or goes out at the ticks of a Clock, and the configuration has parameters",
        )?;
        let is_size = self.role == Role::StructuralParameter;
        refuse(
            Some(&self.ty),
            is_size && (is_array || of_type != FmiType::UInt64),
            "a structural parameter is of type u64",
        )?;
        refuse(
            options.text("size"),
            dimensions != 1 || is_state,
            "only an array of one dimension, and not of states, has a size",
        )?;
        refuse(
            Some(&self.ident),
            self.role == Role::Constant && !options.has("start"),
            "a constant needs a value; expected `#[constant(start = ...)]`",
        )?;
        let is_number = of_type.is_float() || of_type.is_integer();
        let bound = options.expression("min").or(options.expression("max"));
        refuse(bound, !is_number, "only a number has bounds")?;
        refuse(
            options.expression("derivative"),
            !is_real || is_array,
            "only an input of type f64 has an input derivative",
        )?;
        refuse(
            options.derivatives().first().map(|(name, _)| name),
            !is_real || is_array,
            "only a variable of type f64 has directional derivatives",
        )?;
        refuse(
            Some(&self.ident),
            is_of_equations && (!is_real || options.has("discrete")),
            "states, derivatives and event indicators are continuous and of type f64",
        )?;
        let of_equations = options.expression("derivative").is_some()
            || !options.derivatives().is_empty()
            || is_of_equations;
        refuse(
            options.names("clocks").first(),
            of_equations,
            "a variable with clocks changes at their ticks only, and has no part in equations",
        )?;
        let nominal = options.expression("nominal");
        refuse(nominal, !of_type.is_float(), "only an f64 or f32 has a nominal value")
    }
}

/// The length of an array, if it is a literal.
pub fn length(length: &Expr) -> Option<f64> {
    let length = syn::parse2::<Expression>(length.to_token_stream());
    length.ok()?.number()
}

/// Checks an option that is a time or a tolerance, as far as it is a literal.
pub fn check_positive(expression: Option<&Expression>) -> Result<()> {
    let is_positive = |e: &Expression| e.number().is_some_and(|value| value > 0.0);
    let is_mistake = expression.is_some_and(|e| e.is_literal() && !is_positive(e));
    refuse(expression, is_mistake, "expected a positive number")
}

/// An error at a place, if there is the place and a mistake.
pub fn refuse(place: Option<impl ToTokens>, is_mistake: bool, what: &str) -> Result<()> {
    match place {
        Some(place) if is_mistake => error(place, what),
        _ => Ok(()),
    }
}

fn check_unit(unit: &LitStr) -> Result<Unit> {
    let text = unit.value();
    let unknown = match Unit::parse(&text) {
        Ok(unit) => return Ok(unit),
        Err(unknown) => unknown,
    };
    let which = match unknown == format!("{text:?} is not a unit") {
        true => String::new(),
        false => format!(": {unknown}"),
    };
    error(
        unit,
        format!(
            "unknown unit {text:?}{which}; expected a product such as \"N.m\", \"kg.m2\", \"m/s2\" or \"N/(rad.s)\""
        ),
    )
}

/// Checks that values of a variable with a unit can be displayed in another one.
fn check_display(display: &LitStr, unit: Option<(&LitStr, Unit)>) -> Result<()> {
    let shown = check_unit(display)?;
    let Some((name, unit)) = unit else {
        let what = "a display unit needs the unit of the values; expected `unit` as well";
        return error(display, what);
    };
    if unit.conversion_to(&shown).is_some() {
        return Ok(());
    }
    let (display_name, name) = (display.value(), name.value());
    let (dimension, other) = (unit.dimension(), shown.dimension());
    let what = format!(
        "{display_name:?} cannot display a value in {name:?}: its dimension is {other}, not {dimension}"
    );
    error(display, what)
}

/// Whether a type is `Clock`, or an array of it.
fn is_clock(ty: &Type) -> bool {
    match ungrouped(ty) {
        Type::Array(array) => is_clock(&array.elem),
        Type::Path(path) => path.path.segments.last().is_some_and(|last| last.ident == "Clock"),
        _ => false,
    }
}

/// The type of the elements of a variable; a type that is not known is taken for an enumeration, and checked by
/// the compiler.
fn fmi_type(ty: &Type) -> Result<FmiType> {
    if is_clock(ty) {
        return match ungrouped(ty) {
            Type::Array(_) => {
                error(ty, "FMI has no arrays of clocks; expected a field for each Clock")
            }
            _ => Ok(FmiType::Clock),
        };
    }
    let path = match ungrouped(ty) {
        Type::Array(array) => return fmi_type(&array.elem),
        Type::Path(path) => path.path.segments.last(),
        _ => None,
    };
    if let Some(last) = path {
        let name = last.ident.to_string();
        let without_spaces = |text: &str| text.replace(' ', "");
        let rust = without_spaces(&last.to_token_stream().to_string());
        let is_generic = match &last.arguments {
            syn::PathArguments::None => false,
            syn::PathArguments::AngleBracketed(list) => {
                (list.args.iter()).any(|a| matches!(a, GenericArgument::Type(_)))
            }
            syn::PathArguments::Parenthesized(_) => true,
        };
        let others = ["i128", "isize", "u128", "usize", "char", "str"];
        match TYPES.iter().find(|(name, _)| without_spaces(name) == rust) {
            Some((_, of_type)) => return Ok(*of_type),
            None if !is_generic && !others.contains(&&*name) => return Ok(FmiType::Enumeration),
            None => {}
        }
    }
    error(
        ty,
        "not a type of an FMI variable; expected f64, f32, i8 to i64, u8 to u64, bool, String, Vec<u8>, an enum with #[derive(Choice)], or an array such as [f64; 3]",
    )
}

/// A log category that the exporter does not use.
fn log_category(name: LitStr) -> Result<LitStr> {
    let is_known = |known: LogCategory| known.name().to_bytes() == name.value().as_bytes();
    match LogCategory::of_model(true).any(is_known) {
        true => error(&name, "the exporter uses this category; expected another one"),
        false => structured(name),
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

/// A structured name of FMI: identifiers separated by periods.
fn structured(name: LitStr) -> Result<LitStr> {
    let is_name = name.value().split('.').all(is_identifier);
    named(name, is_name, ", with periods between parts")
}

/// A C identifier.
pub fn identifier(name: LitStr) -> Result<LitStr> {
    let is_name = is_identifier(&name.value());
    named(name, is_name, "")
}

fn named(name: LitStr, is_name: bool, more: &str) -> Result<LitStr> {
    let text = name.value();
    let expected = "expected letters, digits and underscores";
    match is_name {
        true => Ok(name),
        false => error(name, format!("{text:?} is not a name; {expected}{more}")),
    }
}

/// The first paragraph of the doc comments as plain text, without backticks and a final period; `None`
/// if there is none.
fn doc_comment(attributes: &[Attribute]) -> Option<String> {
    let docs = attributes.iter().filter(|a| a.path().is_ident("doc"));
    let texts = docs.filter_map(|attribute| match &attribute.meta {
        Meta::NameValue(meta) => Some(&meta.value),
        _ => None,
    });
    let texts: Vec<String> = texts
        .filter_map(|value| match value {
            Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) => Some(text.value()),
            _ => None,
        })
        .collect();
    let is_empty = |line: &&str| line.trim().is_empty();
    let lines = texts.iter().flat_map(|text| text.split('\n'));
    let words = (lines.skip_while(is_empty).take_while(|line| !is_empty(line)))
        .flat_map(str::split_whitespace)
        .collect::<Vec<_>>();
    let text = words.join(" ").replace('`', "");
    let text = text.strip_suffix('.').unwrap_or(&text);
    (!text.is_empty()).then(|| text.to_owned())
}

/// The description of a type or an item.
pub fn required_description(attributes: &[Attribute], ident: &Ident) -> Result<String> {
    require(doc_comment(attributes), ident)
}

fn require(description: Option<String>, ident: &Ident) -> Result<String> {
    match description.filter(|text| !text.is_empty()) {
        Some(text) => Ok(text),
        None => {
            let what = "has no description; write a doc comment above it";
            error(ident, format!("`{ident}` {what}"))
        }
    }
}
