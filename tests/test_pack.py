"""Systems as one FMU: `cargo fmu pack` and `System.pack`."""

import ctypes
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave

from native import call, in_c, printed, read_csv, write_system
from pendulum_fmus.project import PROGRAM, ROOT

LOOP = ROOT / "examples" / "closed-loop" / "pid.toml"
SAMPLED = ("controller.u", "controller.u_p", "controller.e")
"""Columns of a sampled component: a row of the system has them after its step, a host before."""


@pytest.fixture(scope="session")
def library(once: Callable[..., Path]) -> Path:
    """Build the master of containers as the program, so that both share their dependencies."""
    packages = "--workspace --exclude fmi-judge --exclude fuzz --exclude bench".split()
    command = ["cargo", "build", "--locked", *packages, "--lib"]
    once("libraries", lambda _: subprocess.run(command, cwd=ROOT, check=True))
    built = PROGRAM.with_name("libfmu_container.so")
    # A small one is packed sooner.
    strip = ["strip", "--strip-unneeded", built, "-o"]
    folder = once("stripped", lambda new: subprocess.run([*strip, new / built.name], check=True))
    return folder / built.name


@pytest.fixture(scope="session")
def pack(library: Path, fmus: Path) -> Callable[..., Path]:
    """Return a function that packs a system."""

    def run(system: Path, out: Path, *options: object) -> Path:
        command = [PROGRAM, "pack", system, "-o", out, "--fmus", fmus, *options]
        done = call([*command, "--binary", f"linux64={library}"], out.parent)
        assert done.returncode == 0, done.stderr
        return out

    return run


@pytest.fixture(scope="session")
def loops(pack: Callable[..., Path], once: Callable[..., Path]) -> dict[str, Path]:
    """Pack the loop of the paper for both versions of FMI."""

    def write(folder: Path) -> None:
        for version, name in [("2.0", "Loop"), ("3.0", "Loop_fmi3")]:
            pack(LOOP, folder / f"{name}.fmu", "--fmi", version)

    folder = once("loops", write)
    return {"2.0": folder / "Loop.fmu", "3.0": folder / "Loop_fmi3.fmu"}


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_container_has_no_errors(loops: dict[str, Path], version: str, tmp_path: Path) -> None:
    done = call([PROGRAM, "validate", "--quick", loops[version]], tmp_path)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_fmpy_gets_the_bits_of_the_system(
    loops: dict[str, Path], version: str, fmus: Path, tmp_path: Path
) -> None:
    csv = tmp_path / "loop.csv"
    command = [PROGRAM, "simulate", LOOP, "--fmus", fmus, "--stop", "2", "--csv", csv]
    done = call(command, tmp_path)
    assert done.returncode == 0, done.stderr
    expected = read_csv(csv)
    times = {"start_time": 0.001, "stop_time": 2.0}
    found = fmpy.simulate_fmu(str(loops[version]), output_interval=0.001, **times)
    assert len(found) == len(expected["time"])
    for name in found.dtype.names[1:]:
        shift = int(name in SAMPLED)
        rows = len(found) - shift
        np.testing.assert_array_equal(found[name][shift:], expected[name][:rows], name)
    # A step of the host has several of the system.
    coarse = fmpy.simulate_fmu(str(loops[version]), output_interval=0.01, **times)
    for name in coarse.dtype.names[1:]:
        np.testing.assert_array_equal(coarse[name], found[name][::10][: len(coarse)], name)


def instance(file: Path, folder: Path, log: list[str]) -> tuple[FMU2Slave, dict[str, int]]:
    """Return an instance of an unpacked container, and its value references."""
    model = fmpy.read_model_description(str(file), validate=True)
    unpacked = folder / file.stem
    if not unpacked.exists():
        fmpy.extract(str(file), str(unpacked))
    slave = FMU2Slave(
        guid=model.guid,
        unzipDirectory=str(unpacked),
        modelIdentifier=model.coSimulation.modelIdentifier,
        instanceName="container",
    )

    def logged(_: Any, __: bytes, status: int, category: bytes, form: bytes, text: bytes) -> None:
        assert form == b"%s"
        log.append(f"{status} {category.decode()}: {text.decode()}")

    callbacks = fmpy.fmi2.fmi2CallbackFunctions()
    # With the argument of the format, which the type in FMPy leaves out.
    with_text = ctypes.CFUNCTYPE(
        None,
        ctypes.c_void_p,
        ctypes.c_char_p,
        ctypes.c_int,
        *3 * [ctypes.c_char_p],
    )
    slave.logger = with_text(logged)  # type: ignore[attr-defined]
    callbacks.logger = ctypes.cast(slave.logger, fmpy.fmi2.fmi2CallbackLoggerTYPE)  # type: ignore[attr-defined]
    callbacks.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
    callbacks.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
    slave.instantiate(callbacks=callbacks)
    return slave, {variable.name: variable.valueReference for variable in model.modelVariables}


