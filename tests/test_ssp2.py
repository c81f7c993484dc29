"""SSP 2.0: types of FMI 3.0, and arrays."""

import re
from collections.abc import Mapping
from pathlib import Path

import fmpy
import numpy as np
import pytest
from lxml import etree

from native import SOURCES, in_c, read, refusal, replaced, run, simulate, write_system

SCHEMAS = Path(fmpy.__file__).parent / "ssp" / "schema"
VECTOR = (SOURCES / "vector.xml").read_text(encoding="utf-8")

HEAD = """<SystemStructureDescription version="2.0" name="arrays"
  xmlns="http://ssp-standard.org/SSP1/SystemStructureDescription"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
  xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">"""

SIZED = '<ssc:Float64/><ssc:Dimension size="3"/>'

SYSTEM = f"""{HEAD}
  <System name="outer">
    <Elements>
      <Component name="a" source="Vector.fmu">
        <Connectors>
          <Connector name="w" kind="output">{SIZED}</Connector>
          <Connector name="n" kind="structuralParameter"><ssc:UInt64/></Connector>
        </Connectors>
        <ParameterBindings><ParameterBinding><ParameterValues>
          <ssv:ParameterSet version="2.0" name="a"><ssv:Parameters>
            <ssv:Parameter name="c">
              <ssv:Float64 value="0.5 1.5&#10;2.5"/><ssc:Dimension size="3"/></ssv:Parameter>
            <ssv:Parameter name="big"><ssv:Int64 value="9007199254740993"/></ssv:Parameter>
            <ssv:Parameter name="c[2]"><ssv:Float32 value="4"/></ssv:Parameter>
          </ssv:Parameters></ssv:ParameterSet>
        </ParameterValues></ParameterBinding></ParameterBindings>
      </Component>
      <System name="inner">
        <Connectors><Connector name="in" kind="input">{SIZED}</Connector>
          <Connector name="k" kind="parameter">{SIZED}</Connector></Connectors>
        <Elements>
          <Component name="b" source="Vector.fmu">
            <Connectors>
              <Connector name="a" kind="input"><ssc:Float64/>
                <ssc:Dimension sizeConnector="n"/></Connector>
              <Connector name="c" kind="parameter"><ssc:Float64/><ssc:Dimension/></Connector>
              <Connector name="u" kind="input"/>
            </Connectors>
          </Component>
        </Elements>
        <Connections>
          <Connection startConnector="in" endElement="b" endConnector="a"/>
          <Connection startConnector="k" endElement="b" endConnector="c">
            <ssc:LinearTransformation factor="2"/></Connection>
        </Connections>
      </System>
      <Component name="d" source="Vector.fmu">
        <Connectors>
          <Connector name="u" kind="input"/>
          <Connector name="a" kind="input">{SIZED}</Connector>
        </Connectors>
      </Component>
    </Elements>
    <Connections>
      <Connection startElement="a" startConnector="w" endElement="inner" endConnector="in"/>
      <Connection startElement="a" startConnector="w" startIndices="3"
        endElement="d" endConnector="u"/>
      <Connection startElement="d" startConnector="a" startIndices="2"
        endElement="a" endConnector="w" endIndices="1"/>
    </Connections>
    <ParameterBindings><ParameterBinding><ParameterValues>
      <ssv:ParameterSet version="2.0" name="k"><ssv:Parameters>
        <ssv:Parameter name="inner.k">
          <ssv:Real value="1 2 3"/><ssc:Dimension size="3"/></ssv:Parameter>
      </ssv:Parameters></ssv:ParameterSet>
    </ParameterValues></ParameterBinding></ParameterBindings>
  </System>
  <DefaultExperiment startTime="0" stopTime="1"/>
</SystemStructureDescription>
"""

