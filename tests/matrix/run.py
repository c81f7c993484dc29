"""Runs the FMUs in other importers and writes the results to docs/importers.md: `make importers`.

FMPy, libcosim and Ecos are those of the test environment, and `fmi-sim` is in target/tools. All
others run as scripts, each in an environment of its own, since they require conflicting packages;
`uv` installs what a script names in its first lines.
"""

import csv
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

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
STEPS = {"plant": 500, "loop": 5000}
PACKAGES = ["pid", "pid-rbf", "ipid-rbf", "supervised"]
CASES = {"plant": "pendulum alone", "loop": "loop", "ssp": "SSP packages"}

SCRIPTS = {
    "PathSim": ("with_pathsim.py", ["plant", "loop"]),
    "CoFMUPy": ("with_cofmupy.py", ["plant", "loop"]),
    "SOFIRpy": ("with_sofirpy.py", ["plant", "loop"]),
    "FMU Manipulation Toolbox, container": ("with_fmu_manipulation_toolbox.py", ["loop"]),
    "SysSimX": ("with_syssimx.py", ["loop"]),
    "fmuloader": ("with_fmuloader.py", ["plant", "loop"]),
    "GEMSEO": ("with_gemseo_fmu.py", ["plant"]),
    "estim8": ("with_estim8.py", ["plant"]),
    "FMUGym": ("with_fmugym.py", ["plant"]),
    "CasADi": ("with_casadi.py", ["plant"]),
}
"""By importer: its script, whose first requirement is the importer, and what it runs."""

OTHERS = {"OMSimulator": "3.0.0.post198", "mosaik-fmi": "1.1.0.post0", "PyFMI": "2.5"}
"""Packages that did not install when this was written; it is tried again."""


class Row(NamedTuple):
    """A line of the table."""

    importer: str
    version: str
    case: str
    result: str


def rows(folder: Path) -> Iterator[Row]:
    """Run everything; temporary files are in the folder."""
    expected = {"plant": {"": alone()}, "loop": {o: loop(o) for o in ("parallel", "sequential")}}
    for name, case, angles in in_this_environment(folder):
        package = {"Ecos": "ecospy", "libcosim": "libcosimpy"}.get(name, "fmpy")
        yield Row(name, version(package), CASES[case], compare(angles(), expected[case]))
    for name, (package, importer) in {
        "FMPy": ("fmpy", importers.by_fmpy),
        "libcosim": ("libcosimpy", importers.by_libcosim),
        "Ecos": ("ecospy", importers.by_ecos),
    }.items():
        yield Row(name, version(package), CASES["ssp"], packages(importer, folder))
    told = subprocess.run([FMI_SIM, "--version"], capture_output=True, text=True, check=False)
    pinned = re.search(r"fmi-sim ([\d.]+)", told.stdout + told.stderr)[1]
    yield Row("fmi-sim", pinned, CASES["plant"], compare(by_fmi_sim(folder), expected["plant"]))
    for name, (script, cases) in SCRIPTS.items():
        pinned = re.search(r"[\w-]+==([\w.]+)", (HERE / script).read_text())[1]
        for case in cases:
            yield Row(name, pinned, CASES[case], by_script(script, case, folder, expected[case]))
    for name, pinned in OTHERS.items():
        yield Row(name, pinned, "installation", installed(name, pinned))


# --- what is expected -----------------------------------------------------------------------------


def alone() -> np.ndarray:
    """Return the angle [rad] of the pendulum under 1 N, from the matrix exponential."""
    times = STEP * np.arange(STEPS["plant"] + 1)
    return np.array([reference.linear_response((0, 0, 0, 0), 1.0, t)[2] for t in times])


def loop(order: str) -> np.ndarray:
    """Return the angle [rad] in the loop that FMPy steps."""
    with Loop("IpidRbf", "step").system(FMUS) as system:
        results = couple(system, 0.0, STEP, STEPS["loop"] + 1, order=order)
    return results["plant.theta"]


def compare(angles: Sequence[float], expected: dict[str, np.ndarray]) -> str:
    """Describe the result by the order that it is closest to, in time or one step late."""
    found = {}
    for order, angle in expected.items():
        for late in (0, 1):
            own = np.asarray(angles, float)[late:]
            size = min(len(own), len(angle) - late)
            if size < len(angle) - 2:
                return f"{len(angles)} values, expected {len(angle)}"
            difference = np.max(np.abs(own[:size] - angle[:size]))
            found[order, late] = difference
    (order, late), difference = min(found.items(), key=lambda item: (item[1], item[0][1]))
    if not order:
        return f"{difference:.1e} rad from the exact solution"
    said = "same bits" if difference == 0 else f"differs by up to {difference:.1e} rad"
    return f"{said} as FMPy, {order}{', the first inputs one step late' * late}"


