"""The commands of the documentation, new packages, and modified copies of the sources."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from pendulum_fmus.project import PROGRAM, ROOT


def run(command: str, folder: Path = ROOT) -> Path:
    """Run shell commands in a folder, and return the folder in which they end."""
    command = command.replace("target/venv/bin/python", sys.executable)
    env = {**os.environ, "PYTHONPATH": str(ROOT / "python"), "FMUS": "target/fmu"}
    shell = ["bash", "-exc", f"{command}\npwd"]
    output = subprocess.run(shell, cwd=folder, env=env, check=True, stdout=subprocess.PIPE).stdout
    return Path(output.decode().splitlines()[-1])


def outside(base: Path) -> Path:
    """Return an empty folder outside the repository, the same in all tests.

    The path is part of how packages are built, so that dependencies are built once.
    """
    folder = base / "outside"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder


def share_target(package: Path) -> None:
    """Let a new package use the versions in Cargo.lock and the target folder of others."""
    target = ROOT / "target" / f"guide-{os.environ.get('PYTEST_XDIST_WORKER', 'gw0')}"
    target.mkdir(exist_ok=True)
    shutil.copy(ROOT / "Cargo.lock", package)
    (package / "target").symlink_to(target)


def project(name: str = "own-controller") -> Path:
    """Return a new copy of the sources for modification.

    All copies of a test process have the same path and target folder, so that cargo rebuilds only
    modified files.
    """
    target = ROOT / "target" / f"{name}-{os.environ.get('PYTEST_XDIST_WORKER', 'gw0')}"
    copy = target / "project"
    shutil.rmtree(copy, ignore_errors=True)
    ignored = shutil.ignore_patterns("target", ".git", "__pycache__", ".*_cache")
    shutil.copytree(ROOT, copy, ignore=ignored)
    (copy / "target").symlink_to(target)
    return copy


def export_models(copy: Path, lines: str) -> None:
    """Replace the line that exports the controllers."""
    library = copy / "fmu-controller" / "src" / "lib.rs"
    text, count = re.subn(r"^fmu_export::export!\(.*\);$", lines, library.read_text(), flags=re.M)
    assert count == 1, "lib.rs has one export line"
    library.write_text(text)


def export_panicking(folder: Path, target: str | None = None) -> None:
    """Export the panicking model for both versions from a copy of the sources to a folder."""
    copy = project()
    shutil.copy(ROOT / "tests" / "data" / "panicking.rs", copy / "fmu-controller" / "src")
    export_models(copy, "mod panicking;\nfmu_export::export!(panicking::Panicking);")
    option = f"--target {target}" if target else ""
    run(f"{PROGRAM} export Panicking --fmi 2.0,3.0 {option} --out {folder}", copy)
