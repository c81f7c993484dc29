"""`cargo fmu validate` on FMUs of FMI 3.0, valid and broken."""

import json
import re
import subprocess
from pathlib import Path

import fmpy
import pytest
from lxml import etree

from pendulum_fmus.project import ROOT
from test_validate import N, cargo_fmu, check, findings, neighbours, read, write

FULL = (ROOT / "fuzz" / "corpus" / "full3.xml").read_text()

TERMINALS = """<?xml version="1.0" encoding="UTF-8"?>
<fmiTerminalsAndIcons fmiVersion="3.0">
  <GraphicalRepresentation>
    <CoordinateSystem x1="-100" y1="-100" x2="100" y2="100" suggestedScalingFactorTo_mm="0.1"/>
    <Icon x1="-50" y1="-50" x2="50" y2="50"/>
    <Annotations>
      <Annotation type="a"/>
    </Annotations>
  </GraphicalRepresentation>
  <Terminals>
    <Terminal name="a" matchingRule="plug" terminalKind="k" description="d">
      <TerminalMemberVariable variableName="y" memberName="f" variableKind="inflow">
        <Annotations>
          <Annotation type="a"/>
        </Annotations>
      </TerminalMemberVariable>
      <TerminalMemberVariable variableName="u[1,2].a" memberName="s" variableKind="signal"/>
      <TerminalStreamMemberVariable inStreamMemberName="h" outStreamMemberName="g"
        inStreamVariableName="u[1,2].a" outStreamVariableName="y"/>
      <Terminal name="a" matchingRule="sequence">
        <TerminalMemberVariable variableName="w16" variableKind="signal"/>
      </Terminal>
      <TerminalGraphicalRepresentation defaultConnectionColor="255 255 0" x1="-1" y1="-1"
        defaultConnectionStrokeSize="0.5" x2="1" y2="1" iconBaseName="plug"/>
    </Terminal>
  </Terminals>
  <Annotations>
    <Annotation type="a"/>
  </Annotations>
</fmiTerminalsAndIcons>
"""

BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="Full" platform="x86_64-linux" description="d">
    <SourceFileSet name="s" language="C99" compiler="gcc" compilerOptions="-O2">
      <SourceFile name="full.c">
        <Annotations>
          <Annotation type="a"/>
        </Annotations>
      </SourceFile>
      <PreprocessorDefinition name="N" optional="true" value="1" description="d">
        <Option value="1" description="d"/>
        <Annotations>
          <Annotation type="a"/>
        </Annotations>
      </PreprocessorDefinition>
      <IncludeDirectory name="include"/>
    </SourceFileSet>
    <Library name="m" version="&gt;=1" external="true" description="d"/>
    <Annotations>
      <Annotation type="a"/>
    </Annotations>
  </BuildConfiguration>
  <BuildConfiguration modelIdentifier="Full">
    <SourceFileSet>
      <SourceFile name="full.c"/>
    </SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""

MODEL_FILE = "modelDescription.xml"
TERMINALS_FILE = "terminalsAndIcons/terminalsAndIcons.xml"
BUILD_FILE = "sources/buildDescription.xml"

FILES = {
    MODEL_FILE: FULL,
    TERMINALS_FILE: TERMINALS,
    "terminalsAndIcons/plug.png": "",
    BUILD_FILE: BUILD,
    "sources/full.c": "",
    "documentation/licenses/license.txt": "",
    "extra/org.example/data": "",
}
"""The files of a valid FMU with every element of the schemas."""


def fmu(folder: Path, changes: dict[str, str | None], name: str = "x.fmu") -> Path:
    """Write an FMU with other contents of some files, or without them if `None`."""
    files = {**FILES, **changes}
    content = {name: text.encode() for name, text in files.items() if text is not None}
    return write(folder / name, content)


def test_an_fmu_with_every_element_has_no_findings(tmp_path: Path) -> None:
    assert findings(fmu(tmp_path, {})) == []


SCHEMA_RULES = {
    "fmi-version",
    "root-element",
    "no-text",
    "attribute-required",
    "attribute-value",
    "attribute-known",
    "element-known",
    "element-order",
    "element-once",
    "element-required",
}

