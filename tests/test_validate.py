"""`cargo fmu validate` and `cargo fmu info` on valid, broken and hostile FMUs."""

import json
import os
import resource
import subprocess
import zipfile
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path

import fmpy
import pytest
from lxml import etree

from pendulum_fmus.project import PROGRAM, ROOT

MEMORY = 1 << 30
"""Maximum address space of the program in bytes."""

SECONDS = 60
"""Time limit of one run [s]."""

Fmu = dict[str, bytes]
"""The files of an FMU by name."""


@pytest.fixture(scope="session", autouse=True)
def _program(fmus: Path) -> None:
    """Build the program, which the export of the FMUs does."""


def cargo_fmu(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run `cargo fmu` with limited time and memory; it must not panic or be killed."""

    def bound() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    result = subprocess.run(
        [PROGRAM, *map(str, arguments)],
        capture_output=True,
        check=False,
        encoding="utf-8",
        preexec_fn=bound,
        timeout=SECONDS,
    )
    assert "panicked" not in result.stderr, result.stderr
    assert result.returncode in (0, 1, 2), result
    return result


def findings(file: Path, options: tuple[str, ...] = ("--quick",)) -> list[str]:
    """Return the findings of `validate` without the file name, and check the exit code."""
    result = cargo_fmu("validate", "--all", *options, file)
    assert result.stderr == ""
    *found, summary = (line.removeprefix(f"{file}: ") for line in result.stdout.splitlines())
    errors = sum(line.startswith("error: ") for line in found)
    assert result.returncode == (errors > 0)
    assert summary.startswith(f"{errors or 'no'} error"), summary
    return found


def read(file: Path) -> Fmu:
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def write(file: Path, content: Fmu) -> Path:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            # Unchanged: `writestr` would correct a name given as a string.
            entry = zipfile.ZipInfo("x")
            entry.filename = name
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, data)
    return file


def check(found: list[str], *expected: str) -> None:
    """Check that one of the findings contains all expected words."""
    assert any(all(words in line for words in expected) for line in found), found


# --- the exported FMUs ----------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["Pendulum", "IpidRbf", "Source"])  # one for each library
def test_exported_fmus_have_no_findings(fmus: Path, model: str) -> None:
    assert findings(fmus / f"{model}.fmu", ()) == []


# --- the model description ------------------------------------------------------------------------

FULL = (ROOT / "fuzz" / "corpus" / "full.xml").read_text()


def validate_xml(folder: Path, xml: str | bytes) -> list[str]:
    """Return the findings on an FMU with a model description and the files that it names."""
    content = {
        "modelDescription.xml": xml.encode() if isinstance(xml, str) else xml,
        "sources/full.c": b"",
    }
    return findings(write(folder / "x.fmu", content))


def test_a_model_description_with_every_element_has_no_findings(tmp_path: Path) -> None:
    assert validate_xml(tmp_path, FULL) == []


MUTATIONS = [
    # old text, new text, part of the finding
    ("fmiVersion", 'fmiVersion="2.0"', 'fmiVersion="2.1"', "expected 2.0"),
    ("missing", ' modelName="Full"', "", "no attribute modelName"),
    ("unknown attribute", "modelName=", 'colour="red" modelName=', '"colour"'),
    ("unknown element", "<LogCategories>", "<Colour/><LogCategories>", '"Colour"'),
    ("root", "fmiModelDescription", "fmiBuildDescription", "the root is"),
    ("text", "<ModelStructure>", "<ModelStructure>text", "holds text"),
    ("guid", 'guid="{0}"', 'guid=""', "guid is empty"),
    ("name", 'modelName="Full"', 'modelName=" "', "modelName is empty"),
    ("date", "2026-01-31T12:00:00Z", "yesterday", "generationDateAndTime"),
    ("zone", "12:00:00Z", "12:00:00+01:00", "ends in Z"),
    ("convention", '"structured"', '"snake"', "flat or structured"),
    ("structured", 'name="u[1,2].a"', 'name="u-a"', "not structured"),
    ("indicators", 'Indicators="1"', 'Indicators="-1"', "numberOfEventIndicators"),
    ("no indicators", ' numberOfEventIndicators="1"', "", "numberOfEventIndicators is missing"),
    ("identifier", 'modelIdentifier="Full"', 'modelIdentifier="a b"', "C identifier"),
    ("flag", 'canInterpolateInputs="true"', 'canInterpolateInputs="yes"', "true, false, 1 or 0"),
    ("flags", 'canGetAndSetFMUstate="true"', "", "canSerializeFMUstate is true"),
    ("source", 'name="full.c"', 'name="empty.c"', "empty.c", "expected it in sources"),
    ("unit twice", 'Unit name="N"', 'Unit name="rad"', 'unit "rad" is defined twice'),
    ("unit", 'unit="N"', 'unit="lbf"', 'unit "lbf" is not defined'),
    ("display unit", 'displayUnit="deg"/>', 'displayUnit="gon"/>', 'display unit "gon"'),
    ("exponent", 'kg="1"', 'kg="1.5"', "kg is", "whole number"),
    ("factor", 'factor="57.29577951308232"', 'factor="0"', "factor"),
    ("type", 'declaredType="Count"', 'declaredType="Number"', '"Number" is not defined'),
    ("type of type", 'declaredType="Count"', 'declaredType="Angle"', 'expected Integer'),
    ("enumeration type", ' declaredType="Way"', "", "no attribute declaredType"),
    ("item value", 'name="right" value="2"', 'name="right" value="1"', "value 1"),
    ("item name", 'name="right"', 'name="left"', 'item "left" is defined twice'),
    ("item start", 'max="2" start="2"', 'max="3" start="3"', "value of an item"),
    ("category", "<Category", '<Category name="logAll"/><Category', "defined twice"),
    ("experiment", 'stopTime="1"', 'stopTime="0"', "after startTime"),
    ("step", 'stepSize="1e-2"', 'stepSize="0"', "stepSize is 0"),
    ("tolerance", 'tolerance="1e-4"', 'tolerance="x"', "expected a number"),
    ("causality", 'causality="input"', 'causality="in"', "causality is"),
    ("variability", 'variability="tunable"', 'variability="often"', "variability is"),
    ("initial", 'initial="approx"', 'initial="maybe"', "initial is"),
    ("combination", 'causality="input"', 'causality="input" variability="fixed"',
     "causality input and variability fixed", "FMI 2.0.5, section 2.2.7"),
    ("wrong initial", 'fixed" initial="approx"', 'fixed" initial="exact"', "initial is exact"),
    ("initial of input", 'causality="input"', 'causality="input" initial="exact"', "initial is"),
    ("integer", 'causality="parameter" variability="fixed"', 'variability="continuous"', "Integer"),
    ("no start", ' start="0"/>', "/>", "it has no start"),
    ("start", '<Real derivative="2"/>', '<Real derivative="2" start="1"/>', "it has a start"),
    ("start form", 'start="0.5"', 'start="half"', "expected a number"),
    ("boolean form", 'start="true"', 'start="True"', "start is"),
    ("bounds", 'min="1" max="5" start="3"', 'min="5" max="1" start="3"', "min <= max"),
    ("start bound", 'min="1" max="5" start="3"', 'min="1" max="5" start="7"', "start is 7"),
    ("type bound", 'declaredType="Angle" start="0.5"', 'declaredType="Angle" start="8"', "max 7"),
    ("name twice", 'name="y"', 'name="x"', "two variables have the name"),
    ("empty name", 'name="n"', 'name=""', "name is empty"),
    ("reference", 'valueReference="3" causality="p', 'valueReference="-3" causality="p', "-3"),
    ("alias set", 'valueReference="4"', 'valueReference="3"', "both are set"),
    ("alias unit", '<Real unit="rad" displayUnit="deg"/>', '<Real unit="N"/>', "another unit"),
    ("independent", 'name="y" valueReference="1" causality="output"',
     'name="y" valueReference="9" causality="independent"', "at most one independent"),
    ("independent type", "<Real/>", '<Integer/>', "is not a Real"),
    ("derivative", 'derivative="2"', 'derivative="99"', "derivative is 99"),
    ("derivative of", 'derivative="2"', 'derivative="6"', 'derivative of "n"'),
    ("output", '<Unknown index="5" dep', '<Unknown index="4" dep', "not in Outputs"),
    ("no output", '<Unknown index="5" dep', '<Unknown index="4" dep', "expected outputs only"),
    ("no derivative", '<Unknown index="3" dep', '<Unknown index="4" dep', "attribute derivative"),
    ("index", '<Unknown index="9"/>', '<Unknown index="10"/>', "index 10, expected", "1 to 9"),
    ("index twice", '<Unknown index="9"/>', '<Unknown index="9"/><Unknown index="9"/>', "9 twice"),
    ("dependency", 'dependencies="2 4"', 'dependencies="2 10"', "dependencies has 10"),
    ("dependency form", 'dependencies="2 4"', 'dependencies="2,4"', "separated by spaces"),
    ("dependency kind", '"dependent fixed"', '"dependent often"', "dependenciesKind"),
    ("dependency kinds", '"dependent fixed"', '"dependent"', "1 items, expected 2"),
    ("initial unknown", '<Unknown index="9"/>', "", "not in InitialUnknowns"),
    ("too much", '<Unknown index="9"/>', '<Unknown index="9"/><Unknown index="4"/>', "warning"),
    ("order", "<ModelVariables>", "<UnitDefinitions/><ModelVariables>", "expected it before"),
    ("empty list", '<Category name="logAll" description="all"/>', "", "holds no Category"),
    ("no variables", "ModelVariables>", "Variables>", "holds no ModelVariables"),
    ("encoding", 'encoding="UTF-8"', 'encoding="UTF-16"', "expected UTF-8"),
    ("source twice", '<File name="full.c"/>', '<File name="full.c"/><File name="./full.c"/>',
     "listed twice"),
    ("dependency order", 'dependencies="2 4"', 'dependencies="4 2"', "2 after 4"),
    ("kinds alone", 'dependencies="2 4" ', "", "without dependencies"),
    ("kind of initial unknown", '<Unknown index="9"/>',
     '<Unknown index="9" dependencies="4" dependenciesKind="fixed"/>', "dependent or constant"),
    ("kind of integer", '<Unknown index="9"/>',
     '<Unknown index="7" dependencies="4" dependenciesKind="constant"/>', "not a Real"),
    ("initial unknown order", '<Unknown index="9"/>',
     '<Unknown index="9"/><Unknown index="8"/>', "8 after 9"),
    ("initial known", '<Unknown index="9"/>', '<Unknown index="9" dependencies="3"/>', "warning",
     "which is computed"),
    ("type name", 'SimpleType name="Way"', 'SimpleType name="x"', "a type has the same name"),
    ("nominal", 'unit="N"', 'unit="N" nominal="0"', "nominal is 0"),
    ("bound of type", 'declaredType="Angle" start="0.5"',
     'declaredType="Angle" max="9" start="0.5"', "warning", "within max 7 of its type"),
    ("name of derivative", 'name="n"', 'name="der(n)"', "expected a Real, not Integer"),
    ("tool twice", '<Tool name', '<Tool name="a"/><Tool name="a"/><Tool name', 'tool "a"'),
    ("step", 'stepSize="1e-2"', 'stepSize="2"', "warning", "stepSize is 2"),
    ("several sets", 'name="y"', 'name="y" canHandleMultipleSetPerTimeInstant="true"',
     "only for inputs"),
    ("reinit", 'unit="N"', 'unit="N" reinit="true"', "only for states"),
    ("not closed", "</ModelStructure>", "", "modelDescription.xml: line"),
    ("entity", 'guid="{0}"', 'guid="&guid;"', "guid"),
    ("document type", "<fmiModel", "<!DOCTYPE a><fmiModel", "DTD"),
]  # fmt: skip


@pytest.mark.parametrize("mutation", MUTATIONS, ids=[m[0] for m in MUTATIONS])
def test_every_rule_finds_its_violation(mutation: tuple[str, ...], tmp_path: Path) -> None:
    _, old, new, *expected = mutation
    assert old in FULL
    times = -1 if old.endswith(("Description", "Variables>")) else 1
    found = validate_xml(tmp_path, FULL.replace(old, new, times))
    check(found, *expected)


def test_a_second_start_value_of_an_alias_is_found(tmp_path: Path) -> None:
    old = '<ScalarVariable name="y" valueReference="1" causality="output">\n      <Real '
    assert old in FULL
    new = old.replace('"output"', '"output" initial="exact"') + 'start="1" '
    check(validate_xml(tmp_path, FULL.replace(old, new)), "both have a start")


def test_a_flat_name_has_no_line_break(tmp_path: Path) -> None:
    xml = FULL.replace('"structured"', '"flat"').replace('name="n"', 'name="n&#10;m"')
    check(validate_xml(tmp_path, xml), "line break or tab")


def test_aliases_of_other_variability_are_found(tmp_path: Path) -> None:
    old = '<ScalarVariable name="y" valueReference="1" causality="output">'
    assert old in FULL
    new = old.replace('"output"', '"output" variability="discrete"')
    check(validate_xml(tmp_path, FULL.replace(old, new)), "warning", "expected")


def test_findings_of_one_kind_are_grouped(tmp_path: Path) -> None:
    xml = FULL.replace("<ModelStructure>", "<ModelStructure>" + "<A/>" * 1000)
    xml = xml.replace('guid="{0}"', 'guid=""')
    content = {"modelDescription.xml": xml.encode(), "sources/full.c": b""}
    file = write(tmp_path / "x.fmu", content)
    result = cargo_fmu("validate", file)
    assert result.returncode == 1
    *found, summary = result.stdout.splitlines()
    assert summary == f"{file}: 1001 errors, no warning"
    assert sum('ModelStructure holds "A"' in line for line in found) == 3
    assert f"{file}: and 997 more of this kind: element-known" in found
    check(found, "guid is empty")
    assert len(findings(file)) == 1001  # With `--all`.


def test_findings_are_available_as_json(tmp_path: Path) -> None:
    content = {"modelDescription.xml": FULL.replace('guid="{0}"', 'guid=""').encode()}
    file = write(tmp_path / "x.fmu", content)
    result = cargo_fmu("validate", "--format", "json", file)
    assert result.returncode == 1
    (report,) = json.loads(result.stdout)["files"]
    assert (report["file"], report["errors"], report["warnings"]) == (str(file), 2, 0)
    rule = next(rule for rule in report["rules"] if rule["id"] == "name-and-guid")
    assert rule == {
        "id": "name-and-guid",
        "severity": "error",
        "text": "modelName and guid, in FMI 3.0 instantiationToken, are not empty.",
        "source": "FMI 2.0.5, section 2.2.1",
        "count": 1,
        "findings": [
            {
                "file": "modelDescription.xml",
                "line": 2,
                "variable": None,
                "text": "guid is empty, expected a string",
            }
        ],
    }


def test_findings_are_available_as_sarif(tmp_path: Path) -> None:
    xml = FULL.replace("<ModelStructure>", "<ModelStructure>text")
    file = write(tmp_path / "x.fmu", {"modelDescription.xml": xml.encode()})
    result = cargo_fmu("validate", "--format", "sarif", file)
    assert result.returncode == 1
    log = json.loads(result.stdout)
    assert log["version"] == "2.1.0"
    (run,) = log["runs"]
    found = {item["ruleId"]: item["locations"][0] for item in run["results"]}
    assert found["no-text"]["physicalLocation"]["region"] == {"startLine": 76}


@pytest.mark.parametrize("version", ["1.0", "4.0"])
def test_another_version_is_the_only_finding(version: str, tmp_path: Path) -> None:
    content = {
        "modelDescription.xml": f'<fmiModelDescription fmiVersion="{version}"/>'.encode("latin-1"),
        "binaries/x86_64-linux/a.so": b"",
    }
    file = write(tmp_path / "x.fmu", content)
    text = f"it is of FMI version {version}, expected 2.0"
    (found,) = findings(file)
    assert text in found
    assert text in cargo_fmu("info", file).stderr
    system = tmp_path / "system.toml"
    system.write_text('stop = 1\nstep = 1\n[[component]]\nname = "a"\nfmu = "x.fmu"\n')
    result = cargo_fmu("simulate", system)
    assert result.returncode == 1
    assert text in result.stderr


@pytest.mark.parametrize("encoding", ["ISO-8859-1", "windows-1252", "US-ASCII", "UTF-16"])
def test_other_encodings_are_read(encoding: str, tmp_path: Path) -> None:
    name = "Full" if encoding == "US-ASCII" else "Größe"
    xml = FULL.replace('encoding="UTF-8"', f'encoding="{encoding}"')
    xml = xml.replace('modelName="Full"', f'modelName="{name}"').encode(encoding)
    content = {"modelDescription.xml": xml, "sources/full.c": b""}
    file = write(tmp_path / "x.fmu", content)
    (found,) = findings(file)
    assert "error: modelDescription.xml: the encoding is" in found
    assert name in cargo_fmu("info", file).stdout


def test_bytes_that_cannot_be_decoded_are_a_finding(tmp_path: Path) -> None:
    xml = FULL.replace('modelName="Full"', 'modelName="Größe"').encode("latin-1")
    (found,) = validate_xml(tmp_path, xml)
    assert "line 2 has bytes that are not UTF-8" in found


def test_untrusted_text_is_quoted_on_one_line(tmp_path: Path) -> None:
    xml = FULL.replace('name="y"', f'name="a&#10;\u202eb{"c" * 10_000}"')
    found = validate_xml(tmp_path, xml)
    assert all(line.startswith(("error: ", "warning: ")) for line in found)
    assert max(map(len, found)) < 300


def neighbours(xml: str) -> Iterator[str]:
    """Yield every document that differs by one attribute or element."""
    root = etree.fromstring(xml.encode())
    own = [element for element in root.iter(etree.Element) if not etree.QName(element).namespace]
    for place in map(root.getroottree().getpath, own):
        for name in root.xpath(place)[0].attrib:
            for value in (None, "", "x", "-1", "1", "true"):
                copy = deepcopy(root)
                (element,) = copy.xpath(place)
                if value is None:
                    del element.attrib[name]
                else:
                    element.set(name, value)
                yield etree.tostring(copy, encoding="unicode")
        for change in ("delete", "double", "move", "rename", "text", "attribute"):
            copy = deepcopy(root)
            (element,) = copy.xpath(place)
            parent = element.getparent()
            if change == "rename":
                element.tag = "Other"
            elif change == "text":
                element.text = "text"
            elif change == "attribute":
                element.set("other", "1")
            elif parent is None:
                continue
            elif change == "delete":
                parent.remove(element)
            elif change == "double":
                element.addnext(deepcopy(element))
            else:
                parent.append(element)
            yield etree.tostring(copy, encoding="unicode")


def test_documents_that_violate_the_schema_are_errors(tmp_path: Path) -> None:
    folder = Path(fmpy.__file__).parent / "schema" / "fmi2"
    schema = etree.XMLSchema(file=str(folder / "fmi2ModelDescription.xsd"))
    refused = [xml for xml in neighbours(FULL) if not schema.validate(etree.fromstring(xml))]
    assert len(refused) > 500
    files = []
    for index, xml in enumerate(refused):
        content = {"modelDescription.xml": xml.encode(), "sources/full.c": b""}
        files.append(write(tmp_path / f"{index}.fmu", content))
    output = cargo_fmu("validate", *files).stdout
    for file, xml in zip(files, refused, strict=True):
        assert f"{file}: error: modelDescription.xml" in output, xml


# --- the archive ----------------------------------------------------------------------------------


@pytest.fixture
def pid(fmus: Path) -> Fmu:
    """Return the files of a valid FMU."""
    return read(fmus / "Pid.fmu")


BAD_NAMES = {
    "../evil": "path traversal",
    "resources/../../evil": "path traversal",
    "resources\\..\\..\\evil": "path traversal",
    "/etc/evil": "absolute path",
    "C:/evil": "absolute path",
}


@pytest.mark.parametrize("name", BAD_NAMES)
def test_a_path_outside_the_archive_is_rejected(name: str, pid: Fmu, tmp_path: Path) -> None:
    file = write(tmp_path / "x.fmu", {**pid, name: b""})
    check(findings(file), "error: archive", BAD_NAMES[name])
    result = cargo_fmu("info", file)
    assert result.returncode == 1
    assert BAD_NAMES[name] in result.stderr
    assert str(file) in result.stderr
    assert sorted(tmp_path.iterdir()) == [file]


ODD_NAMES = {
    "./": 'the file name is "./", expected none for the FMU itself',
    "./resources/a": 'expected "resources/a"',
    "resources\\a": 'expected "resources/a"',
    "resources//a": 'expected "resources/a"',
    "MODELDESCRIPTION.xml": "upper and lower case",
}


@pytest.mark.parametrize("name", ODD_NAMES)
def test_a_harmless_name_is_corrected(name: str, pid: Fmu, tmp_path: Path) -> None:
    file = write(tmp_path / "x.fmu", {**pid, name: b""})
    (found,) = findings(file)
    assert ODD_NAMES[name] in found
    info = cargo_fmu("info", file)
    assert info.returncode == 0
    assert ("resources    a" in info.stdout) == name.endswith("a")


def test_fmus_with_corrected_names_can_be_merged(pid: Fmu, tmp_path: Path) -> None:
    first = write(tmp_path / "a.fmu", {"./": b""} | {f"./{name}": pid[name] for name in pid})
    second = write(tmp_path / "b.fmu", pid)
    result = cargo_fmu("merge", first, second, "--out", tmp_path / "c.fmu")
    assert result.returncode == 0, result.stderr
    assert read(tmp_path / "c.fmu") == pid


def test_of_two_files_with_the_same_name_the_last_is_used(pid: Fmu, tmp_path: Path) -> None:
    """FMPy does the same."""
    file = write(tmp_path / "x.fmu", pid)
    with zipfile.ZipFile(file, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("modelDescription.xml", FULL)
    check(findings(file), "same name")
    assert "Full" in cargo_fmu("info", file).stdout


def test_a_source_file_may_be_named_with_a_dot(tmp_path: Path) -> None:
    assert validate_xml(tmp_path, FULL.replace('name="full.c"', 'name="./full.c"')) == []


def test_a_name_that_differs_from_the_local_header_is_rejected(pid: Fmu, tmp_path: Path) -> None:
    file = write(tmp_path / "x.fmu", {**pid, "resources/name": b""})
    content = file.read_bytes()
    file.write_bytes(content.replace(b"resources/name", b"resources/evil", 1))
    check(findings(file), "directory is wrong")


def test_a_symbolic_link_is_found(pid: Fmu, tmp_path: Path) -> None:
    file = write(tmp_path / "x.fmu", pid)
    link = zipfile.ZipInfo("resources/link")
    link.create_system, link.external_attr = 3, 0o120777 << 16
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr(link, "/etc/passwd")
    check(findings(file), "symbolic link")


def test_damaged_content_is_found(pid: Fmu, tmp_path: Path) -> None:
    file = tmp_path / "x.fmu"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, data in pid.items():
            archive.writestr(name, data)
    content = file.read_bytes()
    at = content.index(b"documentation/licenses/LICENSE-MIT") + 200
    file.write_bytes(content[:at] + b"XXXX" + content[at + 4 :])
    check(findings(file), "LICENSE-MIT", "damaged")


def test_a_missing_model_description_is_found(tmp_path: Path) -> None:
    file = write(tmp_path / "x.fmu", {"x/modelDescription.xml": b""})
    check(findings(file), "modelDescription.xml")


@pytest.mark.parametrize("name", ["binaries/a\x1b[31m/b", "a\nerror: b", "\u202eevil"])
def test_a_name_cannot_contain_terminal_escapes(name: str, pid: Fmu, tmp_path: Path) -> None:
    file = write(tmp_path / "x.fmu", {**pid, name: b""})
    for command in ("info", "validate"):
        result = cargo_fmu(command, file)
        output = result.stdout + result.stderr
        assert not set("\x1b\u202e") & set(output)
        assert "\nerror: b" not in output


def bomb(file: Path, name: str, size: int) -> Path:
    """Write an archive with a file of zeros of this size."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", FULL)
        with archive.open(name, "w", force_zip64=True) as entry:
            for _ in range(size >> 20):
                entry.write(bytes(1 << 20))
    return file


