"""Paths of the project; of the current folder, if the package is installed without its sources."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
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


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Say how to install an extra, and exit, if one of its modules is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name and error.name.startswith("fmu_master"):
            sys.exit("error: fmu_master is missing; `make module` builds it")
        where = f"'{ROOT}[{name}]'" if ROOT is _sources else f"'pendulum-fmus[{name}]'"
        sys.exit(f"error: {error.name} is missing; `pip install {where}` installs it")
