"""The packages for crates.io, which `make package` builds, are complete and meet its limits."""

import json
import subprocess

import pytest

from pendulum_fmus.project import ROOT

pytestmark = pytest.mark.publish


@pytest.fixture(scope="module")
def packages() -> list[dict]:
    """Return the metadata of the published packages."""
    command = ["cargo", "metadata", "--no-deps", "--format-version=1"]
    output = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout
    return [package for package in json.loads(output)["packages"] if package["publish"] != []]


def test_every_package_carries_its_licences_and_readme(packages: list[dict]) -> None:
    for package in packages:
        unpacked = ROOT / "target" / "package" / "{name}-{version}".format(**package)
        for licence in ROOT.glob("LICENSE-*"):
            assert (unpacked / licence.name).read_text() == licence.read_text(), unpacked
        assert not package["readme"] or (unpacked / package["readme"]).exists(), unpacked


def test_the_registry_accepts_the_metadata(packages: list[dict]) -> None:
    for package in packages:
        assert package["description"], package["name"]
        assert package["license"] == "MIT OR Apache-2.0", package["name"]
        assert 0 < len(package["keywords"]) <= 5, package["name"]
        assert all(len(keyword) <= 20 for keyword in package["keywords"]), package["name"]


def test_dependencies_accept_every_compatible_version(packages: list[dict]) -> None:
    """Cargo leaves out what only tests need, unless it has a version."""
    versions = {package["name"]: package["version"] for package in packages}
    for package in packages:
        for dependency in package["dependencies"]:
            name, requirement = dependency["name"], dependency["req"]
            if dependency["kind"] != "dev":
                assert requirement.startswith("^"), (package["name"], name)
                # One of this repository has the version that it was tested with, or a newer one.
                assert requirement[1:] == versions.get(name, requirement[1:]), package["name"]
