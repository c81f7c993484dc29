//! The summary of a run, made row by row on the worker side: the extremes and the RMS of each number, and alarms.

use std::array::from_fn;
use std::fmt;
use std::ops::Range;

use fmu_description::Type;
use serde::{Deserialize, Serialize};

use crate::simulation::Row;
use crate::store::{Place, Store, number};
use crate::{Column, Plan};

/// The values of a column over all rows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// The smallest value.
    pub min: f64,
    /// The largest value.
    pub max: f64,
    /// The root of the mean of the squares; NaN or infinite if a value is.
    pub rms: f64,
}

/// The summary of a run.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// One for each column; `None` if its values are not numbers.
    pub statistics: Vec<Option<Statistics>>,
    /// Alarms, by their kind in the order of [`Alarm`].
    pub alarms: Vec<Alarm>,
}

/// Something that is probably wrong, in one column.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// The kind of the alarm.
    pub kind: AlarmKind,
    /// The column, with numbers, such as `plant.x from t = 1.0 s`.
    pub text: String,
}

/// The kind of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum AlarmKind {
    /// A number is not finite.
    NotFinite,
    /// A value is beyond the bounds of the model description.
    BeyondBounds,
    /// The end of the run oscillates.
    Oscillating,
    /// A value moves away ever faster.
    Diverging,
}

impl Summary {
    /// A sentence for each kind of alarm, with the first columns.
    pub fn sentences(&self) -> impl Iterator<Item = String> {
        /// The number of columns that are named.
        const NAMED: usize = 3;
        self.alarms.chunk_by(|a, b| a.kind == b.kind).map(|alarms| {
            let named = alarms.iter().take(NAMED).map(|alarm| alarm.text.clone());
            let rest = alarms.len().saturating_sub(NAMED);
            let more = (rest > 0).then(|| format!("and {rest} more"));
            let (kind, named) = (alarms[0].kind, Vec::from_iter(named.chain(more)).join("; "));
            let note = match kind {
                AlarmKind::Oscillating => "; a limit cycle, unless the inputs oscillate like this",
                _ => "",
            };
            format!("{kind}: {named}{note}")
        })
    }
}

impl fmt::Display for AlarmKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotFinite => "not finite",
            Self::BeyondBounds => "beyond the bounds of the model description",
            Self::Oscillating => "oscillating in the last tenth of the run",
            Self::Diverging => "diverging",
        })
    }
}

/// Oscillations are looked for in the last tenth of the rows, in this many windows.
const WINDOWS: u64 = 10;
/// In each window, an oscillation turns at least twice, and once in this many rows.
const ROWS_PER_TURN: u64 = 50;
/// A limit cycle may pause while the set-point changes. Unless it fills all windows, it has at least this many
/// turns: after a jump of the set-point, a healthy loop may reverse direction some 30 times
/// before it settles.
const MANY_TURNS: u64 = 40;
/// The smallest range of a window, relative to the largest; an oscillation with a smaller one decays or grows.
const STEADY: f64 = 0.5;
/// The smallest oscillation that is reported, relative to the range over the run.
const VISIBLE: f64 = 1e-3;
/// A run is divided into this many parts to see what moves away ever faster.
const PARTS: usize = 10;
/// So many of the last moves must grow; at first, what grows may be hidden by what decays.
const GROWING: usize = 7;

/// Makes a summary. There is an element for each column: Float64 columns first, then columns of other types.
pub(crate) struct Summarizer<'a> {
    plan: &'a Plan,
    rows: u64,
    /// The row from which on there is more to do than the extremes.
    next: u64,
    extremes: Vec<Extremes>,
    /// Of the columns whose values are not all of the type Float64, how many values are absent, and the last number.
    absent: Vec<u64>,
    latest: Vec<f64>,
    /// The time (s) of the first value that is not finite.
    lost: Vec<Option<f64>>,
    /// The values at the start, and at the end of each part, and the row of the next ones.
    parts: Vec<Vec<f64>>,
    next_part: u64,
    steps: u64,
    /// The number of rows of a window, 0 if the run is too short, and the rows of all windows.
    window: u64,
    windows: Range<u64>,
    /// The end of the window in progress.
    end_of_window: u64,
    turns: Vec<Turns>,
}

/// The extremes of a column, and the sum of its squares.
#[derive(Clone, Copy)]
struct Extremes {
    min: f64,
    max: f64,
    squares: f64,
}

