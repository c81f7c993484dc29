//! Where the variables of a model are: tables by value reference, computed by the compiler, and access to the
//! memory that the rows describe.

use fmu_description::hash::Hash;
use fmu_description::references::{self, FixedReference, References};
use fmu_description::scalar::{self, ScalarVariable};
use fmu_description::table::{Bounds, Declaration, TableRow, TypedStart};
use fmu_description::{Causality, Clock, Dynamics, OwnCategory, Value, Variability};

use crate::deprecated::Warn;

/// Where a Float64 is stored, and the values that it may be set to between steps.
#[derive(Clone, Copy)]
pub(crate) struct Float64Place {
    /// Its offset in the model; [`Float64Place::NONE`] if the variable is no `f64`, or is computed only when a host
    /// asks for it.
    pub(crate) offset: usize,
    /// The smallest and the largest value. They are finite, which excludes NaN and infinities. The range
    /// is empty for variables that cannot be set without further ado.
    pub(crate) min: f64,
    pub(crate) max: f64,
}

impl Float64Place {
    pub(crate) const NONE: usize = usize::MAX;
    /// The place of no variable.
    const EMPTY: Self = Self { offset: Self::NONE, min: f64::INFINITY, max: f64::NEG_INFINITY };

    pub(crate) const fn from_row(row: &ScalarVariable) -> Self {
        let variable = row.variable;
        // The instance warns when a deprecated variable is set, and refuses a clocked one.
        let is_settable = variable.deprecated().is_empty()
            && variable.clocks.is_empty()
            && matches!(
                (variable.causality, variable.variability),
                (Causality::Input, _) | (Causality::Parameter, Variability::Tunable)
            );
        match (row.offset_of_real(), variable.dynamics, variable.bounds) {
            (_, Dynamics::Derivative { .. } | Dynamics::EventIndicator, _) => Self::EMPTY,
            (Some(offset), _, Bounds::Real(min, max)) if is_settable => {
                Self { offset, min: min.max(f64::MIN), max: max.min(f64::MAX) }
            }
            (Some(offset), ..) => Self { offset, ..Self::EMPTY },
            _ => Self::EMPTY,
        }
    }
}

/// The elements of a variable.
#[derive(Clone, Copy)]
pub(crate) struct Extent {
    /// Number of elements; 0 if the reference does not belong to a first element.
    pub(crate) count: u32,
    /// Number of elements that are in use by default.
    pub(crate) default: u32,
    /// Offset of the number of elements in use; [`Extent::ALL`] if all are.
    pub(crate) size: u32,
}

impl Extent {
    pub(crate) const ALL: u32 = u32::MAX;
    /// The extent of no variable.
    const EMPTY: Self = Self { count: 0, default: 0, size: Self::ALL };
}

/// A variable that is a state, and its derivative.
#[derive(Clone, Copy)]
pub(crate) struct ContinuousState {
    /// Number of elements.
    pub(crate) count: usize,
    /// Value references of the first elements.
    pub(crate) state: u32,
    pub(crate) derivative: u32,
    /// Their offsets in the model.
    pub(crate) state_offset: usize,
    pub(crate) derivative_offset: usize,
    pub(crate) nominal: f64,
}

/// A variable whose elements are event indicators.
#[derive(Clone, Copy)]
pub(crate) struct EventIndicators {
    /// Number of elements.
    pub(crate) count: usize,
    /// Offset of the first in the model.
    pub(crate) offset: usize,
}

/// The value reference of a variable, and its number in the rows.
#[derive(Clone, Copy)]
pub(crate) struct NumberedVariable {
    /// Of the first element.
    pub(crate) reference: u32,
    pub(crate) number: u32,
    /// Number of elements.
    pub(crate) count: u32,
}

/// Up to `N` items.
#[derive(Clone, Copy)]
pub(crate) struct BoundedList<T, const N: usize> {
    items: [T; N],
    length: usize,
}

impl<T: Copy, const N: usize> BoundedList<T, N> {
    const fn new(filler: T) -> Self {
        Self { items: [filler; N], length: 0 }
    }

    const fn push(&mut self, item: T) {
        self.items[self.length] = item;
        self.length += 1;
    }