SCHEMAS = [
    ("fmi3ModelDescription.xsd", MODEL_FILE, FULL),
    ("fmi3TerminalsAndIcons.xsd", TERMINALS_FILE, TERMINALS),
    ("fmi3BuildDescription.xsd", BUILD_FILE, BUILD),
]


@pytest.mark.parametrize(("schema", "file", "text"), SCHEMAS, ids=[s[0] for s in SCHEMAS])
def test_the_schemas_are_those_of_the_standard(
    schema: str, file: str, text: str, tmp_path: Path
) -> None:
    """Compare the verdicts of lxml and of the validator on documents with one change."""
    folder = Path(fmpy.__file__).parent / "schema" / "fmi3"
    reference = etree.XMLSchema(file=str(folder / schema))
    assert reference.validate(etree.fromstring(text.encode()))
    valid = {}
    for index, xml in enumerate(neighbours(text)):
        path = fmu(tmp_path, {file: xml}, f"{index}.fmu")
        valid[str(path)] = (reference.validate(etree.fromstring(xml)), xml)
    verdicts = [verdict for verdict, _ in valid.values()]
    assert min(verdicts.count(True), verdicts.count(False)) > 20
    output = cargo_fmu("validate", "--no-run", "--format", "json", *valid).stdout
    for report in json.loads(output)["files"]:
        verdict, xml = valid[report["file"]]
        found = [rule for rule in report["rules"] if rule["id"] in SCHEMA_RULES]
        assert verdict == (not found), (found, xml)


