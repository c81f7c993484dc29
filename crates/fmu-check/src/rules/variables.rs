//! Rules for variables: their names, causality, variability, start values and value references (FMI
//! 2.0.5, sections 2.2.7 and 2.2.9; FMI 3.0.2, section 2.4.7), and what FMI 3.0 adds: arrays, structural
//! parameters, clocks and clocked variables (sections 2.4.4 and 2.4.7).

use std::collections::{HashMap, HashSet};

use fmu_description::value::{items, unsigned, whole};
use fmu_description::xml::Element;
use fmu_description::{
    Causality, FmiVersion, Initial, Listed, ModelDescription, Type, Variability,
};
use fmu_file::text::quote;

use super::definitions::{expected, float, is_clocked};
use crate::finding::{Findings, Location, find, require};
use crate::rule::{Rule, rules};

rules! {
    /// Names of variables.
    pub NAMES {
        UNIQUE_VARIABLE_NAMES: Error, "variable-unique", Standard("section 2.2.7", "section 2.4.7.4"),
            "The names of variables, and of their aliases in FMI 3.0, are unique.";
        VARIABLE_NAME_GIVEN: Error, "variable-named", Standard("section 2.2.7", "section 2.4.7.4"),
            "A variable has a name.";
        STRUCTURED_NAMES: Error, "structured-names", Standard("section 2.2.9", "section 2.4.7.5.1"),
            "Names follow the grammar of the naming convention structured, if the FMU declares it.";
        FLAT_NAMES: Error, "flat-names", Standard("section 2.2.9", "section 2.4.7.5.1"),
            "Names have no line breaks and tabs.";
        DERIVATIVE_NAMES: Error, "derivative-names", Standard("section 2.2.9", "section 2.4.7.5.1"),
            "Structured names der(...) are those of Reals, in FMI 3.0 Float32 or Float64.";
    }

    /// Variables, and those that share a value reference.
    pub VARIABLES {
        INDEPENDENT_REAL: Error, "independent-real", Standard("section 2.2.7", "section 2.4.7.4"),
            "The independent variable is a Real, in FMI 3.0 Float32 or Float64.";
        INDEPENDENT_ONCE: Error, "independent-once", Standard("section 2.2.7", "section 2.4.7.4"),
            "There is at most one independent variable, in FMI 3.0 exactly one.";
        COMBINATION: Error, "causality-variability", Standard("section 2.2.7", "section 2.4.7.4"),
            "Causality and variability are combined as the table of the standard allows.";
        INITIAL: Error, "initial", Standard("section 2.2.7", "section 2.4.7.5"),
            "initial is one that the table of the standard allows for causality and variability.";
        CONTINUOUS_REAL: Error, "continuous-real", Standard("section 2.2.7", "section 2.4.7.4"),
            "Only Reals, in FMI 3.0 Float32 and Float64, are continuous.";
        START_GIVEN: Error, "start-given", Standard("section 2.2.7", "section 2.4.7.5"),
            "Inputs, constants, and variables with initial exact or approx have a start value.";
        NO_START: Error, "no-start", Standard("section 2.2.7", "section 2.4.7.5"),
            "Variables with initial calculated and the independent variable have no start value.";
        DERIVATIVE_OF_STATE: Error, "derivative-of-state", Standard("section 2.2.7", "section 2.4.7.5"),
            "derivative names a continuous Real, in FMI 3.0 Float32 or Float64.";
        DERIVATIVE_INDEX: Error, "derivative-index", Standard("section 2.2.7", "section 2.4.7.5"),
            "derivative is the index, in FMI 3.0 the value reference, of a variable.";
        MULTIPLE_SET: Error, "multiple-set", Standard("section 2.2.7", "section 2.4.7.4"),
            "canHandleMultipleSetPerTimeInstant is given only for inputs, in FMI 2.0 of an FMU for model exchange.";
        REINIT: Error, "reinit", Standard("section 2.2.7", "section 2.4.7.5"),
            "reinit is given only for states, in FMI 2.0 of an FMU for model exchange.";
        REFERENCE_UNIQUE: Error, "reference-unique", Fmi3("section 2.4.7.4"),
            "The value references of variables are unique.";
        ALIAS_SETTABLE: Error, "alias-settable", Fmi2("section 2.2.7"),
            "At most one of the variables with the same value reference is set from outside.";
        ALIAS_CONSTANT: Error, "alias-constant", Fmi2("section 2.2.7"),
            "Variables with the value reference of a constant are constants with the same start value.";
        ALIAS_START: Error, "alias-start", Fmi2("section 2.2.7"),
            "At most one of the variables with the same value reference has a start value.";
        ALIAS_UNIT: Error, "alias-unit", Fmi2("section 2.2.7"),
            "Variables with the same value reference have the same unit.";
        ALIAS_VARIABILITY: Warning, "alias-variability", Fmi2("section 2.2.7"),
            "Variables with the same value reference have the same variability.";
    }
}

pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
    names(model, findings);
    let states: HashSet<usize> = (model.variables())
        .filter_map(|(_, v)| model.index(unsigned(v.value.attribute("derivative")?)?))
        .collect();
    for (index, variable) in model.variables() {
        combination(variable, model, findings);
        start(variable, findings);
        derivative(variable, model, findings);
        restricted(variable, states.contains(&index), model, findings);
    }
    independent(model, findings);
    match model.version {
        FmiVersion::Fmi2 => aliases(model, findings),
        FmiVersion::Fmi3 => references(model, findings),
    }
}

fn names(model: &ModelDescription<'_>, findings: &mut Findings) {
    let structured = model.root.attribute("variableNamingConvention") == Some("structured");
    let mut names = HashSet::new();
    for (_, variable) in model.variables() {
        for name in [variable.name.as_str()]
            .into_iter()
            .chain(variable.aliases())
        {
            require!(findings, UNIQUE_VARIABLE_NAMES at variable, names.insert(name),
                "two variables have the name {}, expected each once", quote(name));
            let is_given = !name.trim().is_empty();
            require!(findings, VARIABLE_NAME_GIVEN at variable, is_given,
                "the name is empty, expected a string");
            if structured && is_given {
                let is_structured = is_structured(name);
                require!(findings, STRUCTURED_NAMES at variable, is_structured,
                    "the name is not structured, expected a form such as a.b[1,2].c or der(a.b)");
                let is_derivative = is_structured && name.starts_with("der(");
                require!(findings, DERIVATIVE_NAMES at variable,
                    !is_derivative || variable.of_type.is_float(),
                    "the name is that of a derivative, expected a {}, not {}",
                    float(model), variable.value.name);
            }
            require!(findings, FLAT_NAMES at variable,
                structured || !name.contains(['\r', '\n', '\t']),
                "the name has a line break or tab, expected none");
        }
    }
}

