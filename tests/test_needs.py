"""Tests whose tool is missing are skipped, and pytest says once what to install."""

import re
import subprocess
import sys
from pathlib import Path

from pendulum_fmus.project import ROOT


def pages_tested(folder: Path, *options: str) -> tuple[int, str]:
    """Run the tests of the page where no program is in sight; return exit code and output."""
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *options]
    done = subprocess.run(
        [*command, "tests/test_web.py"],
        cwd=ROOT,
        env={"PATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout


def test_a_missing_tool_is_named_once_with_the_command_that_installs_it(tmp_path: Path) -> None:
    code, said = pages_tested(tmp_path)
    assert code == 0, said
    named = re.findall(r"^(\d+) skipped without (.*)$", said, re.MULTILINE)
    assert [name for _, name in named] == [
        f"{name}, which `make system` installs" for name in ("Chromium", "Node")
    ]
    assert sum(int(count) for count, _ in named) == int(re.findall(r"(\d+) skipped in", said)[0])


def test_tests_that_need_tools_fail_without_them_if_they_are_asked_for(tmp_path: Path) -> None:
    code, said = pages_tested(tmp_path, "-m", "needs", "-k", "node")
    assert code == 1, said
    assert "it needs Node, which `make system` installs" in said
