//! Scheduled execution of models with sample times: FMI 3.0.2, section 5.

use std::ffi::CString;
use std::sync::Barrier;
use std::thread;

use fmu_description::{Interface, Type};
use fmu_export::prelude::*;
use fmu_export::{Entry, interface};

use crate::driver::*;
use crate::models::{BREAK, BUG, DISCARD, DIVERGE, REFUSE, fail};

/// Sums what it is given
#[derive(Model)]
#[model(sample_time = self.ts)]
#[rustfmt::skip]
struct Sum {
    /** given */ #[input] u: f64,
    /** sample time */ #[parameter(start = 0.1, unit = "s")] ts: f64,
    /** how the next sample fails */ #[parameter(tunable)] trouble: f64,
    /** sum */ #[output] y: f64,
    /** time of the sample */ #[output] at: f64,
    /** number of gains */ #[structural_parameter(start = 2, max = 3, tunable)] n: u64,
    /** gains */ #[parameter(start = 1, size = n)] gains: [f64; 3],
}

impl Simulate for Sum {
    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        if self.trouble == BUG {
            WAIT.wait(); // until the other call has been refused
            WAIT.wait();
            return Ok(());
        }
        fail(self.trouble)?;
        self.y += step * self.u + if self.trouble == DIVERGE { f64::INFINITY } else { 0.0 };
        self.at = time;
        Ok(())
    }
}

static WAIT: Barrier = Barrier::new(2);

const U: u32 = 0;
const TS: u32 = 1;
const TROUBLE: u32 = 2;
const Y: u32 = 3;
const AT: u32 = 4;
const TIME: u32 = 9;
const CLOCK: i32 = 10;

/// Remembers what ticked last
#[derive(Model)]
#[model(rates(slow = 0.5, fast = self.ts))]
#[rustfmt::skip]
struct Cascade {
    /** sample time of the fast rate */ #[parameter(start = 0.25, unit = "s")] ts: f64,
    /** digits of the rates that have ticked */ #[output] ticks: f64,
    /** a number of its own */ #[input(reference = 40)] fixed: f64,
}

impl Cascade {
    fn slow(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.ticks = 10.0 * self.ticks + 1.0;
        Ok(())
    }

    fn fast(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.ticks = 10.0 * self.ticks + 2.0;
        Ok(())
    }
}

impl MultiRate for Cascade {}

const N: usize = fmu_export::table_size::<Sum>();
const M: usize = fmu_export::table_size::<Cascade>();
const SUM: Interface = Interface { sample_clocks: &["sample"], ..interface::<Sum, N>(None) };
const CASCADE: Interface =
    Interface { sample_clocks: &["slow", "fast"], ..interface::<Cascade, M>(None) };
static MODELS: [Entry; 2] =
    [Entry::new::<Sum, N>(SUM, &[]), Entry::new::<Cascade, M>(CASCADE, &[])];
/// The same model in co-simulation.
static STEPPED: [Entry; 1] = [Entry::new::<Sum, N>(interface::<Sum, N>(None), &[])];

fn new(model: usize) -> Instance {
    let token = Some(CString::new(MODELS[model].guid()).unwrap());
    Arguments::new(SCHEDULED, 0).make(|a| (a.models, a.token) = (&MODELS, token))
}

fn stepped() -> Instance {
    let token = Some(CString::new(STEPPED[0].guid()).unwrap());
    Arguments::new(PLAIN[1], 0).make(|a| (a.models, a.token) = (&STEPPED, token))
}

#[test]
fn activations_compute_the_samples_of_co_simulation() {
    let (it, other) = (new(0).run(0.0), stepped().run(0.0));
    let mut accumulated = 0.0;
    for k in 0..100 {
        let u = f64::from(k).sin();
        ok([it.set(U, u), it.activate(CLOCK, accumulated)]);
        ok([other.set(U, u)]);
        other.steps(f64::from(k) * 0.1, 0.1);
        assert_eq!(it.get([Y, AT]).map(f64::to_bits), other.get([Y, AT]).map(f64::to_bits), "{k}");
        assert_eq!(it.get([TIME]), [accumulated], "the time is the host's");
        accumulated += 0.1;
    }
}