/// Whether a name has the form of the naming convention `structured`.
fn is_structured(name: &str) -> bool {
    let whole = |text: &str| identifier(text).is_some_and(str::is_empty);
    match name
        .strip_prefix("der(")
        .and_then(|rest| rest.strip_suffix(')'))
    {
        None => whole(name),
        Some(inner) => match inner.rsplit_once(',') {
            // The comma may also separate indices.
            Some((inner, order)) if is_number(order) => whole(inner),
            _ => whole(inner),
        },
    }
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// The rest of a text after its leading identifier: names with indices, separated by dots.
fn identifier(mut text: &str) -> Option<&str> {
    loop {
        text = match text.strip_prefix('\'') {
            Some(rest) => quoted(rest)?,
            None => plain(text)?,
        };
        if let Some(rest) = text.strip_prefix('[') {
            let (indices, rest) = rest.split_once(']')?;
            if !indices.split(',').all(is_number) {
                return None;
            }
            text = rest;
        }
        match text.strip_prefix('.') {
            Some(rest) => text = rest,
            None => return Some(text),
        }
    }
}

/// The rest of a text after a name of letters, digits and underscores.
fn plain(text: &str) -> Option<&str> {
    let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let rest = text.trim_start_matches(is_name);
    let starts_well = text.starts_with(|c: char| is_name(c) && !c.is_ascii_digit());
    starts_well.then_some(rest)
}

/// The rest of a text after a quoted name, whose opening quote has been read.
fn quoted(text: &str) -> Option<&str> {
    let mut characters = text.char_indices();
    while let Some((at, character)) = characters.next() {
        match character {
            '\'' => return (at > 0).then(|| &text[at + 1..]),
            '\\' => {
                let (_, escaped) = characters.next()?;
                if !"'\"?\\abfnrtv".contains(escaped) {
                    return None;
                }
            }
            ' '..='~' => {}
            _ => return None,
        }
    }
    None
}

/// The values of `initial` allowed for a causality and a variability; `None` if that combination is
/// not allowed.
fn allowed(
    version: FmiVersion,
    causality: Causality,
    variability: Variability,
) -> Option<&'static [Option<Initial>]> {
    use Causality::{
        CalculatedParameter, Independent, Input, Local, Output, Parameter, StructuralParameter,
    };
    use Variability::{Constant, Continuous, Discrete, Fixed, Tunable};

    const EXACT: &[Option<Initial>] = &[Some(Initial::Exact)];
    const COMPUTED: &[Option<Initial>] = &[Some(Initial::Calculated), Some(Initial::Approx)];
    const ANY: &[Option<Initial>] = &[
        Some(Initial::Calculated),
        Some(Initial::Exact),
        Some(Initial::Approx),
    ];
    const NONE: &[Option<Initial>] = &[None];
    match (causality, variability) {
        (Input, Discrete | Continuous) if version == FmiVersion::Fmi3 => Some(EXACT),
        (Parameter | StructuralParameter, Fixed | Tunable) | (Output | Local, Constant) => {
            Some(EXACT)
        }
        (CalculatedParameter | Local, Fixed | Tunable) => Some(COMPUTED),
        (Output | Local, Discrete | Continuous) => Some(ANY),
        (Input, Discrete | Continuous) | (Independent, Continuous) => Some(NONE),
        _ => None,
    }
}

fn combination(variable: &Listed<'_>, model: &ModelDescription<'_>, findings: &mut Findings) {
    let causality = variable.causality.as_str();
    let variability = variable.variability.as_str();
    match allowed(model.version, variable.causality, variable.variability) {
        None => find!(findings, COMBINATION at variable,
            "causality {causality} and variability {variability} are combined, expected a \
             combination that the standard allows"),
        Some(initials) => require!(findings, INITIAL at variable,
            variable.of_type == Type::Clock || initials.contains(&variable.initial),
            "initial is {}, expected one that goes with causality {causality} and variability \
             {variability}", variable.element.attribute("initial").unwrap_or("missing")),
    }
    let is_continuous = variable.variability == Variability::Continuous;
    require!(findings, CONTINUOUS_REAL at variable, variable.of_type.is_float() || !is_continuous,
        "variability is continuous (or missing), expected another for the type {}",
        variable.value.name);
}

/// Whether it has a start value, which may be an empty text.
fn has_start(variable: &Listed<'_>) -> bool {
    variable.start().is_some() || variable.value.child("Start").is_some()
}

fn start(variable: &Listed<'_>, findings: &mut Findings) {
    if variable.of_type != Type::Clock {
        let is_given = matches!(variable.initial, Some(Initial::Exact | Initial::Approx));
        let needs = is_given || variable.causality == Causality::Input;
        let has = has_start(variable);
        require!(findings, START_GIVEN at variable, has || !needs,
            "it has no start, expected one for an input, a constant, and initial exact or approx");
        require!(findings, NO_START at variable, needs || !has,
            "it has a start, expected none for initial calculated and the independent variable");
    }
}

