"""Pages of the documentation: what stands in them, and the sources changed as a page says."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

from pendulum_fmus.project import PROGRAM, ROOT

NATIVE = re.compile(r"^cargo fmu (?=(simulate|sweep|ssp|table1)\b)")
"""Commands that cargo hands on to the native master."""


def blocks(language: str, text: str) -> list[str]:
    """Return the fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def links(text: str) -> list[str]:
    """Return the targets of the links that do not lead to other sites."""
    return re.findall(r"\]\((?!https?:)([^)]+)\)", text)


def run(command: str, folder: Path = ROOT) -> None:
    """Run a shell command of a page, by the interpreter that has the packages."""
    command = command.replace("target/venv/bin/python", sys.executable)
    subprocess.run(["bash", "-ec", command], cwd=folder, check=True, stdout=subprocess.DEVNULL)


def run_natively(command: str, folder: Path = ROOT) -> None:
    """As `run`; what the native master does is done by the program that is built already."""
    run(NATIVE.sub(f"{PROGRAM} ", command), folder)


def project(name: str = "own-controller") -> Path:
    """Return a new copy of the sources, to be changed.

    It always lies at the same place, and its target folder is that of the copies before, so that
    cargo builds only what a page changes.
    """
    target = ROOT / "target" / name
    copy = target / "project"
    shutil.rmtree(copy, ignore_errors=True)
    ignored = shutil.ignore_patterns("target", ".git", "__pycache__", ".*_cache")
    shutil.copytree(ROOT, copy, ignore=ignored)
    (copy / "target").symlink_to(target)
    return copy


def export_models(copy: Path, lines: str) -> None:
    """Replace the line by which the controllers are exported."""
    library = copy / "fmu-controller" / "src" / "lib.rs"
    text, count = re.subn(r"^fmu_export::export!\(.*\);$", lines, library.read_text(), flags=re.M)
    assert count == 1, "lib.rs has one line that exports"
    library.write_text(text)


def export_panicking(folder: Path, target: str | None = None) -> Path:
    """Export the model that panics to a folder, in a copy of the sources; returns the FMU."""
    copy = project()
    shutil.copy(ROOT / "tests" / "data" / "panicking.rs", copy / "fmu-controller" / "src")
    export_models(copy, "mod panicking;\nfmu_export::export!(panicking::Panicking);")
    option = f"--target {target}" if target else ""
    run(f"cargo fmu export Panicking {option} --out {folder}", copy)
    return folder / "Panicking.fmu"
