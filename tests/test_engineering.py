"""What engineers do with the module: the example test suite, linearization, comparison, tuning."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

from fmu_master import System
from fmu_master.tuning import Tuned, tune
from native import LOOPS, replaced
from pendulum_fmus.project import ROOT

# --- the example test suite -----------------------------------------------------------------------

ANGLE, FORCE = '"plant.theta -> controller.y"', '"controller.u -> plant.u"'
TO_Y, TO_U = 'from = "plant.theta", to = "controller.y"', 'from = "controller.u", to = "plant.u"'
GAINS = "previous_sample_terms = true"

PLANTED = {
    "nothing": ({}, ""),
    "a wrong gain of the sensor": (
        {ANGLE: f"{{ {TO_Y}, faults = [{{ gain = 1.02 }}] }}"},
        "plant.theta -> controller.y: the gain is wrong: 1.02, expected 1",
    ),
    "a swapped sign": (
        {FORCE: f"{{ {TO_U}, faults = [{{ gain = -1 }}] }}"},
        "controller.u -> plant.u: the sign is swapped: -1, expected 1",
    ),
    "a late sample": (
        {ANGLE: f"{{ {TO_Y}, faults = [{{ delay = 0.001 }}] }}"},
        "plant.theta -> controller.y: the value arrives 0.001 s (1 rows) late, expected 0 s",
    ),
    "noise": (
        {ANGLE: f"{{ {TO_Y}, faults = [{{ noise = 1e-6, start = 2 }}] }}"},
        "arrives at t = 2 s, expected ",
    ),
    "a wrong gain of the controller": (
        {GAINS: f"{GAINS}, 'pid.kp' = 330.0"},
        "the first force is 10.033 N, expected 10.0301 N for these gains",
    ),
    "a longer pendulum": (
        {'name = "plant"': 'name = "plant"\nstart = { l = 25.0 }'},
        "plant.theta is 0.000120046 at t = 0.428 s and 0.000148065 at t = 0.761 s, expected from",
    ),
}
"""Changes of the good loop, and what the suite says of each."""


@pytest.mark.parametrize("fault", PLANTED)
def test_the_example_suite_finds_and_explains_planted_faults(fmus, tmp_path, fault):
    changes, message = PLANTED[fault]
    text = (LOOPS / "pid.toml").read_text(encoding="utf-8")
    text = replaced(text, {"../../target/fmu": fmus.as_posix()} | changes)
    system = tmp_path / "system.toml"
    system.write_text(text, encoding="utf-8")
    suite = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "examples/testing"]
    command = [*suite, f"--system={system}"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == bool(message), done.stdout + done.stderr
    assert message in done.stdout


# --- tuning ---------------------------------------------------------------------------------------

CART, ROD, LENGTH, GRAVITY, INERTIA, FRICTION = 1.096, 0.109, 0.25, 9.8, 0.0034, 0.1
"""The paper's M, m, l, g, I and b."""

PIVOT, COUPLING = INERTIA + ROD * LENGTH**2, ROD * LENGTH
Q = (CART + ROD) * PIVOT - COUPLING**2

PLANT = np.array(
    [
        [0, 1, 0, 0],
        [(CART + ROD) * COUPLING * GRAVITY / Q, 0, 0, -FRICTION * COUPLING / Q],
        [0, 0, 0, 1],
        [COUPLING**2 * GRAVITY / Q, 0, 0, -FRICTION * PIVOT / Q],
    ]
)
"""The linear plant (9), for the states theta, omega, x and v."""

FORCE_ON_PLANT = np.array([[0], [COUPLING / Q], [0], [PIVOT / Q]])

SECONDS = 0.2
"""The length of the runs that are tuned [s]."""


def tuned(fmus: Path, **options) -> Tuned:
    """Find the angle at the start from which the pendulum falls to 0.05 rad."""
    plant = System(
        components={"plant": fmus / "Pendulum.fmu"}, connections=[], step=0.01, stop=SECONDS
    )
    given = {"seed": 3, "generations": 6, "output": ["plant.theta"], "in_process": True}
    return tune(
        plant,
        {"plant.theta0": (0.01, 0.1)},
        lambda results: abs(results[0]["plant.theta"][-1] / 0.05 - 1),
        **given | options,
    )


def test_tune_finds_the_parameter_of_the_closed_form(fmus, tmp_path):
    expected = 0.05 / scipy.linalg.expm(PLANT * SECONDS)[0, 0]
    journal = tmp_path / "search.journal"
    whole = tuned(fmus, journal=journal)
    assert whole.values["plant.theta0"] == pytest.approx(expected, rel=0.05)
    # An interrupted search goes on where it was, from an incomplete line.
    lines = journal.read_text(encoding="utf-8").splitlines(keepends=True)
    journal.write_text("".join([*lines[:40], lines[40][:20]]), encoding="utf-8")
    assert tuned(fmus, journal=journal) == whole
    # Equal candidates that are simulated at the same time are noted twice.
    assert set(journal.read_text(encoding="utf-8").splitlines(keepends=True)) == set(lines)
    with pytest.raises(ValueError, match="is the journal of another search"):
        tuned(fmus, journal=journal, seed=4)


def test_tune_does_not_depend_on_the_number_of_cores(fmus, monkeypatch):
    first = tuned(fmus, generations=1)
    monkeypatch.setattr("os.cpu_count", lambda: 7)
    assert tuned(fmus, generations=1) == first


def test_tune_finds_only_what_all_plants_accept(fmus):
    # The heavier cart does not change that a larger angle is farther away.
    limit = 0.03
    found = tuned(
        fmus,
        plants=[{"plant.M": 2.0}],
        accepts=lambda result: result["plant.theta"][-1] <= limit,
        guess={"plant.theta0": 0.01},
    )
    heavier = System(
        components={"plant": fmus / "Pendulum.fmu"}, connections=[], step=0.01, stop=SECONDS
    )
    reached = heavier.simulate(found.values | {"plant.M": 2.0})["plant.theta"][-1]
    assert 0.9 * limit < reached <= limit
    with pytest.raises(ValueError, match=r"plant.theta0: the guess 2.0 is not from 0.01 to 0.1"):
        tuned(fmus, guess={"plant.theta0": 2.0})