impl Extremes {
    /// Adds a value; returns the sum of the squares, which is finite if all values are.
    #[inline(always)]
    fn add(&mut self, x: f64) -> f64 {
        // Branches, as most values are no extremes.
        if x < self.min {
            self.min = x;
        }
        if x > self.max {
            self.max = x;
        }
        self.squares += x * x;
        self.squares
    }
}

/// How a column turns at the end of a run.
#[derive(Clone, Default)]
struct Turns {
    last: f64,
    rises: bool,
    /// The values in this window, as far as it goes, and the windows before it.
    now: Window,
    windows: Vec<Window>,
}

#[derive(Clone, Copy)]
struct Window {
    turns: u64,
    low: f64,
    high: f64,
}

impl Default for Window {
    fn default() -> Self {
        Self { turns: 0, low: f64::INFINITY, high: f64::NEG_INFINITY }
    }
}

impl Window {
    fn range(&self) -> f64 {
        self.high - self.low
    }
}

impl Turns {
    /// The longest oscillation with a steady range that is larger than `least`: its smallest range, and the
    /// number of rows from turn to turn. A window has this many rows.
    fn oscillation(&self, rows: u64, least: f64) -> Option<(f64, f64)> {
        let turns_enough = |window: &Window| {
            window.turns >= 2 && window.turns * ROWS_PER_TURN >= rows && window.range() > least
        };
        let count = self.windows.len();
        let spans = (0..count).flat_map(|first| (first + 1..=count).map(move |end| first..end));
        let oscillations = spans.filter_map(|span| {
            let windows = &self.windows[span];
            let smallest = windows.iter().map(Window::range).fold(f64::INFINITY, f64::min);
            let largest = windows.iter().map(Window::range).fold(0.0, f64::max);
            let turns: u64 = windows.iter().map(|window| window.turns).sum();
            let is_long = turns >= MANY_TURNS || windows.len() as u64 == WINDOWS;
            let is_steady = windows.iter().all(turns_enough) && smallest >= STEADY * largest;
            let per_turn = (windows.len() as u64 * rows) as f64 / turns as f64;
            (is_long && is_steady).then_some((turns, smallest, per_turn))
        });
        let (_, range, per_turn) = oscillations.max_by_key(|(turns, ..)| *turns)?;
        Some((range, per_turn))
    }
}

impl<'a> Summarizer<'a> {
    pub(crate) fn new(plan: &'a Plan) -> Self {
        let count = plan.columns.len();
        // Checked when the plan was made.
        let steps = plan.experiment.steps().unwrap_or(0) - plan.first();
        let none = Extremes { min: f64::INFINITY, max: f64::NEG_INFINITY, squares: 0.0 };
        let others = plan.columns.iter().filter(|column| !column.is_real()).count();
        let window = steps / 10 / WINDOWS;
        Self {
            plan,
            rows: 0,
            next: 0,
            extremes: vec![none; count],
            absent: vec![0; others],
            latest: vec![0.0; others],
            lost: vec![None; count],
            parts: Vec::with_capacity(PARTS + 1),
            next_part: 0,
            steps,
            window,
            windows: steps - window * WINDOWS..steps,
            end_of_window: steps - window * (WINDOWS - 1),
            turns: vec![Turns::default(); count],
        }
    }

    /// Adds a row.
    #[inline]
    pub(crate) fn add(&mut self, row: &Row) {
        // 0 times a number that is not finite is NaN.
        let mut zero = 0.0;
        for (extremes, x) in self.extremes.iter_mut().zip(&row.store.reals) {
            zero += 0.0 * extremes.add(*x);
        }
        if self.rows >= self.next || zero.is_nan() {
            self.inspect(row);
        }
        self.rows += 1;
    }

    /// Does the part of the work that is not needed at every row.
    #[inline(never)]
    fn inspect(&mut self, row: &Row) {
        let Store { reals, others } = &row.store;
        for (index, cell) in others.iter().enumerate() {
            match cell {
                Some(value) => {
                    self.latest[index] = number(value);
                    self.extremes[reals.len() + index].add(self.latest[index]);
                }
                None => self.absent[index] += 1,
            }
        }
        let numbers = reals.iter().chain(&self.latest);
        for (lost, x) in self.lost.iter_mut().zip(numbers) {
            if !x.is_finite() {
                lost.get_or_insert(row.time);
            }
        }
        if self.rows >= self.next_part {
            self.end_part(row);
        }
        if self.windows.contains(&self.rows) {
            self.turn(row);
        }
        self.next = match others[..] {
            [] => self.next_part.min(self.windows.start),
            _ => 0,
        };
    }

