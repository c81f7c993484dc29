//! Tests of the model descriptions.

use super::*;

fn variable(name: &str, causality: Causality, of_type: Type) -> VariableDescription {
    VariableDescription {
        name: name.into(),
        description: format!("{name} & co"),
        causality,
        variability: match causality {
            Causality::Parameter => Variability::Fixed,
            _ => Variability::Discrete,
        },
        has_input_derivative: false,
        dynamics: Dynamics::Algebraic,
        dimensions: Vec::new(),
        size: None,
        initially_from: Vec::new(),
        depends_on: Vec::new(),
        terminal: String::new(),
        of_type,
    }
}

fn real(unit: &str, start: &[f64]) -> Type {
    Type::Real {
        single: false,
        min: 0.0,
        max: f64::INFINITY,
        unit: unit.into(),
        start: start.into(),
    }
}

fn way(items: &[(i32, &str)]) -> Type {
    let item = |(value, name): &(i32, &str)| (*value, (*name).into(), String::new());
    Type::Enumeration {
        name: "Way".into(),
        description: "which way".into(),
        items: items.iter().map(item).collect(),
        start: vec![items[0].0],
    }
}

fn array(v: VariableDescription, from: &[usize]) -> VariableDescription {
    VariableDescription {
        dimensions: vec![1, 2],
        initially_from: from.into(),
        ..v
    }
}

fn model() -> Description {
    use Causality::{Input, Output, Parameter};
    let integer = Type::Integer {
        kind: IntegerKind::Int32,
        min: 1,
        max: i32::MAX.into(),
        start: vec![3],
    };
    let text = Type::String {
        start: vec!["a < b".into()],
    };
    Description {
        name: "Model".into(),
        description: "a \"model\"".into(),
        guid: "{1}".into(),
        is_sampled: false,
        is_continuous: false,
        default_experiment: (20.0, 0.001),
        tolerance: 1e-11,
        variables: vec![
            variable("u", Input, real("rad", &[0.0])),
            variable("y", Output, real("mN", &[])),
            variable("held", Output, real("1", &[1e-9])),
            array(variable("w0", Parameter, real("degC", &[0.25, 2.0])), &[]),
            array(variable("w", Output, real("1", &[])), &[3]),
            variable("n", Parameter, integer),
            variable("b", Parameter, Type::Boolean { start: vec![true] }),
            variable("file", Parameter, text),
            variable("way", Parameter, way(&[(4, "left"), (2, "right")])),
        ],
    }
}

fn xml(model: &Description) -> Element<'static> {
    model.to_xml(&Origin::default()).unwrap()
}

#[test]
fn elements_of_arrays_are_scalar_variables_with_consecutive_references() {
    let description = xml(&model());
    let variables: Vec<_> = description
        .list("ModelVariables", "ScalarVariable")
        .collect();
    let names: Vec<_> = variables
        .iter()
        .filter_map(|v| v.attribute("name"))
        .collect();
    assert_eq!(
        names,
        [
            "u", "y", "held", "w0[1,1]", "w0[1,2]", "w[1,1]", "w[1,2]", "n", "b", "file", "way"
        ]
    );
    for (reference, v) in variables.iter().enumerate() {
        assert_eq!(v.attribute("valueReference"), Some(&*reference.to_string()));
    }
    let start = |i: usize| variables[i].children[0].attribute("start");
    let starts = [1, 2, 4, 9].map(start);
    assert_eq!(
        starts,
        [None, Some("0.000000001"), Some("2"), Some("a < b")]
    );
    let initial = |i: usize| variables[i].attribute("initial");
    let initials = [0, 1, 2, 3].map(initial);
    assert_eq!(
        initials,
        [None, Some("calculated"), Some("exact"), Some("exact")]
    );
}

#[test]
fn arrays_depend_on_arrays_element_by_element() {
    let description = xml(&model());
    let structure = description.child("ModelStructure").unwrap();
    let dependencies: Vec<_> = structure
        .list("InitialUnknowns", "Unknown")
        .map(|u| {
            (
                u.attribute("index").unwrap(),
                u.attribute("dependencies").unwrap(),
            )
        })
        .collect();
    assert_eq!(dependencies, [("2", ""), ("6", "4"), ("7", "5")]);
}