    /// The items; if there are none, a slice that keeps no array in the binary.
    pub(crate) const fn as_slice(&'static self) -> &'static [T] {
        match self.length {
            0 => &[],
            length => self.items.split_at(length).0,
        }
    }
}

/// The variables of a model, at most `N`, with their value references.
pub(crate) struct VariableList<const N: usize> {
    all: [ScalarVariable; N],
    length: usize,
    pub(crate) references: References,
}

impl<const N: usize> VariableList<N> {
    #[track_caller]
    pub(crate) const fn new(rows: &'static [TableRow], fixed: &[FixedReference]) -> Self {
        let (mut all, length) = scalar::scalars(rows);
        let references = references::assign(all.split_at_mut(length).0, rows, fixed);
        Self { all, length, references }
    }

    pub(crate) const fn all(&self) -> &[ScalarVariable] {
        self.all.split_at(self.length).0
    }
}

/// The tables of a model, for constants only: a binary contains those that it uses.
pub(crate) struct Tables<const N: usize> {
    /// The scalars and elements of arrays that are in use by default.
    pub(crate) elements: [Float64Place; N],
    /// The variables that are not arrays.
    pub(crate) scalars: [Float64Place; N],
    /// The first elements of all variables, and how many elements there are.
    pub(crate) variables: [Float64Place; N],
    pub(crate) arrays: [Extent; N],
    /// Of a model with fixed value references, in the order of the rows.
    pub(crate) numbers: BoundedList<NumberedVariable, N>,
    /// In the order of the derivatives.
    pub(crate) states: BoundedList<ContinuousState, N>,
    pub(crate) event_indicators: BoundedList<EventIndicators, N>,
    /// Whether the host may set the time derivative of any input.
    pub(crate) has_input_derivatives: bool,
    /// Whether any variable causes an event by a new value.
    pub(crate) has_switches: bool,
    /// Whether there is a state derivative or a continuous output that is no state.
    pub(crate) has_unknowns: bool,
    /// Whether the derivatives of any of these unknowns with respect to other variables are not known.
    pub(crate) lacks_derivatives: bool,
    pub(crate) has_structural_parameters: bool,
    pub(crate) has_tunable_structural_parameters: bool,
    pub(crate) has_deprecated: bool,
}

impl<const N: usize> Tables<N> {
    /// The tables; those by value reference are empty unless there are places.
    pub(crate) const fn new(variables: &[ScalarVariable], has_places: bool) -> Self {
        let mut tables = Self {
            elements: [Float64Place::EMPTY; N],
            scalars: [Float64Place::EMPTY; N],
            variables: [Float64Place::EMPTY; N],
            arrays: [Extent::EMPTY; N],
            numbers: BoundedList::new(NumberedVariable { reference: 0, number: 0, count: 0 }),
            states: BoundedList::new(ContinuousState {
                count: 0,
                state: 0,
                derivative: 0,
                state_offset: 0,
                derivative_offset: 0,
                nominal: 1.0,
            }),
            event_indicators: BoundedList::new(EventIndicators { count: 0, offset: 0 }),
            has_input_derivatives: false,
            has_switches: false,
            has_unknowns: false,
            lacks_derivatives: false,
            has_structural_parameters: false,
            has_tunable_structural_parameters: false,
            has_deprecated: false,
        };
        let (mut i, mut is_fixed) = (0, false);
        while i < variables.len() {
            tables.add(variables, &variables[i]);
            if has_places {
                tables.add_places(variables, &variables[i]);
            }
            is_fixed |= variables[i].reference != variables[i].number;
            i += 1;
        }
        let mut i = 0;
        while i < variables.len() && is_fixed {
            tables.numbers.push(NumberedVariable {
                reference: variables[i].reference as u32,
                number: variables[i].number as u32,
                count: variables[i].variable.element_count() as u32,
            });
            i += 1;
        }
        tables
    }

    /// Adds the places of a variable. It calls no function for an element, since an array may have many, for which that
    /// would take the compiler long.
    const fn add_places(&mut self, variables: &[ScalarVariable], row: &ScalarVariable) {
        let reference = row.reference;
        let (place, size) = (Float64Place::from_row(row), row.size_parameter(variables));
        let (count, in_use) = (row.variable.element_count(), row.elements_in_use(variables));
        self.variables[reference] = place;
        self.arrays[reference].count = count as u32;
        self.arrays[reference].default = in_use as u32;
        if let Some(size) = size
            && let Some(offset) = variables[size].offset_of_size()
        {
            self.arrays[reference].size = offset as u32;
        }
        if count == 1 && size.is_none() {
            self.scalars[reference] = place;
        }
        let mut element = 0;
        while element < in_use {
            let mut place = place;
            if place.offset != Float64Place::NONE {
                place.offset += element * size_of::<f64>();
            }
            self.elements[reference + element] = place;
            element += 1;
        }
    }

