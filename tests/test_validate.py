"""`cargo fmu validate` and `cargo fmu info` on valid, broken and hostile FMUs of both versions."""

import json
import os
import re
import resource
import subprocess
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path

import fmpy
import pytest
from lxml import etree

from native import SOURCES, in_c, read, run, write
from pendulum_fmus.project import ROOT
from test_package import FMI3_FUNCTIONS

MEMORY = 1 << 30
"""Maximum address space of the program in bytes."""

SECONDS = 60
"""Processor time of one run [s], which does not depend on the load of the machine."""


@pytest.fixture(scope="session", autouse=True)
def _program(fmus: Path) -> None:
    """Build the program, which the export of the FMUs does."""


def cargo_fmu(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run the program with limited time and memory."""

    def bound() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        # The dump of a crash is no file of the FMU.
        dumps = resource.getrlimit(resource.RLIMIT_CORE)[1]
        resource.setrlimit(resource.RLIMIT_CORE, (dumps, dumps))

    return run(*arguments, preexec_fn=bound)


def findings(file: Path, *options: str) -> list[str]:
    """Return the findings of `validate` without the file name, and check the exit code."""
    result = cargo_fmu("validate", "--all", *options, file)
    assert result.stderr == ""
    *found, summary = (line.removeprefix(f"{file}: ") for line in result.stdout.splitlines())
    errors = sum(line.startswith("error: ") for line in found)
    assert result.returncode == (errors > 0)
    assert summary.startswith(f"{errors or 'no'} error"), summary
    return found


def check(found: list[str], *expected: str) -> None:
    """Check that one of the findings contains all expected words."""
    assert any(all(words in line for words in expected) for line in found), found


DATA = ROOT / "tests" / "data"
TERMINALS = (DATA / "terminalsAndIcons.xml").read_text()
BUILD = (DATA / "buildDescription.xml").read_text()
MODEL_FILE = "modelDescription.xml"
TERMINALS_FILE = "terminalsAndIcons/terminalsAndIcons.xml"
BUILD_FILE = "sources/buildDescription.xml"
LICENCES = "documentation/licenses/"

FULL = (ROOT / "fuzz" / "corpus" / "full.xml").read_text()
FILES = {
    2: {MODEL_FILE: FULL, "sources/full.c": ""},
    3: {
        MODEL_FILE: (ROOT / "fuzz" / "corpus" / "full3.xml").read_text(),
        TERMINALS_FILE: TERMINALS,
        "terminalsAndIcons/plug.png": "",
        BUILD_FILE: BUILD,
        "sources/full.c": "",
        LICENCES + "license.txt": "",
        "extra/org.example/data": "",
    },
}
"""The files of a valid FMU of each version, with every element of the schemas."""


def fmu(
    folder: Path, version: int, changes: dict[str, str | bytes | None], name: str = "x.fmu"
) -> Path:
    """Write an FMU with other contents of some files, or without them if `None`."""
    files = {**FILES[version], **changes}
    return write(folder / name, {name: text for name, text in files.items() if text is not None})


def replaced(version: int, *pairs: str) -> str:
    """Return the model description with other texts: old, new, and so on."""
    text = FILES[version][MODEL_FILE]
    for old, new in zip(pairs[::2], pairs[1::2], strict=True):
        assert old in text
        everywhere = version == 3 or old.endswith(("Description", "Variables>"))
        text = text.replace(old, new, -1 if everywhere else 1)
    return text


VALID = [
    (2, ()),
    (3, ()),
    (2, ('name="full.c"', 'name="./full.c"')),
    (3, ('causality="structuralParameter" variability="fixed"', 'causality="structuralParameter"')),
    (3, (' priority="1"', "", '  <ScheduledExecution modelIdentifier="Full"/>\n', "")),
    (2, ("</ModelVariables>", "".join(
        f'<ScalarVariable name="{name}" valueReference="9" variability="constant">'
        f'<Real start="{start}"/></ScalarVariable>'
        for name, start in [("a", "100"), ("b", "100.0")]
    ) + "</ModelVariables>")),
]  # fmt: skip


@pytest.mark.parametrize(("version", "changes"), VALID)
def test_a_valid_fmu_has_no_findings(version: int, changes: tuple, tmp_path: Path) -> None:
    assert findings(fmu(tmp_path, version, {MODEL_FILE: replaced(version, *changes)})) == []


@pytest.mark.parametrize(
    ("name", "options"),
    [("Pendulum", ()), ("Source", ()), ("IpidRbf_fmi3", ()),
     ("IpidRbf", ("--quick",)), ("Pendulum_fmi3", ("--quick",))],
)  # fmt: skip
def test_exported_fmus_have_no_findings(fmus: Path, name: str, options: tuple) -> None:
    assert findings(fmus / f"{name}.fmu", *options) == []


@pytest.mark.parametrize(
    "include", ['#include "parts/b.c"', "# include <b.c>", "#ifdef B\n#include B\n#endif"]
)
def test_a_file_that_may_be_included_need_not_be_listed(include: str, tmp_path: Path) -> None:
    changes = {"sources/full.c": '#include "a.h"', "sources/x/a.h": include}
    for version in (2, 3):
        name = f"{version}.fmu"
        assert findings(fmu(tmp_path, version, {**changes, "sources/parts/b.c": ""}, name)) == []


def test_a_build_description_of_fmi_2_is_checked(tmp_path: Path) -> None:
    listed = replaced(2, '    <SourceFiles>\n      <File name="full.c"/>\n    </SourceFiles>\n', "")
    assert findings(fmu(tmp_path, 2, {MODEL_FILE: listed, BUILD_FILE: BUILD})) == []
    text = BUILD.replace("full.c", "half.c").replace('="Full"', '="Half"', 1)
    found = findings(fmu(tmp_path, 2, {BUILD_FILE: text, "sources/other.cpp": ""}))
    check(found, 'modelIdentifier is "Half"', "FMI 2.0.5, section 2.3")
    check(found, f"{BUILD_FILE}:", 'source file "half.c" is missing')
    check(found, "warning: sources/other.cpp: it is neither listed")


def with_sources(file: Path, *definitions: str, code: str = "", has_binary: bool = True) -> Path:
    """Write the FMU Lawful with its sources, in front of which there may be other code."""
    given = "".join(f'<PreprocessorDefinition name="{name}"/>' for name in definitions)
    files = {name: text for name, text in read(in_c(file)).items()
             if has_binary or not name.startswith("binaries/")}  # fmt: skip
    for name in ("lawful.c", "stubs.h", "fmi2.h"):
        files[f"sources/{name}"] = (SOURCES / name).read_bytes()
    files["sources/lawful.c"] = code.encode() + files["sources/lawful.c"]
    files[BUILD_FILE] = (
        '<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="Lawful">'
        f'<SourceFileSet language="C99"><SourceFile name="lawful.c"/>{given}</SourceFileSet>'
        "</BuildConfiguration></fmiBuildDescription>"
    ).encode()
    return write(file, files)


def test_compiled_sources_are_tested_as_their_binary(tmp_path: Path) -> None:
    own = with_sources(tmp_path / "Lawful.fmu")
    expected = findings(own)
    assert findings(own, "--compile") == expected
    without = with_sources(tmp_path / "Lawful.fmu", has_binary=False)
    assert findings(without) == []
    found = findings(without, "--compile")
    assert [line.replace("compiled sources: ", "") for line in found] == expected != found


def test_sources_that_do_not_compile_are_found(tmp_path: Path) -> None:
    file = with_sources(tmp_path / "Lawful.fmu", code="#error lost\n")
    assert findings(file, "--no-run") == []
    for options in ((), ("--no-run",)):
        found = findings(file, "--compile", *options)
        check(found, "error: sources/lawful.c: it does not compile", "#error lost")
    file = with_sources(tmp_path / "Lawful.fmu", code="#define fmi2Instantiate lost\n")
    check(
        findings(file, "--compile", "--no-run"),
        "error: sources: they do not compile",
        "fmi2Instantiate",
    )


def test_results_of_compiled_sources_are_compared_with_the_binary(tmp_path: Path) -> None:
    file = with_sources(tmp_path / "Lawful.fmu", "KINK")
    assert not any("compiled from the sources" in line for line in findings(file))
    check(
        findings(file, "--compile"),
        "error: binaries/linux64/Lawful.so",
        "compiled from the sources",
    )


# --- the XML files --------------------------------------------------------------------------------

MUTATIONS = tomllib.loads((DATA / "mutations.toml").read_text(encoding="utf-8"))
"""By file: old text, new text, parts of the finding; the model description has versions first."""

ELF = b"\x7fELF\x02" + bytes(59)
FUNCTIONS = "".join(f"{name}\0" for name in FMI3_FUNCTIONS).encode()
"""The names of all functions of FMI 3.0, as in a binary."""

FILE_MUTATIONS = [
    # files, parts of the finding
    ({BUILD_FILE: None}, f"it has no {BUILD_FILE}"),
    ({BUILD_FILE: None, "binaries/x86_64-windows/Full.dll": b""}, "warning: sources: it has no"),
    ({BUILD_FILE: None, "sources/full.c": None}, "neither binaries nor sources"),
    ({"sources/other.c": ""}, "warning: sources/other.c: it is neither listed nor included"),
    ({"binaries/linux64/Full.so": ELF}, "x86_64-linux", "warning"),
    ({"binaries/x86-linux/full.so": ELF}, "binaries/x86-linux/Full.so"),
    ({"binaries/x86_64-windows/Full.dll": ELF}, "not a shared library"),
    ({"binaries/x86_64-windows/": b""}, "it is empty"),
    ({"binaries/x86-windows/Full.dll": b"MZ" + FUNCTIONS}, "warning: binaries", "was run"),
    ({"documentation/diagram.svg": ""}, "documentation/diagram.png"),
    ({LICENCES + "license.txt": None, LICENCES + "MIT": ""}, "license.html"),
    ({"extra/data": ""}, "extra/data", "com.example"),
    ({"extra/read.me": ""}, "extra/read.me", "com.example"),
    ({"binaries/x86_64-windows-msvc142mt/Full.lib": ""}, "documentation/staticLinking.txt"),
    ({MODEL_FILE: re.sub("<ModelExchange.*?(?=  <UnitD)", "", replaced(3), flags=re.S)},
     "it has no interface type", "FMI 3.0.2, section 2.4.1"),
    ({MODEL_FILE: re.sub("<(ModelExchange|CoSimulation).*?(?=  <Sch)", "", replaced(3), flags=re.S),
      "binaries/x86_64-linux/Full.so": ELF}, "not export fmi3InstantiateScheduledExecution"),
]  # fmt: skip


def cases() -> Iterator[tuple[str, int, dict[str, str | bytes | None], tuple[str, ...]]]:
    """Yield a name, the version, the changed files and parts of the finding for each mutation."""
    for versions, old, new, *expected in MUTATIONS["modelDescription"]:
        for version in versions:
            changes = {MODEL_FILE: replaced(version, old, new)}
            yield f"{version} {new or old}", version, changes, expected
    for file, text, mutations in [
        (TERMINALS_FILE, TERMINALS, MUTATIONS["terminalsAndIcons"]),
        (BUILD_FILE, BUILD, MUTATIONS["buildDescription"]),
    ]:
        for old, new, *expected in mutations:
            assert old in text
            yield f"{file} {new or old}", 3, {file: text.replace(old, new)}, (file, *expected)
    for changes, *expected in FILE_MUTATIONS:
        yield " ".join(changes), 3, changes, expected


CASES = list(cases())


@pytest.fixture(scope="module")
def mutants(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Write an FMU for each mutation."""
    folder = tmp_path_factory.mktemp("mutations")
    return [fmu(folder, case[1], case[2], f"{k}.fmu") for k, case in enumerate(CASES)]


@pytest.fixture(scope="module")
def found(mutants: list[Path]) -> list[list[str]]:
    """Return the findings on all mutations, which one run of the program makes."""
    lines = cargo_fmu("validate", "--all", *mutants).stdout.splitlines()
    return [[line for line in lines if line.startswith(f"{file}: ")] for file in mutants]


@pytest.mark.parametrize("k", range(len(CASES)), ids=[case[0][:60] for case in CASES])
def test_every_rule_finds_its_violation(k: int, found: list[list[str]]) -> None:
    check(found[k], *CASES[k][3])


OTHER_VIOLATIONS = {
    "bus-manifest bus-manifest-given bus-manifest-readable bus-mime-type bus-nested bus-once "
    "bus-steps bus-terminal bus-variables": "test_every_rule_of_networks_finds_its_violation",
    "archive-names archive-plain archive-safe files-intact":
        "test_every_rule_for_archives_finds_its_violation",
    "adjoint-derivatives array-lengths early-return-flag events-signalled intermediate-update-flag "
    "last-successful-time start-time-steps structural-parameters":
        "test_defects_of_what_fmi_3_adds_are_found",
    "event-mode": "test_event_mode_that_is_declared_is_tested",
    "file": "test_a_file_that_cannot_be_read_is_a_finding",
    "flat-names": "test_untrusted_text_is_quoted_on_one_line",
    "fmi-version": "test_another_version_is_the_only_finding",
    "input-events": "test_events_by_inputs_that_co_simulation_ignores_are_found",
    "memory-functions": "test_memory_of_the_host_is_not_used_unless_the_xml_says_so",
    "not-tested": "test_what_there_was_no_time_for_is_named",
    "default-results": "test_a_result_without_experiment_is_that_of_the_default_experiment",
    "experiment-results references-exist references-form references-readable references-variables":
        "test_the_validator_compares_reference_results_and_checks_the_files",
    "sources-compile": "test_sources_that_do_not_compile_are_found",
    "sources-results": "test_results_of_compiled_sources_are_compared_with_the_binary",
    "utf-8": "test_other_encodings_are_read",
}  # fmt: skip
"""Rules whose violations are neither mutations nor planted defects, and the tests of them."""


def test_every_rule_has_code_and_a_violation(mutants: list[Path]) -> None:
    """A new rule needs a row in rules.md, code, and a mutation or a defect in tests/c/defects.h."""
    crate = ROOT / "crates" / "fmu-check"
    rules = set(re.findall(r"^\| `(.+?)` \|", (crate / "rules.md").read_text(), re.MULTILINE))
    code = "".join(file.read_text() for file in crate.glob("src/**/*.rs"))
    assert {rule for rule in rules if f'"{rule}"' not in code} == set(), "rules without code"
    report = json.loads(cargo_fmu("validate", "--all", "--format", "json", *mutants).stdout)
    mutations = {rule["id"] for file in report["files"] for rule in file["rules"]}
    defects = "".join(file.read_text() for file in SOURCES.glob("*defects.h"))
    planted = set(re.findall(r', "([a-z0-9-]+)", "', defects))
    others = {rule for names in OTHER_VIOLATIONS for rule in names.split()}
    assert rules - mutations - planted == others, "rules without a violation, or with two"
    tests = "".join(file.read_text() for file in Path(__file__).parent.glob("test_*.py"))
    for test in OTHER_VIOLATIONS.values():
        assert f"def {test}(" in tests


SCHEMA_RULES = {
    "fmi-version", "root-element", "no-text", "attribute-required", "attribute-value",
    "attribute-known", "element-known", "element-order", "element-once", "element-required",
}  # fmt: skip

SCHEMAS = [
    ("fmi2/fmi2ModelDescription.xsd", 2, MODEL_FILE),
    ("fmi3/fmi3ModelDescription.xsd", 3, MODEL_FILE),
    ("fmi3/fmi3TerminalsAndIcons.xsd", 3, TERMINALS_FILE),
    ("fmi3/fmi3BuildDescription.xsd", 3, BUILD_FILE),
]


def neighbours(root: etree._Element) -> Iterator[None]:
    """Change one attribute or element of a document after another."""
    for element in list(root.iter(etree.Element)):
        if etree.QName(element).namespace:
            continue
        for name, old in element.attrib.items():
            del element.attrib[name]
            yield
            for value in ("", "x", "-1", "1", "true"):
                element.set(name, value)
                yield
            element.set(name, old)
        parent, (tag, text) = element.getparent(), (element.tag, element.text)
        element.tag = "Other"
        yield
        element.tag, element.text = tag, "text"
        yield
        element.text = text
        element.set("other", "1")
        yield
        del element.attrib["other"]
        if parent is not None:
            at = parent.index(element)
            parent.remove(element)
            yield
            parent.append(element)
            yield
            parent.insert(at, element)
            parent.insert(at, deepcopy(element))
            yield
            del parent[at]


@pytest.mark.parametrize(("schema", "version", "file"), SCHEMAS, ids=[s[0] for s in SCHEMAS])
def test_the_schemas_are_those_of_the_standard(
    schema: str, version: int, file: str, tmp_path: Path
) -> None:
    """Compare the verdicts of lxml and of the validator on documents with one change."""
    reference = etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "schema" / schema))
    root = etree.fromstring(FILES[version][file].encode())
    assert reference.validate(root)
    valid = {}
    for index, _ in enumerate(neighbours(root)):
        path = fmu(tmp_path, version, {file: etree.tostring(root)}, f"{index}.fmu")
        valid[str(path)] = reference.validate(root)
    verdicts = list(valid.values())
    assert min(verdicts.count(True), verdicts.count(False)) > 20
    output = cargo_fmu("validate", "--no-run", "--format", "json", *valid).stdout
    for report in json.loads(output)["files"]:
        found = [rule for rule in report["rules"] if rule["id"] in SCHEMA_RULES]
        # The schema of FMI 2.0 allows more interface types than the text of the standard.
        is_accepted = "expected 2 at most" in str(found)
        is_valid = valid[report["file"]]
        assert is_valid == (not found or is_accepted), (found, read(Path(report["file"]))[file])


