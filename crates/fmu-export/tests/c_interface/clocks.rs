//! Models with clocks: ticks in event mode and in scheduled execution, intervals, and clocked variables.

use std::cell::Cell;
use std::ffi::{CString, c_int};
use std::ptr::null_mut;

use fmu_description::Type;
use fmu_export::prelude::*;
use fmu_export::testing::Driver;
use fmu_export::{Entry, interface, table_size};
use proptest::collection::vec;
use proptest::prelude::*;

use crate::driver::*;
use crate::models::{BREAK, DISCARD, DIVERGE, REFUSE, fail};

/// Has clocks of every kind
#[derive(Model)]
#[model(clocked)]
#[rustfmt::skip]
struct Node {
    /** a message has arrived */ #[input] received: Clock,
    /** constant */ #[input(constant, interval = 0.25, shift = 0.5, resolution = 8)] steady: Clock,
    /** set before the simulation */ #[input(fixed, interval = 1)] fixed: Clock,
    /** calculated */ #[input(calculated, interval = self.ts, shift = self.delay)] sample: Clock,
    /** follows a parameter */ #[input(tunable, interval = self.period)] tuned: Clock,
    /** set during the simulation */ #[input(tunable, interval = 2)] set: Clock,
    /** says when it ticks next */ #[input(changing)] next: Clock,
    /** counts down */ #[input(countdown)] timer: Clock,
    /** the command is to be sent */ #[output] sent: Clock,
    /** message */ #[input(clocks(received))] message: f64,
    /** sum of the messages */ #[output(clocks(received))] sum: f64,
    /** command */ #[output(clocks(sent))] command: f64,
    /** ticks of any clock */ #[output] ticks: i32,
    /** the clocks that last ticked, as bits */ #[output] active: i32,
    /** time of the last tick */ #[output] at: f64,
    /** is not clocked */ #[input] offset: f64,
    /** sample time */ #[parameter(start = 0.125)] ts: f64,
    /** of `sample` */ #[parameter] delay: f64,
    /** of `tuned` */ #[parameter(tunable, start = 0.5)] period: f64,
    /** of `next` */ #[parameter(tunable, start = 0.75)] interval: f64,
    /** of `timer`; negative: none */ #[parameter(tunable, start = -1)] count: f64,
    /** how a tick fails */ #[parameter(tunable)] trouble: f64,
    /** what it assigns wrongly */ #[parameter(tunable)] fault: i32,
    /** bytes at each tick */ #[output] bytes: Vec<u8>,
    /** whether there are any */ #[parameter] has_bytes: bool,
}

impl Clocked for Node {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        if self.interval != 99.0 {
            self.next = Clock::after(self.interval);
        }
        if self.count >= 0.0 {
            self.timer = Clock::after(self.count);
        }
        Ok(())
    }

    fn tick(&mut self, time: f64) -> Result<(), ModelError> {
        let clocks = [
            self.received,
            self.steady,
            self.fixed,
            self.sample,
            self.tuned,
            self.set,
            self.next,
            self.timer,
        ];
        fail(self.trouble)?;
        self.active = 0;
        for (i, clock) in clocks.iter().enumerate() {
            self.active |= i32::from(clock.is_active()) << i;
        }
        self.ticks += 1;
        self.at = time;
        if self.received.is_active() {
            self.sum += self.message;
            if self.count >= 0.0 {
                self.timer = Clock::after(self.count);
            }
        }
        if self.sample.is_active() {
            self.command = self.sum + self.offset;
            self.sent = Clock::TICK;
        }
        if self.next.is_active() && self.interval > 0.5 {
            self.next = Clock::after(self.interval);
        }
        if self.trouble == DIVERGE {
            self.command = f64::NAN;
        }
        match self.fault {
            1 => self.sent = Clock::after(1.0),
            2 => self.received = Clock::TICK,
            3 => self.tuned = Clock::after(1.0),
            4 => self.timer = Clock::after(-1.0),
            5 => self.next = Clock::TICK,
            _ => {}
        }
        if self.has_bytes {
            self.bytes = vec![self.ticks as u8; 3];
        }
        Ok(())
    }
}

const RECEIVED: u32 = 0;
const STEADY: u32 = 1;
const FIXED: u32 = 2;
const SAMPLE: u32 = 3;
const TUNED: u32 = 4;
const SET: u32 = 5;
const NEXT: u32 = 6;
const TIMER: u32 = 7;
const SENT: u32 = 8;
const MESSAGE: u32 = 9;
const SUM: u32 = 10;
const COMMAND: u32 = 11;
const TICKS: u32 = 12;
const ACTIVE: u32 = 13;
const AT: u32 = 14;
const OFFSET: u32 = 15;
const TS: u32 = 16;
const DELAY: u32 = 17;
const PERIOD: u32 = 18;
const INTERVAL: u32 = 19;
const COUNT: u32 = 20;
const TROUBLE: u32 = 21;
const FAULT: u32 = 22;
const END: u32 = 25;

/// Counts down to zero, and ticks there
#[derive(Model)]
#[model(continuous)]
#[rustfmt::skip]
struct Fuse {
    /** is lit anew */ #[input] lit: Clock,
    /** burns out */ #[output] burnt: Clock,
    /** length */ #[output(state)] length: f64,
    /** speed */ #[derivative(of = length)] speed: f64,
    /** sign */ #[event_indicator] end: f64,
    /** new length */ #[input(clocks(lit))] new: f64,
    /** number of events */ #[output] events: i32,
    is_burning: bool,
}

impl Continuous for Fuse {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        (self.length, self.is_burning) = (1.0, true);
        Ok(())
    }

    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        self.speed = if self.is_burning { -1.0 } else { 0.0 };
        self.end = if self.is_burning { self.length } else { 1.0 };
        Ok(())
    }

    fn event(&mut self, _time: f64) -> Result<(), ModelError> {
        self.events += 1;
        if self.lit.is_active() {
            (self.length, self.is_burning) = (self.new, true);
        } else if self.is_burning && self.length < 1e-3 {
            self.is_burning = false;
            self.burnt = Clock::TICK;
        }
        Ok(())
    }
}