#[test]
fn each_rate_has_a_clock() {
    let it = new(1);
    ok([it.set(0, 0.125), it.enter(2.0, Some(3.0), None)]);
    let clocks = [41, 42];
    let intervals = |qualifier| {
        let (mut intervals, mut qualifiers) = ([f64::NAN; 2], [7; 2]);
        ok([it.get_intervals(&clocks, &mut intervals, &mut qualifiers)]);
        assert_eq!((intervals, qualifiers), ([0.5, 0.125], [qualifier; 2]));
    };
    intervals(2);
    let mut shifts = [f64::NAN; 2];
    ok([it.get_shifts(&clocks, &mut shifts)]);
    assert_eq!(shifts, [0.0; 2]);
    it.fails(ERROR, "supportsFraction is false", |f| {
        f.get_interval_fractions(&clocks, &mut [0; 2], &mut [0; 2], &mut [0; 2])
    });
    ok([it.exit_initialization_mode()]);
    intervals(1);
    ok([it.activate(41, 2.0), it.activate(42, 2.0), it.activate(42, 2.125)]);
    let bytes = it.snapshot();
    ok([it.activate(42, 2.25), it.activate(41, 2.5)]);
    assert_eq!(it.get([1]), [12221.0]);
    it.resume(&bytes);
    ok([it.activate(42, 2.25)]);
    assert_eq!(it.get([1]), [1222.0]);
    it.refuses("value reference 43 is not a clock; expected 41 to 42", |f| f.activate(43, 2.5));
    ok([it.terminate()]);
}

#[test]
fn a_clock_ticks_only_at_its_instants_and_once() {
    let it = new(0);
    ok([it.enter(0.0, Some(1.0), None)]);
    let (mut interval, mut qualifier) = ([f64::NAN], [7]);
    ok([it.set(TS, 0.25), it.get_intervals(&[10], &mut interval, &mut qualifier)]);
    assert_eq!((interval, qualifier), ([0.25], [2]), "of the parameter that is set");
    it.fails(ERROR, "is not allowed in the state \"initialization mode\"", |f| {
        f.activate(CLOCK, 0.0)
    });
    ok([it.exit_initialization_mode(), it.activate(CLOCK, 1e-8)]);
    let words = "the clock cannot tick at 1e-8 s; expected 0.25 s, or later by a multiple of its interval 0.25 s";
    it.refuses(words, |f| f.activate(CLOCK, 1e-8));
    it.refuses("cannot tick at 0.3 s", |f| f.activate(CLOCK, 0.3));
    it.refuses("cannot tick at -0.25 s", |f| f.activate(CLOCK, -0.25));
    it.refuses("the activation time is NaN; expected a finite number", |f| {
        f.activate(CLOCK, f64::NAN)
    });
    it.refuses("past the stop time 1.0", |f| f.activate(CLOCK, 1.25));
    it.refuses("value reference 0 is not a clock; expected 10", |f| f.activate(0, 0.25));
    it.forget_messages();
    ok([it.activate(CLOCK, 0.5)]);
    it.says("a tick of a periodic clock is left out, which the standard does not allow");
    assert_eq!(it.get([AT]), [0.5]);
    ok([it.activate(CLOCK, 1.0)]);
    let bad = new(0);
    ok([bad.set(TS, 0.0), bad.enter(0.0, None, None)]);
    bad.fails(ERROR, "the sample time is 0 s; expected a positive number", |f| {
        f.get_intervals(&[10], &mut [0.0], &mut [0])
    });
    bad.fails(ERROR, "the sample time is 0 s", |f| f.exit_initialization_mode());
}

