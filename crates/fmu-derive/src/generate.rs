//! The code for a field: its row in the table, and the access to its value.

use fmu_description::Type as FmiType;
use proc_macro2::{Group, Span, TokenStream, TokenTree};
use quote::quote;
use syn::LitStr;
use syn::spanned::Spanned;

use crate::attributes::Role;
use crate::field::Field;

/// The tokens at a place in the author's code, where the compiler shows errors. All of them must be there, since
/// it shows an expression whose tokens are at different places at the derive macro.
pub fn at(place: Span, tokens: TokenStream) -> TokenStream {
    let span = Span::call_site().located_at(place);
    let moved = tokens.into_iter().map(|mut token| {
        if let TokenTree::Group(group) = &token {
            token = Group::new(group.delimiter(), at(place, group.stream())).into();
        }
        token.set_span(span);
        token
    });
    moved.collect()
}

impl Field {
    /// An item of a trait for the type of the elements. That it is not implemented is reported once, at the
    /// type, if all code that needs it reads the same.
    fn of_trait(&self, name: &TokenStream, item: &TokenStream) -> TokenStream {
        let (ty, krate) = (self.element_type(), &self.krate);
        at(ty.span(), quote!(<#ty as #krate::#name>::#item))
    }

    /// An item of `Choice` for an enumeration.
    pub fn choice(&self, item: &TokenStream) -> TokenStream {
        self.of_trait(&quote!(Choice), item)
    }

    /// An item of the trait that resets, copies and saves an element.
    fn element(&self, item: &TokenStream) -> TokenStream {
        match (self.role, self.of_type) {
            (Role::Nested, _) => self.of_trait(&quote!(Variables), item),
            (_, FmiType::Enumeration) => self.choice(item),
            _ => self.of_trait(&quote!(Internal), item),
        }
    }

    /// An item of `Variables` for a nested struct; `None` for other fields.
    fn nested(&self, item: &TokenStream) -> Option<TokenStream> {
        (self.role == Role::Nested).then(|| self.element(item))
    }

    /// The number of its first scalar.
    fn first(&self) -> TokenStream {
        let (krate, row) = (&self.krate, self.row);
        quote!(const { #krate::first(Self::ROWS, #row) })
    }

    /// Its row; none if it is internal.
    pub fn row(&self) -> Option<TokenStream> {
        let Self {
            ident,
            krate,
            name,
            description,
            options,
            ..
        } = self;
        let offset = quote!(::core::mem::offset_of!(Self, #ident));
        if let Some(rows) = self.nested(&quote!(ROWS)) {
            return Some(
                quote!(#krate::Row::Group { prefix: #name, offset: #offset, rows: #rows }),
            );
        }
        let causality = match self.role {
            Role::Internal => return None,
            Role::Input => quote!(Input),
            Role::Output => quote!(Output),
            Role::Parameter => quote!(Parameter),
            Role::StructuralParameter => quote!(StructuralParameter),
            _ => quote!(Local),
        };
        let variability = match self.role {
            Role::Constant => quote!(Constant),
            Role::Parameter | Role::StructuralParameter => match options.has("tunable") {
                true => quote!(Tunable),
                false => quote!(Fixed),
            },
            _ if self.of_type.is_float() && !options.has("discrete") => quote!(Continuous),
            _ => quote!(Discrete),
        };
        let dynamics = match (self.role, options.text("of")) {
            (Role::Derivative, Some(of)) => quote!(Derivative { of: #of }),
            (Role::EventIndicator, _) => quote!(EventIndicator),
            _ if options.has("state") => {
                let nominal = options.expression("nominal");
                let nominal = nominal.map_or_else(|| quote!(1.0), |nominal| nominal.real());
                quote!(State { nominal: #nominal })
            }
            _ => quote!(Algebraic),
        };
        let text = |option| options.text(option).map(LitStr::value).unwrap_or_default();
        let [size, unit, terminal] = ["size", "unit", "terminal"].map(text);
        let mime_type = match self.of_type {
            FmiType::Binary if !options.has("mime_type") => "application/octet-stream".into(),
            _ => text("mime_type"),
        };
        let (dimensions, bounds) = (self.dimensions(), self.bounds());
        let start = self.start(&bounds);
        let initially_from = options.names("initially_from");
        let depends_on = options.derivatives().iter().map(|(name, _)| name);
        let has_input_derivative = options.has("derivative");
        Some(quote! {
            #krate::Row::Field(#krate::Field {
                name: #name,
                description: #description,
                offset: #offset,
                causality: #krate::Causality::#causality,
                variability: #krate::Variability::#variability,
                dimensions: &[#(#dimensions),*],
                size: #size,
                start: #start,
                bounds: #krate::Bounds::#bounds,
                unit: #unit,
                mime_type: #mime_type,
                initially_from: &[#(#initially_from),*],
                dynamics: #krate::Dynamics::#dynamics,
                depends_on: &[#(#depends_on),*],
                has_input_derivative: #has_input_derivative,
                terminal: #terminal,
            })
        })
    }

    /// The arm of `input_derivative`.
    pub fn input_derivative(&self) -> Option<TokenStream> {
        let (ident, first) = (&self.ident, self.first());
        if let Some(derivative) = self.nested(&quote!(input_derivative)) {
            let count = self.element(&quote!(COUNT));
            return Some(quote! {
                _ if index.wrapping_sub(#first) < const { #count } => {
                    #derivative(&mut self.#ident, index.wrapping_sub(#first))
                }
            });
        }
        let place = self.options.expression("derivative")?;
        Some(quote!(_ if index == #first => ::core::option::Option::Some(&mut #place),))
    }

    /// The arms of `directional_derivative`, with respect to other fields of the struct.
    pub fn directional_derivatives(&self, others: &[Self]) -> TokenStream {
        let (ident, first) = (&self.ident, self.first());
        if let Some(derivative) = self.nested(&quote!(directional_derivative)) {
            let count = self.element(&quote!(COUNT));
            return quote! {
                _ if unknown.wrapping_sub(#first) < const { #count }
                    && known.wrapping_sub(#first) < const { #count } =>
                {
                    let (unknown, known) = (unknown - #first, known - #first);
                    #derivative(&self.#ident, unknown, known)
                }
            };
        }
        let arms = self
            .options
            .derivatives()
            .iter()
            .filter_map(|(name, value)| {
                let known = others.iter().find(|other| other.is_named(name))?.first();
                Some(quote!(_ if unknown == #first && known == #known => #value,))
            });
        quote!(#(#arms)*)
    }

    /// The statement of `add_outputs`; of an array, it adds the elements in use.
    pub fn add_outputs(&self, others: &[Self]) -> Option<TokenStream> {
        let (ident, krate) = (&self.ident, &self.krate);
        if let Some(add) = self.nested(&quote!(add_outputs)) {
            return Some(quote!(let sum = #add(&self.#ident, sum);));
        }
        if self.role != Role::Output || !self.of_type.is_float() {
            return None;
        }
        let dimensions = self.dimensions().len();
        let size = others.iter().find(|parameter| parameter.is_size_of(self));
        let sum = match (dimensions, size.map(|size| &size.ident)) {
            (0, _) => quote!(f64::from(self.#ident)),
            (_, Some(size)) => {
                quote!(#krate::sum(#krate::in_use(&self.#ident, self.#size)))
            }
            _ => {
                let flatten = (1..dimensions).map(|_| quote!(.as_flattened()));
                quote!(#krate::sum(&self.#ident #(#flatten)*))
            }
        };
        Some(quote!(let sum = sum + #sum;))
    }

    /// The statement that sets the field to its start values.
    pub fn set_start_values(&self) -> Option<TokenStream> {
        let Self {
            ident, krate, row, ..
        } = self;
        if let Some(set) = self.nested(&quote!(set_start_values)) {
            return Some(quote!(#set(&mut self.#ident);));
        }
        let scalars = match self.dimensions().len() {
            0 => quote!(::core::slice::from_mut(&mut self.#ident)),
            dimensions => {
                let flatten = (1..dimensions).map(|_| quote!(.as_flattened_mut()));
                quote!(&mut self.#ident #(#flatten)* [..])
            }
        };
        let row = quote!(const { &Self::ROWS[#row] });
        match (self.is_variable(), self.of_type) {
            (false, _) => None,
            (_, FmiType::Enumeration) => {
                let item = self.choice(&quote!(from_number));
                Some(quote!(#krate::set_choices(#scalars, #row, #item);))
            }
            _ => Some(quote!(#krate::Element::set_start_values(#scalars, #row);)),
        }
    }

    /// The statement that copies the field if the host may set it.
    pub fn copy_settable(&self) -> Option<TokenStream> {
        let ident = &self.ident;
        let copy = match self.nested(&quote!(copy_settable)) {
            None if !self.is_settable() => return None,
            None => quote!(::core::clone::Clone::clone_from),
            Some(copy) => copy,
        };
        Some(quote!(#copy(&mut self.#ident, &from.#ident);))
    }

    /// The default value. `Default` and `Deserialize` end at 32 elements.
    pub fn unset(&self) -> TokenStream {
        let (ident, value) = (&self.ident, self.element(&quote!(unset())));
        let value = self.of_array(value, |value| quote!(::core::array::from_fn(|_| #value)));
        quote!(#ident: #value)
    }

    /// The statement that copies the field into the same field of this struct.
    pub fn copy_from(&self) -> TokenStream {
        let ident = &self.ident;
        let copy = match self.dimensions().is_empty() {
            true => self.element(&quote!(copy_from)),
            false => at(self.span(), quote!(::core::clone::Clone::clone_from)),
        };
        quote!(#copy(&mut self.#ident, &from.#ident);)
    }

    /// The statement that saves the field.
    pub fn save(&self) -> TokenStream {
        let (ident, save) = (&self.ident, self.element(&quote!(save(item, to)?;)));
        let items = self.of_array(save, |item| quote!(for item in item { #item }));
        quote!({ let item = &self.#ident; #items })
    }

    /// The statement that loads the field.
    pub fn load(&self) -> TokenStream {
        let (ident, load) = (&self.ident, self.element(&quote!(load(item, from)?;)));
        let items = self.of_array(load, |item| quote!(for item in item { #item }));
        quote!({ let item = &mut self.#ident; #items })
    }

    /// What is done for the elements of an array, from what is done for one.
    fn of_array(
        &self,
        of_element: TokenStream,
        of_elements: fn(TokenStream) -> TokenStream,
    ) -> TokenStream {
        let dimensions = self.dimensions();
        dimensions
            .iter()
            .fold(of_element, |inner, _| of_elements(inner))
    }
}
