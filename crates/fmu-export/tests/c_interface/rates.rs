//! Models with several sample times.

use std::ffi::CString;

use fmu_description::Type;
use fmu_export::prelude::*;
use fmu_export::testing::Driver;
use fmu_export::{Entry, interface};

use crate::driver::*;
use crate::models::{DISCARD, REFUSE, fail};

/// Remembers its last ticks
#[derive(Model)]
#[model(rates(slow = self.ts, fast = 0.25))]
#[rustfmt::skip]
struct Cascade {
    /** sample time of the slow rate */ #[parameter(start = 0.5, unit = "s")] ts: f64,
    /** number of the tick that fails */ #[parameter(tunable)] fails_at: i32,
    /** how it fails */ #[parameter(tunable)] failure: f64,
    /** number of ticks */ #[output] count: i32,
    /** times of the last ticks, to which the slow ones add 100 */ #[output] last: [f64; 4],
    /** sample times at these ticks */ #[output] steps: [f64; 4],
}

const TS: u32 = 0;
const FAILS_AT: u32 = 1;
const FAILURE: u32 = 2;
const COUNT: u32 = 3;
const LAST: u32 = 4;

impl Cascade {
    fn slow(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        self.tick(100.0 + time, step)
    }

    fn fast(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        self.tick(time, step)
    }

    fn tick(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        if self.count + 1 == self.fails_at {
            fail(self.failure)?;
        }
        self.count += 1;
        self.last = [self.last[1], self.last[2], self.last[3], time];
        self.steps = [self.steps[1], self.steps[2], self.steps[3], step];
        self.ts = 7.0; // the sample time stays the same until the next initialization
        Ok(())
    }
}

impl MultiRate for Cascade {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        self.steps = [self.ts; 4];
        Ok(())
    }
}

const N: usize = <Cascade as Variables>::COUNT;
static RATES: [Entry; 1] = [Entry::new::<Cascade, N>(interface::<Cascade, N>(None), &[])];

fn new(kind: Kind, early_return: bool) -> Instance {
    let token = Some(CString::new(RATES[0].guid()).unwrap());
    let arguments = Arguments::new(kind, 0);
    arguments.make(|a| (a.models, a.token, a.early_return) = (&RATES, token, early_return))
}

/// The number of ticks, and the last ones.
fn ticks(f: &Instance) -> (f64, Vec<f64>) {
    let [count] = f.read(Type::Int32, [COUNT]);
    let n = if f.kind.0 == Fmi2 { 4 } else { 1 };
    let references: Vec<u32> = (LAST..).take(n).collect();
    (count, f.get_all(Type::Float64, &references, 4).1)
}

/// The ticks before a time, or at it, too.
fn expected(end: f64, includes_end: bool) -> (f64, Vec<f64>) {
    let mut all = vec![0.0; 4];
    for k in 0.. {
        let time = f64::from(k) * 0.25;
        if time > end || time == end && !includes_end {
            break;
        }
        all.extend((k % 2 == 0).then_some(100.0 + time));
        all.push(time);
    }
    ((all.len() - 4) as f64, all.split_off(all.len() - 4))
}

#[test]
fn rates_tick_in_order_whatever_the_communication_step() {
    for kind in PLAIN {
        for (steps, size) in [(1, 0.25), (16, 0.125), (5, 0.75), (1, 2.5), (9, 0.5)] {
            let it = new(kind, false).run(0.0);
            assert_eq!(ticks(&it).0, 0.0, "none at the initialization");
            (0..steps).for_each(|k| _ = it.steps(f64::from(k) * size, size));
            assert_eq!(ticks(&it), expected(f64::from(steps) * size, false), "{steps} of {size} s");
        }
        let late = new(kind, false).run(1.0);
        late.steps(1.0, 0.5);
        assert_eq!(ticks(&late).1, [0.0, 101.0, 1.0, 1.25], "from the start time");
    }
}

#[test]
fn a_saved_state_continues_with_all_clocks() {
    for kind in PLAIN {
        let it = new(kind, false).run(0.0);
        it.steps(0.0, 0.3);
        let bytes = it.snapshot();
        it.steps(0.3, 1.0);
        for it in [it, new(kind, false)] {
            it.resume(&bytes).steps(0.3, 0.1);
            assert_eq!(ticks(&it), expected(0.4, false), "no instant in this step");
            it.steps(0.4, 0.7);
            assert_eq!(ticks(&it), expected(1.1, false));
            ok([it.reset()]);
            it.run(0.0).steps(0.0, 0.5);
        }
    }
}

