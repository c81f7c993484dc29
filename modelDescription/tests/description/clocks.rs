//! Clocks and clocked variables: from the fields of a struct to the XML, and back.
#![allow(dead_code, reason = "only the tables are under test")]

use fmu_description::interface::{guid, size, write};
use fmu_description::xml::parse;
use fmu_description::{ClockType, FmiVersion, Interface, IntervalVariability, ModelDescription};
use fmu_export::prelude::*;

use super::{assert_is_file, description, xml};

/// A model with a clock of each kind
#[derive(Model)]
#[model(clocked)]
struct Clocks {
    /// a message has arrived
    #[input]
    received: Clock,
    /// every 10 ms
    #[input(constant, interval = 0.01, shift = 0.005, resolution = 1000, priority = 7)]
    constant: Clock,
    /// every 20 ms, unless the host sets another interval
    #[input(fixed, interval = 0.02)]
    fixed: Clock,
    /// every sample time
    #[input(calculated, interval = self.ts, shift = 0.5 * self.ts, resolution = 1_000_000)]
    sample: Clock,
    /// every period
    #[input(tunable, interval = self.period)]
    tuned: Clock,
    /// when it says so at its ticks
    #[input(changing)]
    changing: Clock,
    /// when it says so at any tick
    #[input(countdown)]
    countdown: Clock,
    /// a message is to be sent
    #[output(clocks(sample))]
    sent: Clock,
    /// message
    #[input(clocks(received), mime_type = "application/x-frame", max_size = 64)]
    message: Vec<u8>,
    /// command
    #[output(clocks(sample, "sent"), unit = "N")]
    command: f64,
    /// ticks so far
    #[output]
    count: i32,
    /// sample time
    #[parameter(start = 0.001, min = 1e-6, unit = "s")]
    ts: f64,
    /// period
    #[parameter(tunable, start = 0.1, min = 1e-6, unit = "s")]
    period: f64,
    #[nested]
    ports: [Port; 2],
}

/// A port.
#[derive(Variables)]
struct Port {
    /// data
    #[input(clocks(rx))]
    data: Vec<u8>,
    /// ticks with data
    #[input(name = "rx")]
    ticks: Clock,
}

impl Clocked for Clocks {
    fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
        self.count += i32::from(self.sample.is_active());
        self.sent = Clock::TICK;
        self.countdown = Clock::after(0.5);
        Ok(())
    }
}

/// A model with equations and a clock
#[derive(Model)]
#[model(continuous)]
struct Ball {
    /// kick
    #[input]
    kick: Clock,
    /// speed
    #[output(state, unit = "m/s")]
    v: f64,
    #[derivative(of = v, unit = "m/s2")]
    acceleration: f64,
    /// kicks so far
    #[output(clocks(kick))]
    kicks: u8,
}

impl Continuous for Ball {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        self.acceleration = -self.v;
        Ok(())
    }
}

const CLOCKS: Interface = fmu_export::interface::<Clocks, { <Clocks as Variables>::COUNT }>(None);
pub static CLOCKS_COPY: [u8; size(&CLOCKS)] = write(&CLOCKS);
const BALL: Interface = fmu_export::interface::<Ball, { <Ball as Variables>::COUNT }>(None);
static BALL_COPY: [u8; size(&BALL)] = write(&BALL);

#[test]
fn the_xml_has_the_clocks_and_what_they_change() {
    for copy in [&CLOCKS_COPY[..], &BALL_COPY] {
        let model = description(copy);
        assert_is_file(&format!("{}_fmi3.xml", model.name), &xml(&model, FmiVersion::Fmi3));
        let omitted = xml(&model, FmiVersion::Fmi2);
        assert_is_file(&format!("{}_fmi2.xml", model.name), &omitted);
    }
}

