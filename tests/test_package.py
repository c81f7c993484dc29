"""The FMUs of both versions of FMI: interface, XML, files, symbols, sizes, capabilities."""

import re
import subprocess
import zipfile
from pathlib import Path
from typing import NamedTuple

import fmpy
import numpy as np
import pytest
from fmpy.model_description import ModelDescription
from fmpy.validation import validate_fmu
from lxml import etree

from native import read

MODELS = ["Pendulum", "Pid", "PidRbf", "IpidRbf", "Source"]
TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
STANDARD = Path(fmpy.__file__).parent

FMI2_FUNCTIONS, FMI3_FUNCTIONS = (
    set(re.findall(r"FullName\((fmi\w+)\)", (STANDARD / "c-code" / header).read_text()))
    for header in ("fmi2Functions.h", "fmi3Functions.h")
)


class Fmu(NamedTuple):
    """An FMU of one of the versions of FMI."""

    path: Path
    model: str

    @property
    def is_fmi_3(self) -> bool:
        """Whether it is for FMI 3.0."""
        return self.path.stem.endswith("_fmi3")

    @property
    def library(self) -> str:
        """The name of its library."""
        return f"binaries/{'x86_64-linux' if self.is_fmi_3 else 'linux64'}/{self.model}.so"

    @property
    def description(self) -> ModelDescription:
        """FMPy's model description."""
        return fmpy.read_model_description(self.path)

    def read(self, name: str) -> bytes:
        """Return a file."""
        return read(self.path)[name]

    def xml(self, name: str = "modelDescription.xml") -> etree._Element:
        """Return the root of an XML file, by default of the model description."""
        return etree.fromstring(self.read(name))


def of(fmus: Path, model: str, version: str = "2.0") -> Fmu:
    """Return the FMU of a model."""
    return Fmu(fmus / f"{model}{'_fmi3' * (version == '3.0')}.fmu", model)


@pytest.fixture
def fmu(fmus: Path, model: str, version: str) -> Fmu:
    """Return the FMU of a model, also for the tests of its documentation."""
    return of(fmus, model, version)


each_model = pytest.mark.parametrize("model", MODELS)
EVERY = [(version, model) for version in ("2.0", "3.0") for model in MODELS]
each_fmu = pytest.mark.parametrize(("version", "model"), EVERY)

# --- the documented interface -------------------------------------------------------------------

# Causality and variability; then name, unit (of an enumeration, its items) and start of each
# variable. An array of FMI 3.0 has four elements in FMI 2.0.
PID = """
input continuous: r rad 0, y rad 0, d rad 0
output discrete: u N, u_p N, e rad
parameter tunable: pid.kp N/rad 300, pid.ki N/(rad.s) 500, pid.kd N.s/rad 100, u_max N 100
parameter fixed: ts s 0.001, previous_sample_terms bool false, anti_windup bool false
"""
PID_RBF = f"""{PID}
output discrete: u_n N, rbf.w[4] N, rbf.h[4] 1
parameter tunable: rbf.eta 1 0.3, rbf.alpha 1 0.05
parameter fixed: rbf.c[4] rad -2|-1|1|2, rbf.b[4] rad 0.5|0.5|0.5|0.5, rbf.w0[4] N 0|0|0|0
"""
INTERFACES = {
    "Pendulum": """
input continuous: u N 0
output continuous: theta rad, omega rad/s, x m, v m/s
parameter fixed: M kg 1.096, m kg 0.109, l m 0.25, g m/s2 9.8, I kg.m2 0.0034, b N.s/m 0.1
parameter fixed: theta0 rad 0, omega0 rad/s 0, x0 m 0, v0 m/s 0, ts s 0.001
parameter fixed: dynamics transfer_function|linear|nonlinear linear
local continuous: der(theta) rad/s, der(omega) rad/s2, der(x) m/s, der(v) m/s2
""",
    "Pid": PID,
    "PidRbf": PID_RBF,
    "IpidRbf": f"""{PID_RBF}
input continuous: u_supervisor N 0
parameter fixed: rbf.target own|supervisor own
""",
    "Source": """
output continuous: r rad, d rad
parameter fixed: signal step|sine|square step, amplitude rad 1, frequency Hz 0.2
parameter fixed: disturbance.amplitude rad 0, disturbance.start s 5, disturbance.duration s 0.5
""",
}