const LIT: u32 = 0;
const BURNT: u32 = 1;
const LENGTH: u32 = 2;
const NEW: u32 = 5;
const EVENTS_OF_FUSE: u32 = 6;

/// Passes on what arrives
#[derive(Variables, Default)]
#[rustfmt::skip]
struct Port {
    /** something arrives */ #[input] arrived: Clock,
    /** what */ #[input(clocks(arrived))] value: f64,
    /** it leaves */ #[output] left: Clock,
}

/// Has clocks in nested structs, and state that cannot be saved
#[derive(Model)]
#[model(clocked)]
struct Ports {
    #[nested]
    ports: [Port; 2],
    /// number of elements in use
    #[structural_parameter(tunable, start = 1, max = 2)]
    n: u64,
    /// sums
    #[output(size = n)]
    sums: [f64; 2],
    /// number of ticks
    #[output]
    ticks: i32,
}

impl Clocked for Ports {
    fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
        self.ticks += 1;
        for (port, sum) in self.ports.iter_mut().zip(&mut self.sums[..self.n as usize]) {
            if port.arrived.is_active() {
                *sum += port.value;
                port.left = Clock::TICK;
            }
        }
        Ok(())
    }
}

/// Counts outside of what is saved
#[derive(Model)]
#[model(clocked)]
struct Unsaved {
    /// ticks
    #[input]
    clock: Clock,
    /// number of ticks
    #[output]
    count: f64,
    /// something
    #[input]
    u: f64,
    #[unsaved]
    ticks: u32,
}

impl Clocked for Unsaved {
    fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
        self.ticks += 1;
        self.count = f64::from(self.ticks);
        Ok(())
    }
}

const N: usize = table_size::<Node>();
const M: usize = table_size::<Fuse>();
const P: usize = table_size::<Ports>();
const Q: usize = table_size::<Unsaved>();
static MODELS: [Entry; 4] = [
    Entry::new::<Node, N>(interface::<Node, N>(None), &[]),
    Entry::new::<Fuse, M>(interface::<Fuse, M>(None), &[]),
    Entry::new::<Ports, P>(interface::<Ports, P>(None), &[]),
    Entry::new::<Unsaved, Q>(interface::<Unsaved, Q>(None), &[]),
];
const NODE: usize = 0;
const FUSE: usize = 1;
const PORTS: usize = 2;
const UNSAVED: usize = 3;
/// The kinds in which a host ticks clocks in event mode.
const EVENTFUL: [Kind; 2] = [EVENTS, EXCHANGED[1]];

fn arguments(kind: Kind, model: usize) -> Arguments<'static> {
    let token = Some(CString::new(MODELS[model].guid()).unwrap());
    Arguments { models: &MODELS, token, ..Arguments::new(kind, 0) }
}

fn new(kind: Kind, model: usize) -> Instance {
    Instance::with(&arguments(kind, model))
}

/// An instance in event mode, or in clock activation mode, at 0 s.
fn started(kind: Kind) -> Instance {
    let it = new(kind, NODE);
    it.start(0.0, None);
    it
}

/// Whether clocks are active.
#[track_caller]
fn active<const K: usize>(f: Fmu, clocks: [u32; K]) -> [u8; K] {
    let mut values = [7; K];
    ok([f.get_clocks(&clocks, &mut values)]);
    values
}

/// The interval of a clock with its qualifier: 0 not yet known, 1 unchanged, 2 changed.
#[track_caller]
fn interval(f: Fmu, clock: u32) -> (f64, c_int) {
    let (mut interval, mut qualifier) = ([f64::NAN], [7]);
    ok([f.get_intervals(&[clock], &mut interval, &mut qualifier)]);
    (interval[0], qualifier[0])
}

#[track_caller]
fn shift(f: Fmu, clock: u32) -> f64 {
    let mut shift = [f64::NAN];
    ok([f.get_shifts(&[clock], &mut shift)]);
    shift[0]
}

fn try_interval(f: Fmu, clock: u32) -> Status {
    f.get_intervals(&[clock], &mut [0.0], &mut [0])
}

fn ticks(f: Fmu) -> f64 {
    f.read(Type::Int32, [TICKS])[0]
}

fn set_fault(f: Fmu, fault: i32) {
    ok([f.set_i32(&[FAULT], &[fault])]);
}

#[test]
fn ticks_are_handled_once_when_a_result_is_asked_for() {
    type Ask = fn(Fmu);
    let asks: [Ask; 5] = [
        |f| ok([f.evaluate()]),
        |f| assert_eq!(active(f, [SENT]), [1]),
        |f| assert_eq!(f.get([COMMAND]), [4.0]),
        |f| _ = interval(f, NEXT),
        |_| {},
    ];
    for (kind, ask) in pairs(&EVENTFUL, &asks) {
        let it = started(kind);
        ok([
            it.set_clocks(&[RECEIVED, SAMPLE], &[1, 1]),
            it.set(MESSAGE, 3.0),
            it.set(OFFSET, 1.0),
        ]);
        ask(*it);
        ok([it.evaluate()]);
        assert_eq!(active(*it, [RECEIVED, STEADY, SAMPLE, SENT]), [1, 0, 1, 1]);
        assert_eq!(it.get([SUM, COMMAND, AT]), [3.0, 4.0, 0.0]);
        assert_eq!(it.read(Type::Int32, [TICKS, ACTIVE]), [1.0, 9.0]);
        assert_eq!(it.update(), (false, None));
        assert_eq!(active(*it, [RECEIVED, SAMPLE, SENT]), [0; 3], "the instant is over");
        assert_eq!(it.get([SUM, COMMAND]), [3.0, 4.0], "the last values");
        ok([it.evaluate()]);
        it.update();
        assert_eq!(ticks(*it), 1.0);
        it.end_event_mode();
        assert_eq!(it.get([SUM, COMMAND]), [3.0, 4.0]);
    }
}