    /// Adds a variable to the lists, and what it says about the model.
    const fn add(&mut self, variables: &[ScalarVariable], row: &ScalarVariable) {
        let variable = row.variable;
        let count = variable.element_count();
        match (variable.dynamics, row.offset_of_real()) {
            (Dynamics::Derivative { .. }, Some(derivative_offset)) => {
                if let Some(state) = row.state(variables)
                    && matches!(state.variable.dynamics, Dynamics::State)
                    && let Some(state_offset) = state.offset_of_real()
                {
                    self.states.push(ContinuousState {
                        count,
                        state: state.reference as u32,
                        derivative: row.reference as u32,
                        state_offset,
                        derivative_offset,
                        nominal: state.variable.nominal,
                    });
                }
            }
            (Dynamics::EventIndicator, Some(offset)) => {
                self.event_indicators.push(EventIndicators { count, offset });
            }
            _ => {}
        }
        self.has_input_derivatives |= variable.has_input_derivative;
        self.has_switches |= is_switch(variable);
        self.has_deprecated |= !variable.deprecated().is_empty();
        let is_output = matches!(variable.causality, Causality::Output)
            && matches!(variable.variability, Variability::Continuous);
        if matches!(variable.dynamics, Dynamics::Derivative { .. })
            || is_output && !matches!(variable.dynamics, Dynamics::State)
        {
            self.has_unknowns = true;
            self.lacks_derivatives |= variable.depends_on.is_empty();
        }
        if matches!(variable.causality, Causality::StructuralParameter) {
            self.has_structural_parameters = true;
            self.has_tunable_structural_parameters |=
                matches!(variable.variability, Variability::Tunable);
        }
    }
}

/// Whether a new value of a variable is an event: of a discrete input or a tunable parameter.
const fn is_switch(field: &Declaration) -> bool {
    // A tick is an event, and not the new value with it.
    if field.is_of_ticks() {
        return false;
    }
    match field.causality {
        Causality::Input => !matches!(field.variability, Variability::Continuous),
        Causality::Parameter | Causality::StructuralParameter => {
            matches!(field.variability, Variability::Tunable)
        }
        _ => false,
    }
}

/// Whether the model computes the variable but for its start value: initial is exact.
pub(crate) fn has_own_start(variable: &Declaration) -> bool {
    matches!(variable.causality, Causality::Output | Causality::Local) && !variable.start.is_empty()
}

/// What is known of a model to the code that is compiled once for all models.
pub(crate) struct ModelInfo {
    pub(crate) rows: &'static [TableRow],
    /// Number of scalar variables.
    pub(crate) count: u32,
    /// The variables of a model with fixed value references, in the order of the rows. Without, numbers are references.
    pub(crate) numbers: &'static [NumberedVariable],
    /// All value references of variables are smaller.
    pub(crate) end: u32,
    /// The value reference of the independent variable, which only FMI 3.0 has.
    pub(crate) time: u32,
    pub(crate) states: &'static [ContinuousState],
    pub(crate) event_indicators: &'static [EventIndicators],
    /// Whether the model has a sample time.
    pub(crate) is_sampled: bool,
    /// The number of its rates; 0 if it has no sample time, or one.
    pub(crate) rates: usize,
    /// Whether it has equations, see [`Continuous`](crate::Continuous).
    pub(crate) is_continuous: bool,
    /// Whether they are integrated here in co-simulation.
    pub(crate) is_integrated: bool,
    /// The step size of the default experiment (s), and the relative tolerance.
    pub(crate) step: f64,
    pub(crate) tolerance: f64,
    pub(crate) has_directional_derivatives: bool,
    pub(crate) has_log: bool,
    pub(crate) log_categories: &'static [OwnCategory],
    /// What cannot be saved, if the state of the model cannot.
    pub(crate) why_unsaved: Option<&'static str>,
    /// Whether its state cannot be serialized.
    pub(crate) is_unserialized: bool,
    /// Warns of deprecated variables; `None` if there are none.
    pub(crate) warn_of_deprecated: Option<Warn>,
    /// The format of its serialized states.
    pub(crate) state_format: u32,
    pub(crate) has_structural_parameters: bool,
    pub(crate) has_tunable_structural_parameters: bool,
}

impl ModelInfo {
    /// The number of the scalar with a value reference.
    pub(crate) fn number(&self, reference: u32) -> Option<u32> {
        if self.numbers.is_empty() {
            return (reference < self.count).then_some(reference);
        }
        let is_of = |v: &&NumberedVariable| reference.wrapping_sub(v.reference) < v.count;
        self.numbers.iter().find(is_of).map(|v| v.number + (reference - v.reference))
    }

