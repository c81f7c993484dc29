"""FMUs as C sources: what a compiler makes of them, what they need, and how importers build them.

`test_hosts.py` compiles them with other compilers and for other processors, and compares the bits.
"""

import re
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest

from loops import MODELS, described_loop, run_loop, stems
from machines import HEADERS, IN_C, NATIVE, functions, unpack_sources
from needs import CMAKE
from pendulum_fmus import table1
from pendulum_fmus.loop import Loop, workers
from pendulum_fmus.report.runs import simulate_all
from test_hosts import run_scenarios
from test_validate import findings

MOST_MEMORY = 128 << 10
"""The largest instance of a model of the paper [bytes]."""

LONGEST_TEXT = 500_000
"""The C of a PID controller for FMI 2.0 [bytes]."""

VARIABLES = "dDbBC"
"""The symbols of variables, as `nm` calls them."""

each_fmu = pytest.mark.parametrize("name", [f"{m}{v}" for m in MODELS for v in ("", "_fmi3")])
each_version = pytest.mark.parametrize("version", ["2", "3"])


def message(file: Path, *options: str) -> str:
    """Compile a file that the compiler must refuse; return what it says."""
    command = ["cc", "-std=c99", *options, "-c", file, "-o", file.with_suffix(".o")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    return done.stderr


def symbols(file: Path, kinds: str, *options: str) -> dict[str, int]:
    """Compile a file; return the symbols of some kinds, as `nm` calls them, with their sizes."""
    output = file.with_suffix(".o")
    subprocess.run(["cc", "-std=c99", *options, "-c", file, "-o", output], check=True)
    command = ["nm", "--print-size", output]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    rows = re.findall(rf"^[0-9a-f ]{{16}}(?: ([0-9a-f]+))? ([{kinds}]) (\S+)$", text, flags=re.M)
    return {name: int(size or "0", 16) for size, _, name in rows}


def interface(file: Path, folder: Path) -> Path:
    """Unpack an FMU; return its file with the functions of the standard."""
    (found,) = (path for path in unpack_sources(file, folder) if path.name.startswith("fmi"))
    return found


# --- files, memory and calls ----------------------------------------------------------------------


@each_fmu
def test_an_instance_is_one_block_of_limited_size(sources, name, tmp_path):
    file = interface(sources / f"{name}.fmu", tmp_path)
    assert symbols(file, VARIABLES) == {}
    static = symbols(file, VARIABLES, "-DFMU_STATIC_INSTANCES=1")
    assert MOST_MEMORY / 4 < sum(static.values()) <= MOST_MEMORY, static
    undefined = symbols(file, "U", "-DFMU_STATIC_INSTANCES=1")
    assert not {"malloc", "calloc", "realloc", "free"} & undefined.keys()


def test_the_c_of_a_pid_controller_is_short(sources):
    with zipfile.ZipFile(sources / "Pid.fmu") as package:
        files = [file for file in package.infolist() if file.filename.endswith((".c", ".h"))]
    assert 0 < sum(file.file_size for file in files) <= LONGEST_TEXT


def test_a_model_has_no_variables_outside_of_its_instances(sources, tmp_path):
    (file,) = (f for f in unpack_sources(sources / "PidRbf.fmu", tmp_path) if f.name == "model.c")
    assert symbols(file, VARIABLES) == {}


@pytest.mark.parametrize("option", ["-ffast-math", "-Ofast", "-mfpmath=387"])
def test_options_that_change_results_are_refused(sources, option, tmp_path):
    files = unpack_sources(sources / "Pid.fmu", tmp_path)
    assert any("#error" in message(file, option) for file in files if file.name == "model.c")


@each_version
def test_an_instance_allocates_one_block_and_nothing_later(sources, version, tmp_path):
    machine, file = IN_C[0], sources / f"{stems(version)[1]}.fmu"
    counted = [f"-D{name}=counted_{name}" for name in ("malloc", "calloc", "realloc")]
    machine.objects([file], tmp_path, *counted)
    program, (fmu,) = machine.host(f"host{version}", [file], tmp_path, "-DCOUNT_ALLOCATIONS")
    run_scenarios(machine, program, fmu, ["one_allocation"])


# --- FMUs whose binaries are compiled from the sources --------------------------------------------


@each_fmu
def test_a_compiled_fmu_has_no_findings(built, name):
    found = findings(built / f"{name}.fmu")
    assert [finding for finding in found if "not tested: variables in" not in finding] == []


def test_the_native_master_gives_the_bits_of_the_binaries(built, table_results):
    with workers() as pool:
        results = simulate_all(table1.runs(), built, pool)
    for loop, columns in table_results.items():
        for name, column in columns.items():
            assert results[loop][name].tobytes() == column.tobytes(), (loop, name)


@each_version
@pytest.mark.parametrize("halves", ["binary first", "sources first"])
def test_binaries_and_sources_exchange_states(fmus, built, version, halves, tmp_path):
    """The second half of a run continues from the bytes of states of the first half."""
    files = [f"{model}{'_fmi3' * (version == '3')}.fmu" for model in MODELS]
    program, binaries = NATIVE.host(f"loop{version}", [fmus / file for file in files], tmp_path)
    folder = tmp_path / "built"
    compiled = [NATIVE.unpack(built / file, folder) for file in files]
    for loop in (Loop("Pid", "sine"), Loop("IpidRbf", "square", 1.0, "supervisor")):
        components = described_loop(replace(loop, fmi3=("all",) if version == "3" else ()), fmus)
        expected = run_loop(NATIVE, program, binaries, components, loop.steps, tmp_path / "results")
        first, second = (binaries, compiled) if halves == "binary first" else (compiled, binaries)
        libraries = dict(zip(files, (f">{fmu.library}" for fmu in second), strict=True))
        mixed = [(model, [*words, libraries[f"{model}.fmu"]]) for model, words in components]
        assert run_loop(NATIVE, program, first, mixed, loop.steps, tmp_path / "results") == expected


# --- as importers compile them --------------------------------------------------------------------


@each_version
@pytest.mark.parametrize(
    "options",
    [
        [],
        [f"-I{HEADERS}"],
        [f"-I{HEADERS}", "-DFMI3_OVERRIDE_FUNCTION_PREFIX"],
        [f"-I{HEADERS}", "-DFMI3_OVERRIDE_FUNCTION_PREFIX", "-DFMI3_ACTUAL_FUNCTION_PREFIX="],
    ],
    ids=["alone", "FMPy", "FMPy with CMake", "fmusim"],
)
def test_functions_have_the_names_of_the_standard(sources, version, options, tmp_path):
    """With the options of importers beyond the build description, which defines no macro."""
    file = sources / f"{stems(version)[0]}.fmu"
    (configuration,) = fmpy.read_model_description(file).buildConfigurations
    (files,) = configuration.sourceFileSets
    assert files.preprocessorDefinitions == []
    exported = symbols(interface(file, tmp_path), "T", *options)
    assert set(functions(version)) <= exported.keys()


@CMAKE.mark
@pytest.mark.parametrize("name", ["PidRbf", "PidRbf_fmi3"])
def test_fmpy_compiles_and_simulates_them(fmus, sources, name, tmp_path):
    file = shutil.copy(sources / f"{name}.fmu", tmp_path)
    command = [
        sys.executable,
        "-m",
        "fmpy",
        "compile",
        file,
        "--all-warnings",
        "--warning-as-error",
    ]
    subprocess.run(command, check=True)
    inputs = np.array([(0.0, 1.0), (0.5, -1.0)], [("time", float), ("r", float)])
    options = {"input": inputs, "output_interval": 1e-3, "stop_time": 1.0, "validate": True}
    ours, theirs = (fmpy.simulate_fmu(one, **options) for one in (file, fmus / f"{name}.fmu"))
    assert len(ours) == 1001
    assert ours.tobytes() == theirs.tobytes()