#[test]
fn a_reader_gets_the_types_of_clocks_that_the_struct_has() {
    use IntervalVariability::{
        Calculated, Changing, Constant, Countdown, Fixed, Triggered, Tunable,
    };
    let model = description(&CLOCKS_COPY);
    let text = xml(&model, FmiVersion::Fmi3);
    let root = parse(&text).unwrap();
    let read = ModelDescription::read(&root).unwrap();
    let clocks: Vec<_> = read.variables().filter_map(|(_, v)| Some((&*v.name, v.clock?))).collect();
    let of = |kind, interval, priority| ClockType {
        interval_variability: kind,
        interval,
        priority: Some(priority),
        ..ClockType::default()
    };
    let fraction = |shift, resolution, of: ClockType| ClockType {
        shift,
        resolution: Some(resolution),
        supports_fraction: true,
        ..of
    };
    let expected = [
        ("received", of(Triggered, None, 0)),
        ("constant", fraction(0.005, 1000, of(Constant, Some(0.01), 7))),
        ("fixed", of(Fixed, Some(0.02), 2)),
        ("sample", fraction(0.0, 1_000_000, of(Calculated, None, 3))),
        ("tuned", of(Tunable, None, 4)),
        ("changing", of(Changing, None, 5)),
        ("countdown", of(Countdown, None, 6)),
        ("sent", ClockType::default()),
        ("ports[1].rx", of(Triggered, None, 7)),
        ("ports[2].rx", of(Triggered, None, 8)),
    ];
    assert_eq!(clocks, expected);
    let asked: Vec<_> = clocks.iter().filter(|(_, of)| of.is_asked_for()).map(|it| it.0).collect();
    assert_eq!(asked, ["sample", "tuned", "changing", "countdown"]);
    let clocked: Vec<_> = (read.variables().filter(|(_, v)| !v.clocks.is_empty()))
        .map(|(_, v)| (&*v.name, &*v.clocks, v.max_size))
        .collect();
    let expected: [(_, &[u32], _); 5] = [
        ("sent", &[3], None),
        ("message", &[0], Some(64)),
        ("command", &[3, 7], None),
        ("ports[1].data", &[14], None),
        ("ports[2].data", &[16], None),
    ];
    assert_eq!(clocked, expected);
}

#[test]
fn a_variable_inherits_what_its_clock_type_says() {
    let root = parse(
        "<fmiModelDescription fmiVersion='3.0'><TypeDefinitions>\
        <ClockType name='Periodic' intervalVariability='fixed' resolution='3' intervalCounter='1' \
        supportsFraction='true' priority='2'/></TypeDefinitions><ModelVariables>\
        <Clock name='a' valueReference='1' causality='input' declaredType='Periodic' \
        intervalVariability='constant' shiftCounter='6'/>\
        <Clock name='b' valueReference='2' causality='input' intervalVariability='nonsense' \
        resolution='0' intervalCounter='1' intervalDecimal='INF' shiftDecimal='x'/>\
        </ModelVariables></fmiModelDescription>",
    )
    .unwrap();
    let read = ModelDescription::read(&root).unwrap();
    let expected = ClockType {
        interval_variability: IntervalVariability::Constant,
        interval: Some(1.0 / 3.0),
        shift: 2.0,
        resolution: Some(3),
        supports_fraction: true,
        priority: Some(2),
        can_be_deactivated: false,
    };
    let clocks = read.variables().map(|(_, v)| v.clock);
    assert_eq!(Vec::from_iter(clocks), [Some(expected), Some(ClockType::default())]);
    assert_eq!(expected.counter(2.0), Some(6));
}

#[test]
fn the_guid_identifies_the_clocks() {
    let text = |interface: &Interface| String::from_utf8(guid(interface).to_vec()).unwrap();
    let found = description(&CLOCKS_COPY);
    assert_eq!(found.guid, text(&CLOCKS));
    assert!(found.is_clocked && found.has_events() && found.is_for_scheduled_execution());
    let not_clocked = Interface { is_clocked: false, ..CLOCKS };
    assert_ne!(text(&not_clocked), text(&CLOCKS));
}

#[test]
fn the_model_tells_the_timing_that_it_calculates() {
    let mut model = Clocks::new();
    model.ts = 0.004;
    let timing = |number| model.clock_timing(number).map(|it| (it.interval, it.shift));
    assert_eq!((timing(3), timing(4)), (Some((0.004, 0.002)), Some((0.1, 0.0))));
    assert!(
        (0..Clocks::COUNT).filter(|number| ![3, 4].contains(number)).all(|i| timing(i).is_none())
    );
}
