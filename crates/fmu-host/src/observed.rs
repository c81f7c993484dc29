//! What an observer sees of a call: the function, its arguments before and after, the status and the duration.

use std::ffi::{c_char, c_int, c_void};
use std::slice;
use std::time::Duration;

use fmi_abi::fmi2::{fmi2EventInfo, fmi2Status};
use fmi_abi::fmi3::fmi3Binary;

use crate::logger::{LogMessage, text};

/// Observes the calls of a library that [`Library::load_observed`](crate::Library::load_observed) has loaded, or of one
/// instance ([`Instantiation::observer`](crate::Instantiation)). Calls of different instances may be observed at the same
/// time.
pub trait CallObserver: Send + Sync {
    /// A function is about to be called.
    fn begin(&self, call: &ObservedCall<'_>);

    /// The function has returned, with this status if it has one.
    fn end(&self, _call: &ObservedCall<'_>, _status: Option<c_int>, _duration: Duration) {}

    /// The FMU has logged a message.
    fn log(&self, _message: &LogMessage) {}

    /// A WebAssembly component has ended the call with a trap.
    fn trapped(&self) {}
}

/// A call of a function of FMI, or the loading of a binary. Its arguments have the names of the rows of `fmi-abi`.
pub struct ObservedCall<'a> {
    /// The function, or [`ObservedCall::LOADING`].
    pub function: &'static str,
    pub(crate) arguments: &'a [Argument<'a>],
}

/// An argument of a call.
pub(crate) struct Argument<'a> {
    pub(crate) name: &'static str,
    pub(crate) direction: Direction,
    pub(crate) values: Values<'a>,
}

/// Who reads and who writes an argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// The FMU reads it.
    In,
    /// The FMU writes it.
    Out,
    /// The FMU reads and writes it.
    Both,
    /// It is the length of lists, which says nothing more than they do.
    Length,
}