TIMES = {"order": "parallel", "step": 0.25}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with FMUs of FMI 3.0 with arrays and rare types."""
    folder = tmp_path_factory.mktemp("ssp2")
    for name in ("Vector", "Sums"):
        in_c(folder / f"{name}.fmu")
    (folder / "Vector").mkdir()
    return folder


def structure(folder: Path, changes: Mapping[str, str]) -> Path:
    """Write the structure with some parts replaced."""
    file = folder / "SystemStructure.ssd"
    file.write_text(replaced(SYSTEM, changes), encoding="utf-8")
    return file


def same(found: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray]) -> None:
    """Check that all columns are equal, whatever the nested system."""
    found = {name.removeprefix("inner."): column for name, column in found.items()}
    assert sorted(found) == sorted(expected)
    for name, column in expected.items():
        np.testing.assert_array_equal(found[name], column)


def test_arrays_are_connected_and_set_like_their_elements(folder, tmp_path):
    start = {
        "a": {"c": [0.5, 4.0, 2.5], "big": 9007199254740993},
        "b": {"c": [2.0, 4.0, 6.0]},
        "d": {},
    }
    links = [f"a.w[{i}] -> b.a[{i}]" for i in (1, 2, 3)]
    links += ["a.w[3] -> d.u", "a.w[1] -> d.a[2]"]
    expected = simulate(write_system(folder, start, links, "Vector", **TIMES), tmp_path)
    # w integrates c + a; in parallel order, a is w before the step.
    np.testing.assert_array_equal(expected["a.w[2]"], 4.0 * expected["time"])
    assert expected["b.w[3]"][-1] > 6.0
    assert expected["d.w[2]"][-1] > 2.0
    same(simulate(structure(folder, {}), tmp_path, "--step", 0.25), expected)


def test_an_array_of_an_outer_system_replaces_elements_of_an_inner_one(folder, tmp_path):
    outer = '<ssv:Parameter name="inner.k">'
    array = '<ssv:Float64 value="9 8 7"/><ssc:Dimension size="3"/>'
    replacing = f'<ssv:Parameter name="a.c">{array}</ssv:Parameter>{outer}'
    columns = simulate(structure(folder, {outer: replacing}), tmp_path, "--step", 0.25)
    assert [columns[f"a.w[{i}]"][-1] for i in (1, 2, 3)] == [9.0, 8.0, 7.0]


def test_every_type_of_fmi_3_is_read(folder, tmp_path):
    links = ["a.y -> b.x", "a.c -> b.b"]
    start = {"a": {"u": [7, 0, 255], "x": 0.1, "s": ["a b", ""]}, "b": {}}
    expected = simulate(write_system(folder, start, links, "Sums", **TIMES), tmp_path)
    ends = re.findall(r"(\w)\.(\w) -> (\w)\.(\w)", " ".join(links))
    connections = "".join(
        f'<Connection startElement="{a}" startConnector="{y}" endElement="{b}" endConnector="{u}"/>'
        for a, y, b, u in ends
    )
    file = folder / "types.ssd"
    file.write_text(
        f"""{HEAD}<System name="types"><Elements>
        <Component name="a" source="Sums.fmu">
          <Connectors><Connector name="y" kind="output"><ssc:Float32/></Connector>
            <Connector name="c" kind="output"><ssc:Boolean/></Connector>
            <Connector name="bytes" kind="output"><ssc:Binary/></Connector>
            <Connector name="largest" kind="output"><ssc:UInt64/></Connector></Connectors>
          <ParameterBindings><ParameterBinding><ParameterValues>
            <ssv:ParameterSet version="2.0" name="a"><ssv:Parameters>
              <ssv:Parameter name="u"><ssv:UInt8 value="7 0 255"/><ssc:Dimension size="3"/>
              </ssv:Parameter>
              <ssv:Parameter name="x"><ssv:Float32 value="0.1"/></ssv:Parameter>
              <ssv:Parameter name="s"><ssv:String><ssv:Value value="a b"/><ssv:Value value=""/>
                </ssv:String><ssc:Dimension size="2"/></ssv:Parameter>
            </ssv:Parameters></ssv:ParameterSet>
          </ParameterValues></ParameterBinding></ParameterBindings></Component>
        <Component name="b" source="Sums.fmu">
          <Connectors><Connector name="x" kind="input"><ssc:Float32/></Connector>
            <Connector name="b" kind="input"><ssc:Boolean/></Connector></Connectors></Component>
        </Elements><Connections>{connections}</Connections></System>
        <DefaultExperiment stopTime="1"/></SystemStructureDescription>""",
        encoding="utf-8",
    )
    same(simulate(file, tmp_path, "--step", 0.25), expected)
    assert expected["a.n"][-1] == 7 + 100 * 255


INNER = 'name="in" kind="input"><ssc:Float64/><ssc:Dimension size="3"/>'


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({INNER: replaced(INNER, {"3": "2"})},
         "inner.in (2) and inner.b.a (3) are connected, but their dimensions differ"),
        ({INNER: 'name="in" kind="input">'},
         "inner.in (a scalar) and inner.b.a (3) are connected, but their dimensions differ"),
        ({SIZED + '</Connector>\n          <Connector name="n"':
          SIZED.replace("3", "4") + '</Connector>\n          <Connector name="n"'},
         "the dimensions of a.w are 4, but 3 in its FMU"),
        ({'startIndices="3"': 'startIndices="4"'},
         'a.w (3) has no element with the indices "4"'),
        ({'startIndices="3"': 'startIndices="1 1"'},
         'a.w (3) has no element with the indices "1 1"'),
        ({INNER: replaced(INNER, {"3": "0"})},
         'the connector inner.in: the size "0" of a Dimension is invalid'),
        ({"<ssc:UInt64/>": '<ssc:Clock intervalVariability="triggered"/>'},
         "the connector a.n is a Clock, but a UInt64 in its FMU"),
        ({"<ssc:UInt64/>": '<ssc:UInt64/><Clock name="tick"/>'},
         "the connector a.n belongs to the clock tick, but not in its FMU"),
        ({'value="1 2 3"': 'value="1 2"'}, "the number of values is 2, expected 3"),
        ({'Int64 value="9007199254740993"': 'Int64 value="1 2"'},
         '"1 2" is not of the type ssv:Int64'),
        ({'"2.0" name="arrays"': '"2.1-beta" name="arrays"'},
         'version "2.1-beta" of SSP is not supported, expected 1.0 or 2.0'),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_named(folder, changes, message):
    text = refusal(folder, "simulate", structure(folder, changes))
    assert message in text


def test_arrays_of_a_size_that_a_parameter_sets_are_connected(folder, tmp_path):
    binding = '<ssv:Parameter name="n"><ssv:UInt64 value="2"/></ssv:Parameter>'
    parameters = f"""<ParameterBindings><ParameterBinding><ParameterValues>
      <ssv:ParameterSet version="2.0" name="n"><ssv:Parameters>{binding}</ssv:Parameters>
      </ssv:ParameterSet></ParameterValues></ParameterBinding></ParameterBindings>"""
    sized = '<ssc:Float64/><ssc:Dimension sizeConnector="n"/></Connector>'
    file = folder / "sizes.ssd"
    file.write_text(
        f"""{HEAD}<System name="sizes"><Elements>
        <Component name="a" source="Vector.fmu">
          <Connectors><Connector name="w" kind="output">{sized}</Connectors>{parameters}</Component>
        <Component name="b" source="Vector.fmu">
          <Connectors><Connector name="a" kind="input">{sized}</Connectors>{parameters}</Component>
        </Elements><Connections><Connection startElement="a" startConnector="w"
          endElement="b" endConnector="a"/></Connections></System>
        <DefaultExperiment stopTime="1"/></SystemStructureDescription>""",
        encoding="utf-8",
    )
    start, links = {"n": 2}, [f"a.w[{i}] -> b.a[{i}]" for i in (1, 2)]
    system = write_system(folder, {"a": start, "b": start}, links, "Vector", **TIMES)
    same(simulate(file, tmp_path, "--step", 0.25), simulate(system, tmp_path))


# --- writing --------------------------------------------------------------------------------------

NS = {
    part: f"http://ssp-standard.org/SSP1/SystemStructure{name}"
    for part, name in [("ssd", "Description"), ("ssc", "Common"), ("ssv", "ParameterValues")]
}


def written(system: Path) -> Path:
    """Write the package of a system, without a warning."""
    result = run("ssp", system, "--out", system.parent / "out", cwd=system.parent)
    assert (result.returncode, result.stderr) == (0, "")
    return system.parent / "out" / "system.ssp"


def root(package: Path) -> etree._Element:
    """Return the root of its structure."""
    return etree.fromstring(read(package)["SystemStructure.ssd"])


def test_a_package_of_fmi_3_gives_the_bits_of_its_system(folder, tmp_path):
    values = {"A": [[0.1, -2, 3], [4, 5, 1e300]], "ws": [1, 2**63 + 1], "i": -5, "m[2,1]": 0.7}
    links = ["a.yws[1] -> b.ws[2]", "a.yA[2,3] -> b.m[1,2]", "a.yi -> b.i", "a.ye -> b.e"]
    links += [{"from": "a.ym[2,1]", "to": "b.m[2,3]", "factor": 3.0, "offset": 0.25}]
    start = {"a": values | {"e": "linear"}, "b": {"ws[1]": 2**64 - 1}}
    in_c(folder / "Echo.fmu")
    system = write_system(folder, start, links, "Echo", **TIMES)
    expected = simulate(system, tmp_path)
    assert expected["b.ym[2,3]"][-1] == 3 * 0.7 + 0.25
    assert expected["b.yws[1]"][-1] == 2.0**64
    result = run("ssp", system, "--out", folder / "out", cwd=folder)
    assert (result.returncode, "e, an enumeration" in result.stderr) == (0, True)
    same(simulate(folder / "out" / "system.ssp", tmp_path), expected)


def test_a_package_states_version_types_and_dimensions(folder, tmp_path):
    start = {"a": {"s": ["a b", ""], "u[2]": 7, "u[3]": 1, "x": 0.1}, "b": {}}
    links = ["a.n -> b.u[2]", "a.y -> b.x"]
    system = write_system(folder, start, links, "Sums", **TIMES)
    expected = simulate(system, tmp_path)
    package = written(system)
    same(simulate(package, tmp_path), expected)
    structure = root(package)
    sets = structure.findall(".//ssv:ParameterSet", NS)
    assert [element.get("version") for element in (structure, *sets)] == ["2.0", "2.0"]

    def shown(element: etree._Element) -> tuple[str, list[str]]:
        sizes = [d.get("size") for d in element.findall("ssc:Dimension", NS)]
        return etree.QName(element[0]).localname, sizes

    component = structure.find(".//ssd:Component", NS)
    connectors = component.findall("ssd:Connectors/ssd:Connector", NS)
    assert {c.get("name"): shown(c) for c in connectors} == {
        "u": ("UInt8", ["3"]), "x": ("Float32", []), "b": ("Boolean", []),
        "n": ("Int64", []), "y": ("Float32", []), "c": ("Boolean", []),
        "k": ("Int16", ["2", "2"]), "bytes": ("Binary", []), "large": ("Int64", []),
        "largest": ("UInt64", []), "shape": ("Enumeration", []), "texts": ("String", ["3"]),
        "s": ("String", ["2"]),
    }  # fmt: skip
    parameters = {p.get("name"): p for p in component.findall(".//ssv:Parameter", NS)}
    assert {name: shown(p) for name, p in parameters.items()} == {
        "s": ("String", ["2"]), "u": ("UInt8", ["3"]), "x": ("Float32", []),
    }  # fmt: skip
    # The first has the start value of the FMU.
    assert parameters["u"][0].get("value") == "1 7 1"
    texts = [value.get("value") for value in parameters["s"].findall("ssv:String/ssv:Value", NS)]
    assert texts == ["a b", ""]
    ends = [dict(c.attrib) for c in structure.findall(".//ssd:Connection", NS)]
    assert [(end.get("startIndices"), end.get("endIndices")) for end in ends] == [
        (None, "2"), (None, None),
    ]  # fmt: skip


def test_a_package_keeps_the_size_that_a_structural_parameter_sets(folder, tmp_path):
    start = {"n": 5, "c": [1.0, 2.0, 3.0, 4.0, 5.0]}
    links = [f"a.w[{i}] -> b.a[{6 - i}]" for i in range(1, 6)]
    changes = {"a": start, "b": start | {"a": [0.0] * 5}}
    system = write_system(folder, changes, links, "Vector", **TIMES)
    expected = simulate(system, tmp_path)
    assert "b.w[5]" in expected
    package = written(system)
    same(simulate(package, tmp_path), expected)
    kinds = [c.get("kind") for c in root(package).findall(".//ssd:Connector[@name='n']", NS)]
    assert kinds == ["structuralParameter"] * 2


def test_a_package_of_scalars_of_fmi_2_types_is_of_version_1(folder, tmp_path):
    xml = re.sub(r".*(Dimension|Int64).*\n", "", VECTOR)
    xml = re.sub(r'.*(<Output|<InitialUnknown) valueReference="1".*\n', "", xml)
    in_c(folder / "Vector" / "Vector.fmu", xml=xml)
    system = write_system(
        folder / "Vector", {"a": {"u": 0.5}, "b": {}}, ["a.y -> b.u"], "Vector", **TIMES
    )
    package = written(system)
    structure = root(package)
    etree.XMLSchema(file=SCHEMAS / "SystemStructureDescription.xsd").assertValid(structure)
    assert structure.get("version") == "1.0"
    found = simulate(package, tmp_path)
    np.testing.assert_array_equal(found["a.y"], 1.0)
