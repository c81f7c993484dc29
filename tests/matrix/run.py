"""Runs the FMUs in other importers and writes the results to docs/importers.md: `make importers`.

FMPy is that of the test environment, as are the importers of SSP packages, and `fmi-sim` is in
target/tools. All others run as scripts, each in an environment of its own, since they require
conflicting packages; `uv` installs what a script names in its first lines.
"""

import csv
import json
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import NamedTuple
from zipfile import ZipFile

import fmpy
import numpy as np

import importers
import reference
from native import run, simulate
from pendulum_fmus.loop import Loop
from pendulum_fmus.master import simulate as couple
from pendulum_fmus.project import FMUS, ROOT
from test_container import Inside, container

HERE = Path(__file__).parent
FMI_SIM = ROOT / "target" / "tools" / "bin" / "fmi-sim"
PAGE = ROOT / "docs" / "importers.md"
STEP = 0.001
SHORT, LONG = 500, 5000
PACKAGES = ["pid", "pid-rbf", "ipid-rbf", "supervised"]
CASES = {
    "plant": "pendulum alone",
    "driven": "pendulum in the loop",
    "controller": "controller in the loop",
    "loop": "loop",
    "pid": "loop with PID",
    "ssp": "SSP packages",
}

FMI = {"2.0": "", "3.0": "_fmi3"}
"""The endings of the names of FMUs."""

CS, EVENTS, ME = "co-simulation", "co-simulation, event mode", "model exchange"

SCRIPTS = {
    "libcosim": ("with_libcosim.py", {CS: ["loop"]}),
    "Ecos": ("with_ecos.py", {CS: ["loop"]}),
    "PathSim": ("with_pathsim.py", {CS: ["plant", "loop", "pid"], ME: ["plant", "loop", "pid"]}),
    "CoFMUPy": ("with_cofmupy.py", {CS: ["plant", "loop"]}),
    "SOFIRpy": ("with_sofirpy.py", {CS: ["plant", "loop"]}),
    "FMU Manipulation Toolbox": (
        "with_fmu_manipulation_toolbox.py",
        {CS: ["loop", "pid"], ME: ["loop", "pid"]},
    ),
    "SysSimX": ("with_syssimx.py", {CS: ["loop"]}),
    "fmuloader": ("with_fmuloader.py", {CS: ["plant", "loop"], ME: ["plant", "loop"]}),
    "CasADi": ("with_casadi.py", {ME: ["plant"]}),
    "GEMSEO": ("with_gemseo_fmu.py", {CS: ["plant"], ME: ["plant"]}),
    "estim8": ("with_estim8.py", {CS: ["plant"], ME: ["plant"]}),
    "FMUGym": ("with_fmugym.py", {CS: ["plant"]}),
}
"""By importer: its script, whose first requirement is the importer, and what it runs."""

OTHERS = {"OMSimulator": "3.0.0.post198", "mosaik-fmi": "1.1.0.post0", "PyFMI": "2.5"}
"""Packages that did not install when this was written; it is tried again."""


class Row(NamedTuple):
    """A line of the table."""

    importer: str
    version: str
    kind: str
    case: str
    result: str
    fmi: str


def rows(folder: Path) -> Iterator[Row]:
    """Run everything; temporary files are in the folder."""
    for kind, case, fmi in parts():
        result = compare(by_fmpy(kind, case, fmi), case)
        yield Row("FMPy, `simulate_fmu`", version("fmpy"), kind, CASES[case], result, fmi)
    for fmi in FMI:
        result = compare(by_container(fmi, folder), "loop")
        yield Row("FMPy, container FMU", version("fmpy"), CS, CASES["loop"], result, fmi)
    told = subprocess.run([FMI_SIM, "--version"], capture_output=True, text=True, check=False)
    pinned = re.search(r"fmi-sim ([\d.]+)", told.stdout + told.stderr)[1]
    result = by_fmi_sim(CS, "plant", FMUS / "Pendulum_fmi3.fmu", folder)
    yield Row("fmi-sim", pinned, CS, CASES["plant"], result, "3.0")
    for kind, case, fmi in parts():
        file, used = FMUS / f"{PARTS[case][0]}{FMI[fmi]}.fmu", fmi
        if fmi == "3.0":
            file, used = without_units(file, folder), "3.0 without units"
        yield Row("fmi-sim", pinned, kind, CASES[case], by_fmi_sim(kind, case, file, folder), used)
    for name, (script, runs) in SCRIPTS.items():
        pinned = re.search(r"[\w-]+==([\w.]+)", (HERE / script).read_text())[1]
        for kind, cases in runs.items():
            for case, fmi in product(cases, FMI):
                result = by_script(script, kind, case, fmi, folder)
                yield Row(name, pinned, kind, CASES[case], result, fmi)
    for name, (package, importer) in {
        "FMPy": ("fmpy", importers.by_fmpy),
        "libcosim": ("libcosimpy", importers.by_libcosim),
        "Ecos": ("ecospy", importers.by_ecos),
    }.items():
        yield Row(name, version(package), CS, CASES["ssp"], packages(importer, folder), "2.0")
    for name, pinned in OTHERS.items():
        yield Row(name, pinned, "", "installation", installed(name, pinned), "")


