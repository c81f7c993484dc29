//! The XML schema of FMI 2.0.5.

use super::form::Form;
use super::{Content, OPTIONAL, REQUIRED, Type, leaf, list, one, optional, part, sequence, some};

pub static ROOT: Type = sequence(
    &[
        ("fmiVersion", Form::Word(&["2.0"]), REQUIRED),
        ("modelName", Form::Text, REQUIRED),
        ("guid", Form::Text, REQUIRED),
        ("description", Form::Text, OPTIONAL),
        ("author", Form::Text, OPTIONAL),
        ("version", Form::Text, OPTIONAL),
        ("copyright", Form::Text, OPTIONAL),
        ("license", Form::Text, OPTIONAL),
        ("generationTool", Form::Text, OPTIONAL),
        ("generationDateAndTime", Form::DateTime, OPTIONAL),
        (
            "variableNamingConvention",
            Form::Word(&["flat", "structured"]),
            OPTIONAL,
        ),
        ("numberOfEventIndicators", Form::UNSIGNED, OPTIONAL),
    ],
    &[
        part(
            &[
                ("ModelExchange", &MODEL_EXCHANGE),
                ("CoSimulation", &CO_SIMULATION),
            ],
            1,
            2,
        ),
        optional(&[("UnitDefinitions", &UNITS)]),
        optional(&[("TypeDefinitions", &TYPES)]),
        optional(&[("LogCategories", &CATEGORIES)]),
        optional(&[("DefaultExperiment", &EXPERIMENT)]),
        optional(&[("VendorAnnotations", &ANNOTATIONS)]),
        one(&[("ModelVariables", &VARIABLES)]),
        one(&[("ModelStructure", &STRUCTURE)]),
    ],
);

static MODEL_EXCHANGE: Type = sequence(
    &[
        ("modelIdentifier", Form::Text, REQUIRED),
        ("needsExecutionTool", Form::Boolean, OPTIONAL),
        ("completedIntegratorStepNotNeeded", Form::Boolean, OPTIONAL),
        (
            "canBeInstantiatedOnlyOncePerProcess",
            Form::Boolean,
            OPTIONAL,
        ),
        (
            "canNotUseMemoryManagementFunctions",
            Form::Boolean,
            OPTIONAL,
        ),
        ("canGetAndSetFMUstate", Form::Boolean, OPTIONAL),
        ("canSerializeFMUstate", Form::Boolean, OPTIONAL),
        ("providesDirectionalDerivative", Form::Boolean, OPTIONAL),
    ],
    &[optional(&[("SourceFiles", &SOURCE_FILES)])],
);

static CO_SIMULATION: Type = sequence(
    &[
        ("modelIdentifier", Form::Text, REQUIRED),
        ("needsExecutionTool", Form::Boolean, OPTIONAL),
        (
            "canHandleVariableCommunicationStepSize",
            Form::Boolean,
            OPTIONAL,
        ),
        ("canInterpolateInputs", Form::Boolean, OPTIONAL),
        ("maxOutputDerivativeOrder", Form::UNSIGNED, OPTIONAL),
        ("canRunAsynchronuously", Form::Boolean, OPTIONAL),
        (
            "canBeInstantiatedOnlyOncePerProcess",
            Form::Boolean,
            OPTIONAL,
        ),
        (
            "canNotUseMemoryManagementFunctions",
            Form::Boolean,
            OPTIONAL,
        ),
        ("canGetAndSetFMUstate", Form::Boolean, OPTIONAL),
        ("canSerializeFMUstate", Form::Boolean, OPTIONAL),
        ("providesDirectionalDerivative", Form::Boolean, OPTIONAL),
    ],
    &[optional(&[("SourceFiles", &SOURCE_FILES)])],
);

static SOURCE_FILES: Type = list(&[some(&[("File", &leaf(&[("name", Form::Text, REQUIRED)]))])]);

static UNITS: Type = list(&[some(&[("Unit", &UNIT)])]);
static UNIT: Type = sequence(
    &[("name", Form::Text, REQUIRED)],
    &[
        optional(&[("BaseUnit", &BASE_UNIT)]),
        part(&[("DisplayUnit", &DISPLAY_UNIT)], 0, usize::MAX),
    ],
);
static BASE_UNIT: Type = leaf(&[
    ("kg", Form::INT, OPTIONAL),
    ("m", Form::INT, OPTIONAL),
    ("s", Form::INT, OPTIONAL),
    ("A", Form::INT, OPTIONAL),
    ("K", Form::INT, OPTIONAL),
    ("mol", Form::INT, OPTIONAL),
    ("cd", Form::INT, OPTIONAL),
    ("rad", Form::INT, OPTIONAL),
    ("factor", Form::Real, OPTIONAL),
    ("offset", Form::Real, OPTIONAL),
]);
static DISPLAY_UNIT: Type = leaf(&[
    ("name", Form::Text, REQUIRED),
    ("factor", Form::Real, OPTIONAL),
    ("offset", Form::Real, OPTIONAL),
]);

