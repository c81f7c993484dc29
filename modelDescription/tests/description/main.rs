//! From the struct of a model to its copy in the binary, its XML, and back: what one layer writes, the next
//! reads.

mod clocks;
mod format;
mod models;
mod networks;

use std::path::Path;
use std::sync::Arc;

use fmu_description::hash::checksum;
use fmu_description::interface::{guid, size, variant, write};
use fmu_description::table::{Bounds, Declaration, History, TypedStart};
use fmu_description::xml::parse;
use fmu_description::{
    Causality, DeclaredType, Dynamics, ExportInfo, ExportedModel, FmiVersion, Initial, Interface,
    InterfaceType, ModelDescription, Origin, Type, Value, Variability, Variable, erase_interfaces,
    read_interfaces,
};
use fmu_export::prelude::*;
use models::{Fan, Gauges, Lists, Renamed, Reservoir, Sensor, Sizes, Spring, Twins};
use proptest::prelude::*;

/// Defines the interface and the copy of a model or a variant of it.
macro_rules! interfaces {
    ($($name:ident $copy:ident: $model:ty, $variant:expr;)*) => {
        $(
            const $name: Interface =
                fmu_export::interface::<$model, { <$model as Variables>::COUNT }>($variant);
            static $copy: [u8; size(&$name)] = write(&$name);
        )*
    };
}

interfaces! {
    TANK TANK_COPY: Reservoir, None;
    SMALL SMALL_COPY: Reservoir, Some(SMALL_VARIANT);
    SPRING SPRING_COPY: Spring, None;
    SIZES SIZES_COPY: Sizes, None;
    OTHER OTHER_COPY: Sizes, Some(OTHER_VARIANT);
    LISTS LISTS_COPY: Lists, None;
    GAUGES GAUGES_COPY: Gauges, None;
    FAN FAN_COPY: Fan, None;
    RENAMED RENAMED_COPY: Renamed, None;
    TWINS TWINS_COPY: Twins, None;
    SENSOR SENSOR_COPY: Sensor, None;
    LONGER LONGER_COPY: Lists, Some("Lists=Longer;1:1:3");
}

/// Start values of one variable of each type.
const SMALL_VARIANT: &str =
    "Tank=SmallTank;1:19:46026788191726469122:19:46218191175889715207:1:38:6:r\u{e9}:1;9:1:0";
const OTHER_VARIANT: &str = "Sizes=Other;5:20:184467440737095516157:4:01230:19:4599075939685498880";

/// Models with flat names.
const FLAT: Interface = TANK.named(Some("flat"), None);
static FLAT_COPY: [u8; size(&FLAT)] = write(&FLAT);
const FLAT_RENAMED: Interface = RENAMED.named(Some("flat"), None);
static FLAT_RENAMED_COPY: [u8; size(&FLAT_RENAMED)] = write(&FLAT_RENAMED);

fn description(copy: &[u8]) -> ExportedModel {
    let mut models = read_interfaces(copy).unwrap();
    assert_eq!(models.len(), 1);
    models.remove(0)
}

fn xml(model: &ExportedModel, version: FmiVersion) -> String {
    let origin = Origin {
        version: "1.2.3".into(),
        author: Some("A. & B.".into()),
        license: Some("MIT".into()),
        generation_tool: "fmu-export".into(),
        copyright: None,
    };
    let root = model.to_xml(version, &origin).unwrap();
    root.document().unwrap()
}

/// Compares with a file, which `SNAPSHOTS=overwrite` writes anew.
#[track_caller]
fn assert_is_file(name: &str, xml: &str) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/xml");
    let file = file.join(name);
    if std::env::var_os("SNAPSHOTS").is_some_and(|value| value == "overwrite") {
        std::fs::write(&file, xml).unwrap();
    }
    assert_eq!(std::fs::read_to_string(file).unwrap(), xml, "{name}");
}

