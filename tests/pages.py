"""The commands of the documentation, and packages outside the repository."""

import fcntl
import os
import shutil
import subprocess
import sys
from pathlib import Path

from pendulum_fmus.project import PROGRAM, ROOT

TARGET = ROOT / "target" / "outside"
"""The target folder of all packages outside the repository: dependencies are built once."""


def call(command: list, folder: Path, **options) -> subprocess.CompletedProcess:
    """Run a command in a folder; of those outside the repository, one at a time."""
    env = {**os.environ, "PYTHONPATH": str(ROOT / "python"), "FMUS": "target/fmu"}
    if folder == ROOT:
        return subprocess.run(command, cwd=folder, env=env, **options)
    env["CARGO_TARGET_DIR"] = str(TARGET)
    TARGET.mkdir(parents=True, exist_ok=True)
    with (TARGET / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return subprocess.run(command, cwd=folder, env=env, **options)


def run(command: str, folder: Path = ROOT) -> Path:
    """Run shell commands in a folder, and return the folder in which they end."""
    command = command.replace("target/venv/bin/python", sys.executable)
    shell = ["bash", "-exc", f"{command}\npwd"]
    output = call(shell, folder, check=True, stdout=subprocess.PIPE).stdout
    return Path(output.decode().splitlines()[-1])


def new(name: str, folder: Path) -> Path:
    """Create a package in a folder; return its folder."""
    return prepare(run(f"{PROGRAM} new {name}\ncd {name}", folder))


def prepare(package: Path) -> Path:
    """Let a new package use the versions in Cargo.lock, and find its FMUs in `target`."""
    shutil.copy(ROOT / "Cargo.lock", package)
    (package / "target").symlink_to(TARGET)
    return package


def export_panicking(folder: Path, target: str | None = None) -> None:
    """Export the panicking model for both versions to a folder."""
    package = new("panicking", folder)
    shutil.copy(ROOT / "tests" / "data" / "panicking.rs", package / "src" / "lib.rs")
    option = f"--target {target}" if target else ""
    run(f"{PROGRAM} export Panicking --fmi 2.0,3.0 {option} --out {folder}", package)
