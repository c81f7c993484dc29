"""`cargo fmu sweep`: kills and bad input.

`test_python.py` compares the runs with single ones.
"""

import subprocess

import pytest

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


@pytest.mark.parametrize("seed", [1, 2])
def test_a_rejected_draw_is_a_failed_run(program, tmp_path, seed):
    """A normal distribution around the minimum mass; the first draw is below it with seed 1."""
    text = f"seed = {seed}\ndraws = 50\nstop = 0.01\n[[parameter]]\nvariable = 'plant.M'"
    text += "\nnormal = [0, 1]"
    out = tmp_path / "out.csv"
    local(sweeps.written(tmp_path, text), out)
    rows = sweeps.table(out)
    assert len(rows) == 50
    for row in rows:
        is_rejected = row["plant.M"].startswith("-")
        assert row["diverged"] == str(is_rejected).lower()
        assert row["failure"].startswith("plant (Pendulum.fmu), M = -") == is_rejected
        assert bool(row["failure"]) == is_rejected


def test_a_refused_value_is_a_failed_run_wherever_it_is(program, tmp_path):
    """The mass of the cart must be positive."""
    for values in ([1.0, 1.1, -1.0], [-1.0, 0.5], [0.5, -1.0, -2.0, 0.6]):
        text = f"stop = 0.01\n[[parameter]]\nvariable = 'plant.M'\nvalues = {values}"
        out = tmp_path / "out.csv"
        result = local(sweeps.written(tmp_path, text), out)
        assert result.returncode == 0, result.stderr
        rows = sweeps.table(out)
        assert [float(row["plant.M"]) for row in rows] == values
        reasons = [f"plant (Pendulum.fmu), M = {v}: fmi2SetReal returned fmi2Error" for v in values]
        found = [row["failure"] for row in rows]
        assert found == [why if v < 0 else "" for v, why in zip(values, reasons, strict=True)]
    for values in ([-1.0], [-1.0, -2.0]):
        text = f"[[parameter]]\nvariable = 'plant.M'\nvalues = {values}"
        result = local(sweeps.written(tmp_path, text), out)
        assert result.returncode == 1
        assert f"{len(values)} of {len(values)} run" in result.stderr
        assert all(row["failure"] for row in sweeps.table(out))


def test_a_sweep_of_which_every_run_fails_is_an_error(program, tmp_path):
    text = 'draws = 3\n[[parameter]]\nvariable = "plant.M"\nnormal = [-9, 1]'
    out = tmp_path / "out.csv"
    result = local(sweeps.written(tmp_path, text), out)
    assert result.returncode == 1
    reason = "error: 3 of 3 runs failed, the first was run 0: plant (Pendulum.fmu), M = -"
    assert result.stderr.startswith(reason)
    assert len(sweeps.table(out)) == 3
    assert not journal_of(out).exists()
