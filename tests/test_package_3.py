"""The five FMUs of FMI 3.0 as packages: what they share with those of FMI 2.0, and what is new."""

import re
import subprocess
import zipfile
from pathlib import Path

import fmpy
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from test_exporter import cargo_fmu, refusal
from test_package import MODELS

STANDARD = Path(fmpy.__file__).parent
FMI3_FUNCTIONS = set(
    re.findall(r"fmi3FullName\((fmi3\w+)\)", (STANDARD / "c-code" / "fmi3Functions.h").read_text())
)
TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
TYPES = {"Real": "Float64", "Integer": "Int32"}
"""Types of FMI 2.0 that have another name in FMI 3.0."""

each_model = pytest.mark.parametrize("model", MODELS)


def fmu(fmus: Path, model: str) -> Path:
    """Return the path of an FMU of FMI 3.0."""
    return fmus / f"{model}_fmi3.fmu"


def read(fmus: Path, model: str, name: str) -> bytes:
    """Return a file of an FMU of FMI 3.0."""
    with zipfile.ZipFile(fmu(fmus, model)) as archive:
        return archive.read(name)


def parse(fmus: Path, model: str, name: str = "modelDescription.xml") -> etree._Element:
    """Return the root of an XML file of an FMU of FMI 3.0."""
    return etree.fromstring(read(fmus, model, name))


def parse_fmi2(fmus: Path, model: str) -> etree._Element:
    """Return the root of the model description in FMI 2.0."""
    with zipfile.ZipFile(fmus / f"{model}.fmu") as archive:
        return etree.fromstring(archive.read("modelDescription.xml"))


@each_model
def test_fmpy_validates_it_without_problems(fmus: Path, model: str) -> None:
    assert validate_fmu(str(fmu(fmus, model))) == []
    assert parse(fmus, model).get("fmiVersion") == "3.0"


def test_the_validator_has_no_findings(fmus: Path) -> None:
    files = [fmu(fmus, model) for model in MODELS]
    result = cargo_fmu("validate", "--no-run", *files)
    assert result.stdout.count("no error, no warning") == len(MODELS), result.stdout


@each_model
def test_it_has_the_files_of_the_standard_and_no_others(fmus: Path, model: str) -> None:
    with zipfile.ZipFile(fmu(fmus, model)) as archive:
        names = archive.namelist()
    assert names[0] == "modelDescription.xml"
    assert sorted(names[1:]) == [
        f"binaries/x86_64-linux/{model}.so",
        "documentation/index.html",
        "documentation/licenses/LICENSE-APACHE",
        "documentation/licenses/LICENSE-MIT",
        "documentation/licenses/license.txt",
        "terminalsAndIcons/icon.png",
        TERMINALS,
    ]
    page = read(fmus, model, "documentation/index.html").decode()
    assert "FMI 3.0" in page
    assert f"<code>{model}_fmi3.fmu</code>" in page
    assert "../terminalsAndIcons/icon.png" in page
    for variable in parse(fmus, model).find("ModelVariables"):
        assert f'<th scope="row">{variable.get("name")}</th>' in page


@pytest.mark.parametrize("model", ["Pendulum", "PidRbf", "Source"])
def test_library_exports_the_functions_of_the_standard_and_nothing_else(
    fmus: Path, model: str, tmp_path: Path
) -> None:
    assert len(FMI3_FUNCTIONS) == 75
    library = tmp_path / "library.so"
    library.write_bytes(read(fmus, model, f"binaries/x86_64-linux/{model}.so"))
    command = ["nm", "-D", "--defined-only", library]
    nm = subprocess.run(command, capture_output=True, text=True, check=True)
    assert {line.split()[-1] for line in nm.stdout.splitlines()} == FMI3_FUNCTIONS