# --- the importers --------------------------------------------------------------------------------


def in_this_environment(
    folder: Path,
) -> Iterator[tuple[str, str, Callable[[], Sequence[float]]]]:
    """Yield name, case and function of those in the test environment."""

    def by_simulate_fmu() -> np.ndarray:
        end = STEPS["plant"] * STEP
        results = fmpy.simulate_fmu(
            FMUS / "Pendulum.fmu", stop_time=end, output_interval=STEP, start_values={"u": 1.0}
        )
        return results["theta"]

    def by_container() -> np.ndarray:
        models = {"source": "Source", "controller": "IpidRbf", "plant": "Pendulum"}
        with Loop("IpidRbf", "step").system(FMUS) as system:
            connections = system.connections
        path = container(Inside(FMUS, models), connections, ["plant.theta"], {}, folder)
        end = STEPS["loop"] * STEP
        return fmpy.simulate_fmu(path, stop_time=end, step_size=STEP, output_interval=STEP)[
            "plant.theta"
        ]

    yield "FMPy, `simulate_fmu`", "plant", by_simulate_fmu
    yield "FMPy, container FMU", "loop", by_container


def by_fmi_sim(folder: Path) -> list[float]:
    """Simulate the pendulum with the program `fmi-sim`."""
    file = folder / "fmi-sim.csv"
    command = [FMI_SIM, "--model", FMUS / "Pendulum.fmu", "-o", file, "co-simulation"]
    times = ["--step", str(STEP), "--output-interval", str(STEP), "-f", str(STEPS["plant"] * STEP)]
    subprocess.run([*command, *times, "--init-values", "u=1"], check=True, capture_output=True)
    with file.open() as lines:
        return [float(row["theta"]) for row in csv.DictReader(lines)]


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


def by_script(script: str, case: str, folder: Path, expected: dict[str, np.ndarray]) -> str:
    """Run a script in an environment of its own; return the comparison or the message."""
    file = folder / f"{script}.{case}.json"
    command = ["run", "--script", HERE / script, case, FMUS, STEPS[case], file]
    done = uv(*command)
    if done.returncode:
        return f"fails: {message(done.stderr)}"
    return compare(json.loads(file.read_text()), expected)


def installed(package: str, pinned: str) -> str:
    """Try to install a package."""
    done = uv("run", "--no-project", "--with", f"{package}=={pinned}", "python", "-c", "")
    return f"fails: {message(done.stderr)}" if done.returncode else "succeeds; not run"


def uv(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run uv with this Python."""
    head = [sys.executable, "-m", "uv", "--quiet"]
    command = [*head, arguments[0], "--python", sys.executable, *arguments[1:]]
    return subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, check=False
    )


def message(text: str) -> str:
    """Return the last line that is not a hint of uv, for a table."""
    lines = [line.strip(" │╰─▶├×") for line in text.split("\nhint:")[0].splitlines()]
    last = [line for line in lines if line][-1:] or ["no message"]
    return f"`{last[0][:100].replace('|', '/').replace('`', '')}`"


# --- the page -------------------------------------------------------------------------------------

HEAD = f"""# Importers

`make importers` runs the FMUs in the importers below, each in the version given, and writes this
page; the numbers are not edited by hand. The tests run FMPy, libcosim and Ecos on every change.

| Run | |
|---|---|
| {CASES["plant"]} | `Pendulum` under a constant force of 1 N for 0.5 s in steps of 1 ms, against the matrix exponential |
| {CASES["loop"]} | `Source`, `IpidRbf` and `Pendulum` for 5 s in steps of 1 ms, against the same loop stepped by FMPy in the order that the importer uses |
| {CASES["ssp"]} | `{"`, `".join(f"{name}.ssp" for name in PACKAGES)}` for 20 s, against `cargo fmu simulate` |

| Importer | Version | Run | Result |
|---|---|---|---|
"""  # noqa: E501

TAIL = """
PathSim, CoFMUPy, SOFIRpy, SysSimX, GEMSEO, estim8 and FMUGym call FMUs through FMPy. fmuloader has
no master, so its script steps the loop. The observations of FMUGym have single precision. CasADi
imports FMUs for model exchange only. PyFMI and mosaik-fmi are built from sources, which requires
more than a C compiler; the installation of OMSimulator downloads the program from the project's
server. [SSP packages](ssp.md#omsimulator) says what the packages contain for it. `make judge` runs
the loops with the crate `fmi`.
"""


def main() -> None:
    """Write the page."""
    with tempfile.TemporaryDirectory() as folder:
        lines = []
        for row in rows(Path(folder)):
            lines.append("| " + " | ".join(row) + " |\n")
            print(lines[-1], end="", flush=True)
    PAGE.write_text(HEAD + "".join(lines) + TAIL, encoding="utf-8")


if __name__ == "__main__":
    main()
