//! The copy of a derived model's interface in its binary, as the exporter reads it.

use fmu_description::{
    Causality, Description, Domain, Dynamics, Hexadecimal, IntegerKind, Interface, Overrides,
    Reals, Row, StartValue, Type, Variability, VariableDescription, embedded, guid, interface,
    read_interfaces,
};

use fmu_export::prelude::*;
use proptest::prelude::*;

/// A tank with two valves
#[derive(Model)]
#[model(name = "Tank", stop_time = 60, step_size = 0.5, tolerance = 1e-6, sample_time = self.ts)]
#[allow(dead_code, reason = "only the table is under test")]
struct Reservoir {
    /// inflow
    #[input(unit = "m3/s", start = 0.25, min = 0, derivative = self.slope)]
    inflow: f64,
    slope: f64,
    /// openings of the valves
    #[input(start = [[10, 20]], max = 100, unit = "%")]
    opening: [[f64; 2]; 1],
    /// flow through the valves
    #[output(
        unit = "m3/s",
        initially_from("opening", "pump.head"),
        derivative_by(inflow = 1.0),
        terminal = "pipe.flow"
    )]
    flow: f64,
    /// flow through each valve
    #[output(name = "valve.flow", unit = "m3/s", initially_from("opening"))]
    flows: [[f64; 2]; 1],
    #[nested]
    pump: Pump,
    #[nested(prefix = "spare.pump")]
    spare: Pump,
    /// sample time
    #[parameter(start = 0.5, unit = "s")]
    ts: f64,
    /// levels that count as full
    #[constant(start = [3, -3])]
    levels: [i32; 2],
    /// number of overflows
    #[local]
    overflows: i32,
    /// level of a float
    #[local(unit = "mm")]
    level: f64,
}

/// A pump.
#[derive(Variables)]
#[allow(dead_code, reason = "only the table is under test")]
struct Pump {
    /// its head
    #[parameter(tunable, start = -1.5, unit = "m")]
    head: f64,
    /// speed
    #[parameter(start = 2, min = 1, max = 4)]
    speed: i32,
    /// which file has its curve
    #[parameter(start = "a & b.csv")]
    curve: String,
    /// whether it runs
    #[input(start = true)]
    on: bool,
    /// how it is controlled
    #[output(initially_from("head"))]
    mode: Mode,
}

/// How a pump is controlled
#[derive(Clone, Copy, Choice)]
#[choice(name = "PumpMode")]
enum Mode {
    /// by hand
    ByHand = -1,
    /// by level
    #[choice(name = "level")]
    Level = 7,
}