# --- what is expected -----------------------------------------------------------------------------


@cache
def loop(order: str, controller: str = "IpidRbf") -> dict[str, np.ndarray]:
    """Return all outputs of the loop that FMPy steps."""
    with Loop(controller, previous_sample_terms=False).system(FMUS) as system:
        return couple(system, 0.0, STEP, LONG + 1, order=order)


@cache
def expected(case: str) -> dict[str, np.ndarray]:
    """Return what the result may be: angles [rad], or the force [N] of the controller."""
    if case in ("loop", "pid"):
        model = "Pid" if case == "pid" else "IpidRbf"
        orders = ("parallel", "sequential")
        return {f"FMPy, {order}": loop(order, model)["plant.theta"] for order in orders}
    if case == "controller":
        return {"the loop": recorded("controller.u")}
    A, B = reference.linear_model()
    euler = angle(np.eye(4) + STEP * A, STEP * B, force := forces(case))
    if case == "plant":
        times = STEP * np.arange(SHORT + 1)
        exact = [reference.linear_response((0, 0, 0, 0), 1.0, t)[2] for t in times]
        return {"the exact solution": np.array(exact), "Euler's method": euler}
    late = angle(*reference.hold(STEP), np.concatenate([force[:1], force[:-1]]))
    return {
        "the loop": recorded("plant.theta"),
        "the plant with the force one step late": late,
        "Euler's method": euler,
    }


def recorded(name: str) -> np.ndarray:
    """Return the first values of a variable of the loop with PID."""
    return loop("sequential", "Pid")[name][: SHORT + 1]


def forces(case: str) -> np.ndarray:
    """Return the force [N] on the pendulum in each step."""
    return np.ones(SHORT + 1) if case == "plant" else recorded("controller.u")


