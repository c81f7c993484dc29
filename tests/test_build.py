"""`cargo fmu build` and `--compile`: FMUs of others as C sources.

`crates/fmu-compile/tests` has what descriptions may say, and hostile ones.
"""

import os
import re
import signal
import subprocess
import time
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.template import create_fmu, generate_model_description

from fmu_master import FmuError, Instance, System, simulate
from native import SOURCES, printed, read, read_csv, refusal, run, write, write_system
from pendulum_fmus.project import PROGRAM

DECAY = {
    path.relative_to(SOURCES / "decay").as_posix(): path.read_text(encoding="utf-8")
    for path in sorted((SOURCES / "decay").rglob("*.*"))
}
"""The files of the FMU Decay, as another tool would export it."""

BINARIES = {2: "binaries/linux64/Decay.so", 3: "binaries/x86_64-linux/Decay.so"}

VERSIONS = pytest.mark.parametrize("version", [2, 3])


def decay(file: Path, version: int, **changes: str | None) -> Path:
    """Write Decay with its sources only; `None` leaves a file out."""
    names = {2: ["all.c"], 3: ["buildDescription.xml", "include/decay.h"]}[version]
    sources = {name: DECAY[name] for name in ["decay.c", "derivative.c", "stubs.c", *names]}
    if version == 2:
        sources["decay.h"] = DECAY["include/decay.h"]
    sources |= {name.replace("__", "."): text for name, text in changes.items()}
    files = {f"sources/{name}": text for name, text in sources.items() if text is not None}
    description = {"modelDescription.xml": DECAY[f"fmi{version}.xml"]}
    return write(file, {**description, **files, "resources/note.txt": "kept"})


def expected(k: float, step: float = 0.125, steps: int = 8) -> np.ndarray:
    """Return the solution of Euler's method."""
    return (1 - k * step) ** np.arange(steps + 1)


def columns(file: Path, *options: object) -> dict[str, np.ndarray]:
    """Return the results of a run."""
    table = file.with_suffix(".csv")
    printed("simulate", file, "--csv", table, *options)
    return read_csv(table)


@VERSIONS
def test_a_built_fmu_runs_in_fmpy_and_is_otherwise_unchanged(version: int, tmp_path: Path) -> None:
    fmu = decay(tmp_path / "Decay.fmu", version)
    before = read(fmu)
    text = printed("build", fmu)
    assert text.startswith(str(fmu)), text
    after = read(fmu)
    assert after.pop(BINARIES[version])[:4] == b"\x7fELF"
    assert after == before
    times = {"stop_time": 1.0, "output_interval": 0.125}
    theirs = fmpy.simulate_fmu(fmu, start_values={"k": 2.0}, **times)
    np.testing.assert_allclose(theirs["x"], expected(2.0), rtol=1e-14)
    ours = columns(fmu, "--set", "k=2")
    np.testing.assert_array_equal(ours["x"], theirs["x"])


@VERSIONS
def test_an_fmu_without_binary_is_compiled_for_a_run(version: int, tmp_path: Path) -> None:
    fmu = decay(tmp_path / "Decay.fmu", version)
    before = fmu.read_bytes()
    assert "--compile compiles them" in refusal(tmp_path, "simulate", fmu)
    np.testing.assert_allclose(columns(fmu, "--compile")["x"], expected(1.0), rtol=1e-14)
    system = write_system(tmp_path, {"a": {"k": 2.0}, "b": {"k": 4.0}}, fmu="Decay", step=0.125)
    text = printed("simulate", system, "--compile", "--csv", tmp_path / "both.csv")
    assert "compiled from sources: a, b" in text
    results = read_csv(tmp_path / "both.csv")
    np.testing.assert_allclose(results["a.x"], expected(2.0), rtol=1e-14)
    np.testing.assert_allclose(results["b.x"], expected(4.0), rtol=1e-14)
    assert fmu.read_bytes() == before


def test_a_sweep_compiles(tmp_path: Path) -> None:
    decay(tmp_path / "Decay.fmu", 3)
    write_system(tmp_path, {"a": {}}, fmu="Decay", step=0.125)
    sweep = tmp_path / "sweep.toml"
    sweep.write_text(
        'system = "system.toml"\n[signals]\nreference = "a.k"\noutput = "a.x"\nerror = "a.x"\n'
        'control = "a.x"\n[[parameter]]\nvariable = "a.k"\nvalues = [1.0, 2.0]\n'
    )
    out = tmp_path / "out.csv"
    assert "--compile compiles them" in run("sweep", sweep, "--out", out).stderr
    assert "2 runs in" in printed("sweep", sweep, "--out", out, "--compile")


