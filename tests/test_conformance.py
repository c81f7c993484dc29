"""A correct FMU in C, `tests/c/conformance.c`, and the same FMU with one defect at a time."""

import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from native import SOURCES, in_c, read, write, write_system
from sweeps import table
from test_validate import cargo_fmu, check, findings

pytestmark = pytest.mark.usefixtures("program")

DESCRIPTION = (SOURCES / "conformance.xml").read_text()

CS = "CoSimulation"
ME = "ModelExchange"
BOTH = "both"

ROWS = (SOURCES / "defects.h").read_text()
DEFECTS = {
    name: (CS if kind == "BOTH" else globals()[kind], rule)
    for name, kind, rule in re.findall(r'\nPLANT\((\w+), (\w+), (?:NULL|"(.+?)"), ".+"\)', ROWS)
}
assert len(DEFECTS) == ROWS.count("PLANT")
"""A kind of FMU that shows each defect, and the rule by which `validate` finds it, if it can."""

FOUND = [name for name, (_, rule) in DEFECTS.items() if rule]

FEW = list({DEFECTS[name][1]: name for name in reversed(FOUND)}.values())
"""One defect for each rule."""

ALL = "ALL_DEFECTS" in os.environ
"""Whether to test all defects, as `make conformance` does, instead of a few."""


def describe(kind: str) -> str:
    """Return the model description of an FMU for one kind of simulation or for both."""
    other = {CS: ME, ME: CS}.get(kind)
    return re.sub(rf"  <{other}.*?/>\n", "", DESCRIPTION, flags=re.S) if other else DESCRIPTION


