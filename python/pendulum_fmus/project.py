"""Paths of the project; the package runs from its sources (`pip install --editable .`)."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

FMUS = ROOT / "target" / "fmu"
"""Folder to which `cargo fmu export` writes the FMUs."""

SENSOR = ROOT / "target" / "examples" / "Sensor.fmu"
"""The example of a sensor, exported by `make fmus`."""

REPORT = ROOT / "target" / "report"
"""Folder for Table 1 and the figures."""

PROGRAM = ROOT / "target" / "debug" / "cargo-fmu"
"""The command line with the native master, built by `make fmus`."""
