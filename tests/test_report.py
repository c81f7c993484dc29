"""The scripts that print Table 1 and draw the report."""

import subprocess
import sys
from pathlib import Path

import pytest
import report

NAMES = {"closed-loop"} | {
    f"{signal}{suffix}" for signal in ("step", "sine", "square") for suffix in ("", "-disturbance")
}


def test_draws_every_signal_with_and_without_disturbance(table_results, tmp_path):
    paths = report.draw(table_results, tmp_path / "report")
    assert {path.stem for path in paths} == NAMES
    for path in paths:
        assert path.read_bytes().startswith(b"\x89PNG")
        assert path.stat().st_size > 20_000


@pytest.mark.parametrize("name", ["table1.py", "report.py"])
def test_missing_fmus_are_answered_with_what_to_do(tmp_path, name):
    path = Path(report.__file__).with_name(name)
    command = [sys.executable, path, "--fmus", "nowhere"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert "run `cargo fmu export`" in run.stderr
    assert "Traceback" not in run.stderr


def test_scripts_work_from_any_directory(fmus, tmp_path):
    command = [sys.executable, Path(report.__file__), "--out", "figures"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stderr == ""
    assert "MISSED" not in run.stdout
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == NAMES
