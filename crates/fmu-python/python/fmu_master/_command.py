"""The command line `cargo-fmu`, and how the processes are started in which FMUs run."""

import sys
from pathlib import Path

from . import _native

_START = "import sys; sys.path.insert(0, sys.argv.pop(1)); import _native; "


def program(call: str) -> list[str]:
    """Return a command that makes a call of the native module, and imports no package."""
    folder = str(Path(_native.__file__).parent)
    return [sys.executable, "-I", "-S", "-c", _START + call, folder]


_AGAIN = "sys.argv[0] = 'cargo-fmu'; _native.main([], sys.argv)"


def main() -> None:
    """Run the command line with the arguments of this program."""
    _native.main(program(_AGAIN), sys.argv)


WORKER = program("_native.work()")
"""A process that does what it is sent."""
