"""Results of the Python module: their columns, summary, files and data frames; and inputs."""

import contextlib
import math
from functools import partial

import numpy as np
import pandas
import polars
import pyarrow
import pyarrow.parquet
import pytest

from fmu_master import FmuError, Result, System, compare, read, simulate, sweep
from native import LOOPS, run
from test_native import TYPED, binaries, relay, sums
from test_python import LARGEST, ODD, PENDULUM, echo

__all__ = ["binaries", "echo", "relay", "sums"]  # fixtures


@pytest.mark.parametrize("in_process", [False, True])
def test_alarms_and_summary_are_those_of_the_command_line(fmus, in_process):
    loop = LOOPS / "pid-rbf.toml"
    late = {"controller.previous_sample_terms": True}
    options = ("--order=parallel", "--set=controller.previous_sample_terms=true")
    shown = run("simulate", loop, *options).stdout.splitlines()
    result = System(loop).simulate(late, order="parallel", in_process=in_process)
    alarms = [line.removeprefix("alarm: ") for line in shown if line.startswith("alarm: ")]
    assert result.alarms == alarms
    assert len(alarms) == 2
    rows = {line.split()[0]: line.split()[1:5] for line in shown}
    assert result.summary
    for name, numbers in result.summary.items():
        digits = [f"{numbers[key]:.3e}" for key in ("min", "max", "rms")]
        assert list(map(float, digits)) == list(map(float, rows[name][:3]))
        assert numbers["last"] == result[name][-1] == pytest.approx(float(rows[name][3]), rel=1e-9)


def test_inputs_are_functions_arrays_frames_results_or_files(fmus, tmp_path):
    step, force = 1e-3, 2.0
    time = np.arange(0, 1.0005, step)
    table = np.array([(0.0, force), (1.0, force)], dtype=[("time", float), ("u", float)])
    before = simulate(PENDULUM, stop_time=1.0, output="u", start_values=pandas.Series({"u": force}))
    file = tmp_path / "input.csv"
    file.write_text(f"time,u [N]\n0,{force}\n")
    results = [
        simulate(PENDULUM, stop_time=1.0, step_size=step, input=given)
        for given in (
            {"u": lambda t: force},
            {"u": lambda t: np.array(force)},  # as functions of SciPy return
            {"time": time, "u": lambda t: force},
            {"time": time, "u": np.full(len(time), force)},
            table,
            before,
            before.to_pandas(),
            file,
        )
    ]
    for result in results:
        np.testing.assert_array_equal(result["theta"], results[0]["theta"])
    assert results[0]["theta"][-1] > 0
    assert simulate(PENDULUM, stop_time=1.0)["theta"][-1] == 0


def test_inputs_may_be_elements_of_matrices_and_any_texts(sums):
    changes = {
        '7" causality="parameter" variability="fixed"': '7" causality="input"',
        '<Dimension start="3"/><Alias': '<Dimension start="3"/><Dimension start="1"/><Alias',
    }
    given = {"time": [0.0], "a.u[2,1]": [5], "a.s[1]": ['a\\b\n",'], "a.s[2]": [""]}
    result = System(sums({"a": {}}, changes=changes)).simulate(input=given)
    assert (result["a.n"][-1], result["a.k[1,1]"][-1]) == (351, -6)  # the length of the texts


def test_results_have_the_types_of_fmi_in_numpy_pandas_polars_and_files(sums, tmp_path):
    system = System(sums({"a": {}}, outputs=list(TYPED)[1:]))
    result = system.simulate()
    frames = result.to_pandas(), result.to_polars()
    for name, (kind, _, value) in TYPED.items():
        if name in result:  # all but the time
            kind = {"float": "float32", "string": "O", "binary": "O"}.get(kind, kind)
            assert result[name].dtype == np.dtype(kind)
            values = result[name], frames[0][name].to_numpy(), frames[1][name].to_list()
            assert [column[-1] for column in values] == [value] * 3
            assert type(values[2][-1]) is type(value)
    assert frames[0].index.tolist() == frames[1]["time"].to_list() == result["time"].tolist()
    assert result["a.texts"].tolist() == [["", 'a "b", c', "π\nline 2"]] * 5
    run("simulate", system.file, "--csv", "out.parquet", cwd=tmp_path)
    assert compare(result, tmp_path / "out.parquet").is_same


TIME = [0.0, 0.5]
ROWS = np.arange(12.0).reshape(2, 2, 3)
"""A matrix of 2 rows and 3 columns at two times."""


