//! `#[derive(Model)]` and `#[derive(Variables)]`.

use std::collections::HashSet;

use fmu_description::{Naming, OwnCategory};
use proc_macro2::{Span, TokenStream};
use quote::{ToTokens, quote};
use syn::{Data, DeriveInput, Error, Fields, LitStr, Result};

use crate::attributes::{MODEL, Options, Role, VARIABLES, all_or_errors, error, ident_name};
use crate::clock;
use crate::expression::{Expression, respan};
use crate::field::{Field, check_positive, identifier, length, required_description};

/// Implements `Model` and `Variables`.
pub fn expand(input: &DeriveInput) -> Result<TokenStream> {
    let options = Options::from_attributes(&input.attrs, MODEL)?;
    let fields = fields(input, &options)?;
    let time = LitStr::new("time", Span::call_site());
    if let Some(Field { name, .. }) = fields.iter().find(|field| field.is_named(&time)) {
        let what = "\"time\" is the independent variable of FMI 3.0 and of Modelica; expected another name";
        return error(name, what);
    }
    let variables = variables(input, &options, Some(&fields));
    let name = options.text("name").cloned();
    let name = identifier(name.unwrap_or_else(|| ident_name(&input.ident)))?;
    let description = required_description(&input.attrs, &input.ident)?;
    for option in ["sample_time", "stop_time", "step_size", "tolerance"] {
        check_positive(options.expression(option))?;
    }
    options.rates().iter().try_for_each(|(_, sample_time)| check_positive(Some(sample_time)))?;
    if let (Some(place), true) = (options.span("rates"), options.has("sample_time")) {
        let what = "`rates` have the sample times; expected no `sample_time` as well";
        return Err(Error::new(place, what));
    }
    let is_sampled = options.has("sample_time") || options.has("rates");
    if let (Some(place), true) = (options.span("continuous"), is_sampled) {
        let what = "a model with a sample time is not continuous";
        return Err(Error::new(place, what));
    }
    if let (Some(step), false) = (options.expression("step"), options.has("continuous")) {
        let what = "only a continuous model names its step; expected `fn step` in `impl Simulate`";
        return error(step, what);
    }
    if let (Some(solver), false) = (options.text("solver"), options.has("continuous")) {
        return error(
            solver,
            "only a continuous model is integrated; expected `continuous` as well",
        );
    }
    clock::check_model(&options, &fields)?;
    let logs: Vec<_> = fields.iter().filter(|field| field.role == Role::Log).collect();
    check_logs(&logs)?;
    let fixed: Vec<_> = fields.iter().flat_map(Field::fixed_references).collect();
    let checks = reference_checks(input, &options, &fixed);
    let clock_checks = clock::model_checks(input, &options, &fields);
    let model = model(input, &options, Some((&name, &description)), &logs, &fixed);
    Ok(quote!(#variables #model #checks #clock_checks))
}

/// Checks that the host can tell the logs apart.
fn check_logs(logs: &[&Field]) -> Result<()> {
    let mut categories = HashSet::new();
    for log in logs {
        let category = log.log_category().map(LitStr::value);
        match (categories.insert(category.clone()), category) {
            (true, _) => {}
            (false, Some(name)) => {
                return error(&log.ident, format!("two logs have the category {name:?}"));
            }
            (false, None) => {
                let what =
                    "a model has one log without a category; expected `#[log(category = ...)]`";
                return error(&log.ident, what);
            }
        }
    }
    match logs.get(OwnCategory::MAX) {
        Some(log) => error(&log.ident, format!("a model has at most {} logs", OwnCategory::MAX)),
        None => Ok(()),
    }
}

/// Implements `Variables`.
pub fn expand_variables(input: &DeriveInput) -> Result<TokenStream> {
    let options = Options::from_attributes(&input.attrs, VARIABLES)?;
    let fields = fields(input, &options)?;
    if let Some(log) = fields.iter().find(|field| field.role == Role::Log) {
        return error(
            &log.ident,
            "only a model has a log; pass it to the functions of this struct",
        );
    }
    let fixed = |field: &Field| {
        ["reference", "references"].iter().find_map(|option| field.options.span(option))
    };
    if let Some(place) = fields.iter().find_map(fixed) {
        let what = "a model numbers its variables; expected `references(...)` where the model has this struct, at #[nested]";
        return Err(Error::new(place, what));
    }
    Ok(variables(input, &options, Some(&fields)))
}

/// The checks of the value references that a model fixes.
fn reference_checks(
    input: &DeriveInput,
    options: &Options,
    fixed: &[(Span, TokenStream)],
) -> TokenStream {
    let (ident, krate) = (&input.ident, options.krate());
    let checks = fixed.iter().enumerate().filter(|_| input.generics.params.is_empty());
    let checks = checks.map(|(i, (place, _))| {
        let rows = quote!(<#ident as #krate::Variables>::ROWS);
        let check = quote! {
            const _: () = #krate::derive::check_reference::<{ #krate::derive::variable_count(#rows) }>(
                #rows, <#ident as #krate::Model>::REFERENCES, #i,
            );
        };
        respan(*place, check)
    });
    quote!(#(#checks)*)
}

/// The implementation for a struct whose derive failed, so that the compiler reports the mistake alone, and not
/// also that there is no implementation. Its functions are never called.
pub fn stub_variables(input: &DeriveInput) -> TokenStream {
    let options = Options::from_attributes(&input.attrs, VARIABLES).unwrap_or_default();
    variables(input, &options, None)
}

/// As [`stub_variables`].
pub fn stub(input: &DeriveInput) -> TokenStream {
    let options = Options::from_attributes(&input.attrs, MODEL).unwrap_or_default();
    let variables = variables(input, &options, None);
    let model = model(input, &options, None, &[], &[]);
    quote!(#variables #model)
}

/// The implementation of `Model`; a stub has no name and description.
fn model(
    input: &DeriveInput,
    options: &Options,
    named: Option<(&LitStr, &String)>,
    logs: &[&Field],
    fixed: &[(Span, TokenStream)],
) -> TokenStream {
    let (ident, krate) = (&input.ident, options.krate());
    let is_stub = named.is_none();
    let (name, description) =
        named.map_or((quote!(""), ""), |(name, description)| (name.to_token_stream(), description));
    let rates = if is_stub { &[] } else { options.rates() };
    let (is_sampled, has_rates) =
        (options.has("sample_time") || !rates.is_empty(), !rates.is_empty());
    let continuous = options.span("continuous").filter(|_| !is_stub);
    let is_continuous = continuous.is_some();
    let clocked = options.span("clocked").filter(|_| !is_stub);
    let is_clocked = clocked.is_some();
    let step = options.expression("step");
    let is_integrated = is_continuous && step.is_none();
    let is_implicit = options.text("solver").is_some_and(|solver| solver.value() == "implicit");
    let number = |option, default| {
        let given = options.expression(option).filter(|_| !is_stub);
        given.map_or(default, |given| given.positive(option, &quote!(#krate::derive)))
    };
    let sample_time = options.expression("sample_time").filter(|_| !is_stub);
    let sample_time = sample_time.map_or(quote!(0.0), Expression::real);
    let stop_time = number("stop_time", quote!(20.0));
    let step_size = number("step_size", quote!(0.001));
    let tolerance = number("tolerance", if is_integrated { quote!(1e-6) } else { quote!(0.0) });
    // What the author implements.
    let author = match (continuous, clocked) {
        (Some(place), _) => respan(place, quote!(<Self as #krate::Continuous>)),
        (None, Some(place)) => respan(place, quote!(<Self as #krate::Clocked>)),
        _ if has_rates => respan(ident.span(), quote!(<Self as #krate::MultiRate>)),
        _ => respan(ident.span(), quote!(<Self as #krate::Simulate>)),
    };
    let step = match (is_continuous, step) {
        _ if has_rates => quote!(::core::unreachable!("from {time} s by {step} s")),
        // Between ticks, nothing happens.
        _ if is_clocked => quote!({
            let _ = (time, step);
            ::core::result::Result::Ok(())
        }),
        (false, _) => quote!(#author::step(self, time, step)),
        (true, Some(function)) => quote!(#function(self, time, step)),
        (true, None) => quote!(::core::unreachable!("from {time} s by {step} s")),
    };
    let body = |body| if is_stub { quote!(::core::unreachable!()) } else { body };
    let step = body(step);
    let initialize = body(quote!(#author::initialize(self, start)));
    let reconfigure = body(quote!(#author::reconfigure(self)));
    let result = quote!(::core::result::Result<(), #krate::ModelError>);
    let (generics, arguments, condition) = input.generics.split_for_impl();
    let more = match is_continuous {
        false if is_clocked => quote! {
            fn on_clocks(&mut self, time: f64) -> #result { #author::tick(self, time) }
        },
        false => TokenStream::new(),
        true => quote! {
            #[inline]
            fn on_evaluate(&mut self, time: f64) -> #result { #author::evaluate(self, time) }
            fn on_event(&mut self, time: f64) -> #result { #author::event(self, time) }
            fn on_next_event(&self, time: f64) -> ::core::option::Option<f64> {
                #author::next_event(self, time)
            }
        },
    };
    let is_bus_simulation = options.has("bus_simulation");
    let is_single_instance = options.has("single_instance");
    let single_instance = is_single_instance.then(|| {
        quote! {
            fn single_instance() -> ::core::option::Option<&'static #krate::SingleInstance> {
                static SINGLE: #krate::SingleInstance = #krate::SingleInstance::new();
                ::core::option::Option::Some(&SINGLE)
            }
        }
    });
    let naming = match options.text("naming").map(LitStr::value).as_deref().and_then(Naming::parse)
    {
        Some(Naming::Flat) => quote!(Some(#krate::derive::Naming::Flat)),
        Some(Naming::Structured) => quote!(Some(#krate::derive::Naming::Structured)),
        None => quote!(None),
    };
    let (with_category, without): (Vec<&Field>, Vec<&Field>) =
        logs.iter().partition(|log| log.log_category().is_some());
    let has_log = !without.is_empty();
    let log = (!logs.is_empty()).then(|| {
        let option = quote!(::core::option::Option);
        let arms = with_category.iter().chain(&without).enumerate().map(|(index, log)| {
            let ident = &log.ident;
            let field = respan(ident.span(), quote!(&mut self.#ident));
            let category = match log.log_category() {
                Some(_) => quote!(#option::Some(#index)),
                None => quote!(#option::None),
            };
            quote!(#index => #option::Some((#field, #category)),)
        });
        let log = quote!((&mut #krate::Log, #option<usize>));
        quote! {
            fn log(&mut self, index: usize) -> #option<#log> {
                match index { #(#arms)* _ => #option::None }
            }
        }
    });
    let categories = with_category.iter().map(|log| {
        let name = format!("{}\0", log.name.value());
        let description = &log.description;
        quote!(#krate::derive::OwnCategory::new(#name, #description))
    });
    let stepped = match (is_continuous, has_rates) {
        (true, _) => TokenStream::new(),
        _ if is_clocked => {
            quote!(impl #generics #krate::Ticked for #ident #arguments #condition {})
        }
        (_, true) => quote!(impl #generics #krate::Rated for #ident #arguments #condition {}),
        _ => quote!(impl #generics #krate::Stepped for #ident #arguments #condition {}),
    };
    let rate_names = rates.iter().map(|(name, _)| name.to_string());
    let ticks = has_rates.then(|| {
        let names = rate_names.clone();
        let times = rates.iter().map(|(_, sample_time)| sample_time.real());
        let methods = rates
            .iter()
            .map(|(name, _)| respan(name.span(), quote!(Self::#name(self, time, step))));
        let indices = 0..rates.len();
        quote! {
            fn rates(&self) -> ::std::vec::Vec<(&'static str, f64)> {
                ::std::vec::Vec::from([#((#names, #times)),*])
            }
            fn on_tick(&mut self, rate: usize, time: f64, step: f64) -> #result {
                match rate {
                    #(#indices => #methods,)*
                    _ => ::core::result::Result::Ok(()),
                }
            }
        }
    });
    // A constant, whose function is compiled in tests only.
    let drive = input.generics.params.is_empty().then(|| {
        quote! {
            impl #krate::testing::Drive for #ident {
                const INSTANCE: fn(Self) -> #krate::testing::DrivenInstance =
                    #krate::testing::instance::<Self, { #krate::table_size::<#ident>() }>;
            }
        }
    });
    let references = fixed.iter().map(|(_, fixed)| fixed);
    quote! {
        #stepped
        #drive

        impl #generics #krate::Model for #ident #arguments #condition {
            const NAME: &'static str = #name;
            const DESCRIPTION: &'static str = #description;
            const REFERENCES: &'static [#krate::derive::FixedReference] = &[#(#references),*];
            const IS_SAMPLED: bool = #is_sampled;
            const RATES: &'static [&'static str] = &[#(#rate_names),*];
            const IS_CONTINUOUS: bool = #is_continuous;
            const IS_CLOCKED: bool = #is_clocked;
            const IS_BUS_SIMULATION: bool = #is_bus_simulation;
            const IS_INTEGRATED: bool = #is_integrated;
            const IS_IMPLICIT: bool = #is_implicit;
            const DEFAULT_EXPERIMENT: (f64, f64) = (#stop_time, #step_size);
            const TOLERANCE: f64 = #tolerance;
            const HAS_LOG: bool = #has_log;
            const LOG_CATEGORIES: &'static [#krate::derive::OwnCategory] = &[#(#categories),*];
            const IS_SINGLE_INSTANCE: bool = #is_single_instance;
            const NAMING: ::core::option::Option<#krate::derive::Naming> =
                ::core::option::Option::#naming;
        }

        #[allow(unused_variables)]
        impl #generics #krate::Behavior for #ident #arguments #condition {
            #[inline(always)]
            fn sample_time(&self) -> f64 { #sample_time }
            fn on_initialize(&mut self, start: &#krate::Start) -> #result { #initialize }
            fn on_reconfigure(&mut self) -> #result { #reconfigure }
            #[inline(always)]
            fn on_step(&mut self, time: f64, step: f64) -> #result { #step }
            #ticks
            #more
            #log
            #single_instance
        }
    }
}

/// The implementation of `Variables`; a stub has no fields.
fn variables(input: &DeriveInput, options: &Options, fields: Option<&[Field]>) -> TokenStream {
    let (ident, krate) = (&input.ident, options.krate());
    let krate = &quote!(#krate::derive);
    let is_stub = fields.is_none();
    let fields = fields.unwrap_or_default();
    let saved = fields.iter().filter(|field| field.role.is_saved());
    let serialized = fields.iter().filter(|field| field.role.is_serialized());
    let unset = match options.has("default") {
        _ if is_stub => quote!(::core::unreachable!()),
        true => quote!(::core::default::Default::default()),
        false => {
            let values = fields.iter().map(Field::unset);
            quote!(Self { #(#values),* })
        }
    };
    let rows = fields.iter().flat_map(Field::rows);
    let is_unsaved = fields.iter().filter_map(Field::is_unsaved);
    let is_unserialized = fields.iter().filter_map(Field::is_unserialized);
    let are_finite = fields.iter().filter_map(|field| field.has_finite_outputs(fields));
    let input_derivatives = fields.iter().filter_map(Field::input_derivative);
    let timings = fields.iter().filter_map(Field::clock_timing);
    let derivatives = fields.iter().map(|field| field.directional_derivatives(fields));
    let copies = saved.map(Field::copy_from);
    let (saves, loads) = (serialized.clone().map(Field::save), serialized.clone().map(Field::load));
    let layouts = serialized.map(Field::state_layout);
    let checks = checks(input, fields, krate);
    let change_checks = fields.iter().map(Field::change_checks);
    let result = quote!(::core::result::Result<(), #krate::StateError>);
    let done = quote!(::core::result::Result::Ok(()));
    let (generics, arguments, condition) = input.generics.split_for_impl();
    quote! {
        #[automatically_derived]
        #[allow(clippy::all, clippy::pedantic, deprecated, unused_variables)]
        // SAFETY: the compiler provides the offsets, and checks the start values against the types.
        unsafe impl #generics #krate::Variables for #ident #arguments #condition {
            const ROWS: &'static [#krate::TableRow] = &[#(#rows),*];
            const IS_UNSAVED: bool = false #(|| #is_unsaved)*;
            const IS_UNSERIALIZED: bool = false #(|| #is_unserialized)*;
            const STATE_LAYOUT: u128 = #krate::state_layout(&[#(#layouts),*]);

            fn unset() -> Self { #unset }
            #[inline(always)]
            fn has_finite_outputs(&self) -> bool { true #(&& #are_finite)* }
            fn input_derivative(&mut self, index: usize) -> ::core::option::Option<&mut f64> {
                match index { #(#input_derivatives)* _ => ::core::option::Option::None }
            }
            fn clock_timing(&self, index: usize) -> ::core::option::Option<#krate::Timing> {
                match index { #(#timings)* _ => ::core::option::Option::None }
            }
            fn directional_derivative(&self, unknown: usize, known: usize) -> f64 {
                match (unknown, known) { #(#derivatives)* _ => 0.0 }
            }
            fn copy_from(&mut self, from: &Self) { #(#copies)* }
            fn save(&self, to: &mut #krate::StateWriter) -> #result { #(#saves)* #done }
            fn load(&mut self, from: &mut #krate::StateReader<'_>) -> #result { #(#loads)* #done }
        }

        #checks
        #(#change_checks)*
    }
}

/// The fields, or the mistakes in all of them.
fn fields(input: &DeriveInput, options: &Options) -> Result<Vec<Field>> {
    let Data::Struct(data) = &input.data else { return error(&input.ident, "expected a struct") };
    let Fields::Named(named) = &data.fields else {
        return error(&input.ident, "expected a struct with named fields");
    };
    if let Some(lifetime) = input.generics.lifetimes().next() {
        let what = "a model outlives what it borrows; expected a struct without lifetimes, whose fields own their values";
        return error(lifetime, what);
    }
    let krate = options.krate();
    let krate = quote!(#krate::derive);
    let field = |field| {
        let field = Field::new(field, &krate)?;
        clock::check(&field)?;
        Ok(field)
    };
    let mut fields = all_or_errors(named.named.iter().map(field))?;
    let mut row = 0;
    for field in &mut fields {
        field.row = row;
        row += field.row_count();
    }
    let fresh = fields.iter().find_map(|field| field.options.expression("fresh"));
    if let (Some(fresh), true) = (fresh, options.has("default")) {
        return error(fresh, "the struct is created with its `Default`; expected no `fresh`");
    }
    check_names(&fields)?;
    Ok(fields)
}

/// Checks that no two variables of the struct have the same name, as far as no nested struct is involved, and that
/// the variables exist to which `size` and `derivative_by` refer.
fn check_names(fields: &[Field]) -> Result<()> {
    let mut names = HashSet::new();
    let variables = fields.iter().filter(|field| field.is_variable());
    for name in
        variables.flat_map(|field| [&field.name].into_iter().chain(field.options.names("alias")))
    {
        if !names.insert(name.value()) {
            return error(name, format!("two variables have the name {:?}", name.value()));
        }
    }
    fields.iter().try_for_each(|field| check_size(field, fields))?;
    fields.iter().try_for_each(|field| clock::check_clocks(field, fields))?;
    for (name, _) in fields.iter().flat_map(|field| field.options.derivatives()) {
        if !fields.iter().any(|field| field.is_known() && field.is_named(name)) {
            let what = format!("there is no input or state {:?}", name.value());
            return error(name, format!("{what} of type f64 in this struct"));
        }
    }
    Ok(())
}

/// Checks that the number of elements in use is a structural parameter of the struct, and does not exceed
/// the array if both are literals. The compiler checks other expressions where a model is exported.
fn check_size(field: &Field, fields: &[Field]) -> Result<()> {
    let Some(size) = field.options.text("size") else { return Ok(()) };
    let name = size.value();
    let Some(parameter) = fields.iter().find(|p| p.is_size_of(field)) else {
        let what = format!("there is no structural parameter {name:?} in this struct");
        return error(size, what);
    };
    let Some(max) = parameter.options.expression("max") else {
        let what =
            "a structural parameter needs a maximum; expected `max` of at most the length of";
        return error(&parameter.ident, format!("{what} `{}`", field.ident));
    };
    let capacity = (field.dimensions().first()).and_then(|capacity| length(capacity));
    match (max.number(), capacity) {
        (Some(max), Some(capacity)) if max > capacity => {
            let what = format!("{name:?} may be {max}, and the array has only {capacity} elements");
            error(size, what)
        }
        _ => Ok(()),
    }
}

/// Checks that the compiler makes when all structs are known; not for generic structs, which are
/// checked where they are exported.
fn checks(input: &DeriveInput, fields: &[Field], krate: &TokenStream) -> TokenStream {
    if !input.generics.params.is_empty() {
        return TokenStream::new();
    }
    let ident = &input.ident;
    let rows = quote!(<#ident as #krate::Variables>::ROWS);
    let nested = fields.iter().filter(|field| field.role == Role::Nested);
    let unique = nested.map(|Field { ident, row, .. }| {
        let message = format!("a variable of `{ident}` has the name of another: ");
        let check = quote!(#krate::unique(#rows, #row, #message));
        respan(ident.span(), quote!(#[allow(long_running_const_eval)] const _: () = #check;))
    });
    let names = fields.iter().flat_map(|f| f.options.names("initially_from"));
    let known = fields.iter().filter(|field| field.is_variable());
    let known = known.map(|field| field.name.value()).collect::<Vec<_>>().join(", ");
    let has_nested = fields.iter().any(|field| field.role == Role::Nested);
    let expected = if has_nested { String::new() } else { format!("; expected one of {known}") };
    let exist = names.map(|name| {
        let message = format!("there is no variable {:?} in this struct{expected}", name.value());
        respan(name.span(), quote!(const _: () = #krate::exists(#rows, #name, #message);))
    });
    let values = fields.iter().map(|field| field.value_checks(&rows));
    quote!(const _: &[#krate::TableRow] = #rows; #(#unique)* #(#exist)* #(#values)*)
}