def test_findings_are_available_as_json_and_sarif(tmp_path: Path) -> None:
    text = "<ModelStructure>text" + 5 * "<A/>"
    text = replaced(2, 'guid="{0}"', 'guid=""', "<ModelStructure>", text)
    file = fmu(tmp_path, 2, {MODEL_FILE: text, "sources/full.c": None}, "a b.fmu")
    result = cargo_fmu("validate", "--format", "json", file)
    assert result.returncode == 1
    (report,) = json.loads(result.stdout)["files"]
    assert (report["file"], report["errors"], report["warnings"]) == (str(file), 8, 0)
    text = "guid is empty, expected a string"
    assert next(rule for rule in report["rules"] if rule["id"] == "name-and-guid") == {
        "id": "name-and-guid",
        "severity": "error",
        "text": "modelName and guid are not empty.",
        "source": "FMI 2.0.5, section 2.2.1",
        "count": 1,
        "findings": [{"file": MODEL_FILE, "line": 2, "variable": None, "text": text}],
    }
    result = cargo_fmu("validate", "--format", "sarif", file)
    assert result.returncode == 1
    log = json.loads(result.stdout)
    assert log["version"] == "2.1.0"
    (run,) = log["runs"]
    assert [artifact["location"]["uri"] for artifact in run["artifacts"]] == [
        str(file).replace(" ", "%20"), f"/{MODEL_FILE}"
    ]  # fmt: skip
    assert run["artifacts"][1]["parentIndex"] == 0
    found = {item["ruleId"]: item["locations"][0]["physicalLocation"] for item in run["results"]}
    assert found["no-text"] == {
        "artifactLocation": {"uri": f"/{MODEL_FILE}", "index": 1},
        "region": {"startLine": 76},
    }
    rules = run["tool"]["driver"]["rules"]
    assert all(rules[item["ruleIndex"]]["id"] == item["ruleId"] for item in run["results"])
    (note,) = run["invocations"][0]["toolExecutionNotifications"]
    assert "2 more of this kind: element-known" in note["message"]["text"]