def angle(A: np.ndarray, B: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return the angle [rad] of the pendulum from its difference equation."""
    states = [np.zeros(4)]
    for u in force[:-1]:
        states.append(A @ states[-1] + B * u)
    return np.array(states)[:, 2]


def inputs(case: str) -> np.ndarray | None:
    """Return what the part of the loop receives, in columns by name, held from sample to sample.

    The force jumps at the samples, the inputs of the controller between them.
    """
    names, late = {
        "plant": ({}, 0),
        "driven": ({"u": "controller.u"}, 0),
        "controller": ({"r": "source.r", "d": "source.d", "y": "plant.theta"}, 0.5),
    }[case]
    if not names:
        return None
    jumps = STEP * (np.arange(1, SHORT + 1) - late)
    times = np.concatenate([[0], np.repeat(jumps, 2), [STEP * (SHORT + 1)]])
    values = [np.repeat(recorded(name), 2) for name in names.values()]
    return np.rec.fromarrays([times, *values], names=["time", *names])


def at_points(times: Sequence[float], values: Sequence[float]) -> np.ndarray:
    """Return the last value at each communication point."""
    points = STEP * np.arange(SHORT + 1) + 1e-6 * STEP
    return np.asarray(values)[np.searchsorted(times, points) - 1]


def compare(found: Sequence[float], case: str) -> str:
    """Describe the result by what it is closest to, in time or one step late."""
    differences = {}
    for name, values in expected(case).items():
        for late in (0, 1):
            own = np.asarray(found, float)[late:]
            size = min(len(own), len(values) - late)
            if size < len(values) - 2:
                return f"{len(found)} values, expected {len(values)}"
            differences[name, late] = np.max(np.abs(own[:size] - values[:size]))
    (name, late), difference = min(differences.items(), key=lambda item: (item[1], item[0][1]))
    unit = "N" if case == "controller" else "rad"
    said = f"{difference:.1e} {unit} from" if difference else "same bits as"
    return f"{said} {name}{', one step late' * late}"


# --- the importers --------------------------------------------------------------------------------

PARTS = {
    "plant": ("Pendulum", "theta"),
    "driven": ("Pendulum", "theta"),
    "controller": ("Pid", "u"),
}
"""By case with a single FMU: the model and the output to compare."""


def parts() -> Iterator[tuple[str, str, str]]:
    """Yield kind, case and version of FMI."""
    for part in product([CS, EVENTS, ME], PARTS, FMI):
        if part[0] != EVENTS or part[2] == "3.0":
            yield part


def by_fmpy(kind: str, case: str, fmi: str) -> np.ndarray:
    """Simulate one FMU; CVode integrates with a tolerance of 1e-12."""
    model, output = PARTS[case]
    results = fmpy.simulate_fmu(
        FMUS / f"{model}{FMI[fmi]}.fmu",
        fmi_type="ModelExchange" if kind == ME else "CoSimulation",
        stop_time=SHORT * STEP,
        output_interval=STEP,
        relative_tolerance=1e-12 if kind == ME else None,
        start_values={"u": 1.0} if case == "plant" else {},
        input=inputs(case),
        output=[output],
        use_event_mode=kind == EVENTS,
        early_return_allowed=kind == EVENTS,
    )
    return at_points(results["time"], results[output])


def by_container(fmi: str, folder: Path) -> np.ndarray:
    """Simulate a container FMU, of FMI 2.0, with the loop of FMUs of either version."""
    models = {"source": "Source", "controller": "IpidRbf", "plant": "Pendulum"}
    inside = Inside(FMUS, {name: model + FMI[fmi] for name, model in models.items()})
    with Loop("IpidRbf", "step").system(FMUS) as system:
        connections = system.connections
    (own := folder / f"container-{fmi}").mkdir()
    path = container(inside, connections, ["plant.theta"], {}, own)
    times = {"stop_time": LONG * STEP, "step_size": STEP, "output_interval": STEP}
    return fmpy.simulate_fmu(path, **times)["plant.theta"]


def by_fmi_sim(kind: str, case: str, fmu: Path, folder: Path) -> str:
    """Simulate one FMU with the program `fmi-sim`; return the comparison or the message."""
    columns, given, file = inputs(case), folder / "inputs.csv", folder / "fmi-sim.csv"
    command = [FMI_SIM, "--model", fmu, "-o", file]
    if columns is not None:
        names = ",".join(columns.dtype.names)
        np.savetxt(given, columns.tolist(), "%.17g", ",", header=names, comments="")
        command += ["-i", given]
    command.append("model-exchange" if kind == ME else "co-simulation")
    if kind == EVENTS:
        command += ["--event-mode-used", "--early-return-allowed"]
    if case == "plant":
        command += ["--init-values", "u=1"]
    command += ["--output-interval", str(STEP), "-f", str(SHORT * STEP)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return failure(done.returncode, done.stderr.partition("\n\nStack backtrace")[0])
    with file.open() as lines:
        rows = [(float(row["time"]), float(row[PARTS[case][1]])) for row in csv.DictReader(lines)]
    return compare(at_points(*zip(*rows, strict=True)), case)


def without_units(fmu: Path, folder: Path) -> Path:
    """Copy an FMU of FMI 3.0 without the attributes of variables that `fmi-sim` does not know."""
    with ZipFile(fmu) as given, ZipFile(folder / fmu.name, "w") as written:
        for entry in given.infolist():
            content = given.read(entry)
            if entry.filename == "modelDescription.xml":
                start = content.index(b"<ModelVariables>")
                units = re.sub(rb' (unit|displayUnit|nominal)="[^"]*"', b"", content[start:])
                content = content[:start] + units
            written.writestr(entry, content)
    return folder / fmu.name


def packages(importer: Callable, folder: Path) -> str:
    """Run the SSP packages and compare the angles with those of `cargo fmu simulate`."""
    systems = [ROOT / "examples" / "ssp" / f"{name}.toml" for name in PACKAGES]
    written = run("ssp", *systems, "--out", folder)
    assert written.returncode == 0, written.stderr
    largest = 0.0
    for system in systems:
        ours = simulate(system, folder)["plant.theta"]
        theirs = importer(folder / f"{system.stem}.ssp", STEP, len(ours) - 1)["plant.theta"]
        largest = max(largest, np.max(np.abs(theirs - ours[:-1])))
    same = "same bits" if largest == 0 else f"differ by up to {largest:.1e} rad"
    return f"all {len(systems)}: {same} as `cargo fmu simulate`"


def by_script(script: str, kind: str, case: str, fmi: str, folder: Path) -> str:
    """Run a script in an environment of its own; return the comparison or the message."""
    file = folder / "results.json"
    steps = SHORT if case == "plant" else LONG
    done = uv("run", "--script", HERE / script, kind, case, FMUS, FMI[fmi], steps, file)
    if done.returncode:
        return failure(done.returncode, done.stderr)
    return compare(json.loads(file.read_text()), case)


def installed(package: str, pinned: str) -> str:
    """Try to install a package."""
    done = uv("run", "--no-project", "--with", f"{package}=={pinned}", "python", "-c", "")
    return failure(done.returncode, done.stderr) if done.returncode else "succeeds; not run"


def uv(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run uv with this Python."""
    head = [sys.executable, "-m", "uv", "--quiet"]
    command = [*head, arguments[0], "--python", sys.executable, *arguments[1:]]
    return subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, check=False
    )


