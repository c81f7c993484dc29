//! Arrays of any length for serde, whose own implementations end at 32 elements.

use core::fmt;
use core::marker::PhantomData;

use serde::de::{Deserializer, Error, SeqAccess, Visitor};
use serde::ser::{SerializeTuple, Serializer};

/// A number, or an array of them.
pub trait Numbers: Copy {
    /// How many numbers.
    const COUNT: usize;
    const ZERO: Self;

    /// Calls a function with each number.
    fn each<E>(&mut self, call: &mut dyn FnMut(&mut f64) -> Result<(), E>) -> Result<(), E>;
}

impl Numbers for f64 {
    const COUNT: usize = 1;
    const ZERO: Self = 0.0;

    fn each<E>(&mut self, call: &mut dyn FnMut(&mut f64) -> Result<(), E>) -> Result<(), E> {
        call(self)
    }
}

impl<T: Numbers, const N: usize> Numbers for [T; N] {
    const COUNT: usize = N * T::COUNT;
    const ZERO: Self = [T::ZERO; N];

    fn each<E>(&mut self, call: &mut dyn FnMut(&mut f64) -> Result<(), E>) -> Result<(), E> {
        self.iter_mut().try_for_each(|item| item.each(call))
    }
}

pub fn serialize<T: Numbers, S: Serializer>(array: &T, serializer: S) -> Result<S::Ok, S::Error> {
    let mut tuple = serializer.serialize_tuple(T::COUNT)?;
    { *array }.each(&mut |number| tuple.serialize_element(number))?;
    tuple.end()
}

pub fn deserialize<'de, T: Numbers, D: Deserializer<'de>>(deserializer: D) -> Result<T, D::Error> {
    struct Tuple<T>(PhantomData<T>);

    impl<'de, T: Numbers> Visitor<'de> for Tuple<T> {
        type Value = T;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "{} numbers", T::COUNT)
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<T, A::Error> {
            let (mut array, mut found) = (T::ZERO, 0);
            array.each(&mut |number| {
                let next = sequence.next_element()?;
                *number = next.ok_or_else(|| A::Error::invalid_length(found, &self))?;
                found += 1;
                Ok(())
            })?;
            Ok(array)
        }
    }

    deserializer.deserialize_tuple(T::COUNT, Tuple(PhantomData))
}
