//! A model behind one interface for all: its values by reference, start values, steps.

use model_description::{Info, Place, Variable, check, guid};

use crate::{Model, ModelError};

/// A model of a library, before it is instantiated.
#[derive(Clone, Copy)]
pub struct Entry {
    /// Its name.
    pub name: &'static str,
    guid: [u8; guid::LENGTH],
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
            guid: guid::guid(M::NAME, M::VARIABLES),
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
}

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

    fn new() -> Self {
        let mut model = M::default();
        for variable in M::VARIABLES {
            variable.start(&mut model);
        }
        Self(model)
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
        let slots = &Self::SLOTS.slots[..Self::SLOTS.count];
        let &(row, element) = slots.get(usize::try_from(reference).ok()?)?;
        let variable = M::VARIABLES.get(usize::from(row))?;
        let element = usize::from(element);
        Some(Scalar {
            info: &variable.info,
            element,
            place: variable.place(&mut self.0, element)?,
        })
    }
}