#[test]
fn new_values_at_an_instant_are_taken_from_the_state_before_it() {
    for kind in EVENTFUL {
        let it = started(kind);
        ok([it.set_clocks(&[RECEIVED, SAMPLE], &[1, 1]), it.set(MESSAGE, 3.0)]);
        assert_eq!(it.get([SUM, COMMAND]), [3.0; 2]);
        ok([it.set(MESSAGE, 5.0)]);
        assert_eq!(it.get([SUM, COMMAND]), [5.0; 2]);
        ok([it.set(OFFSET, 1.0), it.evaluate(), it.evaluate()]);
        assert_eq!(it.get([SUM, COMMAND]), [5.0, 6.0]);
        // A clock that is set as it is changes nothing; one more ticks at the same instant.
        ok([it.set_clocks(&[SAMPLE], &[1])]);
        ok([it.set_clocks(&[NEXT], &[1])]);
        assert_eq!(it.read(Type::Int32, [TICKS, ACTIVE]), [1.0, 73.0]);
        ok([it.set_clocks(&[SAMPLE], &[0])]);
        assert_eq!((active(*it, [SENT]), it.get([SUM, COMMAND])), ([0], [5.0, 0.0]));
        ok([it.set_clocks(&[RECEIVED, NEXT], &[0, 0])]);
        assert_eq!((ticks(*it), it.get([SUM])), (0.0, [0.0]));
        it.update();
        assert_eq!(ticks(*it), 0.0, "no clock was active");
        // Another instant at the same time.
        ok([it.set_clocks(&[RECEIVED], &[1]), it.set(MESSAGE, 2.0)]);
        it.update();
        ok([it.set_clocks(&[RECEIVED], &[1])]);
        assert_eq!(it.get([SUM]), [4.0]);
        it.update();
        assert_eq!(ticks(*it), 2.0);
    }
}

#[test]
fn ticks_happen_at_the_time_of_the_host() {
    let it = started(EVENTS);
    it.update();
    it.end_event_mode();
    assert_eq!(it.steps(0.0, 0.25), results(false, false, 0.25));
    assert_eq!(it.steps(0.25, 0.5), results(false, false, 0.75));
    ok([it.enter_event_mode(), it.set_clocks(&[SAMPLE], &[1])]);
    assert_eq!(it.get([AT]), [0.75]);
    it.update();
    let it = started(EXCHANGED[1]);
    it.update();
    it.end_event_mode();
    ok([it.set_time(1.5), it.enter_event_mode(), it.set_clocks(&[SAMPLE], &[1])]);
    assert_eq!(it.get([AT]), [1.5]);
}

#[test]
fn event_mode_is_left_after_an_update() {
    for kind in EVENTFUL {
        let it = started(kind);
        ok([it.set_clocks(&[SAMPLE], &[1])]);
        let words = "clock sample: it is active; expected fmi3UpdateDiscreteStates";
        it.refuses(words, Fmu::try_end_event_mode);
        ok([it.evaluate()]);
        it.refuses(words, Fmu::try_end_event_mode);
        it.update();
        it.end_event_mode();
    }
}

#[test]
fn each_kind_says_what_is_known_of_its_interval() {
    for kind in [EVENTS, EXCHANGED[1], SCHEDULED] {
        let it = new(kind, NODE);
        ok([it.set(TS, 0.5), it.set(DELAY, 0.25), it.enter(1.0, None, None)]);
        let (unchanged, changed) = (1, 2);
        assert_eq!(interval(*it, STEADY), (0.25, unchanged));
        assert_eq!(interval(*it, FIXED), (1.0, unchanged));
        assert_eq!(interval(*it, SET), (2.0, unchanged));
        assert_eq!(interval(*it, SAMPLE), (0.5, changed));
        assert_eq!(interval(*it, SAMPLE), (0.5, unchanged));
        assert_eq!(interval(*it, TUNED), (0.5, changed));
        assert_eq!(interval(*it, NEXT), (0.75, changed));
        assert_eq!(interval(*it, NEXT), (0.75, unchanged));
        assert_eq!(interval(*it, TIMER), (0.0, 0));
        ok([it.set(TS, 0.125), it.set(INTERVAL, 1.5), it.set(COUNT, 0.0)]);
        assert_eq!(interval(*it, SAMPLE), (0.125, changed));
        assert_eq!(interval(*it, NEXT), (1.5, changed));
        assert_eq!(interval(*it, TIMER), (0.0, changed));
        assert_eq!(
            [STEADY, FIXED, SAMPLE, TUNED, SET].map(|clock| shift(*it, clock)),
            [0.5, 0.0, 0.25, 0.0, 0.0]
        );
        for clock in [RECEIVED, SENT, NEXT, TIMER] {
            it.refuses("has no shift", |f| f.get_shifts(&[clock], &mut [0.0]));
        }
        for clock in [RECEIVED, SENT] {
            it.refuses("is triggered, and has no interval", |f| try_interval(f, clock));
        }
        it.refuses("clock sample: supportsFraction is false", |f| {
            f.get_interval_fractions(&[SAMPLE], &mut [0], &mut [0], &mut [0])
        });
        let (mut counter, mut resolution, mut qualifier) = ([0], [0], [0]);
        ok([it.get_interval_fractions(&[STEADY], &mut counter, &mut resolution, &mut qualifier)]);
        assert_eq!((counter, resolution, qualifier), ([2], [8], [unchanged]));
        ok([it.get_shift_fractions(&[STEADY], &mut counter, &mut resolution)]);
        assert_eq!((counter, resolution), ([4], [8]));
        ok([it.exit_initialization_mode()]);
        assert_eq!(interval(*it, SAMPLE), (0.125, unchanged));
    }
}

#[test]
fn a_calculated_interval_is_never_new_after_the_initialization() {
    let it = started(EVENTS);
    assert_eq!(interval(*it, SAMPLE), (0.125, 1));
}

#[test]
fn an_interval_follows_tunable_parameters() {
    let it = started(EVENTS);
    assert_eq!(interval(*it, TUNED), (0.5, 2));
    ok([it.set(PERIOD, 0.25)]);
    assert_eq!(interval(*it, TUNED), (0.25, 2));
    assert_eq!(interval(*it, TUNED), (0.25, 1));
    ok([it.set(PERIOD, 0.0)]);
    it.refuses("clock tuned: the interval is 0 s; expected a positive number", |f| {
        try_interval(f, TUNED)
    });
    ok([it.set(PERIOD, 0.25)]);
    assert_eq!(interval(*it, TUNED), (0.25, 1));
}

