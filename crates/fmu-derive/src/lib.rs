//! The derive macros of `fmu-export`, which re-exports and documents them.
#![forbid(unsafe_code)]

mod attributes;
mod choice;
mod clock;
mod expression;
mod field;
mod generate;
mod model;

use proc_macro::TokenStream;
use syn::{DeriveInput, Error, parse_macro_input};

/// Defines the derive macro of a struct, with the attributes of structs that it takes; the attributes of fields are the
/// same for all macros.
macro_rules! derive_of_struct {
    ($name:ident as $function:ident($($attribute:ident),+) in $page:literal: $expand:path, $stub:path) => {
        #[doc = include_str!($page)]
        #[proc_macro_derive(
            $name,
            attributes(
                $($attribute,)+
                input, output, parameter, structural_parameter, local, constant, derivative,
                event_indicator, nested, log, saved, copied, unsaved, fresh
            )
        )]
        pub fn $function(input: TokenStream) -> TokenStream {
            expand(parse_macro_input!(input), $expand, $stub)
        }
    };
}

derive_of_struct!(Model as model(model, variables) in "model.md": model::expand, model::stub);
derive_of_struct!(
    Variables as variables(variables) in "variables.md": model::expand_variables, model::stub_variables
);

#[doc = include_str!("choice.md")]
#[proc_macro_derive(Choice, attributes(choice))]
pub fn choice(input: TokenStream) -> TokenStream {
    expand(parse_macro_input!(input), choice::expand, choice::stub)
}

fn expand(
    input: DeriveInput,
    derive: impl FnOnce(&DeriveInput) -> syn::Result<proc_macro2::TokenStream>,
    stub: impl FnOnce(&DeriveInput) -> proc_macro2::TokenStream,
) -> TokenStream {
    let expanded = derive(&input).unwrap_or_else(|error| {
        let mut tokens = Error::into_compile_error(error);
        // A struct that borrows cannot implement the traits.
        if input.generics.lifetimes().next().is_none() {
            tokens.extend(stub(&input));
        }
        tokens
    });
    expanded.into()
}
