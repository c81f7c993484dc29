"""The examples: the FMU in plain C matches the Rust one, the benchmarks step as documented."""

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from native import ROOT, run, simulate

OWN = ROOT / "examples" / "own-fmu"


@pytest.fixture(scope="module")
def own_fmu() -> Path:
    """Build the FMU in plain C as documented."""
    subprocess.run([sys.executable, OWN / "build.py"], check=True, stdout=subprocess.DEVNULL)
    return ROOT / "target" / "own-fmu" / "CPid.fmu"


def test_the_fmu_in_c_has_no_errors(own_fmu: Path) -> None:
    result = run("validate", own_fmu)
    assert result.returncode == 0, result.stdout
    assert "no error, " in result.stdout  # it takes wrong calls, to stay short


def test_the_pid_in_c_gives_the_same_bits(own_fmu: Path, fmus: Path, tmp_path: Path) -> None:
    folders = [tmp_path / "c", tmp_path / "rust"]
    for folder in folders:
        folder.mkdir()
    in_c = simulate(OWN / "system.toml", folders[0])
    loop = ROOT / "examples" / "closed-loop" / "pid.toml"
    ours = simulate(loop, folders[1], "--set", "controller.previous_sample_terms=false")
    for name, values in in_c.items():
        assert values.tobytes() == ours[name].tobytes(), name


def test_the_c_host_of_the_benchmarks_steps_as_documented(own_fmu: Path, tmp_path: Path) -> None:
    # One host, two FMUs with the same law and variables: the outputs must be equal.
    bench = SimpleNamespace(**runpy.run_path(str(ROOT / "bench" / "run.py")))
    host = tmp_path / "cycle"
    source = ROOT / "bench" / "cycle.c"
    compiler = os.environ.get("CC", "cc")
    subprocess.run([compiler, "-O2", "-o", host, source, "-ldl", "-lm"], check=True)
    fmus = [bench.unpack(file, tmp_path) for file in (own_fmu, bench.FMUS / "Pid.fmu")]
    command = [host, "cycle", "1000", "3", *fmus[0].words(), "--", *fmus[1].words()]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    results = [json.loads(line) for line in lines]
    assert [line["fmu"] for line in results] == ["CPid", "Pid"]
    assert results[0]["last_output"] == results[1]["last_output"] != 0
    assert all(0 < line["min_ns"] <= line["median_ns"] for line in results)
