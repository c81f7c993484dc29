"""Models that C sources cannot have: the export names what they need, and where."""

import shutil
from pathlib import Path

import pytest

from native import call, prepare
from pendulum_fmus.project import PROGRAM, ROOT

IMPOSSIBLE = ROOT / "tests" / "data" / "impossible"
"""A package with two models and a library, whose harmless part one of them uses."""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the package outside of the repository."""
    package = tmp_path_factory.mktemp("outside") / "impossible"
    shutil.copytree(IMPOSSIBLE, package)
    manifest = package / "Cargo.toml"
    manifest.write_text(manifest.read_text().replace("[REPOSITORY]", str(ROOT)))
    return prepare(package)


def test_the_export_names_what_c_sources_lack_and_who_needs_it(package: Path) -> None:
    done = call([PROGRAM, "export", "Impossible", "--sources=only"], package)
    assert done.returncode == 1
    lines = {line.strip() for line in done.stderr.splitlines()}
    for needed in [
        "std::fs::read, which the crate impossible calls in impossible::Impossible::initialize",
        "std::thread::spawn, which the crate impossible calls in impossible::Impossible::step",
        "std::time::Instant::now, which the crate vendor calls in vendor::time",
        "rand of another language, which the crate vendor calls in vendor::noise",
    ]:
        assert needed in lines, done.stderr
    assert "Impossible" in done.stderr.split("std::fs::read")[0], "the model is named"
    for instead in ("read_resource", "the arguments of `step`", "export binaries"):
        assert instead in done.stderr


def test_a_model_may_use_the_rest_of_such_a_library(package: Path) -> None:
    done = call([PROGRAM, "export", "Possible", "--sources=only"], package)
    assert done.returncode == 0, done.stderr
