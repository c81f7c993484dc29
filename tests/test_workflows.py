"""The workflows that install few packages run their tests with these, on Windows, too."""

import re
import shlex
import subprocess
import sys
import tomllib
from importlib.metadata import distributions, packages_distributions

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from pendulum_fmus.project import ROOT

REQUIRED = {canonicalize_name(package.name): package.requires for package in distributions()}
"""What each package requires, by name."""

CODE = """
import sys
sys.modules |= dict.fromkeys(sys.argv.pop(1).split())
import pytest
sys.exit(pytest.main([*sys.argv[1:], "--setup-plan", "--disable-plugin-autoload"]))
"""


def installed(text: str) -> set[str]:
    """Return the names of a package and of all that it requires."""
    package = Requirement(text)
    if package.marker and not package.marker.evaluate({"extra": ""}):
        return set()
    name = canonicalize_name(package.name)
    return {name}.union(*map(installed, REQUIRED.get(name) or []))


@pytest.mark.parametrize("workflow", ["fmus", "wheels"])
def test_a_workflow_installs_what_its_tests_need(workflow: str) -> None:
    text = (ROOT / ".github" / "workflows" / f"{workflow}.yml").read_text(encoding="utf-8")
    (group,) = re.findall(r"uv sync --frozen --group (.*)", text)
    (tests,) = re.findall(r"python -m pytest (.*)", text)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packages = project["dependency-groups"][group]
    names = installed("pendulum-fmus").union(*map(installed, packages))
    missing = {"fcntl", "resource"} | {
        module
        for module, packages in packages_distributions().items()
        if names.isdisjoint(map(canonicalize_name, packages))
    }
    command = shlex.join([sys.executable, "-c", CODE, " ".join(missing)])
    run = ["bash", "-c", f"{command} {tests}"]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
