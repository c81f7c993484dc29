"""Where the hosts in C run: here, under valgrind, and on other platforms, which are emulated."""

import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from tempfile import TemporaryDirectory, mkdtemp
from typing import NamedTuple, Self

import fmpy
import pytest
from fmpy.model_description import ModelVariable

from pendulum_fmus.project import FMUS

SOURCES = Path(__file__).parent / "c"

CROSS = FMUS.parent / "cross"
"""Where `make cross` writes FMUs for other platforms."""

SECONDS = 300
"""Time that one run may take."""

# Bits of results are compared: a compiler may not round a product and a sum at once.
OPTIONS = [
    "-std=c99", "-D_POSIX_C_SOURCE=200809L", "-Wall", "-Wextra", "-Werror", "-g",
    "-ffp-contract=off",
]  # fmt: skip


_unpacked = TemporaryDirectory(prefix="hosts-")


class Fmu(NamedTuple):
    """A binary of an FMU, unpacked, and what its model description says."""

    binary: Path
    guid: str
    variables: dict[str, ModelVariable]

    @classmethod
    def unpack(cls, path: Path, platform: str) -> Self:
        """Unpack the binary for a platform."""
        description = fmpy.read_model_description(path)
        extension = "dll" if platform.startswith("win") else "so"
        name = f"binaries/{platform}/{description.coSimulation.modelIdentifier}.{extension}"
        with zipfile.ZipFile(path) as package:
            binary = Path(package.extract(name, mkdtemp(dir=_unpacked.name)))
        return cls(binary, description.guid, {v.name: v for v in description.modelVariables})


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
        fmu = (fmus or self.fmus) / f"{model}.fmu"
        if not fmu.exists():
            pytest.fail(f"{fmu} is missing: {self.remedy}", pytrace=False)
        return Fmu.unpack(fmu, self.platform)

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


class Wine(Machine):
    """Windows, as far as Wine is it.

    Wine 8.0 lacks bcryptprimitives.dll, which gives Rust the seed of a HashMap; FMUs have none.
    """

    @contextmanager
    def started(self, folder: Path) -> Iterator[None]:
        """Make a Windows of its own, and end all of it at the end."""
        with super().started(folder), pytest.MonkeyPatch.context() as environment:
            for name, value in {
                "WINEPREFIX": str(folder / "wine"),
                "WINEARCH": "win64",
                "WINEDEBUG": "-all",
                "WINEDLLOVERRIDES": "mscoree,mshtml,winemenubuilder.exe=",  # nothing to install
                "DISPLAY": "",
            }.items():
                environment.setenv(name, value)
            try:
                _call("wine", "wineboot", "--init").check_returncode()
                yield
            finally:
                _call("wineserver", "--kill")  # fails if it has ended by itself

    def path(self, file: Path) -> str:
        """Return what its programs call a file: all of this machine's are on the drive Z."""
        return str(PureWindowsPath(f"Z:{file}"))


NATIVE = Machine("native", remedy="a C compiler is needed")

VALGRIND = Machine(
    "valgrind",
    remedy="`make valgrind` installs it",
    emulator=(
        "valgrind", "--quiet", "--error-exitcode=9", "--leak-check=full",
        "--errors-for-leak-kinds=definite,indirect",
    ),
)  # fmt: skip

WINDOWS = Wine(
    "windows",
    compiler=("x86_64-w64-mingw32-gcc",),
    emulator=("wine",),
    libraries=(),
    fmus=CROSS,
    platform="win64",
    target="x86_64-pc-windows-gnu",
)

ARM = Machine(
    "arm",
    compiler=(sys.executable, "-m", "ziglang", "cc", "-target", "aarch64-linux-gnu.2.17"),
    emulator=("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"),
    fmus=CROSS / "aarch64",
    target="aarch64-unknown-linux-gnu.2.17",
)

MACHINES = [
    NATIVE,
    pytest.param(VALGRIND, marks=pytest.mark.valgrind),
    pytest.param(WINDOWS, marks=pytest.mark.elsewhere),
    pytest.param(ARM, marks=pytest.mark.elsewhere),
]