def initialize(slave: FMU2Slave, start: float = 0.001, stop: float | None = None) -> None:
    slave.setupExperiment(startTime=start, stopTime=stop)
    slave.enterInitializationMode()
    slave.exitInitializationMode()


def step(slave: FMU2Slave, k: int) -> None:
    slave.doStep(0.001 + 0.001 * k, 0.001)


def test_a_state_is_restored_with_all_fmus(loops: dict[str, Path], tmp_path: Path) -> None:
    slave, references = instance(loops["2.0"], tmp_path, [])
    all_outputs = [references[name] for name in ("plant.theta", "plant.x", "controller.u")]
    initialize(slave)
    for k in range(50):
        step(slave, k)
    saved = slave.getFMUstate()
    runs = []
    for _ in range(2):
        for k in range(50, 100):
            step(slave, k)
        runs.append(slave.getReal(all_outputs))
        slave.setFMUstate(saved)
    slave.freeFMUstate(saved)
    assert runs[0] == runs[1]
    slave.terminate()
    slave.freeInstance()


def test_parameters_act_as_start_values_of_the_system(
    loops: dict[str, Path], fmus: Path, tmp_path: Path
) -> None:
    csv = tmp_path / "loop.csv"
    changes = {"controller.pid.kp": 250.0, "source.amplitude": 0.5}
    options = [option for key, value in changes.items() for option in ("--set", f"{key}={value}")]
    command = [PROGRAM, "simulate", LOOP, "--fmus", fmus, "--stop", "0.5", "--csv", csv, *options]
    done = call(command, tmp_path)
    assert done.returncode == 0, done.stderr
    found = fmpy.simulate_fmu(
        str(loops["2.0"]),
        start_time=0.001,
        stop_time=0.5,
        output_interval=0.001,
        start_values=changes,
        output=["plant.theta"],
    )
    np.testing.assert_array_equal(found["plant.theta"], read_csv(csv)["plant.theta"])


def test_steps_that_do_not_fit_are_refused(loops: dict[str, Path], tmp_path: Path) -> None:
    log: list[str] = []
    slave, references = instance(loops["2.0"], tmp_path, log)
    initialize(slave, stop=0.01)
    for time, length, reason in [
        (
            0.001,
            0.0015,
            "the communication step is 0.0015 s, expected the step of the system, 0.001 s",
        ),
        (0.005, 0.001, "the step begins at t = 0.005 s, expected 0.001 s"),
        (0.001, 0.02, "expected at most the stop time, 0.01 s"),
    ]:
        with pytest.raises(Exception, match="error"):
            slave.doStep(time, length)
        assert reason in log[-1], log
    step(slave, 0)
    with pytest.raises(Exception, match="error"):
        slave.setReal([references["plant.theta"]], [1.0])
    assert "plant.theta cannot be set: it is neither an input nor a parameter" in log[-1]
    slave.freeInstance()


def test_two_instances_of_a_container_are_independent(
    loops: dict[str, Path], tmp_path: Path
) -> None:
    slaves = []
    for gain in (250.0, 350.0):
        slave, references = instance(loops["2.0"], tmp_path, [])
        slave.setReal([references["controller.pid.kp"]], [gain])
        initialize(slave)
        slaves.append(slave)
    for k in range(100):
        for slave in slaves:
            step(slave, k)
    theta = [slave.getReal([references["plant.theta"]]) for slave in slaves]
    assert theta[0] != theta[1]
    alone, _ = instance(loops["2.0"], tmp_path, [])
    alone.setReal([references["controller.pid.kp"]], [250.0])
    initialize(alone)
    for k in range(100):
        step(alone, k)
    assert alone.getReal([references["plant.theta"]]) == theta[0]
    for slave in (*slaves, alone):
        slave.freeInstance()


# --- what is exposed ------------------------------------------------------------------------------

FREE = """
start = 0.001
stop = 1.0
step = 0.001
connections = ["plant.theta -> controller.y", "controller.u -> plant.u"]

[[component]]
name = "controller"
fmu = "Pid.fmu"
start = { d = 0.25 }

[[component]]
name = "plant"
fmu = "Pendulum.fmu"
"""