#[test]
fn the_host_sets_intervals_of_fixed_and_tunable_clocks() {
    let it = new(EVENTS, NODE);
    ok([it.enter(0.0, None, None)]);
    ok([it.set_intervals(&[FIXED, SET], &[0.25, 0.5]), it.set_shifts(&[FIXED], &[0.125])]);
    assert_eq!([interval(*it, FIXED), interval(*it, SET)], [(0.25, 1), (0.5, 1)]);
    assert_eq!([shift(*it, FIXED), shift(*it, SET)], [0.125, 0.0]);
    ok([it.set_interval_fractions(&[SET], &[3], &[4]), it.set_shift_fractions(&[SET], &[1], &[2])]);
    assert_eq!((interval(*it, SET), shift(*it, SET)), ((0.75, 1), 0.5));
    for (value, shown) in [(0.0, "0"), (-1.0, "-1"), (f64::NAN, "NaN"), (f64::INFINITY, "inf")] {
        let words = format!("clock set: the interval is {shown} s; expected a positive number");
        it.refuses(&words, |f| f.set_intervals(&[SET], &[value]));
    }
    it.refuses("clock set: the shift is -1 s", |f| f.set_shifts(&[SET], &[-1.0]));
    it.refuses("a resolution is 0", |f| f.set_interval_fractions(&[SET], &[1], &[0]));
    it.refuses("a resolution is 0", |f| f.set_shift_fractions(&[SET], &[1], &[0]));
    for (clock, kind) in [
        (RECEIVED, "received: it is triggered"),
        (STEADY, "steady: it is constant"),
        (SAMPLE, "sample: it is calculated"),
        (TUNED, "tuned: it is tunable"),
        (NEXT, "next: it is changing"),
        (TIMER, "timer: it is countdown"),
        (SENT, "sent: it is triggered"),
    ] {
        let words = format!("clock {kind}, so that the host does not set when it ticks");
        it.refuses(&words, |f| f.set_intervals(&[clock], &[1.0]));
        it.refuses(&words, |f| f.set_shifts(&[clock], &[1.0]));
    }
    ok([it.exit_initialization_mode(), it.set_intervals(&[SET], &[4.0])]);
    it.refuses("clock fixed: it is fixed", |f| f.set_intervals(&[FIXED], &[1.0]));
    assert_eq!([interval(*it, FIXED), interval(*it, SET)], [(0.25, 1), (4.0, 1)]);
    ok([it.reset(), it.enter(0.0, None, None)]);
    assert_eq!([interval(*it, FIXED), interval(*it, SET)], [(1.0, 1), (2.0, 1)]);
}

#[test]
fn aperiodic_clocks_tick_when_the_model_says_so() {
    for kind in EVENTFUL {
        let it = started(kind);
        ok([it.set(COUNT, 0.5)]);
        assert_eq!(interval(*it, NEXT), (0.75, 2));
        let tick = |clock| {
            ok([it.set_clocks(&[clock], &[1])]);
            it.update();
        };
        tick(NEXT);
        assert_eq!([interval(*it, NEXT), interval(*it, NEXT)], [(0.75, 2), (0.75, 1)]);
        tick(SAMPLE);
        assert_eq!(interval(*it, NEXT), (0.75, 1), "it has not ticked");
        ok([it.set(INTERVAL, 0.25)]);
        tick(NEXT);
        assert_eq!(interval(*it, NEXT), (0.75, 2), "as before, since the model says nothing");
        assert_eq!(interval(*it, TIMER), (0.0, 0));
        tick(RECEIVED);
        assert_eq!([interval(*it, TIMER), interval(*it, TIMER)], [(0.5, 2), (0.5, 1)]);
        tick(SAMPLE);
        assert_eq!(interval(*it, TIMER), (0.5, 1));
        tick(RECEIVED);
        assert_eq!(interval(*it, TIMER), (0.5, 2), "it counts anew");
        tick(TIMER);
        assert_eq!(interval(*it, TIMER), (0.0, 0));
        // Before it was asked for.
        tick(RECEIVED);
        tick(TIMER);
        assert_eq!(interval(*it, TIMER), (0.0, 0));
    }
}

#[test]
fn clocked_variables_are_set_at_ticks_of_their_clocks() {
    for kind in EVENTFUL {
        let it = new(kind, NODE);
        ok([it.set(MESSAGE, 1.0), it.enter(0.0, None, None), it.set(MESSAGE, 2.0)]);
        ok([it.exit_initialization_mode()]);
        let words = "message is a clocked variable: none of its clocks is active (received)";
        it.refuses(words, |f| f.set(MESSAGE, 3.0));
        ok([it.set_clocks(&[SAMPLE], &[1])]);
        it.refuses(words, |f| f.set(MESSAGE, 3.0));
        ok([it.set_clocks(&[RECEIVED], &[1]), it.set(MESSAGE, 3.0)]);
        it.update();
        assert_eq!(it.get([SUM, MESSAGE]), [3.0; 2]);
        it.refuses(words, |f| f.set(MESSAGE, 3.0));
        it.end_event_mode();
        it.refuses("message is a clocked variable: it is set in event mode", |f| {
            f.set(MESSAGE, 3.0)
        });
    }
    let it = started(SCHEDULED);
    ok([it.set(MESSAGE, 3.0), it.activate(RECEIVED as c_int, 0.0)]);
    assert_eq!(it.get([SUM]), [3.0]);
}

#[test]
fn wrong_references_and_values_are_refused() {
    let it = started(EVENTS);
    ok([it.set_clocks(&[SAMPLE], &[1])]);
    let own = format!("value reference {} is unknown; expected 0 to {}", END + 1, END - 1);
    for (reference, words) in
        [(END + 1, own.as_str()), (COMMAND, "command is of type Float64, not Clock")]
    {
        it.refuses(words, |f| f.get_clocks(&[SAMPLE, reference], &mut [0, 0]));
        it.refuses(words, |f| f.set_clocks(&[RECEIVED, reference], &[1, 1]));
        it.refuses(words, |f| try_interval(f, reference));
        it.refuses(words, |f| f.set_intervals(&[reference], &[1.0]));
    }
    it.refuses("clock sent: it is an output", |f| f.set_clocks(&[RECEIVED, SENT], &[1, 1]));
    it.refuses("clock received: the value is 2; expected 0 (inactive) or 1 (active)", |f| {
        f.set_clocks(&[RECEIVED], &[2])
    });
    it.refuses("received is of type Clock, not Float64", |f| f.set(RECEIVED, 1.0));
    it.refuses("received is of type Clock, not Float64", |f| f.get_f64(&[RECEIVED], &mut [0.0]));
    let initial = new(EVENTS, NODE);
    ok([initial.enter(0.0, None, None)]);
    let words = "value reference 99 is unknown";
    initial.refuses(words, |f| f.get_shifts(&[99], &mut [0.0]));
    initial.refuses(words, |f| f.set_shifts(&[99], &[0.0]));
    assert_eq!(active(*initial, [SAMPLE, SENT]), [0; 2]);
}