@pytest.mark.parametrize("version", ["1.0", "4.0"])
def test_another_version_is_the_only_finding(version: str, tmp_path: Path) -> None:
    text = f'<fmiModelDescription fmiVersion="{version}"/>'
    file = write(tmp_path / "x.fmu", {MODEL_FILE: text, "binaries/x86_64-linux/a.so": ""})
    text = f"it is of FMI version {version}, expected 2.0"
    (found,) = findings(file)
    assert text in found
    assert text in cargo_fmu("info", file).stderr
    system = tmp_path / "system.toml"
    system.write_text('stop = 1\nstep = 1\n[[component]]\nname = "a"\nfmu = "x.fmu"\n')
    result = cargo_fmu("simulate", system)
    assert result.returncode == 1
    assert text in result.stderr


def test_other_encodings_are_read(tmp_path: Path) -> None:
    named = replaced(2, 'modelName="Full"', 'modelName="Größe"')
    text = named.replace('encoding="UTF-8"', 'encoding="UTF-16"').encode("UTF-16")
    file = fmu(tmp_path, 2, {MODEL_FILE: text})
    (found,) = findings(file)
    assert "error: modelDescription.xml: the encoding is" in found
    assert "Größe" in cargo_fmu("info", file).stdout
    (found,) = findings(fmu(tmp_path, 2, {MODEL_FILE: named.encode("latin-1")}))
    assert "line 2 has bytes that are not UTF-8" in found


