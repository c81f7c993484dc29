//! Fuzzing of `info` and `validate` on damaged FMUs, for FUZZ_SECONDS (60): see `docs/fuzzing.md`.
//!
//! Inputs are mutated from a corpus. An input with a new kind of finding from `validate` is kept and
//! mutated further, which reaches deep into the checks without compiler instrumentation.

use std::collections::HashSet;
use std::fs;
use std::io::{Cursor, Write, sink};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use cargo_fmu::commands::info;
use fmu_check::{Finding, Findings};

/// Maximum time for one input.
const MAX_TIME: Duration = Duration::from_secs(5);
/// Maximum memory allocated for one input.
const MAX_MEMORY: u64 = 256 << 20;
/// Maximum size of an input.
const MAX_SIZE: usize = 1 << 18;
/// Maximum number of inputs kept for further mutation.
const MAX_KEPT: usize = 4000;

/// Values that often trigger bugs.
#[rustfmt::skip]
const WORDS: &[&str] = &[
    "", " ", "0", "1", "-1", "2", "4294967295", "4294967296", "2147483648", "-2147483649",
    "NaN", "INF", "-INF", "1e400", "-0", "1e-320", "true", "false", "TRUE", "2.0", "3.0",
    "input", "output", "parameter", "local", "independent", "calculatedParameter", "constant",
    "fixed", "tunable", "discrete", "continuous", "exact", "approx", "calculated", "structured",
    "flat", "1 2 3", "999999999", "der(", "'", "'\\", "a[", "a.", "&#0;", "&amp;", "&x;",
    "&#x110000;", "\u{feff}", "\u{202e}", "ä", "\u{1}", "]]>", "<a>", "</a>", "<!--", "-->",
    "<![CDATA[", "<?a", "?>", "<!DOCTYPE a [<!ENTITY x 'y'>]>", "xmlns:x",
    "2026-01-31T12:00:00Z", "2026-01-31T12:00:00+", "T", "-T:", "../", "Full", "rad",
];

/// File names in archives, valid and invalid.
#[rustfmt::skip]
const NAMES: &[&str] = &[
    "binaries/linux64/Full.so", "binaries/win64/Full.dll", "binaries/amiga/Full.library",
    "binaries/linux64/Pid.so", "binaries/", "sources/full.c", "resources/", "../evil",
    "/etc/passwd", "C:\\evil", "a\\b", "modelDescription.xml", "modeldescription.xml", "",
    "a//b", "a\u{0}b", "documentation/index.html",
];

/// Numbers that break the arithmetic of sizes and offsets.
#[rustfmt::skip]
const NUMBERS: &[u64] = &[
    0, 1, 0x7f, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, 0xffff_fffe, 0xffff_ffff, 1 << 40,
    u64::MAX >> 1, u64::MAX,
];

/// SplitMix64: the same seed gives the same run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound.max(1) as u64) as usize
    }

    fn one<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len())]
    }

    /// A range within a length, usually a short one.
    fn range(&mut self, length: usize) -> std::ops::Range<usize> {
        let start = self.below(length);
        let max = if self.below(4) == 0 { length } else { 16 };
        let end = start + self.below(max.min(length - start) + 1);
        start..end
    }
}

/// A fuzzing input.
#[derive(Clone)]
enum Input {
    /// A model description, which is packed into an archive.
    Xml(Vec<u8>),
    /// An archive.
    Fmu(Vec<u8>),
}

impl Input {
    fn mutate(&self, random: &mut Random) -> Self {
        let rounds = 1 + random.below(4);
        type Damage = fn(&mut Vec<u8>, &mut Random);
        let (bytes, damage, input): (_, Damage, fn(Vec<u8>) -> Self) = match self {
            Self::Xml(bytes) if random.below(8) == 0 => return Self::Fmu(pack(bytes, random)),
            Self::Xml(bytes) => (bytes, mutate_text, Self::Xml),
            Self::Fmu(bytes) => (bytes, mutate_bytes, Self::Fmu),
        };
        let mut bytes = bytes.clone();
        for _ in 0..rounds {
            damage(&mut bytes, random);
        }
        bytes.truncate(MAX_SIZE);
        input(bytes)
    }