#[test]
fn a_failed_tick_leaves_the_state_before_it_or_ends_the_simulation() {
    for kind in EVENTFUL {
        for trouble in [REFUSE, DISCARD, BREAK, DIVERGE] {
            let it = started(kind);
            ok([it.set(TROUBLE, trouble), it.set_clocks(&[SAMPLE, TIMER], &[1, 1])]);
            let status = if trouble == DISCARD { DISCARDED } else { ERROR };
            assert_eq!(it.evaluate(), status);
            if trouble == DIVERGE {
                it.says("command became NaN");
            }
            if [REFUSE, DISCARD].contains(&trouble) {
                assert_eq!(it.try_update().0, status);
                ok([it.set(TROUBLE, 0.0)]);
                assert_eq!(it.read(Type::Int32, [TICKS, ACTIVE]), [1.0, 136.0]);
                it.update();
            } else {
                it.refuses("not allowed in the state \"error\"", |f| f.try_update().0);
                ok([it.reset()]);
                it.start(0.0, None);
                ok([it.set_clocks(&[SAMPLE], &[1])]);
                assert_eq!(ticks(*it), 1.0);
            }
        }
    }
}

#[test]
fn wrong_assignments_to_clocks_are_errors_that_name_them() {
    for (fault, words) in [
        (1, "clock sent: the model has assigned an interval to an output; expected `Clock::TICK`"),
        (2, "clock received: the model has assigned a value to it"),
        (3, "clock tuned: the model has assigned a value to it"),
        (4, "clock timer: the interval is -1 s; expected a number of at least 0"),
        (5, "clock next: the model has activated it"),
    ] {
        let it = started(EVENTS);
        set_fault(*it, fault);
        ok([it.set_clocks(&[SAMPLE], &[1])]);
        it.fails(ERROR, words, Fmu::evaluate);
        let it = started(SCHEDULED);
        set_fault(*it, fault);
        it.fails(ERROR, words, |f| f.activate(SAMPLE as c_int, 0.0));
    }
    for (reference, value, words) in [
        (TS, 0.0, "clock sample: the interval is 0 s; expected a positive number"),
        (TS, -1.0, "clock sample: the interval is -1 s"),
        (DELAY, -1.0, "clock sample: the shift is -1 s"),
        (INTERVAL, -1.0, "clock next: the interval is -1 s; expected a number of at least 0"),
        (INTERVAL, 99.0, "clock next: the model has assigned no interval; expected `Clock::after`"),
    ] {
        let it = new(EVENTS, NODE);
        ok([it.set(reference, value), it.enter(0.0, None, None)]);
        it.refuses(words, Fmu::exit_initialization_mode);
        it.refuses(words, |f| f.get_f64(&[SUM], &mut [0.0]));
        ok([it.set(reference, 0.5)]);
        ok([it.exit_initialization_mode()]);
    }
}

#[test]
fn a_state_contains_the_instant() {
    for kind in EVENTFUL {
        let it = started(kind);
        ok([it.set(COUNT, 0.5), it.set_clocks(&[RECEIVED, SAMPLE], &[1, 1]), it.set(MESSAGE, 3.0)]);
        let begun = it.snapshot();
        assert_eq!(it.get([SUM]), [3.0]);
        let mut evaluated = it.save();
        let serialized = it.serialize(evaluated);
        it.update();
        assert_eq!(interval(*it, TIMER), (0.5, 2));
        let ended = it.snapshot();
        let other = started(kind);
        for (f, bytes) in [(*it, &serialized), (*other, &serialized)] {
            f.resume(bytes);
            assert_eq!((active(f, [RECEIVED, SENT]), f.get([SUM])), ([1, 1], [3.0]));
            ok([f.set(MESSAGE, 4.0)]);
            assert_eq!(
                (f.get([SUM]), ticks(f)),
                ([4.0], 1.0),
                "the state before the tick is restored"
            );
        }
        ok([other.set_state(evaluated)]);
        other.update();
        assert_eq!((other.get([SUM]), ticks(*other)), ([3.0], 1.0), "it is not repeated");
        assert_eq!(interval(*other, TIMER), (0.5, 2));
        other.resume(&begun);
        ok([other.set(MESSAGE, 5.0)]);
        assert_eq!((other.get([SUM]), ticks(*other)), ([5.0], 1.0));
        other.resume(&ended);
        assert_eq!((active(*other, [RECEIVED]), interval(*other, TIMER)), ([0], (0.5, 1)));
        ok([it.free_state(&mut evaluated)]);
        // Damaged bytes, whose checksum is wrong.
        for i in [0, serialized.len() / 2, serialized.len() - 1] {
            let mut bytes = serialized.clone();
            bytes[i] ^= 1;
            it.refuses("", |f| f.deserialize(&bytes, &mut null_mut()));
        }
    }
}

#[test]
fn nested_structs_have_clocks_of_their_own() {
    let it = new(EVENTS, PORTS);
    it.start(0.0, None);
    // Each port has three variables.
    ok([it.set_clocks(&[3], &[1]), it.set(4, 2.0)]);
    it.refuses(
        "ports[1].value is a clocked variable: none of its clocks is active (ports[1].arrived)",
        |f| f.set(1, 2.0),
    );
    assert_eq!(active(*it, [2, 5]), [0, 0], "one element is in use");
    // The size changes at the instant, which is evaluated again.
    ok([it.enter_configuration_mode(), it.set_u64(&[6], &[2]), it.exit_configuration_mode()]);
    ok([it.set_clocks(&[0], &[1]), it.set(1, 1.0)]);
    assert_eq!(active(*it, [2, 5]), [1, 1]);
    assert_eq!(it.get_all(Type::Float64, &[7], 2).1, [1.0, 2.0]);
    it.update();
    assert_eq!(it.read(Type::Int32, [9]), [1.0]);
    let it = new(SCHEDULED, PORTS);
    it.start(0.0, None);
    it.refuses("clock ports[2].left: it is an output", |f| f.activate(5, 0.0));
    ok([it.set(1, 3.0), it.activate(0, 0.0)]);
    assert_eq!(it.get_all(Type::Float64, &[7], 1).1, [3.0]);
}

