"""The commands of the documentation, and packages outside the repository."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from pendulum_fmus.project import PROGRAM, ROOT

TARGET = ROOT / "target" / f"outside-{os.environ.get('PYTEST_XDIST_WORKER', 'gw0')}"
"""The target folder of all packages of a test process: dependencies are built once."""


def run(command: str, folder: Path = ROOT) -> Path:
    """Run shell commands in a folder, and return the folder in which they end."""
    command = command.replace("target/venv/bin/python", sys.executable)
    env = {**os.environ, "PYTHONPATH": str(ROOT / "python"), "FMUS": "target/fmu"}
    if folder != ROOT:
        env["CARGO_TARGET_DIR"] = str(TARGET)
    shell = ["bash", "-exc", f"{command}\npwd"]
    output = subprocess.run(shell, cwd=folder, env=env, check=True, stdout=subprocess.PIPE).stdout
    return Path(output.decode().splitlines()[-1])


def new(name: str, folder: Path) -> Path:
    """Create a package in a folder; return its folder."""
    return prepare(run(f"{PROGRAM} new {name}\ncd {name}", folder))


def prepare(package: Path) -> Path:
    """Let a new package use the versions in Cargo.lock, and find its FMUs in `target`."""
    TARGET.mkdir(exist_ok=True)
    shutil.copy(ROOT / "Cargo.lock", package)
    (package / "target").symlink_to(TARGET)
    return package


def export_panicking(folder: Path, target: str | None = None) -> None:
    """Export the panicking model for both versions to a folder."""
    package = new("panicking", folder)
    shutil.copy(ROOT / "tests" / "data" / "panicking.rs", package / "src" / "lib.rs")
    option = f"--target {target}" if target else ""
    run(f"{PROGRAM} export Panicking --fmi 2.0,3.0 {option} --out {folder}", package)
