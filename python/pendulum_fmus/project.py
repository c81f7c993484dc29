"""Where the project's files are: the package runs from its sources (`pip install --editable .`)."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

FMUS = ROOT / "target" / "fmu"
"""Where `cargo fmu export` writes the FMUs."""

REPORT = ROOT / "target" / "report"
"""Where Table 1 and the figures go."""

PROGRAM = ROOT / "target" / "native" / "cargo-fmu"
"""The optimized command line, with the native master, as `make native` builds it."""