/// The values of an argument.
pub(crate) enum Values<'a> {
    One(Element),
    List(&'a dyn List),
    Bytes(&'a [u8]),
    /// Binaries, whose sizes are the argument `sizes`.
    Binaries(&'a [fmi3Binary]),
}

/// A value, or an element of a list. Booleans, statuses and lengths are integers, as the FMU may write any value.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "their names say it")]
pub enum Element {
    Integer(i128),
    Float32(f32),
    Float64(f64),
    /// `None` for NULL.
    Text(Option<String>),
    /// A Binary, or a serialized state; `None` for NULL.
    Bytes(Option<Vec<u8>>),
    /// The address of an FMU state, 0 for NULL.
    State(usize),
}

impl ObservedCall<'_> {
    /// What the loading of a binary is called.
    pub const LOADING: &'static str = "load";

    /// The names and directions of the arguments.
    pub fn arguments(&self) -> impl Iterator<Item = (&'static str, Direction)> {
        self.arguments.iter().map(|argument| (argument.name, argument.direction))
    }

    /// The argument with this index: passes its elements to `receive`, and returns whether it is a list.
    pub fn elements(&self, index: usize, receive: &mut dyn FnMut(Element)) -> bool {
        match &self.arguments[index].values {
            Values::One(element) => receive(element.clone()),
            Values::Bytes(bytes) => receive(Element::Bytes(Some(bytes.to_vec()))),
            Values::List(list) => {
                list.each(receive);
                return true;
            }
            Values::Binaries(pointers) => {
                let mut sizes = Vec::new();
                if let Some(of) = self.arguments.iter().position(|other| other.name == "sizes") {
                    self.elements(of, &mut |size| sizes.push(size));
                }
                for (pointer, size) in pointers.iter().zip(sizes) {
                    let Element::Integer(size) = size else { continue };
                    let is_empty = pointer.is_null() || size == 0;
                    // SAFETY: not NULL by the check; the caller of the function, or the FMU until its next call, promises
                    // so many bytes.
                    let bytes = || unsafe { slice::from_raw_parts(*pointer, size as usize) };
                    let bytes = if is_empty { &[] } else { bytes() };
                    receive(Element::Bytes((!pointer.is_null()).then(|| bytes.to_vec())));
                }
                return true;
            }
        }
        false
    }
}

/// A list of an argument.
pub(crate) trait List {
    fn each(&self, receive: &mut dyn FnMut(Element));
}

impl<T: ToElement> List for &[T] {
    fn each(&self, receive: &mut dyn FnMut(Element)) {
        self.iter().for_each(|value| receive(value.element()));
    }
}

/// A value in C as an element.
pub(crate) trait ToElement {
    fn element(&self) -> Element;
}

macro_rules! elements {
    ($($type:ty: $value:ident => $element:expr;)*) => { $(
        impl ToElement for $type {
            fn element(&self) -> Element {
                let $value = self;
                $element
            }
        }
    )* };
}

elements! {
    bool: value => Element::Integer((*value).into());
    i8: value => Element::Integer((*value).into());
    u8: value => Element::Integer((*value).into());
    i16: value => Element::Integer((*value).into());
    u16: value => Element::Integer((*value).into());
    i32: value => Element::Integer((*value).into());
    u32: value => Element::Integer((*value).into());
    i64: value => Element::Integer((*value).into());
    u64: value => Element::Integer((*value).into());
    usize: value => Element::Integer(*value as i128);
    fmi2Status: value => Element::Integer(value.0.into());
    f32: value => Element::Float32(*value);
    f64: value => Element::Float64(*value);
    *mut c_void: value => Element::State(value.addr());
    &str: value => Element::Text(Some((*value).to_owned()));
    Option<&str>: value => Element::Text(value.map(str::to_owned));
    Element: value => value.clone();
}

impl ToElement for *const c_char {
    fn element(&self) -> Element {
        // SAFETY: a string of the host, or one of the FMU that it has just returned, which by the standard is valid until
        // its next call.
        Element::Text(unsafe { text(*self) })
    }
}

/// The fields of `fmi2EventInfo`, in the order of the standard.
pub(crate) fn fields(info: &fmi2EventInfo) -> [Element; 6] {
    [
        info.newDiscreteStatesNeeded.element(),
        info.terminateSimulation.element(),
        info.nominalsOfContinuousStatesChanged.element(),
        info.valuesOfContinuousStatesChanged.element(),
        info.nextEventTimeDefined.element(),
        info.nextEventTime.element(),
    ]
}

/// An [`Argument`] of a row, such as `values` and `[in f64; n]`, whose value in Rust has its name.
macro_rules! argument {
    // Serialized states, unlike variables of the type UInt8.
    ($arg:ident [in? $type:ident; $n:ident]) => {
        argument!(@ $arg In $crate::observed::Values::Bytes(&$arg[..$n]))
    };
    ($arg:ident [out? $type:ident; $n:ident]) => {
        argument!(@ $arg Out $crate::observed::Values::Bytes(&$arg[..$n]))
    };
    ($arg:ident [in fmi3Binary; $n:ident]) => {
        argument!(@ $arg In $crate::observed::Values::Binaries(&$arg[..$n]))
    };
    ($arg:ident [out fmi3Binary; $n:ident]) => {
        argument!(@ $arg Out $crate::observed::Values::Binaries(&$arg[..$n]))
    };
    ($arg:ident [in $type:ident; $n:ident]) => {
        argument!(@ $arg In $crate::observed::Values::List(&&$arg[..$n]))
    };
    ($arg:ident [out $type:ident; $n:ident]) => {
        argument!(@ $arg Out $crate::observed::Values::List(&&$arg[..$n]))
    };
    ($arg:ident [len]) => { argument!(@ $arg Length $crate::observed::Values::One($arg.element())) };
    ($arg:ident [out fmi2EventInfo]) => {
        argument!(@ $arg Out $crate::observed::Values::List(&&$crate::observed::fields($arg)[..]))
    };
    ($arg:ident [out? fmi2FMUstate]) => {
        argument!(@ $arg Both $crate::observed::Values::One((*$arg).element()))
    };
    ($arg:ident [out? fmi3FMUState]) => {
        argument!(@ $arg Both $crate::observed::Values::One((*$arg).element()))
    };
    ($arg:ident [out $(?)? $type:ident]) => {
        argument!(@ $arg Out $crate::observed::Values::One((*$arg).element()))
    };
    ($arg:ident fmi2FMUstate) => {
        argument!(@ $arg In $crate::observed::Values::One((*$arg).element()))
    };
    ($arg:ident fmi3FMUState) => {
        argument!(@ $arg In $crate::observed::Values::One((*$arg).element()))
    };
    ($arg:ident $type:ty) => { argument!(@ $arg In $crate::observed::Values::One($arg.element())) };
    (@ $arg:ident $direction:ident $values:expr) => {
        $crate::observed::Argument {
            name: stringify!($arg),
            direction: $crate::observed::Direction::$direction,
            values: $values,
        }
    };
}
pub(crate) use argument;

/// Makes a call whose value is its status, and tells an observer before and after.
macro_rules! observe {
    ($observer:expr, $name:expr, $arguments:expr, $call:expr) => {{
        let (observer, function) = ($observer, $name);
        observer.begin(&$crate::observed::ObservedCall { function, arguments: &$arguments });
        let begun = Instant::now();
        let status = $call;
        let duration = begun.elapsed();
        let call = $crate::observed::ObservedCall { function, arguments: &$arguments };
        observer.end(&call, Some(status), duration);
        status
    }};
}
pub(crate) use observe;
