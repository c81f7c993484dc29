"""The native master with FMUs of FMI 3.0, alone and together with those of FMI 2.0."""

import zipfile
from collections.abc import Callable, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from native import LOOPS, compiled, refusal, run, simulate, write_system
from pendulum_fmus.project import FMUS, ROOT

# --- the loops of the paper -----------------------------------------------------------------------

MODELS = ("Pid", "Pendulum", "Source")


def loop(folder: Path, example: str, outputs: str = "", **versions: str) -> Path:
    """Write an example with FMUs of other versions, and perhaps other outputs."""
    text = (LOOPS / example).read_text(encoding="utf-8")
    for model, version in versions.items():
        assert f"/{model}.fmu" in text
        text = text.replace(f"/{model}.fmu", f"/{model}{version}.fmu")
    system = folder / example
    text = text.replace("../../target/fmu", FMUS.as_posix())
    system.write_text(outputs + text, encoding="utf-8")
    return system


def table(system: Path, *options: str) -> bytes:
    """Return the CSV file of a run."""
    simulate(system, system.parent, "--stop", "1", *options)
    return (system.parent / "results.csv").read_bytes()


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_any_pairing_of_versions_gives_the_same_bytes(fmus, tmp_path, order):
    options = (f"--order={order}", "--set=plant.theta0=0.1", "--set=source.signal=sine")
    pairings = list(product(["", "_fmi3"], repeat=len(MODELS)))
    tables = []
    for versions in pairings:
        by_model = dict(zip(MODELS, versions, strict=True))
        tables.append(table(loop(tmp_path, "pid.toml", **by_model), *options))
    assert len(pairings) == 8
    assert tables[0].count(b"\n") == 1001
    assert all(rows == tables[0] for rows in tables), pairings


@pytest.mark.parametrize("model", ["PidRbf", "IpidRbf"])
@pytest.mark.parametrize(
    "outputs", ["", 'outputs = ["controller.rbf.w[3]", "controller.rbf.w[1]"]\n']
)
def test_elements_of_arrays_are_set_and_recorded_as_variables_of_fmi_2(
    fmus, tmp_path, model, outputs
):
    example = {"PidRbf": "pid-rbf.toml", "IpidRbf": "ipid-rbf.toml"}[model]
    options = [f"--set=controller.rbf.{name}" for name in ("c[2]=-0.5", "c[4]=1.5", "w0[1]=3")]

    def run_with(ending: str, *options: str) -> bytes:
        versions = dict.fromkeys((model, "Pendulum", "Source"), ending)
        return table(loop(tmp_path, example, outputs, **versions), *options)

    assert run_with("_fmi3", *options) == run_with("", *options) != run_with("")


def test_a_structural_parameter_makes_arrays_larger(fmus, tmp_path):
    outputs = 'outputs = ["controller.u", "controller.rbf.nodes"]\n'
    system = loop(tmp_path, "pid-rbf.toml", outputs, PidRbf="_fmi3")

    def run_with(nodes: int, **arrays: list[float]) -> tuple[np.ndarray, np.ndarray]:
        elements = [
            f"controller.rbf.{name}[{k}]={value}"
            for name, values in arrays.items()
            for k, value in enumerate(values, 1)
        ]
        sets = [f"--set={word}" for word in [f"controller.rbf.nodes={nodes}", *elements]]
        results = simulate(system, tmp_path, "--stop", "1", *sets)
        return results["controller.u"], results["controller.rbf.nodes"]

    centres, widths = [-2.0, -1.0, 1.0, 2.0], [0.5] * 4
    forces, _ = run_with(4)
    # Nodes that are never active add nothing.
    more, nodes = run_with(8, c=centres + [1e9] * 4, b=widths + [1e-6] * 4, w0=[0.0] * 8)
    assert set(nodes) == {8}
    np.testing.assert_allclose(more, forces, rtol=1e-12)
    fewer, nodes = run_with(1, c=[0.0], b=[1.0], w0=[0.0])
    assert set(nodes) == {1}
    assert np.any(fewer != forces)
    sweep = tmp_path / "sweep.toml"
    parameter = '[[parameter]]\nvariable = "controller.rbf.nodes"\nvalues = [4, 8]\n'
    names = {"reference": "source.r", "output": "plant.theta", "error": "controller.e"}
    signals = [f'{key} = "{name}"' for key, name in (names | {"control": "controller.u"}).items()]
    sweep.write_text(f'system = "{system.name}"\n{parameter}[signals]\n' + "\n".join(signals))
    assert "controller.rbf.nodes = 4 cannot be set for single runs, as it is the size of" in (
        refusal(tmp_path, "sweep", sweep, "--out", tmp_path / "out.csv")
    )


def test_wrong_start_values_of_elements_are_named(fmus, tmp_path):
    system = loop(tmp_path, "pid-rbf.toml", PidRbf="_fmi3")

    def message(assignment: str) -> str:
        return refusal(tmp_path, "simulate", system, "--set", f"controller.{assignment}")

    assert (
        "controller.rbf.c: PidRbf_fmi3.fmu has no variable rbf.c; its elements are rbf.c[1] to"
        in (message("rbf.c=1"))
    )
    assert (
        "controller (PidRbf_fmi3.fmu), rbf.nodes = 17: fmi3SetUInt64 returned fmi3Error: rbf.nodes"
        in message("rbf.nodes=17")
    )
    both = ("--set", "controller.rbf.nodes=8", "--set", "controller.rbf.c[8]=3")
    assert (
        "controller.rbf.c[8] cannot be set without controller.rbf.c[5], for which the FMU has no"
        in refusal(tmp_path, "simulate", system, *both)
    )
    assert (
        "controller (PidRbf_fmi3.fmu), rbf.b[2] = -1.0: fmi3SetFloat64 returned fmi3Error: rbf.b[2]"
        in message("rbf.b[2]=-1")
    )