#[test]
fn a_tick_that_cannot_be_taken_back_is_not_repeated() {
    let it = new(EVENTS, UNSAVED);
    it.start(0.0, None);
    ok([it.set_clocks(&[0], &[1]), it.set(2, 1.0)]);
    assert_eq!(it.get([1]), [1.0]);
    let words = "the model has fields that cannot be saved, so that a tick cannot be repeated";
    it.fails(ERROR, words, |f| f.set(2, 2.0));
    it.fails(ERROR, words, |f| f.set_clocks(&[0], &[0]));
    it.update();
    ok([it.set(2, 2.0), it.set_clocks(&[0], &[1])]);
    it.update();
    assert_eq!(it.get([1]), [2.0]);
}

#[test]
fn event_mode_is_needed_in_co_simulation() {
    for model in [NODE, FUSE] {
        let it = new(PLAIN[1], model);
        assert!(it.c.is_null());
        it.says("has clocks, which tick in event mode; expected a host with event mode");
    }
    let it = new(SCHEDULED, FUSE);
    assert!(it.c.is_null());
}

#[test]
fn a_partition_acts_at_the_tick_of_its_clock_alone() {
    let it = started(SCHEDULED);
    LOCKS.set([0; 2]);
    ok([it.activate(RECEIVED as c_int, 0.5)]);
    assert_eq!(LOCKS.get(), [1; 2]);
    assert_eq!(it.read(Type::Int32, [TICKS, ACTIVE]), [1.0, 1.0]);
    ok([it.activate(STEADY as c_int, 0.5), it.activate(NEXT as c_int, 0.75)]);
    assert_eq!(it.read(Type::Int32, [TICKS, ACTIVE]), [3.0, 64.0]);
    assert_eq!(it.get([AT]), [0.75]);
    assert_eq!(interval(*it, NEXT), (0.75, 2));
    assert_eq!(interval(*it, TUNED), (0.5, 2));
    // Another clock may be late, but no clock ticks twice at a time or goes back.
    ok([it.activate(SAMPLE as c_int, 0.625)]);
    for time in [0.75, 0.5] {
        let words = "clock next: its model partition is activated at";
        it.refuses(words, |f| f.activate(NEXT as c_int, time));
    }
    for time in [f64::NAN, f64::INFINITY] {
        it.refuses("the activation time is", |f| f.activate(NEXT as c_int, time));
    }
    it.refuses("clock sent: it is an output, which has no model partition", |f| {
        f.activate(SENT as c_int, 1.0)
    });
    it.refuses("not Clock", |f| f.activate(COMMAND as c_int, 1.0));
    it.refuses("is unknown", |f| f.activate(99, 1.0));
    let bytes = it.snapshot();
    let other = new(SCHEDULED, NODE);
    other.resume(&bytes);
    other.refuses("its model partition is activated at", |f| f.activate(NEXT as c_int, 0.75));
    ok([other.activate(NEXT as c_int, 1.0), other.terminate()]);
    assert_eq!(ticks(*other), 5.0);
    ok([other.reset()]);
    other.start(0.0, None);
    ok([other.activate(NEXT as c_int, 0.25)]);
}

#[test]
fn a_failed_activation_keeps_the_time() {
    let it = started(SCHEDULED);
    ok([it.set(TROUBLE, REFUSE)]);
    it.fails(ERROR, "at t = 0.5 s: refused by the model", |f| f.activate(TIMER as c_int, 0.5));
    ok([it.set(TROUBLE, 0.0), it.activate(TIMER as c_int, 0.5)]);
    ok([it.set(TROUBLE, BREAK)]);
    it.fails(ERROR, "at t = 1.0 s: broken by the model", |f| f.activate(TIMER as c_int, 1.0));
    it.refuses("not allowed in the state \"error\"", |f| f.activate(TIMER as c_int, 2.0));
}

#[test]
fn ticks_and_countdowns_are_told_in_clock_update_mode() {
    let it = started(SCHEDULED);
    let seen = std::rc::Rc::new(Cell::new(0));
    let count = seen.clone();
    it.on_clock_update(move |f| {
        count.set(count.get() + 1);
        assert_eq!(LOCKS.get()[0], LOCKS.get()[1], "the instance is not locked");
        if count.get() == 1 {
            assert_eq!([active(f, [SENT, SAMPLE]), active(f, [SENT, SAMPLE])], [[1, 0], [0, 0]]);
            assert_eq!(f.get([COMMAND]), [0.0]);
        } else {
            assert_eq!(active(f, [SENT]), [0]);
            assert_eq!([interval(f, TIMER), interval(f, TIMER)], [(0.5, 2), (0.5, 1)]);
        }
        assert_eq!(f.activate(NEXT as c_int, 5.0), ERROR);
        assert_eq!([f.set(OFFSET, 1.0), f.terminate(), f.reset()], [ERROR; 3]);
        assert!(f.save().is_null());
    });
    LOCKS.set([0; 2]);
    ok([it.activate(SAMPLE as c_int, 0.0)]);
    assert_eq!(seen.get(), 1);
    it.says("is not allowed in the state \"clock update mode\"");
    ok([it.activate(NEXT as c_int, 0.0), it.activate(RECEIVED as c_int, 0.0)]);
    assert_eq!(seen.get(), 1, "nothing is new");
    ok([it.set(COUNT, 0.5), it.activate(RECEIVED as c_int, 1.0)]);
    assert_eq!(seen.get(), 2);
    it.refuses("it is allowed in: initialization mode, clock update mode", |f| {
        f.get_clocks(&[SENT], &mut [0])
    });
}

