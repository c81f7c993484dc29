use super::*;

fn plan(text: &str) -> Plan {
    toml::from_str(text).unwrap()
}

fn values(plan: &Plan, parameter: usize) -> Vec<Value> {
    (0..plan.runs())
        .map(|k| plan.run(k).unwrap().assignments[parameter].1.clone())
        .collect()
}

fn numbers(text: &str) -> Vec<f64> {
    let plan = plan(text);
    let number = |value| match value {
        Value::Number(number) => number,
        _ => panic!("{value:?}"),
    };
    values(&plan, 0).into_iter().map(number).collect()
}

/// The TOML of a parameter with these keys.
fn parameter(keys: &str) -> String {
    format!("[[parameter]]\nvariable = 'p'\n{keys}\n")
}

#[test]
fn the_first_parameter_varies_slowest_and_draws_fastest() {
    let plan = plan(
        "draws = 2
        [[parameter]]
        variable = 'a'
        values = [1, 2]
        [[parameter]]
        variable = 'b'
        uniform = [0, 1]
        [[parameter]]
        variables = ['c', 'd']
        values = ['x', 'y', 'z']",
    );
    assert_eq!(plan.runs(), 12);
    let text = |k: u64, place: usize| plan.run(k).unwrap().assignments[place].1.to_string();
    let first: Vec<_> = (0..12).map(|k| text(k, 0)).collect();
    assert_eq!(first, [["1.0"; 6], ["2.0"; 6]].concat());
    let last: Vec<_> = (0..12).map(|k| text(k, 2)).collect();
    assert_eq!(last, ["x", "x", "y", "y", "z", "z"].repeat(2));
    let run = plan.run(11).unwrap();
    let names: Vec<_> = run.assignments.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["a", "b", "c", "d"]);
    assert_eq!(run.assignments[2].1, run.assignments[3].1);
    // Every grid point has the same two draws.
    let draws = values(&plan, 1);
    assert_ne!(draws[0], draws[1]);
    assert!(draws.chunks(2).all(|pair| pair == &draws[..2]));
}

#[test]
fn corners_cover_every_listed_value_and_the_ends_of_ranges() {
    let plan = plan(
        "draws = 3
        [[parameter]]
        variable = 'a'
        values = [1, 2, 4]
        [[parameter]]
        variable = 'b'
        from = 0
        to = 9
        count = 10
        [[parameter]]
        variable = 'c'
        uniform = [0, 1]
        [[parameter]]
        variable = 'd'
        values = ['x', 'y']",
    );
    let corner = |index: u64| {
        let assignments = plan.run(index).unwrap().assignments;
        [0, 1, 3].map(|place| assignments[place].1.to_string())
    };
    let corners: Vec<_> = plan.corners().into_iter().map(corner).collect();
    assert_eq!(
        corners,
        [
            ["1.0", "0.0", "x"],
            ["2.0", "0.0", "x"],
            ["4.0", "0.0", "x"],
            ["1.0", "9.0", "x"],
            ["1.0", "0.0", "y"],
        ]
    );
}

#[test]
fn ranges_are_evenly_spaced_with_exact_ends() {
    let spaced = |keys: &str| numbers(&parameter(keys));
    assert_eq!(
        spaced("from = 0\nto = 49\ncount = 50"),
        Vec::from_iter((0..50).map(f64::from))
    );
    let tenths = Vec::from_iter((5..=20).map(|k| f64::from(k) / 10.0));
    assert_eq!(spaced("from = 0.5\nto = 2\ncount = 16"), tenths);
    let decades = [1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0];
    assert_eq!(
        spaced("from = 1e-3\nto = 100\ncount = 6\nscale = 'log'"),
        decades
    );
    for scale in ["linear", "log"] {
        for (from, to) in [
            (0.1, 0.3),
            (1.0 / 3.0, 7.0),
            (1e-300, 1e289),
            (1.0, 1.0 + f64::EPSILON),
        ] {
            let all = spaced(&format!(
                "from = {from:?}\nto = {to:?}\ncount = 7\nscale = '{scale}'"
            ));
            assert_eq!((all[0], all[6]), (from, to));
            assert!(all.is_sorted(), "{all:?}");
        }
    }
}