def test_a_zip_bomb_is_rejected(tmp_path: Path) -> None:
    file = bomb(tmp_path / "x.fmu", "resources/zeros", 200 << 20)
    assert file.stat().st_size < 1 << 20
    for command in ("info", "validate"):
        result = cargo_fmu(command, file)
        assert result.returncode == 1
        assert "zip bomb" in result.stdout + result.stderr


def test_a_zip_bomb_that_lies_about_its_size_is_not_inflated(tmp_path: Path) -> None:
    size = 200 << 20
    file = bomb(tmp_path / "x.fmu", "resources/zeros", size)
    content = file.read_bytes()
    small = content.replace(size.to_bytes(4, "little"), (1000).to_bytes(4, "little"))
    small = small.replace(size.to_bytes(8, "little"), (1000).to_bytes(8, "little"))
    assert small != content
    file.write_bytes(small)
    check(findings(file), "resources/zeros", "damaged")


def test_overlapping_files_are_rejected(tmp_path: Path) -> None:
    """Imitates a zip bomb whose files all share the same bytes of the archive."""
    file = write(tmp_path / "x.fmu", {"modelDescription.xml": FULL.encode(), "a": b"a", "b": b"b"})
    with zipfile.ZipFile(file) as archive:
        first, second = (archive.getinfo(name).header_offset for name in "ab")
    content = bytearray(file.read_bytes())
    at = content.rindex(second.to_bytes(4, "little") + b"b")
    content[at : at + 4] = first.to_bytes(4, "little")
    file.write_bytes(content)
    check(findings(file), "directory is wrong")


