"""SSP packages: conformance to the standard, and simulation in third-party importers."""

import re
import shutil
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from lxml import etree

from importers import by_ecos, by_fmpy, by_libcosim
from native import (
    LOOPS,
    RELAY,
    ROOT,
    in_c,
    read,
    refusal,
    replaced,
    run,
    simulate,
    with_units,
    write,
    write_system,
)
from needs import LIBTBB

SYSTEMS = ROOT / "examples" / "ssp"
NAMES = ["pid", "pid-rbf", "ipid-rbf", "supervised"]
STEP = 0.001

SCHEMAS = Path(fmpy.__file__).parent / "ssp" / "schema"
NS = {
    part: f"http://ssp-standard.org/SSP1/SystemStructure{name}"
    for part, name in [("ssd", "Description"), ("ssc", "Common"), ("ssv", "ParameterValues")]
} | {"oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"}

TEXT = "1 < 2 & 'é'"


@pytest.fixture(scope="module")
def packages(fmus: Path, variant: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the packages of the loops of the paper; returns their folder."""
    folder = tmp_path_factory.mktemp("packages")
    written = run("ssp", *(SYSTEMS / f"{name}.toml" for name in NAMES), "--out", folder, cwd=ROOT)
    assert (written.returncode, written.stderr) == (0, "")
    files = [line.split()[0] for line in written.stdout.splitlines()]
    assert files == [str(folder / f"{name}.ssp") for name in NAMES]
    return folder


@pytest.fixture(scope="module")
def relay(fmus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a package of FMUs with variables of every type and unusual units."""
    folder = tmp_path_factory.mktemp("relay")
    in_c(folder / "Relay.fmu", xml=replaced(RELAY, with_units("deg", "gon")), **{TEXT: "1"})
    start = {
        "gain": -1e-7, "u": 0.1, "add": -3, "invert": True, "shape": "square", "file": TEXT,
    }  # fmt: skip
    links = ["a & b.m -> b.n", "b.m -> a & b.n", "a & b.c -> b.b"]
    system = write_system(folder, {"a & b": start, "b": {}}, links, start=-0.5, order="parallel")
    written = run("ssp", system, "--out", folder, cwd=folder)
    assert written.returncode == 0, written.stderr
    return folder / "system.ssp"


@pytest.fixture(params=[*NAMES, "relay"])
def package(request: pytest.FixtureRequest, packages: Path) -> Path:
    """Return one of the packages."""
    if request.param == "relay":
        return request.getfixturevalue("relay")
    return packages / f"{request.param}.ssp"


def structure(package: Path) -> etree._Element:
    """Return the root of SystemStructure.ssd."""
    return etree.fromstring(read(package)["SystemStructure.ssd"])


def elements(root: etree._Element, path: str) -> list[etree._Element]:
    """Return the elements of a path such as ".//ssd:Component"."""
    return root.findall(path, NS)


def kind_of(element: etree._Element) -> tuple[str, dict[str, str]]:
    """Return name and attributes of the element with the type."""
    return etree.QName(element[0]).localname, dict(element[0].attrib)


# --- the standard ---------------------------------------------------------------------------------


def test_a_package_is_valid_and_contains_each_fmu_once(package, packages, fmus, variant):
    def check(schema: str, element: etree._Element) -> None:
        etree.XMLSchema(file=SCHEMAS / f"SystemStructure{schema}.xsd").assertValid(element)

    root = structure(package)
    check("Description", root)
    sets = elements(root, ".//ssv:ParameterSet")
    assert sets
    for parameters in sets:
        check("ParameterValues", parameters)
    with zipfile.ZipFile(package) as archive:
        assert archive.testzip() is None
        first, *names = archive.namelist()
        assert first == "SystemStructure.ssd"
        components = elements(root, ".//ssd:Component")
        assert sorted(names) == sorted({c.get("source") for c in components})
        for name in names:
            folder = fmus if package.parent == packages else package.parent
            file = variant if variant.name in name else folder / Path(name).name
            assert archive.read(name) == file.read_bytes()


def test_connectors_are_the_inputs_outputs_and_set_parameters_of_the_fmus(package, tmp_path):
    with zipfile.ZipFile(package) as archive:
        archive.extractall(tmp_path)
    root = structure(package)
    units = {u.get("name"): u[0].attrib for u in elements(root, "ssd:Units/ssc:Unit")}
    enumerations = {
        e.get("name"): [(item.get("name"), item.get("value")) for item in e]
        for e in elements(root, "ssd:Enumerations/ssc:Enumeration")
    }
    for component in elements(root, ".//ssd:Component"):
        model = fmpy.read_model_description(tmp_path / component.get("source"), validate=False)
        variables = {v.name: v for v in model.modelVariables}
        base_units = {u.name: u.baseUnit for u in model.unitDefinitions}
        connectors = elements(component, "ssd:Connectors/ssd:Connector")
        set_here = {p.get("name") for p in elements(component, ".//ssv:Parameter")}
        assert [c.get("name") for c in connectors] == [
            v.name
            for causality in ("input", "output", "parameter")
            for v in model.modelVariables
            if v.causality == causality and (causality != "parameter" or v.name in set_here)
        ]
        for element in connectors + elements(component, ".//ssv:Parameter"):
            variable = variables[element.get("name")]
            kind, attributes = kind_of(element)
            assert element.get("kind", variable.causality) == variable.causality
            assert kind == variable.type
            unit = variable.unit or (variable.declaredType and variable.declaredType.unit)
            if unit and (base := base_units[unit]):
                given = units[attributes["unit"]]
                for part in "kg m s A K mol cd rad factor offset".split():
                    default = 1 if part == "factor" else 0
                    assert float(given.get(part, default)) == float(getattr(base, part))
            else:
                assert "unit" not in attributes
            if kind == "Enumeration":
                items = [(i.name, str(i.value)) for i in variable.declaredType.items]
                assert enumerations[attributes["name"]] == items


def test_times_and_start_values_of_every_type_are_exact(relay):
    times = dict(structure(relay).find("ssd:DefaultExperiment", NS).attrib)
    assert times == {"startTime": "-0.5", "stopTime": "1.0"}
    first, second = elements(structure(relay), ".//ssd:Component")
    assert first.get("name") == "a___b"
    assert {p.get("name"): kind_of(p) for p in elements(first, ".//ssv:Parameter")} == {
        "add": ("Integer", {"value": "-3"}),
        "file": ("String", {"value": TEXT}),
        "gain": ("Real", {"value": "-1e-7"}),
        "invert": ("Boolean", {"value": "true"}),
        "shape": ("Enumeration", {"value": "square", "name": "Relay.Shape"}),
        "u": ("Real", {"value": "0.1", "unit": "deg"}),
    }
    assert elements(second, ".//ssv:Parameter") == []


def test_a_package_has_what_omsimulator_requires(package):
    """Its library opens identifiers only, and systems with a master only; see its `System.cpp`."""
    root = structure(package)
    system = root.find("ssd:System", NS)
    for element in (root, system, *elements(system, ".//ssd:Component")):
        assert re.fullmatch(r"[a-zA-Z][a-zA-Z0-9_]*", element.get("name"))
    annotation = system.find("ssd:Annotations/ssc:Annotation", NS)  # it reads the first
    assert annotation.get("type") == "org.openmodelica"
    information = annotation.find("oms:Annotations/oms:SimulationInformation", NS)
    (master,) = information.findall("oms:FixedStepMaster", NS)
    assert master.get("description") == "oms-ma"
    step = root.get("description").split()[2]
    assert master.get("stepSize") == information.get("fixedStepSize") == step
    assert float(step) == (STEP if system.get("name") != "system" else 0.25)


# --- the diagram ----------------------------------------------------------------------------------

Box = tuple[float, float, float, float]


def box(element: etree._Element) -> Box:
    """Return left, bottom, right and top."""
    return tuple(float(element.get(name)) for name in ("x1", "y1", "x2", "y2"))


def overlap(a: Box, b: Box) -> bool:
    """Return whether two boxes share more than an edge."""
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def test_the_diagram_shows_all_components_and_connectors_apart(package):
    root = structure(package)
    boxes, ends = {}, {}
    for component in elements(root, ".//ssd:Component"):
        name = component.get("name")
        boxes[name] = x1, y1, x2, y2 = box(component.find("ssd:ElementGeometry", NS))
        for connector in elements(component, ".//ssd:Connector"):
            at = connector.find("ssd:ConnectorGeometry", NS)
            x, y = float(at.get("x")), float(at.get("y"))
            side = {"input": x == 0, "output": x == 1, "parameter": y == 0}
            assert side[connector.get("kind")]
            assert 0 <= x <= 1
            assert 0 <= y <= 1
            ends[name, connector.get("name")] = x1 + x * (x2 - x1), y1 + y * (y2 - y1)
        assert len(set(ends.values())) == len(ends)
    for name, a in boxes.items():
        assert not any(overlap(a, b) for other, b in boxes.items() if other != name)


# --- other importers ------------------------------------------------------------------------------

STEPS = 6000
"""Long enough for the disturbances."""

OTHER_VALUES = {
    "controller": {
        "pid.kp": 250, "rbf.eta": 0.2, "rbf.alpha": 0.1, "u_max": 80.5,
        "previous_sample_terms": False,
    },
    "plant": {"m": 0.15, "l": 0.3},
    # Between two samples, since some importers accumulate the time
    "source": {
        "amplitude": 0.5, "disturbance.amplitude": 0.1, "disturbance.start": 4.0005,
        "disturbance.duration": 0.25,
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def results(packages: Path, fmus: Path, ssp_columns, tmp_path_factory) -> dict:
    """Simulate the largest loop, and one with other start values; return packages and results."""
    folder = tmp_path_factory.mktemp("other")
    text = (SYSTEMS / "pid-rbf.toml").read_text().replace("start = {", "# ")
    for name, values in OTHER_VALUES.items():
        start = ", ".join(f'"{key}" = {str(value).lower()}' for key, value in values.items())
        head = f'name = "{name}"\n'
        text = replaced(text, {head: f"{head}start = {{ {start} }}\n"})
    system = folder / "other.toml"
    system.write_text(text)
    written = run("ssp", system, "--fmus", fmus, "--out", folder)
    assert written.returncode == 0, written.stderr
    other = simulate(system, folder, "--fmus", fmus, "--stop", STEPS * STEP)
    assert other["controller.u"].max() == 80.5
    return {
        "supervised": (packages / "supervised.ssp", ssp_columns["supervised"]),
        "other values": (folder / "other.ssp", other),
    }


@pytest.mark.parametrize(
    "importer", [by_fmpy, pytest.param(by_ecos, marks=LIBTBB.mark), by_libcosim]
)
@pytest.mark.parametrize("name", ["supervised", "other values"])
def test_an_importer_equals_the_native_master_bit_for_bit(importer, name, results):
    package, ours = results[name]
    theirs = importer(package, STEP, STEPS)
    for column in ("plant.theta", "controller.u"):
        np.testing.assert_array_equal(theirs[column], ours[column][:STEPS])


# --- the loops of examples/ssp --------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_the_pendulum_stands_and_the_force_does_not_ring(name, ssp_columns):
    late = slice(len(ssp_columns[name]["time"]) // 2, None)
    assert np.all(np.abs(ssp_columns[name]["controller.e"][late]) < 3e-3)
    assert np.all(np.abs(np.diff(ssp_columns[name]["controller.u"][late])) < 0.01)


def test_parallel_order_delays_like_the_terms_of_the_previous_sample(fmus, tmp_path):
    options = ("--start", STEP, "--stop", 6)
    for name in ("pid", "pid-rbf"):
        parallel = simulate(SYSTEMS / f"{name}.toml", tmp_path, *options)
        sequential = simulate(LOOPS / f"{name}.toml", tmp_path, *options)
        np.testing.assert_array_equal(parallel["plant.theta"], sequential["plant.theta"])
    setting = "controller.previous_sample_terms=true"
    ringing = simulate(SYSTEMS / "pid-rbf.toml", tmp_path, *options, "--set", setting)
    assert np.max(np.abs(np.diff(ringing["controller.u"][3000:]))) > 1


def test_the_same_system_gives_the_same_bytes(packages, tmp_path):
    first = (packages / "supervised.ssp").read_bytes()
    written = run("ssp", SYSTEMS / "supervised.toml", "--out", tmp_path / "new/folder")
    assert written.returncode == 0, written.stderr
    assert (tmp_path / "new/folder/supervised.ssp").read_bytes() == first
    assert [path.name for path in (tmp_path / "new/folder").iterdir()] == ["supervised.ssp"]


# --- reading --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_a_package_gives_the_bits_of_its_system(name, packages, tmp_path):
    expected = simulate(SYSTEMS / f"{name}.toml", tmp_path, "--stop", 3)
    found = simulate(packages / f"{name}.ssp", tmp_path, "--stop", 3)
    assert list(found) == list(expected)
    for column, values in expected.items():
        np.testing.assert_array_equal(found[column], values)


def test_a_component_by_model_exchange_stays_one(fmus, tmp_path):
    fmu = f'name = "p", fmu = "{fmus}/Pendulum.fmu", start = {{ theta0 = 0.1 }}'
    system = tmp_path / "falls.toml"
    system.write_text(
        'stop = 0.5\nstep = 0.1\norder = "parallel"\n'
        f'component = [{{ interface = "model-exchange", {fmu} }}]'
    )
    assert run("ssp", system, "--out", tmp_path).returncode == 0
    expected, found = (simulate(system.with_suffix(end), tmp_path) for end in (".toml", ".ssp"))
    np.testing.assert_array_equal(found["p.theta"], expected["p.theta"])


NESTED, VALUES, MAPPING = (
    (ROOT / "tests" / "data" / "ssp" / name).read_text(encoding="utf-8")
    for name in ("SystemStructure.ssd", "values.ssv", "names.ssm")
)
"""The parts of a package with a system in a system."""

DEGREE = 0.017453292519943295
"""One degree [rad]."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the FMU of the nested system, from deg to rad."""
    folder = tmp_path_factory.mktemp("nested")
    in_c(folder / "Relay.fmu", xml=replaced(RELAY, with_units("deg", "rad")))
    return folder


def write_in_files(folder: Path, ending: str, fmu: str = "Relay.fmu") -> Path:
    """Write a package with the nested system in a file of its own."""
    head, outermost, before, system, inner = re.split("(<System name=.*>)", NESTED)
    inner, end, outer = inner.partition("</System>")
    connectors = inner[: inner.index("<ParameterBindings>")]
    of_type = {"ssp": "package", "ssd": "definition"}[ending]
    inner = f"{head}{system}{inner}{end}</SystemStructureDescription>"
    component = f'<Component name="inner" type="application/x-ssp-{of_type}" source="in.{ending}">'
    files = {"SystemStructure.ssd": inner, "resources/A relay.fmu": (folder / fmu).read_bytes()}
    part = write(folder / "in.ssp", files).read_bytes()
    structure = f"{head}{outermost}{before}{component}{connectors}</Component>{outer}"
    return write_nested(folder, structure, f"{ending}.ssp", **{"in.ssp": part, "in.ssd": inner})


def write_nested(folder: Path, structure=NESTED, name="nested.ssp", **parts: str | bytes) -> Path:
    """Write a package with the nested system."""
    files = {"SystemStructure.ssd": structure, "values.ssv": VALUES, "names.ssm": MAPPING}
    files["resources/A relay.fmu"] = (folder / "Relay.fmu").read_bytes()
    return write(folder / name, files | parts)


def test_a_nested_package_gives_the_bits_of_the_same_components_on_one_level(folder, tmp_path):
    for name, text in [
        ("Description", NESTED), ("ParameterValues", VALUES), ("ParameterMapping", MAPPING),
    ]:  # fmt: skip
        schema = etree.XMLSchema(file=SCHEMAS / f"SystemStructure{name}.xsd")
        schema.assertValid(etree.fromstring(text))
    start = {
        "a": {"gain": 0.25, "shape": "square"},
        "b": {"gain": 0.625, "add": 3, "invert": True},
        "c": {"u": 0.5 * (6.283185307179586 / DEGREE), "add": 3},
    }
    links = [
        {"from": "c.y", "to": "a.u", "factor": 2.0, "offset": 0.5},
        {"from": "a.y", "to": "b.u", "factor": 1 / DEGREE},
        {"from": "b.y", "to": "c.u", "factor": 1 / DEGREE * 3, "offset": 0.25},
    ]
    times = {"start": 0.5, "stop": 2.0, "step": 0.125}
    system = write_system(folder, start, links, order="parallel", **times)
    expected = simulate(system, tmp_path)
    assert np.ptp(expected["a.y"]) > 0

    package = write_nested(folder)
    with zipfile.ZipFile(package) as archive:
        archive.extractall(tmp_path)
    parts = (write_in_files(folder, ending) for ending in ("ssd", "ssp"))
    for file in (package, tmp_path / "SystemStructure.ssd", *parts):
        found = simulate(file, tmp_path, "--step", 0.125)
        names = ["time", *(name.removeprefix("inner.") for name in list(found)[1:])]
        assert names == list(expected)
        for name, values in zip(names, found.values(), strict=True):
            np.testing.assert_array_equal(values, expected[name])
    changed = simulate(package, tmp_path, "--step", 0.125, "--set", "inner.a.gain=2")
    assert not np.array_equal(changed["inner.a.y"], expected["a.y"])


def test_a_large_structure_is_read_within_limits(folder, tmp_path):
    """Larger than a model description may be, as it has the variables of several of them."""
    shutil.copy(folder / "Relay.fmu", tmp_path)
    structure = replaced(NESTED, {"resources/A%20relay.fmu": "Relay.fmu"})
    (tmp_path / "values.ssv").write_text(VALUES, encoding="utf-8")
    (tmp_path / "names.ssm").write_text(MAPPING, encoding="utf-8")
    file = tmp_path / "large.ssd"
    file.write_text(structure + " " * (65 << 20), encoding="utf-8")
    assert simulate(file, tmp_path, "--step", 0.125)["time"][-1] == 2
    file.write_text(structure + " " * (256 << 20), encoding="utf-8")
    assert "large.ssd is larger than 256 MB" in refusal(tmp_path, "simulate", file)


def test_connectors_that_feed_each_other_are_refused(folder, tmp_path):
    inside = '<Connection startElement="b" startConnector="y" endConnector="out"/>'
    outside = '<Connection startElement="c" startConnector="y" endElement="inner"'
    structure = replaced(NESTED, {
        inside: '<Connection startConnector="in" endConnector="out"/>',
        outside: '<Connection startElement="inner" startConnector="out" endElement="inner"',
    })  # fmt: skip
    mapping = replaced(MAPPING, {'target="inner.k"': 'target="inner.in"'})
    package = write_nested(folder, structure, **{"names.ssm": mapping})
    assert "inner.in feeds itself" in refusal(tmp_path, "simulate", package)


def test_a_source_outside_of_a_package_is_refused(folder, tmp_path):
    structure = replaced(NESTED, {"resources/A%20relay.fmu": "../Relay.fmu"})
    package = write_nested(folder, structure)
    text = refusal(tmp_path, "simulate", package)
    assert text.startswith(f"{package}: ")
    assert "leaves its folder" in text


def test_errors_name_the_file_in_a_package(folder, tmp_path):
    content = (folder / "Relay.fmu").read_bytes()
    (tmp_path / "Relay.fmu").write_bytes(content)
    (tmp_path / "broken.fmu").write_bytes(content[:1000])
    package = write_in_files(tmp_path, "ssp", "broken.fmu")
    text = refusal(tmp_path, "simulate", package)
    assert f"component inner.a: {package}/in.ssp/resources/A relay.fmu cannot be used" in text