MODEL_MUTATIONS = [
    # old text, new text, part of the finding
    ("missing", ' modelName="Full"', "", "no attribute modelName", "FMI 3.0.2, section 2.4"),
    ("guid", "instantiationToken=", 'guid="" instantiationToken=', '"guid"', "FMI 3.0"),
    ("token", 'instantiationToken="{0}"', 'instantiationToken=""', "instantiationToken is empty"),
    ("identifier", 'modelIdentifier="Full"', 'modelIdentifier="a b"', "C identifier"),
    ("spelling", "needsExecutionTool", "canGetAndSetFMUstate", "does not define", "warning"),
    ("flags", 'canGetAndSetFMUState="true"', "", "canSerializeFMUState is true"),
    ("updates", 'providesIntermediateUpdate="true"', "", "canReturnEarlyAfterIntermediateUpdate"),
    ("internal step", '"1e-3"', '"0"', "fixedInternalStepSize is 0"),
    ("unit twice", 'Unit name="N"', 'Unit name="rad"', 'unit "rad" is defined twice'),
    ("inverse", 'inverse="true"', 'inverse="true" offset="1"', "offset of an inverse unit is 1"),
    ("unit", 'unit="N" start', 'unit="lbf" start', 'unit "lbf" is not defined'),
    ("unit of type", 'name="Force" unit="N"', 'name="Force" unit="lbf"', 'unit "lbf"'),
    ("display unit", 'same" displayUnit="deg"', 'same" displayUnit="gon"', 'display unit "gon"'),
    ("type", 'declaredType="Count"', 'declaredType="Number"', '"Number" is not defined'),
    ("type of type", 'declaredType="Count"', 'declaredType="U32"', "expected Int32"),
    ("float of type", 'declaredType="Angle"', 'declaredType="Force"', "expected Float64"),
    ("item value", 'name="right" value="2"', 'name="right" value="1"', "value 1"),
    ("item start", 'max="2" start="2"', 'max="3" start="3"', "value of an item"),
    ("item name", 'name="right"', 'name="left"', 'item "left" is defined twice'),
    ("type name", 'EnumerationType name="Way"', 'EnumerationType name="z"', "a type has the same"),
    ("experiment", 'stopTime="1"', 'stopTime="0"', "after startTime"),
    ("start of array", 'start="1 2 3 4 5 6"', 'start="1 2 3"', "3 start values, expected 1 or 6"),
    ("start of scalar", 'start="0.5"', 'start="0.5 1"', "2 start values, expected 1"),
    ("start of texts", '<Start value=""/>', '<Start/><Start/>', "3 start values, expected 1 or 2"),
    ("start of bytes", 'maxSize="9"', 'maxSize="1"', "2 bytes, expected at most maxSize = 1"),
    ("bound", 'max="5" start="3"', 'max="5" start="7"', "start is 7"),
    ("bound of byte", 'quantity="q" start="-128"', 'quantity="q" start="-129"', "-128 to 127"),
    ("NaN", 'start="1 2 3 4 5 6"', 'start="1 2 NaN 4 5 6"', "start is NaN", "warning"),
    ("dimension", '<Dimension start="3"/>', "<Dimension/>", "neither start nor valueReference"),
    ("two sizes", '<Dimension start="3"/>', '<Dimension start="3" valueReference="5"/>', "both"),
    ("no size", '<Dimension start="3"/>', '<Dimension start="0"/>', "size of the Dimension is 0"),
    ("size", '<Dimension valueReference="5"/>', '<Dimension valueReference="7"/>', "a UInt64 that"),
    ("no start size", 'max="9" start="2"', 'max="9" start="0"', "size of the Dimension is 0"),
    ("structural", 'max="9" start="2"/>', 'max="9" start="2"><Dimension start="1"/></UInt64>',
     "the structural parameter has a Dimension"),
    ("structural start", 'max="9" start="2"', 'max="9"', "it has no start"),
    ("combination", 'causality="structuralParameter" variability="fixed"',
     'causality="structuralParameter" variability="discrete"',
     "causality structuralParameter and variability discrete"),
    ("input", 'causality="input" variability="discrete"', 'causality="input" variability="fixed"',
     "causality input and variability fixed", "FMI 3.0.2, section 2.4.7.4"),
    ("initial of input", 'causality="input" canH', 'causality="input" initial="approx" canH',
     "initial is approx"),
    ("input start", 'unit="N" start="0"', 'unit="N"', "it has no start"),
    ("start", '<Float64 name="z"', '<Float64 start="0" name="z"', "it has a start"),
    ("continuous", '<Boolean name="flag" valueReference="15" causality="local" variability="const',
     '<Boolean name="flag" valueReference="15" causality="local" variability="continuous" o="',
     "variability is continuous"),
    ("independent", 'causality="independent" variability="continuous"', "", "exactly one"),
    ("two independent", '<Float64 name="z" valueReference="21"',
     '<Float64 name="z" valueReference="21" causality="independent"', "it is independent like"),
    ("reference", 'name="z" valueReference="21"', 'name="z" valueReference="4"',
     '"y" has the value reference 4, too'),
    ("name", 'name="z"', 'name="y"', "two variables have the name"),
    ("name of alias", 'Alias name="phi"', 'Alias name="y"', "two variables have the name"),
    ("structured", 'Alias name="w16"', 'Alias name="w-16"', "not structured"),
    ("derivative name", 'name="i64"', 'name="der(n)"', "expected a Float32 or Float64, not Int64"),
    ("derivative", 'derivative="1"', 'derivative="99"', "derivative is 99"),
    ("derivative of itself", 'derivative="1"', 'derivative="2"', 'derivative of "der(x)", exp'),
    ("derivative size", 'derivative="1"/>', 'derivative="1"><Dimension start="2"/></Float64>',
     'derivative of "x", expected the same dimensions'),
    ("derivative of", 'derivative="1"', 'derivative="7"', 'derivative of "n"'),
    ("several sets", '<Float64 name="z"',
     '<Float64 canHandleMultipleSetPerTimeInstant="1" name="z"', "only for inputs"),
    ("reinit", '<Float64 name="z"', '<Float64 reinit="true" name="z"', "only for states"),
    ("update", '<Float32 name="v"', '<Float32 intermediateUpdate="true" name="v"',
     "intermediateUpdate = true, expected it only for continuous"),
    ("clock", 'Clock name="clock" valueReference="18" causality="input"',
     'Clock name="clock" valueReference="18" causality="parameter"', "the clock has causality"),
    ("clocked", '"xd" valueReference="19" variability="discrete"',
     '"xd" valueReference="19" variability="continuous"', "clocked with variability continuous"),
    ("clocks", 'clocks="18" previous', 'clocks="18 7" previous', "clocks has 7"),
    ("empty clocks", 'clocks="18" previous', 'clocks="" previous', "clocks is empty"),
    ("known", 'dependencies="1 3"', 'dependencies="1 21"', 'has "z", which is computed', "warning"),
    ("initial known", 'dependencies="6" dep', 'dependencies="2" dep', "which is computed"),
    ("no clocks", ' clocks="18" previous', " previous", "only for discrete variables with clocks"),
    ("previous", 'previous="20"', 'previous="4"', "previous is 4"),
    ("previous itself", 'previous="20"', 'previous="19"', "previous is 19"),
    ("interval", 'intervalDecimal="1" shiftDecimal', 'intervalDecimal="0" shiftDecimal',
     "intervalDecimal is 0"),
    ("shift", 'shiftDecimal="0"', 'shiftDecimal="-1"', "shiftDecimal is -1, expected 0 or more"),
    ("triggered", 'intervalVariability="constant"', 'intervalVariability="triggered"',
     "only for periodic clocks"),
    ("constant", 'intervalDecimal="1" ', "", "no intervalDecimal, expected one"),
    ("shift alone", 'intervalCounter="10" ', "", "shiftCounter and no intervalCounter"),
    ("fraction", 'supportsFraction="true"', "", "supportsFraction = true with it"),
    ("resolution", 'resolution="10" ', "", "expected a resolution"),
    ("event mode", 'hasEventMode="true"', "", "expected hasEventMode = true"),
    ("output clock", '"clock" valueReference="18" causality="input"',
     '"clock" valueReference="18" causality="output"', "the output has a priority"),
    ("tunable clock", '"clock" valueReference="18" causality="input" variability="discrete"',
     '"clock" valueReference="18" variability="tunable"', "tunable, expected discrete"),
    ("no output", '<Output valueReference="4"', '<Output valueReference="3"', "not in Output of"),
    ("output", '<Output valueReference="4"', '<Output valueReference="3"', "expected outputs only"),
    ("unknown", '<Output valueReference="4"', '<Output valueReference="99"',
     "Output has the value reference 99"),
    ("unknown twice", "<ClockedState",
     '<ContinuousStateDerivative valueReference="2"/><ClockedState', "value reference 2 twice"),
    ("dependency", 'dependencies="1 3"', 'dependencies="1 98"', "dependencies has 98"),
    ("dependency kinds", '"dependent fixed"', '"dependent"', "1 items, expected 2"),
    ("initial kinds", 'dependenciesKind="constant"', 'dependenciesKind="tunable"',
     "dependent or constant"),
    ("no derivative", 'derivative="1"', "", "the attribute derivative"),
    ("state", 'causality="local" variability="continuous" initial="exact"',
     'causality="input" variability="continuous" initial="exact"', "the state has causality input"),
    ("clocked state", 'previous="20"', "", "clocks and previous"),
    ("indicator", '<EventIndicator valueReference="21"', '<EventIndicator valueReference="7"',
     "expected a continuous Float32 or Float64"),
    ("initial unknown", '<InitialUnknown valueReference="2"/>', "", "not in InitialUnknown of"),
    ("too much", '<InitialUnknown valueReference="2"/>',
     '<InitialUnknown valueReference="2"/><InitialUnknown valueReference="21"/>', "warning",
     "it is in InitialUnknown of"),
]  # fmt: skip


