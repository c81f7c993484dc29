//! The compilers of this machine, and their processes.

use std::collections::HashMap;
use std::ffi::OsString;
use std::fs::{self, File};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use cc::Tool;
use fmu_file::text::plain;

use crate::error::{CompileError, MESSAGE_LINES};
use crate::options::CompilerFamily;

/// The target of this program.
const TARGET: &str = env!("TARGET");
/// Interval between looks at the processes.
const PERIOD: Duration = Duration::from_millis(5);
/// Maximum number of bytes of a compiler's output that are kept.
const MAX_OUTPUT: usize = 1 << 16;
/// Maximum length of a line of a compiler's output.
const MAX_LINE: usize = 400;
/// Maximum memory of a process (bytes), where the system can limit it.
#[cfg(target_os = "linux")]
const MAX_MEMORY: u64 = 8 << 30;

/// How to compile.
pub struct CompileControl<'a> {
    /// The time that all sources of an FMU may take.
    pub time_limit: Duration,
    /// Whether the compiler warns, in the log of a compilation.
    pub warns: bool,
    /// Whether the compiler stays in the group of this process, so that whoever kills the group ends it, too. Otherwise,
    /// it has a group of its own, all of which is killed when it is cancelled or exceeds the time limit.
    pub stays_in_group: bool,
    /// Is asked now and then whether to stop.
    pub is_cancelled: &'a dyn Fn() -> bool,
}

impl Default for CompileControl<'_> {
    fn default() -> Self {
        Self {
            time_limit: Duration::from_secs(600),
            warns: false,
            stays_in_group: false,
            is_cancelled: &|| false,
        }
    }
}

/// The compilers that were found.
#[derive(Default)]
pub struct Compilers(HashMap<(bool, Option<&'static str>), Compiler>);

/// A compiler of this machine, with the options that the user and the target need.
#[derive(Clone)]
pub struct Compiler {
    tool: Tool,
    pub family: CompilerFamily,
    /// The first options of a compiler that only resembles GCC and Clang, such as TCC.
    small: Option<Vec<OsString>>,
}

impl Compilers {
    /// The compiler for a language. `preferred` is the name of one that is taken if it is there, unless the user has
    /// chosen one by the environment variable `CC` or `CXX`.
    pub fn find(
        &mut self,
        is_cpp: bool,
        preferred: Option<&'static str>,
        warns: bool,
        folder: &Path,
    ) -> Result<Compiler, CompileError> {
        if let Some(known) = self.0.get(&(is_cpp, preferred)) {
            return Ok(known.clone());
        }
        let variable = if is_cpp { "CXX" } else { "CC" };
        let chosen = std::env::var_os(variable).filter(|program| !program.is_empty());
        let mut build = cc::Build::new();
        build.target(TARGET).host(TARGET).cpp(is_cpp).opt_level(2).debug(false).pic(true);
        build.static_crt(true).warnings(warns).extra_warnings(false).inherit_rustflags(false);
        // What cargo reads from build scripts.
        build.cargo_metadata(false).cargo_warnings(false).cargo_debug(false).cargo_output(false);
        build.emit_rerun_if_env_changed(false).out_dir(folder);
        let mut names: Vec<OsString> = Vec::new();
        if chosen.is_none() && !TARGET.ends_with("msvc") {
            let others: [&str; 3] =
                if is_cpp { ["c++", "g++", "clang++"] } else { ["cc", "gcc", "clang"] };
            names.extend(preferred.into_iter().chain(others).map(OsString::from));
        }
        let present = names.iter().find(|name| is_program(Path::new(name)));
        if let Some(name) = present {
            build.compiler(name);
        }
        let missing = |program: String| CompileError::MissingCompiler { is_cpp, program };
        let names = if is_cpp { "c++, g++ nor clang++" } else { "cc, gcc nor clang" };
        let none = || missing(format!("neither {names} was found"));
        let tool = build.try_get_compiler().map_err(|_| none())?;
        if !is_program(tool.path()) {
            let program = tool.path().display();
            return Err(match chosen {
                Some(_) => missing(format!("{variable} is {program}, which was not found")),
                None => none(),
            });
        }
        let family = match tool.is_like_msvc() && TARGET.ends_with("msvc") {
            true => CompilerFamily::Msvc,
            false => CompilerFamily::Gnu,
        };
        let is_known = tool.is_like_msvc() == (family == CompilerFamily::Msvc);
        let small = (!is_known).then(|| {
            let flags = std::env::var(format!("{}FLAGS", if is_cpp { "CXX" } else { "C" }));
            let flags = flags.unwrap_or_default();
            let words = ["-O2", "-fPIC"].into_iter().chain(flags.split_whitespace());
            words.map(OsString::from).collect()
        });
        let found = Compiler { tool, family, small };
        Ok(self.0.entry((is_cpp, preferred)).or_insert(found).clone())
    }
}

impl Compiler {
    /// A command that begins with the options of the compiler.
    pub fn command(&self) -> Command {
        match &self.small {
            None => self.tool.to_command(),
            Some(options) => {
                let mut command = Command::new(self.tool.path());
                command.args(options);
                command
            }
        }
    }

    /// Whether it is GCC or Clang, and not a smaller one that only resembles them.
    pub fn is_full(&self) -> bool {
        self.family == CompilerFamily::Gnu && self.small.is_none()
    }
}

/// Whether a program exists, in the folders of `PATH` if it has no path.
fn is_program(program: &Path) -> bool {
    if program.components().count() > 1 {
        return program.is_file();
    }
    let folders = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&folders).any(|folder| {
        let file = folder.join(program);
        file.is_file() || file.with_extension("exe").is_file()
    })
}

/// A call of a compiler.
pub struct Call {
    /// The file that an error names.
    pub file: String,
    pub command: Command,
}

impl Call {
    /// The command as a user would type it.
    pub fn line(&self) -> String {
        let words = [self.command.get_program()].into_iter().chain(self.command.get_args());
        let words = words.map(|word| {
            let word = word.to_string_lossy();
            let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./=+,:".contains(c);
            match !word.is_empty() && word.chars().all(is_plain) {
                true => word.into_owned(),
                false => format!("'{}'", plain(&word, MAX_LINE).replace('\'', r"'\''")),
            }
        });
        Vec::from_iter(words).join(" ")
    }
}

/// A process of a compiler. It and the processes that it has started are killed when it is dropped.
struct Running {
    child: Child,
    index: usize,
    has_group: bool,
}

impl Running {
    fn start(
        call: &mut Call,
        index: usize,
        folder: &Path,
        control: &CompileControl<'_>,
    ) -> Result<Self> {
        let output = File::create(output(folder, index))?;
        let command = &mut call.command;
        command.stdin(Stdio::null()).stdout(output.try_clone()?).stderr(output);
        let has_group = cfg!(unix) && !control.stays_in_group;
        #[cfg(unix)]
        if has_group {
            std::os::unix::process::CommandExt::process_group(command, 0);
        }
        let child = command.spawn();
        let child = child
            .with_context(|| format!("cannot start {}", command.get_program().to_string_lossy()))?;
        confine(&child, control.time_limit);
        Ok(Self { child, index, has_group })
    }
}

/// Limits what the compiler can use even if this process is killed.
#[cfg(target_os = "linux")]
fn confine(child: &Child, limit: Duration) {
    use rustix::process::{Pid, Resource, Rlimit, prlimit};
    let of = |most| Rlimit { current: Some(most), maximum: Some(most) };
    let pid = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
    for (resource, most) in [(Resource::Cpu, limit.as_secs() + 1), (Resource::As, MAX_MEMORY)] {
        // A user may have set lower limits, which cannot be raised.
        let _ = prlimit(pid, resource, of(most));
    }
}

#[cfg(not(target_os = "linux"))]
fn confine(_: &Child, _: Duration) {}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        #[cfg(unix)]
        if self.has_group {
            use rustix::process::{Pid, Signal, kill_process_group};
            let group = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw);
            let _ = group.map(|group| kill_process_group(group, Signal::KILL));
        }
        let _ = self.child.wait();
    }
}