# --- types ----------------------------------------------------------------------------------------

DESCRIPTION = (ROOT / "tests" / "c" / "sums.xml").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def binary(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the binary of tests/c/sums.c."""
    return compiled(tmp_path_factory.mktemp("sums"), source="sums.c")


@pytest.fixture
def system(binary: bytes, tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes a system of Sums.fmu with changes to its model description."""

    def write(
        components: Mapping[str, Any],
        connections: list[str],
        *replaced: tuple[str, str],
        **settings: Any,
    ) -> Path:
        text = DESCRIPTION
        for old, new in replaced:
            assert old in text
            text = text.replace(old, new)
        with zipfile.ZipFile(tmp_path / "Sums.fmu", "w") as archive:
            archive.writestr("modelDescription.xml", text)
            archive.writestr("binaries/x86_64-linux/Sums.so", binary)
        file = write_system(tmp_path, components, connections, **settings)
        file.write_text(file.read_text().replace("Relay.fmu", "Sums.fmu"), encoding="utf-8")
        return file

    return write


START = {"u[1]": 7, "u[2]": 0, "u[3]": 0}


def test_values_of_all_types_are_converted(system, tmp_path):
    connections = ["a.n -> b.u[2]", "a.y -> b.x", "a.c -> b.b"]
    columns = simulate(system({"a": START | {"s[2]": "ab"}, "b": {}}, connections), tmp_path)
    # u[1] and u[3] of b keep their start values 1 and 3.
    final = {name: column[-1] for name, column in columns.items()}
    single = np.float32(0.1)
    assert final == {
        "time": 1,
        "a.n": 7, "a.y": 0.1, "a.c": 1,
        # The strings have 3 and 2 characters, with 5 in the description of the second.
        "a.k[1,1]": -23, "a.k[1,2]": -24, "a.k[2,1]": -25, "a.k[2,2]": -26,
        "b.n": 1 + 10 * 7 + 300, "b.y": float(str(single + single)), "b.c": 0,
        "b.k[1,1]": 0, "b.k[1,2]": -1, "b.k[2,1]": -2, "b.k[2,2]": -3,
    }  # fmt: skip


def test_elements_are_recorded_in_any_order_and_found_by_an_alias(system, tmp_path):
    file = system({"a": {"also[2]": 5}}, [], outputs=["a.k[2,1]", "a.n", "a.k[1,2]"])
    columns = simulate(file, tmp_path)
    assert {name: column[0] for name, column in columns.items()} == {
        "time": 0, "a.k[2,1]": -2, "a.n": 1 + 50 + 300, "a.k[1,2]": -1,
    }  # fmt: skip
    assert list(columns) == ["time", "a.k[2,1]", "a.n", "a.k[1,2]"]


def test_a_value_that_does_not_fit_the_type_of_an_input_is_an_error(system, tmp_path):
    file = system({"a": {}, "b": {}}, ["a.n -> b.u[2]"])
    message = run("simulate", file, cwd=tmp_path).stderr
    assert "b (Sums.fmu), u[2] = 321" in message
    assert "fmi3SetUInt8 cannot take the value 321" in message


def test_the_fmu_ends_the_simulation(system, tmp_path):
    message = run("simulate", system({"a": {"u[1]": 99}}, []), cwd=tmp_path).stderr
    assert "a (Sums.fmu), step of 0.25 s at t = 0.0 s: fmi3DoStep asked to end" in message


@pytest.mark.parametrize(
    ("replaced", "expected"),
    [
        (("<CoSimulation ", "<ScheduledExecution "), "not support co-simulation, only scheduled"),
        (("<CoSimulation ", "<ModelExchange "), "not support co-simulation, only model exchange"),
        (
            ('<Boolean name="b" valueReference="5"', '<Clock name="b" valueReference="5"'),
            "its clock b must be ticked by the master, which is not supported",
        ),
        (('fmiVersion="3.0"', 'fmiVersion="4.0"'), "of FMI version 4.0, expected 2.0 or 3.0"),
        (
            ('<Dimension start="3"/>', '<Dimension start="3000000"/>'),
            "its variables have 3000013 elements, expected at most 1048576",
        ),
    ],
)
def test_what_is_not_supported_is_named(system, tmp_path, replaced, expected):
    assert expected in refusal(tmp_path, "simulate", system({"a": {}}, [], replaced))


@pytest.mark.parametrize(
    ("components", "connections", "outputs", "expected"),
    [
        ({"u[1]": 256}, [], [], "a.u[1] = 256 is invalid; expected a whole number from 0 to 255"),
        ({"u[1]": -1}, [], [], "a.u[1] = -1 is invalid; expected a whole number from 0 to 255"),
        ({"x": "?"}, [], [], 'a.x = "?" is invalid; expected a number'),
        ({}, ["a.y -> a.u[1]"], [], "a.y (Float32) cannot feed a.u[1] (UInt8): the types differ"),
        ({}, ["a.n -> a.u"], [], "Sums.fmu has no variable u; its elements are u[1] to u[3]"),
        ({}, [], ["a.bytes"], "a.bytes cannot be recorded: variables of this type are"),
        ({}, [], ["a.s[1]"], "a.s[1] cannot be recorded: it is a String"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_named(system, tmp_path, components, connections, outputs, expected):
    file = system({"a": components}, connections, outputs=outputs)
    assert expected in refusal(tmp_path, "simulate", file)


def test_a_system_with_fmi_3_is_no_package_of_ssp_1(system, tmp_path):
    message = refusal(tmp_path, "ssp", system({"a": {}}, []))
    assert "Sums.fmu is of FMI 3.0, expected 2.0: SSP 1.0 has no arrays" in message
