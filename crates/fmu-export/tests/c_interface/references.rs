//! Value references that a model fixes: it behaves as without them, under other numbers.

use std::ffi::CString;

use fmu_description::Type;
use fmu_description::references::{FixedReference, assign};
use fmu_description::scalar::{scalars, variable_count};
use fmu_export::prelude::*;
use fmu_export::{Entry, Variables, interface, table_size};
use proptest::prelude::*;
use proptest::sample::{Index, select};

use crate::driver::*;

/// A part
#[derive(Variables)]
pub struct Part {
    /// gain
    #[parameter(tunable, start = 2)]
    gain: f64,
    /// offset
    #[parameter(tunable, start = 0.5)]
    offset: f64,
    /// result
    #[output]
    result: f64,
}

/// Defines a model with some value references.
macro_rules! chain {
    ($name:ident $size:literal: $u:tt $n:tt $w:tt $x:tt $x_dot:tt $level:tt $part:tt $others:tt) => {
        /// Two tanks
        #[derive(Model)]
        #[model(continuous, step = Self::step, step_size = 0.1)]
        #[rustfmt::skip]
        pub struct $name {
            /** inflow */ #[input(derivative = self.u_rate, reference = $u)] u: f64,
            u_rate: f64,
            /** nodes */ #[structural_parameter(start = 2, max = 3, reference = $n)] n: u64,
            /** weights */ #[parameter(tunable, size = "n", start = [1, 2, 3], reference = $w)] w: [f64; 3],
            /** levels */ #[output(state, nominal = 4, reference = $x)] x: [f64; 2],
            /** rates */ #[derivative(of = x, reference = $x_dot)] x_dot: [f64; 2],
            /** full */ #[event_indicator(reference = $level)] level: f64,
            #[nested(reference = $part)] part: Part,
            #[nested(references("[2].gain" = $others))] others: [Part; 2],
        }

        impl $name {
            const SIZE: usize = table_size::<Self>();
            const ENTRY: Entry = Entry::new::<Self, { Self::SIZE }>(interface::<Self, { Self::SIZE }>(None), &[]);

            fn step(&mut self, _time: f64, step: f64) -> Result<(), ModelError> {
                let slope = self.u_rate;
                self.x[0] += (self.u + slope * step / 2.0) * step;
                self.x[1] += self.w[..self.n as usize].iter().sum::<f64>() * step;
                self.outputs();
                Ok(())
            }

            fn outputs(&mut self) {
                self.part.result = self.part.gain * self.x[0] + self.part.offset;
                for (i, other) in self.others.iter_mut().enumerate() {
                    other.result = other.gain * self.x[i] + other.offset;
                }
            }
        }

        impl Continuous for $name {
            fn evaluate(&mut self, time: f64) -> Result<(), ModelError> {
                self.x_dot = [self.u, self.w[..self.n as usize].iter().sum()];
                self.level = self.x[0] - 1.0 - time;
                self.outputs();
                Ok(())
            }
        }
    };
}

// The numbers that they have without: u 0, n 1, w 2, x 5, x_dot 7, level 9, part 10, others 13 and 16.
chain!(Natural 19: 0 1 2 5 7 9 10 16);
chain!(Reversed 19: 18 17 14 12 10 9 6 3);
chain!(Spread 19: 40 0 30 2 70 60 20 100);

static ENTRIES: &[Entry] = &[Natural::ENTRY, Reversed::ENTRY, Spread::ENTRY];

/// For each model, the value references of the scalars in the order of the fields, and of the time.
const REFERENCES: [[u32; 20]; 3] = [
    [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19],
    [18, 17, 14, 15, 16, 12, 13, 10, 11, 9, 6, 7, 8, 0, 1, 2, 3, 4, 5, 19],
    [40, 0, 30, 31, 32, 2, 3, 70, 71, 60, 20, 21, 22, 1, 4, 5, 100, 6, 7, 8],
];
/// The first elements, the number of elements in use, and the time.
const VARIABLES: [(usize, usize); 16] = [
    (0, 1),
    (1, 1),
    (2, 2),
    (5, 2),
    (7, 2),
    (9, 1),
    (10, 1),
    (11, 1),
    (12, 1),
    (13, 1),
    (14, 1),
    (15, 1),
    (16, 1),
    (17, 1),
    (18, 1),
    (19, 1),
];

fn instance(kind: Kind, model: usize) -> Instance {
    let token = Some(CString::new(ENTRIES[model].guid()).unwrap());
    Arguments::new(kind, 0).make(|a| (a.models, a.token) = (ENTRIES, token))
}

