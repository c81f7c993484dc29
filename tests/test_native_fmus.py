"""The native master with FMUs in C: `relay.c` of FMI 2.0, `sums.c` of FMI 3.0."""

import csv
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from native import (
    ROOT,
    compiled,
    description,
    pack,
    refusal,
    replaced,
    run,
    simulate,
    write_system,
)

TIME = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Communication points of the systems here [s]."""

BEFORE = np.array([0.0, 0.0, 0.25, 0.5, 0.75])
"""The previous communication point of each [s]."""

SUMS = (ROOT / "tests" / "c" / "sums.xml").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def binaries(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return the binaries of tests/c/relay.c and tests/c/sums.c."""
    folder = tmp_path_factory.mktemp("binaries")
    return {name: compiled(folder, source=f"{name}.c") for name in ("relay", "sums")}


@pytest.fixture
def relay(binaries: dict[str, bytes], tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes Relay.fmu with changes to its model description."""

    def write(*changes: tuple[str, str], **options: str) -> Path:
        xml = description(dict(changes), **options)
        return pack(tmp_path / "Relay.fmu", xml, binaries["relay"])

    return write


@pytest.fixture
def sums(binaries: dict[str, bytes], tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes Sums.fmu and a system of it."""

    def write(components: dict, connections=(), changes=(), **settings) -> Path:
        xml = replaced(SUMS, dict(changes))
        pack(tmp_path / "Sums.fmu", xml, binaries["sums"], "x86_64-linux")
        return write_system(tmp_path, components, connections, "Sums", **settings)

    return write


# --- values ---------------------------------------------------------------------------------------

ALL = ["a.time -> b.u", "a.count -> b.n", "a.odd -> b.b"]
"""A connection of every type that can be connected."""

START = {"gain": -3, "shape": "square", "add": 7, "invert": True}
SETS = ["gain=-3e0", "shape=4", "add=7", "invert=true", "status_time=inf"]
"""Start values of every type, in a file and as options."""


def check_all(columns: dict[str, np.ndarray], fed: np.ndarray) -> None:
    """Check the outputs of `b`, which received the values of `a` at the times `fed`."""
    count = fed / 0.25
    same = np.testing.assert_array_equal
    same(columns["a.time"], TIME)
    same(columns["a.count"], TIME / 0.25)
    same(columns["a.odd"], TIME / 0.25 % 2)
    same(columns["b.y"], -3 * fed**2)
    same(columns["b.choice"], 4)
    ran = TIME > 0  # without direct feedthrough, a relay outputs nothing before its first step
    same(columns["b.m"][ran], 7 + count[ran])
    same(columns["b.c"][ran], count[ran] % 2 == 0)


@pytest.mark.parametrize(
    ("order", "names", "start", "sets", "fed"),
    [
        ("sequential", "ab", START, [], TIME),
        ("sequential", "ab", START | {"direct": True}, [], TIME),
        ("sequential", "ab", {"gain": 5}, SETS, TIME),
        ("parallel", "ab", START, [], BEFORE),
        ("sequential", "ba", START, [], BEFORE),
    ],
)
def test_values_of_every_type_reach_inputs(relay, tmp_path, order, names, start, sets, fed):
    """In parallel order, or when fed from below, a step later."""
    relay()
    components = {name: start if name == "b" else {} for name in names}
    system = write_system(tmp_path, components, ALL, order=order)
    check_all(simulate(system, tmp_path, *(f"--set=b.{value}" for value in sets)), fed)


def test_values_are_converted_between_all_types(sums, tmp_path):
    connections = ["a.n -> b.u[2]", "a.y -> b.x", "a.c -> b.b"]
    system = sums({"a": {"u[1]": 7, "u[2]": 0, "u[3]": 0, "s[2]": "ab"}, "b": {}}, connections)
    columns = simulate(system, tmp_path)
    # u[1] and u[3] of b keep their start values 1 and 3.
    single = np.float32(0.1)
    assert {name: column[-1] for name, column in columns.items()} == {
        "time": 1,
        "a.n": 7, "a.y": 0.1, "a.c": 1,
        # The strings have 3 and 2 characters, with 5 in the description of the second.
        "a.k[1,1]": -23, "a.k[1,2]": -24, "a.k[2,1]": -25, "a.k[2,2]": -26,
        "a.large": 9007199254740993, "a.largest": 2**64, "a.shape": -5e9,
        "b.n": 1 + 10 * 7 + 300, "b.y": float(str(single + single)), "b.c": 0,
        "b.k[1,1]": 0, "b.k[1,2]": -1, "b.k[2,1]": -2, "b.k[2,2]": -3,
        "b.large": 9007199254740993, "b.largest": 2**64, "b.shape": 2,
    }  # fmt: skip
    system = sums({"a": {}, "b": {}}, ["a.n -> b.u[2]"])
    message = run("simulate", system, cwd=tmp_path).stderr
    assert "b (Sums.fmu), u[2] = 321" in message
    assert "fmi3SetUInt8 cannot take the value 321" in message
    message = run("simulate", sums({"a": {"u[1]": 99}}), cwd=tmp_path).stderr
    assert "a (Sums.fmu), step of 0.25 s at t = 0.0 s: fmi3DoStep asked to end" in message


TYPED = {
    # name: type in Parquet, text in CSV, value in Parquet
    "time [s]": ("double", "1.0", 1.0),
    "a.large": ("int64", "9007199254740993", 9007199254740993),
    "a.largest": ("uint64", "18446744073709551615", 18446744073709551615),
    "a.shape": ("int64", "-5000000000", -5000000000),
    "a.c": ("bool", "true", True),
    "a.y [1]": ("float", "0.1", 0.10000000149011612),
    "a.k[2,1]": ("int16", "-2", -2),
    "a.texts[1]": ("string", "", ""),
    "a.texts[2]": ("string", 'a "b", c', 'a "b", c'),
    "a.texts[3]": ("string", "π\nline 2", "π\nline 2"),
    "a.bytes": ("binary", "001fff", b"\x00\x1f\xff"),
}


def test_results_keep_their_types_and_all_digits(sums, tmp_path):
    outputs = [name.removesuffix(" [1]") for name in TYPED][1:]
    system = sums({"a": {}}, outputs=outputs)
    for name in ("out.csv", "out.parquet"):
        result = run("simulate", system, "--csv", name, cwd=tmp_path)
        assert (result.returncode, result.stderr) == (0, "")
        assert result.stdout.endswith(f"wrote {name}: 5 rows\n")
    with (tmp_path / "out.csv").open(encoding="utf-8", newline="") as lines:
        head, *_, last = csv.reader(lines)
    assert dict(zip(head, last, strict=True)) == {
        name: text for name, (_, text, _) in TYPED.items()
    }
    assert ',-5000000000,true,0.1,-2,"","a ""b"", c","π\nline 2",001fff\n' in (
        tmp_path / "out.csv"
    ).read_text(encoding="utf-8")
    table = pyarrow.parquet.read_table(tmp_path / "out.parquet")
    assert {f.name: str(f.type) for f in table.schema} == {
        n: kind for n, (kind, *_) in TYPED.items()
    }
    assert table.to_pylist()[-1] == {name: value for name, (*_, value) in TYPED.items()}
    assert not list(tmp_path.glob("*.part"))


def test_elements_are_recorded_in_any_order_and_found_by_an_alias(sums, tmp_path):
    system = sums({"a": {"also[2]": 5}}, outputs=["a.k[2,1]", "a.n", "a.k[1,2]"])
    columns = simulate(system, tmp_path)
    expected = {"time": 0, "a.k[2,1]": -2, "a.n": 1 + 50 + 300, "a.k[1,2]": -1}
    assert [(name, column[0]) for name, column in columns.items()] == list(expected.items())


# --- connections ----------------------------------------------------------------------------------


def test_one_output_feeds_several_inputs_and_an_fmu_itself(relay, tmp_path):
    relay()
    connections = ["a.time -> b.u", "a.time -> c.u", "c.m -> c.n", "a.choice -> b.n"]
    components = {"a": {"shape": "square"}, "b": {"add": 1}, "c": {"add": 1}}
    columns = simulate(write_system(tmp_path, components, connections), tmp_path)
    np.testing.assert_array_equal(columns["b.y"], TIME)
    np.testing.assert_array_equal(columns["c.y"], TIME)
    np.testing.assert_array_equal(columns["c.m"], [0, 1, 2, 3, 4])
    np.testing.assert_array_equal(columns["b.m"], [0, 5, 5, 5, 5])


def test_a_connection_can_convert_the_unit(relay, tmp_path):
    relay(u_unit="deg")
    components = {"a": {}, "b": {"direct": True}}
    connection = {"from": "a.time", "to": "b.u", "factor": 2.0, "offset": -1.0}
    system = write_system(tmp_path, components, ["a.count -> b.n", connection])
    np.testing.assert_array_equal(simulate(system, tmp_path)["b.y"], 2 * TIME - 1)
    system = write_system(tmp_path, components, ["a.time -> b.u"])
    assert "the units differ; give the connection a factor" in refusal(tmp_path, "simulate", system)
    connection = {"from": "a.count", "to": "b.n", "factor": 2.0}
    system = write_system(tmp_path, components, [connection])
    assert "with a factor: both must be real numbers" in refusal(tmp_path, "simulate", system)


@pytest.mark.parametrize(("y_unit", "u_unit"), [("rad", "radian"), ("", "deg"), ("gon", "gon")])
def test_equal_or_missing_units_are_compatible(relay, tmp_path, y_unit, u_unit):
    relay(y_unit=y_unit, u_unit=u_unit)
    system = write_system(tmp_path, {"a": {"gain": 2, "u": 0.5}, "b": {}}, ["a.y -> b.u"])
    np.testing.assert_array_equal(simulate(system, tmp_path)["b.y"], [0, 1, 1, 1, 1])


DIRECT = ('<Unknown index="3"/>', '<Unknown index="3" dependencies="2"/>')


def test_algebraic_loops_can_be_allowed(relay, tmp_path):
    relay(DIRECT)
    loop = ["a.y -> b.u", "b.y -> a.u"]
    system = write_system(tmp_path, {"a": {"u": 1}, "b": {}}, loop)
    assert "allow_algebraic_loops = true" in refusal(tmp_path, "simulate", system)
    system = write_system(tmp_path, {"a": {"u": 1}, "b": {}}, loop, allow_algebraic_loops=True)
    assert "a.y" in simulate(system, tmp_path)


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_initial_values_pass_through_a_chain_of_direct_outputs(relay, tmp_path, order):
    """Each doubles its input, starting from 1: the n-th gives 2^n at the first point."""
    relay(DIRECT)
    names = "abcde"
    start = {"direct": True, "gain": 2}
    # Against the order of stepping, where a single pass would only reach the first one.
    chain = {name: start | ({"u": 1} if name == "a" else {}) for name in reversed(names)}
    links = [f"{a}.y -> {b}.u" for a, b in itertools.pairwise(names)]
    columns = simulate(write_system(tmp_path, chain, links, order=order), tmp_path)
    for power, name in enumerate(names, start=1):
        np.testing.assert_array_equal(columns[f"{name}.y"], 2.0**power)


# --- start values and recorded variables ----------------------------------------------------------


def test_variables_with_initial_exact_have_start_values(relay, tmp_path):
    old = 'name="number" valueReference="5" causality="output"><Real/>'
    relay((old, old.replace('"output"><Real', '"output" initial="exact"><Real start="0"')))
    system = write_system(tmp_path, {"a": {"number": 7.5}, "b": {}})
    columns = simulate(system, tmp_path, "--set=b.number=2")
    assert (set(columns["a.number"]), set(columns["b.number"])) == ({7.5}, {2.0})


def test_a_string_can_name_a_file_in_the_resources(binaries, tmp_path):
    files = {"first": "2.5", "größer & so": "1e300"}
    pack(tmp_path / "Relay.fmu", description(), binaries["relay"], **files)
    system = write_system(tmp_path, {"a": {"file": "first"}, "b": {"file": "größer & so"}})
    columns = simulate(system, tmp_path)
    assert (set(columns["a.number"]), set(columns["b.number"])) == ({2.5}, {1e300})


def test_fmus_that_are_declared_as_sampled_or_have_only_discrete_outputs_are(relay, tmp_path):
    """Their row then contains the sample taken at its time, which is available a step later."""
    relay()
    system = write_system(tmp_path, {"a": {}})
    system.write_text(system.read_text().replace("[component.start]", "sampled = true"))
    declared = simulate(system, tmp_path)
    real = 'causality="output"><Real'
    relay((real, 'causality="output" variability="discrete"><Real'))
    discrete = simulate(write_system(tmp_path, {"a": {}}), tmp_path)
    for columns in (declared, discrete):
        np.testing.assert_array_equal(columns["time"], TIME)
        np.testing.assert_array_equal(columns["a.time"], TIME + 0.25)


def test_all_outputs_except_strings_are_recorded_and_any_variable_on_request(relay, tmp_path):
    relay(('name="y"', 'name="y[1,2].&quot;x&quot;"'), y_unit="rad")
    names = ["time", 'y[1,2]."x"', "number", "count", "m", "choice", "odd", "c"]
    columns = simulate(write_system(tmp_path, {"a, b": {}}), tmp_path)
    assert list(columns) == ["time", *(f"a, b.{name}" for name in names)]
    outputs = ["a.add", "a.gain", 'a.y[1,2]."x"', "a.shape", "a.invert"]
    system = write_system(tmp_path, {"a": {"add": -5, "gain": 0.5}}, outputs=outputs)
    columns = simulate(system, tmp_path)
    head, *_, last = (tmp_path / "results.csv").read_text().splitlines()
    assert head == 'time [s],a.add,a.gain [1],"a.y[1,2].""x"" [rad]",a.shape,a.invert'
    assert last == "1.0,-5,0.5,0.0,1,false"


# --- misfits --------------------------------------------------------------------------------------

ELEMENTS = "its variables have 3000019 elements, expected at most 1048576"
CLOCK = "its clock b must be ticked by the master, which is not supported"
MISFITS = [
    # changes, start values, connections, outputs, message
    ([("<CoSimulation ", "<ScheduledExecution ")], {}, [], [], "co-simulation, only scheduled"),
    ([("<CoSimulation ", "<ModelExchange ")], {}, [], [], "co-simulation, only model exchange"),
    ([('<Boolean name="b"', '<Clock name="b"')], {}, [], [], CLOCK),
    ([('fmiVersion="3.0"', 'fmiVersion="4.0"')], {}, [], [], "version 4.0, expected 2.0 or 3.0"),
    ([('"u" valueReference="1" causality="input" start="1 2 3"><Dimension start="3"/>',
       '"u" valueReference="1" causality="input" start="1"><Dimension start="3000000"/>')],
     {}, [], [], ELEMENTS),
    ([], {"u[1]": 256}, [], [], "a.u[1] = 256 is invalid; expected a whole number from 0 to 255"),
    ([], {"u[1]": -1}, [], [], "a.u[1] = -1 is invalid; expected a whole number from 0 to 255"),
    ([], {"x": "?"}, [], [], 'a.x = "?" is invalid; expected a number'),
    ([], {"bytes": "00"}, [], [], 'a.bytes = "00" cannot be set: a Binary can only be recorded'),
    ([], {}, ["a.y -> a.u[1]"], [], "a.y (Float32) cannot feed a.u[1] (UInt8): the types differ"),
    ([], {}, ["a.n -> a.u"], [], "Sums.fmu has no variable u; its elements are u[1] to u[3]"),
    ([('"c" valueReference="6"', '"c" clocks="6" valueReference="6"')], {}, [], ["a.c"],
     "a.c cannot be recorded: clocked variables are not supported"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "start", "connections", "outputs", "message"), MISFITS)
def test_what_does_not_fit_is_named(sums, tmp_path, changes, start, connections, outputs, message):
    system = sums({"a": start}, connections, changes, outputs=outputs)
    assert message in refusal(tmp_path, "simulate", system)


def test_a_system_with_fmi_3_is_no_package_of_ssp_1(sums, tmp_path):
    message = refusal(tmp_path, "ssp", sums({"a": {}}))
    assert "Sums.fmu is of FMI 3.0, expected 2.0: SSP 1.0 has no arrays" in message
