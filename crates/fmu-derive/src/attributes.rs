//! The attributes of structs, enums and fields: which options they have, and how these are written.

use std::fmt::Display;

use fmu_description::words::is_identifier;
use fmu_description::{IntervalVariability, Naming};
use proc_macro2::{Span, TokenStream};
use quote::{ToTokens, quote};
use syn::meta::ParseNestedMeta;
use syn::parse::ParseStream;
use syn::punctuated::Punctuated;
use syn::spanned::Spanned;
use syn::{Attribute, Error, Ident, LitStr, Path, Result, Token, parenthesized, token};

use crate::expression::Expression;

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
    /// The log of the model.
    Log,
    /// Not a variable, and not part of the state that a host saves.
    Unsaved,
    /// Not a variable, and not part of serialized states.
    Copied,
    /// Not a variable, and saved by functions of the author.
    Saved,
    /// Not a variable.
    Internal,
}

use Role::{
    Constant, Derivative, EventIndicator, Input, Local, Log, Nested, Output, Parameter, Saved,
    StructuralParameter,
};

impl Role {
    /// Whether the field is in the table.
    pub fn has_rows(self) -> bool {
        !self.is_internal() && self != Self::Log
    }

    /// Whether it is no variable, and no log.
    pub fn is_internal(self) -> bool {
        matches!(self, Self::Unsaved | Self::Copied | Self::Saved | Self::Internal)
    }

    /// Whether it is part of the state that a host saves.
    pub fn is_saved(self) -> bool {
        !matches!(self, Self::Log | Self::Unsaved)
    }

    /// Whether it is part of the state that a host serializes.
    pub fn is_serialized(self) -> bool {
        self.is_saved() && self != Self::Copied
    }
}

const ROLES: [(&str, Role); 13] = [
    ("input", Input),
    ("output", Output),
    ("parameter", Parameter),
    ("structural_parameter", StructuralParameter),
    ("local", Local),
    ("constant", Constant),
    ("derivative", Derivative),
    ("event_indicator", EventIndicator),
    ("nested", Nested),
    ("log", Log),
    ("saved", Saved),
    ("copied", Role::Copied),
    ("unsaved", Role::Unsaved),
];
/// The attribute with the value of an internal field in a new struct.
const FRESH: &str = "fresh";

/// An option: its name, and the function that reads its value.
type KnownOption = (&'static str, fn(&ParseNestedMeta<'_>) -> Result<OptionValue>);

/// The value of an option.
pub enum OptionValue {
    Flag,
    Text(LitStr),
    Expression(Expression),
    Names(Vec<LitStr>),
    Derivatives(Vec<(LitStr, Expression)>),
    Rates(Vec<(Ident, Expression)>),
    /// What a variable of a nested struct has instead.
    Variable(LitStr, Options),
}

/// The options of `#[model(...)]`, `#[variables(...)]` and `#[choice(...)]`.
pub const MODEL: (&str, &[KnownOption]) = (
    "model",
    &[
        ("name", text),
        ("sample_time", expression),
        ("rates", rates),
        ("continuous", flag),
        ("clocked", flag),
        ("bus_simulation", flag),
        ("single_instance", flag),
        ("step", expression),
        ("solver", solver),
        ("stop_time", expression),
        ("step_size", expression),
        ("tolerance", expression),
        ("naming", naming),
        ("crate", expression),
    ],
);
pub const VARIABLES: (&str, &[KnownOption]) =
    ("variables", &[("crate", expression), ("default", flag)]);
pub const CHOICE: (&str, &[KnownOption]) = ("choice", &[("name", text), ("crate", expression)]);

/// The options of a variable in `#[nested(kp(start = 300))]`.
const CHANGES: &[KnownOption] =
    &[("unit", text), ("min", expression), ("max", expression), ("start", expression)];