HOSTILE = {
    "entities": '<!DOCTYPE a [<!ENTITY a "ha"><!ENTITY b "{}">]><a>&b;</a>'.format("&a;" * 1000),
    "files": '<!DOCTYPE a [<!ENTITY a SYSTEM "file:///etc/passwd">]><a>&a;</a>',
    "deep": "<a>" * 1_000_000,
    "wide": "<a>" + "<b/>" * 1_100_000 + "</a>",
    "attributes": "<a " + " ".join(f'a{i}=""' for i in range(100_000)) + "/>",
    "long": f'<a b="{"x" * 10_000_000}"/>',
    "huge": "<a>" + " " * (64 << 20) + "</a>",
}


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_xml_is_rejected(text: str, tmp_path: Path) -> None:
    file = tmp_path / "x.fmu"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("modelDescription.xml", HOSTILE[text])
        # Incompressible data, so that the compression ratio does not make it a zip bomb.
        archive.writestr("resources/noise", os.urandom(1 << 20))
    for command in ("info", "validate"):
        result = cargo_fmu(command, file)
        assert result.returncode == 1
        output = result.stdout + result.stderr
        assert "modelDescription.xml" in output
        assert len(output) < 2000


N = 20_000
"""So many elements of every kind that a quadratic search would take minutes."""

