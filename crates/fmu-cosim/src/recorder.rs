//! What a simulation is doing, in memory that another process can read even after a crash.

use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use fmu_description::{FmiVersion, VariableType};
use fmu_host::SharedMemory;

use crate::Failure;

/// Records the call in progress, its communication point and the newest log message. Clones share the
/// record. By default it is ordinary memory; with a file, a supervisor reads what a process was doing
/// when it crashed.
#[derive(Debug, Clone)]
pub struct Recorder(SharedMemory);

/// The words of the record.
mod word {
    /// Number of the call, index of the component, function.
    pub(super) const CALL: usize = 0;
    /// The communication point (s) as bits; NaN before the initialization.
    pub(super) const TIME: usize = 1;
    /// The communication step (s) as bits.
    pub(super) const STEP: usize = 2;
    /// Whether the process has done its work.
    pub(super) const DONE: usize = 3;
    /// The word `CALL` when the newest message was logged.
    pub(super) const LOGGED_IN: usize = 4;
    /// Length of the message in bytes.
    pub(super) const LENGTH: usize = 5;
    /// The message.
    pub(super) const TEXT: usize = 6;
}

const MAX_TEXT: usize = 1024;
const WORDS: usize = word::TEXT + MAX_TEXT / 8;

/// Bits of the word `CALL` for the function, and for the component.
const FUNCTION_BITS: u32 = 8;
const COMPONENT_BITS: u32 = 24;
/// The bits of the word `CALL` that are not the number of the call.
const NOT_NUMBER: u64 = (1 << (FUNCTION_BITS + COMPONENT_BITS)) - 1;

/// The calls of an FMU of either version.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Function {
    None,
    Load,
    Instantiate,
    SetupExperiment,
    EnterInitializationMode,
    ExitInitializationMode,
    DoStep,
    Terminate,
    FreeInstance,
    GetReal,
    GetInteger,
    GetBoolean,
    SetReal,
    SetInteger,
    SetBoolean,
    SetString,
    GetFloat32,
    GetInt8,
    GetUInt8,
    GetInt16,
    GetUInt16,
    GetUInt32,
    GetInt64,
    GetUInt64,
    SetFloat32,
    SetInt8,
    SetUInt8,
    SetInt16,
    SetUInt16,
    SetUInt32,
    SetInt64,
    SetUInt64,
    EnterConfigurationMode,
    ExitConfigurationMode,
}

/// The bit of a function in the word `CALL` that tells that it is of FMI 3.0.
const FMI_3: u64 = 1 << (FUNCTION_BITS - 1);

/// The names of the functions in FMI 2.0 and FMI 3.0 and the purposes of the calls, in the order of
/// [`Function`].
const FUNCTIONS: [(&str, &str, &str); 34] = [
    ("", "", ""),
    ("loading the binary", "loading the binary", "instantiation"),
    (
        "fmi2Instantiate",
        "fmi3InstantiateCoSimulation",
        "instantiation",
    ),
    ("fmi2SetupExperiment", "", "initialization"),
    (
        "fmi2EnterInitializationMode",
        "fmi3EnterInitializationMode",
        "initialization",
    ),
    (
        "fmi2ExitInitializationMode",
        "fmi3ExitInitializationMode",
        "initialization",
    ),
    ("fmi2DoStep", "fmi3DoStep", "step"),
    ("fmi2Terminate", "fmi3Terminate", "end"),
    ("fmi2FreeInstance", "fmi3FreeInstance", "end"),
    ("fmi2GetReal", "fmi3GetFloat64", READING),
    ("fmi2GetInteger", "fmi3GetInt32", READING),
    ("fmi2GetBoolean", "fmi3GetBoolean", READING),
    ("fmi2SetReal", "fmi3SetFloat64", SETTING),
    ("fmi2SetInteger", "fmi3SetInt32", SETTING),
    ("fmi2SetBoolean", "fmi3SetBoolean", SETTING),
    ("fmi2SetString", "fmi3SetString", SETTING),
    ("", "fmi3GetFloat32", READING),
    ("", "fmi3GetInt8", READING),
    ("", "fmi3GetUInt8", READING),
    ("", "fmi3GetInt16", READING),
    ("", "fmi3GetUInt16", READING),
    ("", "fmi3GetUInt32", READING),
    ("", "fmi3GetInt64", READING),
    ("", "fmi3GetUInt64", READING),
    ("", "fmi3SetFloat32", SETTING),
    ("", "fmi3SetInt8", SETTING),
    ("", "fmi3SetUInt8", SETTING),
    ("", "fmi3SetInt16", SETTING),
    ("", "fmi3SetUInt16", SETTING),
    ("", "fmi3SetUInt32", SETTING),
    ("", "fmi3SetInt64", SETTING),
    ("", "fmi3SetUInt64", SETTING),
    ("", "fmi3EnterConfigurationMode", SETTING),
    ("", "fmi3ExitConfigurationMode", SETTING),
];
const READING: &str = "reading outputs";
const SETTING: &str = "setting inputs and parameters";