def system(folder: Path, text: str) -> Path:
    file = folder / "system.toml"
    file.write_text(text)
    return file


def test_inputs_that_nothing_feeds_are_those_of_the_host(
    pack: Callable[..., Path], fmus: Path, tmp_path: Path
) -> None:
    container = pack(system(tmp_path, FREE), tmp_path / "Free.fmu")
    model = fmpy.read_model_description(str(container), validate=True)
    inputs = {v.name: v.start for v in model.modelVariables if v.causality == "input"}
    assert inputs == {"controller.r": "0", "controller.d": "0.25"}
    times = np.arange(1, 1001) * 0.001
    columns = [times, np.sin(times)]
    table = np.rec.fromarrays(columns, names=["time", "controller.r"])
    found = fmpy.simulate_fmu(
        str(container), start_time=0.001, stop_time=1.0, output_interval=0.001, input=table
    )
    rows = [
        f"{time!r},{value!r}" for time, value in zip(*map(np.ndarray.tolist, columns), strict=True)
    ]
    (tmp_path / "r.csv").write_text("\n".join(["time,controller.r", *rows]))
    csv = tmp_path / "free.csv"
    command = [PROGRAM, "simulate", tmp_path / "system.toml", "--fmus", fmus]
    done = call([*command, "--input", tmp_path / "r.csv", "--csv", csv], tmp_path)
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(found["plant.theta"], read_csv(csv)["plant.theta"])


def test_a_table_chooses_and_renames_what_is_exposed(
    pack: Callable[..., Path], tmp_path: Path
) -> None:
    text = FREE + (
        '[expose]\ninputs = ["controller.r"]\noutputs = ["plant.theta", "controller.y"]\n'
        'parameters = ["controller.pid.kp"]\n'
        'names = { "controller.pid.kp" = "gain", "controller.r" = "r" }\n'
    )
    container = pack(system(tmp_path, text), tmp_path / "Chosen.fmu")
    model = fmpy.read_model_description(str(container), validate=True)
    assert [(v.name, v.causality) for v in model.modelVariables] == [
        ("r", "input"),
        ("plant.theta", "output"),
        ("controller.y", "local"),
        ("gain", "parameter"),
    ]


def test_a_clocked_variable_keeps_its_value_until_the_next_tick(
    library: Path, tmp_path: Path
) -> None:
    # It ticks at 0, 0.25 and 0.5 s.
    in_c(tmp_path / "Ticker.fmu")
    keys: dict[str, Any] = {"outputs": ["a.value", "a.sent"], "stop": 0.6, "step": 0.1}
    file = write_system(tmp_path, {"a": {"received": False}}, fmu="Ticker", **keys)
    container = tmp_path / "Ticks.fmu"
    printed("pack", file, "-o", container, "--binary", f"linux64={library}")
    found = fmpy.simulate_fmu(str(container), stop_time=0.6, output_interval=0.1)
    # A host has a row of the system after the step that begins with it.
    assert list(found["a.sent"]) == [False, True, False, False, True, False, True]
    assert list(found["a.value"]) == [0.0] + [1.0] * 6


@pytest.mark.parametrize(
    ("expose", "reason"),
    [
        ('inputs = ["controller.y"]', "controller.y cannot be exposed: it is connected"),
        ('parameters = ["plant.mass"]', "plant.mass: Pendulum.fmu has no variable mass"),
        ('names = { "controller.r" = "plant.x" }', "both have the name plant.x in the container"),
        ('names = { "plant.z" = "z" }', "expose.names: plant.z is not exposed"),
        ("other = 1", "unknown field `other`"),
    ],
)
def test_mistakes_in_what_is_exposed_are_named(
    fmus: Path, library: Path, tmp_path: Path, expose: str, reason: str
) -> None:
    file = system(tmp_path, f"{FREE}\n[expose]\n{expose}\n")
    command = [PROGRAM, "pack", file, "--fmus", fmus, "--binary", f"linux64={library}"]
    done = call(command, tmp_path)
    assert done.returncode == 1
    assert reason in done.stderr
    assert not list(tmp_path.glob("*.fmu"))


def test_a_platform_that_an_fmu_lacks_is_named(fmus: Path, tmp_path: Path) -> None:
    command = [PROGRAM, "pack", LOOP, "--fmus", fmus, "--target", "x86_64-pc-windows-gnu"]
    done = call(command, tmp_path)
    assert done.returncode == 1
    assert "controller: Pid.fmu has no binary for win64, only for linux64" in done.stderr


# --- any FMUs -------------------------------------------------------------------------------------

