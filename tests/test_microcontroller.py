"""The loop of the paper from C sources: in one program, and on a microcontroller."""

import importlib.util
import re
import subprocess
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from native import LOOPS, simulate
from needs import MICROCONTROLLER
from pendulum_fmus.project import ROOT

EXAMPLE = ROOT / "examples" / "microcontroller"
PAGE = ROOT / "docs" / "sources.md"

CPUS = ("cortex-m7", "cortex-m4")
"""In the order of the page's columns."""


@pytest.fixture(scope="module")
def picture() -> ModuleType:
    """Import the script of the example, which reads and draws the signals of the board."""
    spec = importlib.util.spec_from_file_location("picture", EXAMPLE / "picture.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def native(program: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """Return the signals of the same loop by the native FMUs."""
    folder = tmp_path_factory.mktemp("native")
    return simulate(LOOPS / "pid-rbf.toml", folder, "--set", "source.signal=sine")


def make(target: str, sources: Path, out: Path, *options: str) -> str:
    """Make a target of the example, without a warning of the compiler; return what it prints."""
    command = ["make", "--silent", "--jobs=2", "--directory", EXAMPLE, target]
    command += [f"FMUS={sources}", f"OUT={out}", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def assert_same_bits(ours: dict[str, np.ndarray], native: dict[str, np.ndarray]) -> None:
    for name, signal in ours.items():
        assert signal.size == 20_000
        assert name == "source.d" or np.ptp(signal) > 0
        differ = np.flatnonzero(signal.view(np.uint64) != native[name].view(np.uint64))
        assert differ.size == 0, f"{name} differs from row {differ[0]}"


def test_three_fmus_in_a_program_have_the_bits_of_the_binaries(
    sources: Path, native: dict[str, np.ndarray], picture: ModuleType, tmp_path: Path
) -> None:
    make("pc", sources, tmp_path, "OPTIMIZE=-O0")
    rows = np.loadtxt(tmp_path / "pc" / "signals.csv", delimiter=",").T
    assert_same_bits(dict(zip(picture.NAMES, map(np.ascontiguousarray, rows), strict=True)), native)


@MICROCONTROLLER.mark
@pytest.mark.parametrize("cpu", CPUS)
def test_the_loop_on_a_microcontroller_has_the_bits_of_the_binaries(
    cpu: str,
    sources: Path,
    native: dict[str, np.ndarray],
    picture: ModuleType,
    tmp_path: Path,
) -> None:
    lines = make("run", sources, tmp_path, f"CPU={cpu}").splitlines()
    needs = {name: int(number) for name, number in (line.split(": ") for line in lines)}
    assert needs["steps"] == 20_000
    board = picture.on_board(tmp_path / cpu / "signals.bin")
    assert_same_bits({name: np.ascontiguousarray(x) for name, x in board.items()}, native)
    rows = re.findall(r"\| ([\w ]+) \| (\d+) \| (\d+) \|\n", PAGE.read_text(encoding="utf-8"))
    assert len(rows) == 4
    for name, *most in rows:
        assert 0 < needs[name] <= int(most[CPUS.index(cpu)]), name
    symbols = subprocess.check_output(["arm-none-eabi-nm", tmp_path / cpu / "loop.elf"], text=True)
    assert not {"malloc", "_sbrk"} & set(symbols.split())
