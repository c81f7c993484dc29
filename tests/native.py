"""The native master as a program, systems for it to run, and small FMUs in C to put in them."""

import csv
import json
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
"""Time that one run may take."""


def run(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run the program, which must neither panic nor be killed, whatever its exit code."""
    if not PROGRAM.exists():
        pytest.fail(f"{PROGRAM} is missing: `make native` builds it", pytrace=False)
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
    """Simulate a system, which must succeed in silence; returns the columns of the CSV file."""
    file = folder / "results.csv"
    result = run("simulate", system, "--csv", file, *options)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    return read_csv(file)


def read_csv(file: Path) -> dict[str, np.ndarray]:
    """Return the columns by their heads without the unit."""
    with file.open(encoding="utf-8", newline="") as lines:
        head, *rows = csv.reader(lines)
    names = [name.rpartition(" [")[0] for name in head]
    return dict(zip(names, np.array(rows, float).T, strict=True))


def refusal(folder: Path, *arguments: object) -> str:
    """Run a command that must fail and write nothing to the folder; returns what it says."""
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
    connections: Sequence[str] = (),
    **settings: Any,
) -> Path:
    """Write a system of FMUs `Relay.fmu`, by their start values, from 0 to 1 s by 0.25 s."""
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
    """Write a value as TOML, which for these types is JSON."""
    return json.dumps(value, ensure_ascii=False).replace("NaN", "nan")


# --- FMUs in C ------------------------------------------------------------------------------------

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Relay" guid=GUID>
  <CoSimulation modelIdentifier="Relay"/>
  <UnitDefinitions>
    <Unit name="s"><BaseUnit s="1"/></Unit>
    <Unit name="rad"><BaseUnit rad="1"/></Unit>
    <Unit name="radian"><BaseUnit rad="1" factor="1"/></Unit>
    <Unit name="deg"><BaseUnit rad="1" factor="0.017453292519943295"/></Unit>
    <Unit name="gon"/>
  </UnitDefinitions>
  <TypeDefinitions>
    <SimpleType name="Shape"><Enumeration>
      <Item name="linear" value="1"/><Item name="square" value="4"/>
    </Enumeration></SimpleType>
  </TypeDefinitions>
  <ModelVariables>
    <ScalarVariable name="time" valueReference="0" causality="output"><Real unit="s"/>
    </ScalarVariable>
    <ScalarVariable name="u" valueReference="1" causality="input"><Real start="0" unit="U_UNIT"/>
    </ScalarVariable>
    <ScalarVariable name="y" valueReference="2" causality="output"><Real unit="Y_UNIT"/>
    </ScalarVariable>
    <ScalarVariable name="gain" valueReference="3" causality="parameter" variability="fixed">
      <Real start="1"/></ScalarVariable>
    <ScalarVariable name="status_time" valueReference="4" causality="parameter"
      variability="tunable"><Real start="1e300" unit="s"/></ScalarVariable>
    <ScalarVariable name="number" valueReference="5" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="count" valueReference="0" causality="output" variability="discrete">
      <Integer/></ScalarVariable>
    <ScalarVariable name="n" valueReference="1" causality="input" variability="discrete">
      <Integer start="0"/></ScalarVariable>
    <ScalarVariable name="m" valueReference="2" causality="output" variability="discrete">
      <Integer/></ScalarVariable>
    <ScalarVariable name="add" valueReference="3" causality="parameter" variability="fixed">
      <Integer start="0"/></ScalarVariable>
    <ScalarVariable name="status" valueReference="4" causality="parameter" variability="fixed">
      <Integer start="0"/></ScalarVariable>
    <ScalarVariable name="logged" valueReference="5" causality="parameter" variability="fixed">
      <Integer start="-1"/></ScalarVariable>
    <ScalarVariable name="shape" valueReference="6" causality="parameter" variability="fixed">
      <Enumeration declaredType="Shape" start="1"/></ScalarVariable>
    <ScalarVariable name="choice" valueReference="7" causality="output" variability="discrete">
      <Enumeration declaredType="Shape"/></ScalarVariable>
    <ScalarVariable name="odd" valueReference="0" causality="output" variability="discrete">
      <Boolean/></ScalarVariable>
    <ScalarVariable name="b" valueReference="1" causality="input" variability="discrete">
      <Boolean start="false"/></ScalarVariable>
    <ScalarVariable name="c" valueReference="2" causality="output" variability="discrete">
      <Boolean/></ScalarVariable>
    <ScalarVariable name="invert" valueReference="3" causality="parameter" variability="fixed">
      <Boolean start="false"/></ScalarVariable>
    <ScalarVariable name="direct" valueReference="4" causality="parameter" variability="fixed">
      <Boolean start="false"/></ScalarVariable>
    <ScalarVariable name="file" valueReference="0" causality="parameter" variability="fixed">
      <String start=""/></ScalarVariable>
    <ScalarVariable name="label" valueReference="1" causality="output" variability="discrete">
      <String/></ScalarVariable>
    <ScalarVariable name="u_max" valueReference="6" causality="parameter" variability="fixed">
      <Real start="1e300"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs>
      <Unknown index="1"/><Unknown index="3"/><Unknown index="6"/><Unknown index="7"/>
      <Unknown index="9"/><Unknown index="14"/><Unknown index="15"/><Unknown index="17"/>
      <Unknown index="21"/>
    </Outputs>
  </ModelStructure>
</fmiModelDescription>
"""

GUID = "{relay <&> 'single' \"double\"}"
"""As in relay.c."""


def compiled(folder: Path, *definitions: str) -> bytes:
    """Return the binary of tests/c/relay.c."""
    compiler = shutil.which("cc") or pytest.skip("no C compiler")
    library = folder / "Relay.so"
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-Wextra",
         *(f"-D{name}" for name in definitions),
         "-o", library, ROOT / "tests" / "c" / "relay.c"],
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
    """Return the model description, with some of its text replaced."""
    text = DESCRIPTION.replace("GUID", quoteattr(guid))
    for name, unit in (("U_UNIT", u_unit), ("Y_UNIT", y_unit)):
        text = text.replace(name, unit).replace(' unit=""', "")
    for old, new in (replaced or {}).items():
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