#[test]
fn elements_follow_the_order_of_the_schema() {
    let description = xml(&model());
    let names: Vec<_> = description
        .children
        .iter()
        .map(|child| child.name)
        .collect();
    assert_eq!(
        names,
        [
            "CoSimulation",
            "UnitDefinitions",
            "TypeDefinitions",
            "LogCategories",
            "DefaultExperiment",
            "ModelVariables",
            "ModelStructure",
        ]
    );
    let xml = description.document().unwrap();
    for part in [
        "displayUnit=\"deg\"",
        "<DefaultExperiment startTime=\"0\" stopTime=\"20\" tolerance=\"1e-11\" stepSize=\"0.001\"/>",
        "<BaseUnit kg=\"1\" m=\"1\" s=\"-2\" factor=\"0.001\"/>",
        "<BaseUnit K=\"1\" offset=\"273.15\"/>",
        "way &amp; co",
        "<Enumeration declaredType=\"Way\" min=\"2\" max=\"4\" start=\"4\"/>",
        "<Integer min=\"1\" start=\"3\"/>",
        "canGetAndSetFMUstate=\"true\" canSerializeFMUstate=\"true\" providesDirectionalDerivative=\"false\"",
    ] {
        assert!(xml.contains(part), "{part} is missing in {xml}");
    }
}

#[test]
fn enumerations_of_one_name_have_the_same_items() {
    let mut model = model();
    let same = way(&[(4, "left"), (2, "right")]);
    let other = way(&[(1, "left"), (2, "right")]);
    model
        .variables
        .push(variable("back", Causality::Parameter, same));
    assert_eq!(xml(&model).list("TypeDefinitions", "SimpleType").count(), 1);
    model
        .variables
        .push(variable("again", Causality::Parameter, other));
    let error = model.to_xml(&Origin::default()).unwrap_err().to_string();
    assert!(error.contains("Way"), "{error}");
}

/// A mass on a spring that can hit a wall: two states in an order other than that of their derivatives.
fn spring() -> Description {
    use Causality::{Input, Local, Output};
    let variable = |name, causality, of_type, dynamics, depends_on: &[usize]| VariableDescription {
        variability: Variability::Continuous,
        dynamics,
        depends_on: depends_on.into(),
        ..variable(name, causality, of_type)
    };
    let none = Dynamics::Algebraic;
    let state = |nominal| Dynamics::State { nominal };
    let derivative = |of| Dynamics::Derivative { of };
    let count = Type::Integer {
        kind: IntegerKind::Int32,
        min: 0,
        max: i32::MAX.into(),
        start: vec![],
    };
    Description {
        name: "Spring".into(),
        is_continuous: true,
        variables: vec![
            variable("f", Input, real("N", &[0.0]), none, &[]),
            variable("v", Local, real("m/s", &[]), state(1.0), &[]),
            variable("der(v)", Local, real("m/s2", &[]), derivative(1), &[3, 0]),
            variable("x", Output, real("m", &[0.5]), state(1e-3), &[]),
            variable("der(x)", Local, real("m/s", &[]), derivative(3), &[1]),
            variable("power", Output, real("W", &[]), none, &[0, 1]),
            VariableDescription {
                variability: Variability::Discrete,
                ..variable("hits", Output, count, none, &[])
            },
            variable("gap", Local, real("m", &[]), Dynamics::EventIndicator, &[3]),
        ],
        ..model()
    }
}

/// The attributes of elements, an empty text for one that is missing.
fn attributes<const N: usize>(
    root: &Element<'_>,
    list: &str,
    names: [&str; N],
) -> Vec<[String; N]> {
    let list = root
        .child(list)
        .map(|list| &*list.children)
        .unwrap_or_default();
    let attribute = |element: &Element<'_>, name| match element.attribute(name) {
        Some("") => "none".to_owned(),
        value => value.unwrap_or_default().to_owned(),
    };
    (list.iter())
        .map(|element| names.map(|name| attribute(element, name)))
        .collect()
}

