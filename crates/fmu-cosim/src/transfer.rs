//! The transfer of values from outputs to inputs and into rows.

use crate::instance::{Called, Instance};
use crate::recorder::Function;
use crate::{Failure, Scale};

/// An FMI type with its get and set functions.
pub(crate) trait Type {
    type Value: Copy + Default + PartialEq + std::fmt::Debug;
    const GET: Function;
    const SET: Function;
    fn get(s: &mut Slave, references: &[u32], values: &mut [Self::Value]) -> fmu_host::Result;
    fn set(s: &mut Slave, references: &[u32], values: &[Self::Value]) -> fmu_host::Result;
    fn number(value: Self::Value) -> f64;
    /// The value of an input whose output has this value; only Reals are scaled.
    fn scaled(value: Self::Value, _scale: Scale) -> Self::Value {
        value
    }
}

type Slave = fmu_host::Instance;

macro_rules! types {
    ($(
        $name:ident: $value:ty, $get:ident $recorded_get:ident, $set:ident $recorded_set:ident
        $(, $scaled:item)?;
    )*) => {
        $(
            pub(crate) struct $name;

            impl Type for $name {
                type Value = $value;
                const GET: Function = Function::$recorded_get;
                const SET: Function = Function::$recorded_set;

                #[inline]
                fn get(s: &mut Slave, references: &[u32], values: &mut [$value]) -> fmu_host::Result {
                    s.$get(references, values)
                }

                #[inline]
                fn set(s: &mut Slave, references: &[u32], values: &[$value]) -> fmu_host::Result {
                    s.$set(references, values)
                }

                #[inline]
                fn number(value: $value) -> f64 {
                    f64::from(value)
                }

                $($scaled)?
            }
        )*
    };
}

types! {
    Real: f64, get_real GetReal, set_real SetReal,
        #[inline]
        fn scaled(value: f64, Scale { factor, offset }: Scale) -> f64 {
            factor * value + offset
        };
    Integer: i32, get_integer GetInteger, set_integer SetInteger;
    Boolean: i32, get_boolean GetBoolean, set_boolean SetBoolean;
}

/// Variables of one component and type.
#[derive(Debug, Clone, Default)]
pub(crate) struct Group {
    /// Index of the component.
    pub(crate) component: usize,
    pub(crate) references: Vec<u32>,
    pub(crate) names: Vec<String>,
}

impl Group {
    #[inline]
    fn get<T: Type>(&self, instances: &mut [Instance], values: &mut [T::Value]) -> Called {
        let what = || self.names.join(", ");
        instances[self.component].call(T::GET, what, |s| T::get(s, &self.references, values))
    }

    #[inline]
    fn set<T: Type>(&self, instances: &mut [Instance], values: &[T::Value]) -> Called {
        let what = || {
            let pairs = self.names.iter().zip(values);
            let texts: Vec<_> = pairs
                .map(|(name, value)| format!("{name} = {value:?}"))
                .collect();
            texts.join(", ")
        };
        instances[self.component].call(T::SET, what, |s| T::set(s, &self.references, values))
    }
}

/// The inputs of one component and type, and the outputs that feed them, in the same order.
pub(crate) struct Transfer<T: Type> {
    outputs: Vec<Group>,
    inputs: Group,
    scales: Vec<(usize, Scale)>,
    values: Vec<T::Value>,
}

impl<T: Type> Transfer<T> {
    pub(crate) fn new(outputs: Vec<Group>, inputs: Group, scales: Vec<(usize, Scale)>) -> Self {
        let values = vec![T::Value::default(); inputs.references.len()];
        Self {
            outputs,
            inputs,
            scales,
            values,
        }
    }

    /// Reads the outputs; returns whether one has changed.
    pub(crate) fn fetch_changes(
        &mut self,
        instances: &mut [Instance],
    ) -> Result<bool, Box<Failure>> {
        let before = self.values.clone();
        self.fetch(instances)?;
        Ok(self.values != before)
    }

    /// Reads the outputs.
    #[inline]
    pub(crate) fn fetch(&mut self, instances: &mut [Instance]) -> Called {
        let mut rest = self.values.as_mut_slice();
        for group in &self.outputs {
            let (values, others) = rest.split_at_mut(group.references.len());
            group.get::<T>(instances, values)?;
            rest = others;
        }
        for (position, scale) in &self.scales {
            self.values[*position] = T::scaled(self.values[*position], *scale);
        }
        Ok(())
    }

    /// Writes the inputs.
    #[inline]
    pub(crate) fn deliver(&self, instances: &mut [Instance]) -> Called {
        self.inputs.set::<T>(instances, &self.values)
    }
}

/// Variables of one component and type that are recorded, and their columns.
pub(crate) struct Reader<T: Type> {
    group: Group,
    columns: Vec<usize>,
    values: Vec<T::Value>,
}

impl<T: Type> Reader<T> {
    pub(crate) fn new(group: Group, columns: Vec<usize>) -> Self {
        let values = vec![T::Value::default(); columns.len()];
        Self {
            group,
            columns,
            values,
        }
    }

    #[inline]
    pub(crate) fn read(&mut self, instances: &mut [Instance], row: &mut [f64]) -> Called {
        self.group.get::<T>(instances, &mut self.values)?;
        for (&column, &value) in self.columns.iter().zip(&self.values) {
            row[column] = T::number(value);
        }
        Ok(())
    }
}
