//! `#[derive(Choice)]`.

use std::collections::HashSet;

use proc_macro2::TokenStream;
use quote::quote;
use syn::meta::ParseNestedMeta;
use syn::{
    Attribute, Data, DeriveInput, Error, Fields, LitStr, Path, Result, Variant, parse_quote,
};

use crate::names;

/// The attribute `#[choice(...)]` of an enum or a variant.
struct Attributes {
    krate: Path,
    name: LitStr,
}

impl Attributes {
    fn of(attributes: &[Attribute], name: LitStr) -> Result<Self> {
        let mut found = Self {
            krate: parse_quote!(::fmu_export),
            name,
        };
        for attribute in attributes.iter().filter(|a| a.path().is_ident("choice")) {
            attribute.parse_nested_meta(|meta| found.read(&meta))?;
        }
        names::check_identifier(&found.name)?;
        Ok(found)
    }

    fn read(&mut self, meta: &ParseNestedMeta<'_>) -> Result<()> {
        if meta.path.is_ident("name") {
            self.name = meta.value()?.parse()?;
        } else if meta.path.is_ident("crate") {
            self.krate = meta.value()?.parse()?;
        } else {
            return Err(meta.error("unknown option; expected `name` or `crate`"));
        }
        Ok(())
    }
}

/// The path of the crate with the traits.
pub fn krate(input: &DeriveInput) -> Path {
    match Attributes::of(&input.attrs, literal(&input.ident)) {
        Ok(attributes) => attributes.krate,
        Err(_) => parse_quote!(::fmu_export),
    }
}

pub fn expand(input: &DeriveInput) -> Result<TokenStream> {
    let ident = &input.ident;
    let Data::Enum(data) = &input.data else {
        return Err(Error::new_spanned(ident, "expected an enum"));
    };
    let of_enum = Attributes::of(&input.attrs, literal(ident))?;
    let (krate, name) = (of_enum.krate, of_enum.name);
    let krate = quote!(#krate::derive);
    let description = description(&input.attrs, ident)?;
    // Without discriminants, Rust counts from 0, and FMI tools from 1.
    let base = i32::from(data.variants.iter().all(|v| v.discriminant.is_none()));
    let mut names = HashSet::new();
    let items = data
        .variants
        .iter()
        .map(|variant| item(variant, base, &mut names, &krate))
        .collect::<Result<Vec<_>>>()?;
    let first = data.variants.first().map(|variant| &variant.ident);
    let Some(first) = first else {
        return Err(Error::new_spanned(ident, "expected at least one variant"));
    };
    let variants: Vec<_> = data.variants.iter().map(|variant| &variant.ident).collect();
    Ok(quote! {
        impl #krate::Choice for #ident {
            const ENUMERATION: #krate::Enumeration = #krate::Enumeration {
                name: #name,
                description: #description,
                items: &[#(#items),*],
            };
            const BASE: i32 = #base;

            #[inline]
            fn number(self) -> i32 {
                self as i32 + #base
            }

            fn from_number(number: i32) -> ::core::option::Option<Self> {
                #(
                    if number == Self::#variants as i32 + #base {
                        return ::core::option::Option::Some(Self::#variants);
                    }
                )*
                ::core::option::Option::None
            }

            fn unset() -> Self {
                Self::#first
            }
        }
    })
}

fn item(
    variant: &Variant,
    base: i32,
    names: &mut HashSet<String>,
    krate: &TokenStream,
) -> Result<TokenStream> {
    let ident = &variant.ident;
    if !matches!(variant.fields, Fields::Unit) {
        return Err(Error::new_spanned(
            &variant.fields,
            "expected a variant without fields",
        ));
    }
    let name = LitStr::new(&names::snake_case(&ident.to_string()), ident.span());
    let name = Attributes::of(&variant.attrs, name)?.name;
    if !names.insert(name.value()) {
        let message = format!("two items have the name {:?}", name.value());
        return Err(Error::new(name.span(), message));
    }
    let description = description(&variant.attrs, ident)?;
    Ok(quote! {
        #krate::Item { value: Self::#ident as i32 + #base, name: #name, description: #description }
    })
}

fn literal(ident: &syn::Ident) -> LitStr {
    LitStr::new(&ident.to_string(), ident.span())
}

fn description(attributes: &[Attribute], ident: &syn::Ident) -> Result<String> {
    names::description(attributes).ok_or_else(|| {
        Error::new_spanned(
            ident,
            format!("`{ident}` has no description; write a doc comment above it"),
        )
    })
}
