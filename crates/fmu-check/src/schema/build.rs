//! The XML schema of `sources/buildDescription.xml` of FMI 3.0.2.

use super::fmi3::ANNOTATED;
use super::form::Form;
use super::{OPTIONAL, REQUIRED, Schema, Type, leaf, part, sequence, some};

/// The schema of `buildDescription.xml`.
pub static BUILD_DESCRIPTION: Schema = Schema {
    root: "fmiBuildDescription",
    of: &ROOT,
};

static ROOT: Type = sequence(
    &[("fmiVersion", Form::Version, REQUIRED)],
    &[some(&[("BuildConfiguration", &CONFIGURATION)]), ANNOTATED],
);
static CONFIGURATION: Type = sequence(
    &[
        ("modelIdentifier", Form::Text, REQUIRED),
        ("platform", Form::Text, OPTIONAL),
        ("description", Form::Text, OPTIONAL),
    ],
    &[
        part(&[("SourceFileSet", &SOURCES)], 0, usize::MAX),
        part(&[("Library", &LIBRARY)], 0, usize::MAX),
        ANNOTATED,
    ],
);
static SOURCES: Type = sequence(
    &[
        ("name", Form::Text, OPTIONAL),
        ("language", Form::Text, OPTIONAL),
        ("compiler", Form::Text, OPTIONAL),
        ("compilerOptions", Form::Text, OPTIONAL),
    ],
    &[
        some(&[("SourceFile", &NAMED)]),
        part(&[("PreprocessorDefinition", &DEFINITION)], 0, usize::MAX),
        part(&[("IncludeDirectory", &NAMED)], 0, usize::MAX),
        ANNOTATED,
    ],
);
static NAMED: Type = sequence(&[("name", Form::Text, REQUIRED)], &[ANNOTATED]);
static DEFINITION: Type = sequence(
    &[
        ("name", Form::Text, REQUIRED),
        ("optional", Form::Boolean, OPTIONAL),
        ("value", Form::Text, OPTIONAL),
        ("description", Form::Text, OPTIONAL),
    ],
    &[part(&[("Option", &CHOICE)], 0, usize::MAX), ANNOTATED],
);
static CHOICE: Type = leaf(&[
    ("value", Form::Text, OPTIONAL),
    ("description", Form::Text, OPTIONAL),
]);
static LIBRARY: Type = sequence(
    &[
        ("name", Form::Text, REQUIRED),
        ("version", Form::Text, OPTIONAL),
        ("external", Form::Boolean, OPTIONAL),
        ("description", Form::Text, OPTIONAL),
    ],
    &[ANNOTATED],
);
