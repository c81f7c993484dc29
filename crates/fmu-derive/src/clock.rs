//! Fields of the type `Clock`: their kinds and options, and which models have them.

use fmu_description::IntervalVariability::{self, Calculated, Constant, Fixed, Triggered, Tunable};
use proc_macro2::TokenStream;
use quote::{format_ident, quote};
use syn::spanned::Spanned;
use syn::{DeriveInput, Error, Result};

use crate::attributes::{Options, Role, error};
use crate::expression::{Expression, respan};
use crate::field::{Field, check_positive, refuse};

/// The options that only some kinds of clocks have, and which these are.
const TIMES: [&str; 3] = ["interval", "shift", "resolution"];

/// The kind of a clock.
fn kind(options: &Options) -> IntervalVariability {
    options.kinds().next().map(|(kind, _)| kind).unwrap_or_default()
}

/// An option of a clock, if the compiler knows its value, as the field does not say otherwise.
fn constant<'a>(options: &'a Options, name: &str) -> Option<&'a Expression> {
    options.expression(name).filter(|expression| !expression.uses_self())
}

/// Checks that the options of a clock go with its kind.
pub fn check(field: &Field) -> Result<()> {
    if !field.is_clock() {
        return Ok(());
    }
    let options = &field.options;
    if let Some((_, place)) = options.kinds().nth(1) {
        return Err(Error::new(
            place,
            "a clock is of one kind; expected only one of triggered, constant, fixed, calculated, tunable, changing and countdown",
        ));
    }
    let kind = kind(options);
    let name = kind.as_str();
    for option in TIMES {
        let given = options.expression(option);
        let what = match kind {
            Triggered => format!(
                "a triggered clock ticks when its source does; expected a kind that has `{option}`: constant, fixed, calculated or tunable"
            ),
            _ => format!(
                "a {name} clock has no `{option}`; expected `Clock::after(...)` to be assigned to it"
            ),
        };
        refuse(given, !kind.is_periodic(), &what)?;
    }
    let interval = options.expression("interval");
    if kind.is_periodic() && interval.is_none() {
        let what = format!(
            "a {name} clock needs the time between its ticks; expected `interval = ...` (s)"
        );
        return error(&field.ident, what);
    }
    check_positive(interval)?;
    for option in TIMES {
        let uses_self = options.expression(option).filter(|expression| expression.uses_self());
        let what = match kind {
            Constant | Fixed => format!(
                "`{option}` of a {name} clock is a constant; expected the kind `calculated`, if the model calculates it"
            ),
            _ => "the resolution of a clock is a constant".to_owned(),
        };
        let is_known = matches!(kind, Constant | Fixed) || option == "resolution";
        refuse(uses_self, is_known, &what)?;
    }
    let shift = options.expression("shift").filter(|shift| shift.uses_self());
    refuse(
        shift,
        kind == Tunable && constant(options, "interval").is_some(),
        "the shift is a constant, as the interval is; expected an interval that the model calculates, too",
    )
}

/// Checks that the clocks of a variable are clocks of its struct.
pub fn check_clocks(field: &Field, fields: &[Field]) -> Result<()> {
    for name in field.options.names("clocks") {
        let is_clock = |other: &&Field| other.is_clock() && other.is_named(name);
        match fields.iter().find(is_clock) {
            None => {
                let what = format!("there is no Clock {:?} in this struct", name.value());
                return error(name, what);
            }
            Some(clock) if clock.ident == field.ident => {
                return error(
                    name,
                    "a clock does not tick at its own ticks; expected another Clock",
                );
            }
            Some(_) => {}
        }
    }
    Ok(())
}

