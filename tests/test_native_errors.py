"""What the native master refuses: one message that names the thing, and no file is written."""

import itertools
import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from native import compiled, description, pack, refusal, run, write_system


@pytest.fixture(scope="session")
def binaries(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return tests/c/relay.c, compiled as it is and with what is missing."""
    folder = tmp_path_factory.mktemp("relay")
    return {name: compiled(folder, *name.split()) for name in ("", "WITHOUT_STEP", "WITHOUT_INIT")}


@pytest.fixture
def relay(binaries: dict[str, bytes], tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes Relay.fmu, with changes of its model description."""

    def write(*replaced: tuple[str, str], binary: str = "", **options: str) -> Path:
        return pack(
            tmp_path / "Relay.fmu", description(dict(replaced), **options), binaries[binary]
        )

    return write


Said = Callable[..., str]


@pytest.fixture
def said(tmp_path: Path) -> Said:
    """Return a function that simulates a system that is refused, and returns what is said.

    An older CSV file must stay as it is.
    """

    def simulate(
        components: dict[str, dict[str, Any]],
        connections: Sequence[str] = (),
        options: Sequence[str] = (),
        **settings: Any,
    ) -> str:
        write_system(tmp_path, components, connections, **settings)
        (tmp_path / "old.csv").write_text("precious")
        return refusal(tmp_path, "simulate", "system.toml", "--csv", "old.csv", *options)

    return simulate


# --- files ----------------------------------------------------------------------------------------


def component(name: str) -> str:
    """Return the TOML of a component, whose name is TOML already."""
    return f'[[component]]\nname = {name}\nfmu = "Relay.fmu"\n'


SOUND = component('"a"')
TIMES = "stop = 1.0\nstep = 0.1\n"

FILES = {
    # what the file holds, what is said of it
    "nothing": ("", "stop"),
    "no TOML": ("this is no TOML", "line 1"),
    "unknown key": (f"{TIMES}colour = 1\n{SOUND}", "unknown field `colour`"),
    "unknown key of a component": (f"{TIMES}{SOUND}colour = 1", "unknown field `colour`"),
    "no components": (TIMES, "missing field `component`"),
    "empty components": (f"{TIMES}component = []", "the system has no component"),
    "no step": (f"stop = 1.0\n{SOUND}", "missing field `step`"),
    "step of text": (f'stop = 1.0\nstep = "1"\n{SOUND}', "line 2"),
    "order": (f'{TIMES}order = "gauss"\n{SOUND}', "expected `sequential` or `parallel`"),
    "connection": (f'{TIMES}connections = ["a.y = a.u"]\n{SOUND}', "component.output -> component"),
    "no FMU": (f'{TIMES}[[component]]\nname = "a"', "missing field `fmu`"),
    "list as value": (f"{TIMES}{SOUND}start = {{gain = [1]}}", "expected a number, true, false or"),
    "two names": (f"{TIMES}{SOUND}{SOUND}", "two components have the name a"),
    "dot in a name": (TIMES + component('"a.b"'), '"a.b" is refused'),
    "empty name": (TIMES + component('""'), '"" is refused'),
    "zero byte in a name": (TIMES + component(r'"a\u0000"'), r'"a\0" is refused'),
}


@pytest.mark.parametrize(("text", "expected"), FILES.values(), ids=FILES)
def test_a_file_that_is_no_system_is_named(relay, tmp_path, text, expected):
    relay()
    (tmp_path / "system.toml").write_text(text)
    said = refusal(tmp_path, "simulate", "system.toml", "--csv", "out.csv")
    assert said.startswith("system.toml: ")
    assert expected in said


def test_a_file_that_is_missing_or_not_text_is_named(tmp_path):
    said = refusal(tmp_path, "simulate", "none.toml", "--csv", "out.csv")
    assert said == "cannot read none.toml: No such file or directory (os error 2)"
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    assert "cannot read bytes.toml: " in refusal(tmp_path, "simulate", "bytes.toml")


# --- FMUs -----------------------------------------------------------------------------------------

FMUS = {
    # what of the description changes, what is said of it
    "FMI 3": (('fmiVersion="2.0"', 'fmiVersion="3.0"'), 'FMI version "3.0"; expected 2.0'),
    "FMI 1": (('fmiVersion="2.0"', 'fmiVersion="1.0"'), 'FMI version "1.0"; expected 2.0'),
    "model exchange": (("<CoSimulation", "<ModelExchange"), "it is not for co-simulation"),
    "other binary": (
        ('modelIdentifier="Relay"', 'modelIdentifier="Other"'),
        "it has no binary for this machine (linux64)",
    ),
    "path for identifier": (
        ('modelIdentifier="Relay"', 'modelIdentifier="../Relay"'),
        '"../Relay" is not a C identifier',
    ),
    "broken XML": (("</ModelVariables>", ""), "modelDescription.xml: line"),
    "variable without type": (
        ('<Real start="1"/>', ""),
        "the variable with the index 4 is invalid",
    ),
}


@pytest.mark.parametrize(("change", "expected"), FMUS.values(), ids=FMUS)
def test_an_fmu_that_does_not_do_is_named(relay, said, tmp_path, change, expected):
    relay(change)
    text = said({"a": {}})
    assert text.startswith("system.toml: component a: Relay.fmu cannot be used: ")
    assert expected in text


def test_an_fmu_that_is_missing_or_no_archive_is_named(said, tmp_path):
    expected = "system.toml: component a: Relay.fmu cannot be used: "
    assert said({"a": {}}) == f"{expected}cannot open it: No such file or directory (os error 2)"
    (tmp_path / "Relay.fmu").write_text("no archive")
    assert said({"a": {}}).startswith(f"{expected}it is damaged, or not an FMU")
    assert said({"a": {}}, options=["--fmus=other"]).count("other/Relay.fmu") == 1


def test_an_fmu_that_refuses_its_guid_is_named_with_what_it_logs(relay, said):
    relay(guid="{other <guid>}")
    assert said({"b": {}}) == (
        "component b: Relay.fmu cannot be instantiated: the GUID is {other <guid>}"
    )


def test_a_binary_that_cannot_be_loaded_is_told(relay, said, tmp_path):
    pack(tmp_path / "Relay.fmu", description(), b"\x7fELF, but no more")
    text = said({"a": {}})
    assert text.startswith("component a: Relay.fmu cannot be instantiated: ")
    assert "Relay.so" in text


def test_a_function_that_the_binary_lacks_is_told(relay, said):
    relay(binary="WITHOUT_STEP")
    text = said({"a": {}})
    assert text.startswith("a (Relay.fmu), step of 0.25 s at t = 0.0 s: fmi2DoStep is missing")
    relay(binary="WITHOUT_INIT")
    assert "cannot be instantiated: fmi2Instantiate is missing in the binary" in said({"a": {}})


def test_an_fmu_that_can_be_instantiated_only_once_is_not_twice(relay, said):
    relay(("<CoSimulation ", '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" '))
    assert "Relay.fmu can have one instance only; a and b are two" in said({"a": {}, "b": {}})


# --- connections ----------------------------------------------------------------------------------

CONNECTIONS = {
    # connections, what is said
    ("c.y -> b.u",): 'c.y: there is no component "c"; there are a, b',
    ("a.yy -> b.u",): "a.yy: Relay.fmu has no variable yy; did you mean y?",
    ("a.y -> b.stat",): "b.stat: Relay.fmu has no variable stat; did you mean status",
    ("a.y -> b.frequency",): "b.frequency: Relay.fmu has no variable frequency",
    ("y -> b.u",): '"y" is not of the form component.variable',
    ("a.y -> b.y",): "b.y is connected as an input, but is an output",
    ("a.u -> b.u",): "a.u is connected as an output, but is an input",
    ("a.gain -> b.u",): "a.gain is connected as an output, but is a parameter",
    ("a.y -> b.gain",): "b.gain is connected as an input, but is a parameter",
    ("a.y -> b.n",): "a.y (Real) cannot feed b.n (Integer): the types differ",
    ("a.count -> b.u",): "a.count (Integer) cannot feed b.u (Real): the types differ",
    ("a.odd -> b.n",): "a.odd (Boolean) cannot feed b.n (Integer): the types differ",
    ("a.label -> b.u",): "a.label (String) cannot feed b.u (Real): the types differ",
    ("a.y -> b.u", "a.number -> b.u"): "b.u is connected twice",
}


@pytest.mark.parametrize("connections", CONNECTIONS, ids="; ".join)
def test_a_connection_that_does_not_fit_is_named(relay, said, connections):
    relay()
    assert said({"a": {}, "b": {}}, connections).startswith(
        f"system.toml: {CONNECTIONS[connections]}"
    )


@pytest.mark.parametrize(("y_unit", "u_unit"), [("deg", "rad"), ("rad", "deg"), ("gon", "rad")])
def test_units_that_differ_are_named(relay, said, y_unit, u_unit):
    relay(y_unit=y_unit, u_unit=u_unit)
    assert f"a.y [{y_unit}] cannot feed b.u [{u_unit}]: the units differ" in said(
        {"a": {}, "b": {}}, ["a.y -> b.u"]
    )


LOOP = ["a.y -> b.u", "b.y -> c.u", "c.y -> a.u"]


def test_an_algebraic_loop_is_told_with_its_path_and_parallel_order_breaks_it(
    relay, said, tmp_path
):
    relay(('<Unknown index="3"/>', '<Unknown index="3" dependencies="2"/>'))
    components = {name: {"direct": True} for name in "dcba"}
    text = said(components, ["a.y -> d.u", *LOOP])
    path = re.search("the one before: ([a-d.y >-]+);", text)[1].split(" -> ")
    assert path[0] == path[-1]
    assert sorted(path[1:]) == ["a.y", "b.y", "c.y"]
    assert all(f"{a} -> {b[0]}.u" in LOOP for a, b in itertools.pairwise(path))
    assert "step in parallel order" in text
    result = run("simulate", tmp_path / "system.toml", "--order=parallel")
    assert result.returncode == 0, result.stderr


def test_a_loop_that_some_output_breaks_is_none(relay, tmp_path):
    for dependencies in ('<Unknown index="3" dependencies=""/>', '<Unknown index="3"/>'):
        relay(('<Unknown index="3"/>', dependencies))
        system = write_system(tmp_path, {"a": {}, "b": {}, "c": {}}, LOOP)
        assert run("simulate", system).returncode == 0


# --- start values and outputs ---------------------------------------------------------------------

STARTS = {
    # variable, value, what is expected instead
    ("gain", True): "expected a number",
    ("gain", "fast"): "expected a number",
    ("add", 1.5): "expected a whole number of 32 bits",
    ("add", 3_000_000_000): "expected a whole number of 32 bits",
    ("invert", 1): "expected true or false",
    ("shape", "round"): "expected one of linear, square",
    ("shape", 2): "expected one of linear, square",
    ("file", 7): "expected a text",
    ("file", "a\0b"): "expected a text",
    ("y", 1.0): "only inputs and parameters have start values",
}


@pytest.mark.parametrize(("variable", "value"), STARTS)
def test_a_start_value_that_does_not_fit_is_named(relay, said, variable, value):
    relay()
    text = said({"a": {variable: value}})
    assert text.startswith(f"system.toml: a.{variable} = ")
    assert STARTS[variable, value] in text


def test_a_start_value_of_an_unknown_variable_is_named(relay, said):
    relay()
    assert said({"a": {"gian": 1}}) == (
        "system.toml: a.gian: Relay.fmu has no variable gian; did you mean gain?"
    )


OPTIONS = {
    "--set=a.gain=fast": 'a.gain = "fast" is refused; expected a number',
    "--set=a.add=1.5": 'a.add = "1.5" is refused; expected a whole number',
    "--set=a.invert=maybe": 'a.invert = "maybe" is refused; expected true or false',
    "--set=a.shape=3": 'a.shape = "3" is refused; expected one of linear, square',
    "--set=a.gian=1": "a.gian: Relay.fmu has no variable gian; did you mean gain?",
    "--set=x.gain=1": 'x.gain: there is no component "x"',
    "--set=a.y=1": 'a.y = "1" is refused: only inputs and parameters have start values',
    "--output=a.z": "system.toml: a.z: Relay.fmu has no variable z",
    "--output=a.label": "system.toml: a.label is a String, which cannot be recorded",
    "--step=0": "system.toml: the step is 0 s; expected a positive number",
    "--step=-0.1": "system.toml: the step is -0.1 s; expected a positive number",
    "--step=nan": "system.toml: the step is NaN s; expected a positive number",
    "--step=1e-10": "system.toml: 1.000e10 steps are too many; the most are 1e9",
    "--stop=-1": "system.toml: the stop time -1 s lies before the start time 0 s",
    "--start=2": "system.toml: the stop time 1 s lies before the start time 2 s",
    "--stop=nan": "system.toml: the stop time NaN s",
    "--csv=none/out.csv": "cannot write to the folder none: No such file or directory",
    "--csv=.": ". is a folder",
}


@pytest.mark.parametrize("option", OPTIONS)
def test_an_option_that_does_not_fit_is_named(relay, tmp_path, option):
    relay()
    write_system(tmp_path, {"a": {}})
    options = [option] if "--csv" in option else [option, "--csv=out.csv"]
    said = refusal(tmp_path, "simulate", "system.toml", *options)
    assert said.startswith(OPTIONS[option])


def test_an_output_is_recorded_once(relay, said):
    relay()
    assert "a.y is recorded twice" in said({"a": {}}, outputs=["a.y", "a.y"])


@pytest.mark.parametrize(
    "option", ["--set=gain", "--set=gain=1", "--set=a.gain", "--order=gauss", "--step=fast"]
)
def test_an_option_that_cannot_be_read_is_named_with_what_is_expected(relay, tmp_path, option):
    relay()
    result = run("simulate", write_system(tmp_path, {"a": {}}), option)
    assert result.returncode == 2
    assert option.split("=")[0] in result.stderr


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf", "1e300"])
def test_what_an_fmu_refuses_at_its_start_is_told_with_its_reason(fmus, tmp_path, value):
    shutil.copy(fmus / "Pid.fmu", tmp_path / "Relay.fmu")
    write_system(tmp_path, {"controller": {}})
    options = ("--csv=out.csv", f"--set=controller.ts={value}")
    said = refusal(tmp_path, "simulate", "system.toml", *options)
    assert said.startswith("controller (Relay.fmu), ")
    assert re.search(r"fmi2\w+ returned fmi2Error: .*\bts\b.*; no file was written", said)


# --- FMUs that fail on the way --------------------------------------------------------------------

STATUS = {
    2: "fmi2Discard",
    3: "fmi2Error",
    4: "fmi2Fatal",
    5: "fmi2Pending, and asynchronous steps are not supported",
    42: "42, which is not a fmi2Status",
    -1: "-1, which is not a fmi2Status",
}


@pytest.mark.parametrize("logged", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("status", STATUS)
def test_a_step_that_fails_is_told_with_component_time_and_reason(relay, said, status, logged):
    """The relay ends the process when a function is called after fmi2Fatal, even to free it."""
    relay()
    start = {"status": status, "status_time": 0.5, "logged": logged}
    assert said({"a": {}, "b": start, "c": {}}) == (
        f"b (Relay.fmu), step of 0.25 s at t = 0.5 s: fmi2DoStep returned {STATUS[status]}:"
        " it is too hot for b; no file was written"
    )


def test_a_failure_without_a_reason_says_so_and_takes_no_older_message_for_one(relay, tmp_path):
    """The message is said by `a` and by `b` in steps before, as information."""
    relay()
    talks = {"status": 0, "status_time": 0, "logged": 0}
    write_system(tmp_path, {"a": talks, "b": {"status": 3, "status_time": 0.5}})
    assert refusal(tmp_path, "simulate", "system.toml") == (
        "b (Relay.fmu), step of 0.25 s at t = 0.5 s:"
        " fmi2DoStep returned fmi2Error; the FMU logged no reason"
    )


def test_warnings_before_a_failure_are_shown(relay, tmp_path):
    relay()
    warns = {"status": 1, "status_time": 0.25, "logged": 1}
    fails = {"status": 3, "status_time": 0.75, "logged": 3}
    result = run("simulate", write_system(tmp_path, {"a": warns, "b": fails}))
    assert result.returncode == 1
    first, second = result.stderr.splitlines()
    assert first == "warning: a: it is too hot for a (3 times)"
    assert second.startswith("error: b (Relay.fmu), step of 0.25 s at t = 0.75 s: ")


def test_a_getter_that_fails_is_told_with_its_variables(relay, said):
    """The relay has no Real with that reference."""
    relay(('name="number" valueReference="5"', 'name="number" valueReference="99"'))
    assert said({"a": {}}) == (
        "a (Relay.fmu), time, y, number at t = 0.0 s:"
        " fmi2GetReal returned fmi2Error; the FMU logged no reason; no file was written"
    )


def test_an_input_that_is_refused_is_told_with_value_and_communication_point(relay, said):
    """At t = 0.5 s `a` steps first, and hands on the time that it reaches."""
    relay()
    assert said({"a": {}, "b": {"u_max": 0.6}}, ["a.time -> b.u"]) == (
        "b (Relay.fmu), u = 0.75 at t = 0.5 s:"
        " fmi2SetReal returned fmi2Error; the FMU logged no reason; no file was written"
    )


def test_an_initialization_that_fails_is_told_with_its_reason(relay, said):
    relay()
    text = said({"a": {"file": "none"}})
    assert re.fullmatch(
        r"a \(Relay\.fmu\), initialization at t = 0\.0 s: fmi2EnterInitializationMode returned"
        r" fmi2Error: there is no number in /.*/resources/none; no file was written",
        text,
    )


def test_a_message_that_is_not_utf_8_is_shown_as_far_as_it_is(relay, said):
    """The relay keeps 63 bytes of a name, which end within a letter."""
    relay()
    assert f"resources/{'ä' * 31}\ufffd; no file" in said({"a": {"file": "ä" * 40}})


@pytest.mark.parametrize("logged", [5, 42])
def test_a_message_with_an_unknown_status_is_shown_as_a_warning(relay, tmp_path, logged):
    relay()
    start = {"status": 0, "status_time": 0.5, "logged": logged}
    result = run("simulate", write_system(tmp_path, {"a": start}))
    assert result.returncode == 0
    assert result.stderr == "warning: a: it is too hot for a (3 times)\n"


def test_a_loop_that_diverges_is_told(fmus, tmp_path):
    shutil.copy(fmus / "Pendulum.fmu", tmp_path / "Relay.fmu")
    write_system(tmp_path, {"plant": {"u": 1.0}}, stop=1000.0, step=0.001)
    said = refusal(tmp_path, "simulate", "system.toml", "--csv=out.csv")
    assert re.match(r"plant \(Relay\.fmu\), step of 0\.001 s at t = [\d.]+ s: fmi2DoStep", said)
    assert said.count("fmi2DoStep") == 1, "once is enough, though our FMUs say it, too"
    assert "diverge" in said
