//! Snapshot tests of the command line: each file of `cmd/` is a session in its own folder.
//!
//! | line | |
//! |---|---|
//! | `# TEXT` | a comment |
//! | `> FILE`, then lines `\| TEXT` | writes a file |
//! | `= FILE OTHER [OLD => NEW]...` | writes a modified copy of another file, of the folder or of `tests/data` |
//! | `+ FMU [BINARY] [OLD => NEW]...` | writes an FMU of `tests/c/relay.c` or, as `Sums.fmu`, of `tests/c/sums.c`, with a modified XML |
//! | `$ cargo fmu ...` | runs a command; its output and exit code follow |
//!
//! A failing command must leave the folder unchanged. `SNAPSHOTS=overwrite cargo test` writes the
//! output of the commands to the files.
#![cfg(all(target_os = "linux", target_pointer_width = "64"))]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use fmu_file::archive::{self, MODEL_DESCRIPTION, Packed};
use regex::Regex;
use snapbox::{Assert, Data};

#[test]
fn sessions() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let relay = Relay::compile(&root.join("../../tests/c"));
    let mut files: Vec<_> =
        fs::read_dir(root.join("tests/cmd")).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    for file in files {
        let session = fs::read_to_string(&file).unwrap();
        let shown = Session::new(&relay).run(&session);
        let expected = Data::read_from(&file, None).raw();
        Assert::new().action_env("SNAPSHOTS").eq(shown, expected);
    }
}

struct Session<'a> {
    folder: tempfile::TempDir,
    relay: &'a Relay,
    shown: String,
}

impl<'a> Session<'a> {
    fn new(relay: &'a Relay) -> Self {
        Self { folder: tempfile::tempdir().unwrap(), relay, shown: String::new() }
    }

    /// Executes the lines of a session and returns them with the output of the commands.
    fn run(mut self, session: &str) -> String {
        let mut lines = session.lines().peekable();
        let mut after_command = false;
        while let Some(line) = lines.next() {
            let Some((mark @ ("#" | ">" | "=" | "+" | "$"), rest)) = line.split_once(' ') else {
                continue;
            };
            if after_command || (mark == "#" && !self.shown.is_empty()) {
                self.shown.push('\n');
            }
            after_command = mark == "$";
            self.shown += &format!("{line}\n");
            match mark {
                ">" => {
                    let mut text = String::new();
                    while let Some(line) = lines.next_if(|line| line.starts_with('|')) {
                        self.shown += &format!("{line}\n");
                        text += line[1..].strip_prefix(' ').unwrap_or(&line[1..]);
                        text.push('\n');
                    }
                    let file = self.folder.path().join(rest);
                    fs::create_dir_all(file.parent().unwrap()).unwrap();
                    fs::write(file, text).unwrap();
                }
                "=" => copy(self.folder.path(), rest),
                "+" => self.relay.write(self.folder.path(), rest),
                "$" => self.command(rest),
                _ => {}
            }
        }
        self.shown
    }

    fn command(&mut self, line: &str) {
        let words = shlex::split(line).unwrap();
        assert_eq!(words[..2], ["cargo", "fmu"], "{line}");
        let before = contents(self.folder.path());
        let output = Command::new(env!("CARGO_BIN_EXE_cargo-fmu"))
            .args(&words[1..])
            .current_dir(self.folder.path())
            .output()
            .unwrap();
        let text = [output.stdout, output.stderr].concat();
        let text = String::from_utf8(text).unwrap();
        assert!(!text.contains("panicked"), "{line}: {text}");
        self.shown += &stable(&text, self.folder.path());
        if !output.status.success() {
            self.shown += &format!("? {}\n", output.status.code().unwrap());
            assert!(before == contents(self.folder.path()), "{line} changed the folder");
        }
    }
}

