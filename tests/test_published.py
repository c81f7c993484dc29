"""The packages for crates.io, which `.ci/package` builds, are complete and meet its limits."""

import json
import subprocess

import pytest

from pendulum_fmus.project import ROOT

pytestmark = pytest.mark.publish


def test_packages_are_complete_and_the_registry_accepts_them() -> None:
    command = ["cargo", "metadata", "--no-deps", "--format-version=1"]
    output = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout
    packages = [package for package in json.loads(output)["packages"] if package["publish"] != []]
    versions = {package["name"]: package["version"] for package in packages}
    for package in packages:
        unpacked = ROOT / "target" / "package" / "{name}-{version}".format(**package)
        for licence in ROOT.glob("LICENSE-*"):
            assert (unpacked / licence.name).read_text() == licence.read_text(), unpacked
        assert not package["readme"] or (unpacked / package["readme"]).exists(), unpacked
        assert package["description"], package["name"]
        assert package["license"] == "MIT OR Apache-2.0", package["name"]
        assert 0 < len(package["keywords"]) <= 5, package["name"]
        assert all(len(keyword) <= 20 for keyword in package["keywords"]), package["name"]
        for dependency in package["dependencies"]:
            name, requirement = dependency["name"], dependency["req"]
            # Cargo leaves out what only tests need, unless it has a version.
            if dependency["kind"] != "dev":
                assert requirement.startswith("^"), (package["name"], name)
                # One of this repository has the version that it was tested with, or a newer one.
                assert requirement[1:] == versions.get(name, requirement[1:]), package["name"]
