"""Runs the FMUs in other importers and writes the table of docs/importers.md: `make importers`.

Each importer runs in an environment of its own, which `uv` installs, since they require conflicting
packages; `fmi-sim` is in target/tools.
"""

import json
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np

import reference
from pendulum_fmus.loop import TS, Loop
from pendulum_fmus.master import simulate
from pendulum_fmus.project import FMUS, ROOT

PAGE = ROOT / "docs" / "importers.md"
FMI_SIM = re.search(r"FMI_SIM := (.*)", (ROOT / "Makefile").read_text(encoding="utf-8"))[1]
STEPS = {"plant": 500, "loop": 5000, "pid": 5000}
CASES = {"plant": "pendulum alone", "loop": "loop", "pid": "loop with PID"}
FMI = {"2.0": "", "3.0": "_fmi3"}
"""The endings of the names of FMUs."""

CS, EVENTS, ME = "co-simulation", "co-simulation, event mode", "model exchange"

IMPORTERS = {
    "FMPy": ("by_fmpy", "fmpy==0.3.32", {CS: "plant", EVENTS: "plant", ME: "plant"}),
    "fmi-sim": ("fmi_sim", "", {CS: "plant", ME: "plant"}),
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
    "fmuloader": ("fmuloader", "fmuloader==0.1.2rc0", {CS: "plant loop"}),
    "jaxonomy": ("jaxonomy", "jaxonomy==3.4.1 fmpy==0.3.32", {CS: "plant loop pid"}),
    "CasADi": ("casadi", "casadi==3.8.2", {ME: "plant"}),
    "GEMSEO": ("gemseo", "gemseo-fmu==3.1.1", {CS: "plant", ME: "plant"}),
    "estim8": ("estim8", "estim8==0.1.6 fmpy==0.3.32", {CS: "plant", ME: "plant"}),
    "FMUGym": ("fmugym", "fmugym==0.2.0 fmpy==0.3.32", {CS: "plant"}),
}
"""By importer: its function in importer.py, what is installed for it, and what it runs."""

OTHERS = {"OMSimulator": "3.0.0.post198", "mosaik-fmi": "1.1.0.post0", "PyFMI": "2.5"}
"""Packages that did not install when this was written; it is tried again."""


def rows() -> Iterator[tuple[str, ...]]:
    """Run everything; yield importer, its version, kind, case, result, and version of FMI."""
    for name, (function, packages, runs) in IMPORTERS.items():
        pinned = [*re.findall(r"==([\w.]+)", packages), FMI_SIM][0]
        for kind, cases in runs.items():
            for case, fmi in product(cases.split(), FMI):
                if kind != EVENTS or fmi == "3.0":
                    result = run(function, packages, kind, case, FMI[fmi])
                    yield name, pinned, kind, CASES[case], result, fmi
    for name, pinned in OTHERS.items():
        done = uv([f"{name}=={pinned}"], "python", "-c", "")
        result = failure(done) if done.returncode else "succeeds; not run"
        yield name, pinned, "", "installation", result, ""


def run(function: str, packages: str, kind: str, case: str, ending: str) -> str:
    """Run an importer; return the comparison or the message."""
    script = Path(__file__).with_name("importer.py")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "results.json"
        done = uv(packages.split(), script, function, kind, case, FMUS, ending, STEPS[case], file)
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


def held_back(controller: str) -> np.ndarray:
    """Return the angles [rad] of the loop in which inputs are the outputs of one step before."""
    angles = []
    with Loop(controller, previous_sample_terms=False).system(FMUS) as system:
        for component in system.components.values():
            component.initialize(0.0)
        ends = [[system.locate(name) for name in pair] for pair in system.connections]
        outputs = [component.get(name) for (component, name), _ in ends]
        for k in range(STEPS["loop"] + 1):
            angles.append(system.components["plant"].get("theta"))
            given, outputs = outputs, [component.get(name) for (component, name), _ in ends]
            for (_, (component, name)), value in zip(ends, given, strict=True):
                component.set(name, value)
            for component in system.components.values():
                component.step(k * TS, TS)
    return np.array(angles)


@cache
def expected(case: str) -> dict[str, np.ndarray]:
    """Return what the angles [rad] may be, at the communication points."""
    if case != "plant":
        controller, found = {"loop": "IpidRbf", "pid": "Pid"}[case], {}
        for order in ("parallel", "sequential"):
            with Loop(controller, previous_sample_terms=False).system(FMUS) as system:
                columns = simulate(system, 0.0, TS, STEPS[case] + 1, order=order)
            found[f"FMPy, {order}"] = columns["plant.theta"]
        return found | {"FMPy, parallel with inputs of one step before": held_back(controller)}
    (A, B), euler = reference.linear_model(), [np.zeros(4)]
    for _ in range(STEPS[case]):
        euler.append(euler[-1] + TS * (A @ euler[-1] + B))
    times = TS * np.arange(STEPS[case] + 1)
    exact = [reference.linear_response((0, 0, 0, 0), 1.0, t)[2] for t in times]
    return {"the exact solution": np.array(exact), "Euler's method": np.array(euler)[:, 2]}


def compare(found: Sequence[float], case: str) -> str:
    """Describe the angles by what they are closest to, in time or one step late."""
    differences = {}
    for (name, values), late in product(expected(case).items(), (0, 1)):
        own = np.asarray(found, float)[late:]
        size = min(len(own), len(values) - late)
        if size < len(values) - 2:
            return f"{len(found)} values, expected {len(values)}"
        differences[name, late] = np.max(np.abs(own[:size] - values[:size]))
    (name, late), difference = min(differences.items(), key=lambda item: (item[1], item[0][1]))
    said = f"{difference:.1e} rad from" if difference else "same bits as"
    return f"{said} {name}{', one step late' * late}"


def main() -> None:
    """Write the table; versions of FMI with the same result share a line."""
    found: dict[tuple, list[str]] = {}
    for *key, fmi in rows():
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
