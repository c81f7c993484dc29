"""What some tests need beyond what the README names, and the command that installs it.

`TOOL.mark` marks a test, which is skipped without the tool. At the end, pytest prints how many
were skipped for each. `pytest -m needs` runs these tests alone, and fails without the tools.
"""

import ctypes
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

import pytest

import node


@dataclass(frozen=True)
class Tool:
    """A program or a library."""

    name: str
    command: str  # that installs it
    there: Callable[[], bool]

    @property
    def mark(self) -> pytest.MarkDecorator:
        """The mark of a test that needs it."""
        return pytest.mark.needs(self)

    def missing(self) -> str:
        """Return the message if it is missing."""
        return f"{self.name}, which `{self.command}` installs"

    def require(self) -> None:
        """Fail the test if it is missing."""
        if not self.there():
            pytest.fail(f"it needs {self.missing()}", pytrace=False)


def _program(name: str, command: str, title: str = "", *others: str) -> Tool:
    names = (name, *others)
    return Tool(title or name, command, lambda: all(map(shutil.which, names)))


def _library(file: str, command: str) -> Tool:
    def loads() -> bool:
        try:
            return bool(ctypes.CDLL(file))
        except OSError:
            return False

    return Tool(file.partition(".")[0], command, loads)


CHROMIUM = _program("chromium", "make system", "Chromium")
NODE = Tool("Node", "make system", lambda: node.program() is not None)
LIBTBB = _library("libtbb.so.12", "make system")
MICROCONTROLLER = _program(
    "arm-none-eabi-gcc", "make system", "gcc for microcontrollers with qemu", "qemu-system-arm"
)
VALGRIND = _program("valgrind", "make valgrind")
WINE = _program("wine", "make elsewhere", "Wine")
MINGW = _program("x86_64-w64-mingw32-gcc", "make elsewhere", "MinGW")
CMAKE = _program("cmake", "make system")
CLANG = _program("clang", "make elsewhere")
TCC = _program("tcc", "make system")
I686 = _program("i686-linux-gnu-gcc", "make elsewhere", "gcc for 32-bit x86")
ARM32 = _program("arm-linux-gnueabihf-gcc", "make elsewhere", "gcc for 32-bit ARM", "qemu-arm")
S390X = _program("s390x-linux-gnu-gcc", "make elsewhere", "gcc for s390x", "qemu-s390x")
QEMU = _program("qemu-aarch64", "make elsewhere", "qemu")
LIEF = Tool("lief", "make elsewhere", lambda: find_spec("lief") is not None)


# --- hooks of pytest, which conftest.py imports ---------------------------------------------------


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that open a page, before tests are selected by their marks."""
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker(CHROMIUM.mark)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test without its tool, or fail if tests that need tools were asked for."""
    for mark in item.iter_markers("needs"):
        (tool,) = mark.args
        if "needs" in item.config.option.markexpr.split():
            tool.require()
        elif not tool.there():
            pytest.skip(tool.missing())


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say what the skipped tests need, once for each tool."""
    skipped = [report.longrepr[2] for report in terminalreporter.stats.get("skipped", ())]
    for reason in sorted(set(skipped)):
        count = skipped.count(reason)
        said = reason.removeprefix("Skipped: ")
        terminalreporter.write_line(f"{count} skipped without {said}")
