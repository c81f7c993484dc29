//! A model behind one interface for all: its values by reference, start values, steps.

use std::any::Any;
use std::fmt;

use model_description::{Info, Place, Variable, check, guid};

use crate::{Model, ModelError};

/// A model of a library, before it is instantiated.
#[derive(Clone, Copy)]
pub struct Entry {
    /// Its name.
    pub name: &'static str,
    guid: Guid,
    create: fn() -> Box<dyn Slave>,
    #[cfg(feature = "describe")]
    pub(crate) describe: fn() -> model_description::schema::ModelDescription,
}

impl Entry {
    /// The entry of the model `M`. A wrong table stops the compilation here.
    pub const fn of<M: Model>() -> Self {
        check(M::VARIABLES);
        Self {
            name: M::NAME,
            guid: Bound::<M>::GUID,
            create: || Box::new(Bound::<M>::new()),
            #[cfg(feature = "describe")]
            describe: crate::description::describe::<M>,
        }
    }

    /// The GUID of the model's interface.
    pub fn guid(&self) -> &str {
        std::str::from_utf8(&self.guid).unwrap_or_default()
    }

    pub(crate) fn create(&self) -> Box<dyn Slave> {
        (self.create)()
    }
}

/// A scalar variable of a slave.
pub(crate) struct Scalar<'a> {
    pub(crate) info: &'static Info,
    /// Index in the array, from 0.
    pub(crate) element: usize,
    pub(crate) place: Place<'a>,
}

/// The name of a scalar variable, which is put together when it is shown.
#[derive(Clone, Copy)]
pub(crate) struct Name(&'static Info, usize);

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.element_name(self.1))
    }
}

impl Scalar<'_> {
    pub(crate) fn name(&self) -> Name {
        Name(self.info, self.element)
    }
}

/// A model whose values are reached by value reference.
pub(crate) trait Slave {
    /// Back to start values.
    fn reset(&mut self);
    /// See [`Model::initialize`].
    fn initialize(&mut self, start_time: f64) -> Result<(), ModelError>;
    /// See [`Model::step`].
    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError>;
    /// Number of scalar variables; their value references are 0 to one less.
    fn count(&self) -> usize;
    /// The variable of a value reference.
    fn find(&mut self, reference: u32) -> Option<Scalar<'_>>;

    /// Where the time derivative of an input lives, if the host may give it.
    fn slope(&mut self, reference: u32) -> Option<&mut f64>;
    /// Sets all time derivatives of inputs to zero.
    fn clear_slopes(&mut self);
    /// Whether derivatives of outputs by inputs are known.
    fn has_sensitivities(&self) -> bool;
    /// The derivative of an output by an input, as it was held over the last step.
    fn sensitivity(&self, output: u32, input: u32) -> f64;

    /// The GUID of the model's interface.
    fn guid(&self) -> Guid;
    /// A copy of the model.
    fn save(&self) -> Box<dyn Any>;
    /// Takes over a copy; false if it is one of another model.
    fn restore(&mut self, saved: &dyn Any) -> bool;
    /// The bytes of a copy; none if it is one of another model.
    fn serialize(&self, saved: &dyn Any) -> Option<Vec<u8>>;
    /// The copy that the bytes hold, if they hold one and nothing else.
    fn deserialize(&self, bytes: &[u8]) -> Option<Box<dyn Any>>;
}

/// A GUID as text.
pub(crate) type Guid = [u8; guid::LENGTH];

/// A model bound to its table.
struct Bound<M>(M);

/// Most scalar variables that a model may have.
const MOST_VARIABLES: usize = 1024;

/// Where the value references of a table lead: to a row, and to an element of its array.
struct Slots {
    count: usize,
    slots: [(u16, u16); MOST_VARIABLES],
}

const fn slots<M>(variables: &[Variable<M>]) -> Slots {
    let mut all = Slots {
        count: 0,
        slots: [(0, 0); MOST_VARIABLES],
    };
    let mut row = 0;
    while row < variables.len() {
        let mut element = 0;
        while element < variables[row].info.count() {
            assert!(all.count < MOST_VARIABLES, "a model has too many variables");
            all.slots[all.count] = (row as u16, element as u16);
            all.count += 1;
            element += 1;
        }
        row += 1;
    }
    all
}

impl<M: Model> Bound<M> {
    const SLOTS: &'static Slots = &slots(M::VARIABLES);
    const GUID: Guid = guid::guid(M::NAME, M::VARIABLES);

    fn new() -> Self {
        let mut model = M::default();
        for variable in M::VARIABLES {
            variable.start(&mut model);
        }
        Self(model)
    }

    /// The row of a value reference, and the element of its array.
    fn row(reference: u32) -> Option<(&'static Variable<M>, usize)> {
        let slots = &Self::SLOTS.slots[..Self::SLOTS.count];
        let &(row, element) = slots.get(usize::try_from(reference).ok()?)?;
        Some((M::VARIABLES.get(usize::from(row))?, usize::from(element)))
    }
}

impl<M: Model> Slave for Bound<M> {
    fn reset(&mut self) {
        *self = Self::new();
    }

    fn initialize(&mut self, start_time: f64) -> Result<(), ModelError> {
        self.0.initialize(start_time)
    }

    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        self.0.step(time, step)
    }

    fn count(&self) -> usize {
        Self::SLOTS.count
    }

    fn find(&mut self, reference: u32) -> Option<Scalar<'_>> {
        let (variable, element) = Self::row(reference)?;
        Some(Scalar {
            info: &variable.info,
            element,
            place: variable.place(&mut self.0, element)?,
        })
    }

    fn slope(&mut self, reference: u32) -> Option<&mut f64> {
        Self::row(reference)?.0.slope_place(&mut self.0)
    }

    fn clear_slopes(&mut self) {
        for variable in M::VARIABLES {
            if let Some(slope) = variable.slope_place(&mut self.0) {
                *slope = 0.0;
            }
        }
    }

    fn has_sensitivities(&self) -> bool {
        M::VARIABLES.iter().any(Variable::has_sensitivities)
    }

    fn sensitivity(&self, output: u32, input: u32) -> f64 {
        match (Self::row(output), Self::row(input)) {
            (Some((output, _)), Some((input, _))) => output.sensitivity(&self.0, input.info.name),
            _ => 0.0,
        }
    }

    fn guid(&self) -> Guid {
        Self::GUID
    }

    fn save(&self) -> Box<dyn Any> {
        Box::new(self.0.clone())
    }

    fn restore(&mut self, saved: &dyn Any) -> bool {
        match saved.downcast_ref::<M>() {
            Some(model) => {
                self.0 = model.clone();
                true
            }
            None => false,
        }
    }

    fn serialize(&self, saved: &dyn Any) -> Option<Vec<u8>> {
        postcard::to_allocvec(saved.downcast_ref::<M>()?).ok()
    }

    fn deserialize(&self, bytes: &[u8]) -> Option<Box<dyn Any>> {
        match postcard::take_from_bytes::<M>(bytes) {
            Ok((model, [])) => Some(Box::new(model)),
            _ => None,
        }
    }
}
