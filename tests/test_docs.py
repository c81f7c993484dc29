"""The documentation is correct: its commands and programs run, its links and files exist."""

import re
import runpy
from pathlib import Path

import pytest

import sweeps
from native import OUTSIDE, new_package, shell
from needs import LIBTBB, Tool
from pendulum_fmus.project import ROOT

PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
    if path.name != "CHANGELOG.md"  # also names removed files
}

each_page = pytest.mark.parametrize("page", PAGES)

BLOCK = re.compile(r"(?:`([\w.-]+/[\w./-]+)`:\n\n)?^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
"""A fenced block: its file, if the preceding text names one; language; text."""


TOOLS = {"ecospy": LIBTBB}
"""By a word of its programs: a tool that the README does not name."""


def with_tools() -> list:
    """Return each page, to run without tools; and again with a tool that its programs need."""
    found = [
        pytest.param(page, tool, marks=tool.mark, id=f"{page} with {tool.name}")
        for word, tool in TOOLS.items()
        for page, text in PAGES.items()
        if any(word in block for _, language, block in BLOCK.findall(text) if language == "python")
    ]
    return [*(pytest.param(page, None, id=page) for page in PAGES), *found]


def anchors(text: str) -> set[str]:
    """Return the anchors of the headings of a page."""
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


@each_page
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


@pytest.mark.parametrize(("page", "tool"), with_tools())
def test_commands_and_programs_run(
    page: str,
    tool: Tool | None,
    program: Path,
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Run the commands of a page in order, except those that install something.

    They run in the root of the repository; a section with a new package, and the numbered sections
    after it, in a folder outside. Sweeps have fewer runs, and FMUs are validated quickly.
    """
    replacements = {
        r"^(make|cargo install|git clone|rustup) .*$": "",
        r"cargo fmu validate (?!.*(--quick|--no-run))": "cargo fmu validate --quick ",
        r"cargo fmu ": f"{program} ",
        r"examples/sweep": str(sweeps.shortened(tmp_path)),
        # A new package is prepared as by `native.prepare`.
        r"\bcd ([\w-]+)$": rf"cd \1 && cp {ROOT}/Cargo.lock . && ln -s {OUTSIDE} target",
    }
    folder = ROOT
    for section in re.split(r"^## ", PAGES[page], flags=re.MULTILINE):
        if "cargo fmu new" in section:
            folder = tmp_path_factory.mktemp("outside")
        elif not section[:1].isdigit():
            folder = ROOT
        for path, language, block in BLOCK.findall(section):
            if path:
                (folder / path).write_text(block, encoding="utf-8")
            elif language == "python":
                if {needed for word, needed in TOOLS.items() if word in block} <= {tool}:
                    shell(f"target/venv/bin/python - <<'END'\n{block}END\n", folder)
            elif language == "sh":
                commands = block
                for text, other in replacements.items():
                    commands = re.sub(text, other, commands, flags=re.MULTILINE)
                folder = shell(commands, folder)


def test_models_compile_and_pass_their_tests(program: Path, tmp_path: Path) -> None:
    """All programs in Rust that are no file of their own become modules of one new package."""
    blocks = [block for page in PAGES.values() for block in BLOCK.findall(page)]
    models = [text for path, language, text in blocks if language == "rust" and not path]
    modules = [f"mod block_{index} {{\n{text}}}\n" for index, text in enumerate(models)]
    package = new_package("guide", tmp_path)
    (package / "src" / "lib.rs").write_text("#![allow(dead_code)]\n" + "".join(modules))
    with (package / "Cargo.toml").open("a") as manifest:
        manifest.write('serde = { version = "1", features = ["derive"] }\n')
        manifest.write('[features]\ndefault = ["fmi"]\nfmi = []\n')
    shell("cargo test", package)


def test_the_python_reference_is_made_from_the_docstrings() -> None:
    """`docs/api.py` writes it."""
    assert runpy.run_path(str(ROOT / "docs" / "api.py"))["page"]() == PAGES["docs/python-api.md"]


def test_all_units_are_listed() -> None:
    """The tables of variables.md have the symbols and prefixes of the parser."""
    section = PAGES["docs/variables.md"].split("## Units")[1]
    parser = (ROOT / "modelDescription" / "src" / "unit.rs").read_text(encoding="utf-8")
    symbols = re.findall(r'^ +\("([^"\\]+)", ', parser.split("impl Unit")[0], re.MULTILINE)
    assert len(symbols) > 40
    assert set(re.findall(r"`([^`]+)`", section)) >= set(symbols)


def test_the_importers_are_those_that_were_run() -> None:
    """Whoever changes a version in `tests/matrix` runs `make importers`."""
    importers = (ROOT / "tests" / "matrix" / "run.py").read_text(encoding="utf-8")
    pinned = re.findall(r'"[\w-]+==([\w.]+)', importers)
    assert pinned
    assert all(f"| {version} |" in PAGES["docs/importers.md"] for version in pinned)


def test_what_you_should_see(ssp_columns: dict) -> None:
    """The table of importing.md: final error, settling time and maximum angle of the four loops."""
    section = PAGES["docs/importing.md"].split("## What you should see")[1].split("\n## ")[0]
    lines = [line.split("|")[2:-1] for line in section.splitlines() if line.startswith("| `")]
    for name, cells in zip(["pid", "pid-rbf", "ipid-rbf", "supervised"], lines, strict=True):
        columns = ssp_columns[name]
        errors = columns["controller.e"]
        error, settled, largest = (float(re.findall(r"-?\d[\d.e-]*", cell)[-1]) for cell in cells)
        if "below" in cells[0]:
            assert abs(errors[-1]) < error
        else:
            assert errors[-1] == pytest.approx(error, rel=5e-3)
        last = columns["time"][abs(errors) > 0.003][-1]
        assert last == pytest.approx(settled, abs=0.006)
        assert columns["plant.theta"].max() == pytest.approx(largest, abs=6e-4)