/// The expected values come from an independent Python implementation of ChaCha8, the Box-Muller
/// transform and the powers.
#[test]
fn random_numbers_match_an_independent_implementation() {
    let plan = plan(
        "seed = 42
        draws = 1000
        [[parameter]]
        variable = 'kp'
        values = [100, 200]
        [[parameter]]
        variable = 'a'
        uniform = [0.2, 0.3]
        [[parameter]]
        variable = 'b'
        log_uniform = [0.01, 100]
        [[parameter]]
        variable = 'c'
        normal = [1, 0.5]",
    );
    for (draw, expected) in EXPECTED {
        for point in 0..2 {
            let run = plan.run(1000 * point + draw).unwrap();
            for ((name, value), expected) in run.assignments[1..].iter().zip(expected) {
                let Value::Number(number) = value else {
                    panic!("{value:?}")
                };
                assert!(
                    (number / expected - 1.0).abs() < 1e-14,
                    "{name} of {draw}: {number:?}"
                );
            }
        }
    }
}

const EXPECTED: [(u64, [f64; 3]); 3] = [
    (
        0,
        [0.23482544685480763, 12.807234226403251, 0.6540068581916535],
    ),
    (
        1,
        [0.24934724642416647, 3.3772126495728494, 0.4501158615434441],
    ),
    (
        999,
        [0.21527188015863885, 0.01421233472429842, 0.4083328062714755],
    ),
];

#[test]
fn another_grid_parameter_does_not_change_the_draws() {
    let random = parameter("normal = [0, 1]");
    let few = plan(&format!("draws = 5\n{random}"));
    let more = plan(&format!(
        "draws = 5\n[[parameter]]\nvariable = 'q'\nvalues = [true]\n{random}"
    ));
    assert_eq!(values(&few, 0), values(&more, 1));
}

#[test]
fn random_numbers_are_within_their_bounds() {
    for (keys, min, max) in [
        ("uniform = [-1, 2]", -1.0, 2.0),
        (
            "uniform = [1.0, 1.0000000000000002]",
            1.0,
            1.0 + f64::EPSILON,
        ),
        ("uniform = [-9e289, 9e289]", -9e289, 9e289),
        ("log_uniform = [0.1, 0.3]", 0.1, 0.3),
        ("log_uniform = [1e-300, 1e289]", 1e-300, 1e289),
    ] {
        let drawn = numbers(&format!("draws = 1000\n{}", parameter(keys)));
        assert!(drawn.iter().all(|x| (min..=max).contains(x)), "{keys}");
        assert!(drawn.iter().any(|x| x != &drawn[0]), "{keys}");
    }
}

#[test]
fn columns_have_the_types_of_their_values() {
    let plan = plan(
        "[[parameter]]
        variable = 'a'
        values = ['x']
        [[parameter]]
        variables = ['b', 'c']
        values = [true]
        [[parameter]]
        variable = 'd'
        values = [1, 2.5]",
    );
    let columns: Vec<_> = plan
        .columns()
        .into_iter()
        .map(|c| (c.name, c.kind))
        .collect();
    use crate::Kind::{Boolean, Number, Text};
    let expected = [("a", Text), ("b", Boolean), ("c", Boolean), ("d", Number)];
    assert_eq!(
        columns,
        expected.map(|(name, kind)| (name.to_owned(), kind))
    );
}

#[test]
fn a_run_beyond_the_last_is_rejected() {
    let plan = plan(&parameter("values = [1, 2]"));
    for (index, reason) in [
        (2, "runs 2..3, expected a range within 0..2"),
        (
            u64::MAX,
            "runs 18446744073709551615..18446744073709551615, expected a range within 0..2",
        ),
    ] {
        assert_eq!(plan.run(index).unwrap_err().to_string(), reason);
    }
    assert!(plan.check(0..2).is_ok());
    assert!(plan.check(1..1).is_err());
    assert!(plan.check(1..3).is_err());
}

