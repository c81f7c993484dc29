"""Tests whose tool is missing are skipped, and pytest says once what to install."""

import re
import subprocess
import sys
from pathlib import Path

from pendulum_fmus.project import ROOT


def pages_tested(folder: Path, *options: str) -> tuple[int, str]:
    """Run the tests in Chromium where no program is in sight; return exit code and output."""
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-k", "not node"]
    done = subprocess.run(
        [*command, *options, "tests/test_web.py"],
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
    [(count, named)] = re.findall(r"^(\d+) skipped without (.*)$", said, re.MULTILINE)
    assert named == "Chromium, which `make system` installs"
    assert int(count) > 1
    assert f"{count} skipped, 1 deselected in " in said


def test_tests_that_need_tools_fail_without_them_if_they_are_asked_for(tmp_path: Path) -> None:
    code, said = pages_tested(tmp_path, "-m", "needs")
    assert code == 1, said
    assert "it needs Chromium, which `make system` installs" in said