/// Checks that a model with clocks acts at their ticks.
pub fn check_model(options: &Options, fields: &[Field]) -> Result<()> {
    if let Some(place) = options.span("clocked") {
        for (option, what) in [
            (
                "continuous",
                "a continuous model handles ticks as events, in `event`; expected no `clocked`",
            ),
            (
                "sample_time",
                "a clocked model acts at the ticks of its clocks; expected no `sample_time`",
            ),
            ("rates", "a clocked model acts at the ticks of its clocks; expected no `rates`"),
        ] {
            if options.has(option) {
                return Err(Error::new(place, what));
            }
        }
        return Ok(());
    }
    let is_sampled = options.has("sample_time") || options.has("rates");
    match fields.iter().find(|field| field.is_clock()) {
        Some(clock) if is_sampled => error(
            &clock.ident,
            "a model with a sample time has no clocks; expected `#[model(clocked)]` instead, and a Clock with an `interval`",
        ),
        Some(clock) if !options.has("continuous") => error(
            &clock.ident,
            "no function is called at ticks; expected `#[model(clocked)]` with `impl Clocked`, or `#[model(continuous)]`",
        ),
        _ => Ok(()),
    }
}

/// The checks of the clocks in nested structs, which the compiler makes.
pub fn model_checks(input: &DeriveInput, options: &Options, fields: &[Field]) -> TokenStream {
    if !input.generics.params.is_empty() {
        return TokenStream::new();
    }
    let (ident, krate) = (&input.ident, options.krate());
    if let Some(place) = options.span("clocked") {
        let what =
            "a clocked model needs a Clock; expected a field such as `#[input] received: Clock`";
        let rows = quote!(<#ident as #krate::derive::Variables>::ROWS);
        return respan(place, quote!(const _: () = #krate::derive::has_clocks(#rows, #what);));
    }
    if options.has("continuous") {
        return TokenStream::new();
    }
    let checks = fields.iter().filter(|field| field.role == Role::Nested).map(|field| {
        let (ty, what) = (field.element_type(), "the nested struct has clocks, and no function is called at their ticks; expected `#[model(clocked)]` or `#[model(continuous)]`");
        let rows = respan(ty.span(), quote!(<#ty as #krate::derive::Variables>::ROWS));
        respan(field.span(), quote!(const _: () = #krate::derive::has_no_clocks(#rows, #what);))
    });
    quote!(#(#checks)*)
}

/// The type of a clock in the table.
pub fn row(field: &Field) -> TokenStream {
    let (krate, options) = (&field.krate, &field.options);
    let (some, none) = (quote!(::core::option::Option::Some), quote!(::core::option::Option::None));
    let kind = kind(options);
    let word = kind.as_str();
    let variability = format_ident!("{}{}", word[..1].to_uppercase(), word[1..]);
    let is_known = kind != Calculated;
    let interval = constant(options, "interval").filter(|_| is_known);
    let interval = match interval.map(|interval| interval.positive("interval", krate)) {
        Some(interval) => quote!(#some(#interval)),
        None => none.clone(),
    };
    let shift = constant(options, "shift").map(|shift| {
        let value = shift.real();
        respan(shift.span(), quote!(#krate::not_negative(#value, "`shift` is ")))
    });
    let shift = shift.unwrap_or(quote!(0.0));
    let whole = |name, ty: TokenStream| match options.expression(name) {
        Some(number) => {
            let value = respan(number.span(), quote!({ let number: #ty = #number; number }));
            quote!(#some(#value))
        }
        None => none.clone(),
    };
    let (resolution, priority) = (whole("resolution", quote!(u64)), whole("priority", quote!(u32)));
    let supports_fraction = options.has("resolution");
    quote! {
        #krate::ClockType {
            interval_variability: #krate::IntervalVariability::#variability,
            interval: #interval,
            shift: #shift,
            resolution: #resolution,
            supports_fraction: #supports_fraction,
            priority: #priority,
            can_be_deactivated: false,
        }
    }
}

/// The interval and the shift of a clock, if the model calculates them.
pub fn calculated(field: &Field) -> Option<(TokenStream, TokenStream)> {
    let options = &field.options;
    let interval = options.expression("interval").filter(|_| field.is_clock())?;
    let is_calculated = kind(options) == Calculated || interval.uses_self();
    let shift = options.expression("shift").map_or(quote!(0.0), Expression::real);
    is_calculated.then(|| (interval.real(), shift))
}