#[test]
fn the_xml_of_each_version_has_all_that_the_struct_says() {
    use FmiVersion::{Fmi2, Fmi3};
    for (copy, versions) in [
        (&TANK_COPY[..], &[Fmi2, Fmi3][..]),
        (&SPRING_COPY, &[Fmi2, Fmi3]),
        (&SIZES_COPY, &[Fmi2, Fmi3]),
        (&LISTS_COPY, &[Fmi2, Fmi3]),
        (&GAUGES_COPY, &[Fmi2, Fmi3]),
        // Variants with other start values, and thereby with another GUID.
        (&SMALL_COPY, &[Fmi2]),
        (&OTHER_COPY, &[Fmi3]),
        (&LONGER_COPY, &[Fmi2]),
    ] {
        let model = description(copy);
        for &version in versions {
            let file = format!("{}_fmi{}.xml", model.name, &version.as_str()[..1]);
            assert_is_file(&file, &xml(&model, version));
        }
    }
    let terminals = description(&TANK_COPY).terminals(true).unwrap().unwrap();
    assert_is_file("Tank_terminals.xml", &terminals.document().unwrap());
    assert_eq!(description(&LISTS_COPY).terminals(false).unwrap(), None);
    // Derivatives of outputs: none is known of `power`, and none of a discrete real number.
    let mut known = description(&SPRING_COPY);
    known.variables.retain(|variable| variable.name != "power");
    assert!(xml(&known, Fmi2).contains("maxOutputDerivativeOrder=\"1\""));
    known.variables.iter_mut().find(|v| v.name == "hits").unwrap().of_type = Type::Float64;
    assert!(xml(&known, Fmi2).contains("maxOutputDerivativeOrder=\"0\""));
    let mut stepped = description(&SPRING_COPY);
    stepped.is_continuous = false;
    assert!(!xml(&stepped, Fmi2).contains("reinit"), "events of model exchange only");
}

#[test]
fn a_description_for_one_interface_type_has_nothing_of_the_other() {
    for (interface_type, gone, left) in [
        (
            InterfaceType::CoSimulation,
            ["<ModelExchange", "numberOfEventIndicators", "reinit", "<EventIndicator"],
            ["<CoSimulation", "Derivative"],
        ),
        (
            InterfaceType::ModelExchange,
            ["<CoSimulation", "intermediateUpdate", "hasEventMode", "canHandleVariable"],
            ["<ModelExchange", "reinit"],
        ),
    ] {
        let both = description(&SPRING_COPY);
        let one = ExportedModel { interface_types: vec![interface_type], ..both.clone() };
        assert_eq!(one.guid, both.guid);
        for version in FmiVersion::ALL {
            let xml = xml(&one, version);
            // FMI 3.0 has events in co-simulation, too.
            let gone = gone.iter().filter(|name| version == FmiVersion::Fmi2 || **name != "reinit");
            for name in gone {
                assert!(!xml.contains(name), "{name} in {xml}");
            }
            for name in left {
                assert!(xml.contains(name), "{name} is missing in {xml}");
            }
        }
    }
}

#[test]
fn every_kind_of_instance_is_the_only_one_in_its_process() {
    let tank = ExportedModel { is_single_instance: true, ..description(&TANK_COPY) };
    for version in FmiVersion::ALL {
        let document = xml(&tank, version);
        let root = parse(&document).unwrap();
        for kind in ["ModelExchange", "CoSimulation"] {
            let element = root.child(kind).unwrap();
            assert_eq!(element.attribute("canBeInstantiatedOnlyOncePerProcess"), Some("true"));
        }
    }
}

#[test]
fn values_are_displayed_in_the_unit_of_choice() {
    let fan = description(&FAN_COPY);
    for version in FmiVersion::ALL {
        let document = xml(&fan, version);
        let root = parse(&document).unwrap();
        let mut shown = Vec::new();
        for unit in root.list("UnitDefinitions", "Unit") {
            for display in unit.children("DisplayUnit") {
                let [factor, offset] = ["factor", "offset"]
                    .map(|name| display.attribute(name).map(|number| number.parse().unwrap()));
                let [unit, display] = [unit, display].map(|e| e.attribute("name").unwrap());
                shown.push((unit, display, factor.unwrap_or(1.0), offset.unwrap_or(0.0)));
            }
        }
        let pi = core::f64::consts::PI;
        let expected = [
            ("rad/s", "rpm", 30.0 / pi, 0.0),
            ("rad/s", "deg/s", 180.0 / pi, 0.0),
            ("K", "degC", 1.0, -273.15),
        ];
        assert_eq!(shown, expected);
        let model = ModelDescription::read(&root).unwrap();
        let displays = model.variables().map(|(_, v)| (&*v.name, v.display_unit.as_deref()));
        let displays: Vec<_> = displays.filter(|(name, _)| !name.ends_with("[2]")).collect();
        let temperatures =
            if version == FmiVersion::Fmi2 { "temperatures[1]" } else { "temperatures" };
        let expected = [
            ("motor", Some("rpm")),
            ("wheel", Some("deg/s")),
            (temperatures, Some("degC")),
            ("angle", None),
        ];
        assert_eq!(displays[..4], expected);
    }
    let mut fan = fan;
    fan.variables[0].display_unit = Some("Hz".into());
    let error = fan.to_xml(FmiVersion::Fmi2, &Origin::default()).unwrap_err().to_string();
    assert_eq!(error, "\"Hz\" cannot display a value in \"rad/s\"");
}

