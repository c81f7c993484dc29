//! A model that reads a file of its resources in the initialization.

use std::ffi::{CStr, CString};
use std::fs;

use fmu_export::fmi2::fmi2OK;

use crate::host::{Arguments, Slave, guid};
use crate::models::READER;

const FILE: u32 = 0;
const SUM: u32 = 1;

/// An instance in initialization mode.
fn initializing(resources: Option<&CStr>) -> Slave {
    let guid = guid(READER);
    let mut slave = Slave::with(&Arguments {
        guid: Some(&guid),
        resources,
        ..Arguments::default()
    });
    assert_eq!(slave.enter_initialization_mode(), fmi2OK);
    slave
}

#[test]
fn a_model_reads_the_file_that_a_parameter_names() {
    let folder = tempfile::Builder::new().prefix("a b").tempdir().unwrap();
    for (name, text) in [
        ("weights.txt", "1\n2.5\n"),
        ("other.txt", "-1"),
        ("bad", "x"),
    ] {
        fs::write(folder.path().join(name), text).unwrap();
    }
    let path = folder.path().to_str().unwrap().replace('\\', "/");
    let uri = format!("file:///{}", path.trim_start_matches('/')).replace(' ', "%20");
    let mut slave = initializing(Some(&CString::new(uri).unwrap()));
    let name = |slave: &mut Slave, name: &CStr| {
        assert_eq!(slave.set_strings(&[FILE], &[name.as_ptr()]), fmi2OK);
    };
    assert_eq!(slave.get([SUM]), [3.5]);
    name(&mut slave, c"other.txt");
    assert_eq!(slave.get([SUM]), [-1.0]);
    name(&mut slave, c"missing.txt");
    let words = ["cannot read the resource ", "missing.txt: "];
    slave.refuses(&words, Slave::exit_initialization_mode);
    name(&mut slave, c"bad");
    slave.refuses(&["invalid float literal"], Slave::exit_initialization_mode);
    name(&mut slave, c"weights.txt");
    assert_eq!(slave.exit_initialization_mode(), fmi2OK);
    assert_eq!(slave.get([SUM]), [3.5]);
}

#[test]
fn a_missing_resource_location_is_an_error_in_the_initialization() {
    for (location, reason) in [
        (None, "the host passed no resource location"),
        (
            Some(c"http://host/a"),
            "\"http://host/a\" is not a file: URI",
        ),
        (Some(c"/a\xff"), "is not UTF-8"),
    ] {
        let words = ["the resource weights.txt cannot be found: ", reason];
        initializing(location).refuses(&words, Slave::exit_initialization_mode);
    }
}
