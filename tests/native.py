"""The native master as a program, with systems and small C FMUs for it."""

import csv
import json
import re
import shutil
import subprocess
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest

from pendulum_fmus.project import PROGRAM, ROOT

LOOPS = ROOT / "examples" / "closed-loop"

SECONDS = 300
"""Time limit of one run on a busy machine [s]."""


def run(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run the program, which must neither panic nor be killed, whatever its exit code."""
    if not PROGRAM.exists():
        pytest.fail(f"{PROGRAM} is missing: `make fmus` builds it", pytrace=False)
    command = [PROGRAM, *map(str, arguments)]
    result = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=SECONDS)
    assert "panicked" not in result.stderr, result.stderr
    assert result.returncode in (0, 1, 2), result
    return result


def simulate(system: Path, folder: Path, *options: object) -> dict[str, np.ndarray]:
    """Simulate a system, which must succeed silently; return the columns of the CSV file."""
    file = folder / "results.csv"
    result = run("simulate", system, "--csv", file, *options)
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
    **settings: Any,
) -> Path:
    """Write a system of instances of an FMU with start values, 1 s long in steps of 0.25 s."""
    settings = {"start": 0.0, "stop": 1.0, "step": 0.25} | settings
    lines = [f"{key} = {_toml(value)}" for key, value in settings.items()]
    lines.append(f"connections = {_toml(list(connections))}")
    for name, start in components.items():
        lines += ["[[component]]", f"name = {_toml(name)}", f'fmu = "{fmu}.fmu"']
        lines.append("[component.start]")
        lines += [f"{_toml(variable)} = {_toml(value)}" for variable, value in start.items()]
    file = folder / "system.toml"
    file.write_text("\n".join(lines), encoding="utf-8")
    return file


def _toml(value: Any) -> str:
    """Format a value as TOML, which for most types is JSON."""
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {_toml(item)}' for key, item in value.items())} }}"
    return json.dumps(value, ensure_ascii=False).replace("NaN", "nan")


# --- FMUs in C ------------------------------------------------------------------------------------

DESCRIPTION = (ROOT / "tests" / "c" / "relay.xml").read_text(encoding="utf-8")

GUID = "{relay <&> 'single' \"double\"}"
"""As in relay.c."""


def compiled(folder: Path, *definitions: str, source: str = "relay.c") -> bytes:
    """Return the binary of a source in tests/c."""
    compiler = shutil.which("cc") or pytest.skip("no C compiler")
    library = folder / "library.so"
    options = ["-shared", "-fPIC", "-O1", "-Wall", "-Wextra", *(f"-D{d}" for d in definitions)]
    subprocess.run(
        [compiler, *options, "-o", library, ROOT / "tests" / "c" / source, "-lm"], check=True
    )
    return library.read_bytes()


def replaced(text: str, replacements: Mapping[str, str]) -> str:
    """Return a text with some parts replaced, all of which must be there."""
    for old, new in replacements.items():
        assert old in text, old
        text = text.replace(old, new)
    return text


def description(
    replacements: Mapping[str, str] | None = None,
    *,
    u_unit: str = "",
    y_unit: str = "",
    guid: str = GUID,
) -> str:
    """Return the model description of relay.c with some text replaced."""
    text = re.sub(r'guid="[^"]*"', lambda _: f"guid={quoteattr(guid)}", DESCRIPTION)
    replacements = dict(replacements or {})
    if u_unit:
        replacements['"input"><Real start="0"'] = f'"input"><Real start="0" unit="{u_unit}"'
    if y_unit:
        output = '"2" causality="output"><Real'
        replacements[output] = f'{output} unit="{y_unit}"'
    return replaced(text, replacements)


def pack(file: Path, xml: str, binary: bytes, platform: str = "linux64", **resources: str) -> Path:
    """Write an FMU whose binary has the name of the file."""
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", xml)
        archive.writestr(f"binaries/{platform}/{file.stem}.so", binary)
        for name, text in resources.items():
            archive.writestr(f"resources/{name}", text)
    return file
