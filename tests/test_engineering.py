"""What engineers do with the module: the example test suite, linearization, comparison, tuning."""

import subprocess
import sys

import pytest

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