#[test]
fn failures_of_a_tick_and_of_a_sample_time() {
    for kind in PLAIN {
        let fails = |f: Fmu, number: i32, how: f64| {
            ok([f.set_i32(&[FAILS_AT], &[number]), f.set(FAILURE, how)]);
        };
        // In the first tick of a step, nothing is changed.
        let it = new(kind, false).run(0.0);
        fails(*it, 1, REFUSE);
        it.refuses("from t = 0.0 s by 0.5 s: refused by the model", |f| f.step(0.0, 0.5));
        fails(*it, 0, REFUSE);
        let before = it.snapshot();
        it.fails(DISCARDED, "sample instants, more than the maximum", |f| f.step(0.0, 1e9));
        it.resume(&before).steps(0.0, 0.5);
        assert_eq!(ticks(&it), expected(0.5, false));
        fails(*it, 4, DISCARD);
        let before = it.snapshot();
        assert_eq!(it.step(0.5, 0.25), DISCARDED);
        fails(it.resume(&before), 0, DISCARD);
        it.steps(0.5, 0.25);
        assert_eq!(ticks(&it), expected(0.75, false));
        // A later one breaks the instance.
        fails(*it, 7, DISCARD);
        assert_eq!(it.step(0.75, 0.75), ERROR);
        it.refuses("\"error\"", |f| f.step(0.75, 0.75));
        let it = new(kind, false);
        ok([it.set(TS, -0.5), it.enter(0.0, None, None)]);
        let words = "the sample time of slow is -0.5 s; expected a positive number";
        it.refuses(words, Fmu::exit_initialization_mode);
        ok([it.set(TS, 0.5), it.exit_initialization_mode()]);
        it.steps(0.0, 0.5);
        assert_eq!(ticks(&it), expected(0.5, false));
    }
}

#[test]
fn in_event_mode_all_that_is_due_at_an_instant_is_one_event() {
    let early = new(EVENTS, true).run(0.0);
    assert_eq!(ticks(&early), expected(0.0, true), "the samples at the start");
    let mut time = 0.0;
    for k in 1..40 {
        let instant = f64::from(k) * 0.25;
        assert_eq!(early.steps(time, 0.7), results(true, true, instant));
        ok([early.enter_event_mode()]);
        assert_eq!(early.update(), (false, Some(instant + 0.25)));
        assert_eq!(ticks(&early), expected(instant, true));
        early.end_event_mode();
        time = instant;
    }
    // Without early return, samples wait for the end of the step.
    let late = new(EVENTS, false).run(0.0);
    assert_eq!(late.steps(0.0, 0.7), results(true, false, 0.7));
    assert_eq!(ticks(&late), expected(0.0, true), "nothing changes in a step");
    ok([late.enter_event_mode()]);
    assert_eq!(late.update(), (false, Some(0.75)));
    assert_eq!(ticks(&late), expected(0.7, true));
    let late = new(EVENTS, false).run(0.0);
    late.fails(DISCARDED, "more than the maximum", |f| f.step(0.0, 1e9));
}

#[test]
fn in_model_exchange_all_that_is_due_at_an_instant_is_one_event() {
    for kind in EXCHANGED {
        let it = new(kind, false);
        it.start(0.0, None);
        for k in 0..100 {
            let (now, jitter) = (f64::from(k) * 0.25, if k % 2 == 0 { 1e-9 } else { -1e-9 });
            ok([it.set_time(now + jitter)]);
            assert_eq!([it.update(), it.update()], [(false, Some(now + 0.25)); 2]);
            assert_eq!(ticks(&it), expected(now, true), "once");
            ok([it.set_time(now + 0.125)]);
            assert_eq!(it.update(), (false, Some(now + 0.25)), "not due");
        }
    }
}

#[test]
fn each_rate_has_the_sample_time_of_the_initialization() {
    let mut cascade = Driver::<Cascade>::new();
    cascade.ts = 1.0;
    cascade.step(1.25).unwrap();
    assert_eq!(cascade.last, [0.5, 0.75, 101.0, 1.0]);
    assert_eq!(cascade.steps, [0.25, 0.25, 1.0, 0.25]);
}
