"""Stiff equations: the implicit method of the master and of exported FMUs, and many events.

Published values are from the Test Set for Initial Value Problem Solvers (Mazzia, Magherini, 2008)
and, at 40 s, from the documentation of LSODE. FMPy integrates by CVODE of SUNDIALS, SciPy by Radau
IIA. `tests/c/rod.c` is an FMU of model exchange that counts its evaluations and events.
"""

import re
from collections.abc import Callable
from math import exp, pi, sin, sqrt
from pathlib import Path

import fmpy
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from native import compiled, pack, read, run, simulate, write, write_system
from pendulum_fmus.project import ROOT

IMPLICIT = ("--interface=model-exchange", "--solver=implicit")
G = 9.81


@pytest.fixture(scope="session")
def stiff(fmus: Path, export: Callable[..., Path]) -> Path:
    """Export the examples of stiff models for both versions; return their folder."""
    return export(ROOT / "target" / "examples", "--package", "stiff", "--fmi", "2.0,3.0")


def sundials(fmu: Path, tolerance: float, interval: float) -> np.ndarray:
    """Integrate an FMU by CVODE; return rows at multiples of an interval [s]."""
    options = {"relative_tolerance": tolerance, "output_interval": interval}
    return fmpy.simulate_fmu(fmu, fmi_type="ModelExchange", record_events=False, **options)


def robertson(_time: float, y: np.ndarray) -> list[float]:
    """Return the derivatives of the concentrations of Robertson's reaction."""
    first, second = 0.04 * y[0] - 1e4 * y[1] * y[2], 3e7 * y[1] ** 2
    return [-first, first - second, second]


@pytest.mark.parametrize("ending", ["", "_fmi3"])
def test_a_reaction_has_its_published_concentrations(stiff, ending, tmp_path):
    fmu = stiff / f"Robertson{ending}.fmu"
    exchanged = simulate(fmu, tmp_path, *IMPLICIT)
    stepped = simulate(fmu, tmp_path, "--interface=co-simulation")
    cvode = sundials(fmu, 1e-6, 0.4)
    for name, value in {"a": 7.158e-1, "b": 9.186e-6, "c": 2.842e-1}.items():
        assert exchanged[name][-1] == pytest.approx(value, rel=2e-4)
        assert exchanged[name] == pytest.approx(cvode[name], rel=1e-3, abs=1e-8)
        # The FMU and the master have the same solver.
        assert exchanged[name].tobytes() == stepped[name].tobytes()
    options = ("--stop=1e11", "--step=1e11", "--tolerance=1e-11")
    last = simulate(fmu, tmp_path, *options, *IMPLICIT)
    for name, value in {"a": 0.2083340149701255e-7, "b": 0.8333360770334713e-13}.items():
        assert last[name][-1] == pytest.approx(value, rel=1e-2)


def test_a_reaction_without_a_step_has_rows_at_the_steps_of_the_solver(stiff, tmp_path):
    files = read(stiff / "Robertson.fmu")
    xml = re.sub(r' stepSize="\S+"', "", files["modelDescription.xml"].decode())
    files["modelDescription.xml"] = re.sub(r'stopTime="\S+"', 'stopTime="1e8"', xml).encode()
    fmu = write(tmp_path / "Robertson.fmu", files)
    rows = simulate(fmu, tmp_path, *IMPLICIT)
    times = rows["time"]
    assert np.all(np.diff(times) > 0)
    assert 0 < times[1] < 1e-2
    assert np.isin(np.arange(501) * 2e5, times).all()
    assert 50 < np.sum(times < 2e5) < 300
    within = times[(times > 0) & (times < 2e5)]
    exact = solve_ivp(
        robertson, (0, 2e5), [1, 0, 0], "Radau", within, rtol=1e-9, atol=[1e-12, 1e-16, 1e-12]
    )
    for name, values in zip("abc", exact.y, strict=True):
        found = rows[name][(times > 0) & (times < 2e5)]
        assert found == pytest.approx(values, rel=1e-4, abs=1e-9), name
    # With a step, rows are where it says. One that is longer than the run is of no use.
    assert len(simulate(fmu, tmp_path, *IMPLICIT, "--step=1e6")["time"]) == 101
    assert len(simulate(fmu, tmp_path, "--interface=co-simulation", "--stop=40")["time"]) == 501


def test_an_oscillator_with_relaxation_has_its_published_solution(equations, tmp_path):
    """By its directional derivatives."""
    options = ("--set=mu=1000", "--stop=2000", "--step=20", "--tolerance=1e-9")
    rows = simulate(equations / "VanDerPol.fmu", tmp_path, *options, *IMPLICIT)
    assert rows["x0"][-1] == pytest.approx(1.706167732170469, abs=1e-6)
    assert rows["x1"][-1] == pytest.approx(-0.8928097010248125e-3, abs=1e-8)


def test_a_stiff_contact_is_an_event_where_it_happens(stiff, tmp_path):
    fmu = stiff / "Contact.fmu"
    rows = simulate(fmu, tmp_path, *IMPLICIT, "--tolerance=1e-8")
    assert rows["x"].tobytes() == simulate(fmu, tmp_path, "--tolerance=1e-8")["x"].tobytes()
    closed = rows["time"][rows["closed"] > 0]
    assert closed[0] == pytest.approx(sqrt(2 / G), abs=0.01)
    falls = rows["closed"] == 0
    assert rows["x"][falls] == pytest.approx(1 - G * rows["time"][falls] ** 2 / 2, abs=1e-7)
    # From the contact on, without events: the mass does not leave the spring.
    start = sqrt(2 / G)

    def contact(_time, y):
        return [y[1], -1e8 * y[0] - 1e6 * y[1] - G]

    kept = solve_ivp(contact, (start, 1), [0, -G * start], "Radau", closed, rtol=1e-10, atol=1e-14)
    assert rows["x"][~falls] == pytest.approx(kept.y[0], abs=1e-10)
    assert rows["x"][-1] == pytest.approx(-G / 1e8, rel=1e-6)
    cvode = sundials(fmu, 1e-8, 0.01)
    assert rows["x"] == pytest.approx(cvode["x"], abs=1e-6)


