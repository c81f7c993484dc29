//! Events that inputs and parameters cause: the same trajectories at each edge, in each kind and in a [`Driver`].

use std::fmt::Debug;

use fmu_description::Type;
use fmu_export::testing::{Driver, Value};
use ode_methods::solver::{self, DormandPrince, Events as Handled, OdeSystem, Workspace};

use crate::driver::*;
use crate::models::*;

const H: f64 = 0.5;
const STEPS: usize = 12;

/// What a host sets at communication points: number of the step, reference, type and value.
type Change = (usize, u32, Type, f64);

/// Steps an instance, and returns outputs of type Float64 and Int32 at the communication points.
fn trajectory(
    it: &Instance,
    changes: &[Change],
    (reals, whole): (&[u32], &[u32]),
) -> Vec<Vec<f64>> {
    let mut host = Host::new(it);
    (0..=STEPS)
        .map(|k| {
            if k > 0 {
                host.step((k - 1) as f64 * H, changes.iter().filter(|change| change.0 == k - 1));
            }
            let mut row = it.get_all(Type::Float64, reals, reals.len()).1;
            row.extend(it.get_all(Type::Int32, whole, whole.len()).1);
            row
        })
        .collect()
}

/// A host that sets the continuous input of [`Relay`] between events, and all else in events.
struct Host {
    f: Fmu,
    next: Option<f64>,
    handled: f64,
    restarts: bool,
    indicators: Vec<f64>,
    workspace: Workspace,
}

impl Host {
    fn new(it: &Instance) -> Self {
        it.start(0.0, None);
        let mut next = None;
        if it.kind.1 != Stepped {
            next = it.update().1;
            it.end_event_mode();
        }
        let f = **it;
        let mut indicators = Vec::new();
        if f.kind.1 == Exchanged {
            // FMI 2.0 has their number in the model description only.
            while f.get_indicators(&mut indicators) != OK {
                indicators.push(0.0);
            }
        }
        let workspace = Workspace::new(1, indicators.len());
        Self { f, next, handled: 0.0, restarts: false, indicators, workspace }
    }

    fn step<'a>(&mut self, time: f64, changes: impl Iterator<Item = &'a Change>) {
        let (continuous, discrete): (Vec<_>, Vec<_>) =
            changes.partition(|change| change.1 == Relay::LEVEL && change.2 == Type::Float64);
        let set = |(_, reference, of, value): &Change| {
            ok([self.f.set_all(*of, &[*reference], &[*value])]);
        };
        continuous.into_iter().for_each(set);
        let is_event = !discrete.is_empty() && self.f.kind.1 != Stepped;
        if is_event {
            ok([self.f.enter_event_mode()]);
        }
        discrete.into_iter().for_each(set);
        if is_event {
            self.next = self.f.update().1;
            self.f.end_event_mode();
        }
        match self.f.kind.1 {
            Stepped => _ = self.f.steps(time, H),
            Events => {
                let mut now = time;
                while now < time + H - 1e-9 {
                    let results = self.f.steps(now, time + H - now);
                    now = results.time;
                    if results.event {
                        ok([self.f.enter_event_mode()]);
                        self.f.update();
                        self.f.end_event_mode();
                    }
                }
            }
            Exchanged => {
                let mut workspace = std::mem::take(&mut self.workspace);
                let step = solver::Step {
                    time,
                    size: H,
                    tolerance: 1e-6,
                    longest: H,
                    events: Handled::Here,
                    handled: self.handled,
                    event: None,
                    restarts: self.restarts,
                };
                let advanced =
                    solver::advance::<DormandPrince, _>(self, &mut workspace, &step).unwrap();
                (self.handled, self.restarts) = (advanced.handled, advanced.restarts);
                self.workspace = workspace;
            }
            Scheduled => unreachable!(),
        }
    }
}

#[derive(Debug)]
struct Failed;

impl solver::SolverError for Failed {
    fn discard(_: std::fmt::Arguments<'_>) -> Self {
        Self
    }

    fn is_discarded(&self) -> bool {
        false
    }

    fn with_prefix(self, _: std::fmt::Arguments<'_>) -> Self {
        self
    }
}

impl OdeSystem for Host {
    type Error = Failed;

    fn nominal(&self, _state: usize) -> f64 {
        1.0
    }

    fn states(&mut self, states: &mut [f64]) -> Result<(), Failed> {
        ok([self.f.get_states(states)]);
        Ok(())
    }

    fn evaluate(&mut self, time: f64, states: &[f64]) -> Result<bool, Failed> {
        ok([self.f.set_time(time), self.f.set_states(states)]);
        ok([self.f.get_indicators(&mut self.indicators)]);
        Ok(true)
    }

    fn derivatives(&mut self, derivatives: &mut [f64]) {
        ok([self.f.get_derivatives(derivatives)]);
    }

    fn event_indicator(&mut self, indicator: usize) -> f64 {
        self.indicators[indicator]
    }

    fn not_finite(&mut self) -> Failed {
        Failed
    }