fn derivative(variable: &Listed<'_>, model: &ModelDescription<'_>, findings: &mut Findings) {
    let Some(number) = variable.value.attribute("derivative").and_then(unsigned) else {
        return;
    };
    match model.variable(model.index(number)) {
        None => find!(findings, DERIVATIVE_INDEX at variable,
            "derivative is {number}, expected {}", expected(model)),
        Some(state) => require!(findings, DERIVATIVE_OF_STATE at variable,
            state.of_type.is_float() && state.variability == Variability::Continuous,
            "it is the derivative of {:?}, expected a continuous {}", state.name, float(model)),
    }
}

/// Checks attributes that are for inputs or states only; in FMI 2.0, they are for model exchange only.
fn restricted(
    variable: &Listed<'_>,
    is_state: bool,
    model: &ModelDescription<'_>,
    findings: &mut Findings,
) {
    const SET: &str = "canHandleMultipleSetPerTimeInstant";
    let (is_exchanged, also) = match model.version {
        FmiVersion::Fmi2 => (model.model_exchange().is_some(), " and model exchange"),
        FmiVersion::Fmi3 => (true, ""),
    };
    let is_input = variable.causality == Causality::Input;
    require!(findings, MULTIPLE_SET at variable,
        !variable.element.has(SET) || is_exchanged && is_input,
        "it has {SET}, expected it only for inputs{also}");
    require!(findings, REINIT at variable,
        !variable.value.has("reinit") || is_exchanged && is_state,
        "it has reinit, expected it only for states{also}");
}

fn independent(model: &ModelDescription<'_>, findings: &mut Findings) {
    let mut first: Option<&str> = None;
    let is_independent = |v: &&Listed<'_>| v.causality == Causality::Independent;
    for variable in model.variables().map(|(_, v)| v).filter(is_independent) {
        require!(findings, INDEPENDENT_REAL at variable, variable.of_type.is_float(),
            "the independent variable is not a {0}, expected a {0}", float(model));
        if let Some(first) = first.replace(&variable.name) {
            find!(findings, INDEPENDENT_ONCE at variable,
                "it is independent like {first:?} is, expected at most one independent variable");
        }
    }
    let needs_one = model.version == FmiVersion::Fmi3;
    require!(findings, INDEPENDENT_ONCE at model.root, first.is_some() || !needs_one,
        "there is no independent variable, expected exactly one");
}

/// Checks that value references are unique, as in FMI 3.0.
fn references(model: &ModelDescription<'_>, findings: &mut Findings) {
    let mut names = HashMap::new();
    for (_, variable) in model.variables() {
        let reference = variable.reference;
        let first = names.entry(reference).or_insert(&variable.name);
        require!(findings, REFERENCE_UNIQUE at variable, **first == variable.name,
            "{first:?} has the value reference {reference}, too, expected each once");
    }
}

/// Checks variables of the same type and value reference, which share one value.
fn aliases(model: &ModelDescription<'_>, findings: &mut Findings) {
    let mut sets: HashMap<(Type, u32), Vec<&Listed<'_>>> = HashMap::new();
    for (_, variable) in model.variables() {
        let of_type = variable.of_type.accessed_as(model.version);
        let set = sets.entry((of_type, variable.reference));
        set.or_default().push(variable);
    }
    let mut sets: Vec<_> = sets.into_values().filter(|set| set.len() > 1).collect();
    sets.sort_by_key(|set| set[0].element.line);
    for set in sets {
        alias_set(&set, findings);
    }
}

