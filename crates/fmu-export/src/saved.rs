//! What is saved with the state of an instance besides its model, and its layout as a hash, so that a state of another
//! layout is refused.

use fmi_abi::state::State;
use fmu_description::derive::state_layout;
use fmu_description::{StateError, StateReader, StateWriter};

/// A type whose values are saved. Structs and enums implement it by `saved!`, which sees a change of their fields.
pub(crate) trait Saved: Sized {
    const LAYOUT: u128;

    fn save(&self, to: &mut StateWriter) -> Result<(), StateError>;
    fn load(from: &mut StateReader<'_>) -> Result<Self, StateError>;
}

/// Defines structs and enums that are saved, with the layout of their fields.
macro_rules! saved {
    ($(
        $(#[$about:meta])* $vis:vis struct $name:ident {
            $($(#[$about_field:meta])* $vis_of_field:vis $field:ident: $type:ty,)*
        }
    )*) => { $(
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        $vis struct $name {
            $($(#[$about_field])* $vis_of_field $field: $type,)*
        }

        impl $crate::saved::Saved for $name {
            const LAYOUT: u128 = fmu_description::derive::state_layout(&[
                $((stringify!($field), "", <$type as $crate::saved::Saved>::LAYOUT)),*
            ]);

            fn save(
                &self,
                to: &mut fmu_description::StateWriter,
            ) -> Result<(), fmu_description::StateError> {
                $($crate::saved::Saved::save(&self.$field, to)?;)*
                Ok(())
            }

            fn load(
                from: &mut fmu_description::StateReader<'_>,
            ) -> Result<Self, fmu_description::StateError> {
                Ok(Self { $($field: $crate::saved::Saved::load(from)?),* })
            }
        }
    )* };
    // Later variants change nothing in saved states.
    ($(#[$about:meta])* $vis:vis enum $name:ident {
        $($(#[$about_variant:meta])* $variant:ident,)*
    } $(and later { $($(#[$about_later:meta])* $later:ident,)* })?) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        $vis enum $name {
            $($(#[$about_variant])* $variant,)*
            $($($(#[$about_later])* $later,)*)?
        }

        impl $crate::saved::Saved for $name {
            const LAYOUT: u128 =
                fmu_description::derive::state_layout(&[$((stringify!($variant), "", 0)),*]);

            fn save(
                &self,
                to: &mut fmu_description::StateWriter,
            ) -> Result<(), fmu_description::StateError> {
                to.put(&(*self as u8))
            }

            fn load(
                from: &mut fmu_description::StateReader<'_>,
            ) -> Result<Self, fmu_description::StateError> {
                let number: u8 = from.take()?;
                let mut variants = [$(Self::$variant,)* $($(Self::$later,)*)?].into_iter();
                let variant = variants.find(|variant| *variant as u8 == number);
                variant.ok_or(fmu_description::StateError)
            }
        }
    };
}
pub(crate) use saved;

macro_rules! primitive_types {
    ($($type:ty),*) => { $(
        impl Saved for $type {
            const LAYOUT: u128 = state_layout(&[("", stringify!($type), 0)]);

            fn save(&self, to: &mut StateWriter) -> Result<(), StateError> {
                to.put(self)
            }

            fn load(from: &mut StateReader<'_>) -> Result<Self, StateError> {
                from.take()
            }
        }
    )* };
}
primitive_types!(bool, f64, u128, Option<f64>);

/// The names of the states with their numbers, by which they are saved. Those of scheduled execution, which came later,
/// changed nothing in saved states.
impl Saved for State {
    const LAYOUT: u128 = {
        const NEW: usize = 3;
        let (mut fields, mut i) = ([("", "", 0); Self::ALL.len() - NEW], 0);
        let mut all = Self::ALL.as_slice();
        while let [(state, name), rest @ ..] = all {
            if (*state as u16) < Self::ClockActivation as u16 {
                fields[i] = (*name, "", *state as u128);
                i += 1;
            }
            all = rest;
        }
        state_layout(&fields)
    };

    fn save(&self, to: &mut StateWriter) -> Result<(), StateError> {
        to.put(&number(*self))
    }

    fn load(from: &mut StateReader<'_>) -> Result<Self, StateError> {
        let saved: u8 = from.take()?;
        let mut all = Self::ALL.into_iter().map(|(state, _)| state);
        all.find(|state| number(*state) == saved).ok_or(StateError)
    }
}

/// The number of a state in a saved one: the place of its bit.
fn number(state: State) -> u8 {
    (state as u16).trailing_zeros() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    mod changed {
        saved! {
            pub(super) struct Point { x: f64, y: bool, }
        }
        saved! {
            pub(super) enum Side { Left, Both, Right, }
        }
    }

    saved! {
        struct Point { x: f64, y: f64, }
        struct Line { point: Point, slope: Option<f64>, }
        struct ChangedLine { point: changed::Point, slope: Option<f64>, }
    }
    saved! {
        enum Side { Left, Right, }
    }

    #[test]
    fn a_change_of_a_field_changes_all_layouts_with_it() {
        assert_ne!(Point::LAYOUT, changed::Point::LAYOUT);
        assert_ne!(Line::LAYOUT, ChangedLine::LAYOUT);
        assert_ne!(Side::LAYOUT, changed::Side::LAYOUT);
        assert_ne!(<Option<f64>>::LAYOUT, f64::LAYOUT);
    }
}
