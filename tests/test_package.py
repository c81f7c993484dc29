"""The five .fmu files as packages: names, units, schema, symbols, sizes, capabilities."""

import math
import os
import subprocess
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

MODELS = ["Pendulum", "Pid", "PidRbf", "IpidRbf", "Source"]

SIZE_OF_LIBRARY = 520_000
SIZE_OF_PACKAGE = 255_000

each_model = pytest.mark.parametrize("model", MODELS)

# --- the documented interface -------------------------------------------------------------------

# Exponents of the SI base units and of rad, by the unit names of the tables below
DIMENSIONS = {
    "1": {},
    "s": {"s": 1},
    "Hz": {"s": -1},
    "kg": {"kg": 1},
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "kg.m2": {"kg": 1, "m": 2},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N.s/m": {"kg": 1, "s": -1},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s2": {"rad": 1, "s": -2},
    "N/rad": {"kg": 1, "m": 1, "s": -2, "rad": -1},
    "N/(rad.s)": {"kg": 1, "m": 1, "s": -3, "rad": -1},
    "N.s/rad": {"kg": 1, "m": 1, "s": -1, "rad": -1},
}


def numbered(name: str, row: tuple, starts: list[float] | None = None) -> dict[str, tuple]:
    """Return four rows, for name[1] to name[4]; `starts` override the start value."""
    return {
        f"{name}[{j}]": row if starts is None else (*row[:-1], starts[j - 1]) for j in range(1, 5)
    }


# name: (causality, variability, unit, start); start None: an output
PENDULUM = {
    "u": ("input", "continuous", "N", 0),
    "theta": ("output", "continuous", "rad", None),
    "omega": ("output", "continuous", "rad/s", None),
    "x": ("output", "continuous", "m", None),
    "v": ("output", "continuous", "m/s", None),
    "M": ("parameter", "fixed", "kg", 1.096),
    "m": ("parameter", "fixed", "kg", 0.109),
    "l": ("parameter", "fixed", "m", 0.25),
    "g": ("parameter", "fixed", "m/s2", 9.8),
    "I": ("parameter", "fixed", "kg.m2", 0.0034),
    "b": ("parameter", "fixed", "N.s/m", 0.1),
    "theta0": ("parameter", "fixed", "rad", 0),
    "omega0": ("parameter", "fixed", "rad/s", 0),
    "x0": ("parameter", "fixed", "m", 0),
    "v0": ("parameter", "fixed", "m/s", 0),
    "ts": ("parameter", "fixed", "s", 0.001),
    "model": ("parameter", "fixed", ("transfer_function", "linear", "nonlinear"), "linear"),
    "der(theta)": ("local", "continuous", "rad/s", None),
    "der(omega)": ("local", "continuous", "rad/s2", None),
    "der(x)": ("local", "continuous", "m/s", None),
    "der(v)": ("local", "continuous", "m/s2", None),
}
PID = {
    "r": ("input", "continuous", "rad", 0),
    "y": ("input", "continuous", "rad", 0),
    "d": ("input", "continuous", "rad", 0),
    "u": ("output", "discrete", "N", None),
    "u_p": ("output", "discrete", "N", None),
    "e": ("output", "discrete", "rad", None),
    "pid.kp": ("parameter", "tunable", "N/rad", 300),
    "pid.ki": ("parameter", "tunable", "N/(rad.s)", 500),
    "pid.kd": ("parameter", "tunable", "N.s/rad", 100),
    "u_max": ("parameter", "tunable", "N", 100),
    "ts": ("parameter", "fixed", "s", 0.001),
    "previous_sample_terms": ("parameter", "fixed", bool, "false"),
    "anti_windup": ("parameter", "fixed", bool, "false"),
}
PID_RBF = {
    **PID,
    "u_n": ("output", "discrete", "N", None),
    **numbered("rbf.w", ("output", "discrete", "N", None)),
    **numbered("rbf.h", ("output", "discrete", "1", None)),
    "rbf.eta": ("parameter", "tunable", "1", 0.3),
    "rbf.alpha": ("parameter", "tunable", "1", 0.05),
    **numbered("rbf.c", ("parameter", "fixed", "rad", 0), [-2, -1, 1, 2]),
    **numbered("rbf.b", ("parameter", "fixed", "rad", 0.5)),
    **numbered("rbf.w0", ("parameter", "fixed", "N", 0)),
}
IPID_RBF = {
    **PID_RBF,
    "u_supervisor": ("input", "continuous", "N", 0),
    "rbf.target": ("parameter", "fixed", ("own", "supervisor"), "own"),
}
SOURCE = {
    "r": ("output", "continuous", "rad", None),
    "d": ("output", "continuous", "rad", None),
    "signal": ("parameter", "fixed", ("step", "sine", "square"), "step"),
    "amplitude": ("parameter", "fixed", "rad", 1),
    "frequency": ("parameter", "fixed", "Hz", 0.2),
    "disturbance.amplitude": ("parameter", "fixed", "rad", 0),
    "disturbance.start": ("parameter", "fixed", "s", 5),
    "disturbance.duration": ("parameter", "fixed", "s", 0.5),
}
INTERFACES = {
    "Pendulum": PENDULUM, "Pid": PID, "PidRbf": PID_RBF, "IpidRbf": IPID_RBF, "Source": SOURCE,
}  # fmt: skip


