//! The parameters of a sweep together: the values that they have in each run.
//!
//! The grid consists of all combinations of listed and spaced values. The runs iterate over the grid,
//! the first parameter varying slowest, with all draws at each grid point.

use std::collections::HashSet;
use std::ops::Range;

use anyhow::{Result, bail, ensure};
use fmu_description::Value;

use super::parameter::Parameter;
use crate::random::Draw;
use crate::table::Column;

/// Maximum number of runs; more are assumed to be a mistake.
const MAX_RUNS: u64 = 1_000_000_000;

/// The parameters of every run.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters {
    seed: u64,
    draws: u64,
    all: Vec<Parameter>,
    /// The number of runs, from 1 to 10^9.
    pub runs: u64,
}

impl Parameters {
    /// Combines parameters.
    ///
    /// # Errors
    /// A variable appears twice, there is nothing to draw, or there are too many runs.
    pub fn new(seed: u64, draws: u64, all: Vec<Parameter>) -> Result<Self> {
        ensure!(!all.is_empty(), "no parameter, expected at least one [[parameter]]");
        let mut names = HashSet::new();
        for variable in all.iter().flat_map(|parameter| &parameter.variables) {
            ensure!(
                names.insert(variable),
                "{variable} appears twice, expected it in one parameter"
            );
        }
        ensure!(draws > 0, "draws = 0, expected at least 1");
        ensure!(
            draws == 1 || all.iter().any(Parameter::is_random),
            "draws = {draws}, expected a random parameter: uniform, log_uniform or normal"
        );
        let mut counts = all.iter().map(Parameter::count);
        let runs = counts.try_fold(draws, u64::checked_mul);
        let Some(runs) = runs.filter(|&runs| runs <= MAX_RUNS) else {
            bail!("the plan has too many runs, expected {MAX_RUNS} at most");
        };
        Ok(Self { seed, draws, all, runs })
    }

    /// A column for every variable.
    pub fn columns(&self) -> impl Iterator<Item = Column> {
        self.all.iter().flat_map(|parameter| {
            let variables = parameter.variables.iter().enumerate();
            variables.map(|(index, name)| Column::new(name, "", parameter.of_type(index)))
        })
    }

    /// The variables of the run with an index, from 0, and their values. They can be computed without the
    /// runs before it.
    ///
    /// A random number depends on the seed, the index of the draw and the rank of its parameter among
    /// the random ones. All grid points use the same draws, so that differences between two points are
    /// not due to the draws.
    ///
    /// # Errors
    /// There is no run with this index.
    pub fn run(&self, index: u64) -> Result<Vec<(&str, Value)>> {
        self.check(&(index..index.saturating_add(1)))?;
        let draw = index % self.draws;
        let mut point = index / self.draws;
        let mut points_left = self.runs / self.draws;
        let mut rank = 0;
        let mut assignments = Vec::with_capacity(self.all.len());
        for parameter in &self.all {
            points_left /= parameter.count();
            let place = point / points_left;
            point %= points_left;
            let drawn = Draw { seed: self.seed, rank, draw };
            rank += u64::from(parameter.is_random());
            for (index, variable) in parameter.variables.iter().enumerate() {
                assignments.push((variable.as_str(), parameter.value(place, index, &drawn)));
            }
        }
        Ok(assignments)
    }

    /// Runs that together cover every listed value and both ends of every range, to be checked before a long sweep is
    /// started.
    pub fn corners(&self) -> Vec<u64> {
        let mut corners = vec![0];
        let mut runs = self.runs;
        for parameter in &self.all {
            runs /= parameter.count();
            corners.extend(parameter.corners().map(|place| place * runs));
        }
        corners
    }