    fn event(&mut self, time: f64) -> Result<(), Failed> {
        ok([self.f.set_time(time), self.f.enter_event_mode()]);
        self.next = self.f.update().1;
        self.f.end_event_mode();
        Ok(())
    }

    fn next_event(&self, _time: f64) -> Option<f64> {
        self.next
    }
}

/// The same by a driver.
fn driven<M: fmu_export::testing::Drive>(
    changes: &[Change],
    set: impl Fn(&mut Driver<M>, &Change),
) -> Vec<Vec<f64>> {
    let mut driver = Driver::<M>::new();
    driver.initialize(0.0).unwrap();
    let mut rows = vec![driver.outputs()];
    for k in 0..STEPS {
        changes.iter().filter(|change| change.0 == k).for_each(|change| set(&mut driver, change));
        driver.step(H).unwrap();
        rows.push(driver.outputs());
    }
    rows
}

#[track_caller]
fn all_near(found: &[Vec<f64>], expected: &[Vec<f64>], what: impl Debug) {
    for (k, (found, expected)) in found.iter().zip(expected).enumerate() {
        let is_near = found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-8);
        assert!(is_near, "{what:?}, row {k}: {found:?}, expected {expected:?}");
    }
}

// --- a continuous input -------------------------------------------------------------------------

/// The level of [`Relay`] in closed form: it rises or falls by 1/s, and switches 0.25 from the set-point.
fn relay(changes: &[Change]) -> Vec<Vec<f64>> {
    let (mut x, mut on, mut count, mut level) = (0.0, false, 0.0, 0.0);
    let mut switch = |x: f64, on: &mut bool, level: f64| {
        let was_on = std::mem::replace(on, if *on { x < level + 0.25 } else { x <= level - 0.25 });
        count += f64::from(u8::from(was_on != *on));
        count
    };
    switch(x, &mut on, level);
    let mut rows = vec![vec![x, 0.0]];
    for k in 0..STEPS {
        let mut set = changes.iter().filter(|change| change.0 == k);
        level = set.next_back().map_or(level, |change| change.3);
        let (mut rest, mut n) = (H, switch(x, &mut on, level));
        loop {
            let to = if on { level + 0.25 } else { level - 0.25 };
            let until = if on { to - x } else { x - to };
            let slope = if on { 1.0 } else { -1.0 };
            if until > rest {
                x += slope * rest;
                break;
            }
            (x, rest) = (to, rest - until);
            n = switch(x, &mut on, level);
        }
        rows.push(vec![x, n]);
    }
    rows
}

#[test]
fn a_jump_of_a_continuous_input_over_a_threshold_is_an_event_in_each_kind() {
    let u = |k, value| (k, Relay::LEVEL, Type::Float64, value);
    let alternating = Vec::from_iter((0..STEPS).map(|k| u(k, [2.1, -2.2][k % 2])));
    for changes in [
        &[u(3, 2.0), u(8, -1.0)][..],       // jumps
        &[u(0, 2.0)],                       // once after the initialization
        &[u(3, 2.0), u(3, 0.1), u(5, 0.1)], // to and fro between two steps
        &alternating,
    ] {
        let expected = relay(changes);
        for kind in KINDS {
            let it = Arguments::new(kind, RELAY).make(|a| a.early_return = true);
            let found = trajectory(&it, changes, (&[Relay::X], &[Relay::SWITCHES]));
            all_near(&found, &expected, (kind, changes));
        }
        let found = driven::<Relay>(changes, |relay, change| relay.level = change.3);
        all_near(&found, &expected, changes);
    }
}

#[test]
fn the_sign_of_an_event_indicator_before_new_inputs_is_saved() {
    for kind in PLAIN {
        let (it, other) = (Instance::running(kind, RELAY), Instance::running(kind, RELAY));
        it.steps(0.0, 0.1);
        ok([it.set(Relay::LEVEL, 2.0)]);
        let bytes = it.snapshot();
        for it in [*it, other.resume(&bytes)] {
            it.steps(0.1, 0.5);
            near(it.get([Relay::X]), [0.4], 1e-8);
        }
    }
}

#[test]
fn inputs_of_an_intermediate_update_cause_events() {
    let arguments = Arguments::new(PLAIN[1], RELAY);
    let it = arguments.make(|a| a.intermediate = Some(&[Relay::LEVEL])).run(0.0);
    it.on_update(|f, update| {
        if (update.time - 0.2).abs() < 1e-9 {
            ok([f.set(Relay::LEVEL, 2.0)]);
        }
        None
    });
    it.steps(0.0, 0.5);
    near(it.get([Relay::X]), [-0.2 + 0.3], 1e-8);
    assert_eq!(it.read(Type::Int32, [Relay::SWITCHES]), [1.0]);
}