def test_untrusted_text_is_quoted_on_one_line(tmp_path: Path) -> None:
    text = replaced(2, 'name="y"', f'name="a&#10;\u202eb{"c" * 10_000}"')
    found = findings(fmu(tmp_path, 2, {MODEL_FILE: text}))
    assert all(line.startswith(("error: ", "warning: ")) for line in found)
    assert max(map(len, found)) < 300
    text = replaced(2, '"structured"', '"flat"', 'name="n"', 'name="n&#10;m"')
    check(findings(fmu(tmp_path, 2, {MODEL_FILE: text})), "line break or tab")


# --- the archive ----------------------------------------------------------------------------------


def twice(file: Path) -> None:
    with zipfile.ZipFile(file, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr(MODEL_FILE, FULL)


def linked(file: Path) -> None:
    link = zipfile.ZipInfo("resources/link")
    link.create_system, link.external_attr = 3, 0o120777 << 16
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr(link, "/etc/passwd")


def overlapping(file: Path) -> None:
    """Imitate a zip bomb whose files all share the same bytes of the archive."""
    with zipfile.ZipFile(file) as archive:
        first, second = (archive.getinfo(f"resources/{name}").header_offset for name in "ab")
    content = bytearray(file.read_bytes())
    at = content.rindex(second.to_bytes(4, "little") + b"resources/b")
    content[at : at + 4] = first.to_bytes(4, "little")
    file.write_bytes(content)


def bomb(file: Path) -> None:
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("resources/zeros", bytes(BOMB))
    assert file.stat().st_size < 1 << 20


def lying_bomb(file: Path) -> None:
    """Write a bomb that lies about its size."""
    bomb(file)
    content = file.read_bytes()
    file.write_bytes(content.replace(BOMB.to_bytes(4, "little"), (1000).to_bytes(4, "little")))


def replacing(old: bytes, new: bytes) -> Callable[[Path], int]:
    return lambda file: file.write_bytes(file.read_bytes().replace(old, new, 1))


BOMB = 200 << 20
"""Size of a file of zeros [B]."""

ARCHIVES = [
    # a further file, a change of the archive, the exit code of `info`, parts of the finding
    ("../evil", None, 1, "error: archive", "path traversal"),
    ("C:/evil", None, 1, "error: archive", "absolute path"),
    ("./", None, 0, 'warning: archive: the file name is "./", expected none for the FMU itself'),
    ("resources\\a", None, 0, 'expected "resources/a"'),
    ("MODELDESCRIPTION.xml", None, 0, "upper and lower case"),
    ("a\x1b[31m\n\u202eerror: b", None, 1, "archive"),
    ("resources/name", replacing(b"resources/name", b"resources/evil"), 0, "directory is wrong"),
    ("licences/a", replacing(b"permission", b"permissXon"), 0, "licences/a", "damaged"),
    ("resources/a", twice, 0, "same name"),
    ("resources/a", linked, 0, "symbolic link"),
    ("resources/a", overlapping, 0, "directory is wrong"),
    ("resources/a", bomb, 1, "zip bomb"),
    ("resources/a", lying_bomb, 0, "resources/zeros", "damaged"),
]


@pytest.mark.parametrize("row", ARCHIVES, ids=[ascii(f"{row[0]} {row[3]}") for row in ARCHIVES])
def test_every_rule_for_archives_finds_its_violation(row: tuple, tmp_path: Path) -> None:
    name, change, code, *expected = row
    file = fmu(tmp_path, 2, {name: "permission " * 99, "resources/b": ""})
    if change:
        change(file)
    check(findings(file), *expected)
    info = cargo_fmu("info", file)
    assert info.returncode == code
    assert code == 0 or str(file) in info.stderr
    assert not set("\x1b\u202e") & set(info.stdout + info.stderr)
    assert sorted(tmp_path.iterdir()) == [file]


def test_fmus_with_corrected_names_can_be_merged(fmus: Path, tmp_path: Path) -> None:
    pid = read(fmus / "Pid.fmu")
    first = write(tmp_path / "a.fmu", {"./": b""} | {f"./{name}": pid[name] for name in pid})
    second = write(tmp_path / "b.fmu", pid)
    result = cargo_fmu("merge", first, second, "--out", tmp_path / "c.fmu")
    assert result.returncode == 0, result.stderr
    assert read(tmp_path / "c.fmu") == pid


HOSTILE = {
    "deep": "<a>" * 1_000_000,
    "attributes": "<a " + " ".join(f'a{i}=""' for i in range(100_000)) + "/>",
    "long": f'<a b="{"x" * 10_000_000}"/>',
    "huge": "<a>" + " " * (64 << 20) + "</a>",
}


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_xml_is_rejected(text: str, tmp_path: Path) -> None:
    file = tmp_path / "x.fmu"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr(MODEL_FILE, HOSTILE[text])
        # Incompressible data, so that the compression ratio does not make it a zip bomb.
        archive.writestr("resources/noise", os.urandom(1 << 20))
    for command in ("info", "validate"):
        result = cargo_fmu(command, file)
        assert result.returncode == 1
        output = result.stdout + result.stderr
        assert MODEL_FILE in output
        assert len(output) < 2000


N = 20_000
"""So many elements of every kind that a quadratic search would take minutes."""


def test_the_time_for_a_large_fmu_is_proportional_to_its_size(tmp_path: Path) -> None:
    def each(text: str) -> str:
        return "".join(
            text % {"i": i, "a": 3 * i + 99, "b": 3 * i + 100, "c": 3 * i + 101} for i in range(N)
        )

    text = replaced(3)
    for end, elements in [
        ("    </Unit>", '<DisplayUnit name="d%(i)s"/>'),
        ("  </TypeDefinitions>", '<ClockType name="c%(i)s" intervalVariability="triggered"/>'
         '<EnumerationType name="e%(i)s"><Item name="a" value="1"/></EnumerationType>'),
        ("  </ModelVariables>", '<Clock name="clock%(i)s" valueReference="%(a)s" causality="input" '
         f'priority="1" declaredType="c{N - 1}" intervalVariability="triggered" '
         f'clocks="{3 * N + 96}"/><Enumeration name="v%(i)s" valueReference="%(b)s" '
         f'causality="parameter" declaredType="e{N - 1}" start="1"><Dimension valueReference="5"/>'
         '<Alias name="alias%(i)s"/></Enumeration><Float64 name="o%(i)s" valueReference="%(c)s" '
         f'causality="output" unit="rad" displayUnit="d{N - 1}"/>'),
        ("    <ContinuousState", '<Output valueReference="%(c)s"/>'),
        ("    <EventIndicator", '<InitialUnknown valueReference="%(c)s"/>'),
    ]:  # fmt: skip
        text = text.replace(end, each(elements) + end, 1)
    changes: dict = {f"sources/s{i}": "" for i in range(N)}
    changes[MODEL_FILE] = text
    changes[BUILD_FILE] = BUILD.replace(
        "<SourceFile n", each('<SourceFile name="s%(i)s"/>') + "<SourceFile n", 1
    )
    changes[TERMINALS_FILE] = TERMINALS.replace("  </Terminals>", each(
        '<Terminal name="t%(i)s" matchingRule="bus"><TerminalMemberVariable memberName="m" '
        'variableName="alias%(i)s" variableKind="signal"/></Terminal>'
    ) + "</Terminals>")  # fmt: skip
    file = fmu(tmp_path, 3, changes)
    assert findings(file) == []
    assert cargo_fmu("info", file).returncode == 0


# --- binaries -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "head"),
    [
        ("binaries/x86_64-linux/Full.so", ELF),
        ("binaries/x86_64-windows/Full.dll", b"MZ" + bytes(62)),
    ],
)
def test_functions_that_are_not_exported_are_found(file: str, head: bytes, tmp_path: Path) -> None:
    assert findings(fmu(tmp_path, 3, {file: head + FUNCTIONS}), "--no-run") == []
    assert len(findings(fmu(tmp_path, 3, {file: head}), "--no-run")) == 75
    files = []
    for name in FMI3_FUNCTIONS:
        functions = FUNCTIONS.replace(f"{name}\0".encode(), f"{name}X\0".encode())
        files.append(fmu(tmp_path, 3, {file: head + functions}, f"{name}.fmu"))
    lines = cargo_fmu("validate", "--no-run", *files).stdout.splitlines()
    assert len(lines) == 2 * 75
    for line, name in zip(lines[::2], FMI3_FUNCTIONS, strict=True):
        assert f"{file}: it does not export {name}," in line