@pytest.mark.parametrize("mutation", MODEL_MUTATIONS, ids=[m[0] for m in MODEL_MUTATIONS])
def test_every_rule_for_models_finds_its_violation(
    mutation: tuple[str, ...], tmp_path: Path
) -> None:
    _, old, new, *expected = mutation
    assert old in FULL
    check(findings(fmu(tmp_path, {MODEL_FILE: FULL.replace(old, new)})), *expected)


def test_an_fmu_has_an_interface_type(tmp_path: Path) -> None:
    start, end = FULL.index("  <ModelExchange"), FULL.index("  <UnitDefinitions>")
    found = findings(fmu(tmp_path, {MODEL_FILE: FULL[:start] + FULL[end:]}))
    check(found, "it has no interface type", "FMI 3.0.2, section 2.4.1")


def test_input_clocks_have_a_priority_in_scheduled_execution(tmp_path: Path) -> None:
    xml = FULL.replace(' priority="1"', "")
    check(findings(fmu(tmp_path, {MODEL_FILE: xml})), "it has no priority")
    xml = xml.replace('  <ScheduledExecution modelIdentifier="Full"/>\n', "")
    assert findings(fmu(tmp_path, {MODEL_FILE: xml})) == []


TERMINAL_MUTATIONS = [
    ("version", 'fmiVersion="3.0"', 'fmiVersion="3.1"', 'fmiVersion is "3.1", expected "3.0"'),
    ("not closed", "</Terminals>", "", f"{TERMINALS_FILE}: line"),
    ("corners", 'x1="-100"', 'x1="100"', "x1 is 100 and x2 is 100"),
    ("name", '<Terminal name="a" matchingRule="plug"', '<Terminal name="" matchingRule="plug"',
     'name of the terminal is ""'),
    ("name twice", "  </Terminals>", '<Terminal name="a" matchingRule="bus"/></Terminals>',
     'name of the terminal is "a"'),
    ("variable", 'variableName="y"', 'variableName="x2"', 'variableName is "x2"'),
    ("stream", 'outStreamVariableName="y"', 'outStreamVariableName="x2"', "outStreamVariableName"),
    ("causality", 'variableName="y"', 'variableName="phi"', 'causality "local"'),
    ("member", ' memberName="s"', "", "memberName is missing"),
    ("member twice", 'memberName="s"', 'memberName="f"', 'memberName is "f"'),
    ("flows", 'variableKind="signal"', 'variableKind="outflow"', "2 inflows and outflows"),
    ("icon", 'iconBaseName="plug"', 'iconBaseName="../plug"', 'iconBaseName is "../plug"'),
]  # fmt: skip