/// The options of fields, and the roles that have them.
const FIELD_OPTIONS: &[(KnownOption, &[Role])] = &[
    (("of", name), &[Derivative]),
    (("name", text), NAMED),
    (("description", text), DESCRIBED),
    (("alias", name_or_names), NAMED),
    (("deprecated", text), DESCRIBED),
    (("unit", text), DESCRIBED),
    (("display", text), DESCRIBED),
    (("start", expression), NAMED),
    (("min", expression), NAMED),
    (("max", expression), NAMED),
    (("mime_type", text), NAMED),
    (("max_size", expression), NAMED),
    (("clocks", clocks), &[Input, Output, Local]),
    (("size", name), &[Input, Output, Parameter, Local, Constant]),
    (("tunable", flag), &[Parameter, StructuralParameter]),
    (("discrete", flag), &[Input, Output, Local]),
    (("state", flag), &[Output, Local]),
    (("nominal", expression), &[Input, Output, Local]),
    (("initially_from", names), &[Output, Local]),
    (("derivative", expression), &[Input]),
    (("derivative_by", derivatives), EQUATIONS),
    (("terminal", terminal), &[Input, Output]),
    (("network", network), &[Input, Output, Parameter, StructuralParameter]),
    (("reference", expression), ANY_ROW),
    (("references", references), &[Nested]),
    (("prefix", text), &[Nested]),
    (("flatten", flag), &[Nested]),
    (("with", path), &[Saved]),
    (("category", text), &[Log]),
];
/// The options of fields of the type `Clock`, and the roles that have them.
const CLOCK_OPTIONS: &[(KnownOption, &[Role])] = &[
    (("triggered", flag), &[Input, Output]),
    (("constant", flag), &[Input]),
    (("fixed", flag), &[Input]),
    (("calculated", flag), &[Input]),
    (("tunable", flag), &[Input]),
    (("changing", flag), &[Input]),
    (("countdown", flag), &[Input]),
    (("interval", expression), &[Input]),
    (("shift", expression), &[Input]),
    (("resolution", expression), &[Input]),
    (("priority", expression), &[Input]),
    (("clocks", clocks), &[Input, Output]),
    (("name", text), &[Input, Output]),
    (("description", text), &[Input, Output]),
    (("alias", name_or_names), &[Input, Output]),
    (("deprecated", text), &[Input, Output]),
    (("terminal", terminal), &[Input, Output]),
    (("network", network), &[Input, Output]),
    (("reference", expression), &[Input, Output]),
];
const ANY_ROW: &[Role] = &[
    Nested,
    Derivative,
    Input,
    Output,
    Parameter,
    StructuralParameter,
    Local,
    Constant,
    EventIndicator,
];
const DESCRIBED: &[Role] = ANY_ROW.split_at(1).1;
/// The name of a derivative follows from the name of its state.
const NAMED: &[Role] = DESCRIBED.split_at(1).1;
const EQUATIONS: &[Role] = &[Output, Derivative, EventIndicator];
/// Options for a few variables only, which messages do not list.
const RARE: [&str; 10] = [
    "alias",
    "clocks",
    "deprecated",
    "display",
    "max_size",
    "mime_type",
    "network",
    "reference",
    "references",
    "size",
];