/// What a host calls: a function, variables and a number.
type Call = (u8, Vec<Index>, f64);

/// The results of calls of a model.
fn results(kind: Kind, model: usize, calls: &[Call]) -> Vec<(Status, Vec<f64>)> {
    let it = instance(kind, model).run(0.0);
    let (mut time, mut results) = (0.0, Vec::new());
    for (function, chosen, number) in calls {
        let of = |index: &Index| match kind.0 {
            Fmi2 => (index.index(20), 1),
            Fmi3 => *index.get(&VARIABLES),
        };
        let chosen = Vec::from_iter(chosen.iter().map(of));
        // In FMI 2.0, the time is no variable.
        let reference = |scalar: usize| match (kind.0, scalar) {
            (Fmi2, 19) => 999,
            _ => REFERENCES[model][scalar],
        };
        let references = Vec::from_iter(chosen.iter().map(|(scalar, _)| reference(*scalar)));
        let n = chosen.iter().map(|(_, count)| count).sum();
        results.push(match function {
            0 => it.get_all(Type::Float64, &references, n),
            1 => (it.set_all(Type::Float64, &references, &vec![*number; n]), vec![]),
            2 => (it.slope(references[0], reference(0), 1.0), vec![]),
            3 => (it.slopes(&[(references[0], 1)]), vec![]),
            4 if kind.1 == Exchanged => {
                let mut values = [[0.0; 2]; 3];
                let [x, x_dot, nominal] = &mut values;
                ok([it.get_states(x), it.get_derivatives(x_dot), it.get_nominals(nominal)]);
                (OK, values.concat())
            }
            4 if kind.1 == Stepped => {
                time += 0.1;
                (it.step(time - 0.1, 0.1), vec![])
            }
            _ => (OK, vec![]),
        });
    }
    results
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_model_behaves_the_same_under_other_numbers(
        kind in select(&KINDS[..]),
        calls in prop::collection::vec(
            (0..5_u8, prop::collection::vec(any::<Index>(), 1..4), -2.0..2.0), 1..12,
        ),
    ) {
        let expected = results(kind, 0, &calls);
        for model in [1, 2] {
            prop_assert_eq!(&results(kind, model, &calls), &expected, "{}", model);
        }
    }

    #[test]
    fn variables_keep_fixed_numbers_and_share_none(
        rows in prop::collection::btree_map(0..8_usize, 0..60_usize, 0..5),
    ) {
        let fixed = Vec::from_iter(rows.iter().map(|(&row, &reference)| FixedReference {
            row, rows: 1, name: "", reference,
        }));
        let (mut all, length) = scalars::<{ variable_count(Natural::ROWS) }>(Natural::ROWS);
        let assigned = std::panic::catch_unwind(move || {
            let end = assign(&mut all[..length], Natural::ROWS, &fixed);
            (all, end)
        });
        // Two that overlap are a compile error.
        if let Ok((all, references)) = assigned {
            let mut ranges = Vec::from_iter(all.iter().map(|scalar| {
                (scalar.reference, scalar.reference + scalar.variable.element_count())
            }));
            let is_apart = |(first, end): &(usize, usize)| {
                *end <= references.end && !(*first..*end).contains(&references.time)
            };
            prop_assert!(ranges.iter().all(is_apart));
            ranges.sort_unstable();
            prop_assert!(ranges.is_sorted_by(|(_, end), (next, _)| end <= next), "{ranges:?}");
            for (row, reference) in rows {
                let first = all.iter().find(|scalar| scalar.number == FIRST[row]).unwrap();
                prop_assert_eq!(first.reference, reference);
            }
        }
    }
}

/// The number of the first scalar of each row.
const FIRST: [usize; 9] = [0, 1, 2, 5, 7, 9, 10, 13, 16];

#[test]
fn a_new_variable_leaves_the_numbers_of_the_others() {
    // A parameter between the second and the third, with the number after the last but one: the time keeps its own.
    let rows = &Natural::ROWS[..6];
    let (mut all, length) = scalars::<6>(rows);
    let new = FixedReference { row: 2, rows: 1, name: "", reference: 11 };
    let references = assign(&mut all[..length], rows, &[new]);
    let found = all.map(|scalar| scalar.reference);
    assert_eq!(found, [0, 1, 11, 2, 4, 6]);
    assert_eq!((references.time, references.end), (7, 14));
}

#[test]
fn a_model_with_fixed_numbers_is_another_one() {
    let guids: Vec<_> = ENTRIES.iter().map(Entry::guid).collect();
    assert!(guids[0] != guids[1] && guids[1] != guids[2] && guids[0] != guids[2]);
}