def describe(fmus: Path, model: str) -> fmpy.model_description.ModelDescription:
    """Return FMPy's model description of an FMU."""
    return fmpy.read_model_description(fmus / f"{model}.fmu")


def exponents(description, unit: str) -> dict[str, int]:
    """Return the nonzero exponents of a unit's base units."""
    base = next(u for u in description.unitDefinitions if u.name == unit).baseUnit
    assert base.factor in (None, 1, "1")
    assert base.offset in (None, 0, "0")
    names = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
    return {name: int(getattr(base, name)) for name in names if int(getattr(base, name) or 0)}


@each_model
def test_variables_match_the_documented_interface(fmus, model):
    description = describe(fmus, model)
    variables = {v.name: v for v in description.modelVariables}
    assert sorted(variables) == sorted(INTERFACES[model])
    assert max(map(len, variables)) <= 63
    for name, (causality, variability, unit, start) in INTERFACES[model].items():
        variable = variables[name]
        assert variable.causality == causality, name
        assert variable.description, name
        if isinstance(unit, tuple):
            items = {item.name: item.value for item in variable.declaredType.items}
            assert (variable.type, tuple(items)) == ("Enumeration", unit), name
            assert variable.start == items[start], name
        elif unit is bool:
            assert (variable.type, variable.start) == ("Boolean", start), name
        else:
            assert variable.type == "Real", name
            declared = variable.unit or variable.declaredType.unit
            assert exponents(description, declared) == DIMENSIONS[unit], name
            assert (variable.start is None) == (start is None), name
            assert start is None or float(variable.start) == start, name
        if causality == "parameter":
            assert variable.variability == variability, name


def test_angles_are_shown_in_degrees(fmus):
    (rad,) = [u for u in describe(fmus, "Pendulum").unitDefinitions if u.name == "rad"]
    (degrees,) = [u for u in rad.displayUnits if u.name == "deg"]
    assert float(degrees.factor) == pytest.approx(180 / math.pi, rel=1e-15)


@each_model
def test_default_experiment_is_the_paper_s(fmus, model):
    experiment = describe(fmus, model).defaultExperiment
    assert (float(experiment.stepSize), float(experiment.stopTime)) == (0.001, 20)


# --- the model description ----------------------------------------------------------------------


@each_model
def test_fmpy_validates_it_without_problems(fmus, model):
    assert validate_fmu(str(fmus / f"{model}.fmu")) == []


@each_model
def test_xml_is_valid_by_the_schema_of_the_standard(fmus, model):
    folder = Path(fmpy.__file__).parent / "schema" / "fmi2"
    schema = etree.XMLSchema(file=str(folder / "fmi2ModelDescription.xsd"))
    schema.assertValid(read_xml(fmus, model))


def read_xml(fmus: Path, model: str) -> etree._ElementTree:
    """Return the model description as XML."""
    with zipfile.ZipFile(fmus / f"{model}.fmu") as package:
        return etree.ElementTree(etree.fromstring(package.read("modelDescription.xml")))


@each_model
def test_no_output_has_direct_feedthrough(fmus, model):
    xml = read_xml(fmus, model)
    variables = xml.findall(".//ModelVariables/ScalarVariable")
    outputs = {
        str(index) for index, v in enumerate(variables, start=1) if v.get("causality") == "output"
    }
    # The plant's outputs are its states.
    states = {v[0].get("derivative") for v in variables} - {None}
    listed = xml.findall(".//ModelStructure/Outputs/Unknown")
    assert {unknown.get("index") for unknown in listed} == outputs
    for unknown in listed:
        own = unknown.get("index")
        assert unknown.get("dependencies") == (own if own in states else "")
    assert states == (outputs if model == "Pendulum" else set())


def test_every_model_has_its_own_guid(fmus):
    guids = [describe(fmus, model).guid for model in MODELS]
    assert all(guids)
    assert len(set(guids)) == len(MODELS)


@each_model
def test_fmpy_simulates_it_with_defaults(fmus, model):
    results = fmpy.simulate_fmu(fmus / f"{model}.fmu", stop_time=0.5)
    assert results["time"][-1] == pytest.approx(0.5)
    for name in results.dtype.names:
        assert np.all(np.isfinite(results[name]))


# --- the package --------------------------------------------------------------------------------