#[test]
fn an_instance_is_not_freed_in_its_update_of_clocks() {
    let it = started(SCHEDULED);
    it.on_clock_update(|f| f.free());
    ok([it.activate(SAMPLE as c_int, 0.0), it.activate(SAMPLE as c_int, 1.0)]);
}

#[test]
fn another_partition_may_preempt_the_update_of_clocks() {
    let it = started(SCHEDULED);
    it.on_clock_update(|f| {
        let address = f.c as usize;
        let other = std::thread::spawn(move || {
            let f = Fmu { kind: SCHEDULED, c: address as *mut _ };
            ok([f.set(MESSAGE, 2.0), f.activate(RECEIVED as c_int, 0.5)]);
            f.get([SUM])
        });
        assert_eq!(other.join().unwrap(), [2.0]);
        assert_eq!(active(f, [SENT]), [1]);
        assert_eq!(f.activate(RECEIVED as c_int, 1.0), ERROR);
    });
    ok([it.activate(SAMPLE as c_int, 0.0), it.activate(RECEIVED as c_int, 1.0)]);
}

#[test]
fn an_output_clock_ticks_at_the_event_at_which_a_step_ends() {
    for is_early in [false, true] {
        let it = arguments(EVENTS, FUSE).make(|a| a.early_return = is_early);
        it.start(0.0, None);
        assert_eq!(active(*it, [BURNT]), [0]);
        it.update();
        it.end_event_mode();
        let Results { event, early, time } = it.steps(0.0, 2.0);
        assert_eq!((event, early), (true, is_early));
        assert!((time - if is_early { 1.0 } else { 2.0 }).abs() < 1e-6, "{time}");
        ok([it.enter_event_mode()]);
        assert_eq!((active(*it, [BURNT]), active(*it, [BURNT])), ([1], [1]));
        let events = it.read(Type::Int32, [EVENTS_OF_FUSE]);
        it.update();
        assert_eq!(active(*it, [BURNT]), [0]);
        assert_eq!(it.read(Type::Int32, [EVENTS_OF_FUSE]), events, "the event is handled once");
        ok([it.set_clocks(&[LIT], &[1]), it.set(NEW, 3.0)]);
        assert_eq!(active(*it, [BURNT]), [0]);
        it.update();
        assert_eq!(it.get([LENGTH]), [3.0]);
        it.end_event_mode();
        it.steps(time, 0.5);
        near(it.get([LENGTH]), [2.5], 1e-9);
    }
    // In model exchange.
    let it = new(EXCHANGED[1], FUSE);
    it.start(0.0, None);
    assert_eq!(active(*it, [BURNT]), [0]);
    assert_eq!(it.update(), (false, None));
    it.end_event_mode();
    ok([it.set_time(1.0), it.set_states(&[0.0]), it.enter_event_mode()]);
    assert_eq!(active(*it, [BURNT]), [1]);
    it.update();
    ok([it.set_clocks(&[LIT], &[1]), it.set(NEW, 3.0), it.evaluate(), it.set(NEW, 4.0)]);
    assert_eq!(it.update(), (true, None));
    let mut states = [0.0];
    ok([it.get_states(&mut states)]);
    assert_eq!(states, [4.0]);
}

#[test]
fn a_test_ticks_clocks_without_a_host() {
    let mut node = Driver::<Node>::new();
    node.set("message", 3.0).unwrap();
    node.tick(&["received", "sample"]).unwrap();
    assert_eq!((node.sum, node.command, node.sent.is_active()), (3.0, 3.0, true));
    assert!(!node.received.is_active());
    node.step(0.5).unwrap();
    node.tick(&["next"]).unwrap();
    assert_eq!((node.at, node.sent.is_active()), (0.5, false));
    assert_eq!(node.next.interval(), Some(0.75));
    for (clocks, words) in [
        (&["sent"][..], "clock sent: it is an output"),
        (&["command"], "command is of type Float64, not Clock"),
        (&["other"], "there is no variable \"other\""),
        (&[], "no clock ticks"),
    ] {
        let error = node.tick(clocks).unwrap_err();
        assert!(error.reason().contains(words), "{error}");
    }
    node.trouble = BREAK;
    assert!(node.tick(&["next"]).is_err());
}

#[test]
fn a_tick_does_not_allocate() {
    let (it, mut last, mut clock) = (started(EVENTS), [0.0], [0]);
    let scheduled = started(SCHEDULED);
    scheduled.on_clock_update(|f| _ = active(f, [SENT]));
    let allocations = allocation_counter::measure(|| {
        for k in 0..1000 {
            ok([it.set_clocks(&[RECEIVED, SAMPLE], &[1, 1]), it.set_f64(&[MESSAGE], &[1.0])]);
            ok([it.evaluate(), it.get_f64(&[COMMAND], &mut last)]);
            ok([it.set_f64(&[MESSAGE], &[2.0]), it.get_clocks(&[SENT], &mut clock)]);
            it.update();
            it.end_event_mode();
            it.steps(f64::from(k) * 0.125, 0.125);
            ok([it.enter_event_mode()]);
            ok([
                scheduled.set_f64(&[MESSAGE], &[1.0]),
                scheduled.activate(SAMPLE as c_int, f64::from(k)),
            ]);
        }
    });
    assert_eq!(allocations.count_total, 0);
    assert_eq!((clock, it.get([SUM])), ([1], [2000.0]));
}

/// An instance in a state: instantiated, initialization mode, event mode, step mode or continuous-time mode, clock
/// activation mode, terminated or error.
fn in_state(kind: Kind, state: char) -> Instance {
    let it = new(kind, NODE);
    if state != 'I' {
        ok([it.enter(0.0, None, None)]);
    }
    if !"IN".contains(state) {
        ok([it.exit_initialization_mode()]);
    }
    match state {
        'S' | 'C' => _ = (it.update(), it.end_event_mode()),
        'T' => ok([it.terminate()]),
        'X' if kind == SCHEDULED => {
            ok([it.set(TROUBLE, BREAK)]);
            assert_eq!(it.activate(SAMPLE as c_int, 0.0), ERROR);
        }
        'X' => {
            ok([it.set(TROUBLE, BREAK), it.set_clocks(&[SAMPLE], &[1])]);
            assert_eq!(it.evaluate(), ERROR);
        }
        _ => {}
    }
    it
}

