//! Repeats calls that were observed before: a function of an instance by its name, with arguments as elements. Made from
//! the rows of `fmi-abi`.

use std::collections::HashMap;
use std::ffi::{CString, c_char};
use std::ptr;

use fmi_abi::fmi2::*;
use fmi_abi::fmi3::*;
use fmi_abi::{fmi2_functions, fmi3_functions};

use crate::clocks::ClockUpdateMode;
use crate::functions::{Fmi2, Fmi3, Handle};
use crate::instance::Instance;
use crate::observed::Element;
use crate::outcome::Result;
use crate::types::FmuState;

/// A call to repeat. Arguments are those of [`ObservedCall`](crate::ObservedCall), by their names.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RepeatedCall {
    /// The function.
    pub function: String,
    /// What the FMU reads; the address of a state is a number that stands for it.
    pub given: Vec<(String, Vec<Element>)>,
    /// What the FMU wrote, as far as it is known.
    pub returned: Vec<(String, Vec<Element>)>,
}

/// The states of an instance by the numbers that stand for them.
#[derive(Default)]
pub struct RepeatedStates(HashMap<usize, FmuState>);

impl RepeatedCall {
    fn given(&self, name: &str) -> &[Element] {
        let given = self.given.iter().find(|(known, _)| known == name);
        given.map_or(&[], |(_, elements)| elements)
    }

    /// The number of elements of a list that the FMU writes.
    fn length(&self, name: &str) -> usize {
        self.given(name).first().map_or(0, usize::of)
    }

    /// The number of the state that the FMU wrote.
    fn returned_state(&self, name: &str) -> usize {
        let returned = self.returned.iter().find(|(known, _)| known == name);
        match returned.and_then(|(_, elements)| elements.first()) {
            Some(Element::State(number)) => *number,
            _ => 0,
        }
    }
}

impl RepeatedStates {
    fn take(&mut self, state: &[Element]) -> FmuState {
        let number = match state.first() {
            Some(Element::State(number)) => *number,
            _ => 0,
        };
        self.0.remove(&number).unwrap_or(FmuState(ptr::null_mut()))
    }

    fn keep(&mut self, number: usize, state: FmuState) {
        if number != 0 {
            self.0.insert(number, state);
        }
    }
}

/// A value in C of an element; a default one if it is of another kind.
trait OfElement {
    fn of(element: &Element) -> Self;
}

macro_rules! integers {
    ($($type:ty),*) => { $(
        impl OfElement for $type {
            fn of(element: &Element) -> Self {
                match element {
                    Element::Integer(value) => (*value).try_into().unwrap_or_default(),
                    _ => 0,
                }
            }
        }
    )* };
}
integers!(i8, u8, i16, u16, i32, u32, i64, u64, usize);

impl OfElement for f64 {
    fn of(element: &Element) -> Self {
        match element {
            Element::Float64(value) => *value,
            Element::Float32(value) => (*value).into(),
            Element::Integer(value) => *value as Self,
            _ => 0.0,
        }
    }
}

impl OfElement for f32 {
    fn of(element: &Element) -> Self {
        f64::of(element) as Self
    }
}

impl OfElement for bool {
    fn of(element: &Element) -> Self {
        i64::of(element) != 0
    }
}

/// Strings with pointers to them.
struct Texts {
    pointers: Vec<*const c_char>,
    _texts: Vec<Option<CString>>,
}

impl Texts {
    fn new(elements: &[Element]) -> Self {
        let text = |element: &Element| match element {
            Element::Text(Some(text)) => CString::new(text.as_str()).ok(),
            _ => None,
        };
        let texts = Vec::from_iter(elements.iter().map(text));
        let pointer = |text: &Option<CString>| text.as_ref().map_or(ptr::null(), |t| t.as_ptr());
        Self { pointers: texts.iter().map(pointer).collect(), _texts: texts }
    }
}