#[test]
fn the_equations_of_a_model_are_for_model_exchange() {
    let description = xml(&spring());
    let names = description.children.iter().map(|child| child.name);
    assert_eq!(
        names.take(2).collect::<Vec<_>>(),
        ["ModelExchange", "CoSimulation"]
    );
    assert_eq!(description.attribute("numberOfEventIndicators"), Some("1"));
    let flag = |kind, name| description.child(kind).and_then(|e| e.attribute(name));
    assert_eq!(flag("ModelExchange", "modelIdentifier"), Some("Spring"));
    assert_eq!(
        flag("ModelExchange", "providesDirectionalDerivative"),
        Some("true")
    );
    // That of `power` is unknown.
    assert_eq!(flag("CoSimulation", "maxOutputDerivativeOrder"), Some("0"));
    let variables = description.child("ModelVariables").unwrap();
    let of_states: Vec<_> = (variables.children.iter())
        .map(|v| {
            (
                v.children[0].attribute("derivative"),
                v.children[0].attribute("nominal"),
                v.children[0].attribute("reinit"),
            )
        })
        .collect();
    let expected = [
        (None, None, None),
        (None, None, Some("true")),
        (Some("2"), None, None),
        (None, Some("0.001"), Some("true")),
        (Some("4"), None, None),
    ];
    assert_eq!(of_states[..5], expected);
    let structure = description.child("ModelStructure").unwrap();
    let unknowns = |list| attributes(structure, list, ["index", "dependencies"]);
    assert_eq!(
        unknowns("Outputs"),
        [["4", "4"], ["6", "1 2"], ["7", "none"]]
    );
    assert_eq!(unknowns("Derivatives"), [["3", "1 4"], ["5", "2"]]);
    // All may depend on the input, and on x, which is exact.
    let expected = ["2", "3", "5", "6", "7"].map(|index| [index, "1 4"]);
    assert_eq!(unknowns("InitialUnknowns"), expected);
}

#[test]
fn capabilities_follow_from_the_equations() {
    let flag = |model: &Description, kind, name| {
        let root = xml(model);
        root.child(kind)?.attribute(name).map(str::to_owned)
    };
    let directional = "providesDirectionalDerivative";
    let mut spring = spring();
    spring.variables[5].depends_on.clear();
    let outputs = attributes(
        xml(&spring).child("ModelStructure").unwrap(),
        "Outputs",
        ["dependencies"],
    );
    assert_eq!(outputs[1], [""]);
    assert_eq!(
        flag(&spring, "ModelExchange", directional).unwrap(),
        "false"
    );
    spring.variables.remove(5);
    assert_eq!(flag(&spring, "ModelExchange", directional).unwrap(), "true");
    let order = flag(&spring, "CoSimulation", "maxOutputDerivativeOrder");
    assert_eq!(order.unwrap(), "1");

    assert_eq!(flag(&model(), "ModelExchange", directional), None);
    let sampled = Description {
        is_sampled: true,
        ..model()
    };
    assert_eq!(
        flag(&sampled, "ModelExchange", directional).unwrap(),
        "false"
    );
    assert_eq!(
        xml(&sampled).attribute("numberOfEventIndicators"),
        Some("0")
    );
    assert_eq!(xml(&model()).attribute("numberOfEventIndicators"), None);
}

#[test]
fn names_of_derivatives_follow_the_grammar_of_the_standard() {
    let states = VariableDescription {
        dimensions: vec![2],
        ..spring().variables[2].clone()
    };
    assert_eq!(states.element_name(1), "der(v[2])");
    assert_eq!(
        crate::table::joined(&["", "arm", "joint"], "der(v)"),
        "der(arm.joint.v)"
    );
    assert_eq!(crate::table::joined(&["arm", ""], "v"), "arm.v");
}