def interface(model: str) -> dict[str, tuple[str, str, str, str]]:
    """Return causality, variability, unit and start of the variables, by name."""
    variables = {}
    for line in INTERFACES[model].split("\n"):
        kind, _, rest = line.partition(":")
        for name, unit, *start in (item.split() for item in rest.split(",") if item):
            name, array, _ = name.partition("[4]")
            starts = start[0].split("|") if start else [""] * 4
            for j in range(4 if array else 1):
                variables[name + f"[{j + 1}]" * bool(array)] = (*kind.split(), unit, starts[j])
    return variables


@each_model
def test_variables_match_the_documented_interface(fmus, model):
    description = of(fmus, model).description
    variables = {v.name: v for v in description.modelVariables}
    assert sorted(variables) == sorted(interface(model))
    for name, (causality, variability, unit, start) in interface(model).items():
        variable = variables[name]
        assert variable.causality == causality, name
        assert variable.description, name
        kind, found = variable.type, variable.start or ""
        if "|" in unit:
            items = {item.name: item.value for item in variable.declaredType.items}
            assert (kind, "|".join(items), found) == ("Enumeration", unit, items[start]), name
        elif unit == "bool":
            assert (kind, found) == ("Boolean", start), name
        else:
            own = variable.unit or variable.declaredType.unit
            assert (kind, own, found) == ("Real", unit, start), name
        if causality == "parameter":
            assert variable.variability == variability, name


# --- the model description ----------------------------------------------------------------------


@each_fmu
def test_fmpy_validates_and_simulates_it(fmu):
    assert validate_fmu(str(fmu.path)) == []  # with the schema of the standard
    results = fmpy.simulate_fmu(fmu.path, stop_time=0.5)
    assert results["time"][-1] == pytest.approx(0.5)
    for name in results.dtype.names:
        assert np.all(np.isfinite(results[name]))


UPDATES = "providesIntermediateUpdate canReturnEarlyAfterIntermediateUpdate"
DERIVATIVES = "providesDirectionalDerivatives providesAdjointDerivatives"
CAPABILITIES = {
    "2.0": "canHandleVariableCommunicationStepSize canNotUseMemoryManagementFunctions"
    " canGetAndSetFMUstate canSerializeFMUstate",
    "2.0 Pendulum": "canInterpolateInputs providesDirectionalDerivative",
    "3.0": "canHandleVariableCommunicationStepSize canGetAndSetFMUState canSerializeFMUState"
    " mightReturnEarlyFromDoStep hasEventMode",
    "3.0 Pendulum": f"{DERIVATIVES} {UPDATES}",
    "3.0 Source": UPDATES,
    "3.0 BouncingBall": UPDATES,
    "3.0 Stair": UPDATES,
    "3.0 VanDerPol": f"{DERIVATIVES} {UPDATES}",
}
CATEGORIES = "logStatusError logStatusWarning logStatusDiscard logStatusFatal logEvents logAll"


@each_fmu
def test_identity_and_experiment_are_those_of_the_model(fmus, fmu, version):
    description = fmu.description
    assert (description.modelName, description.fmiVersion[:1]) == (fmu.model, version[:1])
    kinds = [description.coSimulation, description.modelExchange]
    assert [kind.modelIdentifier for kind in kinds] == [fmu.model] * 2
    guids = {name: of(fmus, name).description.guid for name in MODELS}
    assert len(set(guids.values())) == len(MODELS)
    assert description.guid == guids[fmu.model]
    experiment = description.defaultExperiment
    assert (float(experiment.stepSize), float(experiment.stopTime)) == (0.001, 20)
    assert [category.name for category in description.logCategories] == CATEGORIES.split()
    flags = fmu.xml().find("CoSimulation").attrib
    assert int(flags["maxOutputDerivativeOrder"]) == (fmu.model == "Pendulum")


EQUATIONS = [("3.0", model) for model in ("BouncingBall", "Stair", "VanDerPol")]