@pytest.mark.parametrize("mutation", TERMINAL_MUTATIONS, ids=[m[0] for m in TERMINAL_MUTATIONS])
def test_every_rule_for_terminals_finds_its_violation(
    mutation: tuple[str, ...], tmp_path: Path
) -> None:
    _, old, new, *expected = mutation
    assert old in TERMINALS
    found = findings(fmu(tmp_path, {TERMINALS_FILE: TERMINALS.replace(old, new)}))
    check(found, TERMINALS_FILE, *expected)


BUILD_MUTATIONS = [
    ("not closed", "</BuildConfiguration>", "", f"{BUILD_FILE}: line"),
    ("identifier", 'modelIdentifier="Full"', 'modelIdentifier="Half"', 'modelIdentifier is "Half"'),
    ("platform", ' platform="x86_64-linux"', "", "two configurations have no platform"),
    ("source", 'name="full.c"', 'name="half.c"', 'source file "half.c" is missing'),
    ("sources", "SourceFileSet", "Sources", "it has no SourceFileSet"),
    ("include twice", "    </SourceFileSet>\n    <L",
     '      <IncludeDirectory name="include"/></SourceFileSet><L', '"include" appears twice'),
    ("compiler", ' compiler="gcc"', "", "compilerOptions and no compiler", "warning"),
    ("option", '"true" value="1"', '"true" value="2"', 'value is "2", expected that of an Option'),
]  # fmt: skip


@pytest.mark.parametrize("mutation", BUILD_MUTATIONS, ids=[m[0] for m in BUILD_MUTATIONS])
def test_every_rule_for_sources_finds_its_violation(
    mutation: tuple[str, ...], tmp_path: Path
) -> None:
    _, old, new, *expected = mutation
    assert old in BUILD
    check(findings(fmu(tmp_path, {BUILD_FILE: BUILD.replace(old, new)})), BUILD_FILE, *expected)


ELF = b"\x7fELF\x02".decode() + "\0" * 59

HEADER = Path(fmpy.__file__).parent / "c-code" / "fmi3Functions.h"
FUNCTIONS = "".join(f"{name}\0" for name in re.findall(r"TYPE +(fmi3\w+);", HEADER.read_text()))
"""The names of all functions, as in a binary."""


@pytest.mark.parametrize("folder", ["x86_64-linux", "x86_64-windows"])
def test_functions_that_are_not_exported_are_found(folder: str, tmp_path: Path) -> None:
    file, head = {
        "x86_64-linux": ("binaries/x86_64-linux/Full.so", ELF),
        "x86_64-windows": ("binaries/x86_64-windows/Full.dll", "MZ" + "\0" * 62),
    }[folder]
    names = [name for name in FUNCTIONS.split("\0") if name]
    assert len(names) == 75
    assert findings(fmu(tmp_path, {file: head + FUNCTIONS}), ("--no-run",)) == []
    found = findings(fmu(tmp_path, {file: head}), ("--no-run",))
    assert len(found) == 75
    for name in names:
        missing = FUNCTIONS.replace(f"{name}\0", f"{name}X\0")
        (found,) = findings(fmu(tmp_path, {file: head + missing}), ("--no-run",))
        assert f"{file}: it does not export {name}," in found


