//! The copy of a derived model's interface in its binary, as the exporter reads it.

use fmu_description::{
    Causality, Description, Interface, Row, StartValue, Type, Variability, VariableDescription,
    embedded, guid, interface, read_interfaces,
};
use fmu_export::fmi2;
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
        derivative_by(inflow = 1.0)
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
const TANK: Interface = fmi2::interface::<Reservoir, COUNT>(None);
static EMBEDDED: [u8; embedded::size(&TANK)] = embedded::write(&TANK);

/// Overrides of one variable of each type.
const VARIANT: &str =
    "Tank=SmallTank;1:r16:3fe00000000000002:r16:40240000000000007:i1:38:s6:r\u{e9}:1;9:b1:0";
const SMALL: Interface = fmi2::interface::<Reservoir, COUNT>(Some(VARIANT));
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
        has_directional_derivatives: false,
        dimensions: vec![],
        initially_from: vec![],
        of_type,
    }
}

fn real(min: f64, max: f64, unit: &str, start: &[f64]) -> Type {
    Type::Real {
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
    let integer = |start: &[i32]| Type::Integer {
        min: i32::MIN,
        max: i32::MAX,
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
            has_directional_derivatives: true,
            initially_from: vec![1, 6],
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
    assert_eq!(entries.domain.start(1), Some(StartValue::Real(2.0)));
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