def echoed(fmu, output: str, **given: object) -> list:
    """Return the outputs of runs with inputs, before each of four steps."""
    return simulate(fmu, input=given, step_size=0.25, output=output)[output].tolist()


@pytest.mark.parametrize("in_process", [False, True])
def test_inputs_may_be_constants_alone_or_with_functions_and_arrays(echo, in_process):
    given = {"w": LARGEST, "i": np.int64(-ODD), "e": "linear", "b": b"\0\1", "ws": [1, 2**63]}
    given["m"] = ROWS[0]
    outputs = ["yw", "yi", "ye", "yb", "yws", "ym"]
    options = {"step_size": 0.25, "output": outputs, "in_process": in_process}
    result = simulate(echo, input=given, **options)
    assert [result[name][-1] for name in ("yw", "yi", "ye", "yb")] == [LARGEST, -ODD, 7, b"\0\1"]
    assert result.names("ye")[-1] == "linear"
    assert (result["yws"][-1].tolist(), result["ym"][-1].tolist()) == ([1, 2**63], [*range(6)])
    for i, inputs in (
        ([-3, -3, -3, -1, -1], given | {"i": lambda t: -1 if t >= 0.5 else -3}),
        ([5, 5, 5, 6, 6], given | {"time": TIME, "i": [5, 6]}),
    ):
        mixed = simulate(echo, input=inputs, **options)
        assert mixed["yi"].tolist() == i
        names = ["yw", "ye", "yb", "yws", "ym"]
        for name in names:
            assert mixed[name].tolist() == result[name].tolist()


def test_inputs_that_are_arrays_have_a_row_for_each_time(echo):
    before, after = [0, 1, 2, 3, 4, 5], [6, 7, 8, 9, 10, 11]
    flat = ROWS.reshape(2, 6)
    table = np.array([*zip(TIME, ROWS, strict=True)], [("time", float), ("m", float, (2, 3))])
    frame = polars.DataFrame({"time": TIME, "m": flat.tolist()})
    for given in (
        {"time": TIME, "m": ROWS},
        {"time": TIME, "m": ROWS.tolist()},
        {"time": TIME, "m": flat},
        {"m": lambda t: ROWS[int(t >= 0.5)]},
        {"time": TIME} | {f"m[{1 + k // 3},{1 + k % 3}]": flat[:, k] for k in range(6)},
        table,
        frame,
    ):
        result = simulate(echo, input=given, step_size=0.5)
        # The input of a step is the one at its start.
        assert result["ym"].tolist() == [before, before, after]
    large = {"time": TIME, "ws": [[1, LARGEST], [2**63, 0]]}
    assert echoed(echo, "yws", **large)[2:4] == [[1, LARGEST], [2**63, 0]]
    recorded = simulate(echo, input={"time": TIME, "m": ROWS}, step_size=0.5)
    again = {"time": recorded["time"], "m": recorded["ym"]}
    # Half-way from the second row to the third.
    assert echoed(echo, "ym", **again)[-1] == [3, 4, 5, 6, 7, 8]
    one = {"time": TIME, "b": [b"", b"\xff\0"]}
    for bytes_ in (one["b"], [bytearray(b) for b in one["b"]], np.array(one["b"], object)):
        assert echoed(echo, "yb", **one | {"b": bytes_})[2:4] == one["b"]


def test_values_that_do_not_fit_an_input_are_named_with_both_shapes(echo):
    for given, message in (
        ({"time": TIME, "m": np.zeros((3, 2))}, "input m: values: 3 x 2, expected 2 x 2 x 3 over"),
        ({"time": TIME, "m": np.zeros((2, 3, 2))}, "input m: values: 2 x 3 x 2, expected 2 x 2 x"),
        ({"time": TIME, "m": 1.0}, "input m: values: 1, expected 2 x 2 x 3 over time, or 2 x 3$"),
        ({"m": [1.0, 2.0]}, r"input m: values: 2, expected 2 x 3, or also a column time \[s\]"),
        ({"m": lambda t: [1.0]}, "input m: values: 6 x 1, expected 6 x 2 x 3"),
        ({"time": TIME, "w": ROWS}, "input w: values: 2 x 2 x 3, expected one, or 2 over time"),
        ({"time": TIME, "w": [1, 2, 3]}, "input w: 3 values, expected 2"),
        ({"w": [1, 2]}, r"input = w, expected also a column time \[s\]"),
        ({"ws": [[1, 2], [3]]}, "input ws: lists of different lengths, expected an array"),
        ({"w": 2**64}, f"w is 1.8446744073709552e19, expected .* to {LARGEST}"),
        ({"w": 1.5}, f"w is 1.5, expected a whole number from 0 to {LARGEST}"),
        ({"e": "linar"}, "e is linar, expected one of off, linear; did you mean linear"),
        ({"b": 1}, "b is 1, expected hexadecimal digits"),
        ({"zz": 1}, "Echo.fmu has no variable zz"),
        ({"yw": 1}, "yw is an output, expected an input"),
        ({"w": 1j}, "1j is not a number, Boolean, string or bytes"),
    ):
        with pytest.raises((FmuError, TypeError, ValueError), match=message):
            simulate(echo, input=given, step_size=0.25)