#[test]
fn a_failed_sample_is_an_error() {
    for (trouble, words) in
        [(DISCARD, "at t = 0.1 s: "), (REFUSE, "at t = 0.1 s: refused by the model")]
    {
        let it = new(0).run(0.0);
        ok([it.activate(CLOCK, 0.0), it.set(TROUBLE, trouble)]);
        it.refuses(words, |f| f.activate(CLOCK, 0.1));
        ok([it.set(TROUBLE, 0.0), it.activate(CLOCK, 0.1)]);
    }
    for (trouble, words) in
        [(BREAK, "at t = 0.0 s: broken"), (DIVERGE, "at t = 0.0 s: y became inf")]
    {
        let it = new(0).run(0.0);
        ok([it.set(TROUBLE, trouble)]);
        it.fails(ERROR, words, |f| f.activate(CLOCK, 0.0));
        it.fails(ERROR, "is not allowed in the state \"error\"", |f| f.activate(CLOCK, 0.1));
        ok([it.reset()]);
        it.start(0.0, None);
        ok([it.activate(CLOCK, 0.0)]);
    }
}

#[test]
fn an_instance_has_the_functions_of_its_interface_type() {
    let it = new(0).run(0.0);
    it.refuses(
        "it is a function of co-simulation, but the instance is for scheduled execution",
        |f| f.step(0.0, 0.1),
    );
    it.refuses("it is a function of model exchange, but the instance is", |f| f.set_time(0.0));
    it.refuses("it is a function of event mode, but the instance is", |f| f.enter_event_mode());
    it.refuses("not allowed in the state \"clock activation mode\"", |f| {
        f.exit_initialization_mode()
    });
    ok([it.enter_configuration_mode(), it.set_u64(&[5], &[3])]);
    it.refuses("not allowed in the state \"reconfiguration mode\"", |f| f.activate(CLOCK, 0.0));
    ok([it.exit_configuration_mode(), it.activate(CLOCK, 0.0)]);
    let other = stepped().run(0.0);
    other.refuses("the FMU is not for scheduled execution", |f| f.activate(CLOCK, 0.0));
    other.refuses("the model has no clocks", |f| f.get_shifts(&[10], &mut [0.0]));
    for (kind, models, words) in [
        (
            SCHEDULED,
            &STEPPED[..],
            "fmi3InstantiateScheduledExecution: the FMU is not for scheduled execution",
        ),
        (PLAIN[1], &MODELS[..1], "Sum is for scheduled execution, not for co-simulation"),
        ((Fmi3, Exchanged), &MODELS[..1], "Sum is for scheduled execution, not for model exchange"),
    ] {
        let token = Some(CString::new(models[0].guid()).unwrap());
        let it = Arguments::new(kind, 0).make(|a| (a.models, a.token) = (models, token));
        assert!(it.c.is_null());
        it.says(words);
    }
    assert_ne!(MODELS[0].guid(), STEPPED[0].guid());
}

#[test]
fn each_call_locks_preemption_and_a_host_that_ignores_the_locks_gets_an_error() {
    LOCKS.set([0; 2]);
    let it = new(0).run(0.0);
    ok([it.set(U, 1.0), it.activate(CLOCK, 0.0)]);
    it.get([Y]);
    it.refuses("cannot tick at", |f| f.activate(CLOCK, 0.0));
    let [locked, unlocked] = LOCKS.get();
    assert!(locked > 5 && locked == unlocked, "{locked} {unlocked}");
    ok([it.set(TROUBLE, BUG)]);
    /// A pointer that the test uses on two threads.
    struct Shared(Fmu);
    // SAFETY: this is what the test is about.
    unsafe impl Send for Shared {}
    let shared = Shared(*it);
    let busy = thread::spawn(move || {
        let Shared(f) = { shared };
        f.activate(CLOCK, 0.1)
    });
    WAIT.wait();
    it.forget_messages();
    let words = "fmi3ActivateModelPartition: another call uses the instance";
    it.fails(ERROR, words, |f| f.activate(CLOCK, 0.2));
    it.fails(ERROR, "fmi3SetFloat64: another call uses the instance", |f| f.set(U, 0.0));
    it.fails(ERROR, "fmi3GetFloat64: another call uses the instance", |f| {
        f.get_f64(&[Y], &mut [0.0])
    });
    it.fails(ERROR, "fmi3Reset: another call uses the instance", |f| f.reset());
    it.free();
    WAIT.wait();
    assert_eq!(busy.join().unwrap(), OK);
    let [count] = it.read(Type::Float64, [AT]);
    assert_eq!(count, 0.0, "freeing was ignored");
}
