//! The XML schema of FMI 2.0.5 as tables, and the validation of a document against it.

use fmu_description::value::Form;
use fmu_description::xml::Element;
use fmu_description::{Causality, Initial, Variability};
use fmu_file::text::quote;

use super::finding::Findings;
use super::rule::rules;

rules! {
    /// What the XML schema requires.
    pub SCHEMA {
        ROOT_ELEMENT: Error, "root-element", Standard("section 2.2.1"),
            "The root element is fmiModelDescription.";
        NO_TEXT: Error, "no-text", Standard("section 2.2"),
            "Elements hold other elements, but no text.";
        ATTRIBUTE_REQUIRED: Error, "attribute-required", Standard("section 2.2"),
            "Required attributes are given.";
        ATTRIBUTE_VALUE: Error, "attribute-value", Standard("section 2.2"),
            "The value of an attribute has the form that the schema requires.";
        ATTRIBUTE_KNOWN: Error, "attribute-known", Standard("section 2.2"),
            "An element has no attributes but those of the schema.";
        ELEMENT_KNOWN: Error, "element-known", Standard("section 2.2"),
            "An element holds no elements but those of the schema.";
        ELEMENT_ORDER: Error, "element-order", Standard("section 2.2"),
            "Elements are in the order of the schema.";
        ELEMENT_ONCE: Error, "element-once", Standard("section 2.2"),
            "An element appears at most as often as the schema allows.";
        ELEMENT_REQUIRED: Error, "element-required", Standard("section 2.2"),
            "Required elements are given.";
        ONE_ANNOTATION: Warning, "one-annotation", Standard("section 2.2.6"),
            "The annotation of a tool is one element.";
    }
}