DEFECTS = {
    "LENGTHS": '4 values of "w", which has 3',
    "SIZES": 'with "n" = 4, "w" cannot be read',
    "START": 'the start value of "c[3]" is different in the binary',
    "KEPT": '"c[3]" has another value in initialization mode',
    "STATE": '"w[2]" has another value after the state was restored',
    "RESET": '"w[2]" has another value after fmi3Reset',
    "RESET_PARAMETER": '"w[2]" has another value after fmi3Reset, expected 0.02',
    "RESET_INPUT": '"a[2]" has another value after fmi3Reset, expected 0.0 as its start value',
    "STATE_PARAMETER": '"c[2]" has another value after the state was restored',
    "STATE_INPUT": '"a[2]" has another value after the state was restored',
    "DRIFT": '"c[2]" has another value at the end of the run',
    "START_TIME": 'starts at another time, "time" at t = 0.5 s is 0.0, expected 0.5',
    "LATE_START": "warning: binaries/x86_64-linux/Vector.so: the step from t = 0.5 s",
    "DISCRETE": '"count" at t = 0 s is 1, expected 0 as before, until fmi3UpdateDiscreteStates',
    "EVENT_NEEDED": "eventHandlingNeeded is true after a step without event mode",
    "LAST_TIME": "lastSuccessfulTime is -1.000e-2 s off the end of a step of 0.01 s",
    "EARLY_ACROSS": "has ended early, at 0.0125 s, though that is not allowed",
    "BEYOND": "a step has returned early, but lastSuccessfulTime is after its end",
    "SET_LENGTHS": 'setting 4 values of "c", which has 3; setting 2 values of "c", which has 3',
    "ROUNDED": '"big" is 9007199254740992 after it was set to 9007199254740993',
    "EARLY": "has ended early, at 0.005 s, though that is not allowed",
    "INTERMEDIATE": "providesIntermediateUpdate is false; calls of the callback: 5, expected none",
    "SEED": "for the seed [2.0] is 2, expected 4",
    "ADJOINT": 'the adjoint derivative of "y" by "u" is -2, expected 2',
    "ADJOINT_SEED": 'the adjoint derivative of "y" by "u" is 1, expected 2',
    "RESET_SIZE": 'after fmi3Reset, "n" is 4, expected its start value',
}
"""Part of what is found in each variant of `tests/c/vector.c`."""


