"""Runs the command line; writes systems, small FMUs in C, and packages outside the repository."""

import csv
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filelock import FileLock

from fmu_master._values import document
from pendulum_fmus.project import PROGRAM, ROOT

LOOPS = ROOT / "examples" / "closed-loop"

SECONDS = 300
"""Time limit of one run on a busy machine [s]."""


def run(
    *arguments: object, program: Path = PROGRAM, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run the program, which must neither panic nor be killed, whatever its exit code.

    `options` are those of `subprocess.run`.
    """
    if not program.exists():
        pytest.fail(f"{program} is missing: `make fmus sandbox` builds it", pytrace=False)
    options = {"capture_output": True, "encoding": "utf-8", "timeout": SECONDS} | options
    result = subprocess.run([program, *map(str, arguments)], check=False, **options)
    assert " panicked at " not in result.stderr, result.stderr
    assert result.returncode in (0, 1, 2), result
    return result


def printed(*arguments: object, cwd: Path | None = None) -> str:
    """Run a command that must succeed; return its output."""
    result = run(*arguments, cwd=cwd)
    assert result.returncode == 0, result.stderr
    return result.stdout


def simulate(system: Path, folder: Path, *options: object) -> dict[str, np.ndarray]:
    """Simulate a system, which must succeed silently; return the columns of the CSV file."""
    file = folder / "results.csv"
    result = run("simulate", system, "--csv", file, "--enumerations=numbers", *options)
    assert (result.returncode, result.stderr) == (0, "")
    return read_csv(file)


def read_csv(file: Path) -> dict[str, np.ndarray]:
    """Return the columns by name, without units; all are numbers or Booleans."""
    with file.open(encoding="utf-8", newline="") as lines:
        head, *rows = csv.reader(lines)
    names = [re.sub(r" \[[^\[]*\]$", "", name) for name in head]
    words = {"false": "0", "true": "1"}
    columns = [[words.get(cell, cell) for cell in column] for column in zip(*rows, strict=True)]
    return {name: np.array(column, float) for name, column in zip(names, columns, strict=True)}


def refusal(folder: Path, *arguments: object) -> str:
    """Run a command that must fail and write nothing to the folder; return its message."""

    def files() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    before = files()
    result = run(*arguments, cwd=folder)
    assert (result.returncode, result.stdout) == (1, "")
    assert result.stderr.startswith("error: ")
    assert files() == before
    return result.stderr.removeprefix("error: ").strip()


# --- systems --------------------------------------------------------------------------------------


def write_system(
    folder: Path,
    components: Mapping[str, Mapping[str, Any]],
    connections: Sequence[str | Mapping[str, Any]] = (),
    fmu: str = "Relay",
    own: Mapping[str, Any] | None = None,
    **settings: Any,
) -> Path:
    """Write a system of instances of an FMU with start values, 1 s long in steps of 0.25 s.

    `own` are further keys of each component.
    """
    settings = {"start": 0.0, "stop": 1.0, "step": 0.25, "connections": connections} | settings
    common = {"fmu": f"{fmu}.fmu"} | (own or {})
    tables = [{"name": name, "start": start} | common for name, start in components.items()]
    file = folder / "system.toml"
    file.write_text(document(settings | {"component": tables}, "component"), encoding="utf-8")
    return file


def replaced(text: str, replacements: Mapping[str, str]) -> str:
    """Return a text with some parts replaced, all of which must be there."""
    for old, new in replacements.items():
        assert old in text, old
        text = text.replace(old, new)
    return text


# --- archives -------------------------------------------------------------------------------------


def read(archive: Path) -> dict[str, bytes]:
    """Return the files of an archive by name."""
    with zipfile.ZipFile(archive) as package:
        return {name: package.read(name) for name in package.namelist()}


def write(archive: Path, files: Mapping[str, str | bytes]) -> Path:
    """Write an archive; return its path."""
    with zipfile.ZipFile(archive, "w") as package:
        for name, data in files.items():
            # Unchanged: `writestr` would correct a name given as a string.
            entry = zipfile.ZipInfo("x")
            entry.filename = name
            package.writestr(entry, data)
    return archive


# --- FMUs in C ------------------------------------------------------------------------------------

SOURCES = ROOT / "tests" / "c"

RELAY = (SOURCES / "relay.xml").read_text(encoding="utf-8")

INPUT, OUTPUT = '"input"><Real start="0"', '"2" causality="output"><Real'
"""The input u and the output y in its model description."""


def with_units(u: str, y: str) -> dict[str, str]:
    """Return the replacements that give the input and the output of a relay their units."""
    units = {INPUT: u, OUTPUT: y}
    return {text: f'{text} unit="{unit}"' for text, unit in units.items() if unit}


def compiled(folder: Path, *definitions: str, source: str) -> bytes:
    """Return the binary of a source in tests/c."""
    library = folder / "library.so"
    options = ["-shared", "-fPIC", "-pthread", "-Wall", "-Wextra", "-Werror"]
    options += [f"-D{definition}" for definition in definitions]
    command = ["cc", *options, "-o", library, SOURCES / source, "-lm"]
    subprocess.run(command, check=True)
    return library.read_bytes()


def pack(file: Path, xml: str, binary: bytes, **resources: str) -> Path:
    """Write an FMU whose binary has the name of the file."""
    platform = "x86_64-linux" if 'fmiVersion="3.0"' in xml else "linux64"
    files = {"modelDescription.xml": xml, f"binaries/{platform}/{file.stem}.so": binary}
    return write(file, files | {f"resources/{name}": text for name, text in resources.items()})


def in_c(file: Path, *definitions: str, xml: str = "", **resources: str) -> Path:
    """Write an FMU in C of tests/c, by default with the description there."""
    source = SOURCES / file.stem.lower()
    xml = xml or source.with_suffix(".xml").read_text(encoding="utf-8")
    binary = compiled(file.parent, *definitions, source=f"{source.name}.c")
    return pack(file, xml, binary, **resources)


# --- packages outside the repository --------------------------------------------------------------

OUTSIDE = ROOT / "target" / "outside"
"""The target folder of all packages outside the repository: dependencies are built once."""


@contextmanager
def started(command: Sequence[object], folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a command in a folder; those outside run one at a time."""
    env = {**os.environ, "PYTHONPATH": str(ROOT / "python"), "FMUS": "target/fmu"}
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with ExitStack() as stack:
        if folder != ROOT:
            env |= {"CARGO_TARGET_DIR": str(OUTSIDE), "CARGO_INCREMENTAL": "0"}
            # Debug information takes long to write. An export must override the abort.
            env |= {"CARGO_PROFILE_DEV_DEBUG": "0", "CARGO_PROFILE_RELEASE_PANIC": "abort"}
            stack.enter_context(FileLock(OUTSIDE / "lock"))
        process = subprocess.Popen(list(map(str, command)), cwd=folder, env=env, **pipes)
        yield stack.enter_context(process)


def call(command: Sequence[object], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder, whatever its exit code; those outside run one at a time."""
    with started(command, folder) as process:
        output = process.communicate()
    return subprocess.CompletedProcess(process.args, process.returncode, *output)


def shell(commands: str, folder: Path = ROOT) -> Path:
    """Run shell commands, which must succeed, and return the folder in which they end."""
    commands = commands.replace("target/venv/bin/python", sys.executable)
    done = call(["bash", "-ec", f"{commands}\npwd"], folder)
    assert done.returncode == 0, f"{commands}\n{done.stdout}{done.stderr}"
    return Path(done.stdout.splitlines()[-1])


def new_package(name: str, folder: Path) -> Path:
    """Create a package in a folder; return its folder."""
    return prepare(shell(f"{PROGRAM} new {name}\ncd {name}", folder))


def prepare(package: Path) -> Path:
    """Let a new package use the versions in Cargo.lock, and find its FMUs in `target`."""
    shutil.copy(ROOT / "Cargo.lock", package)
    (package / "target").symlink_to(OUTSIDE)
    return package


def with_binary(fmu: Path, content: bytes, to: Path) -> Path:
    """Copy an FMU with another component."""
    files = read(fmu)
    return write(to, files | {name: content for name in files if name.startswith("binaries/")})