#[test]
fn arrays_are_single_variables_in_fmi_3() {
    let description = model().to_xml_fmi3(&Origin::default()).unwrap();
    let variables = description.child("ModelVariables").unwrap();
    let found: Vec<_> = (variables.children.iter())
        .map(|v| {
            (
                v.name,
                v.attribute("name").unwrap(),
                v.attribute("valueReference").unwrap(),
            )
        })
        .collect();
    let expected = [
        ("Float64", "u", "0"),
        ("Float64", "y", "1"),
        ("Float64", "held", "2"),
        ("Float64", "w0", "3"),
        ("Float64", "w", "5"),
        ("Int32", "n", "7"),
        ("Boolean", "b", "8"),
        ("String", "file", "9"),
        ("Enumeration", "way", "10"),
        ("Float64", "time", "11"),
    ];
    assert_eq!(found, expected);
    let xml = description.document().unwrap();
    for part in [
        "fmiVersion=\"3.0\" modelName=\"Model\" instantiationToken=\"{1}\"",
        "min=\"0\" start=\"0.25 2\">\n      <Dimension start=\"1\"/>\n      <Dimension start=\"2\"/>",
        "<Start value=\"a &lt; b\"/>",
        "<EnumerationType name=\"Way\" description=\"which way\">\n      <Item name=\"left\" value=\"4\"",
        "declaredType=\"Way\" min=\"2\" max=\"4\" start=\"4\"",
        "description=\"Simulation time\" causality=\"independent\" variability=\"continuous\" unit=\"s\"",
        "<Unit name=\"s\">",
        "<Output valueReference=\"5\" dependencies=\"\"/>",
        "<InitialUnknown valueReference=\"5\" dependencies=\"3\"/>",
        "hasEventMode=\"false\"",
    ] {
        assert!(xml.contains(part), "{part} is missing in {xml}");
    }
    assert!(!xml.contains("<ModelExchange"));

    let mut model = model();
    model.variables[1].name = "time".into();
    let error = model
        .to_xml_fmi3(&Origin::default())
        .unwrap_err()
        .to_string();
    assert!(error.contains("\"time\""), "{error}");
}

#[test]
fn equations_have_value_references_in_fmi_3() {
    let mut timed = spring();
    // The height of the wall may depend on all, also on time.
    timed.variables[7].depends_on.clear();
    let description = timed.to_xml_fmi3(&Origin::default()).unwrap();
    let of_variables = attributes(
        &description,
        "ModelVariables",
        [
            "name",
            "derivative",
            "nominal",
            "reinit",
            "intermediateUpdate",
        ],
    );
    let expected = [
        ["f", "", "", "", "true"],
        ["v", "", "", "true", ""],
        ["der(v)", "1", "", "", ""],
        ["x", "", "0.001", "true", "true"],
        ["der(x)", "3", "", "", ""],
        ["power", "", "", "", "true"],
        ["hits", "", "", "", ""],
        ["gap", "", "", "", ""],
        ["time", "", "", "", ""],
    ];
    assert_eq!(of_variables, expected);
    let structure = description.child("ModelStructure").unwrap();
    let unknowns: Vec<_> = (structure.children.iter())
        .map(|u| {
            (
                u.name,
                u.attribute("valueReference").unwrap(),
                u.attribute("dependencies"),
            )
        })
        .collect();
    let expected = [
        ("Output", "3", Some("3")),
        ("Output", "5", Some("0 1")),
        ("Output", "6", Some("")),
        ("ContinuousStateDerivative", "2", Some("0 3")),
        ("ContinuousStateDerivative", "4", Some("1")),
        ("InitialUnknown", "1", Some("0 3 8")),
        ("InitialUnknown", "2", Some("0 3 8")),
        ("InitialUnknown", "4", Some("0 3 8")),
        ("InitialUnknown", "5", Some("0 3 8")),
        ("InitialUnknown", "6", Some("0 3 8")),
        ("EventIndicator", "7", Some("0 1 3 8")),
    ];
    assert_eq!(unknowns, expected);
    let flags = |model: &Description, kind, names: &[&str]| -> Vec<bool> {
        let root = model.to_xml_fmi3(&Origin::default()).unwrap();
        let element = root.child(kind).unwrap();
        names
            .iter()
            .map(|name| element.attribute(name) == Some("true"))
            .collect()
    };
    let derivatives = [
        "providesDirectionalDerivatives",
        "providesAdjointDerivatives",
    ];
    assert_eq!(flags(&spring(), "ModelExchange", &derivatives), [true; 2]);
    let events = [
        "hasEventMode",
        "providesIntermediateUpdate",
        "canReturnEarlyAfterIntermediateUpdate",
        "mightReturnEarlyFromDoStep",
    ];
    let expected = [true, true, true, false];
    assert_eq!(flags(&spring(), "CoSimulation", &events), expected);
    let sampled = Description {
        is_sampled: true,
        ..model()
    };
    let expected = [true, false, false, true];
    assert_eq!(flags(&sampled, "CoSimulation", &events), expected);
    assert_eq!(flags(&sampled, "ModelExchange", &derivatives), [false; 2]);
}