def failure(code: int, text: str) -> str:
    """Return the signal or the last line, without folders, hints and destructors, for a table."""
    text = re.split(r"\nhint:|\nException ignored", text)[0]
    lines = [line.strip(" │╰─▶├×") for line in text.splitlines()]
    last = ([line for line in lines if line] or ["no message"])[-1]
    if code > 128:
        last = signal.strsignal(code - 128)
    last = re.sub(r"(?<![\w./:])/(?:[\w.-]+/)+", "", last)
    return f"fails: `{last[:120].replace('|', '/').replace('`', '')}`"


# --- the page -------------------------------------------------------------------------------------

HEAD = f"""# Importers

`make importers` runs the FMUs of FMI 2.0 and 3.0 in the importers below, each in the version given, and
writes this page; the numbers are not edited by hand. The tests run FMPy, libcosim and Ecos on every change.

| Run | |
|---|---|
| {CASES["plant"]} | `Pendulum` under a constant force of 1 N for 0.5 s in steps of 1 ms, against the matrix exponential |
| {CASES["driven"]} | `Pendulum` for 0.5 s under the force of a loop with `Pid`, which jumps at each sample, against the angle in this loop, stepped sequentially |
| {CASES["controller"]} | `Pid` for 0.5 s with the inputs of the same loop, held around each sample, against its force |
| {CASES["loop"]} | `Source`, `IpidRbf` and `Pendulum` for 5 s in steps of 1 ms, against the same loop stepped by FMPy in the order that the importer uses |
| {CASES["pid"]} | the same with `Pid`, which has no arrays, for importers that refuse `IpidRbf` of FMI 3.0 |
| {CASES["ssp"]} | `{"`, `".join(f"{name}.ssp" for name in PACKAGES)}` for 20 s, against `cargo fmu simulate` |

A controller takes a sample at the communication point itself in model exchange and in event mode;
in other co-simulation its output is seen one step later.

| Importer | Version | FMI | Kind | Run | Result |
|---|---|---|---|---|---|
"""  # noqa: E501

TAIL = """
PathSim, CoFMUPy, SOFIRpy, SysSimX, GEMSEO, estim8 and FMUGym call FMUs through FMPy. The
observations of FMUGym have single precision.

**Model exchange.** FMPy, CasADi and estim8 integrate with CVODE, PathSim with a Runge-Kutta method.
The block of PathSim for model exchange needs continuous states, so the controller of its loop is
for co-simulation. fmuloader has no master or solver: its script couples plant and controller by
model exchange. The container of the FMU Manipulation Toolbox does so itself, with a Runge-Kutta
method; it prefers co-simulation, so `CoSimulation` was removed from the XML. GEMSEO calls FMPy in a
way that is for co-simulation only.

**fmi-sim** is a program for one FMU, with Euler's method as its only solver. It refuses `unit` and
`displayUnit` of variables of FMI 3.0, which the standard allows: its parser (`impl_float_type` in
`src/fmi3/variable/mod.rs` of `fmi-schema` 0.8) lacks them and rejects unknown attributes. Without
them in the XML, the same binaries run. Where an input jumps, it sets the value before the jump at
the start of a step (`apply_input` with `after_event = false` in `src/sim/fmi2/cs.rs`, and in
`src/sim/fmi3/cs.rs` with event mode), also if the jump was handled as an event before; so inputs
arrive late there.

**FMI 3.0.** CoFMUPy and GEMSEO install versions of FMPy that do not know `description` of a type.
PathSim reads the array `rbf.w` as a scalar, and the FMU Manipulation Toolbox refuses its variable
size. SOFIRpy, SysSimX and libcosim are for FMI 2.0; libcosim ends the process. `make judge` runs
the loops with the crate `fmi`, and the pendulum in both versions and kinds.

PyFMI is built with the FMI Library, and mosaik-fmi with SUNDIALS in a version older than that of
Debian 12, which are not in PyPI; the installation of OMSimulator downloads the program from the
project's server. [SSP packages](ssp.md#omsimulator) says what the packages contain for it.
"""


def main() -> None:
    """Write the page; versions of FMI with the same result share a line."""
    found: dict[tuple, list[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for *key, fmi in rows(Path(folder)):
            found.setdefault(tuple(key), []).append(fmi)
            print(fmi, *key, sep=" | ", flush=True)
    lines = [
        f"| {importer} | {pinned} | {', '.join(fmi)} | {' | '.join(rest)} |\n"
        for (importer, pinned, *rest), fmi in found.items()
    ]
    PAGE.write_text(HEAD + "".join(lines) + TAIL, encoding="utf-8")


if __name__ == "__main__":
    main()