LARGE = {
    "items": (
        "".join(f'<Item name="i{i}" value="{i + 3}"/>' for i in range(N)),
        '<Enumeration declaredType="Way" start="3"/>',
    ),
    "display units": (
        "".join(f'<DisplayUnit name="d{i}"/>' for i in range(N)),
        f'<Real unit="rad" displayUnit="d{N - 1}" start="0"/>',
    ),
    "types": (
        "".join(f'<SimpleType name="t{i}"><Real/></SimpleType>' for i in range(N)),
        f'<Real declaredType="t{N - 1}" start="0"/>',
    ),
    "sources": ("".join(f'<File name="s{i}"/>' for i in range(N)), '<Real start="0"/>'),
}
LAST = {
    "items": "</Enumeration>",
    "display units": "    </Unit>",
    "types": "</TypeDefinitions>",
    "sources": "</SourceFiles>",
}


@pytest.mark.parametrize("what", LARGE)
def test_the_time_for_a_large_fmu_is_proportional_to_its_size(what: str, tmp_path: Path) -> None:
    definitions, value = LARGE[what]
    variables = "".join(
        f'<ScalarVariable name="v{i}" valueReference="{i + 99}" causality="parameter" '
        f'variability="fixed">{value}</ScalarVariable>'
        for i in range(N)
    )
    xml = FULL.replace(LAST[what], definitions + LAST[what], 1)
    xml = xml.replace("</ModelVariables>", variables + "</ModelVariables>")
    content = {f"sources/s{i}": b"" for i in range(N)} if what == "sources" else {}
    content |= {"modelDescription.xml": xml.encode(), "sources/full.c": b""}
    file = write(tmp_path / "x.fmu", content)
    for command in ("info", "validate"):
        result = cargo_fmu(command, file)
        assert result.returncode == 0, (result.stdout + result.stderr)[:1000]