@pytest.mark.parametrize("in_process", [False, True])
def test_start_values_keep_all_bits_on_their_way_to_numpy_and_parquet(relay, tmp_path, in_process):
    file = relay({"a": {}}, (), outputs=["a.gain", "a.shape"])
    for gain in (-0.0, 5e-324, 0.1 + 0.2, -math.inf, math.nan, 2**63):
        start = {"gain": gain, "shape": "square"}
        system = System(file).changed(component=[{"name": "a", "fmu": "Relay.fmu", "start": start}])
        (tmp_path / "b.toml").write_text(system.toml, encoding="utf-8")
        run("simulate", "b.toml", "--csv", "out.parquet", cwd=tmp_path)
        written = pyarrow.parquet.read_table(tmp_path / "out.parquet")
        given = {f"a.{key}": value for key, value in start.items()}
        result = System(file).simulate(given, in_process=in_process)
        for column in (result["a.gain"], written["a.gain"].to_numpy()):
            assert column[-1].tobytes() == np.float64(gain).tobytes()
        assert result["a.shape"][-1] == written["a.shape"].to_pylist()[-1] == 4


def test_the_item_of_an_enumeration_of_fmi_2_is_its_number(relay):
    system = System(relay({"a": {"shape": "square"}}, (), outputs=["a.choice"]))
    assert system.simulate()["a.choice"].tolist() == [4] * 5


def test_the_names_of_items_are_in_files_and_beside_the_numbers(relay, tmp_path):
    file = relay({"a": {"shape": "SQUARE"}}, (), outputs=["a.choice", "a.label"])
    result = System(file).simulate()
    assert result.enumerations == {"a.choice": {1: "linear", 4: "square"}}
    assert result.names("a.choice").tolist() == ["square"] * 5
    assert result.names("a.label") is result["a.label"]
    labels = [axis.get_legend_handles_labels()[1] for axis in result.plot().axes]
    assert labels == [["a.choice"], ["a.label"]]
    numbers = {"time": result["time"], "a.choice": [4, 4, 1, 4, 4], "a.label": result["a.label"]}
    assert [d.values for d in compare(result, numbers).differences] == [(4, 1)]
    for name in ("out.csv", "out.parquet"):
        run("simulate", file, "--csv", name, cwd=tmp_path)
        written = read(tmp_path / name)
        assert written["a.choice"].tolist() == ["square"] * 5
        for pair in ((result, written), (written, result)):
            assert compare(*pair).is_same


def test_whole_numbers_of_64_bits_keep_all_digits_in_runs_and_tables(echo, tmp_path):
    start = {"w": LARGEST, "i": -ODD, "ws": [1, 2**63 + 1]}
    system = System(components={"a": {"fmu": echo, "start": start}}, step=0.5, stop=1.0)
    (tmp_path / "a.toml").write_text(system.toml)
    parts = {f"a.{name}": value for name, value in start.items()}
    for result in (
        system.simulate(),
        System(tmp_path / "a.toml").simulate(),
        System({**system.keys(), "component": [{"name": "a", "fmu": echo}]}).simulate(parts),
    ):
        assert (result["a.yw"][-1], result["a.yi"][-1]) == (LARGEST, -ODD)
        assert result["a.yws"][-1].tolist() == [1, 2**63 + 1]
    arrow = pyarrow.table({"time": [0.0, 0.5], "w": pyarrow.array([1, LARGEST], pyarrow.uint64())})
    pyarrow.parquet.write_table(arrow, tmp_path / "w.parquet", compression="none")
    time = [0.0, 0.5]
    for given in (
        {"time": time, "w": [1, LARGEST]},
        {"time": time, "w": np.array([1, LARGEST], np.uint64)},
        {"w": lambda t: LARGEST if t >= 0.5 else 1},
        pandas.DataFrame({"time": time, "w": [1, LARGEST]}),
        polars.DataFrame({"time": time, "w": [1, LARGEST]}),
        tmp_path / "w.parquet",
    ):
        result = simulate(echo, input=given, step_size=0.25)
        assert result["yw"].tolist() == [1, 1, 1, LARGEST, LARGEST]  # before each step
    assert read(tmp_path / "w.parquet")["w"].tolist() == [1, LARGEST]
    tables = [{"time": time, "w": [1, last]} for last in (LARGEST, LARGEST - 1)]
    assert compare(*tables, relative=0).reference["w"].tolist() == [1, LARGEST]
    names = dict.fromkeys(("reference", "output", "error", "control"), "a.yA[1,1]")
    plan = {"a.w": [1, LARGEST], "a.i": [-ODD, ODD]}
    sweep(plan, system, tmp_path / "out.parquet", signals=names, set={"a.ws": [LARGEST, 0]})
    runs = read(tmp_path / "out.parquet")
    assert {name: runs[name].tolist() for name in plan} == plan


