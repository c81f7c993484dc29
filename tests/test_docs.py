"""The documentation is correct: its commands and programs run, its links and files exist."""

import csv
import re
import shutil
from ctypes.util import find_library
from pathlib import Path

import pytest

import pages
from pendulum_fmus.project import ROOT

PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
    if path.name != "CHANGELOG.md"  # also names removed files
}

BLOCK = re.compile(r"(?:`([\w.-]+/[\w./-]+)`:\n\n)?^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
"""A fenced block: its file, if the preceding text names one; language; text."""


def anchors(text: str) -> set[str]:
    """Return the anchors of the headings of a page."""
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES)
def test_links_and_files_exist(page: str) -> None:
    for link in re.findall(r"\]\((?!https?:)([^)]+)\)", PAGES[page]):
        path, _, anchor = link.partition("#")
        target = (ROOT / page).parent / path if path else ROOT / page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target.read_text(encoding="utf-8")), link
    written = {path for path, _, _ in BLOCK.findall(PAGES[page])}
    tops = {path.name for path in ROOT.iterdir()} - {"target"}
    for path in re.findall(r"`([\w.-]+/[\w./-]*)`", PAGES[page]):
        if path.split("/")[0] in tops and path not in written:
            assert (ROOT / path).exists(), path


@pytest.mark.parametrize("page", PAGES)
def test_commands_and_programs_run(page: str, fmus: Path, program: Path) -> None:
    """Run the commands of a page in order, except `make`, in a copy if it writes files."""
    blocks = BLOCK.findall(PAGES[page])
    folder = ROOT
    if any(path for path, _, _ in blocks):
        folder = pages.project()
        shutil.copytree(fmus, folder / "target" / "fmu", dirs_exist_ok=True)
    for path, language, block in blocks:
        if path.endswith("lib.rs"):
            pages.export_models(folder, block)
        elif path:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(block, encoding="utf-8")
        elif language == "python":
            if "ecospy" in block and not find_library("tbb"):
                pytest.skip("`make system` installs libtbb")
            pages.run(f"target/venv/bin/python - <<'END'\n{block}END\n", folder)
        elif language == "sh":
            commands = re.sub(r"^make .*$", "", block, flags=re.MULTILINE)
            pages.run(commands.replace("cargo fmu ", f"{program} "), folder)


def test_what_you_should_see(program: Path, tmp_path: Path) -> None:
    """The table of importing.md: final error, settling time and maximum angle of the four loops."""
    section = PAGES["docs/importing.md"].split("## What you should see")[1].split("\n## ")[0]
    lines = [line.split("|")[2:-1] for line in section.splitlines() if line.startswith("| `")]
    for name, cells in zip(["pid", "pid-rbf", "ipid-rbf", "supervised"], lines, strict=True):
        file = tmp_path / "loop.csv"
        outputs = "--output controller.e --output plant.theta"
        pages.run(f"{program} simulate examples/ssp/{name}.toml {outputs} --csv {file}")
        with file.open() as opened:
            rows = [[float(cell) for cell in row] for row in list(csv.reader(opened))[1:]]
        error, settled, largest = (re.findall(r"-?\d[\d.e-]*", cell)[-1] for cell in cells)
        if "below" in cells[0]:
            assert abs(rows[-1][1]) < float(error)
        else:
            assert rows[-1][1] == pytest.approx(float(error), rel=5e-3)
        last = max(time for time, error, _ in rows if abs(error) > 0.003)
        assert last == pytest.approx(float(settled), abs=0.006)
        assert max(angle for _, _, angle in rows) == pytest.approx(float(largest), abs=6e-4)