fn alias_set(set: &[&Listed<'_>], findings: &mut Findings) {
    use Causality::{Independent, Input, Parameter};
    let first = set[0];
    let is_constant = |v: &Listed<'_>| v.variability == Variability::Constant;
    let is_settable = |v: &&&Listed<'_>| matches!(v.causality, Parameter | Input | Independent);
    let mut report = |rule: &'static Rule, variable: Option<&&Listed<'_>>, what: &str| {
        if let Some(variable) = variable {
            let text = format!("it has the value reference of {:?} {what}", first.name);
            findings.add(rule, *variable, text);
        }
    };
    let what = "though both are set from outside, expected at most one such variable";
    report(&ALIAS_SETTABLE, set.iter().filter(is_settable).nth(1), what);
    let has_constant = set.iter().any(|v| is_constant(v));
    if has_constant {
        let differs = |v: &&&Listed<'_>| v.start() != first.start() || !is_constant(v);
        let what = "which is constant, expected all to be constant with the same start";
        report(&ALIAS_CONSTANT, set.iter().find(differs), what);
    } else {
        let what = "and both have a start, expected at most one start";
        let mut started = set.iter().filter(|v| has_start(v));
        report(&ALIAS_START, started.nth(1), what);
        let expected = first.variability;
        let other = set.iter().find(|v| v.variability != expected);
        let (own, expected) = (
            other.unwrap_or(&first).variability.as_str(),
            expected.as_str(),
        );
        let what = format!("and is {own}, expected {expected} like that variable");
        report(&ALIAS_VARIABILITY, other, &what);
    }
    let other = set.iter().find(|v| v.unit != first.unit);
    report(
        &ALIAS_UNIT,
        other,
        "and another unit, expected the same unit",
    );
}

rules! {
    /// Arrays and structural parameters.
    pub ARRAYS {
        DIMENSION_SIZE: Error, "dimension-size", Fmi3("section 2.4.7.2"),
            "A Dimension has either start or valueReference.";
        DIMENSION_REFERENCE: Error, "dimension-reference", Fmi3("section 2.4.7.2"),
            "valueReference of a Dimension is that of a UInt64, which is a constant or a structural parameter.";
        DIMENSION_POSITIVE: Error, "dimension-positive", Fmi3("section 2.4.7.2"),
            "The initial size of a dimension is not 0.";
        STRUCTURAL_SCALAR: Error, "structural-scalar", Fmi3("section 2.4.7.4"),
            "A structural parameter has no dimensions.";
        START_COUNT: Error, "start-count", Fmi3("section 2.4.7.5"),
            "A variable with start values has one, or one for each of its elements.";
        START_SIZE: Error, "start-size", Fmi3("section 2.4.4"),
            "The start value of a Binary is not longer than maxSize.";
    }

    /// Clocks and clocked variables.
    pub CLOCKS {
        CLOCK_CAUSALITY: Error, "clock-causality", Fmi3("section 2.4.7.4"),
            "A clock is an input, an output or local.";
        CLOCKED_VARIABILITY: Error, "clocked-variability", Fmi3("section 2.4.7.4"),
            "Clocks are discrete, and clocked variables discrete or tunable.";
        CLOCKS_EXIST: Error, "clocks-exist", Fmi3("section 2.4.7.4"),
            "clocks has value references of clocks, at least one.";
        PREVIOUS_CLOCKED: Error, "previous-clocked", Fmi3("section 2.4.7.4"),
            "Only discrete clocked variables have previous.";
        PREVIOUS_REFERENCE: Error, "previous-reference", Fmi3("section 2.4.7.4"),
            "previous is the value reference of another discrete variable of the same type, which is no input, and of each at most once.";
        CLOCK_INTERVAL: Error, "clock-interval", Fmi3("section 2.4.4"),
            "The interval of a clock is positive, and its shift is not negative.";
        CLOCK_INTERVAL_GIVEN: Error, "clock-interval-given", Fmi3("section 2.4.4"),
            "A constant clock has intervalDecimal.";
        CLOCK_PERIODIC: Error, "clock-periodic", Fmi3("section 2.4.4"),
            "Only periodic clocks (constant, fixed, tunable) have intervalDecimal, intervalCounter and resolution.";
        CLOCK_SHIFT: Error, "clock-shift", Fmi3("section 2.4.4"),
            "shiftDecimal is given with intervalDecimal, and shiftCounter with intervalCounter.";
        CLOCK_FRACTION: Error, "clock-fraction", Fmi3("section 2.4.4"),
            "intervalCounter is given with a resolution and supportsFraction.";
        CLOCK_PRIORITY: Error, "clock-priority", Fmi3("section 2.4.4"),
            "In Scheduled Execution, input clocks have a priority; output clocks never have one.";
        CLOCKS_NEED_EVENTS: Error, "clocks-need-events", Fmi3("section 4.4"),
            "An FMU for Co-Simulation with clocks has hasEventMode.";
        INTERMEDIATE_UPDATE: Error, "intermediate-update", Fmi3("section 2.4.7.4"),
            "Only continuous variables have intermediateUpdate = true.";
    }
}

/// Applies the rules for what FMI 3.0 adds.
pub fn check_fmi3(model: &ModelDescription<'_>, findings: &mut Findings) {
    for (_, variable) in model.variables() {
        start_size(variable, findings);
        elements(variable, model, findings);
    }
    clocks(model, findings);
}

/// Checks the number of bytes of the start values of a Binary.
fn start_size(variable: &Listed<'_>, findings: &mut Findings) {
    let max = variable.inherited("maxSize").and_then(unsigned);
    let max = max.unwrap_or(u32::MAX);
    for start in variable.element.children("Start") {
        // Two digits a byte.
        let size = start.attribute("value").unwrap_or_default().trim().len() / 2;
        require!(findings, START_SIZE at variable, size <= max as usize,
            "its start value has {size} bytes, expected at most maxSize = {max}");
    }
}

/// Checks the dimensions of a variable, and how many start values it has.
fn elements(variable: &Listed<'_>, model: &ModelDescription<'_>, findings: &mut Findings) {
    let element = variable.element;
    if variable.causality == Causality::StructuralParameter
        && let Some(dimension) = element.child("Dimension")
    {
        find!(findings, STRUCTURAL_SCALAR at dimension,
            "the structural parameter has a Dimension, expected none");
    }
    let mut size = Some(1_u64);
    for dimension in element.children("Dimension") {
        let length = length(dimension, model, findings);
        size = size.zip(length).and_then(|(a, b)| a.checked_mul(b));
    }
    let is_list = matches!(variable.of_type, Type::String | Type::Binary);
    let starts = match is_list {
        true => element.children("Start").count(),
        false => element
            .attribute("start")
            .map_or(1, |start| items(start).count()),
    };
    if let Some(size) = size {
        let fits = starts == 1 || starts as u64 == size || is_list && starts == 0;
        let or_more = if size == 1 {
            String::new()
        } else {
            format!(" or {size}")
        };
        require!(findings, START_COUNT at variable, fits,
            "it has {starts} start values, expected 1{or_more}");
    }
}

/// The initial size of a dimension, if it is valid.
fn length(
    dimension: &Element<'_>,
    model: &ModelDescription<'_>,
    findings: &mut Findings,
) -> Option<u64> {
    let attribute = |name| dimension.attribute(name);
    let start = match (attribute("start"), attribute("valueReference")) {
        (Some(start), None) => start,
        (None, Some(reference)) => {
            let is_size = |v: &&Listed<'_>| {
                let is_structural = v.causality == Causality::StructuralParameter;
                v.of_type == Type::UInt64
                    && (is_structural || v.variability == Variability::Constant)
            };
            let Some(size) = model.referred(dimension, "valueReference").filter(is_size) else {
                find!(findings, DIMENSION_REFERENCE at dimension,
                    "valueReference of the Dimension is {reference}, expected that of a UInt64 that \
                     is a constant or a structural parameter");
                return None;
            };
            size.start()?
        }
        (start, _) => {
            let both = if start.is_some() {
                "both start and"
            } else {
                "neither start nor"
            };
            find!(findings, DIMENSION_SIZE at dimension,
                "the Dimension has {both} valueReference, expected one of them");
            return None;
        }
    };
    let length = whole(start)?;
    require!(findings, DIMENSION_POSITIVE at dimension, length > 0,
        "the initial size of the Dimension is 0, expected a positive number");
    Some(length)
}

