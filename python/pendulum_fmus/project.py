"""Paths of the project; of the current folder, if the package is installed without its sources."""

from pathlib import Path

_sources = Path(__file__).resolve().parents[2]

ROOT = _sources if (_sources / "pyproject.toml").is_file() else Path.cwd()

FMUS = ROOT / "target" / "fmu"
"""Folder to which `cargo fmu export` writes the FMUs."""

SENSOR = ROOT / "target" / "examples" / "Sensor.fmu"
"""The example of a sensor, exported by `make fmus`."""

REPORT = ROOT / "target" / "report"
"""Folder for Table 1 and the figures."""

PROGRAM = ROOT / "target" / "debug" / "cargo-fmu"
"""The command line with the native master, built by `make fmus`."""
