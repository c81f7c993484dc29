//! The code for a field: its row in the table, and the access to its value.

use fmu_description::{Type as FmiType, words};
use proc_macro2::{Span, TokenStream};
use quote::{ToTokens, quote};
use syn::spanned::Spanned;
use syn::{Ident, Lit, LitStr};

use crate::attributes::Role;
use crate::clock;
use crate::expression::{Expression, Form, respan};
use crate::field::Field;

impl Field {
    /// An item of a trait for the type of the elements. The compiler reports a missing implementation once, at the
    /// type, if all code that needs the trait reads the same.
    fn trait_item(&self, name: &TokenStream, item: &TokenStream) -> TokenStream {
        let (ty, krate) = (self.element_type(), &self.krate);
        respan(ty.span(), quote!(<#ty as #krate::#name>::#item))
    }

    /// An item of `Choice` for an enumeration.
    fn choice_item(&self, item: &TokenStream) -> TokenStream {
        self.trait_item(&quote!(Choice), item)
    }

    /// An item of the trait that resets, copies or saves an element: the third for a field that is no enumeration.
    fn element_item(&self, item: &TokenStream, trait_of_item: &TokenStream) -> TokenStream {
        match (self.role, self.of_type) {
            (Role::Nested, _) => self.trait_item(&quote!(Variables), item),
            (_, FmiType::Enumeration) => self.choice_item(item),
            _ => self.trait_item(trait_of_item, item),
        }
    }

    /// An item of `Variables` for a nested struct; `None` for other fields.
    fn nested_item(&self, item: &TokenStream) -> Option<TokenStream> {
        (self.role == Role::Nested).then(|| self.trait_item(&quote!(Variables), item))
    }

    /// The number of its first scalar.
    fn first_scalar(&self) -> TokenStream {
        let (krate, row) = (&self.krate, self.row);
        quote!(const { #krate::first(Self::ROWS, #row) })
    }

    /// The rows of the field in the table: a row for each nested struct; none if the field is internal.
    pub fn rows(&self) -> Vec<TokenStream> {
        let (Self { ident, krate, name, .. }, ty) = (self, self.element_type());
        let Some(rows) = self.nested_item(&quote!(ROWS)) else {
            return self.row().into_iter().collect();
        };
        let rows = self.changed(rows);
        let group = |i: usize| {
            let prefix = match self.dimensions().is_empty() {
                true => name.value(),
                false => format!("{}[{}]", name.value(), i + 1),
            };
            let offset = quote!(::core::mem::offset_of!(Self, #ident) + #i * size_of::<#ty>());
            quote!(#krate::TableRow::Group { prefix: #prefix, offset: #offset, rows: #rows })
        };
        (0..self.row_count()).map(group).collect()
    }

    /// The changes of variables of a nested struct, in the order in which they are made.
    fn changes(&self) -> impl Iterator<Item = (&LitStr, TokenStream)> {
        let krate = &self.krate;
        self.options.variables().flat_map(move |(name, options)| {
            let unit = options.text("unit").map(|unit| quote!(Unit(#unit)));
            let real = |option| options.expression(option).map(Expression::real);
            let min = real("min").map(|min| quote!(Min(#min)));
            let max = real("max").map(|max| quote!(Max(#max)));
            let start = options.expression("start").map(start_change);
            let changes = [unit, min, max, start].into_iter().flatten();
            changes.map(move |change| (name, quote!(#krate::Change::#change)))
        })
    }

    /// The rows of a nested struct with its changes.
    fn changed(&self, rows: TokenStream) -> TokenStream {
        let krate = &self.krate;
        let changes: Vec<_> =
            self.changes().map(|(name, change)| quote!((#name, #change))).collect();
        match changes.is_empty() {
            true => rows,
            false => quote!({
                const CHANGED: [#krate::TableRow; #rows.len()] =
                    #krate::changed(#rows, &[#(#changes),*]);
                &CHANGED
            }),
        }
    }

    /// Checks of the changes of a nested struct, which the compiler makes.
    pub fn change_checks(&self) -> TokenStream {
        let (krate, rows) = (&self.krate, self.nested_item(&quote!(ROWS)));
        let changes: Vec<_> =
            self.changes().map(|(name, change)| quote!((#name, #change))).collect();
        let checks = self.changes().enumerate().map(|(i, (name, _))| {
            let check = quote!(#krate::check_change(#rows, &[#(#changes),*], #i));
            respan(name.span(), quote!(const _: () = #check;))
        });
        quote!(#(#checks)*)
    }

    /// The row of a variable.
    fn row(&self) -> Option<TokenStream> {
        let Self { ident, krate, name, description, options, .. } = self;
        let offset = quote!(::core::mem::offset_of!(Self, #ident));
        let causality = match self.role {
            role if !role.has_rows() => return None,
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
            _ if self.of_type.is_float() && !options.has("discrete") && !options.has("clocks") => {
                quote!(Continuous)
            }
            _ => quote!(Discrete),
        };
        let dynamics = match (self.role, options.text("of")) {
            (Role::Derivative, Some(of)) => quote!(Derivative { of: #of }),
            (Role::EventIndicator, _) => quote!(EventIndicator),
            _ if options.has("state") => quote!(State),
            _ => quote!(Algebraic),
        };
        let nominal = options.expression("nominal");
        let nominal = nominal.map_or_else(|| quote!(1.0), |n| n.positive("nominal", krate));
        let text = |option| options.text(option).map(LitStr::value).unwrap_or_default();
        let [size, unit, terminal, network] = ["size", "unit", "terminal", "network"].map(text);
        let display_unit = self.display_unit();
        let (aliases, deprecated) = (options.names("alias"), &self.deprecated);
        let history = match aliases.is_empty() && deprecated.is_empty() {
            true => quote!(::core::option::Option::None),
            false => quote!(::core::option::Option::Some(&#krate::History {
                aliases: &[#(#aliases),*],
                deprecated: #deprecated,
            })),
        };
        let mime_type = match self.of_type {
            FmiType::Binary if !options.has("mime_type") => "application/octet-stream".into(),
            _ => text("mime_type"),
        };
        let (dimensions, bounds, start) = (self.dimensions(), self.bounds(), self.start());
        let initially_from = match options.has("initially_from") {
            true => {
                let names = options.names("initially_from");
                quote!(::core::option::Option::Some(&[#(#names),*]))
            }
            false => quote!(::core::option::Option::None),
        };
        let clocks = options.names("clocks");
        let depends_on = options.derivatives().iter().map(|(name, _)| name);
        let has_input_derivative = options.has("derivative");
        Some(quote! {
            #krate::TableRow::Variable(#krate::Declaration {
                name: #name,
                description: #description,
                history: #history,
                offset: #offset,
                causality: #krate::Causality::#causality,
                variability: #krate::Variability::#variability,
                dimensions: &[#(#dimensions),*],
                size: #size,
                start: #start,
                bounds: #krate::Bounds::#bounds,
                unit: #unit,
                display_unit: #display_unit,
                mime_type: #mime_type,
                clocks: &[#(#clocks),*],
                initially_from: #initially_from,
                dynamics: #krate::Dynamics::#dynamics,
                nominal: #nominal,
                depends_on: &[#(#depends_on),*],
                has_input_derivative: #has_input_derivative,
                terminal: #terminal,
                network: #network,
            })
        })
    }

    /// The condition under which this field keeps the struct from being saved; `None` if it never does.
    pub fn is_unsaved(&self) -> Option<TokenStream> {
        match self.role {
            Role::Unsaved => Some(quote!(true)),
            _ => self.nested_item(&quote!(IS_UNSAVED)),
        }
    }

    /// The condition under which this field keeps the struct from being serialized; `None` if it never does.
    pub fn is_unserialized(&self) -> Option<TokenStream> {
        match self.role {
            Role::Unsaved | Role::Copied => Some(quote!(true)),
            _ => self.nested_item(&quote!(IS_UNSERIALIZED)),
        }
    }

    /// For each nested struct of the field: its place, and the number of its first scalar.
    fn places(&self) -> Vec<(TokenStream, TokenStream)> {
        let (ident, first) = (&self.ident, self.first_scalar());
        if self.role != Role::Nested || self.dimensions().is_empty() {
            return vec![(quote!(self.#ident), first)];
        }
        let count = self.nested_item(&quote!(COUNT));
        let place = |i: usize| (quote!(self.#ident[#i]), quote!(const { #i * #count + #first }));
        (0..self.row_count()).map(place).collect()
    }

    /// The arms of `input_derivative`.
    pub fn input_derivative(&self) -> Option<TokenStream> {
        let first = self.first_scalar();
        if let Some(derivative) = self.nested_item(&quote!(input_derivative)) {
            let count = self.nested_item(&quote!(COUNT));
            let arms = self.places().into_iter().map(|(place, first)| {
                quote! {
                    _ if index.wrapping_sub(#first) < const { #count } => {
                        #derivative(&mut #place, index.wrapping_sub(#first))
                    }
                }
            });
            return Some(arms.collect());
        }
        let place = self.options.expression("derivative")?;
        Some(quote!(_ if index == #first => ::core::option::Option::Some(&mut #place),))
    }

    /// The arms of `clock_timing`, of clocks whose timing the model calculates.
    pub fn clock_timing(&self) -> Option<TokenStream> {
        let krate = &self.krate;
        if let Some(timing) = self.nested_item(&quote!(clock_timing)) {
            let count = self.nested_item(&quote!(COUNT));
            let arms = self.places().into_iter().map(|(place, first)| {
                quote! {
                    _ if index.wrapping_sub(#first) < const { #count } => {
                        #timing(&#place, index.wrapping_sub(#first))
                    }
                }
            });
            return Some(arms.collect());
        }
        let (interval, shift) = clock::calculated(self)?;
        let first = self.first_scalar();
        Some(quote! {
            _ if index == #first => {
                ::core::option::Option::Some(#krate::Timing { interval: #interval, shift: #shift })
            }
        })
    }

    /// The arms of `directional_derivative`, with respect to other fields of the struct.
    pub fn directional_derivatives(&self, others: &[Self]) -> TokenStream {
        let first = self.first_scalar();
        if let Some(derivative) = self.nested_item(&quote!(directional_derivative)) {
            let count = self.nested_item(&quote!(COUNT));
            let arms = self.places().into_iter().map(|(place, first)| {
                quote! {
                    _ if unknown.wrapping_sub(#first) < const { #count }
                        && known.wrapping_sub(#first) < const { #count } =>
                    {
                        let (unknown, known) = (unknown - #first, known - #first);
                        #derivative(&#place, unknown, known)
                    }
                }
            });
            return arms.collect();
        }
        let arms = self.options.derivatives().iter().filter_map(|(name, value)| {
            let known = others.iter().find(|other| other.is_named(name))?.first_scalar();
            let value = value.real();
            Some(quote!(_ if unknown == #first && known == #known => #value,))
        });
        quote!(#(#arms)*)
    }

    /// The condition of `has_finite_outputs` on the field, or on the elements of an array that are in use.
    pub fn has_finite_outputs(&self, others: &[Self]) -> Option<TokenStream> {
        let (ident, krate) = (&self.ident, &self.krate);
        if let Some(has) = self.nested_item(&quote!(has_finite_outputs)) {
            let places = self.places().into_iter().map(|(place, _)| place);
            return Some(quote!(true #(&& #has(&#places))*));
        }
        if self.role != Role::Output || !self.of_type.is_float() {
            return None;
        }
        let dimensions = self.dimensions().len();
        let size = others.iter().find(|parameter| parameter.is_size_of(self));
        Some(match (dimensions, size.map(|size| &size.ident)) {
            (0, _) => quote!(#krate::is_finite(&self.#ident)),
            (_, Some(size)) => {
                quote!(#krate::are_finite(#krate::in_use(&self.#ident, self.#size)))
            }
            _ => {
                let flatten = (1..dimensions).map(|_| quote!(.as_flattened()));
                quote!(#krate::are_finite(&self.#ident #(#flatten)*))
            }
        })
    }

    /// The value in a new struct. `Default` and `Deserialize` end at 32 elements.
    pub fn unset(&self) -> TokenStream {
        let ident = &self.ident;
        if let Some(fresh) = self.options.expression("fresh") {
            let fresh = fresh.authored();
            return quote!(#ident: #fresh);
        }
        let value = self.element_item(&quote!(unset()), &quote!(HasDefault));
        let value = self.for_elements(value, |value| quote!(::core::array::from_fn(|_| #value)));
        quote!(#ident: #value)
    }

    /// A function of the module by which the field is saved; `None` for other fields.
    fn function_of_author(&self, name: &str) -> Option<TokenStream> {
        let module = self.options.expression("with")?;
        let name = Ident::new(name, module.span());
        Some(respan(module.span(), quote!(#module::#name)))
    }

    /// The statement that copies the field into the same field of this struct.
    pub fn copy_from(&self) -> TokenStream {
        let (ident, krate, ty) = (&self.ident, &self.krate, &self.ty);
        let [save, load] = ["save", "load"].map(|name| self.function_of_author(name));
        if let (Some(save), Some(load)) = (save, load) {
            return quote!(self.#ident = #load(#save(&from.#ident)););
        }
        let copy = match (self.role, self.dimensions().is_empty()) {
            (Role::Nested, false) => {
                let copy = self.nested_item(&quote!(copy_from));
                return quote!(for (to, from) in self.#ident.iter_mut().zip(&from.#ident) { #copy(to, from) });
            }
            (_, true) => self.element_item(&quote!(copy_from), &quote!(HasClone)),
            (_, false) => respan(ty.span(), quote!(<#ty as #krate::HasClone>::copy_from)),
        };
        quote!(#copy(&mut self.#ident, &from.#ident);)
    }

    /// The statement that saves the field.
    pub fn save(&self) -> TokenStream {
        let ident = &self.ident;
        if let Some(save) = self.function_of_author("save") {
            return quote!(to.put(&#save(&self.#ident))?;);
        }
        let save = self.element_item(&quote!(save(item, to)?;), &quote!(HasSerialize));
        let items = self.for_elements(save, |item| quote!(for item in item { #item }));
        quote!({ let item = &self.#ident; #items })
    }

    /// The statement that loads the field.
    pub fn load(&self) -> TokenStream {
        let ident = &self.ident;
        if let Some(load) = self.function_of_author("load") {
            return quote!(self.#ident = #load(from.take()?););
        }
        let load = self.element_item(&quote!(load(item, from)?;), &quote!(HasDeserialize));
        let items = self.for_elements(load, |item| quote!(for item in item { #item }));
        quote!({ let item = &mut self.#ident; #items })
    }

    /// The name and the type of the field in a saved state, and the layout of a nested struct.
    pub fn state_layout(&self) -> TokenStream {
        let (name, mut type_name) = (self.ident.to_string(), self.ty.to_token_stream().to_string());
        type_name.retain(|c| !c.is_whitespace()); // the spaces depend on the compiler
        let layout = self.nested_item(&quote!(STATE_LAYOUT)).unwrap_or(quote!(0));
        quote!((#name, #type_name, #layout))
    }

    /// The code for all elements of an array, from the code for an element.
    fn for_elements(
        &self,
        of_element: TokenStream,
        of_elements: fn(TokenStream) -> TokenStream,
    ) -> TokenStream {
        let dimensions = self.dimensions();
        dimensions.iter().fold(of_element, |inner, _| of_elements(inner))
    }
}

/// Fixed value references.
impl Field {
    /// The value references that the field fixes: where each is given, and its row of the table of the model.
    pub fn fixed_references(&self) -> Vec<(Span, TokenStream)> {
        let (krate, row, rows, prefix) =
            (&self.krate, self.row, self.row_count(), self.name.value());
        let fixed = |name: String, reference: &Expression| {
            let place = reference.span();
            let number = respan(place, quote!({ let reference: u32 = #reference; reference }));
            let fixed = quote!(#krate::FixedReference {
                row: #row, rows: #rows, name: #name, reference: #number as usize,
            });
            (place, fixed)
        };
        let all = self.options.expression("reference").map(|all| fixed(String::new(), all));
        let single = self.options.references().iter().map(|(name, reference)| {
            let name = name.value();
            let full = match (prefix.is_empty(), name.starts_with('[')) {
                (true, _) => name,
                (false, true) => format!("{prefix}{name}"),
                (false, false) => format!("{prefix}.{name}"),
            };
            fixed(full, reference)
        });
        all.into_iter().chain(single).collect()
    }
}

/// The start value of a variable whose type is known to the compiler only.
fn start_change(value: &Expression) -> TokenStream {
    let (innermost, depth) = value.innermost();
    let slice = |value: TokenStream| match depth {
        0 => quote!(&[#value]),
        _ => {
            let flatten = (1..depth).map(|_| quote!(.as_flattened()));
            quote!({ const { &#value } #(#flatten)* })
        }
    };
    match &innermost.form {
        Form::Literal(Lit::Bool(_)) => {
            let values = slice(value.authored());
            quote!(Booleans(#values))
        }
        Form::Literal(Lit::Str(_)) => {
            let values = slice(value.authored());
            quote!(Texts(#values))
        }
        _ => {
            let (numbers, real) = (slice(value.real()), innermost.real());
            let whole = if depth == 0 { quote!(&[#real as i32]) } else { quote!(&[]) };
            quote!(Numbers(#numbers, #whole))
        }
    }
}

/// Start values and bounds.
impl Field {
    /// An expression as a value of the type, in which whole numbers may stand for real ones, and items for their
    /// numbers.
    fn value(&self, expression: &Expression) -> TokenStream {
        match (&expression.form, self.of_type) {
            (_, of_type) if of_type.is_float() => expression.real(),
            (Form::Array(elements), FmiType::Enumeration) => {
                let elements = elements.iter().map(|element| self.value(element));
                quote!([#(#elements),*])
            }
            (Form::Repeat(element, length), FmiType::Enumeration) => {
                let element = self.value(element);
                quote!([#element; #length])
            }
            (_, FmiType::Enumeration) => {
                let (ty, base) = (self.element_type(), self.choice_item(&quote!(BASE)));
                quote!({ let item: #ty = #expression; item as i32 + #base })
            }
            _ => expression.authored(),
        }
    }

    /// The bounds, each written in the type of the field.
    fn bounds(&self) -> TokenStream {
        let ty = self.element_type();
        let common = match self.of_type {
            of_type if of_type.is_float() => quote!(f64),
            of_type if of_type.is_integer() => quote!(i128),
            _ => {
                let max = self.options.expression("max_size").map(Expression::authored);
                return max
                    .map_or(quote!(None), |max| quote!(Size({ let max: usize = #max; max })));
            }
        };
        let bound = |option, real, whole| match self.options.expression(option) {
            Some(bound) => {
                let bound = self.value(bound);
                quote!({ let bound: #ty = #bound; bound as #common })
            }
            None if self.of_type.is_float() => real,
            None => quote!(#ty::#whole as i128),
        };
        let min = bound("min", quote!(f64::NEG_INFINITY), quote!(MIN));
        let max = bound("max", quote!(f64::INFINITY), quote!(MAX));
        if self.of_type.is_float() { quote!(Real(#min, #max)) } else { quote!(Whole(#min, #max)) }
    }

    /// The type with the start values.
    fn start(&self) -> TokenStream {
        let (krate, values) = (&self.krate, self.values());
        if self.is_clock() {
            let clock = clock::row(self);
            return quote!(#krate::TypedStart::Clock(&#clock));
        }
        if self.of_type == FmiType::Enumeration {
            let items = self.choice_item(&quote!(ENUMERATION));
            return quote!(#krate::TypedStart::Enumeration(#values, &#items));
        }
        let place = self.options.expression("start").map_or(self.span(), Spanned::span);
        let of_type = Ident::new(self.of_type.as_str(), place);
        respan(place, quote!(#krate::TypedStart::#of_type(#values)))
    }

    /// Checks of the start values and the bounds of a number in the table of its struct, which the compiler makes.
    pub fn value_checks(&self, table: &TokenStream) -> TokenStream {
        let (krate, row) = (&self.krate, self.row);
        let [start, min, max] = ["start", "min", "max"].map(|name| self.options.expression(name));
        let order = min.zip(max).map(|(min, max)| {
            let message = format!("expected a maximum of at least {min}, the minimum");
            let check = quote!(#krate::check_bounds(#table, #row, #message));
            respan(max.span(), quote!(const _: () = #check;))
        });
        let max_size = self.options.expression("max_size");
        let is_checked = min.or(max).is_some()
            || start.is_some() && (self.of_type.is_float() || max_size.is_some());
        let values = is_checked.then(|| {
            let expected = match max_size {
                Some(max) => format!(" of at most {max} bytes"),
                None => words::bounds(min, max),
            };
            let (place, message) = match start {
                Some(start) => {
                    (start.span(), format!("outside the bounds; expected a start value{expected}"))
                }
                None => (
                    self.span(),
                    format!("without `start`, it starts at 0; expected a start value{expected}"),
                ),
            };
            let check = quote!(#krate::check_start(#table, #row, #message));
            respan(place, quote!(const _: () = #check;))
        });
        let clock = self.is_clock().then(|| {
            let resolution = self.options.expression("resolution");
            let place = resolution.map_or(self.span(), Spanned::span);
            let check = quote!(#krate::check_clock(#table, #row));
            respan(place, quote!(const _: () = #check;))
        });
        quote!(#order #values #clock)
    }

    /// The start values as a constant slice; empty if the model calculates them.
    fn values(&self) -> TokenStream {
        let Some(start) = self.options.expression("start") else {
            let zero = match self.of_type {
                _ if !self.is_settable() => return quote!(&[]),
                FmiType::Float32 | FmiType::Float64 => quote!(0.0),
                FmiType::Boolean => quote!(false),
                FmiType::String => quote!(""),
                FmiType::Binary => quote!(b""),
                FmiType::Enumeration => {
                    let enumeration = self.choice_item(&quote!(ENUMERATION));
                    quote!(#enumeration.items[0].value)
                }
                _ => quote!(0),
            };
            return self.slice(&zero, true);
        };
        // An item cannot be distinguished from a constant array, and a constant array of items is unusual.
        let is_item = self.of_type == FmiType::Enumeration && matches!(start.form, Form::Other);
        self.slice(&self.value(start), start.is_literal() || is_item)
    }

    /// A value as a constant slice: of all scalars, or `is_scalar` if all elements of an array have it.
    fn slice(&self, value: &TokenStream, is_scalar: bool) -> TokenStream {
        let dimensions = self.dimensions();
        if dimensions.is_empty() || is_scalar {
            return quote!(&[#value]);
        }
        let repeated = |value| {
            let lengths = dimensions.iter().rev();
            lengths.fold(value, |inner, length| quote!([#inner; #length]))
        };
        let array = match self.options.expression("start") {
            // An error of its type is shown there.
            Some(start) => respan(start.span(), quote!(&#value)),
            None => quote!(&#value),
        };
        // In a start value, numbers stand for items, and string slices for strings.
        let ty = repeated(match self.of_type {
            FmiType::Enumeration => quote!(i32),
            FmiType::String => quote!(&'static str),
            FmiType::Binary => quote!(&'static [u8]),
            _ => self.element_type().to_token_stream(),
        });
        let flatten = (1..dimensions.len()).map(|_| quote!(.as_flattened()));
        quote!({ let start: &'static #ty = const { #array }; start #(#flatten)* })
    }
}