/// The file with the output of a call.
fn output(folder: &Path, index: usize) -> std::path::PathBuf {
    folder.join(format!("{index}.txt"))
}

/// The output of a call, without control characters.
fn read_output(folder: &Path, index: usize) -> String {
    let bytes = fs::read(output(folder, index)).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(MAX_OUTPUT)]);
    let lines = text.lines().map(|line| plain(line.trim_end(), MAX_LINE) + "\n");
    lines.collect()
}

/// Makes the calls, several at a time, and returns their commands with what they print. `folder` is for their output.
///
/// # Errors
/// A call fails, or exceeds the limits.
pub fn run(
    mut calls: Vec<Call>,
    folder: &Path,
    control: &CompileControl<'_>,
    deadline: Instant,
) -> Result<String, CompileError> {
    let most = thread::available_parallelism().map_or(1, |count| count.get());
    let (mut running, mut started) = (Vec::<Running>::new(), 0);
    while started < calls.len() || !running.is_empty() {
        while started < calls.len() && running.len() < most {
            let call = &mut calls[started];
            running.push(Running::start(call, started, folder, control)?);
            started += 1;
        }
        let mut is_waiting = true;
        for at in (0..running.len()).rev() {
            let status = running[at].child.try_wait();
            if let Some(status) = status.map_err(|error| CompileError::Unusable(error.into()))? {
                let index = running.swap_remove(at).index;
                is_waiting = false;
                // Ctrl-C may have ended the compiler first.
                if !status.success() && !(control.is_cancelled)() {
                    return Err(failed(&calls[index], read_output(folder, index), status));
                }
            }
        }
        if (control.is_cancelled)() {
            return Err(CompileError::Cancelled);
        }
        if Instant::now() > deadline {
            return Err(CompileError::TimedOut(control.time_limit.as_secs()));
        }
        if is_waiting {
            thread::sleep(PERIOD);
        }
    }
    let calls = calls.iter().enumerate();
    Ok(calls.map(|(i, call)| format!("{}\n{}", call.line(), read_output(folder, i))).collect())
}

/// The error of a call, with the first lines that it printed; from the first error on, if that is later.
fn failed(call: &Call, output: String, status: std::process::ExitStatus) -> CompileError {
    let lines = Vec::from_iter(output.lines());
    let first = lines.iter().position(|line| line.contains("error"));
    let first = first.unwrap_or(0).saturating_sub(MESSAGE_LINES / 4);
    let mut kept = Vec::from_iter(lines.iter().skip(first).take(MESSAGE_LINES).copied());
    let more = format!("and {} more lines", lines.len().saturating_sub(first + kept.len()));
    if lines.len() > first + kept.len() {
        kept.push(&more);
    }
    let ended = status.to_string();
    if kept.is_empty() {
        kept.push(&ended);
    }
    CompileError::Failed { file: call.file.clone(), command: call.line(), message: kept.join("\n") }
}
