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

PAGE = ROOT / "docs" / "speed.md"

PACKAGES = {"libcosim": "libcosimpy", "fmuloader": "fmuloader"}
"""The packages of other masters, which not every environment has."""

ENGINES = (NODE, CHROMIUM)
"""Engines that are measured where they are installed, in the order of their columns."""

PLACE = re.compile(r"<!-- (\w+) -->\n(.*?)<!-- / -->", re.DOTALL)
"""A part of the page that is generated."""


@pytest.fixture(scope="module")
def hosts(fmus: Path):
    """Import the module of the benchmarks that runs the C host."""
    import hosts

    return hosts


def test_the_c_host_steps_as_documented(hosts, tmp_path: Path) -> None:
    # One host, FMUs with the same law and variables: the outputs must be equal.
    models = [hosts.REFERENCE, *hosts.VERSIONS[:1]]
    host = hosts.Host(tmp_path)
    for cases in (models, [hosts.standing(case) for case in models]):
        lines = host.measure("cycle", 1000, 3, [*cases, hosts.in_fmi3(cases[1])])
        assert [line["fmu"] for line in lines] == ["bare PID in C", "Pid", "Pid, FMI 3.0"]
        assert len({line["last_output"] for line in lines}) == 1
        assert lines[0]["last_output"] != 0
        assert all(len(line["ns"]) == 3 and min(line["ns"]) > 0 for line in lines)
    arrays = replace(hosts.ALL_OUTPUTS, outputs=hosts.ALL_OUTPUTS.outputs[4:])
    lines = host.measure("cycle", 1000, 1, [arrays, hosts.in_fmi3(arrays)])
    assert lines[0]["last_output"] == lines[1]["last_output"] != 0


@pytest.mark.parametrize("file", ["examples/closed-loop/pid-rbf.toml", "bench/coupled.toml"])
def test_the_master_in_c_gives_the_same_bits(hosts, file: str, tmp_path: Path) -> None:
    cases = hosts.LOOP if "examples" in file else hosts.PAIR
    newer = [replace(hosts.in_fmi3(case), name=case.name) for case in cases]
    host = hosts.Host(tmp_path)
    ours = simulate(ROOT / file, tmp_path, "--stop", "0.5", "--output", "controller.u")
    for version in (cases, newer):
        (line,) = host.measure("loop", 500, 2, version)
        assert ours["controller.u"][-1] == line["last_outputs"]["controller"] != 0


def test_the_page_has_what_was_measured(
    hosts, fmus: Path, sources: Path, page_file: Path, tmp_path: Path
) -> None:
    page = shutil.copy(PAGE, tmp_path)
    command = [ROOT / "bench" / "run.py", "--quick", "--out", tmp_path, "--publish", page]
    subprocess.run([sys.executable, *command], check=True, capture_output=True)
    before, after = (path.read_text(encoding="utf-8") for path in (PAGE, Path(page)))
    assert PLACE.sub("", before) == PLACE.sub("", after)
    assert (tmp_path / "speed.md").read_text(encoding="utf-8") == after
    abilities = dict(PLACE.findall((tmp_path / "abilities.md").read_text(encoding="utf-8")))
    assert re.search(r"--trace.* \| [\d.]+ .s a step, \d+ bytes ", abilities["abilities"])
    assert re.search(r"\| busy \|( [\d.]+ .s \|){4}\n", abilities["jitter"])
    texts = dict(PLACE.findall(after))
    assert "with `--quick`" in texts["machine"]
    for model in ("Pid", "PidRbf", "IpidRbf", "Pendulum"):
        assert f"| `{model}`" in texts["cycle"]
    # FMI 3.0, and C sources; without `--quick`, of the other FMUs, too.
    span = r"[\d.]+( to [\d.]+)?"
    assert re.search(rf"\| `Pid` \|.* \| {span} \| {span} \|\n", texts["cycle"])
    assert f"has {round(page_file.stat().st_size / 1000)} KB" in texts["engines"]
    engines = "".join(r" \S+ .s \|" if tool.there() else r" \|" for tool in ENGINES)
    for model in ("Pid", "PidRbf", "Pendulum"):
        assert re.search(rf"`{model}` \| \| \|{engines}\n", texts["engines"])
    # Our own master on FMPy is not called FMPy; `make bench` installs the others.
    one, three = r" [\d.]+ \S*s \|.*", r" \| \| \| [\d.]+ \S*s \|.*"
    rows = dict.fromkeys(("`Instance`, in process", "`Instance`", "FMPy's own API: .*"), one)
    others = [name for name in ("libcosim", "fmuloader") if find_spec(PACKAGES[name])]
    rows |= dict.fromkeys(("our master on FMPy, .*", *others), three)
    for name, cells in rows.items():
        assert re.search(rf"^\| {name} \|{cells}$", texts["calls"], re.MULTILINE)
    for what in ("first result", "with a plot", "MB of memory"):
        assert what in texts["host"]
    assert re.search(r"\| `FmuEnv` \| [\d.]+.* \| [\d.]+ \S*s \|\n", texts["environments"])


def test_the_page_is_short_and_begins_with_a_set_a_step_and_a_get() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert text.count("\n") <= 135
    assert [name for name, _ in PLACE.findall(text)][:2] == ["calls", "care"]


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


def test_what_is_worse_than_published_is_named(hosts) -> None:
    page = importlib.import_module("page")
    before = page.earlier()[-1]
    assert page.worse(before, before) == []
    # Ratios differ between processors.
    for published in page.earlier():
        found = page.last_before(published)
        assert all(found[key] == published[key] for key in ("processor", "vectors"))
    assert page.last_before({"processor": "another", "vectors": "none"}) == before
    step = "a step of the coupled pair, natively, relative to a master in C"
    speed = "the same step in a script that calls FMPy, relative to the native one"
    for factor, worse in ((1.1, step), (0.9, speed)):
        ratios = {name: factor * before["ratios"][name] for name in (step, speed)}
        (line,) = page.worse({"ratios": ratios}, before)
        assert line.startswith(f"{worse}: ")


def test_numbers_of_the_page_are_measured() -> None:
    prose = PLACE.sub("", PAGE.read_text(encoding="utf-8"))
    assert not re.findall(r".*\d.*", re.sub(r"PUBLISH=1|FMI [23]\.0|AVX2|AVX-512", "", prose))