#[test]
fn terminals_have_their_variables_as_members() {
    let mut model = model();
    assert_eq!(model.terminals(false).unwrap(), None);
    for (index, terminal) in [(0, "loop.u"), (1, "loop.y"), (4, "network.w")] {
        model.variables[index].terminal = terminal.into();
    }
    let root = model.terminals(true).unwrap().unwrap();
    let names: Vec<_> = root.children.iter().map(|child| child.name).collect();
    assert_eq!(names, ["GraphicalRepresentation", "Terminals"]);
    let terminals: Vec<_> = (root.list("Terminals", "Terminal"))
        .map(|terminal| {
            let members = terminal.children("TerminalMemberVariable");
            let names = members.map(|m| (m.attribute("memberName"), m.attribute("variableName")));
            (
                terminal.attribute("name").unwrap(),
                names.collect::<Vec<_>>(),
            )
        })
        .collect();
    let expected = [
        ("loop", vec![(Some("u"), Some("u")), (Some("y"), Some("y"))]),
        ("network", vec![(Some("w"), Some("w"))]),
    ];
    assert_eq!(terminals, expected);
    model.variables[2].terminal = "loop.y".into();
    let error = model.terminals(true).unwrap_err().to_string();
    assert!(error.contains("member y of the terminal loop"), "{error}");
}

#[test]
fn every_type_of_fmi_3_is_written() {
    let integer = |kind: IntegerKind, start| Type::Integer {
        kind,
        min: kind.range().0,
        max: 100,
        start,
    };
    let single = Type::Real {
        single: true,
        min: f64::NEG_INFINITY,
        max: f64::INFINITY,
        unit: String::new(),
        start: vec![f64::from(0.1_f32), 2.0],
    };
    let binary = Type::Binary {
        mime_type: "image/png".into(),
        start: vec![vec![0, 0xaf]],
    };
    let parameter = |name, of_type| variable(name, Causality::Parameter, of_type);
    let model = Description {
        variables: vec![
            array(parameter("single", single), &[]),
            parameter("small", integer(IntegerKind::Int8, vec![-3])),
            parameter("large", integer(IntegerKind::UInt64, vec![7])),
            parameter("image", binary),
        ],
        ..model()
    };
    let xml = model.to_xml_fmi3(&Origin::default()).unwrap();
    let xml = xml.document().unwrap();
    let fixed = "causality=\"parameter\" variability=\"fixed\" initial=\"exact\"";
    for part in [
        format!(
            "<Float32 name=\"single\" valueReference=\"0\" description=\"single &amp; co\" {fixed} start=\"0.1 2\">"
        ),
        format!(
            "<Int8 name=\"small\" valueReference=\"2\" description=\"small &amp; co\" {fixed} max=\"100\" start=\"-3\"/>"
        ),
        format!(
            "<UInt64 name=\"large\" valueReference=\"3\" description=\"large &amp; co\" {fixed} max=\"100\" start=\"7\"/>"
        ),
        "mimeType=\"image/png\">\n      <Start value=\"00af\"/>".to_owned(),
    ] {
        assert!(xml.contains(&part), "{part} is missing in {xml}");
    }
}
