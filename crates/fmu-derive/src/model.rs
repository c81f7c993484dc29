//! `#[derive(Model)]` and `#[derive(Variables)]`.

use std::collections::HashMap;

use proc_macro2::TokenStream;
use quote::quote;
use syn::{Data, DeriveInput, Error, Fields, Ident, LitStr, Result};

use crate::attributes::{Role, StructAttributes};
use crate::field::{Content, Field, Kind};
use crate::generate::{self, Position};
use crate::{names, spans, start};

pub fn expand(input: &DeriveInput) -> Result<TokenStream> {
    let attributes = StructAttributes::of(&input.attrs)?;
    let variables = implement_variables(input, &attributes)?;
    let ident = &input.ident;
    let krate = &attributes.krate;
    let name =
        (attributes.name.clone()).unwrap_or_else(|| LitStr::new(&ident.to_string(), ident.span()));
    names::check_identifier(&name)?;
    let description = names::description(&input.attrs).ok_or_else(|| {
        Error::new_spanned(
            ident,
            format!("`{ident}` has no description; write a doc comment above it"),
        )
    })?;
    let positive = [
        &attributes.sample_time,
        &attributes.stop_time,
        &attributes.step_size,
        &attributes.tolerance,
    ];
    (positive.into_iter().flatten()).try_for_each(start::check_positive)?;
    let number = |e| start::number(e, &Kind::Real);
    let is_sampled = attributes.sample_time.is_some();
    let is_continuous = attributes.continuous.is_some();
    let is_integrated = is_continuous && attributes.step.is_none();
    if let (Some(span), true) = (attributes.continuous, is_sampled) {
        return Err(Error::new(
            span,
            "a model with a sample time is not continuous",
        ));
    }
    if let (Some(step), false) = (&attributes.step, is_continuous) {
        return Err(Error::new_spanned(
            step,
            "only a continuous model names its step; expected `fn step` in `impl Simulate`",
        ));
    }
    let behaviour = behaviour(ident, &attributes);
    let sample_time = match attributes.sample_time.as_ref().map(number) {
        Some(sample_time) => quote!(#sample_time),
        None => quote!(0.0),
    };
    let stop_time = attributes.stop_time.as_ref().map(number);
    let stop_time = stop_time.map_or_else(|| quote!(20.0), |e| quote!(#e));
    let step_size = attributes.step_size.as_ref().map(number);
    let step_size = step_size.map_or_else(|| quote!(0.001), |e| quote!(#e));
    let tolerance = match attributes.tolerance.as_ref().map(number) {
        Some(tolerance) => quote!(#tolerance),
        None if is_integrated => quote!(1e-6),
        None => quote!(0.0),
    };
    let (generics, arguments, condition) = input.generics.split_for_impl();
    let stepped = (!is_continuous).then(|| {
        quote! {
            impl #generics #krate::Stepped for #ident #arguments #condition {}
        }
    });
    Ok(quote! {
        #variables

        #stepped

        impl #generics #krate::Model for #ident #arguments #condition {
            const NAME: &'static str = #name;
            const DESCRIPTION: &'static str = #description;
            const IS_SAMPLED: bool = #is_sampled;
            const IS_CONTINUOUS: bool = #is_continuous;
            const IS_INTEGRATED: bool = #is_integrated;
            const DEFAULT_EXPERIMENT: (f64, f64) = (#stop_time, #step_size);
            const TOLERANCE: f64 = #tolerance;

            #[inline(always)]
            fn sample_time(&self) -> f64 {
                #sample_time
            }

            #behaviour
        }
    })
}

/// The functions of a model that call those of its author.
fn behaviour(ident: &Ident, attributes: &StructAttributes) -> TokenStream {
    let krate = &attributes.krate;
    let result = quote!(::core::result::Result<(), #krate::ModelError>);
    let (author, step, equations) = match attributes.continuous {
        None => {
            let author = spans::at(ident.span(), quote!(<Self as #krate::Simulate>));
            let step = quote!(#author::step(self, time, step));
            (author, step, None)
        }
        Some(span) => {
            let author = spans::at(span, quote!(<Self as #krate::Continuous>));
            let step = match &attributes.step {
                Some(function) => quote!(#function(self, time, step)),
                None => quote!(::core::unreachable!("from {time} s by {step} s")),
            };
            let equations = quote! {
                #[inline]
                fn on_evaluate(&mut self, time: f64) -> #result {
                    #author::evaluate(self, time)
                }

                fn on_event(&mut self, time: f64) -> #result {
                    #author::event(self, time)
                }

                fn on_next_event(&self, time: f64) -> ::core::option::Option<f64> {
                    #author::next_event(self, time)
                }
            };
            (author, step, Some(equations))
        }
    };
    quote! {
        fn on_initialize(&mut self, start: &#krate::Start) -> #result {
            #author::initialize(self, start)
        }

        fn on_reconfigure(&mut self) -> #result {
            #author::reconfigure(self)
        }

        #[inline(always)]
        fn on_step(&mut self, time: f64, step: f64) -> #result {
            #step
        }

        #equations
    }
}

pub fn expand_variables(input: &DeriveInput) -> Result<TokenStream> {
    implement_variables(input, &StructAttributes::of(&input.attrs)?)
}

fn implement_variables(input: &DeriveInput, attributes: &StructAttributes) -> Result<TokenStream> {
    let ident = &input.ident;
    let fields = fields(input)?;
    check_names(&fields)?;
    let krate = &attributes.krate;
    let krate = &quote!(#krate::derive);
    let positions = positions(&fields, krate);
    let knowns = knowns(&fields, &positions);
    check_knowns(&fields, &knowns)?;

    let rows = fields
        .iter()
        .filter_map(|field| generate::row(field, krate));
    let arms = |arm: fn(&Field, &Position, &TokenStream) -> Option<TokenStream>| -> Vec<_> {
        let each = fields.iter().zip(&positions);
        each.filter_map(|(field, at)| arm(field, at, krate))
            .collect()
    };
    let values = arms(generate::value_arm);
    let input_derivatives = arms(generate::input_derivative_arm);
    let derivatives = fields
        .iter()
        .zip(&positions)
        .map(|(field, at)| generate::directional_derivative_arms(field, at, &knowns, krate));
    let sums = fields
        .iter()
        .filter_map(|field| generate::add_outputs(field, &fields, krate));
    let of_fields = |of: fn(&Field, &TokenStream) -> TokenStream| -> Vec<_> {
        fields.iter().map(|field| of(field, krate)).collect()
    };
    let (copies, saves) = (of_fields(generate::copy), of_fields(generate::save));
    let (unsets, loads) = (of_fields(generate::unset), of_fields(generate::load));
    let copies_from = of_fields(generate::copy_from);
    let unset = match attributes.by_default {
        true => quote!(::core::default::Default::default()),
        false => quote!(Self { #(#unsets),* }),
    };
    let listed = fields
        .iter()
        .filter(|f| !matches!(f.content, Content::Internal));
    let starts = listed
        .enumerate()
        .filter_map(|(row, field)| generate::set_start_values(field, row, krate));
    let settable = fields
        .iter()
        .filter_map(|field| generate::copy_settable(field, krate));
    let checks = checks(input, &fields, krate);
    let (generics, arguments, condition) = input.generics.split_for_impl();
    Ok(quote! {
        #[automatically_derived]
        #[allow(clippy::all, clippy::pedantic, unused_variables)]
        // SAFETY: the compiler provides the offsets, and a Real is only read from a field of the type f64.
        unsafe impl #generics #krate::Variables for #ident #arguments #condition {
            const ROWS: &'static [#krate::Row] = &[#(#rows),*];

            fn unset() -> Self {
                #unset
            }

            fn set_start_values(&mut self) {
                #(#starts)*
            }

            fn copy_settable(&mut self, from: &Self) {
                #(#settable)*
            }

            fn value(&mut self, index: usize) -> ::core::option::Option<#krate::ValueMut<'_>> {
                match index {
                    #(#values)*
                    _ => ::core::option::Option::None,
                }
            }

            #[inline(always)]
            fn add_outputs(&self, sum: f64) -> f64 {
                #(#sums)*
                sum
            }

            fn input_derivative(&mut self, index: usize) -> ::core::option::Option<&mut f64> {
                match index {
                    #(#input_derivatives)*
                    _ => ::core::option::Option::None,
                }
            }

            fn directional_derivative(&self, unknown: usize, known: usize) -> f64 {
                match (unknown, known) {
                    #(#derivatives)*
                    _ => 0.0,
                }
            }

            fn copy(&self) -> Self {
                Self { #(#copies),* }
            }

            fn copy_from(&mut self, from: &Self) {
                #(#copies_from)*
            }

            fn save(
                &self,
                to: &mut #krate::Saver,
            ) -> ::core::result::Result<(), #krate::Damaged> {
                #(#saves)*
                ::core::result::Result::Ok(())
            }

            fn load(
                from: &mut #krate::Loader<'_>,
            ) -> ::core::result::Result<Self, #krate::Damaged> {
                ::core::result::Result::Ok(Self { #(#loads),* })
            }
        }

        #checks
    })
}

fn fields(input: &DeriveInput) -> Result<Vec<Field>> {
    let Data::Struct(data) = &input.data else {
        return Err(Error::new_spanned(&input.ident, "expected a struct"));
    };
    let Fields::Named(named) = &data.fields else {
        return Err(Error::new_spanned(
            &input.ident,
            "expected a struct with named fields",
        ));
    };
    // All errors at once.
    let (mut fields, mut errors) = (Vec::new(), None::<Error>);
    for field in &named.named {
        match (Field::of(field), &mut errors) {
            (Ok(field), _) => fields.push(field),
            (Err(error), Some(errors)) => errors.combine(error),
            (Err(error), none) => *none = Some(error),
        }
    }
    errors.map_or(Ok(fields), Err)
}

fn positions(fields: &[Field], krate: &TokenStream) -> Vec<Position> {
    let mut at = Position::START;
    fields
        .iter()
        .map(|field| {
            let here = at.clone();
            at.advance(field, krate);
            here
        })
        .collect()
}

/// Names and positions of the inputs and states that are scalars of type f64.
fn knowns(fields: &[Field], positions: &[Position]) -> Vec<(String, TokenStream)> {
    fields
        .iter()
        .zip(positions)
        .filter(|(field, _)| {
            let attributes = &field.attributes;
            let is_known = attributes.role == Role::Input || attributes.state;
            is_known && field.dimensions().is_empty()
        })
        .filter_map(|(field, at)| {
            let variable = field.variable()?;
            matches!(variable.kind, Kind::Real).then(|| (variable.name.value(), at.tokens()))
        })
        .collect()
}

/// Checks that no two variables of the struct have the same name, and that the variables exist which
/// others depend on, as far as no nested struct is involved.
fn check_names(fields: &[Field]) -> Result<()> {
    let mut names = HashMap::new();
    for field in fields {
        if let Some(variable) = field.variable()
            && names.insert(variable.name.value(), ()).is_some()
        {
            let name = variable.name.value();
            return Err(Error::new(
                variable.name.span(),
                format!("two variables have the name {name:?}"),
            ));
        }
    }
    fields
        .iter()
        .try_for_each(|field| check_size(field, fields))?;
    let has_nested = (fields.iter()).any(|f| matches!(f.content, Content::Nested { .. }));
    for name in fields.iter().flat_map(|f| &f.attributes.initially_from) {
        if !has_nested && !names.contains_key(&name.value()) {
            let known = fields.iter().filter_map(Field::variable);
            let known: Vec<_> = known.map(|variable| variable.name.value()).collect();
            return Err(Error::new(
                name.span(),
                format!(
                    "there is no variable {:?} in this struct; expected one of {}",
                    name.value(),
                    known.join(", ")
                ),
            ));
        }
    }
    Ok(())
}

/// Checks that the number of elements in use is a structural parameter of the struct, and does not exceed
/// the array if both are literals. The compiler checks the others where a model is exported.
fn check_size(field: &Field, fields: &[Field]) -> Result<()> {
    let Some(size) = &field.attributes.size else {
        return Ok(());
    };
    let Some(parameter) = fields.iter().find(|p| p.is_size_of(field)) else {
        let message = format!(
            "there is no structural parameter {:?} in this struct",
            size.value()
        );
        return Err(Error::new(size.span(), message));
    };
    let Some(max) = &parameter.attributes.max else {
        let message = format!(
            "a structural parameter needs a maximum; expected `max` of at most the length of `{}`",
            field.ident
        );
        return Err(Error::new(parameter.span(), message));
    };
    let capacity = field
        .dimensions()
        .first()
        .copied()
        .and_then(start::number_of);
    match (start::number_of(max), capacity) {
        (Some(max), Some(capacity)) if max > capacity => Err(Error::new(
            size.span(),
            format!(
                "{size:?} may be {max}, and the array has only {capacity} elements",
                size = size.value()
            ),
        )),
        _ => Ok(()),
    }
}

/// Checks that directional derivatives are with respect to inputs and states.
fn check_knowns(fields: &[Field], knowns: &[(String, TokenStream)]) -> Result<()> {
    for (name, _) in fields.iter().flat_map(|f| &f.attributes.derivative_by) {
        if !knowns.iter().any(|(known, _)| *known == name.value()) {
            return Err(Error::new(
                name.span(),
                format!(
                    "there is no input or state {:?} of type f64 in this struct",
                    name.value()
                ),
            ));
        }
    }
    Ok(())
}

/// Checks that the compiler makes when all structs are known; not for generic structs, which are
/// checked where they are exported.
fn checks(input: &DeriveInput, fields: &[Field], krate: &TokenStream) -> TokenStream {
    if !input.generics.params.is_empty() {
        return TokenStream::new();
    }
    let ident = &input.ident;
    let rows = quote!(<#ident as #krate::Variables>::ROWS);
    let nested = fields.iter().enumerate().filter_map(|(index, field)| {
        let Content::Nested { .. } = &field.content else {
            return None;
        };
        let before = fields[..index].iter();
        let row = before
            .filter(|f| !matches!(f.content, Content::Internal))
            .count();
        let message = format!("a variable of `{}` has the name of another: ", field.ident);
        Some(spans::at(
            field.span(),
            quote!(#[allow(long_running_const_eval)] const _: () = #krate::unique(#rows, #row, #message);),
        ))
    });
    let dependencies = fields
        .iter()
        .flat_map(|f| &f.attributes.initially_from)
        .map(|name| {
            let message = format!("there is no variable {:?} in this struct", name.value());
            spans::at(
                name.span(),
                quote!(const _: () = #krate::exists(#rows, #name, #message);),
            )
        });
    quote! {
        const _: &[#krate::Row] = #rows;
        #(#nested)*
        #(#dependencies)*
    }
}