def test_an_array_has_its_elements_only_and_a_column_with_texts_is_one_of_objects(tmp_path):
    result = Result.of({name: [1.0] for name in ("time", "a[1].b[1]", "a[1].b[2]", "a[1].c")}, {})
    assert result["a[1].b"].tolist() == [[1, 1]]
    with pytest.raises(KeyError, match="a is not recorded"):
        result["a"]
    file = tmp_path / "mixed.csv"
    file.write_text("time,x\n0,1\n1,on\n")
    assert read(file)["x"].tolist() == [1, "on"]


def run_of(**columns: list) -> Result:
    """Return the result of a run with these columns."""
    units = {"time": "s", "theta": "rad"}
    return Result.of({"time": [0.0, 0.5, 1.0], **columns}, units)


def test_results_are_equal_if_names_values_and_units_are():
    theta = [0.0, math.nan, 2.0]
    one = run_of(theta=theta, texts=np.array(["a", "b", "c"], object))
    assert one == run_of(theta=theta, texts=np.array(["a", "b", "c"], object))
    for other in (
        run_of(theta=[0.0, math.nan, 2.5], texts=np.array(["a", "b", "c"], object)),
        run_of(theta=[0.0, 1.0, 2.0], texts=np.array(["a", "b", "c"], object)),
        run_of(theta=theta, texts=np.array(["a", "b", "d"], object)),
        run_of(theta=theta),
        Result.of(dict(one), {}),
        Result.of({name: column[:2] for name, column in one.items()}, one.units),
        dict,
    ):
        assert one != other
        assert (one == other) is False


def test_a_list_of_names_selects_columns_and_other_keys_explain(fmus):
    result = simulate(PENDULUM, stop_time=0.1, start_values={"theta0": 0.1})
    part = result[["v", "theta"]]
    assert list(part) == ["time", "v", "theta"]
    assert part == result[["time", "v", "theta"]]
    assert part["v"] is result["v"]
    assert (part.units["theta"], part.duration) == ("rad", result.duration)
    assert part.summary["theta"] == result.summary["theta"]
    assert "omega" not in part.summary
    assert list(result) == ["time", "theta", "omega", "x", "v"]
    array = run_of(**{"q[1]": [1, 2, 3], "q[2]": [4, 5, 6], "theta": [0, 0, 0]})
    assert list(array[["q"]]) == ["time", "q[1]", "q[2]"]
    for key, error, text in (
        (0, TypeError, r'result\[0\], expected the name .*; result\["v"\]\[0\] is the first value'),
        (slice(3), TypeError, r"result\[slice\(None, 3, None\)\], expected the name of a column"),
        ("theat", KeyError, "theat is not recorded; did you mean theta"),
        (["theta", "omga"], KeyError, "omga is not recorded; did you mean omega"),
        ("zzz", KeyError, "zzz is not recorded; recorded are time, theta, omega, x, v"),
    ):
        with pytest.raises(error, match=text):
            result[key]
    assert ("theta" in result, 0 in result, "theat" in result) == (True, False, False)
    assert result.get("theat") is None
    loop = Result.of({"time": [0.0], "plant.theta": [0.0]}, {})
    with pytest.raises(KeyError, match=r"did you mean plant\.theta"):
        loop["theta"]