impl Simulate for Reservoir {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

const COUNT: usize = <Reservoir as Variables>::COUNT;
const TANK: Interface = fmu_export::interface::<Reservoir, COUNT>(None);
static EMBEDDED: [u8; embedded::size(&TANK)] = embedded::write(&TANK);

/// Overrides of one variable of each type.
const VARIANT: &str =
    "Tank=SmallTank;1:r16:3fe00000000000002:r16:40240000000000007:i1:38:s6:r\u{e9}:1;9:b1:0";
const SMALL: Interface = fmu_export::interface::<Reservoir, COUNT>(Some(VARIANT));
static EMBEDDED_SMALL: [u8; embedded::size(&SMALL)] = embedded::write(&SMALL);

fn variable(
    name: &str,
    description: &str,
    (causality, variability): (Causality, Variability),
    of_type: Type,
) -> VariableDescription {
    VariableDescription {
        name: name.into(),
        description: description.into(),
        causality,
        variability,
        has_input_derivative: false,
        dynamics: Dynamics::Algebraic,
        dimensions: vec![],
        size: None,
        initially_from: vec![],
        depends_on: vec![],
        terminal: String::new(),
        of_type,
    }
}

fn real(min: f64, max: f64, unit: &str, start: &[f64]) -> Type {
    Type::Real {
        single: false,
        min,
        max,
        unit: unit.into(),
        start: start.into(),
    }
}

fn pump(prefix: &str, first: usize) -> [VariableDescription; 5] {
    const ANY: f64 = f64::INFINITY;
    let fixed = (Causality::Parameter, Variability::Fixed);
    let tunable = (Causality::Parameter, Variability::Tunable);
    let input = (Causality::Input, Variability::Discrete);
    let output = (Causality::Output, Variability::Discrete);
    let name = |name: &str| format!("{prefix}.{name}");
    let speed = Type::Integer {
        kind: IntegerKind::Int32,
        min: 1,
        max: 4,
        start: vec![2],
    };
    let curve = Type::String {
        start: vec!["a & b.csv".into()],
    };
    let mode = Type::Enumeration {
        name: "PumpMode".into(),
        description: "How a pump is controlled".into(),
        items: vec![
            (-1, "by_hand".into(), "by hand".into()),
            (7, "level".into(), "by level".into()),
        ],
        start: vec![],
    };
    let head = real(-ANY, ANY, "m", &[-1.5]);
    [
        variable(&name("head"), "its head", tunable, head),
        variable(&name("speed"), "speed", fixed, speed),
        variable(&name("curve"), "which file has its curve", fixed, curve),
        variable(
            &name("on"),
            "whether it runs",
            input,
            Type::Boolean { start: vec![true] },
        ),
        VariableDescription {
            initially_from: vec![first],
            ..variable(&name("mode"), "how it is controlled", output, mode)
        },
    ]
}

/// What the exporter is to read, written by hand.
fn tank() -> Description {
    const ANY: f64 = f64::INFINITY;
    let input = (Causality::Input, Variability::Continuous);
    // The outputs and local variables of a sampled model are discrete.
    let output = (Causality::Output, Variability::Discrete);
    let local = (Causality::Local, Variability::Discrete);
    let fixed = (Causality::Parameter, Variability::Fixed);
    let constant = (Causality::Local, Variability::Constant);
    let integer = |start: &[i128]| Type::Integer {
        kind: IntegerKind::Int32,
        min: i32::MIN.into(),
        max: i32::MAX.into(),
        start: start.into(),
    };
    let mut variables = vec![
        VariableDescription {
            has_input_derivative: true,
            ..variable("inflow", "inflow", input, real(0.0, ANY, "m3/s", &[0.25]))
        },
        VariableDescription {
            dimensions: vec![1, 2],
            ..variable(
                "opening",
                "openings of the valves",
                input,
                real(-ANY, 100.0, "%", &[10.0, 20.0]),
            )
        },
        VariableDescription {
            initially_from: vec![1, 6],
            depends_on: vec![0],
            terminal: "pipe.flow".into(),
            ..variable(
                "flow",
                "flow through the valves",
                output,
                real(-ANY, ANY, "m3/s", &[]),
            )
        },
        VariableDescription {
            dimensions: vec![1, 2],
            initially_from: vec![1],
            ..variable(
                "valve.flow",
                "flow through each valve",
                output,
                real(-ANY, ANY, "m3/s", &[]),
            )
        },
    ];
    variables.extend(pump("pump", 6));
    variables.extend(pump("spare.pump", 11));
    variables.extend([
        variable("ts", "sample time", fixed, real(-ANY, ANY, "s", &[0.5])),
        VariableDescription {
            dimensions: vec![2],
            ..variable(
                "levels",
                "levels that count as full",
                constant,
                integer(&[3, -3]),
            )
        },
        variable("overflows", "number of overflows", local, integer(&[])),
        variable(
            "level",
            "level of a float",
            local,
            real(-ANY, ANY, "mm", &[]),
        ),
    ]);
    Description {
        name: "Tank".into(),
        description: "A tank with two valves".into(),
        guid: String::from_utf8(guid::guid(&TANK).into()).unwrap(),
        is_sampled: true,
        is_continuous: false,
        default_experiment: (60.0, 0.5),
        tolerance: 1e-6,
        variables,
    }
}

#[test]
fn all_properties_of_a_model_are_read_back() {
    assert_eq!(read_interfaces(&EMBEDDED).unwrap(), [tank()]);
}

#[test]
fn a_variant_has_its_own_name_and_start_values() {
    let overrides = [
        (1, StartValue::Real(0.5)),
        (2, StartValue::Real(10.0)),
        (7, StartValue::Integer(3)),
        (8, StartValue::String("r\u{e9}:1;")),
        (9, StartValue::Boolean(false)),
    ];
    assert_eq!(interface::variant("Tank", "SmallTank", &overrides), VARIANT);
    let mut expected = tank();
    expected.name = "SmallTank".into();
    expected.guid = String::from_utf8(guid::guid(&SMALL).into()).unwrap();
    assert_ne!(expected.guid, tank().guid);
    expected.variables[1].of_type = real(f64::NEG_INFINITY, 100.0, "%", &[0.5, 10.0]);
    for (index, of_type) in [
        (
            5,
            Type::Integer {
                kind: IntegerKind::Int32,
                min: 1,
                max: 4,
                start: vec![3],
            },
        ),
        (
            6,
            Type::String {
                start: vec!["r\u{e9}:1;".into()],
            },
        ),
        (7, Type::Boolean { start: vec![false] }),
    ] {
        expected.variables[index].of_type = of_type;
    }
    assert_eq!(read_interfaces(&EMBEDDED_SMALL).unwrap(), [expected]);
}

#[test]
fn copies_are_found_anywhere_in_a_binary_and_without_duplicates() {
    let binary = [
        b"\x7fELF\x7fFMU",
        &EMBEDDED[..],
        b"\x7f",
        &EMBEDDED_SMALL,
        &EMBEDDED,
        b"end",
    ];
    let models = read_interfaces(&binary.concat()).unwrap();
    let names: Vec<_> = models.iter().map(|model| &*model.name).collect();
    assert_eq!(names, ["Tank", "SmallTank"]);
    assert_eq!(read_interfaces(b"no model").unwrap(), []);
}

#[test]
fn the_xml_of_a_derived_model_is_written() {
    let xml = tank().to_xml(&Default::default()).unwrap();
    let xml = xml.document().unwrap();
    for part in [
        r#"modelName="Tank""#,
        r#"<ScalarVariable name="valve.flow[1,2]" valueReference="5""#,
        r#"<Item name="by_hand" value="-1" description="by hand"/>"#,
        // flow and the elements of valve.flow, with those of opening and pump.head
        r#"<Unknown index="4" dependencies="2 3 7"/>"#,
        r#"<Unknown index="5" dependencies="2"/>"#,
        r#"<Unknown index="6" dependencies="3"/>"#,
    ] {
        assert!(xml.contains(part), "{part} is missing in {xml}");
    }
}

macro_rules! table {
    ($name:ident, $of:ty, $start:expr) => {
        #[derive(Variables)]
        struct $name {
            /// entries
            #[parameter(start = $start)]
            #[allow(dead_code, reason = "only the table is under test")]
            entries: $of,
        }
    };
}
table!(Table, [[f64; 2]; 1], [[1, 2]]);

#[test]
fn structs_can_be_written_by_macros() {
    let Row::Variable(entries) = &Table::ROWS[0] else {
        panic!("{:?}", Table::ROWS);
    };
    assert_eq!(entries.dimensions, [1, 2]);
    let Domain::Real {
        start: Reals::Float64(start),
        ..
    } = entries.domain
    else {
        panic!("{:?}", entries.domain);
    };
    assert_eq!(start, [1.0, 2.0]);
}

/// Checks that bytes are an error.
fn assert_damaged(bytes: &[u8]) {
    let error = read_interfaces(bytes).unwrap_err().to_string();
    assert!(
        error.contains("is damaged") || error.contains("another version"),
        "{error}"
    );
}

#[test]
fn truncated_copies_are_errors() {
    // Without its first bytes, it is no copy.
    for length in 16 + 8..EMBEDDED.len() {
        assert_damaged(&EMBEDDED[..length]);
    }
}

#[test]
fn a_single_flipped_bit_is_an_error() {
    for bit in 8 * 16..8 * EMBEDDED.len() {
        let mut damaged = EMBEDDED;
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert_damaged(&damaged);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Even with a valid checksum, no bytes cause a panic.
    #[test]
    fn forged_copies_do_not_crash(
        edits in prop::collection::vec((24..EMBEDDED.len() - 16, any::<u32>()), 1..4),
    ) {
        let mut forged = EMBEDDED;
        let end = forged.len() - 16;
        for (place, number) in edits {
            let stop = (place + 4).min(end);
            forged[place..stop].copy_from_slice(&number.to_le_bytes()[..stop - place]);
        }
        let sum = guid::checksum(&forged[..end]);
        forged[end..].copy_from_slice(&sum.to_le_bytes());
        let _ = read_interfaces(&forged);
    }
}

/// One variable of each size
#[derive(Model)]
#[allow(dead_code, reason = "only the table is under test")]
struct Sizes {
    /// single precision
    #[input(start = 0.1, min = 0, max = 0.7, unit = "N")]
    single: f32,
    /// signed bytes
    #[parameter(start = [[-128, 127]])]
    signed: [[i8; 2]; 1],
    /// unsigned words
    #[input(max = 500)]
    unsigned: [u16; 2],
    /// the largest number
    #[parameter(start = u64::MAX)]
    largest: u64,
    /// the smallest number
    #[parameter(start = -9223372036854775808, max = -1)]
    smallest: i64,
    /// a picture
    #[parameter(start = b"\x00\xff", mime_type = "image/png")]
    picture: Vec<u8>,
    /// packets
    #[input(start = [b"a", b"bc"])]
    packets: [Vec<u8>; 2],
    /// sum
    #[output(initially_from("smallest", "picture"))]
    sum: f32,
}

impl Simulate for Sizes {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

const SIZES: Interface = fmu_export::interface::<Sizes, { Sizes::COUNT }>(None);
static EMBEDDED_SIZES: [u8; embedded::size(&SIZES)] = embedded::write(&SIZES);

#[test]
fn numbers_of_all_sizes_are_read_back() {
    let [sizes] = &read_interfaces(&EMBEDDED_SIZES).unwrap()[..] else {
        panic!("one model was expected");
    };
    let integer = |kind, min: i128, max: i128, start: &[i128]| Type::Integer {
        kind,
        min,
        max,
        start: start.into(),
    };
    let single = |min, max, unit: &str, start: &[f64]| Type::Real {
        single: true,
        min,
        max,
        unit: unit.into(),
        start: start.into(),
    };
    let types: Vec<_> = sizes.variables.iter().map(|v| v.of_type.clone()).collect();
    let (u64_max, i64_min) = (u64::MAX.into(), i64::MIN.into());
    assert_eq!(
        types,
        [
            single(0.0, f64::from(0.7f32), "N", &[f64::from(0.1f32)]),
            integer(IntegerKind::Int8, -128, 127, &[-128, 127]),
            integer(IntegerKind::UInt16, 0, 500, &[0, 0]),
            integer(IntegerKind::UInt64, 0, u64_max, &[u64_max]),
            integer(IntegerKind::Int64, i64_min, -1, &[i64_min]),
            Type::Binary {
                mime_type: "image/png".into(),
                start: vec![vec![0, 0xff]],
            },
            Type::Binary {
                mime_type: "application/octet-stream".into(),
                start: vec![b"a".to_vec(), b"bc".to_vec()],
            },
            single(f64::NEG_INFINITY, f64::INFINITY, "", &[]),
        ]
    );
}

#[test]
fn fmi_2_has_reals_and_integers_of_32_bits() {
    let models = read_interfaces(&EMBEDDED_SIZES).unwrap();
    let xml = models[0].to_xml(&Default::default()).unwrap();
    let listed: Vec<_> = xml
        .list("ModelVariables", "ScalarVariable")
        .map(|v| {
            (
                v.attribute("name").unwrap(),
                v.attribute("valueReference").unwrap(),
            )
        })
        .collect();
    // Without largest and smallest, which need 64 bits, and the binaries.
    assert_eq!(
        listed,
        [
            ("single", "0"),
            ("signed[1,1]", "1"),
            ("signed[1,2]", "2"),
            ("unsigned[1]", "3"),
            ("unsigned[2]", "4"),
            ("sum", "10"),
        ]
    );
    let xml = xml.document().unwrap();
    for part in [
        r#"<Real unit="N" min="0" max="0.7" start="0.1"/>"#,
        r#"<Integer min="-128" max="127" start="-128"/>"#,
        r#"<Integer min="0" max="500" start="0"/>"#,
        // Indices count the variables that are listed.
        r#"<Unknown index="6" dependencies=""/>"#,
    ] {
        assert!(xml.contains(part), "{part} is missing in {xml}");
    }
}

#[test]
fn start_values_of_all_sizes_can_be_overridden() {
    let digits = Hexadecimal::parse("0123ef").unwrap();
    let overrides = [
        (5, StartValue::Integer(u64::MAX.into())),
        (7, StartValue::Binary(digits)),
    ];
    let text = interface::variant("Sizes", "Other", &overrides);
    let (_, overrides) = Overrides::of("Sizes", text.leak()).unwrap();
    let other = Interface { overrides, ..SIZES };
    assert_ne!(guid::guid(&other), guid::guid(&SIZES));
}

macro_rules! identity {
    ($($name:ident: $ty:ty, ($($option:tt)*);)*) => {
        $(
            #[derive(Model)]
            #[model(name = "Same")]
            #[allow(dead_code, reason = "only the table is under test")]
            /// a model
            struct $name {
                /// a value
                #[parameter($($option)*)]
                value: $ty,
            }

            impl Simulate for $name {
                fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
                    Ok(())
                }
            }
        )*

        #[test]
        fn the_guid_depends_on_the_type() {
            let guids = [$(guid::guid(&fmu_export::interface::<$name, 1>(None))),*];
            for (i, guid) in guids.iter().enumerate() {
                assert!(!guids[..i].contains(guid), "{i}");
            }
        }
    };
}
identity! {
    Double: f64, (start = 1);
    Single: f32, (start = 1);
    Byte: u8, (start = 1, max = 100);
    SignedByte: i8, (start = 1, min = 0, max = 100);
    Binary: Vec<u8>, (start = b"a");
    OtherBinary: Vec<u8>, (start = b"b");
    Picture: Vec<u8>, (start = b"a", mime_type = "image/png");
}

/// Two arrays of variable size
#[derive(Model)]
#[allow(dead_code, reason = "only the table is under test")]
struct Lists {
    /// offset
    #[input]
    offset: f64,
    #[nested]
    net: Net,
    /// sum
    #[output(initially_from("offset"))]
    sum: f64,
}

#[derive(Variables)]
#[allow(dead_code, reason = "only the table is under test")]
struct Net {
    /// number of nodes
    #[structural_parameter(start = 2, min = 1, max = 3, tunable)]
    nodes: u64,
    /// weights
    #[parameter(start = [1, 2, 3], size = nodes)]
    w: [f64; 3],
    /// names
    #[parameter(size = "nodes", start = ["a", "b", "c"])]
    names: [String; 3],
    /// levels
    #[output(size = "nodes", initially_from("w", "nodes"))]
    levels: [f64; 3],
}

impl Simulate for Lists {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

const LISTS: Interface = fmu_export::interface::<Lists, { Lists::COUNT }>(None);
static EMBEDDED_LISTS: [u8; embedded::size(&LISTS)] = embedded::write(&LISTS);
/// With three nodes.
const LONGER: Interface =
    fmu_export::interface::<Lists, { Lists::COUNT }>(Some("Lists=Longer;1:i1:3"));
static EMBEDDED_LONGER: [u8; embedded::size(&LONGER)] = embedded::write(&LONGER);

fn only(embedded: &[u8]) -> Description {
    let mut models = read_interfaces(embedded).unwrap();
    assert_eq!(models.len(), 1);
    models.remove(0)
}

#[test]
fn structural_parameters_are_read_back() {
    let lists = only(&EMBEDDED_LISTS);
    let sizes: Vec<_> = (lists.variables.iter())
        .map(|v| (&*v.name, v.size, v.count(), lists.elements(v)))
        .collect();
    assert_eq!(
        sizes,
        [
            ("offset", None, 1, 1),
            ("net.nodes", None, 1, 1),
            ("net.w", Some(1), 3, 2),
            ("net.names", Some(1), 3, 2),
            ("net.levels", Some(1), 3, 2),
            ("sum", None, 1, 1),
        ]
    );
    let nodes = &lists.variables[1];
    assert_eq!(nodes.causality, Causality::StructuralParameter);
    assert_eq!(nodes.variability, Variability::Tunable);
    let longer = only(&EMBEDDED_LONGER);
    assert_eq!(longer.elements(&longer.variables[2]), 3);
}

#[test]
fn fmi_2_lists_the_elements_in_use_only() {
    let names = |description: Description| -> Vec<_> {
        let xml = description.to_xml(&Default::default()).unwrap();
        xml.list("ModelVariables", "ScalarVariable")
            .map(|v| {
                let of = |name| v.attribute(name).unwrap().to_owned();
                (of("name"), of("valueReference").parse().unwrap())
            })
            .collect()
    };
    let listed = |names: &[(&str, u32)]| -> Vec<(String, u32)> {
        names.iter().map(|(name, r)| ((*name).into(), *r)).collect()
    };
    assert_eq!(
        names(only(&EMBEDDED_LISTS)),
        listed(&[
            ("offset", 0),
            ("net.w[1]", 2),
            ("net.w[2]", 3),
            ("net.names[1]", 5),
            ("net.names[2]", 6),
            ("net.levels[1]", 8),
            ("net.levels[2]", 9),
            ("sum", 11),
        ])
    );
    assert_eq!(names(only(&EMBEDDED_LONGER)).len(), 11);
    let xml = only(&EMBEDDED_LISTS).to_xml(&Default::default()).unwrap();
    let xml = xml.document().unwrap();
    for part in [
        // The level of each node from its weight, and the sum from the offset.
        r#"<Unknown index="6" dependencies="2"/>"#,
        r#"<Unknown index="7" dependencies="3"/>"#,
        r#"<Unknown index="8" dependencies="1"/>"#,
    ] {
        assert!(xml.contains(part), "{part} is missing in {xml}");
    }
}

#[test]
fn fmi_3_has_arrays_whose_size_is_a_parameter() {
    let xml = only(&EMBEDDED_LISTS)
        .to_xml_fmi3(&Default::default())
        .unwrap();
    let xml = xml.document().unwrap();
    for part in [
        r#"<UInt64 name="net.nodes" valueReference="1" description="number of nodes" causality="structuralParameter" variability="tunable" initial="exact" min="1" max="3" start="2"/>"#,
        r#"<Dimension valueReference="1"/>"#,
        r#"start="1 2""#,
        r#"<Start value="b"/>"#,
    ] {
        assert!(xml.contains(part), "{part} is missing in {xml}");
    }
    assert!(!xml.contains(r#"<Start value="c"/>"#), "{xml}");
}