/// The variables of FMI 2.0 in a line each: position and value reference, name, causality, initial, start and
/// description.
#[test]
fn in_fmi_2_hosts_can_set_a_variable_by_its_former_name_alone() {
    let document = xml(&description(&RENAMED_COPY), FmiVersion::Fmi2);
    let root = parse(&document).unwrap();
    let model = ModelDescription::read(&root).unwrap();
    let lines = model.variables().map(|(index, v)| {
        let start = v.start().map(|start| format!("={start}")).unwrap_or_default();
        let initial = v.initial.map(Initial::as_str).unwrap_or_default();
        let causality = v.causality.as_str();
        format!(
            "{index} {} {}{start} {causality} {initial}: {}",
            v.reference, v.name, v.description
        )
    });
    let expected = [
        "1 0 u=1 input : force (former name of force)",
        "2 1 mass.s=0.5 output exact: position (former name of mass.x)",
        "3 2 der(mass.x) local calculated: Derivative of x",
        "4 3 power output calculated: power",
        "5 4 k[1]=2 parameter exact: gains (former name of gains[1])",
        "6 5 k[2]=3 parameter exact: gains (former name of gains[2])",
        "7 6 gears=4 parameter exact: number of gears (deprecated: use gains)",
        "8 7 poles=2 local exact: number of poles (deprecated: it is always 2)",
        "9 0 force local calculated: force (set as u)",
        "10 1 mass.x output calculated: position",
        "11 2 der(mass.s) local calculated: Derivative of x (former name of der(mass.x))",
        "12 3 p_out output calculated: power (former name of power)",
        "13 3 P output calculated: power (former name of power)",
        "14 4 gains[1] calculatedParameter calculated: gains (set as k[1])",
        "15 5 gains[2] calculatedParameter calculated: gains (set as k[2])",
        "16 7 p=2 local exact: number of poles (deprecated: it is always 2) (former name of poles)",
    ];
    assert_eq!(Vec::from_iter(lines), expected);
    let unknowns = |list: &[fmu_description::Unknown<'_>]| {
        let text = |name| {
            move |u: &fmu_description::Unknown<'_>| u.element.attribute(name).map(str::to_owned)
        };
        let all = list.iter().map(|u| (u.number, text("dependencies")(u).unwrap_or_default()));
        Vec::from_iter(all.map(|(number, on)| format!("{number} on {on}")))
    };
    // A state depends on itself, and its initial value on what the host sets, which is in the variable with its start.
    assert_eq!(
        unknowns(&model.outputs),
        ["2 on 2", "4 on 1 2", "10 on 2", "12 on 1 2", "13 on 1 2"]
    );
    assert_eq!(unknowns(&model.derivatives), ["3 on 2"]);
    assert_eq!(
        unknowns(&model.initial_unknowns),
        [
            "3 on 1 2 5 6 7",
            "4 on 1 2 5 6 7",
            "10 on 2",
            "12 on 1 2 5 6 7",
            "13 on 1 2 5 6 7",
            "14 on 5",
            "15 on 6"
        ]
    );
}

#[test]
fn in_fmi_3_a_former_name_is_an_alias() {
    let document = xml(&description(&RENAMED_COPY), FmiVersion::Fmi3);
    for expected in [
        "<Alias name=\"u\" description=\"Former name of force\"/>",
        "<Alias name=\"mass.s\" description=\"Former name of mass.x\"/>",
        "<Alias name=\"der(mass.s)\" description=\"Former name of der(mass.x)\"/>",
        "<Alias name=\"P\" description=\"Former name of power\"/>",
        "<Alias name=\"k\" description=\"Former name of gains\"/>",
        "description=\"number of poles (deprecated: it is always 2)\"",
    ] {
        assert!(document.contains(expected), "{expected}");
    }
}