INNER = r"""
#include <stdlib.h>
#include <string.h>
#define REAL(name) int name(void* c, const unsigned* r, size_t n, double* v)
typedef struct { double x, u; } M;
static int instances = 0;
const char* fmi2GetVersion(void) { return "2.0"; }
const char* fmi2GetTypesPlatform(void) { return "default"; }
void* fmi2Instantiate(const char* n, int t, const char* g, const char* r, const void* f, int v,
                      int l) {
  instances++;
  return calloc(1, sizeof(M));
}
void fmi2FreeInstance(void* c) { free(c); }
int fmi2SetupExperiment(void* c, int a, double b, double d, int e, double f) { return 0; }
int fmi2EnterInitializationMode(void* c) { return 0; }
int fmi2ExitInitializationMode(void* c) { return 0; }
int fmi2Terminate(void* c) { return 0; }
int fmi2Reset(void* c) { return 0; }
REAL(fmi2GetReal) {
  for (size_t i = 0; i < n; i++) v[i] = r[i] ? ((M*)c)->x : ((M*)c)->u;
  return 0;
}
int fmi2SetReal(void* c, const unsigned* r, size_t n, const double* v) {
  for (size_t i = 0; i < n; i++) *(r[i] ? &((M*)c)->x : &((M*)c)->u) = v[i];
  return 0;
}
/* By its own functions, which must not be those of the container or of the other FMU. */
int fmi2DoStep(void* c, double t, double h, int p) {
  unsigned both[2] = {0, 1};
  double values[2];
  if (fmi2GetReal(c, both, 2, values)) return 3;
  values[1] += h * (FACTOR * values[0] + 1);
  if (values[1] > 1e3) return 3;
  return fmi2SetReal(c, both + 1, 1, values + 1);
}
"""

XML = """<?xml version="1.0"?>
<fmiModelDescription fmiVersion="2.0" modelName="NAME" guid="{1}">
  <CoSimulation modelIdentifier="NAME" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="x" valueReference="1" causality="output" initial="exact">
      <Real start="0"/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs><Unknown index="2"/></Outputs></ModelStructure>
</fmiModelDescription>
"""


def compile_fmu(folder: Path, name: str, factor: int) -> Path:
    """Compile an FMU in C whose step calls its own functions of FMI by their names."""
    unpacked = folder / name
    binaries = unpacked / "binaries" / "linux64"
    binaries.mkdir(parents=True)
    (unpacked / "modelDescription.xml").write_text(XML.replace("NAME", name))
    source = unpacked / "fmu.c"
    source.write_text(INNER)
    command = [
        "cc",
        "-shared",
        "-fPIC",
        f"-DFACTOR={factor}",
        source,
        "-o",
        binaries / f"{name}.so",
    ]
    subprocess.run(command, check=True)
    source.unlink()
    archive = shutil.make_archive(str(folder / name), "zip", unpacked)
    return Path(archive).rename(folder / f"{name}.fmu")


PAIR = """
stop = 1.0
step = 0.1
connections = ["a.x -> b.u", "b.x -> c.u"]
[[component]]
name = "a"
fmu = "A.fmu"
[[component]]
name = "b"
fmu = "B.fmu"
[[component]]
name = "c"
fmu = "A.fmu"
"""


@pytest.fixture(scope="module")
def nested(library: Path, once: Callable[..., Path]) -> Path:
    """Pack FMUs that call their own functions, twice the same, and the container in another."""

    def write(folder: Path) -> None:
        compile_fmu(folder, "A", 2)
        compile_fmu(folder, "B", 3)
        pairs = [("pair.toml", PAIR, "Pair.fmu"), ("outer.toml", OUTER, "Outer.fmu")]
        for name, text, out in pairs:
            (folder / name).write_text(text)
            command = [PROGRAM, "pack", folder / name, "-o", folder / out]
            done = call([*command, "--binary", f"linux64={library}"], folder)
            assert done.returncode == 0, done.stderr

    return once("nested", write)


OUTER = """
stop = 1.0
step = 0.1
connections = ["inner.c.x -> b.u"]
[[component]]
name = "inner"
fmu = "Pair.fmu"
[[component]]
name = "b"
fmu = "B.fmu"
"""


def closed_form(factors: list[int], steps: int, u: float) -> list[float]:
    """Return what a chain of the FMUs computes, one after the other, in floating-point numbers."""
    x = [0.0] * len(factors)
    for _ in range(steps):
        value = u
        for i, factor in enumerate(factors):
            x[i] += 0.1 * (factor * value + 1)
            value = x[i]
    return x


