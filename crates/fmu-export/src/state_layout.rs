//! The layout of what is saved with the state of an instance, as a hash, so that a state of another layout is refused.

use fmi_abi::state::State;
use fmu_description::derive::state_layout;

/// A type whose values are saved. Structs and enums implement it by `saved!`, which sees a change of their fields.
pub(crate) trait StateLayout {
    const LAYOUT: u128;
}

/// Defines structs and enums that are saved, with the layout of their fields.
macro_rules! saved {
    ($(
        $(#[$about:meta])* $vis:vis struct $name:ident {
            $($(#[$about_field:meta])* $vis_of_field:vis $field:ident: $type:ty,)*
        }
    )*) => { $(
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
        $vis struct $name {
            $($(#[$about_field])* $vis_of_field $field: $type,)*
        }

        impl $crate::state_layout::StateLayout for $name {
            const LAYOUT: u128 = fmu_description::derive::state_layout(&[
                $((stringify!($field), "", <$type as $crate::state_layout::StateLayout>::LAYOUT)),*
            ]);
        }
    )* };
    ($(#[$about:meta])* $vis:vis enum $name:ident {
        $($(#[$about_variant:meta])* $variant:ident,)*
    }) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        $vis enum $name {
            $($(#[$about_variant])* $variant,)*
        }

        impl $crate::state_layout::StateLayout for $name {
            const LAYOUT: u128 =
                fmu_description::derive::state_layout(&[$((stringify!($variant), "", 0)),*]);
        }
    };
}
pub(crate) use saved;

macro_rules! layouts_of_primitive_types {
    ($($type:ty),*) => { $(
        impl StateLayout for $type {
            const LAYOUT: u128 = state_layout(&[("", stringify!($type), 0)]);
        }
    )* };
}
layouts_of_primitive_types!(bool, f64, u128);

impl<T: StateLayout> StateLayout for Option<T> {
    const LAYOUT: u128 = state_layout(&[("", "Option", T::LAYOUT)]);
}

/// The names of all states, with their numbers, by which they are saved.
impl StateLayout for State {
    const LAYOUT: u128 = {
        let (mut fields, mut i) = ([("", "", 0); Self::ALL.len()], 0);
        while i < fields.len() {
            let (state, name) = Self::ALL[i];
            fields[i] = (name, "", state as u128);
            i += 1;
        }
        state_layout(&fields)
    };
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