impl Function {
    /// Its name in a version of FMI.
    pub(crate) const fn name(self, version: FmiVersion) -> &'static str {
        let (in_2, in_3, _) = FUNCTIONS[self as usize];
        match version {
            FmiVersion::Fmi2 => in_2,
            FmiVersion::Fmi3 => in_3,
        }
    }

    /// The function that gets variables of a type, as `access` of [`Variable`](crate::Variable) has it.
    pub(crate) fn get(access: VariableType) -> Self {
        match access {
            VariableType::Boolean => Self::GetBoolean,
            VariableType::Float32 => Self::GetFloat32,
            VariableType::Int8 => Self::GetInt8,
            VariableType::UInt8 => Self::GetUInt8,
            VariableType::Int16 => Self::GetInt16,
            VariableType::UInt16 => Self::GetUInt16,
            VariableType::UInt32 => Self::GetUInt32,
            VariableType::Int64 => Self::GetInt64,
            VariableType::UInt64 => Self::GetUInt64,
            kind if kind.is_float() => Self::GetReal,
            _ => Self::GetInteger,
        }
    }

    /// The function that sets variables of a type.
    pub(crate) fn set(access: VariableType) -> Self {
        match access {
            VariableType::Boolean => Self::SetBoolean,
            VariableType::String => Self::SetString,
            VariableType::Float32 => Self::SetFloat32,
            VariableType::Int8 => Self::SetInt8,
            VariableType::UInt8 => Self::SetUInt8,
            VariableType::Int16 => Self::SetInt16,
            VariableType::UInt16 => Self::SetUInt16,
            VariableType::UInt32 => Self::SetUInt32,
            VariableType::Int64 => Self::SetInt64,
            VariableType::UInt64 => Self::SetUInt64,
            kind if kind.is_float() => Self::SetReal,
            _ => Self::SetInteger,
        }
    }
}

impl Default for Recorder {
    fn default() -> Self {
        Self(SharedMemory::private(WORDS))
    }
}

impl Recorder {
    /// Creates the file of a record.
    ///
    /// # Errors
    /// The file exists or cannot be written.
    pub fn create(file: &Path) -> io::Result<Self> {
        SharedMemory::create(file, WORDS).map(Self)
    }

    /// Opens the file of a record, in another process.
    ///
    /// # Errors
    /// The file cannot be read, or has another size.
    pub fn open(file: &Path) -> io::Result<Self> {
        let memory = SharedMemory::open(file)?;
        if memory.words().len() != WORDS {
            return Err(io::Error::other("it is not a record of calls"));
        }
        Ok(Self(memory))
    }

    #[inline]
    fn words(&self) -> &[AtomicU64] {
        self.0.words()
    }

    /// Records calls of a component, whose FMU is of a version of FMI.
    pub(crate) fn calls(&self, component: usize, version: FmiVersion) -> Calls {
        let flag = match version {
            FmiVersion::Fmi2 => 0,
            FmiVersion::Fmi3 => FMI_3,
        };
        let id = (component as u64) << FUNCTION_BITS & NOT_NUMBER | flag;
        Calls {
            recorder: self.clone(),
            word: self.call() & !NOT_NUMBER | id,
        }
    }

    /// Records that no call is in progress.
    pub(crate) fn end_call(&self) {
        self.calls(0, FmiVersion::Fmi2).begin(Function::None);
    }

    /// Records the communication point (s); NaN before the initialization.
    #[inline]
    pub(crate) fn at(&self, time: f64) {
        self.words()[word::TIME].store(time.to_bits(), Relaxed);
    }

    /// Records the communication step (s).
    pub(crate) fn step(&self, step: f64) {
        self.words()[word::STEP].store(step.to_bits(), Relaxed);
    }

    /// A number that differs for every call.
    #[inline]
    pub fn call(&self) -> u64 {
        self.words()[word::CALL].load(Relaxed)
    }

    /// Whether a call is in progress.
    pub fn is_in_call(&self) -> bool {
        function(self.call()) != Function::None as usize
    }

    /// The communication point (s), once the simulation has been initialized.
    pub fn time(&self) -> Option<f64> {
        let time = f64::from_bits(self.words()[word::TIME].load(Relaxed));
        (self.call() != 0 && !time.is_nan()).then_some(time)
    }

    /// Records that the process has done its work, whether it succeeded or reported an error.
    pub fn finish(&self) {
        self.words()[word::DONE].store(1, Relaxed);
    }

    /// Whether the process has done its work.
    pub fn is_finished(&self) -> bool {
        self.words()[word::DONE].load(Relaxed) != 0
    }

    /// Records a log message.
    pub(crate) fn log(&self, text: &str) {
        let words = self.words();
        let bytes = &text.as_bytes()[..text.len().min(MAX_TEXT)];
        for (word, chunk) in words[word::TEXT..].iter().zip(bytes.chunks(8)) {
            let mut eight = [0; 8];
            eight[..chunk.len()].copy_from_slice(chunk);
            word.store(u64::from_le_bytes(eight), Relaxed);
        }
        words[word::LENGTH].store(bytes.len() as u64, Relaxed);
        words[word::LOGGED_IN].store(self.call(), Relaxed);
    }

