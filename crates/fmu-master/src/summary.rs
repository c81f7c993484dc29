//! What a run did, gathered row by row: the extremes and the RMS of each number, and what is alarming.

use std::array::from_fn;

use fmu_description::Type;
use serde::{Deserialize, Serialize};

use crate::simulation::Row;
use crate::wiring::Place;
use crate::{Column, Plan};

/// The values of a column over all rows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Statistic {
    /// The smallest value.
    pub min: f64,
    /// The largest value.
    pub max: f64,
    /// The root of the mean of the squares; NaN or infinite if a value is.
    pub rms: f64,
}

/// The summary of a run.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Summarized {
    /// One for each column; `None` if its values are not numbers.
    pub statistics: Vec<Option<Statistic>>,
    /// What is alarming, as sentences.
    pub alarms: Vec<String>,
}

/// Oscillations are looked for in the last tenth of the rows, in this many windows.
const WINDOWS: u64 = 10;
/// In most windows, an oscillation turns at least twice, and once in this many rows.
const ROWS_PER_TURN: u64 = 50;
/// The number of windows that are most: an oscillation by a limit may pause while the set-point changes.
const MOST_WINDOWS: u64 = 7;
/// The smallest oscillation that is reported, relative to the range over the run.
const VISIBLE: f64 = 1e-3;
/// A run is divided into this many parts to see what moves away ever faster.
const PARTS: usize = 10;

/// Gathers a summary. There is an element for each column: those of the type Float64 first, then the others.
pub(crate) struct Gathering<'a> {
    plan: &'a Plan,
    rows: u64,
    now: Vec<f64>,
    min: Vec<f64>,
    max: Vec<f64>,
    squares: Vec<f64>,
    /// The time (s) of the first value that is not finite.
    lost: Vec<Option<f64>>,
    /// The values at the start, and at the end of each part.
    parts: Vec<Vec<f64>>,
    steps: u64,
    /// The number of rows of a window; 0 if the run is too short.
    window: u64,
    turns: Vec<Turns>,
}

/// How a column turns at the end of a run.
#[derive(Clone, Copy)]
struct Turns {
    last: f64,
    rises: bool,
    low: f64,
    high: f64,
    /// In this window, and in all.
    turns: u64,
    all: u64,
    /// The windows with enough turns, and the smallest range of these.
    windows: u64,
    range: f64,
}

impl<'a> Gathering<'a> {
    pub(crate) fn new(plan: &'a Plan) -> Self {
        let count = plan.columns.len();
        // Checked when the plan was made.
        let steps = plan.experiment.steps().unwrap_or(0);
        let turns = Turns {
            last: f64::NAN,
            rises: false,
            low: f64::INFINITY,
            high: f64::NEG_INFINITY,
            turns: 0,
            all: 0,
            windows: 0,
            range: f64::INFINITY,
        };
        Self {
            plan,
            rows: 0,
            now: vec![0.0; count],
            min: vec![f64::INFINITY; count],
            max: vec![f64::NEG_INFINITY; count],
            squares: vec![0.0; count],
            lost: vec![None; count],
            parts: Vec::with_capacity(PARTS + 1),
            steps,
            window: steps / 10 / WINDOWS,
            turns: vec![turns; count],
        }
    }

    /// Adds a row.
    #[inline]
    pub(crate) fn add(&mut self, row: &Row) {
        row.numbers(&mut self.now);
        let mut is_finite = true;
        let all = self.min.iter_mut().zip(&mut self.max).zip(&mut self.squares);
        for (&x, ((min, max), squares)) in self.now.iter().zip(all) {
            *min = if x < *min { x } else { *min };
            *max = if x > *max { x } else { *max };
            *squares += x * x;
            is_finite &= *squares < f64::INFINITY;
        }
        if !is_finite {
            self.lose(row.time);
        }
        if self.rows * PARTS as u64 >= self.steps.saturating_sub(1) * self.parts.len() as u64 {
            self.parts.push(self.now.clone());
        }
        if self.steps - self.rows <= self.window * WINDOWS {
            self.turn();
        }
        self.rows += 1;
    }

    #[cold]
    fn lose(&mut self, time: f64) {
        for (lost, x) in self.lost.iter_mut().zip(&self.now) {
            if !x.is_finite() {
                lost.get_or_insert(time);
            }
        }
    }