#[test]
fn an_instance_is_not_freed_in_its_intermediate_update() {
    let it = Arguments::new(PLAIN[1], RELAY).make(|a| a.intermediate = Some(&[])).run(0.0);
    it.on_update(|f, _| {
        f.free();
        None
    });
    let other = Instance::running(PLAIN[1], RELAY);
    it.steps(0.0, 0.5);
    other.steps(0.0, 0.5);
    near(it.get([Relay::X]), other.get([Relay::X]), 1e-8);
}

// --- discrete inputs and tunable parameters -----------------------------------------------------

/// What [`Switches`] counts.
fn switches(changes: &[Change]) -> Vec<Vec<f64>> {
    let (mut x, mut on, mut seen) = (0.0, false, [0.0, 0.0, 0.0, 12.0, 1.0, 2.0]);
    let mut values = seen;
    let mut count = 0.0;
    let mut rows = vec![vec![0.0; 2]];
    for k in 0..STEPS {
        for (_, reference, _, value) in changes.iter().filter(|change| change.0 == k) {
            let all = [Switches::ON, Switches::GEAR, Switches::W, Switches::TEXT];
            let all = [all[0], all[1], all[2], all[3], Switches::LAW, Switches::LIMIT];
            values[all.iter().position(|it| it == reference).unwrap()] = *value;
        }
        if values != seen {
            count += 1.0;
            // A state jumps when it is switched on.
            if values[0] == 1.0 && !on {
                x = 10.0;
            }
            (on, seen) = (values[0] == 1.0, values);
        }
        x += if on { H * values[5] } else { 0.0 };
        rows.push(vec![x, count]);
    }
    rows
}

#[test]
fn a_new_value_of_a_discrete_input_or_tunable_parameter_is_an_event_in_each_kind() {
    use Type::*;
    let on = |k, value| (k, Switches::ON, Boolean, value);
    let alternating = Vec::from_iter((0..STEPS).map(|k| on(k, [1.0, 0.0][k % 2])));
    let each = [
        on(0, 1.0), // once after the initialization
        (1, Switches::GEAR, Int32, 3.0),
        (2, Switches::W, Float64, 0.5),
        (3, Switches::TEXT, String, 7.0),
        (4, Switches::LAW, Enumeration, 2.0),
        (5, Switches::LIMIT, Float64, 3.0),
        (6, Switches::GEAR, Int32, 3.0), // the same value
        (7, Switches::W, Float64, 0.25),
        (7, Switches::ON, Boolean, 0.0),
    ];
    for changes in [&each[..], &[on(5, 1.0)], &alternating] {
        let expected = switches(changes);
        for kind in KINDS {
            let it = Arguments::new(kind, SWITCHES).make(|a| a.early_return = true);
            let found = trajectory(&it, changes, (&[Switches::X], &[Switches::CHANGES]));
            all_near(&found, &expected, (kind, changes));
        }
        let found = driven::<Switches>(changes, |driver, (_, reference, of, value)| {
            let name = ["on", "gear", "w", "text", "law", "limit"][*reference as usize];
            let value = match of {
                String => Value::String(value.to_string()),
                Float64 => Value::Float64(*value),
                Boolean => Value::Boolean(*value == 1.0),
                _ => Value::Int32(*value as i32),
            };
            driver.set(name, value).unwrap();
        });
        all_near(&found, &expected, changes);
        // In a test, also by the fields.
        if changes.len() > 1 && changes[1].1 == Switches::ON {
            let found = driven::<Switches>(changes, |driver, change| driver.on = change.3 == 1.0);
            all_near(&found, &expected, changes);
        }
    }
    for kind in PLAIN {
        let it = Instance::running(kind, SWITCHES);
        let set = |value| it.set_all(Boolean, &[Switches::ON], &[value]);
        ok([set(1.0), set(0.0)]);
        it.steps(0.0, H);
        assert_eq!(it.read(Int32, [Switches::CHANGES]), [0.0], "the value is the same again");
        // The values of the step before belong to the state.
        ok([set(1.0)]);
        let other = Instance::running(kind, SWITCHES).resume(&it.snapshot()).steps(H, H);
        assert_eq!((other, it.steps(H, H)), (results(false, false, 2.0 * H), other));
        assert_eq!(it.read(Int32, [Switches::CHANGES]), [1.0]);
    }
}

// --- events that need not be --------------------------------------------------------------------

#[test]
fn event_mode_without_need_changes_no_bit() {
    for (model, references) in [(HOPPER, [Hopper::H, Hopper::V]), (RELAY, [Relay::X, Relay::X])] {
        let run = |enters: bool| {
            let it = Arguments::new(EVENTS, model).make(|a| a.early_return = true).run(0.0);
            let mut rows = Vec::new();
            for k in 0..30 {
                let (mut now, end) = (f64::from(k) * 0.1, f64::from(k + 1) * 0.1);
                while now < end - 1e-9 {
                    let results = it.steps(now, end - now);
                    now = results.time;
                    if results.event || enters {
                        ok([it.enter_event_mode()]);
                        it.update();
                        it.end_event_mode();
                    }
                }
                rows.push(it.get(references).map(f64::to_bits));
            }
            rows
        };
        assert_eq!(run(false), run(true));
    }
}