@pytest.fixture
def conformance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Return a function that packs the FMU with a defect, which may write to the working folder."""
    monkeypatch.chdir(tmp_path)

    def make(defect: str = "NO_DEFECT", kind: str = BOTH) -> Path:
        define = [f"DEFECT={defect}", *["WITHOUT_CANCEL_STEP"] * (defect == "MISSING_FUNCTION")]
        return in_c(tmp_path / "Conformance.fmu", *define, xml=describe(kind), data="")

    return make


@pytest.mark.parametrize("kind", [CS, ME, BOTH])
def test_the_correct_fmu_has_no_findings(conformance: Callable[..., Path], kind: str) -> None:
    assert findings(conformance(kind=kind)) == []


def test_one_instance_is_enough_if_the_fmu_allows_no_more(conformance: Callable[..., Path]) -> None:
    fmu = conformance("SECOND_INSTANCE_ABORTS")
    files = read(fmu)
    flags = b'canBeInstantiatedOnlyOncePerProcess="true" canSerializeFMUstate'
    text = files["modelDescription.xml"].replace(b"canSerializeFMUstate", flags)
    assert findings(write(fmu, {**files, "modelDescription.xml": text})) == []


def test_memory_of_the_host_is_not_used_unless_the_xml_says_so(
    conformance: Callable[..., Path],
) -> None:
    fmu = conformance(kind=CS)
    files = read(fmu)
    flags = b'canNotUseMemoryManagementFunctions="true" canSerializeFMUstate'
    text = files["modelDescription.xml"].replace(b"canSerializeFMUstate", flags)
    (found,) = findings(write(fmu, {**files, "modelDescription.xml": text}))
    check([found], "warning", "but: calls of allocateMemory: 2, expected none")


def test_parameters_may_exclude_each_other(conformance: Callable[..., Path]) -> None:
    assert findings(conformance("PARAMETERS_CLASH")) == []


@pytest.mark.parametrize("defect", FOUND if ALL else FEW)
def test_a_defect_is_found(conformance: Callable[..., Path], defect: str) -> None:
    kind, rule = DEFECTS[defect]
    command = ["validate", "--format", "json", "--time-limit", "5", conformance(defect, kind)]
    for options in (["--quick"], []):
        report = json.loads(cargo_fmu(*command, *options).stdout)
        found = {rule["id"]: rule["findings"] for rule in report["files"][0]["rules"]}
        if rule in found:
            return
    pytest.fail(str(found))


def hybrid(folder: Path, definitions: str, *, hidden: bool = False) -> Path:
    """Return the FMU of `tests/c/hybrid.c`, if `hidden` without its discrete outputs in the XML."""
    xml = (SOURCES / "hybrid.xml").read_text()
    if hidden:
        xml = re.sub(r' *<ScalarVariable name="(gear|gate|high)".*\n', "", xml)
        xml = re.sub(r'<Unknown index="1[345]"/>', "", xml)
    return in_c(folder / "Hybrid.fmu", *definitions.split(), xml=xml)


def by_rule(fmu: Path) -> dict[str, list[str]]:
    """Return the texts of the findings of each rule."""
    report = json.loads(cargo_fmu("validate", "--format", "json", fmu).stdout)
    rules = report["files"][0]["rules"]
    return {rule["id"]: [found["text"] for found in rule["findings"]] for rule in rules}


@pytest.mark.parametrize(
    ("defect", "hidden", "jump", "effect"),
    [
        ("MISSES_INDICATOR", False, '"u" has jumped to 1', '"high" at t = 0.2 s is false'),
        ("MISSES_INDICATOR", True, '"u" has jumped to 1', '"level" at t = 0.2 s is 0 in'),
        ("MISSES_DISCRETE", False, '"wanted" has jumped to 2', '"gear" at t = 0.2 s is 1 in'),
        ("MISSES_DISCRETE", True, '"open" has jumped to true', '"volume" at t = 0.2 s is 0 in'),
    ],
)
def test_events_by_inputs_that_co_simulation_ignores_are_found(
    defect: str, hidden: bool, jump: str, effect: str, tmp_path: Path
) -> None:
    (found,) = by_rule(hybrid(tmp_path, defect, hidden=hidden))["input-events"]
    assert jump in found
    assert effect in found


@pytest.mark.parametrize(
    "solver",
    ["NONE", "LATE", "ONE_EULER_STEP", "CHATTERS", "CHATTERS LATE", "CHATTERS ONE_EULER_STEP",
     "REFUSES"],
)  # fmt: skip
def test_another_solver_or_a_delay_is_no_defect(solver: str, tmp_path: Path) -> None:
    assert not {"input-events", "long-steps"} & by_rule(hybrid(tmp_path, solver)).keys()


def test_samples_in_a_wrong_order_are_found(tmp_path: Path) -> None:
    """The slow samples of a step come before its fast ones; the solver has its own steps."""
    (found,) = by_rule(hybrid(tmp_path, "SLOW_FIRST"))["long-steps"]
    assert '"slow" at t = 0.5 s is 48, expected 49 as with steps of 0.01 s' in found


@pytest.mark.parametrize("defect", ["CRASH_IN_STEP", "HANG_IN_INIT", "EXIT_IN_INSTANTIATE"])
def test_no_run_does_not_run_the_binary(conformance: Callable[..., Path], defect: str) -> None:
    assert findings(conformance(defect), "--no-run") == []


@pytest.mark.parametrize("seconds", ["0", "3"])
def test_what_there_was_no_time_for_is_named(
    conformance: Callable[..., Path], seconds: str
) -> None:
    """The FMU hangs for longer than this test may take."""
    fmu = conformance("HANG_IN_STEP", CS)
    found = findings(fmu, "--time-limit", "10000", "--total-time", seconds)
    check(found, "warning", "no time for the schema" if seconds == "0" else "after-error")


def test_nothing_is_left_behind(
    conformance: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmu = conformance("CRASH_IN_STEP")
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    assert not any("files written" in line for line in findings(fmu))
    assert list(folder.iterdir()) == []


def test_files_beside_the_working_directory_are_found(conformance: Callable[..., Path]) -> None:
    fmu = conformance("WRITES_FILE_ABOVE")
    check(findings(fmu, "--quick"), 'the working directory: "../conformance.log" (1 in total)')


def test_a_crash_after_a_simulation_does_not_lose_its_results(
    conformance: Callable[..., Path], tmp_path: Path
) -> None:
    conformance("UNLOAD_CRASHES", CS)
    results = tmp_path / "results.csv"
    system = write_system(tmp_path, {"a": {}}, fmu="Conformance", step=0.1)
    run = cargo_fmu("simulate", system, "--csv", results)
    assert run.returncode == 0
    assert "after the simulation" in run.stderr
    assert len(results.read_text().splitlines()) == 12


def test_a_sweep_goes_on_if_an_fmu_refuses_to_log_less(
    conformance: Callable[..., Path], tmp_path: Path
) -> None:
    conformance("LOGGING_REFUSED", CS)
    system = write_system(tmp_path, {"a": {}}, fmu="Conformance", step=0.1)
    sweep, results = tmp_path / "sweep.toml", tmp_path / "results.csv"
    sweep.write_text(
        f'system = "{system}"\n[[parameter]]\nvariable = "a.damping"\nvalues = [0.1, 0.2]\n'
        '[signals]\nreference = "a.limited"\noutput = "a.y"\nerror = "a.y"\ncontrol = "a.energy"\n'
    )
    run = cargo_fmu("sweep", sweep, "--out", results)
    assert run.returncode == 0, run.stderr
    assert [row["failure"] for row in table(results)] == ["", ""]


# --- what FMUs may do -----------------------------------------------------------------------------

EMPTY = "with 0 value references"
"""What the validator warns of in an FMU that refuses the empty calls of some hosts."""

LAWFUL = {
    "LENIENT": [],
    "NONE": [EMPTY],
    "STIFF": [EMPTY],
    "KINK": [EMPTY],
    "JUMP": [EMPTY],
    "DIFFERENCES": [EMPTY],
    "ENDS=0": [EMPTY],
    "ENDS=0.005": [EMPTY],
    "ENDS=0.05": [EMPTY],
    "NOISE=1e-12": [EMPTY],
    "RESTARTS": [EMPTY],
    "ASSERTS": [EMPTY, "not tested: larger changes of inputs, which it refuses"],
}
"""Variants of tests/c/lawful.c, and parts of the warnings."""


@pytest.mark.parametrize("variant", LAWFUL)
def test_what_the_standard_allows_is_no_error(variant: str, tmp_path: Path) -> None:
    found = findings(in_c(tmp_path / "Lawful.fmu", variant))
    assert len(found) == len(LAWFUL[variant]), found
    for words in LAWFUL[variant]:
        check(found, "warning", words)


def test_a_slow_fmu_does_not_hang(tmp_path: Path) -> None:
    """Its steps take 0.15 s, but 1.5 s after a state was restored."""
    fmu = in_c(tmp_path / "Lawful.fmu", "LENIENT", "SLOW=0.15")
    (found,) = findings(fmu, "--quick", "--time-limit", "1")
    check([found], "warning", "after the state was restored, did not return within 1 s")
    assert "it is slow" in found


CLOCK = (
    '<Clock name="clock" valueReference="20" causality="input" intervalVariability="constant"'
    ' intervalDecimal="0.1"/><Binary name="data" valueReference="21" causality="input">'
    '<Start value="00"/></Binary>'
)


def test_clocks_need_event_mode(tmp_path: Path) -> None:
    """The FMU with a clock refuses hosts without event mode."""
    xml = (SOURCES / "vector.xml").read_text()
    xml = xml.replace("</ModelVariables>", f"{CLOCK}</ModelVariables>")
    found = findings(in_c(tmp_path / "Vector.fmu", "CLOCKED", xml=xml))
    assert all(line.startswith("warning: ") for line in found), found
    (line,) = [line for line in found if "not tested: " in line]
    assert "not tested: Binaries without clocks, derivatives of arrays" in line


def test_a_library_that_the_machine_lacks_is_no_error_of_the_fmu(
    conformance: Callable[..., Path],
) -> None:
    fmu = conformance()
    files = read(fmu)
    (binary,) = [name for name in files if name.startswith("binaries/")]
    assert files[binary].count(b"\0libm.so.6\0") == 1
    files[binary] = files[binary].replace(b"\0libm.so.6\0", b"\0libX.so.6\0")
    (found,) = findings(write(fmu, files))
    check([found], "warning", "this machine lacks libX.so.6")
    # If the FMU has the library, the binary should find it.
    (found,) = findings(write(fmu, files | {"binaries/linux64/libX.so.6": b"\x7fELF"}))
    check([found], "error", "libX.so.6: cannot open shared object file")


@pytest.mark.parametrize(
    ("defect", "words"),
    [
        ("SECOND_INSTANCE_ABORTS", "fmi2Instantiate, with a second instance, was ended"),
        ("SHARED_STATIC", "with a second instance"),
        ("DEPENDS_ON_PREVIOUS_INSTANCE", "with a second instance"),
        ("RESET_CRASHES", "fmi2Reset was ended"),
        ("RESET_KEEPS_STATE", "after fmi2Reset"),
        ("STATE_LOSES_CONTINUOUS", "after the state was restored"),
    ],
)
def test_one_cause_is_one_finding(
    conformance: Callable[..., Path], defect: str, words: str
) -> None:
    (found,) = findings(conformance(defect))
    assert words in found


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("STARTS_ANEW", 'with a second instance, "u" at t = 0.01 s is '),
        ("KEEPS", 'with a second instance, "u" at t = 0 s is '),
        ("STARTS_ONCE", "fmi2EnterInitializationMode returned fmi2Error"),
        (
            "RUNS_ALONE",
            "fmi2EnterInitializationMode, with a second instance, was ended by signal 6",
        ),
    ],
)
def test_global_variables_are_one_finding(tmp_path: Path, code: str, words: str) -> None:
    found = findings(in_c(tmp_path / "Legacy.fmu", code))
    # The FMU takes calls in any order.
    (found,) = [line for line in found if "these calls returned fmi2OK" not in line]
    assert f": the instances share state: {words}" in found
    check([found], "error: ", "or set canBeInstantiatedOnlyOncePerProcess to true; left out: ")


def test_an_fmu_says_once_what_it_claims(conformance: Callable[..., Path]) -> None:
    found = findings(conformance("INPUT_DERIVATIVE_IGNORED", CS))
    check(found, "so: canInterpolateInputs is true, but: derivatives of inputs have no effect (")