/// The bytes of elements.
fn bytes(elements: &[Element]) -> impl Iterator<Item = &[u8]> {
    elements.iter().map(|element| match element {
        Element::Bytes(Some(bytes)) => bytes.as_slice(),
        _ => &[],
    })
}

/// Makes the argument of a call.
macro_rules! given {
    ($call:ident $states:ident $arg:ident [in? $type:ident; $n:ident]) => {
        bytes($call.given(stringify!($arg))).next().unwrap_or_default()
    };
    ($call:ident $states:ident $arg:ident [in fmi2String; $n:ident]) => {
        Texts::new($call.given(stringify!($arg)))
    };
    ($call:ident $states:ident $arg:ident [in fmi3String; $n:ident]) => {
        Texts::new($call.given(stringify!($arg)))
    };
    ($call:ident $states:ident $arg:ident [in fmi3Binary; $n:ident]) => {
        Vec::from_iter(bytes($call.given(stringify!($arg))).map(<[u8]>::as_ptr))
    };
    ($call:ident $states:ident $arg:ident [in $type:ident; $n:ident]) => {
        Vec::from_iter($call.given(stringify!($arg)).iter().map(<$type>::of))
    };
    ($call:ident $states:ident $arg:ident [out? $type:ident; $n:ident]) => {
        vec![0_u8; $call.length(stringify!($n))]
    };
    ($call:ident $states:ident $arg:ident [out fmi2String; $n:ident]) => {
        vec![ptr::null(); $call.length(stringify!($n))]
    };
    ($call:ident $states:ident $arg:ident [out fmi3String; $n:ident]) => {
        vec![ptr::null(); $call.length(stringify!($n))]
    };
    ($call:ident $states:ident $arg:ident [out fmi3Binary; $n:ident]) => {
        vec![ptr::null(); $call.length(stringify!($n))]
    };
    ($call:ident $states:ident $arg:ident [out $type:ident; $n:ident]) => {
        vec![<$type>::default(); $call.length(stringify!($n))]
    };
    ($call:ident $states:ident $arg:ident [out fmi2EventInfo]) => {
        fmi2EventInfo {
            newDiscreteStatesNeeded: 0,
            terminateSimulation: 0,
            nominalsOfContinuousStatesChanged: 0,
            valuesOfContinuousStatesChanged: 0,
            nextEventTimeDefined: 0,
            nextEventTime: 0.0,
        }
    };
    ($call:ident $states:ident $arg:ident [out? fmi2FMUstate]) => {
        $states.take($call.given(stringify!($arg)))
    };
    ($call:ident $states:ident $arg:ident [out? fmi3FMUState]) => {
        $states.take($call.given(stringify!($arg)))
    };
    ($call:ident $states:ident $arg:ident [out? fmi2Status]) => {
        fmi2Status(0)
    };
    ($call:ident $states:ident $arg:ident [out? fmi2String]) => {
        ptr::null()
    };
    ($call:ident $states:ident $arg:ident [out $(?)? $type:ident]) => {
        <$type>::default()
    };
    ($call:ident $states:ident $arg:ident fmi2FMUstate) => {
        $states.take($call.given(stringify!($arg)))
    };
    ($call:ident $states:ident $arg:ident fmi3FMUState) => {
        $states.take($call.given(stringify!($arg)))
    };
    ($call:ident $states:ident $arg:ident fmi2Boolean) => {
        $call.given(stringify!($arg)).first().is_some_and(bool::of)
    };
    ($call:ident $states:ident $arg:ident fmi3Boolean) => {
        $call.given(stringify!($arg)).first().is_some_and(bool::of)
    };
    ($call:ident $states:ident $arg:ident $type:ty) => {
        $call.given(stringify!($arg)).first().map_or_else(<$type>::default, <$type>::of)
    };
}

