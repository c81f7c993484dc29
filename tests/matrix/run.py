"""Runs the FMUs in other importers and writes the table of docs/importers.md: `make importers`.

FMPy comes from the test environment, as do the importers of SSP packages, and `fmi-sim` is in
target/tools. All others run in an environment of their own, which `uv` installs, since they require
conflicting packages.
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
from zipfile import ZipFile

import fmpy
import numpy as np

import importers
import reference
from native import run, simulate
from pendulum_fmus.loop import Loop
from pendulum_fmus.master import simulate as couple
from pendulum_fmus.project import FMUS, ROOT
from test_container import container

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
PARTS = {
    "plant": ("Pendulum", "theta"),
    "driven": ("Pendulum", "theta"),
    "controller": ("Pid", "u"),
}
"""By case with a single FMU: the model and the output to compare."""

FMI = {"2.0": "", "3.0": "_fmi3"}
"""The endings of the names of FMUs."""

CS, EVENTS, ME = "co-simulation", "co-simulation, event mode", "model exchange"

SCRIPTS = {
    "libcosim": ("libcosim", "libcosimpy==0.0.6", {CS: "loop"}),
    "Ecos": ("ecos", "ecospy==0.7.2", {CS: "loop"}),
    "PathSim": (
        "pathsim",
        "pathsim-fmi==0.1.1 pathsim==0.27.1 fmpy==0.3.32",
        {CS: "plant loop pid", ME: "plant loop pid"},
    ),
    "CoFMUPy": ("cofmupy", "cofmupy==1.0.0", {CS: "plant loop"}),
    # It needs the pkg_resources of an older setuptools.
    "SOFIRpy": ("sofirpy", "sofirpy==1.0.2 fmpy==0.3.32 setuptools<81", {CS: "plant loop"}),
    "FMU Manipulation Toolbox": (
        "toolbox",
        "fmu-manipulation-toolbox==2.0 fmpy==0.3.32",
        {CS: "loop pid", ME: "loop pid"},
    ),
    "SysSimX": ("syssimx", "syssimx==0.4.3 fmpy==0.3.32", {CS: "loop"}),
    "fmuloader": ("fmuloader", "fmuloader==0.1.2rc0", {CS: "plant loop", ME: "plant loop"}),
    "CasADi": ("casadi", "casadi==3.8.2", {ME: "plant"}),
    "GEMSEO": ("gemseo", "gemseo-fmu==3.1.1", {CS: "plant", ME: "plant"}),
    "estim8": ("estim8", "estim8==0.1.6 fmpy==0.3.32", {CS: "plant", ME: "plant"}),
    "FMUGym": ("fmugym", "fmugym==0.2.0 fmpy==0.3.32", {CS: "plant"}),
}
"""By importer: its function in importer.py, what is installed for it, and what it runs."""

OTHERS = {"OMSimulator": "3.0.0.post198", "mosaik-fmi": "1.1.0.post0", "PyFMI": "2.5"}
"""Packages that did not install when this was written; it is tried again."""

SINGLE = [
    run for run in product([CS, EVENTS, ME], PARTS, FMI) if run[0] != EVENTS or run[2] == "3.0"
]
"""Kind, case and version of FMI of the runs of a single FMU."""


def rows(folder: Path) -> Iterator[tuple[str, ...]]:
    """Run everything, with temporary files in the folder.

    Yields lines of the table: importer, its version, kind, case, result, version of FMI.
    """
    for kind, case, fmi in SINGLE:
        result = compare(by_fmpy(kind, case, fmi), case)
        yield "FMPy, `simulate_fmu`", version("fmpy"), kind, CASES[case], result, fmi
    for fmi in FMI:
        result = compare(by_container(fmi, folder), "loop")
        yield "FMPy, container FMU", version("fmpy"), CS, CASES["loop"], result, fmi
    told = subprocess.run([FMI_SIM, "--version"], capture_output=True, text=True, check=False)
    pinned = re.search(r"fmi-sim ([\d.]+)", told.stdout + told.stderr)[1]
    result = by_fmi_sim(CS, "plant", FMUS / "Pendulum_fmi3.fmu", folder)
    yield "fmi-sim", pinned, CS, CASES["plant"], result, "3.0"
    for kind, case, fmi in SINGLE:
        file, used = FMUS / f"{PARTS[case][0]}{FMI[fmi]}.fmu", fmi
        if fmi == "3.0":
            file, used = without_units(file, folder), "3.0 without units"
        yield "fmi-sim", pinned, kind, CASES[case], by_fmi_sim(kind, case, file, folder), used
    for name, (function, packages, runs) in SCRIPTS.items():
        pinned = re.search(r"==([\w.]+)", packages)[1]
        for kind, cases in runs.items():
            for case, fmi in product(cases.split(), FMI):
                result = by_script(function, packages, kind, case, fmi, folder)
                yield name, pinned, kind, CASES[case], result, fmi
    for name, (package, importer) in {
        "FMPy": ("fmpy", importers.by_fmpy),
        "libcosim": ("libcosimpy", importers.by_libcosim),
        "Ecos": ("ecospy", importers.by_ecos),
    }.items():
        yield name, version(package), CS, CASES["ssp"], by_packages(importer, folder), "2.0"
    for name, pinned in OTHERS.items():
        done = uv([f"{name}=={pinned}"], "python", "-c", "")
        result = failure(done) if done.returncode else "succeeds; not run"
        yield name, pinned, "", "installation", result, ""


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
    force = np.ones(SHORT + 1) if case == "plant" else recorded("controller.u")
    euler = angle(np.eye(4) + STEP * A, STEP * B, force)
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
    if case == "plant":
        return None
    names, late = {
        "driven": ({"u": "controller.u"}, 0),
        "controller": ({"r": "source.r", "d": "source.d", "y": "plant.theta"}, 0.5),
    }[case]
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
    loop = Loop("IpidRbf", "step", fmi3=("all",) if FMI[fmi] else ())
    files = {name: FMUS / file for name, file in loop.files().items()}
    (own := folder / f"container-{fmi}").mkdir()
    path = container(files, loop.connections(), ["plant.theta"], {}, own)
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
        return failure(done)
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


def by_packages(importer: Callable, folder: Path) -> str:
    """Run the SSP packages and compare the angles with `cargo fmu simulate`."""
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


def by_script(function: str, packages: str, kind: str, case: str, fmi: str, folder: Path) -> str:
    """Run an importer in an environment of its own; return the comparison or the message."""
    file, script = folder / "results.json", Path(__file__).with_name("importer.py")
    steps = SHORT if case == "plant" else LONG
    arguments = [function, kind, case, FMUS, FMI[fmi], steps, file]
    done = uv(packages.split(), script, *arguments)
    return failure(done) if done.returncode else compare(json.loads(file.read_text()), case)


def uv(packages: Sequence[str], *command: object) -> subprocess.CompletedProcess[str]:
    """Run a command with this Python and packages that are installed for it."""
    head = [sys.executable, *"-m uv --quiet run --no-project --python".split(), sys.executable]
    options = [f"--with={package}" for package in packages]
    words = [str(word) for word in [*head, *options, *command]]
    return subprocess.run(words, capture_output=True, text=True, check=False)


def failure(done: subprocess.CompletedProcess[str]) -> str:
    """Return the signal or the last line, without folders, hints and destructors, for a table."""
    text = re.split(r"\nhint:|\nException ignored|\n\nStack backtrace", done.stderr)[0]
    lines = [line.strip(" │╰─▶├×") for line in text.splitlines()]
    last = ([line for line in lines if line] or ["no message"])[-1]
    if done.returncode > 128:
        last = signal.strsignal(done.returncode - 128)
    last = re.sub(r"(?<![\w./:])/(?:[\w.-]+/)+", "", last)
    return f"fails: `{last[:120].replace('|', '/').replace('`', '')}`"


def main() -> None:
    """Write the table; versions of FMI with the same result share a line."""
    found: dict[tuple, list[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for *key, fmi in rows(Path(folder)):
            found.setdefault(tuple(key), []).append(fmi)
            print(fmi, *key, sep=" | ", flush=True)
    lines = [
        f"| {importer} | {pinned} | {', '.join(fmi)} | {' | '.join(rest)} |\n"
        for (importer, pinned, *rest), fmi in found.items()
    ]
    text = PAGE.read_text(encoding="utf-8")
    place = re.compile(r"(?<=\| Importer \| Version ).*?(?=\n\n)", re.DOTALL)
    head = "| FMI | Kind | Run | Result |\n|---|---|---|---|---|---|\n"
    text, count = place.subn(lambda _: head + "".join(lines).rstrip(), text)
    assert count == 1, PAGE
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
