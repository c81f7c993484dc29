//! The XML schema of `terminalsAndIcons/terminalsAndIcons.xml` of FMI 3.0.2.

use super::fmi3::ANNOTATED;
use super::form::Form;
use super::{
    Attribute, OPTIONAL, REQUIRED, Schema, Type, extending, leaf, list, optional, part, sequence,
    some,
};

/// The schema of `terminalsAndIcons.xml`.
pub static TERMINALS_AND_ICONS: Schema = Schema {
    root: "fmiTerminalsAndIcons",
    of: &ROOT,
};

static ROOT: Type = sequence(
    &[("fmiVersion", Form::Version, REQUIRED)],
    &[
        optional(&[("GraphicalRepresentation", &REPRESENTATION)]),
        optional(&[("Terminals", &TERMINALS)]),
        ANNOTATED,
    ],
);

static REPRESENTATION: Type = list(&[
    optional(&[("CoordinateSystem", &COORDINATES)]),
    optional(&[("Icon", &ICON)]),
    ANNOTATED,
]);
const CORNERS: &[Attribute] = &[
    ("x1", Form::Real, REQUIRED),
    ("y1", Form::Real, REQUIRED),
    ("x2", Form::Real, REQUIRED),
    ("y2", Form::Real, REQUIRED),
];
static COORDINATES: Type = extending(
    &[CORNERS],
    &[("suggestedScalingFactorTo_mm", Form::Real, REQUIRED)],
    &[],
);
static ICON: Type = leaf(CORNERS);

static TERMINALS: Type = list(&[some(&[("Terminal", &TERMINAL)])]);
static TERMINAL: Type = sequence(
    &[
        ("name", Form::Text, REQUIRED),
        ("matchingRule", Form::Text, REQUIRED),
        ("terminalKind", Form::Text, OPTIONAL),
        ("description", Form::Text, OPTIONAL),
    ],
    &[
        part(&[("TerminalMemberVariable", &MEMBER)], 0, usize::MAX),
        part(&[("TerminalStreamMemberVariable", &STREAM)], 0, usize::MAX),
        part(&[("Terminal", &TERMINAL)], 0, usize::MAX),
        optional(&[("TerminalGraphicalRepresentation", &GRAPHICAL)]),
        ANNOTATED,
    ],
);
static MEMBER: Type = sequence(
    &[
        ("variableName", Form::Text, REQUIRED),
        ("memberName", Form::Text, OPTIONAL),
        ("variableKind", Form::Text, REQUIRED),
    ],
    &[ANNOTATED],
);
static STREAM: Type = sequence(
    &[
        ("inStreamMemberName", Form::Text, REQUIRED),
        ("outStreamMemberName", Form::Text, REQUIRED),
        ("inStreamVariableName", Form::Text, REQUIRED),
        ("outStreamVariableName", Form::Text, REQUIRED),
    ],
    &[ANNOTATED],
);
static GRAPHICAL: Type = extending(
    &[CORNERS],
    &[
        (
            "defaultConnectionColor",
            Form::List(&Form::UNSIGNED_BYTE),
            OPTIONAL,
        ),
        ("defaultConnectionStrokeSize", Form::Real, OPTIONAL),
        ("iconBaseName", Form::Text, REQUIRED),
    ],
    &[ANNOTATED],
);