#[test]
fn a_wrong_parameter_is_rejected_with_its_name_and_the_expectation() {
    for (keys, reason) in [
        (
            "",
            "p: no values, expected values, or from, to and count, or uniform, log_uniform or normal",
        ),
        (
            "values = [1]\nuniform = [0, 1]",
            "p: several ranges of values, expected one: values, or from, to and count, or uniform, log_uniform or normal",
        ),
        (
            "values = [1]\nfrom = 0\nto = 1\ncount = 3",
            "p: several ranges of values, expected one: values, or from, to and count, or uniform, log_uniform or normal",
        ),
        (
            "values = [1]\nfrom = 0",
            "p: part of a range, expected from, to and count",
        ),
        (
            "values = [1]\nscale = 'log'",
            "p: part of a range, expected from, to and count",
        ),
        ("values = []", "values = [], expected at least one"),
        (
            "values = [1, nan]",
            "the value NaN, expected finite numbers",
        ),
        (
            "values = [1, true]",
            "the value true, expected a number like the first one",
        ),
        (
            "values = ['a', 1]",
            "the value 1.0, expected a string like the first one",
        ),
        (
            "values = [\"a\\n\"]",
            "the value \"a\\n\", expected no control characters",
        ),
        ("values = [[1]]", "expected a number, a boolean or a string"),
        (
            "from = 0\nto = 1\ncount = 0",
            "count = 0, expected at least 2",
        ),
        (
            "from = 0\nto = 1\ncount = 1",
            "count = 1, expected at least 2",
        ),
        (
            "from = 0\nto = 1\ncount = -1",
            "invalid value: integer `-1`, expected u64",
        ),
        (
            "from = 1\nto = 1\ncount = 2",
            "p: to = 1.0, expected more than from = 1.0",
        ),
        (
            "from = 2\nto = 1\ncount = 2",
            "p: to = 1.0, expected more than from = 2.0",
        ),
        (
            "from = -inf\nto = 1\ncount = 2",
            "p: from = -inf, expected a number within ±1e290",
        ),
        (
            "from = 1\nto = nan\ncount = 2",
            "p: to = NaN, expected a number within ±1e290",
        ),
        (
            "from = 0\nto = 1\ncount = 2\nscale = 'log'",
            "p: from = 0.0, expected more than 0 for logarithms",
        ),
        (
            "from = 0\nto = 1\ncount = 2\nscale = 'cubic'",
            "unknown variant `cubic`, expected `linear` or `log`",
        ),
        (
            "uniform = [1, 1]",
            "uniform = [1.0, 1.0], expected the smaller one first",
        ),
        (
            "uniform = [1]",
            "invalid length 1, expected an array of length 2",
        ),
        (
            "log_uniform = [-1, 1]",
            "log_uniform = [-1.0, 1.0], expected numbers above 0",
        ),
        (
            "normal = [0, 0]",
            "normal = [0.0, 0.0], expected a mean and a deviation above 0",
        ),
        (
            "normal = [0, inf]",
            "normal = [0.0, inf], expected numbers within ±1e290",
        ),
        (
            "normal = [nan, 1]",
            "normal = [NaN, 1.0], expected numbers within ±1e290",
        ),
        (
            "values = [1]\nvariables = ['q']",
            "p: both variable and variables, expected one of them",
        ),
        (
            "value = [1]",
            "unknown field `value`, expected one of `variable`",
        ),
    ] {
        let error = toml::from_str::<Plan>(&parameter(keys))
            .unwrap_err()
            .to_string();
        assert!(error.contains(reason), "{keys}: {error}");
        assert!(error.starts_with("TOML parse error at line"), "{error}");
    }
}

#[test]
fn a_wrong_plan_is_rejected_with_the_expectation() {
    let many = |count: u64| {
        ["p", "q", "r"].map(|name| {
            format!("[[parameter]]\nvariable = '{name}'\nfrom = 0\nto = 1\ncount = {count}\n")
        })
    };
    for (text, reason) in [
        (
            "".into(),
            "no parameter, expected at least one [[parameter]]",
        ),
        (
            parameter("values = [1]").repeat(2),
            "p appears twice, expected it in one parameter",
        ),
        (
            "[[parameter]]\nvariables = ['q', 'q']\nvalues = [1]".into(),
            "q appears twice, expected it in one parameter",
        ),
        (
            "[[parameter]]\nvariables = []".into(),
            "variables = [], expected names of variables",
        ),
        (
            "[[parameter]]\nvalues = [1]".into(),
            "a parameter without variable or variables, expected a name",
        ),
        (
            format!("draws = 0\n{}", parameter("uniform = [0, 1]")),
            "draws = 0, expected at least 1",
        ),
        (
            format!("draws = 2\n{}", parameter("values = [1]")),
            "draws = 2, expected a random parameter: uniform, log_uniform or normal",
        ),
        (
            format!("draws = 1000000001\n{}", parameter("uniform = [0, 1]")),
            "the plan has too many runs, expected 1000000000 at most",
        ),
        (
            many(1001).concat(),
            "the plan has too many runs, expected 1000000000 at most",
        ),
        (
            many(i64::MAX as u64).concat(),
            "the plan has too many runs, expected 1000000000 at most",
        ),
        (
            "sed = 1".into(),
            "unknown field `sed`, expected one of `seed`, `draws`, `parameter`",
        ),
        (
            "seed = -1".into(),
            "invalid value: integer `-1`, expected u64",
        ),
    ] {
        let error = toml::from_str::<Plan>(&text).unwrap_err().to_string();
        assert!(error.contains(reason), "{text}: {error}");
    }
    assert_eq!(plan(&many(1000).concat()).runs(), MAX_RUNS);
}