def test_defects_of_what_fmi_3_adds_are_found(tmp_path: Path) -> None:
    def found(defects: str, *options: str) -> set[str]:
        return set(findings(in_c(tmp_path / "Vector.fmu", *defects.split()), *options))

    sound = found("NONE")
    for defect, expected in DEFECTS.items():
        # A quick run keeps the inputs and makes no mistakes.
        is_slow = defect in {"LENGTHS", "SET_LENGTHS", "RESET_INPUT", "STATE_INPUT", "ROUNDED"}
        options = () if is_slow else ("--quick",)
        (finding,) = found(defect, *options) - sound
        assert expected in finding
    # Both are sound; many FMUs have a solver with steps of its own.
    assert found("EARLY_AT_END", "--quick") | found("OWN_STEPS", "--quick") <= sound
    # A crash at the end is no reason to look no further.
    assert len(found("UNLOAD SEED", "--quick") - sound) == 2
    other = (SOURCES / "vector.xml").read_text().replace("{vector}", "{other}")
    file = in_c(tmp_path / "Vector.fmu", xml=other)
    check(findings(file, "--quick"), "error: binaries", "fmi3InstantiateCoSimulation returned NULL")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        # Fewer start values than elements.
        ('start="1 2 3"', 'start="1 2"', [True]),
        # A variable without a valid size.
        ('<Float64 name="w"', '<Float64 name="z" valueReference="19">'
         '<Dimension valueReference="77"/></Float64><Float64 name="w"', [True]),
        # Nothing that can be run.
        ("fmiModelDescription", "fmiBuild", []),
    ],
)  # fmt: skip
def test_the_binary_is_not_blamed_for_errors_of_the_xml(
    old: str, new: str, expected: list[bool], tmp_path: Path
) -> None:
    """The output y of the binary is random."""
    xml = (SOURCES / "vector.xml").read_text().replace(old, new)
    found = findings(in_c(tmp_path / "Vector.fmu", "RANDOM", xml=xml), "--quick")
    assert any(line.startswith(f"error: {MODEL_FILE}") for line in found)
    assert ['"y" at t' in line for line in found if "Vector.so" in line] == expected, found


