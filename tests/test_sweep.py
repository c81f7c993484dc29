"""`cargo fmu sweep`: kills and bad input.

`test_python.py` compares the runs with single ones.
"""

import re
import subprocess

import sweeps
from native import printed
from pendulum_fmus.project import PROGRAM
from sweeps import LONG, done, expected, journal_of, local, wait_until


def test_a_killed_sweep_resumes(program, tmp_path):
    sweep = sweeps.written(tmp_path, LONG)
    out = tmp_path / "out.csv"
    for _ in range(2):
        before = done(out)
        with subprocess.Popen([PROGRAM, "sweep", sweep, "--out", out]) as process:
            wait_until(lambda before=before: len(done(out)) > len(before) + 20, process)
            process.kill()
        after = done(out)
        assert after[: len(before)] == before, "nothing is lost"
        assert len(set(after)) == len(after) < 100, "nothing is done twice"
    journal = journal_of(out).read_bytes()
    for other in (
        LONG.replace("stop = 180.0", "stop = 179.0"),
        LONG.replace("to = 400", "to = 401"),
        f"{LONG}\n[metrics]\nband = 0.004",
        f"set = {{ 'plant.M' = 2 }}\n{LONG}",
    ):
        said = local(sweeps.written(tmp_path, other), out).stderr
        assert f"{journal_of(out)} belongs to another sweep" in said
        assert journal_of(out).read_bytes() == journal
    said = printed("sweep", sweeps.written(tmp_path, LONG), "--out", out)
    assert said.startswith(f"{100 - len(after)} runs in ")
    assert f"\n{len(after)} runs already done\n" in said
    assert not journal_of(out).exists()
    assert out.read_bytes() == expected(sweep)


def test_a_rejected_draw_ends_the_sweep_with_run_and_reason(program, tmp_path):
    """A normal distribution around the minimum mass; the first draw of this seed is above it."""
    text = 'seed = 2\ndraws = 50\nstop = 0.01\n[[parameter]]\nvariable = "plant.M"\nnormal = [0, 1]'
    sweep = sweeps.written(tmp_path, text)
    out = tmp_path / "out.csv"
    result = local(sweep, out)
    assert result.returncode == 1
    said = re.match(r"error: run (\d+): plant \(Pendulum\.fmu\), M = -[0-9.]+: ", result.stderr)
    assert said
    assert "expected a finite number from 0.000001 to 1000000 [kg]" in result.stderr
    assert int(said[1]) not in done(out)
    assert not out.exists()