    /// Follows the oscillations at the end of the run.
    fn turn(&mut self) {
        let is_last = (self.steps - self.rows - 1).is_multiple_of(self.window);
        for (turns, &x) in self.turns.iter_mut().zip(&self.now) {
            if x != turns.last {
                let rises = x > turns.last;
                turns.turns += u64::from(rises != turns.rises);
                (turns.rises, turns.last) = (rises, x);
            }
            turns.low = turns.low.min(x);
            turns.high = turns.high.max(x);
            if is_last {
                if turns.turns >= 2 && turns.turns * ROWS_PER_TURN >= self.window {
                    turns.windows += 1;
                    turns.range = turns.range.min(turns.high - turns.low);
                }
                turns.all += turns.turns;
                turns.turns = 0;
                (turns.low, turns.high) = (f64::INFINITY, f64::NEG_INFINITY);
            }
        }
    }

    /// The summary of all rows.
    pub(crate) fn summarize(self) -> Summarized {
        let columns = &self.plan.columns;
        let mut statistics = Vec::new();
        let [mut lost, mut bounds, mut oscillating, mut leaving] = from_fn(|_| Vec::new());
        for (place, (column, allowed)) in
            Row::places(columns).zip(columns.iter().zip(&self.plan.bounds))
        {
            let index = match place {
                Place::Real(index) => index,
                Place::Other(index) => {
                    index + columns.iter().filter(|c| c.kind == Type::Float64).count()
                }
            };
            if !is_number(column.kind) || self.rows == 0 {
                statistics.push(None);
                continue;
            }
            let (min, max) = (self.min[index], self.max[index]);
            let rms = (self.squares[index] / self.rows as f64).sqrt();
            statistics.push(Some(Statistic { min, max, rms }));
            if let Some(time) = self.lost[index] {
                lost.push(format!("{} from t = {time:?} s", column.name));
                continue;
            }
            for (value, bound, word) in [(min, allowed[0], "minimum"), (max, allowed[1], "maximum")]
            {
                if let Some(bound) = bound
                    && (value - bound) * if word == "minimum" { -1.0 } else { 1.0 } > 0.0
                {
                    bounds.push(format!(
                        "{} reaches {}, its {word} is {bound:?}",
                        column.name,
                        with_unit(value, column)
                    ));
                }
            }
            let turns = &self.turns[index];
            if turns.windows >= MOST_WINDOWS && turns.range > VISIBLE * (max - min) {
                let range = with_unit(turns.range, column);
                let rows = (self.window * WINDOWS) as f64 / turns.all as f64;
                oscillating
                    .push(format!("{} by {range}, with a turn every {rows:.1} steps", column.name));
            }
            if self.leaves(index) {
                leaving.push(format!(
                    "{}, which ends at {}",
                    column.name,
                    with_unit(self.now[index], column)
                ));
            }
        }
        let alarms = [
            (lost, "not finite", ""),
            (bounds, "beyond the bounds of the model description", ""),
            (
                oscillating,
                "oscillating to the end of the run",
                "; a limit cycle, unless the inputs oscillate like this",
            ),
            (leaving, "moving away ever faster", ""),
        ];
        let alarms = alarms.into_iter().filter(|(found, ..)| !found.is_empty());
        let alarms =
            alarms.map(|(found, what, note)| format!("{what}: {}{note}", listed(&found))).collect();
        Summarized { statistics, alarms }
    }

    /// Whether a column moves in one direction in all parts of the run, in each further than in the one
    /// before.
    fn leaves(&self, index: usize) -> bool {
        if self.parts.len() <= PARTS {
            return false;
        }
        let moves: [f64; PARTS] =
            from_fn(|part| self.parts[part + 1][index] - self.parts[part][index]);
        let far = moves[PARTS - 1].abs() > VISIBLE * self.now[index].abs();
        far && moves.windows(2).all(|pair| pair[0] != 0.0 && pair[1] / pair[0] > 1.0)
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

/// The first of some texts.
fn listed(texts: &[String]) -> String {
    const MOST: usize = 3;
    let first = texts.iter().take(MOST).cloned();
    let more = (texts.len() > MOST).then(|| format!("and {} more", texts.len() - MOST));
    Vec::from_iter(first.chain(more)).join("; ")
}