@pytest.mark.parametrize(("version", "model"), [*EVERY, *EQUATIONS])
def test_capabilities_are_those_of_the_model(fmus, equations, version, model):
    """`cargo fmu validate` finds what an FMU does without the capability."""
    flags = of(fmus if model in MODELS else equations, model, version).xml().find("CoSimulation")
    expected = CAPABILITIES[version] + " " + CAPABILITIES.get(f"{version} {model}", "")
    assert {name for name, value in flags.items() if value == "true"} == set(expected.split())


@each_model
def test_no_output_has_direct_feedthrough(fmus, model):
    xml = of(fmus, model).xml()
    variables = xml.findall(".//ModelVariables/ScalarVariable")
    outputs = {str(k) for k, v in enumerate(variables, 1) if v.get("causality") == "output"}
    # The plant's outputs are its states.
    states = {v[0].get("derivative") for v in variables} - {None}
    assert states == (outputs if model == "Pendulum" else set())
    listed = {u.get("index"): u.get("dependencies") for u in xml.findall(".//Outputs/Unknown")}
    assert listed == {own: own if own in states else "" for own in outputs}


@pytest.mark.parametrize("controller", ["Pid", "PidRbf", "IpidRbf"])
def test_terminals_connect_the_loop(fmus, controller):
    def terminals(model: str) -> dict[tuple[str, str], str]:
        """Return the causality of each member of each terminal."""
        fmu = of(fmus, model, "3.0")
        causality = {v.get("name"): v.get("causality") for v in fmu.xml().find("ModelVariables")}
        return {
            (terminal.get("name"), member.get("memberName")): causality[member.get("variableName")]
            for terminal in fmu.xml(TERMINALS).find("Terminals")
            for member in terminal
        }

    own, others = terminals(controller), terminals("Pendulum") | terminals("Source")
    assert {name for name, _ in own} == {name for name, _ in others} == {"loop", "reference"}
    for member, causality in own.items():
        assert {causality, others[member]} == {"input", "output"}


# --- the package --------------------------------------------------------------------------------


@each_fmu
def test_it_is_small_and_has_the_files_of_the_standard_and_no_others(fmu):
    with zipfile.ZipFile(fmu.path) as package:
        entries = package.infolist()
        assert package.testzip() is None
    for entry in entries:
        assert "\\" not in entry.orig_filename
        assert entry.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        assert not entry.flag_bits & 0x08, "a data descriptor"
        assert entry.date_time == (1980, 1, 1, 0, 0, 0), "so that bytes can be reproduced"
    documentation = ["index.html", "licenses/LICENSE-APACHE", "licenses/LICENSE-MIT"]
    rest = ["model.png"]
    if fmu.is_fmi_3:
        documentation.append("licenses/license.txt")
        rest = ["terminalsAndIcons/icon.png", TERMINALS]
    names = [fmu.library, *(f"documentation/{name}" for name in documentation), *rest]
    first, *others = [entry.filename for entry in entries]
    assert first == "modelDescription.xml"
    assert sorted(others) == names
    limits = (180_000, 450_000) if fmu.is_fmi_3 else (160_000, 400_000)
    assert fmu.path.stat().st_size <= limits[0]
    assert len(fmu.read(fmu.library)) <= limits[1]


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("model", ["Pendulum", "PidRbf", "Source"])  # controllers share a library
def test_library_exports_the_functions_of_the_standard_and_needs_only_the_c_library(fmu, tmp_path):
    def told(*command: str) -> list[list[str]]:
        done = subprocess.run([*command, library], capture_output=True, text=True, check=True)
        return [line.split() for line in done.stdout.splitlines()]

    library = tmp_path / "library.so"
    library.write_bytes(fmu.read(fmu.library))
    functions, number = (FMI3_FUNCTIONS, 75) if fmu.is_fmi_3 else (FMI2_FUNCTIONS, 44)
    assert {line[-1] for line in told("nm", "-D", "--defined-only")} == functions
    assert len(functions) == number
    needed = {line[1] for line in told("objdump", "-p") if "NEEDED" in line}
    assert needed <= {"libc.so.6", "libm.so.6", "libgcc_s.so.1", "ld-linux-x86-64.so.2"}