#[test]
fn flat_names_have_no_structure_but_arrays_stay_arrays() {
    let (tank, flat) = (description(&TANK_COPY), description(&FLAT_COPY));
    assert_ne!(flat.guid, tank.guid);
    let names = |model: &ExportedModel, version| -> Vec<String> {
        read(&xml(model, version)).into_iter().map(|v| v.name).collect()
    };
    assert_eq!(
        names(&flat, FmiVersion::Fmi2)[..6],
        ["inflow", "opening_1_1", "opening_1_2", "flow", "valve_flow_1_1", "valve_flow_1_2"]
    );
    assert_eq!(
        names(&flat, FmiVersion::Fmi3)[..6],
        ["inflow", "opening", "flow", "valve_flow", "pump_head", "pump_speed"]
    );
    for version in FmiVersion::ALL {
        // Nothing but the names and the GUID differs.
        let mut expected = xml(&tank, version).replace(&tank.guid, &flat.guid);
        expected = expected.replace("=\"structured\"", "=\"flat\"");
        for (own, other) in names(&tank, version).iter().zip(names(&flat, version)) {
            expected = expected.replace(&format!(" name=\"{own}\""), &format!(" name=\"{other}\""));
        }
        assert_eq!(xml(&flat, version), expected);
    }
    let terminals = flat.terminals(false).unwrap().unwrap().document().unwrap();
    assert!(terminals.contains("variableName=\"opening\""), "{terminals}");
    let former = names(&description(&FLAT_RENAMED_COPY), FmiVersion::Fmi2);
    for alias in ["mass_s", "der_mass_s", "gains_1", "k_2"] {
        assert!(former.iter().any(|name| name == alias), "{former:?}");
    }
    let error = read_interfaces(&TWINS_COPY).unwrap_err().to_string();
    assert_eq!(
        error,
        "pid_w[2] and pid.w_2 of Twins both become pid_w_2 with naming = \"flat\"; expected other names"
    );
    let structured = TWINS.named(Some("structured"), Some(fmu_description::Naming::Flat));
    assert_eq!(TWINS.naming, fmu_description::Naming::Flat);
    assert_ne!(guid(&structured), guid(&TWINS));
}

/// The valid variables of a document, without their elements.
fn read(document: &str) -> Vec<Variable> {
    let root = parse(document).unwrap();
    let model = ModelDescription::read(&root).unwrap();
    let variables = model.variables().map(|(_, v)| Variable::clone(v));
    variables.collect()
}

#[test]
fn the_xml_of_fmi_3_reads_back_as_the_variables_of_the_model() {
    for copy in [&TANK_COPY[..], &SPRING_COPY, &OTHER_COPY, &LISTS_COPY, &FAN_COPY, &RENAMED_COPY] {
        let model = description(copy);
        let variables = model.variables.iter().map(|v| {
            let mut expected = v.clone();
            expected.exported = ExportInfo::default();
            if v.exported.size.is_some() {
                expected.dimensions = vec![model.elements_in_use(v)];
                expected.start.truncate(model.elements_in_use(v));
            }
            if v.causality == Causality::Input {
                expected.initial = Some(Initial::Exact);
            }
            expected
        });
        let mut found = read(&xml(&model, FmiVersion::Fmi3));
        assert_eq!(found.pop().unwrap().name, "time");
        assert_eq!(found, variables.collect::<Vec<_>>());
    }
}

