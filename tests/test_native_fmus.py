"""The native master with third-party FMUs: variable types, model descriptions, messages."""

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from native import (
    compiled,
    description,
    pack,
    read_csv,
    refusal,
    run,
    simulate,
    write_system,
)

TIME = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Communication points of the systems here [s]."""

BEFORE = np.array([0.0, 0.0, 0.25, 0.5, 0.75])
"""The previous communication point of each [s]."""


@pytest.fixture(scope="session")
def binary(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the binary of tests/c/relay.c."""
    return compiled(tmp_path_factory.mktemp("relay"))


@pytest.fixture
def relay(binary: bytes, tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes Relay.fmu with changes to its model description."""

    def write(*replaced: tuple[str, str], **options: str) -> Path:
        return pack(tmp_path / "Relay.fmu", description(dict(replaced), **options), binary)

    return write


# --- values ---------------------------------------------------------------------------------------

ALL = ["a.time -> b.u", "a.count -> b.n", "a.odd -> b.b"]
"""A connection of every type that can be connected."""


def check_all(columns: dict[str, np.ndarray], fed: np.ndarray) -> None:
    """Check the outputs of `b`, which received the values of `a` at the times `fed`."""
    count = fed / 0.25
    np.testing.assert_array_equal(columns["a.time"], TIME)
    np.testing.assert_array_equal(columns["a.count"], TIME / 0.25)
    np.testing.assert_array_equal(columns["a.odd"], TIME / 0.25 % 2)
    np.testing.assert_array_equal(columns["b.y"], -3 * fed**2)
    np.testing.assert_array_equal(columns["b.choice"], 4)
    ran = TIME > 0  # without direct feedthrough, a relay outputs nothing before its first step
    np.testing.assert_array_equal(columns["b.m"][ran], 7 + count[ran])
    np.testing.assert_array_equal(columns["b.c"][ran], count[ran] % 2 == 0)


START = {"gain": -3, "shape": "square", "add": 7, "invert": True}


@pytest.mark.parametrize("direct", [False, True])
def test_values_of_every_type_reach_inputs_in_sequential_order(relay, tmp_path, direct):
    relay()
    system = write_system(tmp_path, {"a": {}, "b": START | {"direct": direct}}, ALL)
    check_all(simulate(system, tmp_path), fed=TIME)


def test_values_reach_inputs_a_step_later_in_parallel_order_or_when_fed_from_below(relay, tmp_path):
    relay()
    system = write_system(tmp_path, {"a": {}, "b": START}, ALL, order="parallel")
    parallel = simulate(system, tmp_path)
    check_all(parallel, fed=BEFORE)
    system = write_system(tmp_path, {"b": START, "a": {}}, ALL)
    below = simulate(system, tmp_path)
    assert list(below) != list(parallel)
    for name, column in parallel.items():
        np.testing.assert_array_equal(below[name], column)


def test_an_enumeration_feeds_an_integer(relay, tmp_path):
    relay()
    system = write_system(
        tmp_path, {"a": {"shape": "square"}, "b": {"add": 1}}, ["a.choice -> b.n"]
    )
    np.testing.assert_array_equal(simulate(system, tmp_path)["b.m"], [0, 5, 5, 5, 5])


def test_a_connection_can_convert_the_unit(relay, tmp_path):
    relay(u_unit="deg")
    connection = {"from": "a.time", "to": "b.u", "factor": 2.0, "offset": -1.0}
    connections = ["a.count -> b.n", connection]
    system = write_system(tmp_path, {"a": {}, "b": {"direct": True}}, connections)
    np.testing.assert_array_equal(simulate(system, tmp_path)["b.y"], 2 * TIME - 1)
    system = write_system(tmp_path, {"a": {}, "b": {}}, ["a.time -> b.u"])
    assert "the units differ; give the connection a factor" in refusal(tmp_path, "simulate", system)
    connection = {"from": "a.count", "to": "b.n", "factor": 2.0}
    system = write_system(tmp_path, {"a": {}, "b": {}}, [connection])
    assert "with a factor: both must be real numbers" in refusal(tmp_path, "simulate", system)


def test_algebraic_loops_can_be_allowed(relay, tmp_path):
    relay(('<Unknown index="3"/>', '<Unknown index="3" dependencies="2"/>'))
    loop = ["a.y -> b.u", "b.y -> a.u"]
    system = write_system(tmp_path, {"a": {"u": 1}, "b": {}}, loop)
    assert "allow_algebraic_loops = true" in refusal(tmp_path, "simulate", system)
    system = write_system(tmp_path, {"a": {"u": 1}, "b": {}}, loop, allow_algebraic_loops=True)
    assert list(simulate(system, tmp_path)) == list(
        simulate(write_system(tmp_path, {"a": {}, "b": {}}), tmp_path)
    )


def test_variables_with_initial_exact_have_start_values(relay, tmp_path):
    old = 'name="number" valueReference="5" causality="output"><Real/>'
    new = old.replace('"output"><Real', '"output" initial="exact"><Real start="0"')
    relay((old, new))
    system = write_system(tmp_path, {"a": {"number": 7.5}, "b": {}})
    columns = simulate(system, tmp_path, "--set=b.number=2")
    assert set(columns["a.number"]) == {7.5}
    assert set(columns["b.number"]) == {2.0}


def test_one_output_feeds_several_inputs_and_an_fmu_itself(relay, tmp_path):
    relay()
    connections = ["a.time -> b.u", "a.time -> c.u", "c.m -> c.n"]
    system = write_system(tmp_path, {"a": {}, "b": {}, "c": {"add": 1}}, connections)
    columns = simulate(system, tmp_path)
    np.testing.assert_array_equal(columns["b.y"], TIME)
    np.testing.assert_array_equal(columns["c.y"], TIME)
    np.testing.assert_array_equal(columns["c.m"], [0, 1, 2, 3, 4])


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_initial_values_pass_through_a_chain_of_direct_outputs(relay, tmp_path, order):
    """Each doubles its input, starting from 1: the n-th gives 2^n at the first point."""
    relay(('<Unknown index="3"/>', '<Unknown index="3" dependencies="2"/>'))
    names = "abcde"
    start = {"direct": True, "gain": 2}
    # Against the order of stepping, where a single pass would only reach the first one.
    chain = {name: start | ({"u": 1} if name == "a" else {}) for name in reversed(names)}
    links = [f"{a}.y -> {b}.u" for a, b in itertools.pairwise(names)]
    columns = simulate(write_system(tmp_path, chain, links, order=order), tmp_path)
    for power, name in enumerate(names, start=1):
        np.testing.assert_array_equal(columns[f"{name}.y"], 2.0**power)


def test_options_set_start_values_of_every_type(relay, tmp_path):
    relay()
    system = write_system(tmp_path, {"a": {}, "b": {"gain": 5}}, ALL)
    options = ["b.gain=-3e0", "b.shape=4", "b.add=7", "b.invert=true", "b.status_time=inf"]
    check_all(simulate(system, tmp_path, *(f"--set={value}" for value in options)), fed=TIME)


def test_a_string_can_name_a_file_in_the_resources(binary, tmp_path):
    pack(tmp_path / "Relay.fmu", description(), binary, first="2.5", **{"größer & so": "1e300"})
    system = write_system(tmp_path, {"a": {"file": "first"}, "b": {"file": "größer & so"}})
    columns = simulate(system, tmp_path)
    np.testing.assert_array_equal(columns["a.number"], 2.5)
    np.testing.assert_array_equal(columns["b.number"], 1e300)
    columns = simulate(system, tmp_path, "--set=b.file=first")
    np.testing.assert_array_equal(columns["b.number"], 2.5)


def test_fmus_can_be_declared_as_sampled(relay, tmp_path):
    """Their row then contains the sample taken at its time, which is available a step later."""
    relay()
    system = write_system(tmp_path, {"a": {}})
    system.write_text(system.read_text().replace("[component.start]", "sampled = true"))
    columns = simulate(system, tmp_path)
    np.testing.assert_array_equal(columns["time"], TIME)
    np.testing.assert_array_equal(columns["a.time"], TIME + 0.25)


def test_an_fmu_with_only_discrete_outputs_is_sampled(relay, tmp_path):
    real = 'causality="output"><Real'
    relay((real, 'causality="output" variability="discrete"><Real'))
    columns = simulate(write_system(tmp_path, {"a": {}}), tmp_path)
    np.testing.assert_array_equal(columns["a.time"], TIME + 0.25)


def test_all_outputs_except_strings_are_recorded(relay, tmp_path):
    relay()
    names = ["time", "y", "number", "count", "m", "choice", "odd", "c"]
    columns = simulate(write_system(tmp_path, {"a": {}}), tmp_path)
    assert list(columns) == ["time", *(f"a.{name}" for name in names)]


def test_any_variable_can_be_recorded(relay, tmp_path):
    relay(y_unit="rad")
    outputs = ["a.add", "a.gain", "a.y", "a.shape", "a.invert"]
    system = write_system(tmp_path, {"a": {"add": -5, "gain": 0.5}}, outputs=outputs)
    columns = simulate(system, tmp_path)
    head, *_, last = (tmp_path / "results.csv").read_text().splitlines()
    assert last == "1.0,-5,0.5,0.0,1,false"
    assert head == "time [s],a.add,a.gain [1],a.y [rad],a.shape,a.invert"
    assert [columns[name][-1] for name in outputs] == [-5, 0.5, 0, 1, 0]


def test_names_with_commas_and_quotes_are_quoted(relay, tmp_path):
    relay(('name="y"', 'name="y[1,2].&quot;x&quot;"'))
    columns = simulate(write_system(tmp_path, {"a, b": {}}, outputs=['a, b.y[1,2]."x"']), tmp_path)
    assert list(columns) == ["time", 'a, b.y[1,2]."x"']


# --- model descriptions ---------------------------------------------------------------------------

VENDOR = """<VendorAnnotations><Tool name="Simulator">
  <s:options xmlns:s="http://example.org/s"><s:deep a="b"><![CDATA[ <&> ]]></s:deep></s:options>
</Tool></VendorAnnotations><ModelVariables>"""

FOREIGN = {
    "annotations of a variable": (
        ("causality=\"output\"><Real unit=\"s\"/>",
         "causality=\"output\"><Real unit=\"s\"/><Annotations><Tool name=\"T\"><x:y xmlns:x=\"u\"/>"
         "</Tool></Annotations>"),
    ),
    "vendor annotations": (("<ModelVariables>", VENDOR),),
    "capabilities": (
        ("<CoSimulation ",
         '<CoSimulation needsExecutionTool="false" canHandleVariableCommunicationStepSize="true" '
         'canRunAsynchronuously="true" canNotUseMemoryManagementFunctions="true" '
         'canInterpolateInputs="true" maxOutputDerivativeOrder="1" canGetAndSetFMUstate="true" '),
    ),
    "an attribute that FMI 2.0.5 does not define": (
        ("<CoSimulation ", '<CoSimulation canHandleMultipleSetPerTimeInstant="false" '),
    ),
    "source files": (
        ('<CoSimulation modelIdentifier="Relay"/>',
         '<CoSimulation modelIdentifier="Relay"><SourceFiles><File name="relay.c"/></SourceFiles>'
         "</CoSimulation>"),
    ),
    "also model exchange": (
        ("<CoSimulation ", '<ModelExchange modelIdentifier="Other"/><CoSimulation '),
    ),
    "information about the tool": (
        ('modelName="Relay"',
         'modelName="Relay &amp; Söhne" generationTool="T" variableNamingConvention="structured" '
         'license="&lt;ours&gt;" numberOfEventIndicators="0"'),
    ),
    "dependencies": (
        ('<Unknown index="3"/>',
         '<Unknown index="3" dependencies="2" dependenciesKind="dependent"/>'),
    ),
    "no dependency": (('<Unknown index="3"/>', '<Unknown index="3" dependencies=""/>'),),
    "a default experiment": (
        ("<ModelVariables>",
         '<DefaultExperiment startTime="0" stopTime="5" tolerance="1e-4"/><ModelVariables>'),
    ),
    "log categories": (
        ("<ModelVariables>",
         '<LogCategories><Category name="logAll"/></LogCategories><ModelVariables>'),
    ),
}  # fmt: skip


@pytest.mark.parametrize("replaced", FOREIGN.values(), ids=FOREIGN)
def test_optional_parts_of_a_model_description_do_not_affect_the_values(relay, tmp_path, replaced):
    relay(*replaced)
    check_all(simulate(write_system(tmp_path, {"a": {}, "b": START}, ALL), tmp_path), fed=TIME)


@pytest.mark.parametrize(
    ("y_unit", "u_unit"),
    [("rad", "rad"), ("rad", "radian"), ("rad", ""), ("", "deg"), ("gon", "gon"), ("", "")],
)
def test_equal_or_missing_units_are_compatible(relay, tmp_path, y_unit, u_unit):
    relay(y_unit=y_unit, u_unit=u_unit)
    system = write_system(tmp_path, {"a": {"gain": 2, "u": 0.5}, "b": {}}, ["a.y -> b.u"])
    np.testing.assert_array_equal(simulate(system, tmp_path)["b.y"], [0, 1, 1, 1, 1])


def test_a_variable_inherits_the_unit_of_its_type(relay, tmp_path):
    relay(
        ("<TypeDefinitions>",
         '<TypeDefinitions><SimpleType name="Angle"><Real unit="deg"/></SimpleType>'),
        ('causality="output"><Real/>', 'causality="output"><Real declaredType="Angle"/>'),
    )  # fmt: skip
    run("simulate", write_system(tmp_path, {"a": {}}), "--csv", tmp_path / "out.csv")
    assert "a.number [deg]" in (tmp_path / "out.csv").read_text()


def test_nothing_is_left_in_the_temporary_folder(relay, tmp_path, monkeypatch):
    relay()
    temporary = tmp_path / "temporary files & more"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    for status in (0, 3, 4):
        start = {"status": status, "status_time": 0.5}
        result = run("simulate", write_system(tmp_path, {"a": start, "b": {}}))
        assert result.returncode == (status > 0)
        assert list(temporary.iterdir()) == []


# --- log messages ---------------------------------------------------------------------------------


@pytest.mark.parametrize("logged", [0, 1, 2, 3], ids=["OK", "Warning", "Discard", "Error"])
def test_a_warning_is_shown_once_and_the_run_continues(relay, tmp_path, logged):
    relay()
    start = {"status": 1, "status_time": 0.5, "logged": logged}
    system = write_system(tmp_path, {"a": {}, "b": start})
    result = run("simulate", system, "--csv", tmp_path / "out.csv")
    assert result.returncode == 0
    assert result.stderr == "warning: b: it is too hot for b (2 times)\n"
    np.testing.assert_array_equal(read_csv(tmp_path / "out.csv")["b.time"], TIME)


def test_a_warning_without_a_message_is_shown(relay, tmp_path):
    relay()
    system = write_system(tmp_path, {"a": {"status": 1, "status_time": 0.75}})
    assert run("simulate", system).stderr == "warning: a: fmi2DoStep returned fmi2Warning\n"


def test_informational_messages_are_not_shown(relay, tmp_path):
    relay()
    system = write_system(tmp_path, {"a": {"status": 0, "status_time": 0, "logged": 0}})
    assert run("simulate", system).stderr == ""
