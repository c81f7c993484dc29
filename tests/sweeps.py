"""Small sweeps with the native program, and their progress."""

import csv
import re
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from native import LOOPS, ROOT, printed, replaced, run

TIMEOUT = 300
"""Time limit for something that takes a second on an idle machine [s]."""

SHORT = """
stop = 0.05
seed = 3
draws = 4

[[parameter]]
variable = "controller.previous_sample_terms"
values = [true, false]

[[parameter]]
variable = "plant.dynamics"
values = ["linear", "nonlinear"]

[[parameter]]
variable = "controller.pid.kp"
values = [200, 300]

[[parameter]]
variable = "plant.M"
normal = [1.096, 0.1]
"""
"""32 runs with values of every type."""

LONG = """
stop = 180.0

[[parameter]]
variable = "controller.pid.kp"
from = 200
to = 400
count = 100
"""
"""100 runs of some milliseconds each: enough time to kill the process."""

SIGNALS = """
[signals]
reference = "source.r"
output = "plant.theta"
error = "controller.e"
control = "controller.u"
"""


def written(folder: Path, text: str, system: str = "pid-rbf", signals: str = SIGNALS) -> Path:
    """Write a sweep of an example system."""
    file = folder / "sweep.toml"
    text = f'system = "{LOOPS / system}.toml"\n{text}\n{signals}'
    file.write_text(text, encoding="utf-8")
    return file


def shortened(folder: Path) -> Path:
    """Write the examples with two values of each range and five draws; return the folder."""
    for file in (ROOT / "examples" / "sweep").glob("*.toml"):
        text = replaced(file.read_text(encoding="utf-8"), {"../closed-loop": str(LOOPS)})
        text = re.sub(r"(?m)^count = \d+", "count = 2", text)
        (folder / file.name).write_text(re.sub(r"(?m)^draws = \d+", "draws = 5", text))
    return folder


def local(sweep: Path, out: Path, *options: object) -> subprocess.CompletedProcess[str]:
    """Run a sweep with `cargo fmu sweep`, whatever its exit code."""
    return run("sweep", sweep, "--out", out, *options, cwd=out.parent)


def table(out: Path) -> list[dict[str, str]]:
    """Read the rows of a CSV file."""
    with out.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def expected(sweep: Path, suffix: str = ".csv") -> bytes:
    """Return the table of an uninterrupted sweep."""
    out = sweep.with_name(f"uninterrupted{suffix}")
    printed("sweep", sweep, "--out", out)
    return out.read_bytes()


def journal_of(out: Path) -> Path:
    """Return the journal of a table."""
    return out.with_name(f"{out.name}.part")


def done(out: Path) -> list[int]:
    """Return the runs that are in the journal of a table so far."""
    if not journal_of(out).exists():
        return []
    lines = journal_of(out).read_text(encoding="utf-8").split("\n")
    return [int(line.split(",", 1)[0]) for line in lines[2:-1]]  # whole ones


def wait_until(condition: Callable[[], Any], process: subprocess.Popen | None = None) -> Any:
    """Wait until the condition is true, while the process runs; return its value."""
    deadline = time.monotonic() + TIMEOUT
    while not (holds := condition()):
        assert process is None or process.poll() is None, "it ended too early"
        assert time.monotonic() < deadline, "no progress"
        time.sleep(0.002)
    return holds
