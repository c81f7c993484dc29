"""The command line `cargo-fmu`, which is also what worker processes start with."""

import sys
from pathlib import Path

from . import _native

MODULE = Path(_native.__file__)
"""The native module."""

PROGRAM = MODULE.with_name("_program.py")
"""The program beside it."""


def command(folder: Path, python: str = sys.executable) -> list[str]:
    """Return the command line, by the program and the native module in a folder."""
    return [python, "-E", "-s", "-S", str(folder / PROGRAM.name)]


COMMAND = command(MODULE.parent)
"""The command line."""


def main() -> None:
    """Run the command line with the arguments of this program."""
    _native.main(COMMAND, sys.argv)