    /// The newest message, as the reason why the call in progress did not return.
    fn reason(&self) -> Option<String> {
        let words = self.words();
        let bytes = words[word::TEXT..]
            .iter()
            .flat_map(|word| word.load(Relaxed).to_le_bytes());
        let length = words[word::LENGTH].load(Relaxed) as usize;
        let bytes: Vec<u8> = bytes.take(length).collect();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        match words[word::LOGGED_IN].load(Relaxed) {
            _ if text.is_empty() => None,
            call if call == self.call() => Some(text),
            _ => Some(format!(
                "the last log message, of an earlier call, is {text:?}"
            )),
        }
    }

    /// The call in progress as a failure with this outcome, if there is one. `components` are the names
    /// of the components and of their files.
    pub fn failure(&self, components: &[(String, String)], outcome: &str) -> Option<Failure> {
        let call = self.call();
        let (in_2, in_3, what) = *FUNCTIONS.get(function(call))?;
        let function = match call & FMI_3 {
            0 => in_2,
            _ => in_3,
        };
        if function.is_empty() {
            return None;
        }
        let component = (call >> FUNCTION_BITS) as usize & ((1 << COMPONENT_BITS) - 1);
        let (component, fmu) = components.get(component).cloned().unwrap_or_default();
        let step = f64::from_bits(self.words()[word::STEP].load(Relaxed));
        Some(Failure {
            component,
            fmu,
            function,
            what: match what {
                "step" => format!("step of {step:?} s"),
                _ => what.to_owned(),
            },
            time: self.time(),
            outcome: outcome.to_owned(),
            message: self.reason(),
        })
    }
}

/// Records calls of a component. They are numbered without reading the record, so that no call waits for
/// the one before it; the numbers of different components differ, since the words contain the component.
#[derive(Debug)]
pub(crate) struct Calls {
    recorder: Recorder,
    /// The word `CALL` of the newest call, without its function.
    word: u64,
}

impl Calls {
    /// Records that a function is about to be called.
    #[inline]
    pub(crate) fn begin(&mut self, function: Function) {
        self.word = self.word.wrapping_add(NOT_NUMBER + 1);
        let word = self.word | function as u64;
        self.recorder.words()[word::CALL].store(word, Relaxed);
    }
}

/// The function of a word `CALL`.
fn function(call: u64) -> usize {
    (call & (FMI_3 - 1)) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_supervisor_reads_the_call_the_time_and_the_message() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("call");
        let supervisor = Recorder::create(&file).unwrap();
        let names = ["a", "b"].map(|name| (name.to_owned(), format!("{name}.fmu")));
        assert!(supervisor.failure(&names, "").is_none());
        assert!(!supervisor.is_in_call());

        let worker = Recorder::open(&file).unwrap();
        worker.step(0.25);
        worker.at(f64::NAN);
        worker
            .calls(0, FmiVersion::Fmi2)
            .begin(Function::Instantiate);
        let first = supervisor.call();
        let text = |outcome| supervisor.failure(&names, outcome).unwrap().to_string();
        assert_eq!(
            text("was ended by signal 6, abort"),
            "a (a.fmu), instantiation: fmi2Instantiate was ended by signal 6, abort; \
             the FMU logged no reason"
        );
        worker.at(1.5);
        worker.calls(1, FmiVersion::Fmi3).begin(Function::DoStep);
        worker.log("too fast: 9 > 8");
        assert_ne!(supervisor.call(), first);
        assert_eq!(
            text("was ended by signal 6, abort"),
            "b (b.fmu), step of 0.25 s at t = 1.5 s: fmi3DoStep was ended by signal 6, abort: \
             too fast: 9 > 8"
        );
        worker.end_call();
        assert!(!supervisor.is_in_call());
        assert!(!supervisor.is_finished());
        worker.finish();
        assert!(supervisor.is_finished());
    }

    #[test]
    fn every_function_has_its_name() {
        assert_eq!(Function::DoStep.name(FmiVersion::Fmi2), "fmi2DoStep");
        assert_eq!(Function::SetString.name(FmiVersion::Fmi2), "fmi2SetString");
        assert_eq!(
            FUNCTIONS.len(),
            Function::ExitConfigurationMode as usize + 1
        );
        for kind in VariableType::of(FmiVersion::Fmi3) {
            use VariableType as T;
            if !matches!(kind, T::Binary | T::Clock | T::Enumeration | T::String) {
                let name = format!("fmi3Get{}", kind.as_str());
                assert_eq!(Function::get(kind).name(FmiVersion::Fmi3), name);
                let name = format!("fmi3Set{}", kind.as_str());
                assert_eq!(Function::set(kind).name(FmiVersion::Fmi3), name);
            }
        }
    }
}