    #[cold]
    fn end_part(&mut self, row: &Row) {
        self.parts.push(row.store.reals.iter().chain(&self.latest).copied().collect());
        let rows = self.steps.saturating_sub(1) * self.parts.len() as u64;
        self.next_part = rows.div_ceil(PARTS as u64);
    }

    /// Follows the oscillations at the end of the run.
    fn turn(&mut self, row: &Row) {
        let is_last = self.rows + 1 == self.end_of_window;
        if is_last {
            self.end_of_window += self.window;
        }
        let numbers = row.store.reals.iter().chain(&self.latest);
        for (turns, x) in self.turns.iter_mut().zip(numbers.copied()) {
            let now = &mut turns.now;
            if x != turns.last {
                let rises = x > turns.last;
                now.turns += u64::from(rises != turns.rises);
                (turns.rises, turns.last) = (rises, x);
            }
            now.low = if x < now.low { x } else { now.low };
            now.high = if x > now.high { x } else { now.high };
            if is_last {
                turns.windows.push(std::mem::take(now));
            }
        }
    }

    /// The summary of all rows.
    pub(crate) fn summarize(self) -> Summary {
        let columns = &self.plan.columns;
        let mut statistics = Vec::new();
        let mut alarms = Vec::new();
        let mut alarm = |kind, text| alarms.push(Alarm { kind, text });
        for (place, (column, allowed)) in
            Row::places(columns).zip(columns.iter().zip(&self.plan.bounds))
        {
            let (index, absent) = match place {
                Place::Real(index) => (index, 0),
                Place::Other(index) => {
                    (columns.len() - self.absent.len() + index, self.absent[index])
                }
            };
            let values = self.rows - absent;
            if !is_number(column.kind) || values == 0 {
                statistics.push(None);
                continue;
            }
            let Extremes { min, max, squares } = self.extremes[index];
            let rms = (squares / values as f64).sqrt();
            statistics.push(Some(Statistics { min, max, rms }));
            if let Some(time) = self.lost[index] {
                let text = format!("{} from t = {time:?} s", column.name);
                alarm(AlarmKind::NotFinite, text);
                continue;
            }
            for (value, bound, word) in [(min, allowed[0], "minimum"), (max, allowed[1], "maximum")]
            {
                if let Some(bound) = bound
                    && (value - bound) * if word == "minimum" { -1.0 } else { 1.0 } > 0.0
                {
                    let value = with_unit(value, column);
                    let text = format!("{} reaches {value}, its {word} is {bound:?}", column.name);
                    alarm(AlarmKind::BeyondBounds, text);
                }
            }
            let oscillation = self.turns[index].oscillation(self.window, VISIBLE * (max - min));
            if let Some((range, rows)) = oscillation {
                let range = with_unit(range, column);
                let text = format!("{} by {range}, reversing every {rows:.1} steps", column.name);
                alarm(AlarmKind::Oscillating, text);
            }
            if let Some(end) = self.leaves(index) {
                let text = format!("{}, which ends at {}", column.name, with_unit(end, column));
                alarm(AlarmKind::Diverging, text);
            }
        }
        alarms.sort_by_key(|alarm| alarm.kind);
        Summary { statistics, alarms }
    }

    /// The last value of a column that moves in one direction in the last parts of the run, in each further than
    /// in the one before.
    fn leaves(&self, index: usize) -> Option<f64> {
        let end = self.parts.get(PARTS)?[index];
        let part = |growing: usize| self.parts[PARTS - GROWING + growing][index];
        let moves: [f64; GROWING] = from_fn(|growing| part(growing + 1) - part(growing));
        let far = moves[GROWING - 1].abs() > VISIBLE * end.abs();
        let leaves = far && moves.windows(2).all(|pair| pair[0] != 0.0 && pair[1] / pair[0] > 1.0);
        leaves.then_some(end)
    }
}

/// Whether values of a type have a size.
fn is_number(kind: Type) -> bool {
    !matches!(kind, Type::Boolean | Type::Enumeration | Type::String | Type::Binary | Type::Clock)
}

/// A number in few digits, with its unit.
fn with_unit(value: f64, column: &Column) -> String {
    match column.unit.as_str() {
        "" => format!("{value:.3e}"),
        unit => format!("{value:.3e} {unit}"),
    }
}