@each_model
def test_zip_contains_the_files_of_the_standard(fmus, model):
    with zipfile.ZipFile(fmus / f"{model}.fmu") as package:
        entries = package.infolist()
        assert package.testzip() is None
    names = [entry.filename for entry in entries]
    assert names[0] == "modelDescription.xml"
    assert f"binaries/linux64/{model}.so" in names
    assert any(name.startswith("documentation/licenses/") for name in names)
    assert len(names) == len(set(names))
    for entry in entries:
        assert "\\" not in entry.orig_filename
        assert entry.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        assert not entry.flag_bits & 0x08, "a data descriptor"
        assert entry.date_time == entries[0].date_time


@each_model
def test_package_is_small(fmus, model):
    package = fmus / f"{model}.fmu"
    assert package.stat().st_size <= SIZE_OF_PACKAGE
    with zipfile.ZipFile(package) as content:
        assert content.getinfo(f"binaries/linux64/{model}.so").file_size <= SIZE_OF_LIBRARY


@each_model
def test_model_identifier_names_the_library(fmus, model):
    description = describe(fmus, model)
    assert description.modelName == model
    assert description.coSimulation.modelIdentifier == model
    if model == "Source":  # neither sampled nor described by equations
        assert description.modelExchange is None
    else:
        assert description.modelExchange.modelIdentifier == model
    assert description.fmiVersion == "2.0"


FMI2_FUNCTIONS = {
    f"fmi2{name}"
    for name in """
    GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance
    SetupExperiment EnterInitializationMode ExitInitializationMode Terminate Reset
    GetReal GetInteger GetBoolean GetString SetReal SetInteger SetBoolean SetString
    GetFMUstate SetFMUstate FreeFMUstate
    SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate
    GetDirectionalDerivative
    EnterEventMode NewDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep
    SetTime SetContinuousStates GetDerivatives GetEventIndicators GetContinuousStates
    GetNominalsOfContinuousStates
    SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep
    GetStatus GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus
    """.split()
}


@pytest.fixture(params=["Pendulum", "PidRbf", "Source"])
def library(fmus, request, tmp_path) -> Path:
    """Return the unzipped library of a model; the three controllers share one."""
    model = request.param
    with zipfile.ZipFile(fmus / f"{model}.fmu") as package:
        return Path(package.extract(f"binaries/linux64/{model}.so", tmp_path))


def test_library_exports_the_functions_of_the_standard_and_nothing_else(library):
    nm = subprocess.run(
        ["nm", "-D", "--defined-only", library], capture_output=True, text=True, check=True
    )
    assert len(FMI2_FUNCTIONS) == 44
    assert {line.split()[-1] for line in nm.stdout.splitlines()} == FMI2_FUNCTIONS


def test_library_needs_only_the_c_library(library):
    dump = subprocess.run(["objdump", "-p", library], capture_output=True, text=True, check=True)
    needed = {line.split()[1] for line in dump.stdout.splitlines() if "NEEDED" in line}
    assert needed <= {"libc.so.6", "libm.so.6", "libgcc_s.so.1", "ld-linux-x86-64.so.2"}


def test_library_contains_no_path_of_the_build_machine(library):
    content = library.read_bytes()
    for path in (Path.home() / ".cargo", Path(__file__).resolve().parent.parent):
        assert os.fsencode(path) not in content


# --- capabilities -------------------------------------------------------------------------------


@each_model
def test_capability_flags_and_log_categories_match_the_implementation(fmus, model):
    description = describe(fmus, model)
    flags = description.coSimulation
    assert flags.canGetAndSetFMUstate
    assert flags.canSerializeFMUstate
    assert flags.canHandleVariableCommunicationStepSize
    assert flags.canNotUseMemoryManagementFunctions
    assert not flags.needsExecutionTool
    assert not flags.canRunAsynchronuously
    assert int(flags.maxOutputDerivativeOrder) == (model == "Pendulum")
    assert not flags.canBeInstantiatedOnlyOncePerProcess
    # Only of the plant, which supports input derivatives and directional derivatives.
    assert flags.canInterpolateInputs == (model == "Pendulum")
    assert flags.providesDirectionalDerivative == (model == "Pendulum")
    categories = "Error Warning Discard Fatal".split()
    categories = [*(f"logStatus{name}" for name in categories), "logEvents", "logAll"]
    assert [category.name for category in description.logCategories] == categories


def test_one_library_serves_several_instances(fmus, tmp_path):
    folder = fmpy.extract(fmus / "Pendulum.fmu", tmp_path)
    description = fmpy.read_model_description(folder)
    slaves = [fmpy.instantiate_fmu(folder, description, "CoSimulation") for _ in range(3)]
    references = {v.name: v.valueReference for v in description.modelVariables}
    for index, slave in enumerate(slaves):
        slave.setReal([references["theta0"]], [0.1 * index])
        slave.setupExperiment()
        slave.enterInitializationMode()
        slave.exitInitializationMode()
    for slave in slaves:
        slave.doStep(0.0, 0.1)
    angles = [slave.getReal([references["theta"]])[0] for slave in slaves]
    assert angles[0] == 0
    assert angles[2] == pytest.approx(2 * angles[1], rel=1e-12)
    for slave in slaves:
        slave.terminate()
        slave.freeInstance()