@each_model
def test_variables_are_those_of_fmi_2(fmus: Path, model: str) -> None:
    scalars = parse_fmi2(fmus, model).findall("ModelVariables/ScalarVariable")
    *variables, time = parse(fmus, model).find("ModelVariables")
    shared = ("name", "description", "causality", "variability", "initial")
    # FMI 2.0 has no structural parameters, and arrays of the size that these have at the start.
    structural = {
        variable.get("valueReference"): int(variable.get("start"))
        for variable in variables
        if variable.get("causality") == "structuralParameter"
    }
    position = 0
    for variable in variables:
        if variable.get("valueReference") in structural:
            continue
        sizes = [
            structural[dimension.get("valueReference")]
            if dimension.get("valueReference")
            else int(dimension.get("start"))
            for dimension in variable.findall("Dimension")
        ]
        elements = scalars[position : position + (sizes or [1])[0]]
        first, (of_type,) = elements[0], elements[0]
        assert variable.tag == TYPES.get(of_type.tag, of_type.tag)
        for name in shared[0 if not sizes else 1 :]:
            assert variable.get(name) == first.get(name)
        assert first.get("name") == variable.get("name") + ("[1]" if sizes else "")
        assert variable.get("valueReference") == first.get("valueReference")
        for name in ("unit", "displayUnit", "min", "max", "nominal", "declaredType"):
            assert variable.get(name) == of_type.get(name), name
        starts = [element[0].get("start") for element in elements]
        assert (variable.get("start") or "").split() == [start for start in starts if start]
        position += len(elements)
    assert position == len(scalars)
    assert (time.get("causality"), time.get("unit")) == ("independent", "s")
    last = max(int(scalar.get("valueReference")) for scalar in scalars)
    assert int(time.get("valueReference")) > last


@each_model
def test_unknowns_are_those_of_fmi_2(fmus: Path, model: str) -> None:
    description, other = parse(fmus, model), parse_fmi2(fmus, model)
    references = [v.get("valueReference") for v in other.findall("ModelVariables/ScalarVariable")]
    arrays = {v.get("valueReference") for v in description.find("ModelVariables")}
    time = description.find("ModelVariables")[-1].get("valueReference")

    def unknowns(element: etree._Element, attribute: str) -> dict[str, list[str]]:
        return {u.get(attribute): u.get("dependencies").split() for u in element}

    for old, new in (
        ("Outputs", "Output"),
        ("Derivatives", "ContinuousStateDerivative"),
        ("InitialUnknowns", "InitialUnknown"),
    ):
        listed = other.find(f"ModelStructure/{old}")
        in_fmi2 = {
            references[int(index) - 1]: [references[int(i) - 1] for i in dependencies]
            for index, dependencies in unknowns(() if listed is None else listed, "index").items()
        }
        expected = {key: value for key, value in in_fmi2.items() if key in arrays}
        found = unknowns(description.findall(f"ModelStructure/{new}"), "valueReference")
        # FMI 2.0 does not list the time, which has no variable there.
        without_time = {key: [v for v in known if v != time] for key, known in found.items()}
        assert without_time == expected, new


def terminals(fmus: Path, model: str) -> dict[str, dict[str, str]]:
    """Return the causalities of the members of each terminal."""
    variables = parse(fmus, model).find("ModelVariables")
    causality = {variable.get("name"): variable.get("causality") for variable in variables}
    return {
        terminal.get("name"): {
            member.get("memberName"): causality[member.get("variableName")] for member in terminal
        }
        for terminal in parse(fmus, model, TERMINALS).find("Terminals")
    }


@each_model
def test_terminals_follow_the_schema(fmus: Path, model: str) -> None:
    schema = STANDARD / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"
    etree.XMLSchema(file=str(schema)).assertValid(parse(fmus, model, TERMINALS))


@pytest.mark.parametrize("controller", ["Pid", "PidRbf", "IpidRbf"])
def test_terminals_connect_the_loop(fmus: Path, controller: str) -> None:
    of_controller = terminals(fmus, controller)
    others = terminals(fmus, "Pendulum") | terminals(fmus, "Source")
    assert set(of_controller) == set(others) == {"loop", "reference"}
    for name, members in of_controller.items():
        for member, causality in members.items():
            assert {causality, others[name][member]} == {"input", "output"}


def test_a_prebuilt_binary_is_for_one_version(fmus: Path, tmp_path: Path) -> None:
    library = tmp_path / "Source.so"
    library.write_bytes(read(fmus, "Source", "binaries/x86_64-linux/Source.so"))
    options = ["export", "Source", "--fmi", "3.0", "--out", tmp_path / "out"]
    assert cargo_fmu(*options, "--binary", f"x86_64-linux={library}").returncode == 0
    again = tmp_path / "out" / "Source_fmi3.fmu"
    assert again.read_bytes() == fmu(fmus, "Source").read_bytes()
    message = refusal(*options, "--binary", f"linux64={library}")
    assert "cannot be used for FMI 3.0" in message
    with zipfile.ZipFile(fmus / "Source.fmu") as archive:
        library.write_bytes(archive.read("binaries/linux64/Source.so"))
    message = refusal(*options, "--binary", f"x86_64-linux={library}")
    assert "does not export the functions of FMI 3.0" in message