@pytest.mark.parametrize("mode", [ctypes.RTLD_LOCAL, ctypes.RTLD_GLOBAL])
def test_fmus_call_their_own_functions_also_in_nested_containers(
    nested: Path, tmp_path: Path, mode: int
) -> None:
    """Also if the host lets all libraries see the functions of the container."""
    unpacked = tmp_path / "Outer"
    fmpy.extract(str(nested / "Outer.fmu"), str(unpacked))
    library = unpacked / "binaries" / "linux64" / "Outer.so"
    # In a process of its own, as libraries that are loaded globally stay so.
    program = f"import ctypes\nctypes.CDLL({str(library)!r}, mode={mode})\n" + HOST
    arguments = [str(nested / "Outer.fmu"), str(unpacked)]
    python = [sys.executable, "-c", program, *arguments]
    done = subprocess.run(python, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = [float(text) for text in done.stdout.split()]
    assert found == closed_form([2, 3, 2, 3], 10, 0.5)[2:]


HOST = """
import sys, fmpy
from fmpy.fmi2 import FMU2Slave
model = fmpy.read_model_description(sys.argv[1])
references = {v.name: v.valueReference for v in model.modelVariables}
slave = FMU2Slave(
    guid=model.guid, unzipDirectory=sys.argv[2],
    modelIdentifier=model.coSimulation.modelIdentifier, instanceName="outer",
)
slave.instantiate()
slave.setReal([references["inner.a.u"]], [0.5])
slave.setupExperiment(startTime=0.0)
slave.enterInitializationMode()
slave.exitInitializationMode()
for k in range(10):
    slave.doStep(0.1 * k, 0.1)
print(*slave.getReal([references["inner.c.x"], references["b.x"]]))
slave.terminate()
slave.freeInstance()
"""


def test_a_failure_names_the_component(nested: Path, tmp_path: Path) -> None:
    log: list[str] = []
    slave, references = instance(nested / "Pair.fmu", tmp_path, log)
    initialize(slave, start=0.0)
    slave.setReal([references["a.u"]], [1e6])
    with pytest.raises(Exception, match="error"):
        slave.doStep(0.0, 0.1)
    assert log[-1].startswith("3 logStatusError: fmi2DoStep: a (A), step of 0.1 s at t = 0.0 s: ")
    slave.reset()
    initialize(slave, start=0.0)
    slave.doStep(0.0, 0.1)
    assert slave.getReal([references["a.x"]]) == [0.1]
    slave.freeInstance()


def test_what_cannot_be_saved_is_said(nested: Path, library: Path) -> None:
    command = [PROGRAM, "pack", nested / "pair.toml", "-o", nested / "Again.fmu"]
    done = call([*command, "--binary", f"linux64={library}"], nested)
    assert "note: hosts cannot save its state: a (A.fmu): " in done.stderr
    model = fmpy.read_model_description(str(nested / "Again.fmu"))
    assert not model.coSimulation.canGetAndSetFMUstate


def test_the_python_module_packs_the_same_file(nested: Path, library: Path, tmp_path: Path) -> None:
    from fmu_master import FmuError, System

    pair = System(nested / "pair.toml")
    pair.pack(tmp_path / "Pair.fmu", binaries={"linux64": library})
    assert (tmp_path / "Pair.fmu").read_bytes() == (nested / "Pair.fmu").read_bytes()
    with pytest.raises(FmuError, match=r'fmi = "1\.0", expected'):
        pair.pack(tmp_path / "Other.fmu", fmi="1.0", binaries={"linux64": library})


def test_an_ssp_package_becomes_a_container(
    pack: Callable[..., Path], nested: Path, library: Path, tmp_path: Path
) -> None:
    done = call([PROGRAM, "ssp", nested / "pair.toml", "--out", tmp_path], tmp_path)
    assert done.returncode == 0, done.stderr
    command = [PROGRAM, "pack", tmp_path / "pair.ssp", "-o", tmp_path / "Package.fmu"]
    done = call([*command, "--binary", f"linux64={library}"], tmp_path)
    assert done.returncode == 0, done.stderr
    found = fmpy.simulate_fmu(str(tmp_path / "Package.fmu"), stop_time=1.0, output_interval=0.1)
    # A package steps in parallel.
    x = [0.0] * 3
    for _ in range(10):
        inputs = [0.0, *x[:2]]
        x = [x[i] + 0.1 * ((2, 3, 2)[i] * inputs[i] + 1) for i in range(3)]
    assert [found[f"{name}.x"][-1] for name in "abc"] == x
