//! Implementations for a type whose derive failed, so that the compiler reports the mistake alone, and
//! not also that the type has no implementation.

use proc_macro2::TokenStream;
use quote::quote;
use syn::{DeriveInput, Path, parse_quote};

use crate::attributes::StructAttributes;

/// The path of the crate with the traits.
fn krate(input: &DeriveInput) -> Path {
    match StructAttributes::of(&input.attrs) {
        Ok(attributes) => attributes.krate,
        Err(_) => parse_quote!(::fmu_export),
    }
}

/// A struct without variables.
pub fn variables(input: &DeriveInput) -> TokenStream {
    let (ident, krate) = (&input.ident, krate(input));
    let krate = quote!(#krate::derive);
    let (generics, arguments, condition) = input.generics.split_for_impl();
    quote! {
        // SAFETY: the table is empty.
        unsafe impl #generics #krate::Variables for #ident #arguments #condition {
            const ROWS: &'static [#krate::Row] = &[];

            fn unset() -> Self {
                ::core::unreachable!()
            }

            fn set_start_values(&mut self) {}

            fn copy_settable(&mut self, _: &Self) {}

            fn value(&mut self, _: usize) -> ::core::option::Option<#krate::ValueMut<'_>> {
                ::core::option::Option::None
            }

            fn add_outputs(&self, sum: f64) -> f64 {
                sum
            }

            fn input_derivative(&mut self, _: usize) -> ::core::option::Option<&mut f64> {
                ::core::option::Option::None
            }

            fn directional_derivative(&self, _: usize, _: usize) -> f64 {
                0.0
            }

            fn copy(&self) -> Self {
                ::core::unreachable!()
            }

            fn save(&self, _: &mut #krate::Saver) -> ::core::result::Result<(), #krate::Damaged> {
                ::core::result::Result::Err(#krate::Damaged)
            }

            fn load(_: &mut #krate::Loader<'_>) -> ::core::result::Result<Self, #krate::Damaged> {
                ::core::result::Result::Err(#krate::Damaged)
            }
        }
    }
}

/// A model without variables.
pub fn model(input: &DeriveInput) -> TokenStream {
    let (ident, krate, variables) = (&input.ident, krate(input), variables(input));
    let (generics, arguments, condition) = input.generics.split_for_impl();
    quote! {
        #variables

        impl #generics #krate::Stepped for #ident #arguments #condition {}

        impl #generics #krate::Model for #ident #arguments #condition {
            const NAME: &'static str = "";
            const DESCRIPTION: &'static str = "";
            const IS_SAMPLED: bool = false;
            const IS_CONTINUOUS: bool = false;
            const DEFAULT_EXPERIMENT: (f64, f64) = (0.0, 0.0);

            fn sample_time(&self) -> f64 {
                0.0
            }

            fn on_initialize(
                &mut self,
                _: &#krate::Start,
            ) -> ::core::result::Result<(), #krate::ModelError> {
                ::core::unreachable!()
            }

            fn on_reconfigure(&mut self) -> ::core::result::Result<(), #krate::ModelError> {
                ::core::unreachable!()
            }

            fn on_step(
                &mut self,
                _: f64,
                _: f64,
            ) -> ::core::result::Result<(), #krate::ModelError> {
                ::core::unreachable!()
            }
        }
    }
}

/// An enumeration with one item.
pub fn choice(input: &DeriveInput) -> TokenStream {
    let (ident, krate) = (&input.ident, crate::choice::krate(input));
    let krate = quote!(#krate::derive);
    let (generics, arguments, condition) = input.generics.split_for_impl();
    quote! {
        impl #generics #krate::Choice for #ident #arguments #condition {
            const ENUMERATION: #krate::Enumeration = #krate::Enumeration {
                name: "",
                description: "",
                items: &[#krate::Item { value: 1, name: "", description: "" }],
            };
            const BASE: i32 = 1;

            fn number(self) -> i32 {
                1
            }

            fn from_number(_: i32) -> ::core::option::Option<Self> {
                ::core::option::Option::None
            }

            fn unset() -> Self {
                ::core::unreachable!()
            }
        }
    }
}
