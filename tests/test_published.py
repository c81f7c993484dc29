"""What `make package` packed for crates.io is complete, and asks for no more than it needs."""

import json
import subprocess
import tomllib
from pathlib import Path

import pytest

from pendulum_fmus.project import ROOT

pytestmark = pytest.mark.publish


def packages() -> list[dict]:
    """Return the metadata of the packages that are published."""
    command = ["cargo", "metadata", "--no-deps", "--format-version=1"]
    output = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout
    return [p for p in json.loads(output)["packages"] if p["publish"] != []]


@pytest.fixture(params=packages(), ids=lambda package: package["name"])
def folder(request: pytest.FixtureRequest) -> Path:
    """Return the folder to which cargo unpacked a package to build it."""
    return ROOT / "target" / "package" / "{name}-{version}".format(**request.param)