/// An attribute of an element: name, form, whether it is required.
type Attribute = (&'static str, Form, bool);

const REQUIRED: bool = true;
const OPTIONAL: bool = false;

/// The attributes and children that an element may have.
struct Type {
    attributes: &'static [Attribute],
    content: Content,
}

enum Content {
    /// Elements in this order.
    Sequence(&'static [Part]),
    /// At most one element, of any kind.
    Anything,
    /// Any children and attributes.
    Open,
}

/// A part of a sequence: the elements allowed there, and how many.
struct Part {
    choice: &'static [(&'static str, &'static Type)],
    at_least: usize,
    at_most: usize,
}

const fn one(choice: &'static [(&'static str, &'static Type)]) -> Part {
    part(choice, 1, 1)
}

const fn optional(choice: &'static [(&'static str, &'static Type)]) -> Part {
    part(choice, 0, 1)
}

const fn some(choice: &'static [(&'static str, &'static Type)]) -> Part {
    part(choice, 1, usize::MAX)
}

const fn part(
    choice: &'static [(&'static str, &'static Type)],
    at_least: usize,
    at_most: usize,
) -> Part {
    Part {
        choice,
        at_least,
        at_most,
    }
}

const fn leaf(attributes: &'static [Attribute]) -> Type {
    sequence(attributes, &[])
}

const fn list(content: &'static [Part]) -> Type {
    sequence(&[], content)
}

const fn sequence(attributes: &'static [Attribute], content: &'static [Part]) -> Type {
    Type {
        attributes,
        content: Content::Sequence(content),
    }
}

static ROOT: Type = sequence(
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
        ("numberOfEventIndicators", Form::Unsigned, OPTIONAL),
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
        ("maxOutputDerivativeOrder", Form::Unsigned, OPTIONAL),
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
    ("kg", Form::Integer, OPTIONAL),
    ("m", Form::Integer, OPTIONAL),
    ("s", Form::Integer, OPTIONAL),
    ("A", Form::Integer, OPTIONAL),
    ("K", Form::Integer, OPTIONAL),
    ("mol", Form::Integer, OPTIONAL),
    ("cd", Form::Integer, OPTIONAL),
    ("rad", Form::Integer, OPTIONAL),
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
    attributes: &[],
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
    ("min", Form::Integer, OPTIONAL),
    ("max", Form::Integer, OPTIONAL),
]);
static ENUMERATION_TYPE: Type = sequence(
    &[("quantity", Form::Text, OPTIONAL)],
    &[some(&[("Item", &ITEM)])],
);
static ITEM: Type = leaf(&[
    ("name", Form::Text, REQUIRED),
    ("value", Form::Integer, REQUIRED),
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
    attributes: &[("name", Form::Text, REQUIRED)],
    content: Content::Anything,
};

static VARIABLES: Type = list(&[some(&[("ScalarVariable", &VARIABLE)])]);
static VARIABLE: Type = sequence(
    &[
        ("name", Form::Text, REQUIRED),
        ("valueReference", Form::Unsigned, REQUIRED),
        ("description", Form::Text, OPTIONAL),
        ("causality", Form::Word(Causality::WORDS), OPTIONAL),
        ("variability", Form::Word(Variability::WORDS), OPTIONAL),
        ("initial", Form::Word(Initial::WORDS), OPTIONAL),
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
    ("derivative", Form::Unsigned, OPTIONAL),
    ("reinit", Form::Boolean, OPTIONAL),
]);
static INTEGER: Type = leaf(&[
    ("declaredType", Form::Text, OPTIONAL),
    ("quantity", Form::Text, OPTIONAL),
    ("min", Form::Integer, OPTIONAL),
    ("max", Form::Integer, OPTIONAL),
    ("start", Form::Integer, OPTIONAL),
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
    ("min", Form::Integer, OPTIONAL),
    ("max", Form::Integer, OPTIONAL),
    ("start", Form::Integer, OPTIONAL),
]);

static STRUCTURE: Type = list(&[
    optional(&[("Outputs", &UNKNOWNS)]),
    optional(&[("Derivatives", &UNKNOWNS)]),
    optional(&[("InitialUnknowns", &UNKNOWNS)]),
]);
static UNKNOWNS: Type = list(&[some(&[("Unknown", &UNKNOWN)])]);
static UNKNOWN: Type = leaf(&[
    ("index", Form::Unsigned, REQUIRED),
    ("dependencies", Form::Unsigneds, OPTIONAL),
    (
        "dependenciesKind",
        Form::Words(&["dependent", "constant", "fixed", "tunable", "discrete"]),
        OPTIONAL,
    ),
]);

/// Checks a model description against the schema.
pub fn check(root: &Element<'_>, findings: &mut Findings) {
    if root.name == "fmiModelDescription" {
        element(root, &ROOT, findings);
    } else {
        findings.add(
            &ROOT_ELEMENT,
            root,
            format!(
                "the root is {}, expected fmiModelDescription",
                quote(root.name)
            ),
        );
    }
}

fn element(element: &Element<'_>, of: &Type, findings: &mut Findings) {
    if let Content::Open = of.content {
        return;
    }
    attributes(element, of.attributes, findings);
    if element.has_text {
        findings.add(
            &NO_TEXT,
            element,
            format!("{} holds text, expected elements only", element.name),
        );
    }
    match of.content {
        Content::Sequence(parts) => children(element, parts, findings),
        Content::Anything if element.children.len() > 1 => findings.add(
            &ONE_ANNOTATION,
            element,
            format!(
                "{} holds {} elements, expected at most one",
                element.name,
                element.children.len()
            ),
        ),
        Content::Anything | Content::Open => {}
    }
}

fn attributes(element: &Element<'_>, of: &[Attribute], findings: &mut Findings) {
    for (name, form, required) in of {
        match element.attribute(name) {
            None if *required => findings.add(
                &ATTRIBUTE_REQUIRED,
                element,
                format!("{} has no attribute {name}, expected one", element.name),
            ),
            Some(value) if !form.fits(value) => findings.add(
                &ATTRIBUTE_VALUE,
                element,
                format!("{name} is {}, expected {}", quote(value), form.expected()),
            ),
            _ => {}
        }
    }
    for (name, _) in &element.attributes {
        // Namespaces and schema locations may appear in any element.
        let special = *name == "xmlns"
            || ["xmlns:", "xml:", "xsi:"]
                .iter()
                .any(|p| name.starts_with(p));
        if !special && !of.iter().any(|(known, _, _)| known == name) {
            findings.add(
                &ATTRIBUTE_KNOWN,
                element,
                format!(
                    "{} has the attribute {}, which FMI 2.0 does not define",
                    element.name,
                    quote(name)
                ),
            );
        }
    }
}

/// Checks that the elements of a sequence are known and in the order of the parts.
fn children(parent: &Element<'_>, parts: &[Part], findings: &mut Findings) {
    let mut counts = vec![0_usize; parts.len()];
    let mut reached = 0;
    for child in &parent.children {
        let found = parts.iter().enumerate().find_map(|(index, part)| {
            let (_, of) = part.choice.iter().find(|(name, _)| *name == child.name)?;
            Some((index, *of))
        });
        let Some((index, of)) = found else {
            findings.add(
                &ELEMENT_KNOWN,
                child,
                format!(
                    "{} holds {}, expected {}",
                    parent.name,
                    quote(child.name),
                    names(parts)
                ),
            );
            continue;
        };
        if index < reached {
            findings.add(
                &ELEMENT_ORDER,
                child,
                format!(
                    "{} comes after {}, expected it before",
                    child.name, parts[reached].choice[0].0
                ),
            );
        }
        reached = reached.max(index);
        counts[index] += 1;
        if counts[index] > parts[index].at_most && counts[index] <= parts[index].at_most + 1 {
            findings.add(
                &ELEMENT_ONCE,
                child,
                format!(
                    "{} holds too many {}, expected {} at most",
                    parent.name, child.name, parts[index].at_most
                ),
            );
        }
        element(child, of, findings);
    }
    for (part, count) in parts.iter().zip(counts) {
        if count < part.at_least {
            findings.add(
                &ELEMENT_REQUIRED,
                parent,
                format!(
                    "{} holds no {}, expected one",
                    parent.name,
                    names(std::slice::from_ref(part))
                ),
            );
        }
    }
}

fn names(parts: &[Part]) -> String {
    let names: Vec<_> = parts
        .iter()
        .flat_map(|part| part.choice)
        .map(|(name, _)| *name)
        .collect();
    if names.is_empty() {
        "nothing".into()
    } else {
        names.join(" or ")
    }
}