def test_event_mode_that_is_declared_is_tested(tmp_path: Path) -> None:
    xml = re.sub(r' provides\w+Derivatives="true"', "", (SOURCES / "vector.xml").read_text())
    found = findings(in_c(tmp_path / "Vector.fmu", "NO_STEP_MODE", xml=xml), "--quick")
    check(found, "hasEventMode is true, but: fmi3EnterStepMode returned fmi3Error")


def test_a_file_that_cannot_be_read_is_a_finding(tmp_path: Path) -> None:
    check(findings(tmp_path / "missing.fmu"), "error: archive: cannot open it")


# --- info -----------------------------------------------------------------------------------------

INFO = """model        Full
description  every element of the schema
FMI version  3.0
token        {0}
version      1
author       a
copyright    c
licence      MIT
generated by t
experiment   start 0 s, stop 1 s, step 0.01 s, tolerance 0.0001
"""


def test_info_shows_what_fmi_3_adds(tmp_path: Path) -> None:
    result = cargo_fmu("info", fmu(tmp_path, 3, {}))
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith(INFO)
    lines = [line.split() for line in result.stdout.splitlines()]
    for line in [
        "scheduled execution",
        "hasEventMode true",
        "fixedInternalStepSize 1e-3",
        "v parameter tunable Float32[m, 3] N 1 2 3 4 5 6",
        "phi local continuous Float64 rad -7 to 7 alias of x",
        "way parameter tunable Enumeration right 1 to 2",
        "data input discrete Binary 0aFF",
        "clock input discrete Clock constant every 1 s, priority 1",
        "Way: left = 1, right = 2",
        "a (plug, k): y, u[1,2].a, u[1,2].a, y",
        "a (sequence): w16",
    ]:
        assert line.split() in lines, line