/// The options that are given: name, place and value.
#[derive(Default)]
pub struct Options(Vec<(&'static str, Span, OptionValue)>);

impl Options {
    /// The options of a struct, an enum or a variant.
    pub fn from_attributes(
        attributes: &[Attribute],
        (name, known): (&str, &[KnownOption]),
    ) -> Result<Self> {
        let names: Vec<_> = known.iter().map(|(name, _)| *name).collect();
        let unknown = |option: &Path| match similar(option, &names) {
            Some(similar) => format!("unknown option; did you mean `{similar}`?"),
            None => format!("unknown option; expected {}", either(&names)),
        };
        let mut options = Self::default();
        for attribute in attributes.iter().filter(|a| a.path().is_ident(name)) {
            attribute.parse_nested_meta(|meta| options.read(&meta, known, &unknown))?;
        }
        Ok(options)
    }

    /// The role of a field, and its options; those of a clock are others.
    pub fn of_field(field: &syn::Field, is_clock: bool) -> Result<(Role, Self)> {
        let (mut found, mut options) = (Role::Internal, Self::default());
        for attribute in &field.attrs {
            let mut roles = ROLES.iter();
            if attribute.path().is_ident(FRESH) {
                let value = attribute.parse_args().map_err(|_| {
                    let what = "expected an expression, as in `#[fresh(Filter::new(0.1))]`";
                    Error::new_spanned(attribute, what)
                })?;
                options.0.push((FRESH, attribute.span(), OptionValue::Expression(value)));
                continue;
            }
            let Some((name, role)) = roles.find(|(name, _)| attribute.path().is_ident(name)) else {
                continue;
            };
            if found != Role::Internal {
                return error(
                    attribute,
                    "a field has one role; expected only one of input, output, parameter, structural_parameter, local, constant, derivative, event_indicator, nested, log, saved, copied and unsaved",
                );
            }
            found = *role;
            if is_clock && role.has_rows() && !matches!(role, Input | Output) {
                return error(attribute, "a Clock is an input or an output");
            }
            if attribute.meta.require_path_only().is_ok() {
                continue;
            }
            let all = if is_clock { CLOCK_OPTIONS } else { FIELD_OPTIONS };
            let of_role = all.iter().filter(|(_, roles)| roles.contains(role));
            let known: Vec<KnownOption> = of_role.map(|(known, _)| *known).collect();
            let names: Vec<_> = known.iter().map(|(name, _)| *name).collect();
            let unknown = |option: &Path| {
                let is_of_clock =
                    |((name, _), _): &(KnownOption, _)| !is_clock && option.is_ident(name);
                let is_of_others = |((name, _), _): &(KnownOption, _)| option.is_ident(name);
                let expected = match similar(option, &names) {
                    Some(similar) => format!("did you mean `{similar}`?"),
                    None if CLOCK_OPTIONS.iter().any(is_of_clock)
                        && !FIELD_OPTIONS.iter().any(is_of_others) =>
                    {
                        "only an input of the type Clock has it".to_owned()
                    }
                    None if names.is_empty() => format!("expected `#[{name}]` alone"),
                    None => format!("expected {}", frequent(&names)),
                };
                let what = if is_clock { " of the type Clock" } else { "" };
                format!("not an option of `{name}`{what}; {expected}")
            };
            attribute.parse_nested_meta(|meta| {
                let is_option = names.iter().any(|name| meta.path.is_ident(name));
                match found {
                    Nested if !is_option && meta.input.peek(token::Paren) => {
                        options.read_variable(&meta)
                    }
                    _ => options.read(&meta, &known, &unknown),
                }
            })?;
        }
        Ok((found, options))
    }

    /// Reads `kp(start = 300)`.
    fn read_variable(&mut self, meta: &ParseNestedMeta<'_>) -> Result<()> {
        let mut options = Self::default();
        let name = ident_name(meta.path.require_ident()?);
        let names: Vec<_> = CHANGES.iter().map(|(name, _)| *name).collect();
        let unknown = |_: &Path| format!("unknown option; expected {}", either(&names));
        meta.parse_nested_meta(|meta| options.read(&meta, CHANGES, &unknown))?;
        self.0.push(("", meta.path.span(), OptionValue::Variable(name, options)));
        Ok(())
    }

    fn read(
        &mut self,
        meta: &ParseNestedMeta<'_>,
        known: &[KnownOption],
        unknown: &dyn Fn(&Path) -> String,
    ) -> Result<()> {
        let found = known.iter().find(|(name, _)| meta.path.is_ident(name));
        let (name, value) = found.ok_or_else(|| meta.error(unknown(&meta.path)))?;
        if self.has(name) {
            return Err(meta.error("this option is given twice"));
        }
        self.0.push((name, meta.path.span(), value(meta)?));
        Ok(())
    }

    fn given(&self, option: &str) -> Option<&(&'static str, Span, OptionValue)> {
        self.0.iter().find(|(name, ..)| *name == option)
    }

    /// Where an option is given.
    pub fn span(&self, option: &str) -> Option<Span> {
        self.given(option).map(|(_, place, _)| *place)
    }

    pub fn has(&self, option: &str) -> bool {
        self.given(option).is_some()
    }

    pub fn text(&self, option: &str) -> Option<&LitStr> {
        match self.given(option) {
            Some((.., OptionValue::Text(text))) => Some(text),
            _ => None,
        }
    }

    pub fn expression(&self, option: &str) -> Option<&Expression> {
        match self.given(option) {
            Some((.., OptionValue::Expression(expression))) => Some(expression),
            _ => None,
        }
    }

    pub fn names(&self, option: &str) -> &[LitStr] {
        match self.given(option) {
            Some((.., OptionValue::Names(names))) => names,
            _ => &[],
        }
    }

    /// The kinds of a clock that are given, and their places.
    pub fn kinds(&self) -> impl Iterator<Item = (IntervalVariability, Span)> {
        self.0
            .iter()
            .filter_map(|(name, place, _)| Some((IntervalVariability::parse(name)?, *place)))
    }

    pub fn derivatives(&self) -> &[(LitStr, Expression)] {
        match self.given("derivative_by") {
            Some((.., OptionValue::Derivatives(derivatives))) => derivatives,
            _ => &[],
        }
    }

    /// The names of methods, and their sample times.
    pub fn rates(&self) -> &[(Ident, Expression)] {
        match self.given("rates") {
            Some((.., OptionValue::Rates(rates))) => rates,
            _ => &[],
        }
    }

    /// The value references of variables in a nested struct.
    pub fn references(&self) -> &[(LitStr, Expression)] {
        match self.given("references") {
            Some((.., OptionValue::Derivatives(references))) => references,
            _ => &[],
        }
    }

    /// The variables of a nested struct that have other options.
    pub fn variables(&self) -> impl Iterator<Item = (&LitStr, &Self)> {
        self.0.iter().filter_map(|(.., value)| match value {
            OptionValue::Variable(name, options) => Some((name, options)),
            _ => None,
        })
    }

    /// The path of the crate with the traits.
    pub fn krate(&self) -> TokenStream {
        let path = self.expression("crate").map(ToTokens::to_token_stream);
        path.unwrap_or_else(|| quote!(::fmu_export))
    }
}

fn flag(_: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    Ok(OptionValue::Flag)
}

fn text(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    Ok(OptionValue::Text(meta.value()?.parse()?))
}

fn expression(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    Ok(OptionValue::Expression(meta.value()?.parse()?))
}

/// A path, which may be in quotes.
fn path(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    let value = meta.value()?;
    let path: Path = match value.peek(LitStr) {
        true => value.parse::<LitStr>()?.parse(),
        false => value.parse(),
    }
    .map_err(|error| Error::new(error.span(), "expected the path of a module"))?;
    Ok(OptionValue::Expression(syn::parse2(path.to_token_stream())?))
}

fn name(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    Ok(OptionValue::Text(quoted_or_not(meta.value()?)?))
}

/// A naming convention.
fn naming(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    let name: LitStr = meta.value()?.parse()?;
    match Naming::parse(&name.value()) {
        Some(_) => Ok(OptionValue::Text(name)),
        None => {
            let what = format!("{:?} is no naming convention", name.value());
            error(name, format!("{what}; expected \"flat\" or \"structured\""))
        }
    }
}

/// The method by which equations are integrated.
fn solver(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    let name: LitStr = meta.value()?.parse()?;
    match &*name.value() {
        "explicit" | "implicit" => Ok(OptionValue::Text(name)),
        other => {
            let what = format!("{other:?} is no solver; expected \"explicit\" or \"implicit\"");
            error(name, what)
        }
    }
}

/// The name of a terminal and of a member, separated by a period.
fn terminal(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    let names: LitStr = meta.value()?.parse()?;
    let text = names.value();
    let is_name = |(terminal, member)| is_identifier(terminal) && is_identifier(member);
    match text.split_once('.').is_some_and(is_name) {
        true => Ok(OptionValue::Text(names)),
        false => error(
            names,
            format!("{text:?} is not the name of a terminal and of a member, such as \"loop.u\""),
        ),
    }
}

/// The name of a member of the terminal of a network, or of its configuration.
fn network(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    let member: LitStr = meta.value()?.parse()?;
    let text = member.value();
    let is_parameter = text.strip_prefix("Configuration.").is_some_and(is_identifier);
    match is_parameter || ["Rx_Data", "Rx_Clock", "Tx_Data", "Tx_Clock"].contains(&&*text) {
        true => Ok(OptionValue::Text(member)),
        false => error(
            member,
            format!(
                "{text:?} is no member of the terminal of a network; expected \"Rx_Data\", \"Rx_Clock\", \"Tx_Data\", \"Tx_Clock\", or a parameter such as \"Configuration.BusNotifications\""
            ),
        ),
    }
}

/// `("name", "name")`
fn names(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    let list;
    parenthesized!(list in meta.input);
    let names = Punctuated::<LitStr, Token![,]>::parse_terminated(&list)?;
    Ok(OptionValue::Names(names.into_iter().collect()))
}

/// `(name, name)`, with or without quotes
fn clocks(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    const EXPECTED: &str = "expected the clocks of the variable, which are fields of this struct, such as `clocks(sample)`";
    if !meta.input.peek(token::Paren) {
        return Err(meta.error(EXPECTED));
    }
    let list;
    parenthesized!(list in meta.input);
    let names = Vec::from_iter(list.parse_terminated(quoted_or_not, Token![,])?);
    match names.is_empty() {
        true => Err(meta.error(EXPECTED)),
        false => Ok(OptionValue::Names(names)),
    }
}

/// `= "name"` or `("name", "name")`
fn name_or_names(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    match meta.input.peek(Token![=]) {
        true => Ok(OptionValue::Names(vec![meta.value()?.parse()?])),
        false => names(meta),
    }
}

/// `(name = expression, name = expression)`
fn derivatives(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    let list;
    parenthesized!(list in meta.input);
    let one = |input: ParseStream<'_>| {
        let name = quoted_or_not(input)?;
        input.parse::<Token![=]>()?;
        Ok((name, input.parse()?))
    };
    if list.is_empty() {
        let what =
            "expected an input or a state; the derivative is 0.0 if nothing has an influence";
        return Err(list.error(what));
    }
    let all = list.parse_terminated(one, Token![,])?;
    Ok(OptionValue::Derivatives(all.into_iter().collect()))
}

/// `(name = expression, "name.name" = expression)`
fn references(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    match meta.input.peek(syn::token::Paren) {
        true => derivatives(meta),
        false => {
            let what = "expected variables of the struct with their value references, such as `references(kp = 12)`; `reference = 12` numbers all";
            Err(meta.error(what))
        }
    }
}

/// `(method = expression, method = expression)`
fn rates(meta: &ParseNestedMeta<'_>) -> Result<OptionValue> {
    const EXPECTED: &str = "expected a method and its sample time for each rate, such as `rates(slow = 0.1, fast = 0.001)`";
    if !meta.input.peek(token::Paren) {
        return Err(meta.error(EXPECTED));
    }
    let list;
    parenthesized!(list in meta.input);
    let one = |input: ParseStream<'_>| {
        let name: Ident = input.parse()?;
        input.parse::<Token![=]>()?;
        Ok((name, input.parse::<Expression>()?))
    };
    let all = Vec::from_iter(list.parse_terminated(one, Token![,])?);
    if all.is_empty() {
        return Err(meta.error(EXPECTED));
    }
    for (i, (name, _)) in all.iter().enumerate() {
        if all[..i].iter().any(|(other, _)| other == name) {
            return error(name, format!("two rates have the name `{name}`"));
        }
    }
    Ok(OptionValue::Rates(all))
}