FILE_MUTATIONS = [
    ("build", {BUILD_FILE: None}, f"it has no {BUILD_FILE}"),
    ("nothing", {BUILD_FILE: None, "sources/full.c": None}, "neither binaries nor sources"),
    ("platform of FMI 2.0", {"binaries/linux64/Full.so": ELF}, "x86_64-linux", "warning"),
    ("name", {"binaries/x86-linux/full.so": ELF}, "binaries/x86-linux/Full.so"),
    ("format", {"binaries/x86_64-windows/Full.dll": ELF}, "not a shared library"),
    ("diagram", {"documentation/diagram.svg": ""}, "documentation/diagram.png"),
    ("licence", {"documentation/licenses/license.txt": None, "documentation/licenses/MIT": ""},
     "license.html"),
    ("extra", {"extra/data": ""}, "extra/data", "com.example"),
]  # fmt: skip


@pytest.mark.parametrize("mutation", FILE_MUTATIONS, ids=[m[0] for m in FILE_MUTATIONS])
def test_every_rule_for_files_finds_its_violation(
    mutation: tuple[str, dict[str, str | None], str], tmp_path: Path
) -> None:
    _, changes, *expected = mutation
    check(findings(fmu(tmp_path, changes)), *expected)


def test_static_libraries_may_have_any_name(tmp_path: Path) -> None:
    changes = {"binaries/x86_64-windows-msvc142mt/Full.lib": ""}
    check(findings(fmu(tmp_path, changes)), "documentation/staticLinking.txt")
    changes["documentation/staticLinking.html"] = ""
    assert findings(fmu(tmp_path, changes), ("--no-run",)) == []


def test_binaries_that_are_not_run_are_reported(tmp_path: Path) -> None:
    changes = {"binaries/x86-windows/Full.dll": "MZ" + "\0" * 62 + FUNCTIONS}
    (found,) = findings(fmu(tmp_path, changes))
    assert "warning: binaries" in found
    assert "no binary was run" in found


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
    result = cargo_fmu("info", fmu(tmp_path, {}))
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
        "clock input discrete Clock",
        "Way: left = 1, right = 2",
        "a (plug): y, u[1,2].a, u[1,2].a, y",
        "a (sequence): w16",
    ]:
        assert line.split() in lines, line


@pytest.mark.parametrize("text", ["", "<a/>", "<fmiTerminalsAndIcons><Terminals>"])
def test_info_ignores_broken_terminals(text: str, tmp_path: Path) -> None:
    result = cargo_fmu("info", fmu(tmp_path, {TERMINALS_FILE: text}))
    assert result.returncode == 0
    assert "terminals" not in result.stdout


def test_parameters_are_fixed_by_default(tmp_path: Path) -> None:
    old = 'causality="structuralParameter" variability="fixed"'
    assert old in FULL
    xml = FULL.replace(old, 'causality="structuralParameter"')
    assert findings(fmu(tmp_path, {MODEL_FILE: xml})) == []


def test_the_time_for_a_large_fmu_is_proportional_to_its_size(tmp_path: Path) -> None:
    types = "".join(
        f'<ClockType name="c{i}" intervalVariability="triggered"/><EnumerationType name="e{i}">'
        f'<Item name="a" value="1"/></EnumerationType>'
        for i in range(N)
    )
    variables = "".join(
        f'<Clock name="clock{i}" valueReference="{3 * i + 99}" causality="input" priority="1" '
        f'declaredType="c{N - 1}" intervalVariability="triggered" clocks="{3 * N + 96}"/>'
        f'<Enumeration name="v{i}" valueReference="{3 * i + 100}" causality="parameter" '
        f'declaredType="e{N - 1}" start="1"><Dimension valueReference="5"/><Alias name="alias{i}"/>'
        f'</Enumeration><Float64 name="o{i}" valueReference="{3 * i + 101}" causality="output"/>'
        for i in range(N)
    )
    unknowns = [
        "".join(f'<{name} valueReference="{3 * i + 101}"/>' for i in range(N))
        for name in ("Output", "InitialUnknown")
    ]
    xml = FULL.replace("  </TypeDefinitions>", types + "</TypeDefinitions>")
    xml = xml.replace("  </ModelVariables>", variables + "</ModelVariables>")
    xml = xml.replace("    <ContinuousState", unknowns[0] + "<ContinuousState")
    xml = xml.replace("    <EventIndicator", unknowns[1] + "<EventIndicator")
    terminals = "".join(
        f'<Terminal name="t{i}" matchingRule="bus"><TerminalMemberVariable '
        f'variableName="alias{i}" memberName="m" variableKind="signal"/></Terminal>'
        for i in range(N)
    )
    terminals = TERMINALS.replace("  </Terminals>", terminals + "</Terminals>")
    file = fmu(tmp_path, {MODEL_FILE: xml, TERMINALS_FILE: terminals})
    assert findings(file) == []
    assert cargo_fmu("info", file).returncode == 0