def test_info_as_json_has_what_fmpy_reads(tmp_path: Path, fmus: Path) -> None:
    files = [fmus / "Pid.fmu", fmus / "IpidRbf_fmi3.fmu", fmu(tmp_path, 3, {})]
    *all_shown, full = json.loads(cargo_fmu("info", "--json", *files).stdout)
    for file, shown in zip(files, all_shown, strict=False):
        expected = fmpy.read_model_description(str(file), validate=False)
        assert shown["file"] == str(file)
        assert shown["modelDescription"]["fmiVersion"] == expected.fmiVersion
        assert shown["defaultExperiment"]["stopTime"] == float(expected.defaultExperiment.stopTime)
        for name, interface in shown["interfaces"].items():
            of_fmpy = getattr(expected, name[0].lower() + name[1:])
            for key in ("modelIdentifier", "needsExecutionTool", "canSerializeFMUState"):
                if key in interface and hasattr(of_fmpy, key):
                    assert interface[key] == getattr(of_fmpy, key), (name, key)
        for variable, listed in zip(shown["variables"], expected.modelVariables, strict=True):
            for key in ("name", "causality", "variability", "unit", "valueReference", "type"):
                assert variable[key] == getattr(listed, key), (variable, key)
            if isinstance(variable["start"], float):
                assert variable["start"] == float(listed.start)
        # One FMU is no array.
        assert json.loads(cargo_fmu("info", "--json", file).stdout) == shown
    # FMPy does not read every type.
    variables = {variable["name"]: variable for variable in full["variables"]}
    assert variables["v"]["start"] == [1, 2, 3, 4, 5, 6]
    assert full["interfaces"]["CoSimulation"]["hasEventMode"] is True
    assert all_shown[0]["modelDescription"]["numberOfEventIndicators"] == 0
    assert "ScheduledExecution" in full["interfaces"]
    assert full["enumerations"] == {"Way": {"left": 1, "right": 2}}
    assert full["terminals"][0]["matchingRule"] == "plug"


@pytest.mark.parametrize("text", ["", "<a/>", "<fmiTerminalsAndIcons><Terminals>"])
def test_info_ignores_broken_terminals(text: str, tmp_path: Path) -> None:
    result = cargo_fmu("info", fmu(tmp_path, 3, {TERMINALS_FILE: text}))
    assert result.returncode == 0
    assert "terminals" not in result.stdout