/// A name in quotes, or without if it is an identifier.
fn quoted_or_not(input: ParseStream<'_>) -> Result<LitStr> {
    if input.peek(LitStr) {
        return input.parse();
    }
    Ok(ident_name(&input.parse()?))
}

/// An identifier as a name, without `r#`.
pub fn ident_name(ident: &Ident) -> LitStr {
    let name = ident.to_string();
    LitStr::new(name.strip_prefix("r#").unwrap_or(&name), ident.span())
}

fn quoted(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| format!("`{name}`")).collect()
}

/// The options in a sentence, without those for a few types.
fn frequent(names: &[&str]) -> String {
    let names: Vec<_> = names.iter().copied().filter(|name| !RARE.contains(name)).collect();
    match names.len() {
        0..=2 => either(&names),
        _ => quoted(&names).join(", "),
    }
}

/// The name that was probably meant.
fn similar<'a>(written: &Path, names: &[&'a str]) -> Option<&'a str> {
    const MIN_SIMILARITY: f64 = 0.7;
    let written = written.get_ident()?.to_string();
    let scores =
        names.iter().map(|name| (strsim::normalized_damerau_levenshtein(&written, name), *name));
    let best = scores.max_by(|(one, _), (other, _)| one.total_cmp(other))?;
    (best.0 >= MIN_SIMILARITY).then_some(best.1)
}

/// Names in a sentence: `a`, `b` or `c`.
fn either(names: &[&str]) -> String {
    match quoted(names).split_last() {
        Some((last, others)) if !others.is_empty() => format!("{} or {last}", others.join(", ")),
        _ => quoted(names).concat(),
    }
}

/// All results, or the mistakes in all of them.
pub fn all_or_errors<T>(results: impl IntoIterator<Item = Result<T>>) -> Result<Vec<T>> {
    let (mut all, mut errors) = (Vec::new(), None::<Error>);
    for result in results {
        match (result, &mut errors) {
            (Ok(one), _) => all.push(one),
            (Err(error), Some(errors)) => errors.combine(error),
            (Err(error), none) => *none = Some(error),
        }
    }
    errors.map_or(Ok(all), Err)
}

/// An error at a place.
pub fn error<T>(place: impl ToTokens, text: impl Display) -> Result<T> {
    Err(Error::new_spanned(place, text))
}