# --- binaries -------------------------------------------------------------------------------------


def test_an_unknown_platform_is_a_warning(pid: Fmu, tmp_path: Path) -> None:
    found = findings(write(tmp_path / "x.fmu", {**pid, "binaries/amiga/Pid.library": b""}))
    check(found, "warning: binaries/amiga", "linux64")
    assert len(found) == 1


def test_a_binary_of_another_name_is_missing(pid: Fmu, tmp_path: Path) -> None:
    pid["binaries/linux64/libPid.so"] = pid.pop("binaries/linux64/Pid.so")
    check(findings(write(tmp_path / "x.fmu", pid)), "binaries/linux64", "modelIdentifier")


@pytest.mark.parametrize("head", [b"", b"MZ", b"\x7fELF\x01"])
def test_a_binary_of_another_format_is_found(head: bytes, pid: Fmu, tmp_path: Path) -> None:
    pid["binaries/linux64/Pid.so"] = head
    found = findings(write(tmp_path / "x.fmu", pid))
    check(found, "binaries/linux64/Pid.so", "not a shared library")
    check(found, "cannot be loaded")


def test_a_truncated_binary_is_found(pid: Fmu, tmp_path: Path) -> None:
    binary = pid["binaries/linux64/Pid.so"]
    pid["binaries/linux64/Pid.so"] = binary[: len(binary) // 2]
    assert findings(write(tmp_path / "x.fmu", pid))


def test_an_fmu_without_binaries_and_sources_is_found(pid: Fmu, tmp_path: Path) -> None:
    del pid["binaries/linux64/Pid.so"]
    check(findings(write(tmp_path / "x.fmu", pid)), "neither binaries nor sources")


def test_an_fmu_for_other_machines_is_not_run(pid: Fmu, tmp_path: Path) -> None:
    del pid["binaries/linux64/Pid.so"]
    pid["binaries/win64/Pid.dll"] = b"MZ"
    found = findings(write(tmp_path / "x.fmu", pid))
    assert len(found) == 1
    check(found, "warning: binaries", "linux64")


def test_mismatched_xml_and_binary_are_found(pid: Fmu, tmp_path: Path) -> None:
    xml = pid["modelDescription.xml"].decode()
    guid = xml.split('guid="')[1].split('"')[0]
    pid["modelDescription.xml"] = xml.replace(guid, "{another}").encode()
    check(findings(write(tmp_path / "x.fmu", pid)), "fmi2Instantiate returned NULL")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('start="300"', 'start="301"', 'start value of "pid.kp" is 300 in the binary'),
        (
            'OutputDerivativeOrder="0"',
            'OutputDerivativeOrder="1"',
            "OutputDerivativeOrder is not",
        ),
        ('canInterpolateInputs="false"', 'canInterpolateInputs="true"', "canInterpolateInputs is"),
        ('DirectionalDerivative="false"', 'DirectionalDerivative="1"', "DirectionalDerivative is"),
        ('name="u" valueReference="3"', 'name="u" valueReference="999"', '"u" cannot be read'),
    ],
)
def test_wrong_claims_of_the_xml_are_found(
    old: str, new: str, expected: str, pid: Fmu, tmp_path: Path
) -> None:
    xml = pid["modelDescription.xml"].decode()
    assert old in xml
    pid["modelDescription.xml"] = xml.replace(old, new).encode()
    check(findings(write(tmp_path / "x.fmu", pid)), "error: binaries/linux64/Pid.so", expected)