    fn archive(&self) -> Vec<u8> {
        match self {
            Self::Xml(bytes) => pack(bytes, &mut Random(0)),
            Self::Fmu(bytes) => bytes.clone(),
        }
    }
}

/// Packs a model description and some other files into an archive.
fn pack(xml: &[u8], random: &mut Random) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    let mut add = |name: &str, content: &[u8], method| {
        let options = SimpleFileOptions::default().compression_method(method);
        // The writer rejects duplicate names; the archive then has one file less.
        if writer.start_file(name, options).is_ok() {
            writer.write_all(content).unwrap();
        }
    };
    let methods = [CompressionMethod::Stored, CompressionMethod::Deflated];
    add("modelDescription.xml", xml, random.one(&methods));
    for _ in 0..random.below(4) {
        let name = random.one(NAMES);
        add(name, b"\x7fELF\x02 and more", random.one(&methods));
    }
    writer.finish().unwrap().into_inner()
}

/// Damages bytes: flips bits, inserts numbers, cuts and repeats.
fn mutate_bytes(bytes: &mut Vec<u8>, random: &mut Random) {
    let at = random.below(bytes.len());
    let range = random.range(bytes.len());
    match random.below(6) {
        0 | 1 if !bytes.is_empty() => bytes[at] ^= 1 << random.below(8),
        2 => {
            let number = random.one(NUMBERS).to_le_bytes();
            let width = random.one(&[1, 2, 4, 8]);
            for (byte, new) in bytes[at..].iter_mut().zip(&number[..width]) {
                *byte = *new;
            }
        }
        3 => drop(bytes.drain(range)),
        4 => {
            let part = bytes[range].to_vec();
            bytes.splice(at..at, part);
        }
        _ => bytes.truncate(at),
    }
}

/// Damages the structure of a text: values, lines, whole elements.
fn mutate_text(text: &mut Vec<u8>, random: &mut Random) {
    match random.below(8) {
        0 => mutate_bytes(text, random),
        1..=3 => {
            let new = match random.below(4) {
                0 => between_quotes(text, random).map(|range| text[range].to_vec()),
                _ => Some(random.one(WORDS).as_bytes().to_vec()),
            };
            if let (Some(range), Some(new)) = (between_quotes(text, random), new) {
                text.splice(range, new);
            }
        }
        4 => {
            let at = random.below(text.len());
            text.splice(at..at, random.one(WORDS).bytes());
        }
        5 => drop(text.drain(lines(text, random))),
        6 => {
            let part = text[lines(text, random)].to_vec();
            let to = lines(text, random).start;
            text.splice(to..to, part);
        }
        _ => {
            let range = random.range(text.len());
            let times = random.one(&[2, 70, 1000]);
            let times = times.min(MAX_SIZE / range.len().max(1));
            let part = text[range.clone()].repeat(times);
            text.splice(range, part);
        }
    }
}

/// The range of a random quoted text.
fn between_quotes(text: &[u8], random: &mut Random) -> Option<std::ops::Range<usize>> {
    let from = random.below(text.len());
    let next = |from: usize| Some(from + text[from..].iter().position(|b| *b == b'"')?);
    let start = next(from)? + 1;
    Some(start..next(start)?)
}

/// The range of some random lines.
fn lines(text: &[u8], random: &mut Random) -> std::ops::Range<usize> {
    let breaks = (0..text.len()).filter(|&at| text[at] == b'\n');
    let starts: Vec<usize> = [0].into_iter().chain(breaks.map(|at| at + 1)).collect();
    let first = random.below(starts.len());
    let last = first + 1 + random.below(3);
    starts[first]..starts.get(last).copied().unwrap_or(text.len())
}

