"""The examples: the FMU in plain C matches the one in Rust, the sensor is valid."""

import subprocess
import sys
from pathlib import Path

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


def test_the_sensor_is_valid_and_exported_by_itself(sensor: Path, fmus: Path) -> None:
    assert "no error, no warning" in run("validate", sensor).stdout
    assert not (fmus / sensor.name).exists(), "it is no default member of the workspace"
