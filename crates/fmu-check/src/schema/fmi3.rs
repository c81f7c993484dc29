//! The XML schema of model descriptions of FMI 3.0.2.

use super::form::Form;
use super::{
    Attribute, Content, OPTIONAL, Part, REQUIRED, Type, extending, leaf, list, one, optional, part,
    sequence, some,
};

pub static ROOT: Type = sequence(
    &[
        ("fmiVersion", Form::Version, REQUIRED),
        ("modelName", Form::Text, REQUIRED),
        ("instantiationToken", Form::Text, REQUIRED),
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
    ],
    &[
        optional(&[("ModelExchange", &MODEL_EXCHANGE)]),
        optional(&[("CoSimulation", &CO_SIMULATION)]),
        optional(&[("ScheduledExecution", &SCHEDULED_EXECUTION)]),
        optional(&[("UnitDefinitions", &UNITS)]),
        optional(&[("TypeDefinitions", &TYPES)]),
        optional(&[("LogCategories", &CATEGORIES)]),
        optional(&[("DefaultExperiment", &EXPERIMENT)]),
        one(&[("ModelVariables", &VARIABLES)]),
        one(&[("ModelStructure", &STRUCTURE)]),
        ANNOTATED,
    ],
);

/// What most elements may hold.
pub const ANNOTATED: Part = Part {
    choice: &[("Annotations", &ANNOTATIONS)],
    at_least: 0,
    at_most: 1,
};

static ANNOTATIONS: Type = list(&[some(&[("Annotation", &ANNOTATION)])]);
static ANNOTATION: Type = Type {
    shared: &[],
    attributes: &[("type", Form::Text, REQUIRED)],
    has_more: false,
    content: Content::Mixed,
};

const INTERFACE: &[Attribute] = &[
    ("modelIdentifier", Form::Text, REQUIRED),
    ("needsExecutionTool", Form::Boolean, OPTIONAL),
    (
        "canBeInstantiatedOnlyOncePerProcess",
        Form::Boolean,
        OPTIONAL,
    ),
    ("canGetAndSetFMUState", Form::Boolean, OPTIONAL),
    ("canSerializeFMUState", Form::Boolean, OPTIONAL),
    ("providesDirectionalDerivatives", Form::Boolean, OPTIONAL),
    ("providesAdjointDerivatives", Form::Boolean, OPTIONAL),
    ("providesPerElementDependencies", Form::Boolean, OPTIONAL),
];

const fn interface(attributes: &'static [Attribute]) -> Type {
    Type {
        shared: &[INTERFACE],
        attributes,
        has_more: true,
        content: Content::Sequence(&[ANNOTATED]),
    }
}

static MODEL_EXCHANGE: Type = interface(&[
    ("needsCompletedIntegratorStep", Form::Boolean, OPTIONAL),
    ("providesEvaluateDiscreteStates", Form::Boolean, OPTIONAL),
]);
static CO_SIMULATION: Type = interface(&[
    (
        "canHandleVariableCommunicationStepSize",
        Form::Boolean,
        OPTIONAL,
    ),
    ("fixedInternalStepSize", Form::Real, OPTIONAL),
    ("maxOutputDerivativeOrder", Form::UNSIGNED, OPTIONAL),
    (
        "recommendedIntermediateInputSmoothness",
        Form::INT,
        OPTIONAL,
    ),
    ("providesIntermediateUpdate", Form::Boolean, OPTIONAL),
    ("mightReturnEarlyFromDoStep", Form::Boolean, OPTIONAL),
    (
        "canReturnEarlyAfterIntermediateUpdate",
        Form::Boolean,
        OPTIONAL,
    ),
    ("hasEventMode", Form::Boolean, OPTIONAL),
    ("providesEvaluateDiscreteStates", Form::Boolean, OPTIONAL),
]);
static SCHEDULED_EXECUTION: Type = interface(&[]);