    /// The value reference of the scalar with a number.
    pub(crate) fn reference(&self, number: u32) -> u32 {
        let is_of = |v: &&NumberedVariable| number.wrapping_sub(v.number) < v.count;
        let found = self.numbers.iter().find(is_of);
        found.map_or(number, |v| v.reference + (number - v.number))
    }
}

/// The number of elements in use.
///
/// # Safety
/// The entry is one of the table of the model.
#[inline(always)]
pub(crate) unsafe fn elements_in_use(model: *mut u8, array: &Extent) -> usize {
    if array.size == Extent::ALL {
        return array.count as usize;
    }
    // SAFETY: `Variables` promises a `u64` at the offset of a structural parameter.
    let size = unsafe { *model.byte_add(array.size as usize).cast::<u64>() };
    size.min(u64::from(array.count)) as usize
}

/// The Float64 with the given offset in a model.
///
/// # Safety
/// The offset is the offset of a Float64 in the table of the model, which is borrowed mutably for `'a`.
#[inline(always)]
pub(crate) unsafe fn float64_at<'a>(model: *mut u8, offset: usize) -> &'a mut f64 {
    // SAFETY: `Variables` promises an `f64` at this offset.
    unsafe { &mut *model.byte_add(offset).cast::<f64>() }
}

/// Sets all variables that have start values to them.
///
/// # Safety
/// At the place is a struct with these rows, which is borrowed mutably.
pub(crate) unsafe fn set_start_values(model: *mut u8, rows: &'static [TableRow]) {
    scalar::each_declaration(rows, 0, &mut |field, offset| {
        // SAFETY: `Variables` promises a value of the type of the table for each element.
        unsafe { start(model.byte_add(offset), field) };
    });
}

/// Copies some of the fields.
///
/// # Safety
/// At both places is a struct with these rows, which are borrowed mutably.
pub(crate) unsafe fn copy_fields(
    to: *mut u8,
    from: *mut u8,
    rows: &'static [TableRow],
    is_copied: fn(&Declaration) -> bool,
) {
    scalar::each_declaration(rows, 0, &mut |field, offset| {
        if is_copied(field) {
            // SAFETY: as for start values.
            unsafe { copy(to.byte_add(offset), from.byte_add(offset), field) };
        }
    });
}

/// A hash of the variables that cause an event by a new value. It is one number of a fixed size, which is saved with
/// the state of an instance more easily than the values.
///
/// # Safety
/// At the place is a struct with these rows, which is borrowed mutably.
pub(crate) unsafe fn hash_of_switches(model: *mut u8, rows: &'static [TableRow]) -> u128 {
    let mut hash = Hash::new();
    scalar::each_declaration(rows, 0, &mut |field, offset| {
        if is_switch(field) {
            // SAFETY: as for start values.
            hash = unsafe { add(hash, model.byte_add(offset), field) };
        }
    });
    hash.0
}

/// A value that is added to a hash.
trait Hashed {
    fn add_to(&self, hash: Hash) -> Hash;
}

macro_rules! hashed_numbers {
    ($($type:ty),*) => {
        $(impl Hashed for $type {
            fn add_to(&self, hash: Hash) -> Hash {
                hash.bytes(&self.to_le_bytes())
            }
        })*
    };
}
hashed_numbers!(f32, f64, i8, u8, i16, u16, i32, u32, i64, u64);

impl Hashed for bool {
    fn add_to(&self, hash: Hash) -> Hash {
        u8::from(*self).add_to(hash)
    }
}

impl Hashed for Vec<u8> {
    fn add_to(&self, hash: Hash) -> Hash {
        (self.len() as u64).add_to(hash).bytes(self)
    }
}

impl Hashed for String {
    fn add_to(&self, hash: Hash) -> Hash {
        (self.len() as u64).add_to(hash).bytes(self.as_bytes())
    }
}

macro_rules! access {
    ($($($name:ident: $type:ty),*);*) => {
        /// Gets a value.
        ///
        /// # Safety
        /// At the place is a value of the type of the variable.
        pub(crate) unsafe fn get(place: *mut u8, field: &Declaration) -> Value {
            // SAFETY: the caller's promise.
            unsafe {
                match field.start {
                    $($(TypedStart::$name(_) => Value::$name((*place.cast::<$type>()).clone()),)*)*
                    TypedStart::Enumeration(_, of) => Value::Enumeration((*(of.item)(place)).get().into()),
                    TypedStart::Clock(_) => Value::Clock((*place.cast::<Clock>()).is_active()),
                }
            }
        }

        /// Sets a value; nothing happens if the variable is of another type, or has no such item.
        ///
        /// # Safety
        /// As [`get`], and the place is borrowed mutably.
        pub(crate) unsafe fn set(place: *mut u8, field: &Declaration, value: Value) {
            // SAFETY: the caller's promise.
            unsafe {
                match (field.start, value) {
                    $($((TypedStart::$name(_), Value::$name(value)) => *place.cast::<$type>() = value,)*)*
                    (TypedStart::Enumeration(_, of), Value::Enumeration(item)) => {
                        (*(of.item)(place)).set(item as i32);
                    }
                    (TypedStart::Clock(_), Value::Clock(is_active)) => {
                        (*place.cast::<Clock>()).set_active(is_active);
                    }
                    _ => {}
                }
            }
        }

        /// Sets the elements of a field to their start values, if there are any.
        ///
        /// # Safety
        /// At the place are all elements of the field, which are borrowed mutably.
        unsafe fn start(place: *mut u8, field: &Declaration) {
            let elements = 0..field.start_count();
            let last = field.start.len().saturating_sub(1);
            // SAFETY: the caller's promise.
            unsafe {
                match field.start {
                    $($(TypedStart::$name(values) => for i in elements {
                        *place.cast::<$type>().add(i) = values[i.min(last)].to_owned();
                    },)*)*
                    TypedStart::Enumeration(values, of) => for i in elements {
                        (*(of.item)(place.byte_add(i * of.size))).set(values[i.min(last)]);
                    },
                    TypedStart::Clock(_) => {}
                }
            }
        }

        /// Adds the elements of a field to a hash.
        ///
        /// # Safety
        /// As [`start`].
        unsafe fn add(mut hash: Hash, place: *mut u8, field: &Declaration) -> Hash {
            let elements = 0..field.element_count();
            // SAFETY: the caller's promise.
            unsafe {
                match field.start {
                    $($(TypedStart::$name(_) => for i in elements {
                        hash = (*place.cast::<$type>().add(i)).add_to(hash);
                    },)*)*
                    TypedStart::Enumeration(_, of) => for i in elements {
                        hash = (*(of.item)(place.byte_add(i * of.size))).get().add_to(hash);
                    },
                    TypedStart::Clock(_) => {}
                }
            }
            hash
        }

        /// Copies the elements of a field.
        ///
        /// # Safety
        /// As [`start`], for both places.
        unsafe fn copy(to: *mut u8, from: *mut u8, field: &Declaration) {
            let elements = 0..field.element_count();
            // SAFETY: the caller's promise.
            unsafe {
                match field.start {
                    $($(TypedStart::$name(_) => for i in elements {
                        (*to.cast::<$type>().add(i)).clone_from(&*from.cast::<$type>().add(i));
                    },)*)*
                    TypedStart::Enumeration(_, of) => for i in elements {
                        let item = (*(of.item)(from.byte_add(i * of.size))).get();
                        (*(of.item)(to.byte_add(i * of.size))).set(item);
                    },
                    TypedStart::Clock(_) => *to.cast::<Clock>() = *from.cast::<Clock>(),
                }
            }
        }
    };
}

fmu_description::types!(access!);