@pytest.mark.parametrize("model", ["Pendulum", "IpidRbf"])
def test_exported_fmus_have_no_findings(fmus: Path, model: str) -> None:
    assert findings(fmus / f"{model}_fmi3.fmu", ()) == []


CLAIMS = [
    # model, old text, new text, part of the finding
    (
        "Pendulum",
        'instantiationToken="{',
        'instantiationToken="{a',
        "fmi3Instantiate returned NULL",
    ),
    ("Pendulum", 'start="1.096"', 'start="1.097"', 'start value of "M" is 1.096 in the binary'),
    ("Pendulum", 'name="u" valueReference="0"', 'name="u" valueReference="999"', '"u" cannot be'),
    ("PidRbf", 'start="-2 -1 1 2"', 'start="-2 -1 1 3"', '"rbf.c[4]" is different in the binary'),
    ("PidRbf", 'start="4"', 'start="5"', '"rbf.w" cannot be read'),
    ("PidRbf", 'max="16" start="4"', 'max="16" start="16"', '"rbf.w" cannot be read'),
    (
        "Pid",
        'providesAdjointDerivatives="false"',
        'providesAdjointDerivatives="true"',
        "providesAdjointDerivatives is true, but",
    ),
    ("Source", 'hasEventMode="false"', 'hasEventMode="true"', "hasEventMode is true, but"),
]


@pytest.mark.parametrize(
    ("model", "old", "new", "expected"), CLAIMS, ids=[f"{c[0]} {c[1]}" for c in CLAIMS]
)
def test_wrong_claims_of_the_xml_are_found(
    model: str, old: str, new: str, expected: str, fmus: Path, tmp_path: Path
) -> None:
    files = read(fmus / f"{model}_fmi3.fmu")
    xml = files[MODEL_FILE].decode()
    assert old in xml
    file = write(tmp_path / "x.fmu", {**files, MODEL_FILE: xml.replace(old, new).encode()})
    check(findings(file), f"error: binaries/x86_64-linux/{model}.so", expected, "FMI 3.0.2")


DEFECTS = {
    "LENGTHS": '4 values of "w", which has 3',
    "SIZES": 'with "n" = 4, "w" cannot be read',
    "START": 'the start value of "c[3]" is different in the binary',
    "KEPT": '"c[3]" has another value in initialization mode',
    "STATE": '"w[2]" has another value after the state was restored',
    "RESET": '"w[2]" has another value after fmi3Reset',
    "ADJOINT": 'the adjoint derivative of "y" by "u" is -2, expected 2',
}
"""Part of what is found in each variant of `tests/c/vector.c`."""


def test_defects_of_what_fmi_3_adds_are_found(tmp_path: Path) -> None:
    found = {defect: set(findings(vector(tmp_path, defect), ())) for defect in ["NONE", *DEFECTS]}
    for defect, expected in DEFECTS.items():
        (finding,) = found[defect] - found["NONE"]
        assert expected in finding


def vector(folder: Path, defect: str) -> Path:
    """Build a variant of the FMU."""
    library = folder / "Vector.so"
    source = ROOT / "tests" / "c" / "vector.c"
    options = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", f"-D{defect}"]
    subprocess.run(["cc", *options, "-o", library, source], check=True)
    return write(
        folder / "x.fmu",
        {
            MODEL_FILE: source.with_suffix(".xml").read_bytes(),
            "binaries/x86_64-linux/Vector.so": library.read_bytes(),
        },
    )