def test_too_many_explicit_steps_name_the_implicit_solver(stiff, tmp_path):
    run_ = ("simulate", stiff / "Robertson.fmu", "--interface=model-exchange", "--stop=1e8")
    refused = run(*run_, "--step=1e8")
    assert refused.returncode == 1
    assert "more than 100000 internal steps" in refused.stderr
    assert "; if the equations are stiff, --solver implicit needs fewer" in refused.stderr


def test_a_component_or_a_system_chooses_the_solver(stiff, tmp_path):
    (tmp_path / "Robertson.fmu").write_bytes((stiff / "Robertson.fmu").read_bytes())
    common = {"interface": "model-exchange"}
    chosen = [
        ({**common, "solver": "implicit"}, {}, ()),
        (common, {"solver": "implicit"}, ()),
        ({**common, "solver": "explicit"}, {}, ("--solver=implicit",)),
        (common, {}, ()),
    ]
    columns = [
        simulate(
            write_system(tmp_path, {"r": {}}, (), "Robertson", own, **system), tmp_path, *options
        )["r.b"].tobytes()
        for own, system, options in chosen
    ]
    assert columns[0] == columns[1] == columns[2] != columns[3]
    system = write_system(tmp_path, {"r": {}}, (), "Robertson", common, solver="cvode")
    refused = run("simulate", system)
    assert refused.returncode == 1
    assert "unknown variant `cvode`, expected `explicit` or `implicit`" in refused.stderr


# --- a rod with sparse equations and many events --------------------------------------------------

N = 30


def rod(folder: Path, *definitions: str, dependencies: bool = True) -> Path:
    """Write the FMU of a rod, which may declare on which states its derivatives depend."""
    states = range(1, N + 1)

    def neighbours(i: int) -> str:
        known = " ".join(str(j) for j in (i - 1, i, i + 1) if j in states)
        return f' dependencies="{known}"' if dependencies else ""

    variables = [f'<Float64 name="x{i}" valueReference="{i}" causality="output"/>' for i in states]
    variables += [
        f'<Float64 name="der{i}" valueReference="{N + i}" derivative="{i}"/>' for i in states
    ]
    variables += [
        f'<Int32 name="{name}" valueReference="{reference}" causality="output"/>'
        for name, reference in (("evaluations", 2 * N + 1), ("events", 2 * N + 2))
    ]
    structure = [f'<Output valueReference="{i}"/>' for i in (*states, 2 * N + 1, 2 * N + 2)]
    structure += [
        f'<ContinuousStateDerivative valueReference="{N + i}"{neighbours(i)}/>' for i in states
    ]
    xml = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Rod" instantiationToken="{{rod}}">
  <ModelExchange modelIdentifier="Rod" needsCompletedIntegratorStep="true"/>
  <DefaultExperiment startTime="0" stopTime="1" stepSize="1"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    {" ".join(variables)}
  </ModelVariables>
  <ModelStructure>{" ".join(structure)}</ModelStructure>
</fmiModelDescription>"""
    return pack(folder / "Rod.fmu", xml, compiled(folder, *definitions, source="rod.c"))


def is_cooled(rows: dict[str, np.ndarray]) -> bool:
    """Return whether the rod has its temperatures after 1 s."""
    last = [rows[f"x{i}"][-1] for i in range(1, N + 1)]
    exact = [sin(pi * i / (N + 1)) * exp(-1) for i in range(1, N + 1)]
    return last == pytest.approx(exact, abs=1e-5)


def test_states_that_change_different_derivatives_are_varied_together(tmp_path):
    """The three groups of a tridiagonal Jacobian take a tenth of the evaluations of 30 states."""
    counts = {}
    for declared in (True, False):
        rows = simulate(rod(tmp_path, dependencies=declared), tmp_path, "--solver=implicit")
        assert is_cooled(rows)
        counts[declared] = rows["evaluations"][-1]
    # Each internal step has 9 other evaluations.
    assert counts[True] / counts[False] == pytest.approx((3 + 9) / (30 + 9), rel=0.1)


@pytest.mark.parametrize("solver", ["explicit", "implicit"])
def test_an_fmu_may_ask_for_an_event_after_each_internal_step(solver, tmp_path):
    option = f"--solver={solver}"
    plain = simulate(rod(tmp_path), tmp_path, option)
    rows = simulate(rod(tmp_path, "EVERY_STEP=1"), tmp_path, option)
    assert is_cooled(rows)
    assert rows["events"][-1] > 3
    # An event that changes nothing costs one evaluation.
    assert rows["evaluations"][-1] == pytest.approx(
        plain["evaluations"][-1] + rows["events"][-1], rel=0.01
    )


def test_a_step_may_have_any_number_of_events(tmp_path):
    """Also if a thousand of them take less than a ten-thousandth of it."""
    rows = simulate(rod(tmp_path, "PERIOD=5e-5"), tmp_path)
    assert is_cooled(rows)
    assert rows["events"][-1] == 20_000
    many = simulate(rod(tmp_path, "PERIOD=5e-5"), tmp_path, "--stop=10", "--step=10")
    assert many["events"][-1] == 200_000