static UNITS: Type = list(&[some(&[("Unit", &UNIT)])]);
static UNIT: Type = sequence(
    &[("name", Form::Text, REQUIRED)],
    &[
        optional(&[("BaseUnit", &BASE_UNIT)]),
        part(&[("DisplayUnit", &DISPLAY_UNIT)], 0, usize::MAX),
        ANNOTATED,
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
static DISPLAY_UNIT: Type = sequence(
    &[
        ("name", Form::Text, REQUIRED),
        ("factor", Form::Real, OPTIONAL),
        ("offset", Form::Real, OPTIONAL),
        ("inverse", Form::Boolean, OPTIONAL),
    ],
    &[ANNOTATED],
);

static TYPES: Type = list(&[some(&[
    ("Float32Type", &FLOAT_TYPE),
    ("Float64Type", &FLOAT_TYPE),
    ("Int8Type", &INT8_TYPE),
    ("UInt8Type", &UINT8_TYPE),
    ("Int16Type", &INT16_TYPE),
    ("UInt16Type", &UINT16_TYPE),
    ("Int32Type", &INT32_TYPE),
    ("UInt32Type", &UINT32_TYPE),
    ("Int64Type", &INT64_TYPE),
    ("UInt64Type", &UINT64_TYPE),
    ("BooleanType", &PLAIN_TYPE),
    ("StringType", &PLAIN_TYPE),
    ("BinaryType", &BINARY_TYPE),
    ("EnumerationType", &ENUMERATION_TYPE),
    ("ClockType", &CLOCK_TYPE),
])]);

/// Attributes of all types.
const NAMED: &[Attribute] = &[
    ("name", Form::Text, REQUIRED),
    ("description", Form::Text, OPTIONAL),
];
const QUANTITY: &[Attribute] = &[("quantity", Form::Text, OPTIONAL)];
const FLOAT_ATTRIBUTES: &[Attribute] = &[
    ("unit", Form::Text, OPTIONAL),
    ("displayUnit", Form::Text, OPTIONAL),
    ("relativeQuantity", Form::Boolean, OPTIONAL),
    ("unbounded", Form::Boolean, OPTIONAL),
    ("min", Form::Real, OPTIONAL),
    ("max", Form::Real, OPTIONAL),
    ("nominal", Form::Real, OPTIONAL),
];
const BINARY_ATTRIBUTES: &[Attribute] = &[
    ("mimeType", Form::Text, OPTIONAL),
    ("maxSize", Form::NATURAL, OPTIONAL),
];
const CLOCK_ATTRIBUTES: &[Attribute] = &[
    ("canBeDeactivated", Form::Boolean, OPTIONAL),
    ("priority", Form::UNSIGNED, OPTIONAL),
    (
        "intervalVariability",
        Form::Word(&[
            "constant",
            "fixed",
            "tunable",
            "changing",
            "countdown",
            "triggered",
        ]),
        REQUIRED,
    ),
    ("intervalDecimal", Form::Real, OPTIONAL),
    ("shiftDecimal", Form::Real, OPTIONAL),
    ("supportsFraction", Form::Boolean, OPTIONAL),
    ("resolution", Form::UNSIGNED_LONG, OPTIONAL),
    ("intervalCounter", Form::UNSIGNED_LONG, OPTIONAL),
    ("shiftCounter", Form::UNSIGNED_LONG, OPTIONAL),
];

static FLOAT_TYPE: Type = extending(&[NAMED, QUANTITY, FLOAT_ATTRIBUTES], &[], &[ANNOTATED]);
static PLAIN_TYPE: Type = sequence(NAMED, &[ANNOTATED]);
static BINARY_TYPE: Type = extending(&[NAMED, BINARY_ATTRIBUTES], &[], &[ANNOTATED]);
static CLOCK_TYPE: Type = extending(&[NAMED, CLOCK_ATTRIBUTES], &[], &[ANNOTATED]);
static ENUMERATION_TYPE: Type = extending(
    &[NAMED, QUANTITY],
    &[("min", Form::LONG, OPTIONAL), ("max", Form::LONG, OPTIONAL)],
    &[ANNOTATED, some(&[("Item", &ITEM)])],
);
static ITEM: Type = sequence(
    &[
        ("name", Form::Text, REQUIRED),
        ("value", Form::LONG, REQUIRED),
        ("description", Form::Text, OPTIONAL),
    ],
    &[ANNOTATED],
);

static CATEGORIES: Type = list(&[some(&[("Category", &CATEGORY)])]);
static CATEGORY: Type = sequence(NAMED, &[ANNOTATED]);

static EXPERIMENT: Type = sequence(
    &[
        ("startTime", Form::Real, OPTIONAL),
        ("stopTime", Form::Real, OPTIONAL),
        ("tolerance", Form::Real, OPTIONAL),
        ("stepSize", Form::Real, OPTIONAL),
    ],
    &[ANNOTATED],
);

static VARIABLES: Type = list(&[some(&[
    ("Float32", &FLOAT),
    ("Float64", &FLOAT),
    ("Int8", &INT8),
    ("UInt8", &UINT8),
    ("Int16", &INT16),
    ("UInt16", &UINT16),
    ("Int32", &INT32),
    ("UInt32", &UINT32),
    ("Int64", &INT64),
    ("UInt64", &UINT64),
    ("Boolean", &BOOLEAN),
    ("String", &STRING),
    ("Binary", &BINARY),
    ("Enumeration", &ENUMERATION),
    ("Clock", &CLOCK),
])]);

/// Attributes of all variables.
const VARIABLE: &[Attribute] = &[
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
            "structuralParameter",
        ]),
        OPTIONAL,
    ),
    (
        "variability",
        Form::Word(&["constant", "fixed", "tunable", "discrete", "continuous"]),
        OPTIONAL,
    ),
    (
        "canHandleMultipleSetPerTimeInstant",
        Form::Boolean,
        OPTIONAL,
    ),
    ("clocks", Form::List(&Form::UNSIGNED), OPTIONAL),
];
/// Attributes of all variables but clocks.
const VALUE: &[Attribute] = &[
    ("intermediateUpdate", Form::Boolean, OPTIONAL),
    ("previous", Form::UNSIGNED, OPTIONAL),
    (
        "initial",
        Form::Word(&["exact", "approx", "calculated"]),
        OPTIONAL,
    ),
];
const TYPED: &[Attribute] = &[("declaredType", Form::Text, OPTIONAL)];