#[test]
fn descriptions_that_no_importer_could_read_are_errors() {
    let other_items = |tank: &mut ExportedModel| {
        let mut variables = tank.variables.iter_mut();
        let mode = variables.find(|v| v.of_type == Type::Enumeration).unwrap();
        let mut declared = DeclaredType::clone(mode.declared_type.as_ref().unwrap());
        declared.items.pop();
        mode.declared_type = Some(Arc::new(declared));
    };
    type Case = (fn(&mut ExportedModel), &'static [FmiVersion], &'static str);
    let cases: [Case; 3] = [
        (other_items, &FmiVersion::ALL, "two enumerations of Tank have the name PumpMode"),
        (
            |tank| tank.variables[0].unit = Some("Nm".into()),
            &FmiVersion::ALL,
            "\"Nm\" is not a unit",
        ),
        (
            |tank| tank.variables[0].name = "time".into(),
            &[FmiVersion::Fmi3],
            "the independent variable of FMI 3.0",
        ),
    ];
    for (change, versions, expected) in cases {
        let mut tank = description(&TANK_COPY);
        change(&mut tank);
        for version in versions {
            let error = tank.to_xml(*version, &Origin::default()).unwrap_err();
            assert!(error.to_string().contains(expected), "{error}");
        }
    }
    let mut lists = description(&LISTS_COPY);
    lists.variables[1].start = vec![Value::UInt64(0)];
    let error = lists.to_xml(FmiVersion::Fmi3, &Origin::default()).unwrap_err();
    assert!(error.to_string().starts_with("no element of net.w"), "{error}");
    let mut tank = description(&TANK_COPY);
    tank.variables[0].exported.terminal = "pipe.flow".into();
    let error = tank.terminals(true).unwrap_err().to_string();
    assert!(error.contains("member flow of the terminal pipe"), "{error}");
}

#[test]
fn start_values_survive_the_way_through_the_compiler() {
    let text = "r\u{e9}:1;".to_owned();
    let tank = [
        (1, Value::Float64(0.5)),
        (2, Value::Float64(10.0)),
        (7, Value::Int32(3)),
        (8, Value::String(text)),
        (9, Value::Boolean(false)),
    ];
    assert_eq!(variant("Tank", "SmallTank", &tank), SMALL_VARIANT);
    let sizes = [
        (5, Value::UInt64(u64::MAX)),
        (7, Value::Binary(vec![0x01, 0x23])),
        (0, Value::Float32(0.3)),
    ];
    assert_eq!(variant("Sizes", "Other", &sizes), OTHER_VARIANT);
    for (interface, expected) in [(SMALL, &tank[..]), (OTHER, &sizes)] {
        let mut rest = interface.overrides;
        for (reference, value) in expected {
            let (first, others) = rest.next().unwrap();
            assert_eq!(first.reference, *reference);
            assert_eq!(first.value(value.of_type()), Some(value.clone()));
            rest = others;
        }
        assert_eq!(rest.next(), None);
    }
    let model = description(&OTHER_COPY);
    for (reference, value) in sizes {
        let mut scalars = model.scalars();
        let (_, v, element) = scalars.find(|(r, ..)| *r == reference).unwrap();
        assert_eq!(v.start[element], value);
    }
    // A variant of another model does not concern this one.
    let plain = fmu_export::interface::<Sizes, { Sizes::COUNT }>(Some("Size=Other;5:1:1"));
    assert_eq!((plain.name, guid(&plain)), ("Sizes", guid(&SIZES)));
}

const DEPRECATED: Option<&History> = Some(&History { aliases: &[], deprecated: "use other" });
const RENAMED_ONCE: Option<&History> = Some(&History { aliases: &["inflow_1"], deprecated: "" });