/// Replaces the parts of a text that differ between runs and compilers.
fn stable(text: &str, folder: &Path) -> String {
    let text = text.replace(&folder.display().to_string(), "[FOLDER]");
    let hidden = [
        (r" in [0-9.]+ m?s: [0-9.]+ (times real time|a second)", " in [TIME]"),
        (r"[0-9]+ KB", "[SIZE] KB"),
        (r"/[^ ]*/fmu-[^/]*/", "[UNPACKED]/"),
        (r#" at path "[^"]*""#, ""),
        (r#""[^"]*/crates/fmu-export""#, "\"[CHECKOUT]/crates/fmu-export\""),
        // The progress of a build that takes long.
        (r"(?m)^building \w+: .*\n", ""),
        // What compilers print.
        (r"cannot be compiled: .*(\n  .*)+", "cannot be compiled: [COMMAND]"),
        (r"(?m) +$", ""),
    ];
    hidden.iter().fold(text, |text, (pattern, shown)| {
        let pattern = Regex::new(pattern).unwrap();
        pattern.replace_all(&text, *shown).into_owned()
    })
}

/// Writes a modified copy of a file.
fn copy(folder: &Path, line: &str) {
    let words = shlex::split(line).unwrap();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data");
    let text = fs::read_to_string(folder.join(&words[1]));
    let text = text.or_else(|_| fs::read_to_string(data.join(&words[1]))).unwrap();
    fs::write(folder.join(&words[0]), changed(&text, &words[2..])).unwrap();
}

/// Applies changes `OLD => NEW`, each to its first occurrence.
fn changed(text: &str, changes: &[String]) -> String {
    changes.chunks(3).fold(text.to_owned(), |text, change| {
        assert!(change[1] == "=>" && text.contains(&change[0]), "{change:?}");
        text.replacen(&change[0], &change[2].replace("\\n", "\n"), 1)
    })
}

/// All files below a folder except cargo's.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.ends_with("target") || path.ends_with("Cargo.lock") {
            continue;
        }
        if path.is_dir() {
            found.extend(contents(&path));
            found.insert(path, Vec::new());
        } else {
            let content = fs::read(&path).unwrap();
            found.insert(path, content);
        }
    }
    found
}

/// Builds of the FMU in C, by name.
struct Relay {
    /// The model descriptions of Relay.fmu and Sums.fmu.
    descriptions: [String; 2],
    binaries: BTreeMap<&'static str, Vec<u8>>,
}

impl Relay {
    fn compile(sources: &Path) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let compile = |name: &'static str| {
            let library = folder.path().join(name);
            let source = if name == "SUMS" { "sums.c" } else { "relay.c" };
            let status = Command::new("cc")
                .args(["-shared", "-fPIC", "-O1", &format!("-D{name}"), "-o"])
                .args([&library, &sources.join(source)])
                .status()
                .unwrap();
            assert!(status.success());
            (name, fs::read(library).unwrap())
        };
        let mut binaries =
            BTreeMap::from(["RELAY", "SUMS", "WITHOUT_STEP", "WITHOUT_INIT"].map(compile));
        binaries.insert("NONE", Vec::new());
        binaries.insert("BROKEN", b"\x7fELF, but no more".to_vec());
        let read = |name| fs::read_to_string(sources.join(name)).unwrap();
        Self { descriptions: ["relay.xml", "sums.xml"].map(read), binaries }
    }

    /// Writes an FMU, given its file, optionally the name of a binary or `PLATFORM=TEXT`, and changes.
    fn write(&self, folder: &Path, line: &str) {
        let words = shlex::split(line).unwrap();
        let (file, mut rest) = words.split_first().unwrap();
        let [relay, sums] = &self.descriptions;
        let (name, xml, path) = match file.ends_with("Sums.fmu") {
            true => ("SUMS", sums, "binaries/x86_64-linux/Sums.so"),
            false => ("RELAY", relay, "binaries/linux64/Relay.so"),
        };
        let (mut path, mut binary) = (path.to_owned(), self.binaries[name].clone());
        if let [name, others @ ..] = rest
            && others.len() % 3 == 0
        {
            rest = others;
            match name.split_once('=') {
                Some((other, text)) => (path, binary) = (other.into(), text.into()),
                None => binary = self.binaries[name.as_str()].clone(),
            }
        }
        let xml = changed(xml, rest);
        let xml = Packed::text(xml.as_bytes()).unwrap();
        let binary = Packed::program(&binary).unwrap();
        let entries = [(MODEL_DESCRIPTION, &xml), (path.as_str(), &binary)];
        let file = folder.join(file);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        archive::write(&file, &entries).unwrap();
    }
}

#[test]
fn a_message_that_nobody_reads_is_no_panic() {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let mut command = Command::new(env!("CARGO_BIN_EXE_cargo-fmu"));
    let status = command.args(["info", "missing.fmu"]).stderr(writer).status().unwrap();
    assert_eq!(status.code(), Some(1));
}
