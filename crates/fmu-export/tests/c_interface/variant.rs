//! A variant of a model: another name and other start values, which the exporter passes to the compiler.

use std::ffi::{CStr, CString};
use std::ptr::null;

use fmu_description::Interface;
use fmu_export::Variables;
use fmu_export::fmi2::fmi2OK;
use fmu_export::{Entry, interface};

use crate::host::{Arguments, Slave, guid};
use crate::models::*;

const N: usize = <Probe as Variables>::COUNT;
/// gain = 3, order = 4, law = ignored, label = "slow", table[2,1] = -0.5, flags[1] = true
const FAST: Interface = interface::<Probe, N>(Some(
    "Probe=Fast;3:r16:40080000000000008:i1:410:i1:216:s4:slow21:r16:bfe000000000000026:b1:1",
));
static VARIANTS: &[Entry] = &[Entry::of::<Probe, N>(FAST, &[])];

fn variant(guid: &CStr) -> Slave {
    Slave::with(&Arguments {
        models: VARIANTS,
        guid: Some(guid),
        ..Arguments::default()
    })
}

#[test]
fn a_variant_starts_with_its_own_values_also_after_a_reset() {
    let own = CString::new(VARIANTS[0].guid()).unwrap();
    let mut slave = variant(&own);
    for _ in 0..2 {
        slave.start(0.0, None);
        assert_eq!(slave.get([GAIN, LIMIT, 20, 21]), [3.0, 1e6, 3.0, -0.5]);
        let integers = slave.get_all(Kind::Integer, &[ORDER, LAW, 14]);
        assert_eq!(integers, (fmi2OK, vec![4.0, 2.0, 3.0]));
        let flags = slave.get_all(Kind::Boolean, &[26, 27]);
        assert_eq!(flags, (fmi2OK, vec![1.0, 1.0]));
        let mut label = [null()];
        assert_eq!(slave.get_strings(&[LABEL], &mut label), fmi2OK);
        // SAFETY: no call was made since.
        assert_eq!(unsafe { CStr::from_ptr(label[0]) }, c"slow");
        assert_eq!(slave.set(LIMIT, 7.0), fmi2OK);
        assert_eq!(slave.reset(), fmi2OK);
    }
}

#[test]
fn a_variant_is_another_model() {
    let mut slave = variant(&guid(PROBE));
    assert!(slave.c.is_null());
    assert!(slave.last_message().contains("this binary has: Fast {"));
    slave = variant(&CString::new(VARIANTS[0].guid()).unwrap());
    let bytes = Slave::new().snapshot();
    slave.refuses(&["are a state of the model {"], |s| {
        s.deserialize(&bytes, &mut std::ptr::null_mut())
    });
}