/// Passes the argument.
macro_rules! passed {
    ($arg:ident [in? $type:ident; $n:ident]) => {
        $arg
    };
    ($arg:ident [in fmi2String; $n:ident]) => {
        &$arg.pointers
    };
    ($arg:ident [in fmi3String; $n:ident]) => {
        &$arg.pointers
    };
    ($arg:ident [in $type:ident; $n:ident]) => {
        &$arg
    };
    ($arg:ident [out $($rest:tt)*]) => {
        &mut $arg
    };
    ($arg:ident fmi2FMUstate) => {
        &$arg
    };
    ($arg:ident fmi3FMUState) => {
        &$arg
    };
    ($arg:ident $type:ty) => {
        $arg
    };
}

/// Keeps a state after the call.
macro_rules! kept {
    ($call:ident $states:ident $arg:ident [out? fmi2FMUstate]) => {
        $states.keep($call.returned_state(stringify!($arg)), $arg)
    };
    ($call:ident $states:ident $arg:ident [out? fmi3FMUState]) => {
        $states.keep($call.returned_state(stringify!($arg)), $arg)
    };
    ($call:ident $states:ident $arg:ident fmi2FMUstate) => {
        kept!(@ $call $states $arg)
    };
    ($call:ident $states:ident $arg:ident fmi3FMUState) => {
        kept!(@ $call $states $arg)
    };
    (@ $call:ident $states:ident $arg:ident) => {
        if let Some(Element::State(number)) = $call.given(stringify!($arg)).first() {
            $states.keep(*number, $arg);
        }
    };
    ($call:ident $states:ident $arg:ident $kind:tt) => {};
}

macro_rules! repeat_one {
    ($version:ident $handle:ident $call:ident $states:ident $operation:ident;
        $done:tt [$n:ident: [len], $($rest:tt)*]) => {
        repeat_one!($version $handle $call $states $operation; $done [$($rest)*])
    };
    ($version:ident $handle:ident $call:ident $states:ident $operation:ident;
        [$($done:tt)*] [$arg:ident: $kind:tt, $($rest:tt)*]) => {
        repeat_one!($version $handle $call $states $operation; [$($done)* $arg: $kind,] [$($rest)*])
    };
    ($version:ident $handle:ident $call:ident $states:ident $operation:ident;
        [$($arg:ident: $kind:tt,)*] []) => {{
        $(#[allow(unused_mut, reason = "not all are written")] let mut $arg = given!($call $states $arg $kind);)*
        let result = $version(&mut *$handle).$operation($(passed!($arg $kind)),*);
        $(kept!($call $states $arg $kind);)*
        result
    }};
}

macro_rules! repeat {
    (
        $repeat:ident $version:ident
        Free { $($_0:tt)* }
        $($_1:ident { $($name:ident($($arg:ident: $kind:tt),*) => $operation:ident in $($states:ident)|+;)* })*
    ) => {
        #[allow(unused_variables, reason = "not all functions have arguments")]
        fn $repeat(
            handle: &mut Handle,
            call: &RepeatedCall,
            states: &mut RepeatedStates,
        ) -> Option<Result> {
            Some(match call.function.as_str() {
                $($(stringify!($name) => {
                    repeat_one!($version handle call states $operation; [] [$($arg: $kind,)*])
                })*)*
                _ => return None,
            })
        }
    };
}

fmi2_functions!(repeat! repeat_2 Fmi2);
fmi3_functions!(repeat! repeat_3 Fmi3);

impl Instance {
    /// Repeats a call of a function of instances; `None` if it is none.
    pub fn repeat(&mut self, call: &RepeatedCall, states: &mut RepeatedStates) -> Option<Result> {
        self.is_saved |= call.function.contains("GetFMU");
        let handle = &mut self.handle;
        repeat_2(handle, call, states).or_else(|| repeat_3(handle, call, states))
    }
}

impl ClockUpdateMode {
    /// Repeats a call of a function that was made while the FMU updated its clocks; `None` if it is none of instances.
    pub fn repeat(&mut self, call: &RepeatedCall) -> Option<Result> {
        repeat_3(&mut self.0, call, &mut RepeatedStates::default())
    }
}
