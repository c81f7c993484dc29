"""`cargo fmu validate` on FMUs with clocks, Binaries and networks."""

import json
import os
import re
from pathlib import Path

import pytest

from native import ROOT, SOURCES, in_c, write
from test_validate import BUILD, BUILD_FILE, MODEL_FILE, TERMINALS_FILE, cargo_fmu, check, findings

pytestmark = pytest.mark.usefixtures("program")

BUS = ROOT / "tests" / "data" / "bus"
MANIFEST_FILE = "extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml"
NETWORK = {
    MODEL_FILE: (BUS / "modelDescription.xml").read_text(),
    TERMINALS_FILE: (BUS / "terminalsAndIcons.xml").read_text(),
    MANIFEST_FILE: (BUS / "fmi-ls-manifest.xml").read_text(),
    BUILD_FILE: BUILD.replace("Full", "Node"),
    "sources/full.c": "",
}
"""The files of a valid FMU with a network terminal."""


def test_a_valid_network_has_no_findings(tmp_path: Path) -> None:
    assert findings(write(tmp_path / "Node.fmu", NETWORK)) == []


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        (MANIFEST_FILE, "/>", ">", f"{MANIFEST_FILE}: the document ends"),
        (MANIFEST_FILE, "fmiLayeredStandardManifest", "manifest", 'the root is "manifest"'),
        (MANIFEST_FILE, "standard.fmi-ls-bus", "standard.other", "expected org.fmi-standard"),
        (MANIFEST_FILE, 'version="1.0.0"', 'version="one"', 'fmi-ls-version is "one"'),
        (MANIFEST_FILE, 'fmi-ls:fmi-ls-version="1.0.0"', "", "fmi-ls-version is missing"),
        (MANIFEST_FILE, '="false"', '="no"', 'isBusSimulationFMU is "no"'),
        (MANIFEST_FILE, "", None, f"warning: {TERMINALS_FILE}: it has a network terminal"),
        (TERMINALS_FILE, "transceiver", "other", 'has matchingRule "org.fmi-ls-bus.other"'),
        (TERMINALS_FILE, 'memberName="Tx_Data"', 'memberName="Tx"', "has no member Tx_Data"),
        (TERMINALS_FILE, 'memberName="Tx_Data"', 'memberName="Tx"', 'the member "Tx" has'),
        (TERMINALS_FILE, 'Kind="signal"', 'Kind="inflow"', 'variableKind "inflow", expected'),
        (TERMINALS_FILE, 'ableName="Tx_Data"', 'ableName="Rx_Data"', "with causality input"),
        (TERMINALS_FILE, 'ableName="Tx_Data"', 'ableName="Rx_Data"', '"Rx_Data" is a member of'),
        (MODEL_FILE, 'clocks="3"', 'clocks="1"', '"Tx_Data" does not have the clock'),
        (MODEL_FILE, '"countdown"', '"triggered"', "expected a time-based input clock"),
        (MODEL_FILE, '"triggered"', '"countdown"', "expected a triggered input clock"),
        (MODEL_FILE, "bus.can; version=&quot;1.0.0&quot;", "bus.can", "bus.can\", expected one"),
        (MODEL_FILE, 'can; version=&quot;1.0.0&quot;"/>', 'lin; version=&quot;1.0.0&quot;"/>',
         "expected the same"),
        (MODEL_FILE, 'StepSize="true"', 'StepSize="false"', "warning: modelDescription.xml:3"),
        (TERMINALS_FILE, '"none"', '"bus"', 'groups network terminals and has matchingRule "bus"'),
        (TERMINALS_FILE, 'name="Configuration"', 'name="Status"', 'has name "Status"'),
    ],
)  # fmt: skip
def test_every_rule_of_networks_finds_its_violation(
    file: str, old: str, new: str | None, expected: str, tmp_path: Path
) -> None:
    assert old in NETWORK[file]
    files = {**NETWORK, file: "" if new is None else NETWORK[file].replace(old, new)}
    if new is None:
        del files[file]
    check(findings(write(tmp_path / "Node.fmu", files)), expected)


# --- binaries -------------------------------------------------------------------------------------

CS, SE = "CoSimulation", "ScheduledExecution"
ROWS = (SOURCES / "clock_defects.h").read_text()
DEFECTS = {
    name: (globals()[interface], rule)
    for name, interface, rule in re.findall(r'\nPLANT\((\w+), (\w+), "(.+?)", ".+"\)', ROWS)
}
assert len(DEFECTS) == ROWS.count("PLANT(") - ROWS.count(", NULL, ")
"""An interface type that shows each defect of `tests/c/clocked.c`, and the rule that finds it."""

FEW = {rule: name for name, (_, rule) in reversed(DEFECTS.items())}.values()
"""One defect for each rule."""


def clocked(folder: Path, defect: str, interface: str = "") -> Path:
    """Return the FMU with a defect and one interface type, by default with both."""
    xml = (SOURCES / "clocked.xml").read_text()
    other = {CS: SE, SE: CS}.get(interface)
    xml = re.sub(rf"  <{other}.*/>\n", "", xml) if other else xml
    return in_c(folder / "Clocked.fmu", f"DEFECT={defect}", xml=xml)


def test_correct_clocks_have_no_findings(tmp_path: Path) -> None:
    assert findings(clocked(tmp_path, "NO_DEFECT")) == []


@pytest.mark.parametrize("defect", DEFECTS if "ALL_DEFECTS" in os.environ else FEW)
def test_a_defect_of_clocks_is_found(defect: str, tmp_path: Path) -> None:
    interface, rule = DEFECTS[defect]
    fmu = clocked(tmp_path, defect, interface)
    for options in (["--quick"], []):
        report = cargo_fmu("validate", "--format", "json", "--time-limit", "5", *options, fmu)
        rules = json.loads(report.stdout)["files"][0]["rules"]
        found = {rule["id"]: rule["findings"] for rule in rules}
        if rule in found:
            return
    pytest.fail(str(found))


def test_an_fmu_that_also_steps_in_event_mode_has_no_findings(tmp_path: Path) -> None:
    assert findings(clocked(tmp_path, "STEPS_IN_EVENT_MODE", CS)) == []


def test_a_clock_that_never_ticks_is_a_hint(tmp_path: Path) -> None:
    (found,) = findings(clocked(tmp_path, "NEVER_SENT", CS))
    assert found.startswith('hint: the output clock "sent" does not tick')
