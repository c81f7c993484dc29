"""Where the hosts in C run: here, and under valgrind."""

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from master import FMUS
from slave import Fmu, unpack

SOURCES = Path(__file__).parent / "c"

SECONDS = 300
"""Time that one run may take."""

# Bits of results are compared: a compiler may not round a product and a sum at once.
OPTIONS = [
    "-std=c99", "-D_POSIX_C_SOURCE=200809L", "-Wall", "-Wextra", "-Werror", "-g",
    "-ffp-contract=off",
]  # fmt: skip


@dataclass(frozen=True)
class Machine:
    """A machine: how programs are compiled for it, and run on it."""

    name: str
    compiler: tuple[str, ...] = ("cc",)
    emulator: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ("-ldl", "-lm")
    fmus: Path = FMUS
    platform: str = "linux64"
    """Folder of its binaries in these FMUs."""
    target: str | None = None
    """What `cargo fmu export` calls it; by default it is this machine."""
    remedy: str = "`make elsewhere` installs what is needed"

    @contextmanager
    def started(self, _folder: Path) -> Iterator[None]:
        """See that its programs are there."""
        for program in (self.compiler[0], *self.emulator[:1]):
            if shutil.which(program) is None:
                pytest.fail(f"`{program}` is not on the PATH: {self.remedy}", pytrace=False)
        yield

    def compile(self, name: str, folder: Path) -> Path:
        """Compile one of the hosts."""
        program = folder / f"{name}.exe"
        source = SOURCES / f"{name}.c"
        command = [*self.compiler, *OPTIONS, "-o", program, source, *self.libraries]
        subprocess.run(command, check=True)
        return program

    def run(self, program: str | Path, *arguments: str) -> str:
        """Run a program that ends well and complains of nothing; returns what it prints."""
        done = _call(*self.emulator, program, *arguments)
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    def unpack(self, model: str, fmus: Path | None = None) -> Fmu:
        """Unpack an FMU, by default one of ours, with its binary for the machine."""
        fmus = fmus or self.fmus
        if not fmus.exists():
            pytest.fail(f"{fmus} is missing: {self.remedy}", pytrace=False)
        return unpack(fmus, model, self.platform)

    def path(self, file: Path) -> str:
        """Return what its programs call a file."""
        return str(file)


def _call(*command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
    )


NATIVE = Machine("native", remedy="a C compiler is needed")

VALGRIND = Machine(
    "valgrind",
    remedy="`make valgrind` installs it",
    emulator=(
        "valgrind", "--quiet", "--error-exitcode=9", "--leak-check=full",
        "--errors-for-leak-kinds=definite,indirect",
    ),
)  # fmt: skip

MACHINES = [
    NATIVE,
    pytest.param(VALGRIND, marks=pytest.mark.valgrind),
]
