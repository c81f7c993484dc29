"""What the guide says is what happens: its commands, its programs, its controller, its names."""

import csv
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import pages
from pages import ROOT, blocks

GUIDE = ROOT / "docs" / "guide"
PAGES = {path.name: path.read_text() for path in sorted(GUIDE.glob("*.md"))}
CONTROLLER = PAGES["own-controller.md"]

each_page = pytest.mark.parametrize("page", PAGES)

FILE = re.compile(r"^`([\w./-]+)`:\n\n```[^\n]*\n(.*?)^```$", re.M | re.S)
"""A file that a page tells to write: its path, alone on a line, and its text."""


def files(text: str) -> dict[str, str]:
    """Return the files that a page tells to write."""
    return dict(FILE.findall(text))


def anchors(text: str) -> set[str]:
    """Return what links to the headings of a page end in."""
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


def parts(language: str) -> list:
    """Return the blocks of a language on all pages but that of the controller, with their page."""
    return [
        pytest.param(block, id=f"{name}:{number}")
        for name, text in PAGES.items()
        if text is not CONTROLLER
        for number, block in enumerate(blocks(language, text))
    ]


def test_the_table_of_contents_has_every_page() -> None:
    assert set(pages.links(PAGES["README.md"])) >= PAGES.keys() - {"README.md"}


@each_page
def test_every_link_leads_somewhere(page: str) -> None:
    for link in pages.links(PAGES[page]):
        path, _, anchor = link.partition("#")
        target = (GUIDE / path).resolve() if path else GUIDE / page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target.read_text()), link


@each_page
def test_every_file_and_name_exists(page: str) -> None:
    own = files(CONTROLLER)
    tops = {path.name for path in ROOT.iterdir()} - {"target"}
    for path, name in re.findall(r"`([\w.-]+/[\w./-]*)(?:::(\w+))?`", PAGES[page]):
        if path.split("/")[0] not in tops or path in own:
            continue
        assert (ROOT / path).exists(), path
        if name:
            assert re.search(rf"\b{name}\b", (ROOT / path).read_text()), f"{path}::{name}"


@pytest.mark.parametrize("command", parts("sh"))
def test_every_command_works(command: str, program: Path) -> None:
    for line in command.splitlines():
        pages.run_natively(line)


@pytest.mark.parametrize("code", parts("python"))
def test_every_program_works(code: str, fmus: Path) -> None:
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_what_you_should_see(program: Path, tmp_path: Path) -> None:
    """The table of import.md: last error, settling time and largest angle of the four loops."""
    section = PAGES["import.md"].split("## What you should see")[1].split("\n## ")[0]
    lines = [line.split("|")[1:-1] for line in section.splitlines() if line.startswith("| `")]
    for name, line in zip(["pid", "pid-rbf", "ipid-rbf", "supervised"], lines, strict=True):
        file = tmp_path / "loop.csv"
        outputs = "--output controller.e --output plant.theta"
        pages.run_natively(f"cargo fmu simulate examples/ssp/{name}.toml {outputs} --csv {file}")
        with file.open() as opened:
            rows = [[float(cell) for cell in row] for row in list(csv.reader(opened))[1:]]
        last = max(time for time, error, _ in rows if abs(error) > 0.003)
        error, settled, largest = (re.findall(r"-?\d[\d.e-]*", cell)[-1] for cell in line[1:])
        if "below" in line[1]:
            assert abs(rows[-1][1]) < float(error)
        else:
            assert rows[-1][1] == pytest.approx(float(error), rel=5e-3)
        assert last == pytest.approx(float(settled), abs=0.006)
        assert max(angle for _, _, angle in rows) == pytest.approx(float(largest), abs=6e-4)


def test_the_controller_of_the_guide(program: Path) -> None:
    """Follow own-controller.md in a copy of the sources, from its first block to its last."""
    copy = pages.project()
    for path, content in files(CONTROLLER).items():
        if path.endswith("lib.rs"):
            pages.export_models(copy, content)
        else:
            (copy / path).parent.mkdir(parents=True, exist_ok=True)
            (copy / path).write_text(content)
    for language, block in re.findall(
        r"^```(sh|python)\n(.*?)^```$", CONTROLLER, re.MULTILINE | re.DOTALL
    ):
        if language == "sh":
            for line in block.splitlines():
                pages.run_natively(line, copy)
        else:
            subprocess.run([sys.executable, "-c", block], cwd=copy, check=True)

    target = copy / "target"
    with zipfile.ZipFile(target / "fmu" / "FilteredPid.fmu") as archive:
        assert b"<h2>Use</h2>" in archive.read("documentation/index.html")
    assert (target / "filtered-pid.png").stat().st_size > 10_000
    assert len((target / "filtered-pid-gains.csv").read_text().splitlines()) == 1 + 36
