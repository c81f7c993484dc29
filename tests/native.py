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

SECONDS = 60
"""Time limit of one run [s]."""


def run(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run the program, which must neither panic nor be killed, whatever its exit code."""
    if not PROGRAM.exists():
        pytest.fail(f"{PROGRAM} is missing: `make fmus` builds it", pytrace=False)
    result = subprocess.run(
        [PROGRAM, *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        timeout=SECONDS,
    )
    assert "panicked" not in result.stderr, result.stderr
    assert result.returncode in (0, 1, 2), result
    return result


def simulate(system: Path, folder: Path, *options: object) -> dict[str, np.ndarray]:
    """Simulate a system, which must succeed silently; return the columns of the CSV file."""
    file = folder / "results.csv"
    result = run("simulate", system, "--csv", file, *options)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    return read_csv(file)


def read_csv(file: Path) -> dict[str, np.ndarray]:
    """Return the columns by name, without units."""
    with file.open(encoding="utf-8", newline="") as lines:
        head, *rows = csv.reader(lines)
    names = [re.sub(r" \[[^\[]*\]$", "", name) for name in head]
    words = {"false": "0", "true": "1"}
    columns = [[words.get(cell, cell) for cell in column] for column in zip(*rows, strict=True)]
    return {name: np.array(column, float) for name, column in zip(names, columns, strict=True)}


def refusal(folder: Path, *arguments: object) -> str:
    """Run a command that must fail and write nothing to the folder; return its message."""
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    result = run(*arguments, cwd=folder)
    after = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert result.returncode == 1, result
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert after == before
    return result.stderr.removeprefix("error: ").strip()


# --- systems --------------------------------------------------------------------------------------


def write_system(
    folder: Path,
    components: Mapping[str, Mapping[str, Any]],
    connections: Sequence[str | Mapping[str, Any]] = (),
    **settings: Any,
) -> Path:
    """Write a system of `Relay.fmu` instances with start values, 1 s long in steps of 0.25 s."""
    settings = {"start": 0.0, "stop": 1.0, "step": 0.25} | settings
    lines = [f"{key} = {_toml(value)}" for key, value in settings.items()]
    lines.append(f"connections = {_toml(list(connections))}")
    for name, start in components.items():
        lines += [
            "[[component]]",
            f"name = {_toml(name)}",
            'fmu = "Relay.fmu"',
            "[component.start]",
        ]
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
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-Wextra",
         *(f"-D{name}" for name in definitions),
         "-o", library, ROOT / "tests" / "c" / source],
        check=True,
    )  # fmt: skip
    return library.read_bytes()


def description(
    replaced: Mapping[str, str] | None = None,
    *,
    u_unit: str = "",
    y_unit: str = "",
    guid: str = GUID,
) -> str:
    """Return the model description with some text replaced."""
    text = re.sub(r'guid="[^"]*"', lambda _: f"guid={quoteattr(guid)}", DESCRIPTION)
    replaced = dict(replaced or {})
    if u_unit:
        replaced['"input"><Real start="0"'] = f'"input"><Real start="0" unit="{u_unit}"'
    if y_unit:
        replaced['"2" causality="output"><Real'] = f'"2" causality="output"><Real unit="{y_unit}"'
    for old, new in replaced.items():
        assert old in text, old
        text = text.replace(old, new)
    return text


def pack(file: Path, xml: str, binary: bytes, **resources: str) -> Path:
    """Write an FMU."""
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", xml)
        archive.writestr("binaries/linux64/Relay.so", binary)
        for name, text in resources.items():
            archive.writestr(f"resources/{name}", text)
    return file