    /// Checks that there is a range of runs, such as the share of a worker.
    ///
    /// # Errors
    /// There is not, or it is empty.
    pub fn check(&self, Range { start, end }: &Range<u64>) -> Result<()> {
        let runs = self.runs;
        ensure!(
            start < end && *end <= runs,
            "runs {start}..{end}, expected a range within 0..{runs}"
        );
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use fmu_description::Type;
    use serde::Deserialize;

    use super::*;

    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct ParametersOnly {
        #[serde(default)]
        seed: u64,
        draws: Option<u64>,
        #[serde(default)]
        parameter: Vec<Parameter>,
    }

    /// Reads parameters from lines of TOML that are separated by semicolons; `[v]` begins a parameter of a
    /// variable `v`, and `[]` one without.
    fn read(text: &str) -> Result<Parameters> {
        let line = |line: &str| match line.trim().strip_prefix('[') {
            Some("]") => "[[parameter]]".to_owned(),
            Some(name) => format!("[[parameter]]\nvariable = '{}'", name.trim_end_matches(']')),
            None => line.trim().to_owned(),
        };
        let file: ParametersOnly =
            toml::from_str(&Vec::from_iter(text.split(';').map(line)).join("\n"))?;
        Parameters::new(file.seed, file.draws.unwrap_or(1), file.parameter)
    }

    fn number(value: &Value) -> f64 {
        match value {
            Value::Boolean(value) => f64::from(*value),
            value => value.as_real().unwrap(),
        }
    }

    fn values(parameters: &Parameters, place: usize) -> Vec<Value> {
        let runs = (0..parameters.runs).map(|k| parameters.run(k).unwrap());
        runs.map(|run| run[place].1.clone()).collect()
    }

    fn numbers(text: &str) -> Vec<f64> {
        let values = values(&read(text).unwrap(), 0);
        values.iter().map(number).collect()
    }

    #[test]
    fn variables_with_lists_of_their_own_vary_together() {
        let parameters =
            read("[]; variables = ['a', 'b']; together = [[1, 2], ['x', 'y']]").unwrap();
        assert_eq!(parameters.runs, 2);
        let second = parameters.run(1).unwrap();
        let text = Value::String("y".into());
        assert_eq!(second, [("a", Value::Float64(2.0)), ("b", text)]);
        for (lists, reason) in
            [("[[1, 2], [3]]", "same length"), ("[[1]]", "1 lists, expected one")]
        {
            let text = format!("[]; variables = ['a', 'b']; together = {lists}");
            assert!(read(&text).unwrap_err().to_string().contains(reason));
        }
    }

    #[test]
    fn the_first_parameter_varies_slowest_and_draws_fastest() {
        let text = "draws = 2; [a]; values = [1, 2]; [b]; uniform = [0, 1]; \
                    []; variables = ['c', 'd']; values = ['x', 'y', 'z']";
        let parameters = read(text).unwrap();
        assert_eq!(parameters.runs, 12);
        let all = |place| values(&parameters, place);
        let real = |number| vec![Value::Float64(number); 6];
        assert_eq!(all(0), [real(1.0), real(2.0)].concat());
        let texts = ["x", "x", "y", "y", "z", "z"].map(|text| Value::String(text.into()));
        assert_eq!(all(2), [texts.clone(), texts].concat());
        assert_eq!(all(2), all(3));
        // Every grid point has the same two draws.
        let draws = all(1);
        assert_ne!(draws[0], draws[1]);
        assert!(draws.chunks(2).all(|pair| pair == &draws[..2]));
        let columns = parameters.columns().map(|column| column.kind);
        assert!(columns.eq([Type::Float64, Type::Float64, Type::String, Type::String]));
        let error = parameters.run(12).unwrap_err().to_string();
        assert_eq!(error, "runs 12..13, expected a range within 0..12");
        assert!(parameters.check(&(1..1)).is_err());
    }

    #[test]
    fn corners_cover_every_listed_value_and_the_ends_of_ranges() {
        let text = "draws = 3; [a]; values = [1, 2, 4]; [b]; from = 0; to = 9; count = 10; \
                    [c]; uniform = [0, 1]; [d]; values = [true, false]";
        let parameters = read(text).unwrap();
        let corners = parameters.corners().into_iter().map(|index| {
            let run = parameters.run(index).unwrap();
            [0, 1, 3].map(|place| number(&run[place].1) as i32)
        });
        let expected = [[1, 0, 1], [2, 0, 1], [4, 0, 1], [1, 9, 1], [1, 0, 0]];
        assert!(corners.eq(expected));
    }

    #[test]
    fn whole_numbers_are_real_unless_one_is_too_large_for_that() {
        assert_eq!(numbers("[p]; values = [1, 2.5]"), [1.0, 2.5]);
        let large = read("[p]; values = [1, 9007199254740993]").unwrap();
        let expected = [1, 9_007_199_254_740_993].map(Value::Int64);
        assert_eq!(values(&large, 0), expected);
        assert_eq!(large.columns().next().unwrap().kind, Type::Int64);
        let larger = read("[p]; values = [1, 18446744073709551615]").unwrap();
        assert_eq!(values(&larger, 0), [1, u64::MAX].map(Value::UInt64));
    }

    #[test]
    fn ranges_are_evenly_spaced_with_exact_ends() {
        let tenths = Vec::from_iter((5..=20).map(|k| f64::from(k) / 10.0));
        assert_eq!(numbers("[p]; from = 0.5; to = 2; count = 16"), tenths);
        let log = numbers("[p]; from = 1e-3; to = 100; count = 6; scale = 'log'");
        assert_eq!(log, [1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0]);
        let next = 1.0 + f64::EPSILON;
        for (from, to) in [(0.1, 0.3), (1.0 / 3.0, 7.0), (1e-300, 1e289), (1.0, next)] {
            for scale in ["linear", "log"] {
                let range = format!("from = {from:?}; to = {to:?}; count = 7; scale = '{scale}'");
                let all = numbers(&format!("[p]; {range}"));
                assert_eq!((all[0], all[6]), (from, to));
                assert!(all.is_sorted(), "{all:?}");
            }
        }
    }

    /// The expected values come from an independent Python implementation of ChaCha8, the Box-Muller
    /// transform and the powers. Parameters that are not random change nothing.
    #[test]
    fn random_numbers_match_an_independent_implementation() {
        let random =
            "[a]; uniform = [0.2, 0.3]; [b]; log_uniform = [0.01, 100]; [c]; normal = [1, 0.5]";
        let grid = "[kp]; values = [100, 200]";
        for (text, first) in [(format!("{grid}; {random}"), 1), (format!("{random}; {grid}"), 0)] {
            let parameters = read(&format!("seed = 42; draws = 1000; {text}")).unwrap();
            let expected = [
                [0.23482544685480763, 12.807234226403251, 0.6540068581916535],
                [0.24934724642416647, 3.3772126495728494, 0.4501158615434441],
                [0.21527188015863885, 0.01421233472429842, 0.4083328062714755],
            ];
            for (draw, expected) in [0, 1, 999].into_iter().zip(expected) {
                for run in [draw, 1000 + draw] {
                    let run = parameters.run(run).unwrap();
                    for ((name, value), expected) in run[first..].iter().zip(expected) {
                        let deviation = (number(value) / expected - 1.0).abs();
                        assert!(deviation < 1e-14, "{name} of {draw}: {value}");
                    }
                }
            }
        }
    }

    #[test]
    fn random_numbers_are_within_their_bounds() {
        let next = 1.0 + f64::EPSILON;
        for (key, min, max) in [
            ("uniform", 1.0, next),
            ("uniform", -9e289, 9e289),
            ("log_uniform", 0.1, 0.3),
            ("log_uniform", 1e-300, 1e289),
        ] {
            let drawn = numbers(&format!("draws = 1000; [p]; {key} = [{min:?}, {max:?}]"));
            assert!(drawn.iter().all(|x| (min..=max).contains(x)), "{key}");
            assert!(drawn.iter().any(|x| x != &drawn[0]), "{key}");
        }
    }

    #[test]
    fn wrong_parameters_are_rejected_with_the_expectation() {
        let one_of = "values, or from, to and count, or uniform, log_uniform or normal";
        let cases = "
            [p] => p: no values, expected ONE_OF
            [p]; values = [1]; uniform = [0, 1] => p: several ranges of values, expected one: ONE_OF
            [p]; values = [1]; from = 0 => p: part of a range, expected from, to and count
            [p]; values = [1]; scale = 'log' => p: part of a range, expected from, to and count
            [p]; values = [] => values = [], expected at least one
            [p]; values = [1, nan] => the value NaN, expected finite numbers
            [p]; values = [1, true] => the value true, expected a number like the first one
            [p]; values = [-1, 18446744073709551615] => the value -1, expected a whole number from 0 to
            [p]; values = ['a', 1] => the value 1.0, expected a string like the first one
            [p]; values = [\"a\\n\"] => the value \"a\\n\", expected no control characters
            [p]; values = [[1]] => expected a number, true, false or a quoted string
            [p]; from = 0; to = 1; count = 1 => count = 1, expected at least 2
            [p]; from = 1; to = 1; count = 2 => p: to = 1.0, expected more than from = 1.0
            [p]; from = -inf; to = 1; count = 2 => p: from = -inf, expected a number within ±1e290
            [p]; from = 0; to = 1; count = 2; scale = 'log' => expected more than 0 for logarithms
            [p]; from = 0; to = 1; count = 2; scale = 'cubic' => expected `linear` or `log`
            [p]; uniform = [1, 1] => uniform = [1.0, 1.0], expected the smaller one first
            [p]; uniform = [1] => invalid length 1, expected an array of length 2
            [p]; log_uniform = [-1, 1] => log_uniform = [-1.0, 1.0], expected numbers above 0
            [p]; normal = [0, 0] => normal = [0.0, 0.0], expected a mean and a deviation above 0
            [p]; normal = [nan, 1] => normal = [NaN, 1.0], expected numbers within ±1e290
            [p]; values = [1]; variables = ['q'] => p: both variable and variables, expected one
            [p]; value = [1] => unknown field `value`, expected one of `variable`
            []; variables = [] => variables = [], expected names of variables
            []; values = [1] => a parameter without variable or variables, expected a name
            seed = 1 => no parameter, expected at least one [[parameter]]
            [p]; values = [1]; [p]; values = [1] => p appears twice, expected it in one parameter
            draws = 0; [p]; uniform = [0, 1] => draws = 0, expected at least 1
            draws = 2; [p]; values = [1] => draws = 2, expected a random parameter: uniform,
            draws = 1000000001; [p]; uniform = [0, 1] => too many runs, expected 1000000000 at most
            [p]; from = 0; to = 1; count = 1001; [q]; from = 0; to = 1; count = 1000000 => too many runs";
        for case in cases.trim().lines() {
            let (text, reason) = case.split_once(" => ").unwrap();
            let error = format!("{:#}", read(text).unwrap_err());
            assert!(error.contains(&reason.replace("ONE_OF", one_of)), "{text}: {error}");
        }
        let many = "[p]; from = 0; to = 1; count = 1000; [q]; from = 0; to = 1; count = 1000000";
        assert_eq!(read(many).unwrap().runs, MAX_RUNS);
    }
}
