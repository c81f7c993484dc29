"""The benchmarks: the C host steps as documented, and the page gets what was measured."""

import importlib
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest

from native import ROOT, simulate
from needs import CHROMIUM, NODE, Tool
from test_package import MODELS

PAGE = ROOT / "docs" / "speed.md"

ENGINES = (NODE, CHROMIUM)
"""Engines that are measured where they are installed, in the order of their columns."""

PLACE = re.compile(r"<!-- (\w+) -->\n(.*?)<!-- / -->", re.DOTALL)
"""A part of the page that is generated."""


@pytest.fixture(scope="module")
def measure(fmus: Path):
    """Import the module of the benchmarks that runs the C host."""
    import measure

    return measure


def test_the_c_host_steps_as_documented(measure, tmp_path: Path) -> None:
    # One host, FMUs with the same law and variables: the outputs must be equal.
    models = [measure.REFERENCE, *measure.VERSIONS[:1]]
    host = measure.Host(tmp_path)
    for cases in (models, [measure.standing(case) for case in models]):
        lines = host.measure("cycle", 1000, 3, [*cases, measure.in_fmi3(cases[1])])
        assert [line["fmu"] for line in lines] == ["bare PID in C", "Pid", "Pid, FMI 3.0"]
        assert len({line["last_output"] for line in lines}) == 1
        assert lines[0]["last_output"] != 0
        assert all(len(line["ns"]) == 3 and min(line["ns"]) > 0 for line in lines)
    arrays = replace(measure.ALL_OUTPUTS, outputs=measure.ALL_OUTPUTS.outputs[4:])
    lines = host.measure("cycle", 1000, 1, [arrays, measure.in_fmi3(arrays)])
    assert lines[0]["last_output"] == lines[1]["last_output"] != 0


@pytest.mark.parametrize("file", ["examples/closed-loop/pid-rbf.toml", "bench/coupled.toml"])
def test_the_master_in_c_gives_the_same_bits(measure, file: str, tmp_path: Path) -> None:
    cases = measure.LOOP if "examples" in file else measure.PAIR
    newer = [replace(measure.in_fmi3(case), name=case.name) for case in cases]
    host = measure.Host(tmp_path)
    ours = simulate(ROOT / file, tmp_path, "--stop", "0.5", "--output", "controller.u")
    for version in (cases, newer):
        (line,) = host.measure("loop", 500, 2, version)
        assert ours["controller.u"][-1] == line["last_outputs"]["controller"] != 0


def test_the_page_has_what_was_measured(
    measure, fmus: Path, sources: Path, page_file: Path, tmp_path: Path
) -> None:
    page = shutil.copy(PAGE, tmp_path)
    command = [ROOT / "bench" / "run.py", "--quick", "--out", tmp_path, "--publish", page]
    subprocess.run([sys.executable, *command], check=True, capture_output=True)
    before, after = (path.read_text(encoding="utf-8") for path in (PAGE, Path(page)))
    assert PLACE.sub("", before) == PLACE.sub("", after)
    assert (tmp_path / "speed.md").read_text(encoding="utf-8") == after
    texts = dict(PLACE.findall(after))
    assert "with `--quick`" in texts["machine"]
    for model in MODELS:
        assert f"| `{model}`" in texts["cycle"]
        assert f"| component of `{model}` |" in texts["page"]
    assert f"| {round(page_file.stat().st_size / 1000)} KB |" in texts["page"]
    engines = "".join(r" \S+ .s \|" if tool.there() else r" \|" for tool in ENGINES)
    for model in ("Pid", "PidRbf", "IpidRbf", "Pendulum"):
        assert re.search(rf"`{model}` \| \| \|{engines}\n", texts["engines"])
    assert texts["versions"].count("at most") == 10
    # Without `--quick`, the other FMUs, too, and by all compilers.
    for name in ("`Pid`", "`Pid`, FMI 3.0"):
        assert f"| {name} compiled by `cc` | " in texts["sources"]
    assert re.search(r"\| `Pid_fmi3` \| \d+ KB \| \d+ KB \| [\d.]+ s by `cc` \|", texts["sources"])
    # `make bench` installs the others.
    others = [name for name in ("libcosim", "fmuloader") if find_spec(measure.OTHERS[name])]
    assert all(f"\n| {name} | " in texts["masters"] for name in ("FMPy", *others))
    assert len(re.findall(r"loops in .*(met|missed|unclear) \|", texts["module"])) == 2
    assert all((tmp_path / name).exists() for name in re.findall(r"\]\((\S+svg)\)", after)[1:])


@pytest.mark.parametrize(
    "engine", [pytest.param(tool, marks=tool.mark, id=tool.name) for tool in ENGINES]
)
def test_an_engine_is_measured(
    engine: Tool, components: Path, page_file: Path, tmp_path: Path
) -> None:
    engines = importlib.import_module("engines")
    found = engines.measure(tmp_path, quick=True)
    # A browser's clock is too coarse for so few cycles, which may take no time.
    assert all(len(found["costs"][f"{engine.name}/{name}"]) == 2 for name in engines.SIGNALS)
    assert re.fullmatch(r"[\d.]+", found["versions"][engine.name])
    assert engine is NODE or found["frames"]["rate"] > 0


def test_what_is_worse_than_published_is_named(measure) -> None:
    page = importlib.import_module("page")
    before = page.earlier()[-1]
    assert page.worse(before, before) == []
    # Ratios differ between processors.
    for published in page.earlier():
        found = page.last_before(published)
        assert all(found[key] == published[key] for key in ("processor", "vectors"))
    assert page.last_before({"processor": "another", "vectors": "none"}) == before
    step = "a step of the coupled pair, natively, relative to a master in C"
    speed = "the same step in FMPy, relative to the native one"
    for factor, worse in ((1.1, step), (0.9, speed)):
        ratios = {name: factor * before["ratios"][name] for name in (step, speed)}
        (line,) = page.worse({"ratios": ratios}, before)
        assert line.startswith(f"{worse}: ")


def test_numbers_of_the_page_are_measured() -> None:
    prose = PLACE.sub("", PAGE.read_text(encoding="utf-8"))
    assert not re.findall(r".*\d.*", re.sub(r"PUBLISH=1|FMI [23]\.0|AVX2|AVX-512", "", prose))