fn clocks(model: &ModelDescription<'_>, findings: &mut Findings) {
    let has_clocks = model.variables().any(|(_, v)| v.of_type == Type::Clock);
    for interface in model.root.children("CoSimulation") {
        require!(findings, CLOCKS_NEED_EVENTS at interface, !has_clocks || interface.is_true("hasEventMode"),
            "the FMU has clocks, expected hasEventMode = true");
    }
    let mut types = HashMap::new();
    for defined in model.root.list("TypeDefinitions", "ClockType") {
        interval(defined, None, findings);
        types.insert(defined.attribute("name").unwrap_or_default(), defined);
    }
    let mut previous = HashSet::new();
    for (_, variable) in model.variables() {
        if variable.of_type == Type::Clock {
            clock(variable, model, &types, findings);
        }
        clocked(variable, model, findings);
        if let Some(reference) = variable.element.attribute("previous") {
            let is_first = previous.insert(reference.trim());
            previous_value(variable, reference, is_first, model, findings);
        }
    }
}

fn clock(
    variable: &Listed<'_>,
    model: &ModelDescription<'_>,
    types: &HashMap<&str, &Element<'_>>,
    findings: &mut Findings,
) {
    use Causality::{Input, Local, Output};
    let (clock, causality) = (variable.element, variable.causality);
    require!(findings, CLOCK_CAUSALITY at variable, matches!(causality, Input | Output | Local),
        "the clock has causality {}, expected input, output or local", causality.as_str());
    let declared = clock.attribute("declaredType");
    let declared = declared.and_then(|name| types.get(name).copied());
    interval(clock, declared, findings);
    let has_priority = clock.has("priority");
    require!(findings, CLOCK_PRIORITY at variable, causality != Output || !has_priority,
        "the output has a priority, expected none");
    let inherits = declared.is_some_and(|declared| declared.has("priority"));
    let needs_one = causality == Input && model.scheduled_execution().is_some();
    require!(findings, CLOCK_PRIORITY at variable, !needs_one || has_priority || inherits,
        "it has no priority, expected one in Scheduled Execution");
}

