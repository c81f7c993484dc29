"""The wheel of the module and the command line runs outside the repository."""

import os
import shutil
import subprocess
import sysconfig
import tomllib
import venv
from pathlib import Path

import pytest

from pendulum_fmus.project import ROOT

pytestmark = pytest.mark.publish

VERSION = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]["version"]


def python_of(environment: Path) -> Path:
    """Return the Python of a virtual environment."""
    return Path(sysconfig.get_path("scripts", "venv", {"base": str(environment)})) / "python"


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel to a new virtual environment; return its folder."""
    (wheel,) = (ROOT / "target" / "wheels").glob("fmu_master-*.whl")
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=True)
    install = [python_of(folder), "-m", "pip", "install", "--quiet", wheel]
    subprocess.run(install, cwd=folder, check=True)
    return folder


@pytest.mark.parametrize(
    ("command", "line"),
    [
        ("cargo-fmu --version", f"cargo-fmu {VERSION}"),
        ("cargo fmu --version", f"cargo-fmu {VERSION}"),
        ("cargo-fmu info Decay.fmu", "model        Decay"),
    ],
)
def test_the_command_line_runs(environment: Path, command: str, line: str) -> None:
    shutil.copy(ROOT / "fuzz" / "corpus" / "archive.fmu", environment / "Decay.fmu")
    scripts = sysconfig.get_path("scripts", "venv", {"base": str(environment)})
    # A cargo home of its own, because cargo prefers what is installed there.
    env = {**os.environ, "CARGO_HOME": str(environment / "cargo")}
    env["PATH"] = os.pathsep.join([scripts, os.environ["PATH"]])
    program, *arguments = command.split()
    run = [shutil.which(program, path=env["PATH"]), *arguments]
    done = subprocess.run(run, cwd=environment, env=env, capture_output=True, text=True, check=True)
    assert line in done.stdout.splitlines()


def test_the_module_runs_an_fmu_in_a_worker_process(environment: Path) -> None:
    """The binary of this FMU is a text."""
    shutil.copy(ROOT / "fuzz" / "corpus" / "archive.fmu", environment / "Decay.fmu")
    code = "import fmu_master; fmu_master.simulate('Decay.fmu')"
    command = [python_of(environment), "-c", code]
    done = subprocess.run(command, cwd=environment, capture_output=True, text=True, check=False)
    last = done.stderr.splitlines()[-1]
    assert last.startswith("fmu_master.result.FmuError: component Decay: ")


def test_it_carries_the_licences(environment: Path) -> None:
    for licence in ROOT.glob("LICENSE-*"):
        (installed,) = environment.rglob(f"fmu_master-*/licenses/{licence.name}")
        assert installed.read_text() == licence.read_text()