/// Runs `info` and `validate` on an archive; returns the kinds of the findings of `validate`.
fn examine(archive: &[u8], file: &Path) -> Vec<String> {
    fs::write(file, archive).unwrap();
    let start = Instant::now();
    let mut messages = Vec::new();
    let memory = allocation_counter::measure(|| {
        let mut findings = Findings::default();
        let deadline = Instant::now() + Duration::from_secs(60);
        fmu_check::check(file, None, deadline, &mut findings);
        let kept = findings.groups().iter().flat_map(|group| &group.kept);
        let message = |finding: &Finding| format!("{}: {}", finding.location, finding.text);
        messages = kept.map(message).collect();
        for json in [false, true] {
            let args = info::InfoArgs { files: vec![file.to_owned()], json };
            let _ = info::run(&args, &mut sink());
        }
    });
    assert!(start.elapsed() < MAX_TIME, "took {:?}", start.elapsed());
    assert!(memory.bytes_max < MAX_MEMORY, "took {} bytes", memory.bytes_max);
    for message in &messages {
        assert!(message.len() < 10_000 && !message.contains(char::is_control), "{message:?}");
    }
    messages.iter().map(|message| kind(message)).collect()
}

/// The first words of a message without quoted parts; reasons from libraries come later in the text.
fn kind(message: &str) -> String {
    let outside = message.split(['"', '`']).step_by(2);
    let words = outside.flat_map(|part| part.split_whitespace());
    words.filter(|word| word.chars().all(|c| c.is_ascii_alphabetic() || c == ',')).take(6).collect()
}

fn corpus() -> Vec<Input> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    let mut files: Vec<PathBuf> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    let input = |file: &PathBuf| {
        let bytes = fs::read(file).unwrap();
        match file.extension() {
            Some(extension) if extension == "xml" => Input::Xml(bytes),
            _ => Input::Fmu(bytes),
        }
    };
    files.iter().map(input).collect()
}

/// Runs inputs while `go_on` returns true; returns the numbers of inputs and of message kinds.
fn fuzz(seed: u64, mut go_on: impl FnMut(u64) -> bool) -> (u64, usize) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("input.fmu");
    let mut random = Random(seed);
    let mut pool = corpus();
    let mut kinds = HashSet::new();
    for input in &pool {
        kinds.extend(examine(&input.archive(), &file));
    }
    let mut count = pool.len() as u64;
    while go_on(count) {
        let input = pool[random.below(pool.len())].mutate(&mut random);
        let archive = input.archive();
        match catch_unwind(AssertUnwindSafe(|| examine(&archive, &file))) {
            Ok(found) => {
                let known = kinds.len();
                kinds.extend(found);
                if kinds.len() > known && pool.len() < MAX_KEPT {
                    pool.push(input);
                }
            }
            Err(panic) => {
                let kept = std::env::temp_dir().join(format!("fuzz-{seed}-{count}.fmu"));
                fs::write(&kept, &archive).unwrap();
                eprintln!("input {count} of seed {seed} is kept as {}", kept.display());
                resume_unwind(panic);
            }
        }
        count += 1;
    }
    (count, kinds.len())
}

fn main() {
    let seconds = std::env::var("FUZZ_SECONDS").unwrap_or("60".into());
    let limit = Duration::from_secs(seconds.parse().expect("FUZZ_SECONDS is a number"));
    let start = Instant::now();
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let seed = now.map_or(0, |time| time.as_secs());
    let (count, kinds) = fuzz(seed, |_| start.elapsed() < limit);
    println!(
        "seed {seed}: {count} inputs in {} s, {kinds} kinds of messages",
        start.elapsed().as_secs()
    );
}

#[test]
fn no_damaged_fmu_stops_info_or_validate() {
    fuzz(1, |count| count < 300);
}
