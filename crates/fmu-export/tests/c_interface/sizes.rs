//! The largest sizes of Binaries.

use std::ffi::CString;

use fmu_description::Type;
use fmu_export::prelude::*;
use fmu_export::{Entry, interface, table_size};

use crate::driver::*;

/// Repeats bytes
#[derive(Model)]
struct Repeater {
    /// bytes
    #[input(max_size = 2)]
    bytes: Vec<u8>,
    /// the same bytes, as often as asked
    #[output(max_size = 4)]
    repeated: Vec<u8>,
    /// how often
    #[parameter(tunable, start = 2)]
    times: u8,
}

impl Simulate for Repeater {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.repeated = self.bytes.repeat(self.times.into());
        Ok(())
    }
}

const N: usize = table_size::<Repeater>();
static MODELS: [Entry; 1] = [Entry::new::<Repeater, N>(interface::<Repeater, N>(None), &[])];
const BYTES: u32 = 0;
const REPEATED: u32 = 1;
const TIMES: u32 = 2;

#[test]
fn bytes_beyond_the_largest_size_are_refused_in_both_directions() {
    let token = Some(CString::new(MODELS[0].guid()).unwrap());
    let it = Instance::with(&Arguments { models: &MODELS, token, ..Arguments::new(PLAIN[1], 0) });
    it.start(0.0, None);
    let f = *it;
    it.fails(ERROR, "bytes = 3 bytes is refused; expected at most 2 bytes", |f| {
        f.set_all(Type::Binary, &[BYTES], &[3.0])
    });
    assert_eq!(f.set_all(Type::Binary, &[BYTES], &[2.0]), OK);
    assert_eq!(f.step(0.0, 1.0), OK);
    assert_eq!(f.read(Type::Binary, [REPEATED]), [4.0]);
    assert_eq!(f.set_all(Type::UInt8, &[TIMES], &[3.0]), OK);
    assert_eq!(f.step(1.0, 1.0), OK);
    it.fails(ERROR, "repeated has 6 bytes, more than its maximum size of 4", |f| {
        f.get_all(Type::Binary, &[REPEATED], 1).0
    });
}