@VERSIONS
def test_python_compiles(version: int, tmp_path: Path) -> None:
    fmu = decay(tmp_path / "Decay.fmu", version)
    with pytest.raises(FmuError, match="but sources; `compile=True` compiles them"):
        simulate(fmu)
    for here in (False, True):
        result = simulate(fmu, start_values={"k": 2.0}, compile=True, in_process=here)
        np.testing.assert_allclose(result["x"], expected(2.0), rtol=1e-14)
        with Instance(fmu, compile=True, in_process=here) as instance:
            instance.step(0.5)
            assert instance.get("x") == 0.5
    with System(components={"a": fmu}, step=0.125, stop=1.0).loaded() as system:
        for k in (1.0, 2.0):
            result = system.simulate({"a.k": k}, compile=True)
            np.testing.assert_allclose(result["a.x"], expected(k), rtol=1e-14)


def test_the_validator_runs_what_it_compiles(tmp_path: Path) -> None:
    fmu = decay(tmp_path / "Decay.fmu", 3)
    binary = BINARIES[3]
    assert binary not in run("validate", "--quick", fmu).stdout
    assert f"{fmu}: error: {binary}: " in run("validate", "--quick", "--compile", fmu).stdout


def test_an_fmu_of_fmpy_is_built(tmp_path: Path) -> None:
    fmu = tmp_path / "Model.fmu"
    create_fmu(generate_model_description(), fmu)
    printed("build", fmu)
    result = fmpy.simulate_fmu(fmu, start_values={"u5": 5.0}, output=["u5"])
    assert np.all(result["u5"] == 5.0)


BROKEN = [
    ({"decay__c": "int a = b;\n"}, "sources/decay.c cannot be compiled: .*\n.*decay.c:1"),
    ({"derivative__c": None}, 'the source file "sources/derivative.c" is missing'),
    ({"derivative__c": "int a;\n"}, r"Decay.so cannot be linked: .*\n(.*\n)*.*derivative"),
    ({"buildDescription__xml": None}, "it has no sources/buildDescription.xml"),
]


@pytest.mark.parametrize(("changes", "reason"), BROKEN)
def test_sources_that_do_not_compile_leave_everything_as_it_is(
    changes: dict, reason: str, tmp_path: Path
) -> None:
    fmu = decay(tmp_path / "Decay.fmu", 3, **changes)
    for command in (["build", fmu], ["simulate", "--compile", fmu]):
        assert re.search(reason, refusal(tmp_path, *command))


@pytest.mark.parametrize(
    ("environment", "program"),
    [({"PATH": ""}, "neither cc, gcc nor clang"), ({"CC": "no-cc"}, "CC is no-cc, which")],
)
def test_a_missing_compiler_is_named_with_its_package(
    environment: dict, program: str, tmp_path: Path
) -> None:
    fmu = decay(tmp_path / "Decay.fmu", 2)
    result = run("build", fmu, env=os.environ | environment)
    assert result.returncode == 1
    assert f"there is no C compiler on this machine ({program}" in result.stderr
    assert "apt-get install gcc" in result.stderr


def test_ctrl_c_stops_the_compiler(tmp_path: Path) -> None:
    twice = "".join(f"#define M{n + 1} M{n} M{n}\n" for n in range(60))
    fmu = decay(tmp_path / "Decay.fmu", 2, all__c=f"{twice}int a = M60;\n")
    before, temporary = fmu.read_bytes(), tmp_path / "temporary"
    temporary.mkdir()
    environment = os.environ | {"TMPDIR": str(temporary)}
    with subprocess.Popen(
        [PROGRAM, "build", fmu], env=environment, stderr=subprocess.PIPE, text=True
    ) as process:
        while not list(temporary.glob("**/objects/0.txt")):
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGINT, errors
    assert f"interrupted; {fmu} was not written" in errors
    assert fmu.read_bytes() == before
    assert not list(temporary.iterdir())
