//! Fuzzes `info` and `validate` with damaged FMUs, by libFuzzer: see `docs/quality.md`.
#![no_main]

use std::fs;
use std::io::{Cursor, Write, sink};
use std::path::PathBuf;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use cargo_fmu::commands::info;
use fmu_check::{Finding, Findings, Scope};
use libfuzzer_sys::fuzz_target;
use tempfile::NamedTempFile;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// Maximum memory allocated for one input (bytes).
const MAX_MEMORY: u64 = 256 << 20;

static FILE: LazyLock<NamedTempFile> = LazyLock::new(|| NamedTempFile::new().unwrap());

// An input is an archive, or a model description, which is packed into one.
fuzz_target!(|input: &[u8]| {
    let archive = if input.starts_with(b"PK") { input.to_vec() } else { pack(input) };
    fs::write(FILE.path(), archive).unwrap();
    let memory = allocation_counter::measure(examine);
    assert!(memory.bytes_max < MAX_MEMORY, "took {} bytes", memory.bytes_max);
});

/// Packs a model description and two other files into an archive.
fn pack(xml: &[u8]) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in [
        ("modelDescription.xml", xml),
        ("binaries/linux64/Full.so", b"\x7fELF\x02 and more"),
        ("resources/data", b""),
    ] {
        writer.start_file(name, SimpleFileOptions::default()).unwrap();
        writer.write_all(content).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// Runs `validate`, without binaries, and `info` on the file.
fn examine() {
    let mut findings = Findings::default();
    let deadline = Instant::now() + Duration::from_secs(60);
    let scope = Scope { probes: None, perform: None, compile: None, deadline };
    fmu_check::check(FILE.path(), &scope, &mut findings);
    let kept = findings.groups().iter().flat_map(|group| &group.kept);
    for Finding { location, text, .. } in kept {
        let message = format!("{location}: {text}");
        assert!(message.len() < 10_000 && !message.contains(char::is_control), "{message:?}");
    }
    let files = vec![PathBuf::from(FILE.path())];
    for json in [false, true] {
        let _ = info::run(&info::InfoArgs { files: files.clone(), json }, &mut sink());
    }
}