def test_a_summary_is_a_table_with_the_alarms_below(fmus):
    late = {"controller.previous_sample_terms": True}
    result = System(LOOPS / "pid-rbf.toml").simulate(late, order="parallel")
    summary = result.summary
    assert summary.alarms == summary["alarms"] == result.alarms != []
    assert summary.ended is summary["ended"] is None
    lines = str(summary).splitlines()
    assert lines[0].split() == ["min", "max", "rms", "last", "unit"]
    theta = next(line.split() for line in lines if line.startswith("plant.theta "))
    numbers = [float(f"{value:.4g}") for value in summary["plant.theta"].values()]
    assert (list(map(float, theta[1:5])), theta[5]) == (numbers, "rad")
    assert lines[-2:] == [f"alarm: {alarm}" for alarm in result.alarms]
    with pytest.raises(KeyError, match=r"theta has no statistics; did you mean plant\.theta\?"):
        summary["theta"]


def test_a_result_that_is_written_reads_back_as_itself(sums, tmp_path):
    system = System(sums({"a": {}}, outputs=list(TYPED)[1:]))
    result = system.simulate()
    run("simulate", system.file, "--csv", "expected.csv", cwd=tmp_path)
    run("simulate", system.file, "--csv", "expected.parquet", cwd=tmp_path)
    for ending in ("csv", "parquet"):
        file = tmp_path / f"out.{ending}"
        file.write_text("older")
        result.write(file)
        assert file.read_bytes() == (tmp_path / f"expected.{ending}").read_bytes()
        again = read(file)
        again.write(file)
        assert file.read_bytes() == (tmp_path / f"expected.{ending}").read_bytes()
    assert again == result
    assert {name: column.dtype for name, column in again.items() if name != "a.shape"} == {
        name: column.dtype for name, column in result.items() if name != "a.shape"
    }
    assert again.enumerations == result.enumerations
    assert not list(tmp_path.glob(".out*"))
    for name, message in (
        ("out.txt", "out.txt: expected a name that ends in .csv or .parquet"),
        ("nowhere/out.csv", "the folder .*nowhere does not exist"),
    ):
        with pytest.raises(FmuError, match=message):
            result.write(tmp_path / name)


def test_the_table_of_a_sweep_is_written_as_the_sweep_does(tmp_path):
    names = {"reference": "source.r", "output": "plant.theta"}
    names |= {"error": "controller.e", "control": "controller.u"}
    system, plan = LOOPS / "pid.toml", {"controller.pid.kp": [200.0, 300.0]}
    for ending in ("csv", "parquet"):
        out, again = tmp_path / f"out.{ending}", tmp_path / f"again.{ending}"
        runs = sweep(plan, system, out, signals=names, stop=0.1)
        runs.write(again)
        assert read(again) == runs
        assert np.isnan(read(again)["settling_time"]).all()
    assert again.with_suffix(".csv").read_bytes() == out.with_suffix(".csv").read_bytes()


@pytest.fixture
def typed() -> pyarrow.Table:
    """Return a table of all types that a variable may have, some with missing values."""
    types = {
        "i8": ([-1, 2, 3], pyarrow.int8()),
        "u16": ([1, 2, 65535], pyarrow.uint16()),
        "i32": ([-1, 2, 3], pyarrow.int32()),
        "u64": ([1, LARGEST, 3], pyarrow.uint64()),
        "f32": ([0.1, 2.5, math.inf], pyarrow.float32()),
        "f64": ([0.1, None, 2.5], pyarrow.float64()),
        "b": ([True, False, True], pyarrow.bool_()),
        "s": (["a", "π", "a"], pyarrow.large_string()),
        "c": (["a", "b", "a"], pyarrow.dictionary(pyarrow.int8(), pyarrow.string())),
        "y": ([b"\0", b"", b"\xff"], pyarrow.binary()),
    }
    columns = {name: pyarrow.array(values, kind) for name, (values, kind) in types.items()}
    return pyarrow.table(columns | {"time": [0.0, 0.5, 1.0]})


def by_polars(table: pyarrow.Table, file: object) -> None:
    polars.from_arrow(table).write_parquet(file)


def by_pandas(table: pyarrow.Table, file: object) -> None:
    table.to_pandas().set_index("time").to_parquet(file)


OPTIONS = [
    *({"compression": name} for name in ("none", "snappy", "zstd", "gzip", "lz4")),
    {"compression": "zstd", "data_page_version": "2.0"},
    {"compression": "zstd", "use_dictionary": False, "data_page_size": 64},
]


