//! The derive macros of `fmu-export`, which re-exports and documents them.
#![forbid(unsafe_code)]

mod attributes;
mod choice;
mod expression;
mod field;
mod generate;
mod model;

use proc_macro::TokenStream;
use syn::{DeriveInput, Error, parse_macro_input};

/// Turns a struct into a model: its fields are the variables of an FMU.
///
/// The doc comment of the struct is the description of the model, up to the first empty line. The
/// fields have the attributes of [`derive@Variables`]. What the model does is an
/// implementation of `Simulate`, or of `Continuous`, and `export!` makes an FMU of it.
///
/// | `#[model(...)]` | Meaning | Default |
/// |---|---|---|
/// | `name = "Pd"` | name of the model and of its FMU, a C identifier | name of the struct |
/// | `sample_time = self.ts` | sample time in s, any expression of type `f64`: `step` is called once for each sample instant, and the outputs hold in between | none: `step` is called for each communication step |
/// | `continuous` | the model is described by equations that hold at any time: implement `Continuous` instead of `Simulate`, and it is for model exchange as well | no |
/// | `step = Self::step` | a function of a continuous model that takes its steps in co-simulation, as `Simulate::step`, instead of the integrator | none: it is integrated |
/// | `stop_time = 10` | stop time of the default experiment in s | 20 |
/// | `step_size = 0.01` | communication step size of the default experiment in s | 0.001 |
/// | `tolerance = 1e-8` | relative tolerance of the integrator, shown in the default experiment | 1e-6 if the model is integrated, otherwise none |
/// | `crate = path` | path of the crate `fmu_export` | `::fmu_export` |
///
/// ```
/// use fmu_export::prelude::*;
///
/// /// Sampled PD controller
/// #[derive(Model)]
/// #[model(sample_time = self.ts, stop_time = 10)]
/// pub struct Pd {
///     /// control error
///     #[input(unit = "rad")]
///     e: f64,
///     /// force
///     #[output(unit = "N")]
///     u: f64,
///     /// gain
///     #[parameter(tunable, start = 300, min = 0, unit = "N/rad")]
///     kp: f64,
///     /// damping
///     #[parameter(tunable, start = 10, min = 0, unit = "N.s/rad")]
///     kd: f64,
///     /// sample time
///     #[parameter(start = 0.001, min = 1e-6, unit = "s")]
///     ts: f64,
///     last: f64,
/// }
///
/// impl Simulate for Pd {
///     fn step(&mut self, _time: f64, step: f64) -> Result<(), ModelError> {
///         self.u = self.kp * self.e + self.kd * (self.e - self.last) / step;
///         self.last = self.e;
///         Ok(())
///     }
/// }
///
/// let mut pd = Pd::new(); // with the start values
/// pd.e = 0.5;
/// pd.step(0.0, pd.ts)?;
/// assert_eq!(pd.u, 300.0 * 0.5 + 10.0 * 0.5 / 0.001);
/// # Ok::<(), ModelError>(())
/// ```
#[proc_macro_derive(
    Model,
    attributes(
        model,
        variables,
        input,
        output,
        parameter,
        structural_parameter,
        local,
        constant,
        derivative,
        event_indicator,
        nested,
        log,
        unsaved
    )
)]
pub fn model(input: TokenStream) -> TokenStream {
    expand(parse_macro_input!(input), model::expand, model::stub)
}

