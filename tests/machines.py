"""Platforms for the C hosts: native, valgrind, and emulated machines."""

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
"""Folder to which `make cross` writes FMUs for other platforms."""

SECONDS = 300
"""Time limit of one run [s]."""

# Results are compared bit by bit, so the compiler must not fuse multiplications and additions.
OPTIONS = [
    "-std=c99", "-D_POSIX_C_SOURCE=200809L", "-Wall", "-Wextra", "-Werror", "-g",
    "-ffp-contract=off",
]  # fmt: skip


_unpacked = TemporaryDirectory(prefix="hosts-")


class Fmu(NamedTuple):
    """An unpacked FMU binary and its model description."""

    binary: Path
    guid: str
    variables: dict[str, ModelVariable]

    @classmethod
    def unpack(cls, path: Path, platforms: dict[str, str]) -> Self:
        """Unpack the binary for a platform, whose names are given by the version of FMI."""
        description = fmpy.read_model_description(path)
        platform = platforms[description.fmiVersion]
        extension = "dll" if "win" in platform else "so"
        name = f"binaries/{platform}/{description.coSimulation.modelIdentifier}.{extension}"
        with zipfile.ZipFile(path) as package:
            binary = Path(package.extract(name, mkdtemp(dir=_unpacked.name)))
        return cls(binary, description.guid, {v.name: v for v in description.modelVariables})


@dataclass(frozen=True)
class Machine:
    """A machine: how to compile programs for it and run them on it."""

    name: str
    compiler: tuple[str, ...] = ("cc",)
    emulator: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ("-ldl", "-lm")
    fmus: Path = FMUS
    platform: str = "linux64"
    """Folder of its binaries in these FMUs, in FMI 2.0."""
    platform_3: str = "x86_64-linux"
    """The same in FMI 3.0."""
    target: str | None = None
    """Its name for `cargo fmu export`; by default this machine."""
    remedy: str = "`make elsewhere` installs the requirements"

    @contextmanager
    def started(self, _folder: Path) -> Iterator[None]:
        """Check that its programs are installed."""
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
        """Run a program that must succeed without warnings; return its output."""
        done = _call(*self.emulator, program, *arguments)
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
        return done.stdout

    def unpack(self, model: str, fmus: Path | None = None) -> Fmu:
        """Unpack an FMU, by default an exported one, with its binary for the machine."""
        fmu = (fmus or self.fmus) / f"{model}.fmu"
        if not fmu.exists():
            pytest.fail(f"{fmu} is missing: {self.remedy}", pytrace=False)
        return Fmu.unpack(fmu, {"2.0": self.platform, "3.0": self.platform_3})

    def path(self, file: Path) -> str:
        """Return the path of a file as seen by its programs."""
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
    """Windows, emulated by Wine.

    Wine 8.0 lacks bcryptprimitives.dll, which seeds Rust's HashMap; the FMUs do not use one.
    """

    @contextmanager
    def started(self, folder: Path) -> Iterator[None]:
        """Create a separate Wine prefix, and stop its processes at the end."""
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
                _call("wineserver", "--kill")  # fails if it has already exited

    def path(self, file: Path) -> str:
        """Return the path of a file on drive Z, which contains all files of this machine."""
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
    platform_3="x86_64-windows",
    target="x86_64-pc-windows-gnu",
)

ARM = Machine(
    "arm",
    compiler=(sys.executable, "-m", "ziglang", "cc", "-target", "aarch64-linux-gnu.2.17"),
    emulator=("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"),
    fmus=CROSS / "aarch64",
    platform_3="aarch64-linux",
    target="aarch64-unknown-linux-gnu.2.17",
)

MACHINES = [
    NATIVE,
    pytest.param(VALGRIND, marks=pytest.mark.valgrind),
    pytest.param(WINDOWS, marks=pytest.mark.elsewhere),
    pytest.param(ARM, marks=pytest.mark.elsewhere),
]