def test_parquet_of_other_programs_is_read_with_its_types(typed, tmp_path):
    """By default, pyarrow and pandas compress by Snappy, and Polars by zstd."""
    writers = [partial(pyarrow.parquet.write_table, **options) for options in OPTIONS]
    for number, write in enumerate([*writers, by_polars, by_pandas]):
        file = tmp_path / f"{number}.parquet"
        write(typed, file)
        result = read(file)
        assert list(result) == ["time", *(name for name in typed.column_names if name != "time")]
        for name in ("i8", "u16", "i32", "u64", "f32"):
            assert result[name].dtype == typed[name].to_numpy().dtype
        for name, column in result.items():
            values = [None if value != value else value for value in column.tolist()]
            assert values == typed[name].to_pylist()


def test_parquet_that_cannot_be_read_is_named(typed, tmp_path):
    file = tmp_path / "a.parquet"
    pyarrow.parquet.write_table(typed, file, compression="brotli")
    with pytest.raises(FmuError, match=r"a\.parquet cannot be read: its compression is BROTLI, ex"):
        read(file)
    for values, kind, reason in (
        ([0, 1], pyarrow.timestamp("ns"), "t has dates or times of day, expected numbers"),
        ([0, 1], pyarrow.date32(), "t has dates or times of day, expected numbers"),
        ([[1.0], [2.0]], pyarrow.list_(pyarrow.float64()), "t has lists or structures, expected"),
        ([1, 2], pyarrow.decimal128(5), "t is not a column of numbers, Booleans or strings"),
    ):
        table = pyarrow.table({"time": [0.0, 1.0], "t": pyarrow.array(values, kind)})
        pyarrow.parquet.write_table(table, file)
        with pytest.raises(FmuError, match=reason):
            read(file)
    pyarrow.parquet.write_table(typed, file, compression="zstd")
    content = bytearray(file.read_bytes())
    for place in range(4, len(content) - 200, 7):
        damaged = content.copy()
        damaged[place] ^= 0x55
        file.write_bytes(damaged)
        with contextlib.suppress(FmuError):  # Other values or an error, but no panic.
            read(file)


def test_other_programs_find_names_types_and_units_in_parquet(sums, tmp_path):
    units = {"time": "s", "a.x[1,2]": "rad", "b": ""}
    columns = {"time": [0.0, 0.5], "a.x[1,2]": np.float32([1.5, 2.5]), "b": np.uint8([1, 255])}
    file = tmp_path / "a.parquet"
    Result.of(columns, units).write(file)
    schema = pyarrow.parquet.read_schema(file)
    assert schema.names == ["time [s]", "a.x[1,2] [rad]", "b"]
    assert [str(field.type) for field in schema] == ["double", "float", "uint8"]
    found = [(field.metadata or {}).get(b"unit") for field in schema]
    assert found == [b"s", b"rad", None]
    assert pandas.read_parquet(file)["a.x[1,2] [rad]"].tolist() == [1.5, 2.5]
    assert polars.read_parquet(file)["b"].to_list() == [1, 255]
    assert polars.read_parquet(file).schema["b"] == polars.UInt8


def test_files_of_data_frames_have_the_time_first(fmus, tmp_path):
    """Pandas writes its index last to Parquet, and without a name to CSV."""
    result = simulate(PENDULUM, stop_time=0.1, start_values={"theta0": 0.1})
    frame = result.to_pandas()
    assert (frame.index.name, next(iter(frame.reset_index()))) == ("time", "time")
    assert frame.attrs["units"]["theta"] == "rad"
    flat = frame.reset_index()[["theta", "omega", "x", "v", "time"]]
    writes = {
        "a.parquet": frame.to_parquet,
        "b.parquet": flat.to_parquet,
        "c.csv": frame.to_csv,
        "d.csv": flat.to_csv,
        "e.csv": partial(flat.to_csv, index=False),
        "f.parquet": result.to_polars().write_parquet,
        "g.csv": result.to_polars().write_csv,
    }
    for name, write in writes.items():
        write(tmp_path / name)
        again = read(tmp_path / name)
        assert list(again) == list(result)
        for column in result:
            np.testing.assert_array_equal(again[column], result[column])
    force = pandas.DataFrame({"u": [2.0, 2.0], "time": [0.0, 1.0]})
    force.to_csv(tmp_path / "u.csv")
    force.set_index("time").to_parquet(tmp_path / "u.parquet")
    expected = simulate(PENDULUM, stop_time=0.1, input={"u": 2.0})
    for given in (tmp_path / "u.csv", tmp_path / "u.parquet", force, force.set_index("time")):
        assert simulate(PENDULUM, stop_time=0.1, input=given) == expected
