"""The documentation is correct: its commands and programs run, its links and files exist."""

import re
import runpy
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

import sweeps
from native import OUTSIDE, new_package, run, shell
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
    excluded = "".join(f" --exclude {name}" for name in ("fmi-judge", "fuzz", "bench"))
    build = f"cargo build --quiet --locked --workspace{excluded}"
    replacements = {
        r"^(make|cargo install|rustup) .*$": "",
        # With the features that it has in `make check`.
        r"^cargo run --quiet --package [\w-]+ (--example (\w+))$": (
            rf"{build} \1 && target/debug/examples/\2"
        ),
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
    programs = [text for path, language, text in blocks if language == "rust" and not path]
    models = [text for text in programs if "fn main()" not in text]
    modules = [f"mod block_{index} {{\n{text}}}\n" for index, text in enumerate(models)]
    package = new_package("guide", tmp_path)
    (package / "src" / "lib.rs").write_text("#![allow(dead_code)]\n" + "".join(modules))
    with (package / "Cargo.toml").open("a") as manifest:
        manifest.write('[features]\ndefault = ["fmi"]\nfmi = []\n')
        for crate in ("control-blocks", "fmi-ls-bus"):
            path = ROOT / "crates" / crate
            manifest.write(f'[dependencies.{crate}]\npath = "{path}"\nfeatures = ["fmi"]\n')
    shell("cargo test", package)


def test_the_map_names_files_and_items_that_exist() -> None:
    """ARCHITECTURE.md gives files without their crate, and items without their file."""
    folders = ("crates", "docs", "modelDescription", "fmu-controller", "python", "tests")
    files = [
        path
        for folder in folders
        for path in (ROOT / folder).rglob("*")
        if path.suffix in {".rs", ".py", ".wit"}
    ]
    page = PAGES["ARCHITECTURE.md"]
    places = [f"/{path.relative_to(ROOT)}" for path in files]
    for name in re.findall(r"`([\w./-]+\.(?:rs|py|wit))`", page):
        assert any(place.endswith(f"/{name}") for place in places), name
    code = "\n".join(path.read_text(encoding="utf-8") for path in files)
    words = {*re.findall(r"\w+", code)}
    for item in re.findall(r"`([A-Z]\w+(?:::\w+)?)`", page):
        assert {*item.split("::")} <= words, item


def test_programs_in_rust_are_examples() -> None:
    """What `test_commands_and_programs_run` runs is what the page shows."""
    blocks = BLOCK.findall(PAGES["docs/rust.md"])
    example = ROOT / "crates" / "fmu-master" / "examples" / "gains.rs"
    assert [text for _, kind, text in blocks if kind == "rust"] == [example.read_text()]


def test_reference_pages_are_made_from_the_program_the_fmus_and_the_docstrings(
    program: Path,
) -> None:
    """`docs/reference.py` and `docs/api.py` write them."""
    reference = runpy.run_path(str(ROOT / "docs" / "reference.py"))
    assert reference["command_line"]() == PAGES["docs/command-line.md"]
    assert reference["parameters"]() == PAGES["docs/parameters.md"]
    assert runpy.run_path(str(ROOT / "docs" / "api.py"))["page"]() == PAGES["docs/python-api.md"]


def part(page: str, heading: str) -> str:
    """Return the section of a page."""
    return PAGES[page].split(f"\n## {heading}\n")[1].split("\n## ")[0]


def names(cells: str) -> set[str]:
    """Return the names in the first column of a table."""
    rows = re.findall(r"^\| (`.*?`) \|", cells, re.MULTILINE)
    return {name for row in rows for name in re.findall(r"`(\w+)`", row)}


COMPONENT = '[[component]]\nname = "a"\nfmu = "a"\n'

CONNECTION = f'{COMPONENT}[[connections]]\nfrom = "a.b"\nto = "a.c"\n'


@pytest.fixture
def expected(program: Path, tmp_path: Path) -> Callable[[str, str], set[str]]:
    """Return a function: which keys the program expects instead of an unknown one in a file."""

    def read(command: str, text: str) -> set[str]:
        file = tmp_path / "file.toml"
        file.write_text(text, encoding="utf-8")
        message = run(command, file).stderr.splitlines()[-1]
        assert "unknown" in message, message
        return {*re.findall(r"\w+", message.split("expected")[1])} - {"one", "of", "or"}

    return read


def test_system_files_are_described_in_full(expected: Callable[[str, str], set[str]]) -> None:
    tables = re.split(r"\n(?=\| Key)", part("docs/systems.md", "The system file"))
    assert names(tables[1]) == expected("simulate", "unknown = 1")
    assert names(tables[2]) == expected("simulate", "[[component]]\nunknown = 1")
    fault = f"{CONNECTION}faults = [{{ unknown = 1 }}]"
    assert names(part("docs/systems.md", "Faults")) == expected("simulate", fault)


def test_sweep_files_are_described_in_full(expected: Callable[[str, str], set[str]]) -> None:
    example = part("docs/sweeps.md", "The sweep file")
    keys = {
        *expected("sweep", "unknown = 1"),
        *expected("sweep", 'system = "a"\n[[parameter]]\nunknown = 1'),
        *expected("sweep", "[signals]\nunknown = 1"),
        *expected("sweep", "[metrics]\nunknown = 1"),
    }
    assert len(keys) > 20
    assert keys <= {*re.findall(r"\w+", example)}
    assert {*re.findall(r"(\w+) = ", example)} <= keys


def test_metrics_are_described_in_full(program: Path, tmp_path: Path) -> None:
    one = 'stop = 0.01\n[[parameter]]\nvariable = "plant.M"\nvalues = [1.0]'
    table = sweeps.expected(sweeps.written(tmp_path, one)).decode()
    _index, _value, *metrics = table.splitlines()[0].split(",")
    assert {*metrics} == names(part("docs/sweeps.md", "Metrics"))


def test_all_units_are_listed() -> None:
    """The tables of variables.md have the symbols and prefixes of the parser."""
    section = part("docs/variables.md", "Units")
    parser = (ROOT / "modelDescription" / "src" / "unit.rs").read_text(encoding="utf-8")
    symbols = re.findall(r'^ +\("([^"\\]+)", ', parser.split("impl Unit")[0], re.MULTILINE)
    assert len(symbols) > 40
    assert set(re.findall(r"`([^`]+)`", section)) >= set(symbols)


def column(text: str, heading: str, index: int = 1) -> list[list[str]]:
    """Return the names in each cell of a column, of all tables with this first heading."""
    table = rf"^\| {re.escape(heading)} .*\n[-| ]+\n((?:\|.*\n)+)"
    rows = "".join(re.findall(table, text, re.MULTILINE)).splitlines()
    return [re.findall(r"`(?:#\[)?(\w+)", row.split("|")[index]) for row in rows]


def flat(cells: Iterable[Iterable[str]]) -> set[str]:
    """Return all names in some cells."""
    return {name for cell in cells for name in cell}


def test_all_attributes_are_listed() -> None:
    """The tables of variables.md and of the macros' own pages have what the macros read."""
    folder = ROOT / "crates" / "fmu-derive" / "src"
    code = (folder / "attributes.rs").read_text(encoding="utf-8")
    own = {
        name: (folder / f"{name}.md").read_text(encoding="utf-8")
        for name in ("model", "choice", "variables")
    }
    page = PAGES["docs/variables.md"]

    def defined(name: str) -> str:
        return code.split(f"const {name}:")[1].split(" =", 1)[1].split(";\n")[0]

    roles = {
        role: name for name, role in re.findall(r'"(\w+)", (?:Role::)?(\w+)', defined("ROLES"))
    }
    groups = {name: re.findall(r"\w+", defined(name)) for name in ("ANY_ROW", "EQUATIONS")}
    groups["DESCRIBED"] = groups["ANY_ROW"][1:]
    groups["NAMED"] = groups["DESCRIBED"][1:]
    options = {
        name: {roles[role] for role in groups.get(group, re.findall(r"\w+", group))}
        for name, group in re.findall(r'\("(\w+)", \w+\), &?\[?([\w, ]+)', defined("FIELD_OPTIONS"))
    }
    assert len(roles) > 10
    assert len(options) > 15
    for text in (page, own["variables"]):
        attributes = {cell[0] for cell in column(text, "Attribute") if cell}
        assert attributes == {
            *roles.values(),
            re.findall(r'"(\w+)"', code.split("const FRESH")[1])[0],
        }
        assert flat(column(text, "Option")) <= options.keys()
        assert all(re.search(rf"[`(]{name}\b", text) for name in options)

    # Of each attribute, the options that not all have.
    common = flat(
        column(part("docs/variables.md", "Fields").split("| Option | Meaning |\n")[0], "Option")
    )
    further = column(page, "Attribute", 3)
    for attribute, listed in zip(column(page, "Attribute"), further, strict=True):
        has = {name for name, owners in options.items() if owners & {*attribute[:1]}}
        assert {*listed} == has - common - {"of", "size"}, attribute

    for kind, text, heading in [
        ("MODEL", page, "`#[model(...)]`"),
        ("MODEL", own["model"], "`#[model(...)]`"),
        ("VARIABLES", own["variables"], "`#[variables(...)]`"),
        ("CHOICE", own["choice"], "`#[choice(...)]`"),
    ]:
        known = {*re.findall(r'\("(\w+)", ', defined(kind).split(",", 1)[1])}
        assert known
        assert flat(column(text, heading)) == known


def test_all_types_and_log_categories_are_listed() -> None:
    """The pages have the types of variables and the log categories of the vocabulary."""
    vocabulary = (ROOT / "modelDescription" / "src" / "vocabulary.rs").read_text(encoding="utf-8")
    macro = vocabulary.split("macro_rules! types")[1].split("\n}\n")[0]
    types = re.findall(r"(\w+): (\w+)(?:<u8>)?[,;\n]", macro)
    assert len(types) > 12
    assert flat(types) <= {*re.findall(r"\w+", part("docs/variables.md", "Types"))}
    categories = re.findall(r'c"(log\w+)"', vocabulary)
    assert len(categories) > 6
    assert all(f"`{name}`" in PAGES["docs/quality.md"] for name in categories)


def test_the_importers_are_those_that_were_run() -> None:
    """Whoever changes a version in `tests/matrix` runs `make importers`."""
    importers = (ROOT / "tests" / "matrix" / "run.py").read_text(encoding="utf-8")
    pinned = re.findall(r'"[\w-]+==([\w.]+)', importers)
    assert pinned
    assert all(f"| {version} |" in PAGES["docs/importers.md"] for version in pinned)


def test_what_you_should_see(ssp_columns: dict) -> None:
    """The table of importing.md: final error, settling time and maximum angle of the four loops."""
    section = part("docs/importing.md", "What you should see")
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