#[test]
fn functions_of_clocks_are_allowed_in_the_states_of_the_standard() {
    // FMI 3.0.2, sections 2.3, 3.2, 4.2 and 5.2. In clock update mode, see below.
    let table = [
        ("get_clock", "NE"),
        ("set_clock", "E"),
        ("get_interval_decimal get_interval_fraction", "NEA"),
        ("set_interval_decimal set_interval_fraction", "NEA"),
        ("get_shift_decimal get_shift_fraction", "N"),
        ("set_shift_decimal set_shift_fraction", "N"),
        ("evaluate_discrete_states", "E"),
        ("activate_model_partition", "A"),
    ];
    for (kind, states) in [(EVENTS, "INESTX"), (EXCHANGED[1], "INECTX"), (SCHEDULED, "INATX")] {
        for function in functions(Fmi3) {
            let is_of = |(operations, _): &&(&str, &str)| {
                operations.split(' ').any(|operation| operation == function.operation)
            };
            let Some((_, allowed)) = table.iter().find(is_of) else { continue };
            for state in states.chars() {
                let it = in_state(kind, state);
                it.forget_messages();
                let before = it.snapshot();
                let status = function.call_with_zeros(*it, 1, None);
                let last = it.messages().pop().map_or(String::new(), |message| message.text);
                let is_lacking = last.contains("is not allowed in the state")
                    || last.contains("the instance is ")
                    || last.contains("it is a function of ");
                let what = format!("{} in {state} of {kind:?}: {last}", function.operation);
                assert_eq!(is_lacking, !allowed.contains(state), "{what}");
                assert!(status == OK || it.snapshot() == before, "{what}");
                let refusals = function.refusals.iter().flatten().enumerate();
                for (null, words) in refusals.filter(|(_, words)| !words.is_empty()) {
                    it.refuses(words, |f| function.call_with_zeros(f, 1, Some(null)));
                }
                // No clock at all.
                assert!(is_lacking || function.call_with_zeros(*it, 0, None) != FATAL);
            }
        }
    }
}

/// What a host does.
#[derive(Debug, Clone, Copy)]
enum Act {
    SetClocks([u32; 2], [u8; 2]),
    Set(u32, f64),
    Evaluate,
    Ask(u32),
    Interval(u32),
    SetInterval(u32, f64),
    Update,
    Enter,
    Leave,
    Activate(u32, u8),
}

/// Does something; what it returns.
fn act(f: Fmu, act: Act) -> (Status, Vec<f64>) {
    let numbers = |status, numbers: &[f64]| (status, numbers.to_vec());
    match act {
        Act::SetClocks(clocks, values) => (f.set_clocks(&clocks, &values), Vec::new()),
        Act::Set(reference, value) => (f.set(reference, value), Vec::new()),
        Act::Evaluate => (f.evaluate(), Vec::new()),
        Act::Ask(reference) if reference <= SENT => {
            let mut active = [7];
            numbers(f.get_clocks(&[reference], &mut active), &[f64::from(active[0])])
        }
        Act::Ask(reference) => {
            let of = if [TICKS, ACTIVE].contains(&reference) { Type::Int32 } else { Type::Float64 };
            f.get_all(of, &[reference], 1)
        }
        Act::Interval(clock) => {
            let (mut interval, mut qualifier) = ([0.0], [7]);
            let status = f.get_intervals(&[clock], &mut interval, &mut qualifier);
            numbers(status, &[interval[0], f64::from(qualifier[0])])
        }
        Act::SetInterval(clock, value) => (f.set_intervals(&[clock], &[value]), Vec::new()),
        Act::Update => (f.try_update().0, Vec::new()),
        Act::Enter => (f.enter_event_mode(), Vec::new()),
        Act::Leave => (f.try_end_event_mode(), Vec::new()),
        Act::Activate(clock, time) => (f.activate(clock as c_int, f64::from(time)), Vec::new()),
    }
}

fn acts() -> impl Strategy<Value = Vec<Act>> {
    let clock = || 0..=SENT + 1;
    let value = || prop_oneof![Just(0.0), Just(0.5), Just(-1.0), Just(f64::NAN), 0.0..3.0];
    let set = prop_oneof![Just(MESSAGE), Just(OFFSET), Just(PERIOD), Just(INTERVAL), Just(COUNT)];
    let asked = prop_oneof![clock(), SUM..=AT];
    let one = prop_oneof![
        4 => (clock(), clock(), 0..3u8, 0..2u8).prop_map(|(a, b, c, d)| Act::SetClocks([a, b], [c, d])),
        2 => (clock(), 0..2u8).prop_map(|(clock, value)| Act::SetClocks([clock; 2], [value; 2])),
        3 => (set, value()).prop_map(|(reference, value)| Act::Set(reference, value)),
        1 => Just(Act::Evaluate),
        4 => asked.prop_map(Act::Ask),
        3 => clock().prop_map(Act::Interval),
        1 => (clock(), value()).prop_map(|(clock, value)| Act::SetInterval(clock, value)),
        2 => Just(Act::Update),
        2 => Just(Act::Enter),
        1 => Just(Act::Leave),
        3 => (clock(), 0..9u8).prop_map(|(clock, time)| Act::Activate(clock, time)),
    ];
    vec(one, 0..40)
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 100, failure_persistence: None, ..ProptestConfig::default()
    })]

    #[test]
    fn saving_and_restoring_between_calls_changes_nothing(acts in acts()) {
        for kind in [EVENTS, EXCHANGED[1], SCHEDULED] {
            let (it, mut restored) = (started(kind), started(kind));
            for one in &acts {
                let bytes = restored.snapshot();
                restored = new(kind, NODE);
                restored.resume(&bytes);
                let found = act(*restored, *one);
                let expected = act(*it, *one);
                prop_assert_eq!(found.0, expected.0, "{:?}: {:?}", one, it.messages().pop());
                let is_same = found.1.iter().zip(&expected.1).all(|(a, b)| a.to_bits() == b.to_bits());
                prop_assert!(found.0 != OK || is_same, "{:?}: {:?}", one, (found, expected));
            }
        }
    }
}
