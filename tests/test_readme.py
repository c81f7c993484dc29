"""What the README says is what happens: its commands, its Python, its page on a new controller."""

import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

import pages
from pages import ROOT, blocks
from pendulum_fmus.master import Component, System, simulate

README = (ROOT / "README.md").read_text()

RUN_BY_CI = re.compile(r"make (demo|test)\b")


def commands() -> list[str]:
    """Return the shell commands of the README but for those that CI runs as they stand."""
    lines = [line for block in blocks("sh", README) for line in block.splitlines()]
    return [line for line in lines if not RUN_BY_CI.match(line)]


def test_ci_runs_the_two_commands_of_the_first_screen() -> None:
    first = blocks("sh", README)[0]
    ci = (ROOT / ".ci" / "run").read_text()
    for command in ("make demo", "make test"):
        assert command in first
        assert command in ci.splitlines()


@pytest.mark.parametrize("command", commands())
def test_every_command_works(command: str, fmus: Path) -> None:
    pages.run(command)


@pytest.mark.parametrize("program", blocks("python", README))
def test_every_program_works(program: str, fmus: Path) -> None:
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)


def test_every_file_and_folder_it_names_exists() -> None:
    links = [link.partition("#")[0] for link in pages.links(README)]
    tree = re.findall(r"^(\S+/) {2,}", README, re.MULTILINE)
    assert links
    assert len(tree) >= 8
    for path in links + tree:
        assert (ROOT / path).exists(), path


@pytest.fixture(scope="module")
def own_controller() -> Path:
    """Follow the page on a new controller in a copy of the sources; returns its FMU."""
    page = README.split("## Your own controller")[1].split("\n## ")[0]
    file, lines = blocks("rust", page)
    copy = pages.project()
    path = re.search(r"`(fmu-controller/src/\w+\.rs)`", page)
    assert path
    (copy / path[1]).write_text(file)
    pages.export_models(copy, lines)

    command = re.search(r"`(cargo fmu export \w+)`", page)
    assert command
    pages.run(command[1], copy)
    return copy / "target" / "fmu" / "Pd.fmu"


def test_a_new_controller_is_one_file_away(own_controller: Path, fmus: Path) -> None:
    with System(
        [
            Component("source", fmus / "Source.fmu"),
            Component("controller", own_controller, sampled=True),
            Component("plant", fmus / "Pendulum.fmu"),
        ],
        [
            ("source.r", "controller.r"),
            ("plant.theta", "controller.y"),
            ("controller.u", "plant.u"),
        ],
    ) as system:
        theta = simulate(system, start=0.0, step=0.001, steps=2000)["plant.theta"]
    # With kp e + kd de/dt dominant, e decays as exp(-kp t/kd): 0.0025 after 2 s.
    assert theta[-1] == pytest.approx(1.0, abs=0.05)
    assert np.max(theta) < 1.1


def test_a_new_controller_has_a_page_without_a_word_about_it(own_controller: Path) -> None:
    with zipfile.ZipFile(own_controller) as archive:
        page = etree.fromstring(archive.read("documentation/index.html"))
        assert "model.png" not in archive.namelist()
    assert page.findtext(".//h1") == "Pd"
    table = page.find(".//table[@id='variables']/tbody")
    assert table is not None
    assert [row[0].text for row in table] == ["r", "y", "u", "kp", "kd", "ts"]