const DIMENSIONS: Part = Part {
    choice: &[("Dimension", &DIMENSION)],
    at_least: 0,
    at_most: usize::MAX,
};
static DIMENSION: Type = leaf(&[
    ("start", Form::UNSIGNED_LONG, OPTIONAL),
    ("valueReference", Form::UNSIGNED, OPTIONAL),
]);

const ALIASES: Part = Part {
    choice: &[("Alias", &ALIAS)],
    at_least: 0,
    at_most: usize::MAX,
};
static ALIAS: Type = leaf(NAMED);
static FLOAT_ALIAS: Type = extending(&[NAMED], &[("displayUnit", Form::Text, OPTIONAL)], &[]);

static FLOAT: Type = extending(
    &[VARIABLE, VALUE, TYPED, QUANTITY, FLOAT_ATTRIBUTES],
    &[
        ("start", Form::List(&Form::Real), OPTIONAL),
        ("derivative", Form::UNSIGNED, OPTIONAL),
        ("reinit", Form::Boolean, OPTIONAL),
    ],
    &[
        ANNOTATED,
        DIMENSIONS,
        part(&[("Alias", &FLOAT_ALIAS)], 0, usize::MAX),
    ],
);

/// Defines variables and types of whole numbers.
macro_rules! whole_numbers {
    ($($variable:ident, $defined:ident: $form:expr;)*) => {
        $(
            static $variable: Type = extending(
                &[VARIABLE, VALUE, TYPED, QUANTITY],
                &[
                    ("min", $form, OPTIONAL),
                    ("max", $form, OPTIONAL),
                    ("start", Form::List(&$form), OPTIONAL),
                ],
                &[ANNOTATED, DIMENSIONS, ALIASES],
            );
            static $defined: Type = extending(
                &[NAMED, QUANTITY],
                &[("min", $form, OPTIONAL), ("max", $form, OPTIONAL)],
                &[ANNOTATED],
            );
        )*
    };
}

whole_numbers! {
    INT8, INT8_TYPE: Form::BYTE;
    UINT8, UINT8_TYPE: Form::UNSIGNED_BYTE;
    INT16, INT16_TYPE: Form::SHORT;
    UINT16, UINT16_TYPE: Form::UNSIGNED_SHORT;
    INT32, INT32_TYPE: Form::INT;
    UINT32, UINT32_TYPE: Form::UNSIGNED;
    INT64, INT64_TYPE: Form::LONG;
    UINT64, UINT64_TYPE: Form::UNSIGNED_LONG;
}

static BOOLEAN: Type = extending(
    &[VARIABLE, VALUE, TYPED],
    &[("start", Form::List(&Form::Boolean), OPTIONAL)],
    &[ANNOTATED, DIMENSIONS, ALIASES],
);

static STRING: Type = extending(
    &[VARIABLE, VALUE, TYPED],
    &[],
    &[
        ANNOTATED,
        DIMENSIONS,
        part(&[("Start", &STRING_START)], 0, usize::MAX),
        ALIASES,
    ],
);
static STRING_START: Type = leaf(&[("value", Form::Text, OPTIONAL)]);

static BINARY: Type = extending(
    &[VARIABLE, VALUE, TYPED, BINARY_ATTRIBUTES],
    &[],
    &[
        ANNOTATED,
        DIMENSIONS,
        part(&[("Start", &BINARY_START)], 0, usize::MAX),
        ALIASES,
    ],
);
static BINARY_START: Type = leaf(&[("value", Form::Hex, OPTIONAL)]);

static ENUMERATION: Type = extending(
    &[VARIABLE, VALUE, QUANTITY],
    &[
        ("declaredType", Form::Text, REQUIRED),
        ("min", Form::LONG, OPTIONAL),
        ("max", Form::LONG, OPTIONAL),
        ("start", Form::List(&Form::LONG), OPTIONAL),
    ],
    &[ANNOTATED, DIMENSIONS, ALIASES],
);

static CLOCK: Type = extending(
    &[VARIABLE, TYPED, CLOCK_ATTRIBUTES],
    &[],
    &[ANNOTATED, ALIASES],
);

static STRUCTURE: Type = list(&[
    part(&[("Output", &UNKNOWN)], 0, usize::MAX),
    part(&[("ContinuousStateDerivative", &UNKNOWN)], 0, usize::MAX),
    part(&[("ClockedState", &UNKNOWN)], 0, usize::MAX),
    part(&[("InitialUnknown", &UNKNOWN)], 0, usize::MAX),
    part(&[("EventIndicator", &UNKNOWN)], 0, usize::MAX),
]);
static UNKNOWN: Type = sequence(
    &[
        ("valueReference", Form::UNSIGNED, REQUIRED),
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
    ],
    &[ANNOTATED],
);