/// Checks the clocks of a variable, and the variability of clocks and clocked variables.
fn clocked(variable: &Listed<'_>, model: &ModelDescription<'_>, findings: &mut Findings) {
    let clocks = variable.element.attribute("clocks");
    let (what, expected) = match variable.of_type {
        Type::Clock => ("a clock", "discrete"),
        _ => ("clocked", "discrete or tunable"),
    };
    let is_clock = variable.of_type == Type::Clock;
    let fits = match variable.variability {
        Variability::Discrete => true,
        Variability::Tunable => !is_clock,
        _ => !is_clock && clocks.is_none(),
    };
    require!(findings, CLOCKED_VARIABILITY at variable, fits,
        "it is {what} with variability {}, expected {expected}", variable.variability.as_str());
    require!(findings, CLOCKS_EXIST at variable, clocks.is_none_or(|all| items(all).next().is_some()),
        "clocks is empty, expected value references of clocks");
    for clock in items(clocks.unwrap_or_default()) {
        let of = unsigned(clock).and_then(|number| model.variable(model.index(number)));
        require!(findings, CLOCKS_EXIST at variable, of.is_some_and(|of| of.of_type == Type::Clock),
            "clocks has {clock}, expected value references of clocks");
    }
    let is_continuous = variable.variability == Variability::Continuous;
    let is_updated = variable.element.is_true("intermediateUpdate");
    require!(findings, INTERMEDIATE_UPDATE at variable, !is_updated || is_continuous,
        "it has intermediateUpdate = true, expected it only for continuous variables");
}

