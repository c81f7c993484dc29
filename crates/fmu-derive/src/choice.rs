//! `#[derive(Choice)]`.

use std::collections::HashSet;

use proc_macro2::TokenStream;
use quote::{ToTokens, quote};
use syn::{Data, DeriveInput, Fields, LitStr, Result, Variant};

use crate::attributes::{CHOICE, Options, all_or_errors, error, ident_name};
use crate::expression::respan;
use crate::field::{identifier, required_description};

/// Implements `Choice`.
pub fn expand(input: &DeriveInput) -> Result<TokenStream> {
    let ident = &input.ident;
    let Data::Enum(data) = &input.data else { return error(ident, "expected an enum") };
    let options = Options::from_attributes(&input.attrs, CHOICE)?;
    let name = options.text("name").cloned();
    let name = identifier(name.unwrap_or_else(|| ident_name(ident)))?;
    let description = required_description(&input.attrs, ident)?;
    // Without discriminants, Rust counts from 0, and FMI tools from 1.
    let base = i32::from(data.variants.iter().all(|v| v.discriminant.is_none()));
    let (krate, mut names) = (options.krate(), HashSet::new());
    let items = data.variants.iter();
    let items = items.map(|variant| item(variant, base, &mut names, &krate));
    let items = all_or_errors(items)?;
    let variants: Vec<_> = data.variants.iter().map(|variant| &variant.ident).collect();
    let [first, ..] = &*variants else { return error(ident, "expected at least one variant") };
    let from_number = quote! {
        #(
            if number == Self::#variants as i32 + #base {
                return ::core::option::Option::Some(Self::#variants);
            }
        )*
        ::core::option::Option::None
    };
    let bodies = [quote!(self as i32 + #base), from_number, quote!(Self::#first)];
    let about = (name.to_token_stream(), description.to_token_stream());
    Ok(implementation(input, &krate, about, &items, base, bodies))
}

/// The implementation for a type whose derive failed, so that the compiler reports the mistake alone. Its
/// functions are never called.
pub fn stub(input: &DeriveInput) -> TokenStream {
    let krate = Options::from_attributes(&input.attrs, CHOICE).unwrap_or_default().krate();
    let item = quote!(#krate::derive::Item { value: 1, name: "", description: "" });
    let bodies = [(); 3].map(|()| quote!(::core::unreachable!()));
    implementation(input, &krate, (quote!(""), quote!("")), &[item], 1, bodies)
}

fn implementation(
    input: &DeriveInput,
    krate: &TokenStream,
    (name, description): (TokenStream, TokenStream),
    items: &[TokenStream],
    base: i32,
    [number, from_number, unset]: [TokenStream; 3],
) -> TokenStream {
    let (ident, krate) = (&input.ident, quote!(#krate::derive));
    let (generics, arguments, condition) = input.generics.split_for_impl();
    quote! {
        #[allow(unused_variables)]
        impl #generics #krate::Choice for #ident #arguments #condition {
            const ENUMERATION: #krate::Enumeration = #krate::Enumeration {
                name: #name,
                description: #description,
                items: &[#(#items),*],
                size: ::core::mem::size_of::<Self>(),
                item: #krate::item::<Self>,
            };
            const BASE: i32 = #base;

            #[inline]
            fn number(self) -> i32 { #number }
            fn from_number(number: i32) -> ::core::option::Option<Self> { #from_number }
            fn unset() -> Self { #unset }
        }
    }
}

fn item(
    variant: &Variant,
    base: i32,
    names: &mut HashSet<String>,
    krate: &TokenStream,
) -> Result<TokenStream> {
    let ident = &variant.ident;
    if !matches!(variant.fields, Fields::Unit) {
        return error(&variant.fields, "expected a variant without fields");
    }
    let options = Options::from_attributes(&variant.attrs, CHOICE)?;
    let default = LitStr::new(&snake_case(&ident_name(ident).value()), ident.span());
    let name = identifier(options.text("name").cloned().unwrap_or(default))?;
    if !names.insert(name.value()) {
        return error(&name, format!("two items have the name {:?}", name.value()));
    }
    let description = required_description(&variant.attrs, ident)?;
    let value = quote!(#krate::derive::number(Self::#ident as i128 + #base as i128));
    let value = respan(ident.span(), value);
    Ok(quote!(#krate::derive::Item { value: #value, name: #name, description: #description }))
}

/// `TransferFunction` as `transfer_function`.
fn snake_case(name: &str) -> String {
    let mut snake = String::new();
    for (index, c) in name.chars().enumerate() {
        if c.is_uppercase() && index > 0 {
            snake.push('_');
        }
        snake.extend(c.to_lowercase());
    }
    snake
}
