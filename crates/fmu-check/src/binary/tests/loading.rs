//! Loading a binary and creating instances.

use anyhow::Result;
use fmu_description::{Capability, Causality, FmiVersion, VariableType};
use fmu_file::text::quote;
use fmu_host::Treatment;

use super::calls::provoke;
use crate::binary::rules::{ARGUMENTS_COPIED, GUID, LOADS, VERSION};
use crate::binary::run::Run;
use crate::binary::subject::{Setup, Subject};

pub fn identity(subject: &Subject<'_>) -> Result<()> {
    let version = match subject.model.version {
        FmiVersion::Fmi2 => fmu_host::Version::Fmi2,
        FmiVersion::Fmi3 => fmu_host::Version::Fmi3,
    };
    let missing = subject.library.missing_of(version, subject.kind);
    for name in &missing {
        let text = format!("the function {name} is missing, expected it in the library");
        subject.report.find(&LOADS, text);
    }
    if !missing.is_empty() {
        return Ok(());
    }
    let library = subject.library;
    let texts = match subject.model.version {
        FmiVersion::Fmi2 => vec![
            ("fmi2GetVersion", library.version()?, "2.0"),
            ("fmi2GetTypesPlatform", library.types_platform()?, "default"),
        ],
        FmiVersion::Fmi3 => vec![("fmi3GetVersion", library.version_3()?, "3.0")],
    };
    for (function, text, expected) in texts {
        if text != expected {
            let text = format!("{function} gave {}, expected {expected:?}", quote(&text));
            subject.report.find(&VERSION, text);
        }
    }
    subject.instantiate(&subject.setup())?;
    Ok(())
}

pub fn guid(subject: &Subject<'_>) -> Result<()> {
    let wrong = "{00000000-0000-0000-0000-000000000000}";
    if subject.try_instantiate(&subject.setup(), wrong)?.is_some() {
        subject.report.find(
            &GUID,
            "fmi2Instantiate accepted the GUID of another FMU, expected NULL: a mismatch of XML and binary would go unnoticed",
        );
    }
    Ok(())
}

pub fn null(subject: &Subject<'_>) -> Result<()> {
    subject.report.stage("with NULL for the instance");
    subject.library.free_null()?;
    if subject.claims(Capability::CanGetAndSetFMUstate) {
        let mut run = Run::begin(subject, &subject.setup())?;
        subject.report.stage("with NULL for the state");
        run.instance.free_null_state()?;
    }
    Ok(())
}

/// Wrong calls, whose messages the FMU cannot log.
pub fn no_logger(subject: &Subject<'_>) -> Result<()> {
    let setup = Setup {
        treatment: Treatment::NoLogger,
        logging: true,
        ..subject.setup()
    };
    subject.report.stage("with a logger that is NULL");
    let _ = subject.try_instantiate(&setup, "{00000000-0000-0000-0000-000000000000}");
    let guid = subject.model.token();
    // An FMU may refuse to run without a logger.
    if subject.try_instantiate(&setup, guid)?.is_some() {
        provoke(subject, &setup);
    }
    Ok(())
}

pub fn no_resources(subject: &Subject<'_>) -> Result<()> {
    let setup = Setup {
        treatment: Treatment::NoResources,
        ..subject.setup()
    };
    subject
        .report
        .stage("with a resource location that is NULL");
    // An FMU that needs its resources may refuse.
    let _ = Run::begin(subject, &setup);
    Ok(())
}

/// Overwrites the strings that were passed to `fmi2Instantiate`.
pub fn short_lived_strings(subject: &Subject<'_>) -> Result<()> {
    let expected = Run::begin(subject, &subject.setup())?.record(subject.steps)?;
    let setup = Setup {
        treatment: Treatment::ShortLivedStrings,
        logging: true,
        ..subject.setup()
    };
    subject
        .report
        .stage("after the strings passed to fmi2Instantiate were overwritten");
    let actual = Run::begin(subject, &setup)?.record(subject.steps)?;
    provoke(subject, &setup);
    if let Some(text) = subject
        .observed
        .difference(&actual, &expected, subject.tolerance())
    {
        let text = format!("after the strings passed to fmi2Instantiate were overwritten, {text}");
        subject.report.find(&ARGUMENTS_COPIED, text);
    }
    if subject
        .logged
        .misnamed
        .load(std::sync::atomic::Ordering::Relaxed)
        > 0
    {
        subject.report.find(
            &ARGUMENTS_COPIED,
            "messages were logged with another name of the instance than the one passed to fmi2Instantiate",
        );
    }
    Ok(())
}

/// Uses names and values with percent signs, which must not be taken as formats of messages.
pub fn percent_signs(subject: &Subject<'_>) -> Result<()> {
    let stage = "with percent signs in the name of the instance and in Strings";
    with_text(subject, "%s%s%n%s%s%n%s%s%n%d", stage)
}

/// Uses a long name and long Strings.
pub fn long_texts(subject: &Subject<'_>) -> Result<()> {
    let stage = "with 20000 characters in the name of the instance and in Strings";
    with_text(subject, &"long".repeat(5000), stage)
}

fn with_text(subject: &Subject<'_>, text: &str, stage: &str) -> Result<()> {
    subject.report.stage(stage);
    let setup = Setup {
        name: text,
        logging: true,
        ..subject.setup()
    };
    provoke(subject, &setup);
    let Ok(mut run) = Run::instantiate(subject, &setup) else {
        return Ok(());
    };
    let text = [std::ffi::CString::new(text)?];
    let settable = |causality| matches!(causality, Causality::Parameter | Causality::Input);
    for variable in subject.all() {
        if variable.kind == VariableType::String
            && settable(variable.causality)
            && run
                .instance
                .set_string(&[variable.reference], &text)
                .is_err()
        {
            return Ok(());
        }
    }
    let _ = run.initialize().and_then(|()| run.advance());
    let _ = run.observe();
    Ok(())
}