fn previous_value(
    variable: &Listed<'_>,
    reference: &str,
    is_first: bool,
    model: &ModelDescription<'_>,
    findings: &mut Findings,
) {
    let is_discrete = |v: &Listed<'_>| v.variability == Variability::Discrete;
    require!(findings, PREVIOUS_CLOCKED at variable, is_clocked(variable) && is_discrete(variable),
        "it has previous, expected it only for discrete variables with clocks");
    let kind = variable.value.name;
    let fits = |before: &Listed<'_>| {
        let is_other = before.reference != variable.reference;
        is_other
            && before.value.name == kind
            && is_discrete(before)
            && before.causality != Causality::Input
    };
    let before = model.referred(variable.element, "previous");
    require!(findings, PREVIOUS_REFERENCE at variable, before.is_some_and(fits) && is_first,
        "previous is {reference}, expected the value reference of another discrete {kind} that is no \
         input, and of each at most once");
}

/// Checks when a clock ticks; a variable inherits from its declared type.
fn interval(clock: &Element<'_>, declared: Option<&Element<'_>>, findings: &mut Findings) {
    let at = || Location::of_variable(clock);
    let has = |name| clock.has(name) || declared.is_some_and(|declared| declared.has(name));
    for (name, may_be_zero, expected) in [
        ("intervalDecimal", false, "a positive number"),
        ("intervalCounter", false, "a positive number"),
        ("shiftDecimal", true, "0 or more"),
    ] {
        let value = clock.real(name).unwrap_or(1.0);
        require!(findings, CLOCK_INTERVAL at at(), value > 0.0 || may_be_zero && value == 0.0,
            "{name} is {value}, expected {expected}");
    }
    let variability = clock.attribute("intervalVariability").unwrap_or_default();
    require!(findings, CLOCK_INTERVAL_GIVEN at at(), variability != "constant" || has("intervalDecimal"),
        "the clock is constant and has no intervalDecimal, expected one");
    let is_periodic = !matches!(variability, "changing" | "countdown" | "triggered");
    for name in ["intervalDecimal", "intervalCounter", "resolution"] {
        require!(findings, CLOCK_PERIODIC at at(), is_periodic || !clock.has(name),
            "it has {name} and intervalVariability {variability}, expected {name} only for periodic \
             clocks");
    }
    for (shift, interval) in [
        ("shiftDecimal", "intervalDecimal"),
        ("shiftCounter", "intervalCounter"),
    ] {
        require!(findings, CLOCK_SHIFT at at(), !clock.has(shift) || has(interval),
            "it has {shift} and no {interval}, expected both");
    }
    let own = clock.attribute("supportsFraction").is_some();
    let supports = match declared {
        Some(declared) if !own => declared.is_true("supportsFraction"),
        _ => clock.is_true("supportsFraction"),
    };
    require!(findings, CLOCK_FRACTION at at(),
        !clock.has("intervalCounter") || supports && has("resolution"),
        "it has intervalCounter, expected a resolution and supportsFraction = true with it");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn structured_names_have_the_form_of_the_standard() {
        for good in [
            "a",
            "_a1",
            "a.b.c",
            "rbf.w[1]",
            "a[1,2].b[3]",
            "der(a)",
            "der(a.b[1])",
            "der(a[1,2])",
            "der(a,2)",
            "'a b'.c",
            "'it\\'s'",
            "a.'[x]'[2]",
            "der('a,b')",
        ] {
            assert!(is_structured(good), "{good}");
        }
        for bad in [
            "", "1a", "a.", ".a", "a..b", "a[", "a[]", "a[x]", "a[1", "a b", "a-b", "ä", "der(",
            "der()", "der(a", "a)", "''", "'a", "'a\\x'", "a[1,]", "der(a,)", "a[1]b",
        ] {
            assert!(!is_structured(bad), "{bad}");
        }
    }
}
