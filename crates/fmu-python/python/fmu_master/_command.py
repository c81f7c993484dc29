"""The command line `cargo-fmu`, and how the processes are started in which FMUs run."""

import sys
from pathlib import Path

from . import _native

START = "import sys; sys.path.insert(0, sys.argv.pop(1)); import _native; "


def program(call: str, folder: Path) -> list[str]:
    """Return a command that makes a call of the native module, and imports no package."""
    return [sys.executable, "-I", "-S", "-c", START + call, str(folder)]


def command(folder: Path) -> list[str]:
    """Return the command line, by the native module in a folder."""
    again = "sys.orig_argv[:6]"  # all words but the arguments
    return program(f"sys.argv[0] = 'cargo-fmu'; _native.main({again}, sys.argv)", folder)


MODULE = Path(_native.__file__)
"""The native module."""

WORKER = program("_native.work()", MODULE.parent)
"""A process that does what it is sent."""

COMMAND = command(MODULE.parent)
"""The command line."""


def main() -> None:
    """Run the command line with the arguments of this program."""
    _native.main(COMMAND, sys.argv)