#[test]
fn the_guid_changes_with_the_interface_only() {
    // The GUID of a model with one variable after a change.
    let changed = |change: fn(&mut Declaration, &mut Interface)| {
        let (mut scalar, mut interface) = (TANK.scalars[0], TANK);
        let mut field = *scalar.variable;
        change(&mut field, &mut interface);
        scalar.variable = Box::leak(Box::new(field));
        if !interface.scalars.is_empty() {
            interface.scalars = Box::leak(Box::new([scalar]));
        }
        guid(&interface)
    };
    let plain = changed(|_, _| ());
    assert_eq!(changed(|field, _| field.description = "another"), plain);
    assert_eq!(changed(|field, _| field.terminal = "another.one"), plain);
    assert_eq!(changed(|field, _| field.nominal = 2.0), plain);
    assert_eq!(changed(|field, _| field.display_unit = "l/min"), plain);
    assert_eq!(changed(|field, _| field.history = DEPRECATED), plain);
    // Equations count with their states, derivatives and event indicators.
    assert_eq!(changed(|_, interface| interface.is_continuous = true), plain);
    let mut guids = vec![plain];
    for change in [
        |_, interface| interface.is_sampled = false,
        |_, interface| interface.name = "Other",
        |_, interface| interface.revision = "1.0.0",
        |_, interface| interface.revision = "1.0.1",
        |_, interface| interface.scalars = &[],
        |field, _| field.name = "other",
        |field, _| field.history = RENAMED_ONCE,
        |field, _| field.causality = Causality::Local,
        |field, _| field.variability = Variability::Discrete,
        |field, _| field.dimensions = &[1],
        |field, _| field.size = "other",
        |field, _| field.unit = "m",
        |field, _| field.dynamics = Dynamics::State,
        |field, _| field.bounds = Bounds::Real(0.0, 1.0),
        |field, _| field.start = TypedStart::Float64(&[2.0]),
        |field, _| field.start = TypedStart::Float32(&[0.25]),
        |field, _| field.start = TypedStart::UInt8(&[1]),
        |field, _| field.start = TypedStart::Int8(&[1]),
        |field, _| field.start = TypedStart::Boolean(&[true]),
        |field, _| field.start = TypedStart::String(&["a"]),
        |field, _| field.start = TypedStart::Binary(&[b"a"]),
        |field, _| field.start = TypedStart::Binary(&[b"b"]),
        |field, _| (field.start, field.mime_type) = (TypedStart::Binary(&[b"a"]), "image/png"),
    ] as [fn(&mut Declaration, &mut Interface); _]
    {
        guids.push(changed(change));
    }
    for (i, guid) in guids.iter().enumerate() {
        assert!(!guids[..i].contains(guid), "{i}");
    }
}

#[test]
fn copies_are_found_anywhere_in_a_binary_and_without_duplicates() {
    let binary = [b"\x7fELF\x7fFMU", &TANK_COPY[..], b"\x7f", &SMALL_COPY, &TANK_COPY, b"end"];
    let mut binary = binary.concat();
    let models = read_interfaces(&binary).unwrap();
    let names: Vec<_> = models.iter().map(|model| &*model.name).collect();
    assert_eq!(names, ["Tank", "SmallTank"]);
    erase_interfaces(&mut binary).unwrap();
    assert_eq!(read_interfaces(&binary).unwrap(), []);
    assert!(binary.starts_with(b"\x7fELF\x7fFMU\0") && binary.ends_with(b"\0end"));
}

/// Checks that bytes are an error.
fn assert_damaged(bytes: &[u8]) {
    let error = read_interfaces(bytes).unwrap_err().to_string();
    assert!(error.contains("is damaged") || error.contains("another version"), "{error}");
}

#[test]
fn truncated_copies_are_errors() {
    // Without its first bytes, it is no copy.
    for length in 16 + 8..TANK_COPY.len() {
        assert_damaged(&TANK_COPY[..length]);
    }
}

#[test]
fn a_single_flipped_bit_is_an_error() {
    for bit in 8 * 16..8 * TANK_COPY.len() {
        let mut damaged = TANK_COPY;
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert_damaged(&damaged);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Even with a valid checksum, no bytes cause a panic.
    #[test]
    fn forged_copies_do_not_crash(
        edits in prop::collection::vec((24..TANK_COPY.len() - 16, any::<u32>()), 1..4),
    ) {
        let mut forged = TANK_COPY;
        let end = forged.len() - 16;
        for (place, number) in edits {
            let stop = (place + 4).min(end);
            forged[place..stop].copy_from_slice(&number.to_le_bytes()[..stop - place]);
        }
        let sum = checksum(&forged[..end]);
        forged[end..].copy_from_slice(&sum.to_le_bytes());
        let _ = read_interfaces(&forged);
    }
}

#[test]
fn log_categories_and_states_that_are_not_serialized_are_declared() {
    let sensor = description(&SENSOR_COPY);
    for (version, state) in [(FmiVersion::Fmi2, "FMUstate"), (FmiVersion::Fmi3, "FMUState")] {
        let xml = xml(&sensor, version);
        let own = "<Category name=\"sensor.limits\" description=\"values that are limited\"/>";
        assert!(xml.contains(own), "{xml}");
        assert!(!xml.contains("logModel"), "{xml}");
        assert!(xml.contains(&format!("canGetAndSet{state}=\"true\"")), "{xml}");
        assert!(xml.contains(&format!("canSerialize{state}=\"false\"")), "{xml}");
    }
}