static TYPES: Type = list(&[some(&[("SimpleType", &SIMPLE_TYPE)])]);
static SIMPLE_TYPE: Type = sequence(
    &[
        ("name", Form::Text, REQUIRED),
        ("description", Form::Text, OPTIONAL),
    ],
    &[one(&[
        ("Real", &REAL_TYPE),
        ("Integer", &INTEGER_TYPE),
        ("Boolean", &OPEN),
        ("String", &OPEN),
        ("Enumeration", &ENUMERATION_TYPE),
    ])],
);
static OPEN: Type = Type {
    shared: &[],
    attributes: &[],
    has_more: false,
    content: Content::Open,
};
static REAL_TYPE: Type = leaf(&[
    ("quantity", Form::Text, OPTIONAL),
    ("unit", Form::Text, OPTIONAL),
    ("displayUnit", Form::Text, OPTIONAL),
    ("relativeQuantity", Form::Boolean, OPTIONAL),
    ("min", Form::Real, OPTIONAL),
    ("max", Form::Real, OPTIONAL),
    ("nominal", Form::Real, OPTIONAL),
    ("unbounded", Form::Boolean, OPTIONAL),
]);
static INTEGER_TYPE: Type = leaf(&[
    ("quantity", Form::Text, OPTIONAL),
    ("min", Form::INT, OPTIONAL),
    ("max", Form::INT, OPTIONAL),
]);
static ENUMERATION_TYPE: Type = sequence(
    &[("quantity", Form::Text, OPTIONAL)],
    &[some(&[("Item", &ITEM)])],
);
static ITEM: Type = leaf(&[
    ("name", Form::Text, REQUIRED),
    ("value", Form::INT, REQUIRED),
    ("description", Form::Text, OPTIONAL),
]);

static CATEGORIES: Type = list(&[some(&[("Category", &CATEGORY)])]);
static CATEGORY: Type = leaf(&[
    ("name", Form::Text, REQUIRED),
    ("description", Form::Text, OPTIONAL),
]);

static EXPERIMENT: Type = leaf(&[
    ("startTime", Form::Real, OPTIONAL),
    ("stopTime", Form::Real, OPTIONAL),
    ("tolerance", Form::Real, OPTIONAL),
    ("stepSize", Form::Real, OPTIONAL),
]);

static ANNOTATIONS: Type = list(&[some(&[("Tool", &TOOL)])]);
static TOOL: Type = Type {
    shared: &[],
    attributes: &[("name", Form::Text, REQUIRED)],
    has_more: false,
    content: Content::Anything,
};

static VARIABLES: Type = list(&[some(&[("ScalarVariable", &VARIABLE)])]);
static VARIABLE: Type = sequence(
    &[
        ("name", Form::Text, REQUIRED),
        ("valueReference", Form::UNSIGNED, REQUIRED),
        ("description", Form::Text, OPTIONAL),
        (
            "causality",
            Form::Word(&[
                "parameter",
                "calculatedParameter",
                "input",
                "output",
                "local",
                "independent",
            ]),
            OPTIONAL,
        ),
        (
            "variability",
            Form::Word(&["constant", "fixed", "tunable", "discrete", "continuous"]),
            OPTIONAL,
        ),
        (
            "initial",
            Form::Word(&["exact", "approx", "calculated"]),
            OPTIONAL,
        ),
        (
            "canHandleMultipleSetPerTimeInstant",
            Form::Boolean,
            OPTIONAL,
        ),
    ],
    &[
        one(&[
            ("Real", &REAL),
            ("Integer", &INTEGER),
            ("Boolean", &BOOLEAN),
            ("String", &STRING),
            ("Enumeration", &ENUMERATION),
        ]),
        optional(&[("Annotations", &ANNOTATIONS)]),
    ],
);
static REAL: Type = leaf(&[
    ("declaredType", Form::Text, OPTIONAL),
    ("quantity", Form::Text, OPTIONAL),
    ("unit", Form::Text, OPTIONAL),
    ("displayUnit", Form::Text, OPTIONAL),
    ("relativeQuantity", Form::Boolean, OPTIONAL),
    ("min", Form::Real, OPTIONAL),
    ("max", Form::Real, OPTIONAL),
    ("nominal", Form::Real, OPTIONAL),
    ("unbounded", Form::Boolean, OPTIONAL),
    ("start", Form::Real, OPTIONAL),
    ("derivative", Form::UNSIGNED, OPTIONAL),
    ("reinit", Form::Boolean, OPTIONAL),
]);
static INTEGER: Type = leaf(&[
    ("declaredType", Form::Text, OPTIONAL),
    ("quantity", Form::Text, OPTIONAL),
    ("min", Form::INT, OPTIONAL),
    ("max", Form::INT, OPTIONAL),
    ("start", Form::INT, OPTIONAL),
]);
static BOOLEAN: Type = leaf(&[
    ("declaredType", Form::Text, OPTIONAL),
    ("start", Form::Boolean, OPTIONAL),
]);
static STRING: Type = leaf(&[
    ("declaredType", Form::Text, OPTIONAL),
    ("start", Form::Text, OPTIONAL),
]);
static ENUMERATION: Type = leaf(&[
    ("declaredType", Form::Text, REQUIRED),
    ("quantity", Form::Text, OPTIONAL),
    ("min", Form::INT, OPTIONAL),
    ("max", Form::INT, OPTIONAL),
    ("start", Form::INT, OPTIONAL),
]);

static STRUCTURE: Type = list(&[
    optional(&[("Outputs", &UNKNOWNS)]),
    optional(&[("Derivatives", &UNKNOWNS)]),
    optional(&[("InitialUnknowns", &UNKNOWNS)]),
]);
static UNKNOWNS: Type = list(&[some(&[("Unknown", &UNKNOWN)])]);
static UNKNOWN: Type = leaf(&[
    ("index", Form::UNSIGNED, REQUIRED),
    ("dependencies", Form::List(&Form::UNSIGNED), OPTIONAL),
    (
        "dependenciesKind",
        Form::List(&Form::Word(&[
            "dependent",
            "constant",
            "fixed",
            "tunable",
            "discrete",
        ])),
        OPTIONAL,
    ),
]);