/// Turns a struct into a group of variables, for a field of a model with `#[nested]`.
///
/// # Fields
/// The attribute of a field says what it is. A field without one is internal: it is no variable, but
/// it is reset, and saved with the FMU's state, as all fields.
///
/// | Attribute | Variable | Who sets it |
/// |---|---|---|
/// | `#[input]` | input | the host, at any time |
/// | `#[output]` | output | the model |
/// | `#[parameter]` | fixed parameter | the host, before the first step |
/// | `#[parameter(tunable)]` | tunable parameter | the host, at any time |
/// | `#[structural_parameter]`, of type `u64` | number of elements in use of arrays with the option `size` | the host, in configuration mode of FMI 3.0 |
/// | `#[local]` | local variable, for inspection | the model |
/// | `#[constant(start = ...)]` | local constant | nobody |
/// | `#[derivative(of = x)]` | local variable `der(x)`, the time derivative of a state of the same struct | the model |
/// | `#[event_indicator]` | local variable; where it changes its sign, an event happens | the model |
/// | `#[nested]` | the variables of another struct, with the name of the field before theirs: `pid.kp`; of an array of structs, `pid[1].kp` | |
/// | `#[log]` | none: the `Log` of a model | |
/// | `#[unsaved]` | none: an internal field that is no part of the state of the FMU, which then cannot be saved | |
/// | none | none; the type implements `Default`, `Clone`, `Serialize` and `Deserialize` | the model |
///
/// # Types
///
/// | Type | FMI type | Start value if there is no `start` |
/// |---|---|---|
/// | `f64` | Float64, which is called Real in FMI 2.0; continuous unless it is `discrete` or the model has a sample time | 0 |
/// | `f32` | Float32, which is a Real in FMI 2.0; as `f64` | 0 |
/// | `i8` to `i64`, `u8` to `u64` | Int8 to UInt64, all of which are an Integer of 32 bits in FMI 2.0 | 0 |
/// | `bool` | Boolean | false |
/// | `String` | String | empty |
/// | `Vec<u8>` | Binary, which FMI 2.0 does not have | empty |
/// | an enum with [`derive@Choice`] | Enumeration | the first item |
/// | `[T; N]`, `[[T; M]; N]`, ... | scalars `w[1]`, `w[2]` or `w[1,1]`, ... of these types | as its elements |
///
/// Outputs and local variables without `start` have no start value; `initialize` calculates it.
///
/// # Options
///
/// | Option | For | Meaning |
/// |---|---|---|
/// | `name = "valve.flow"` | all | name of the variable instead of the field's name: letters, digits and underscores, with periods between parts |
/// | `description = "..."` | all | description instead of the doc comment, of which it is the text up to the first empty line, without backticks and the unit in parentheses |
/// | `unit = "N.s/m"` | `f64`, `f32` | a [`Unit`](fmu_description::unit) |
/// | `start = 0.5` | all | start value, a constant expression; of an array, an array or one value for all elements |
/// | `mime_type = "image/png"` | `Vec<u8>` | MIME type of the bytes, `application/octet-stream` if it is not given |
/// | `min = 0`, `max = 1` | numbers | bounds, constant expressions; the layer refuses values outside |
/// | `size = "nodes"` | arrays of one dimension | the structural parameter of this struct that is the number of elements in use, which are the first ones |
/// | `tunable` | parameters | the host may set it between steps; a structural parameter in reconfiguration mode, after which [`reconfigure`](trait.Simulate.html#method.reconfigure) is called |
/// | `discrete` | inputs, outputs and local variables of type `f64` or `f32` | changes at certain instants only |
/// | `state` | outputs and local variables of type `f64` | a continuous state; a field with `#[derivative(of = ...)]` has its derivative |
/// | `nominal = 0.1` | inputs, outputs and local variables of type `f64` or `f32` | order of magnitude, 1 if it is not given |
/// | `initially_from("y0", "pid.kp")` | outputs and local variables | variables of this struct that the value after the initialization depends on; those of an array of the same dimensions element by element; none: `initially_from()`; without this option, all |
/// | `derivative = self.u_rate` | inputs of type `f64` | the host may set the time derivative of the input, which is stored in this field |
/// | `derivative_by(u = self.slope())` | outputs, derivatives and event indicators of type `f64`, with equations | derivatives of the variable with respect to inputs and states of this struct, expressions of type `f64`; it depends on no others |
/// | `terminal = "loop.u"` | inputs and outputs | the terminal of FMI 3.0 that it belongs to, and its name there; tools connect terminals with the same members by one line |
/// | `prefix = "spare.pump"` | `#[nested]` | what to write before the names, instead of the name of the field |
/// | `flatten` | `#[nested]` | the names are kept as they are |
///
/// A name has at most 63 characters, and structs are nested at most four deep.
///
/// | `#[variables(...)]` | Meaning |
/// |---|---|
/// | `default` | the struct is created with its `Default` instead of field by field; start values are set afterwards |
/// | `crate = path` | path of the crate `fmu_export`, or of `fmu_description`, on which the traits depend |
///
/// ```
/// use fmu_export::prelude::*;
///
/// /// PI controller with two channels
/// #[derive(Model)]
/// pub struct TwoChannels {
///     #[nested]
///     first: Pi,
///     #[nested(prefix = "second")]
///     other: Pi,
///     /// gains of both channels
///     #[parameter(start = [1, 0.5])]
///     gains: [f64; 2],
/// }
///
/// #[derive(Variables)]
/// struct Pi {
///     /// control error
///     #[input]
///     e: f64,
///     /// control
///     #[output]
///     u: f64,
///     /// integral time
///     #[parameter(start = 2.0, min = 1e-3, unit = "s")]
///     ti: f64,
///     integral: f64,
/// }
///
/// impl Pi {
///     fn step(&mut self, gain: f64, h: f64) {
///         self.integral += self.e * h;
///         self.u = gain * (self.e + self.integral / self.ti);
///     }
/// }
///
/// impl Simulate for TwoChannels {
///     fn step(&mut self, _time: f64, step: f64) -> Result<(), ModelError> {
///         self.first.step(self.gains[0], step);
///         self.other.step(self.gains[1], step);
///         Ok(())
///     }
/// }
///
/// // first.e, first.u, first.ti, second.e, second.u, second.ti, gains[1], gains[2]
/// assert_eq!(<TwoChannels as Variables>::COUNT, 8);
/// ```
#[proc_macro_derive(
    Variables,
    attributes(
        variables,
        input,
        output,
        parameter,
        structural_parameter,
        local,
        constant,
        derivative,
        event_indicator,
        nested,
        log,
        unsaved
    )
)]
pub fn variables(input: TokenStream) -> TokenStream {
    expand(parse_macro_input!(input), model::expand_variables, model::stub_variables)
}

/// Turns an enum into the type of an enumeration variable.
///
/// The variants are the items; they have no fields and are `Copy`. Doc comments, up to the first empty
/// line, describe the type and the items. Items are numbered from 1, or as the discriminants say if any
/// is written. The first item is the default start value.
///
/// | `#[choice(...)]` | Of | Meaning | Default |
/// |---|---|---|---|
/// | `name = "Law"` | the enum | name of the type | name of the enum |
/// | `name = "p_only"` | a variant | name of the item | name of the variant, as `open_loop` for `OpenLoop` |
/// | `crate = path` | the enum | path of the crate `fmu_export`, or of `fmu_description` | `::fmu_export` |
///
/// ```
/// use fmu_export::prelude::*;
///
/// /// Form of the control law
/// #[derive(Debug, Clone, Copy, PartialEq, Choice)]
/// enum Law {
///     /// no feedback
///     OpenLoop,
///     /// proportional to the control error
///     #[choice(name = "p_only")]
///     P,
/// }
///
/// assert_eq!(Law::P.number(), 2);
/// assert_eq!(Law::from_number(1), Some(Law::OpenLoop));
/// assert_eq!(Law::ENUMERATION.items[0].name, "open_loop");
/// ```
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
