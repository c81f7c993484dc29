"""What engineers do with the module: the example test suite, linearization, comparison, tuning."""

import dataclasses
import math
import re
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from lxml import etree

import fmu_master.linear
import reference
from fmu_master import FmuError, System, compare, simulate
from fmu_master.linear import Linear, linearize
from fmu_master.testing import assert_carries
from fmu_master.tuning import Tuned, tune
from native import LOOPS, SOURCES, in_c, replaced
from pendulum_fmus.project import ROOT

# --- the example test suite -----------------------------------------------------------------------

ANGLE, FORCE = '"plant.theta -> controller.y"', '"controller.u -> plant.u"'
TO_Y, TO_U = 'from = "plant.theta", to = "controller.y"', 'from = "controller.u", to = "plant.u"'
GAINS = "previous_sample_terms = true"

PLANTED = {
    "nothing": ({}, ""),
    "a wrong gain of the sensor": (
        {ANGLE: f"{{ {TO_Y}, faults = [{{ gain = 1.02 }}] }}"},
        "plant.theta -> controller.y: the gain is wrong: 1.02, expected 1",
    ),
    "a swapped sign": (
        {FORCE: f"{{ {TO_U}, faults = [{{ gain = -1 }}] }}"},
        "controller.u -> plant.u: the sign is swapped: -1, expected 1",
    ),
    "a late sample": (
        {ANGLE: f"{{ {TO_Y}, faults = [{{ delay = 0.001 }}] }}"},
        "plant.theta -> controller.y: the value arrives 0.001 s late (rows: 1), expected 0 s",
    ),
    "noise": (
        {ANGLE: f"{{ {TO_Y}, faults = [{{ noise = 1e-6, start = 2 }}] }}"},
        "arrives at t = 2 s, expected ",
    ),
    "a wrong gain of the controller": (
        {GAINS: f"{GAINS}, 'pid.kp' = 330.0"},
        "the first force is 10.033 N, expected 10.0301 N for these gains",
    ),
    "a longer pendulum": (
        {'name = "plant"': 'name = "plant"\nstart = { l = 25.0 }'},
        "plant.theta is 0.000120046 at t = 0.428 s and 0.000148065 at t = 0.761 s, expected from",
    ),
}
"""Changes of the good loop, and what the suite says of each."""


@pytest.mark.parametrize("fault", PLANTED)
def test_the_example_suite_finds_and_explains_planted_faults(
    fmus, tmp_path, monkeypatch, capfd, fault
):
    changes, message = PLANTED[fault]
    text = (LOOPS / "pid.toml").read_text(encoding="utf-8")
    text = replaced(text, {"../../target/fmu": fmus.as_posix()} | changes)
    system = tmp_path / "system.toml"
    system.write_text(text, encoding="utf-8")
    monkeypatch.chdir(ROOT)
    suite = ["-p", "no:cacheprovider", "--import-mode=importlib", "examples/testing"]
    code = pytest.main([*suite, f"--system={system}"])
    said = capfd.readouterr().out
    assert code == bool(message), said
    assert message in said


@pytest.mark.parametrize(
    ("gain", "rows", "message"),
    [
        (1 + 5e-7, 0, "a -> b: the gain is wrong: 1.0000005, expected 1"),
        (1.0, 5, "a -> b: the result has 5 rows, expected more than 5"),
        (1.0, 6, "a -> b: the result has 5 rows, expected more than 6"),
    ],
)
def test_what_a_signal_that_does_not_arrive_lacks_is_said(gain, rows, message):
    sent = np.arange(5.0)
    with pytest.raises(AssertionError, match=f"^{re.escape(message)}$"):
        assert_carries({"time": sent, "a": sent, "b": gain * sent}, "a", "b", rows=rows)


FALL = {"stop_time": 0.5, "step_size": 0.01, "start_values": {"theta0": 0.1}}
"""A run of the pendulum."""

# --- comparison -----------------------------------------------------------------------------------


def test_compare_names_and_draws_the_first_planted_difference(fmus, tmp_path):
    run, other = (simulate(fmus / f"Pendulum{end}.fmu", **FALL) for end in ("", "_fmi3"))
    assert compare(run, other).is_same
    file = tmp_path / "run.csv"
    np.savetxt(file, np.column_stack(list(run.values())), delimiter=",", header=",".join(run))
    file.write_text(file.read_text().removeprefix("# "))
    assert str(compare(file, run)) == "the same within the tolerance"
    planted = {name: column.copy() for name, column in run.items()}
    planted["x"][30] += 1e-3
    planted["theta"][20] *= 1.001
    found = compare(run, planted)
    names, values = [d.name for d in found.differences], found.differences[0].values
    assert names == ["theta", "x"]
    assert values == (run["theta"][20], planted["theta"][20])
    assert found.differences[0].time == run["time"][20]
    first, second = str(found).splitlines()
    assert first.startswith(
        f"theta differs at t = 0.2 s: {values[0]} in the reference, {values[1]} in the results; "
    )
    assert float(first.split()[-1]) == pytest.approx(1e-6 * run["theta"].max(), rel=1e-3)
    assert second == f"different: 2 of {len(run) - 1} variables: theta, x"
    assert compare(run, planted, absolute=1e-2).is_same
    assert compare(run.to_pandas(), run).is_same
    lines = found.plot().axes[0].lines
    assert [line.get_ydata()[20] for line in lines[:2]] == list(values)
    assert lines[2].get_xdata() == [run["time"][20]] * 2
    short = {"time": [0.0, 1.0], "a": [1.0]}
    for tables, options, message in (
        ((run, {"time": run["time"], "theta": run["theta"]}), {}, "the second has no variable ome"),
        ((run, other), {"hold": "omeg"}, "hold: the reference has no variable omeg"),
        ((run, tmp_path / "a.csv"), {}, "a.csv cannot be read: No such file"),
        ((run, other), {"relative": np.nan}, "the relative tolerance is NaN, expected"),
        ((short, short), {}, "a has 1 values, expected 2, as time has"),
    ):
        with pytest.raises(FmuError, match=message):
            compare(*tables, **options)


# --- tuning ---------------------------------------------------------------------------------------

ORDER = [2, 3, 0, 1]
"""The states theta, omega, x and v of the FMU among those of the reference."""

PLANT = reference.linear_model()[0][np.ix_(ORDER, ORDER)]
FORCE_ON_PLANT = reference.linear_model()[1][ORDER, None]
"""The linear plant (9) with these states."""

SECONDS = 0.2
"""The length of the runs that are tuned [s]."""


def tuned(fmus: Path, **options) -> Tuned:
    """Find the angle at the start from which the pendulum falls to 0.05 rad."""
    plant = System(
        components={"plant": fmus / "Pendulum.fmu"}, connections=[], step=0.01, stop=SECONDS
    )
    given = {"seed": 3, "generations": 6, "output": ["plant.theta"], "in_process": True}
    return tune(
        plant,
        {"plant.theta0": (0.01, 0.1)},
        lambda results: abs(results[0]["plant.theta"][-1] / 0.05 - 1),
        **given | options,
    )


def test_tune_finds_the_parameter_of_the_closed_form(fmus, tmp_path, monkeypatch):
    expected = 0.05 / scipy.linalg.expm(PLANT * SECONDS)[0, 0]
    journal = tmp_path / "search.journal"
    whole = tuned(fmus, journal=journal)
    assert whole.values["plant.theta0"] == pytest.approx(expected, rel=0.05)
    # An interrupted search goes on where it was, from an incomplete line.
    lines = journal.read_text(encoding="utf-8").splitlines(keepends=True)
    journal.write_text("".join([*lines[:40], lines[40][:20]]), encoding="utf-8")
    # As a full disk, on which the FMU that is checked before is.
    monkeypatch.setattr(System, "_check", lambda *_, **__: None)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    with pytest.raises(OSError, match="too large"):
        tuned(fmus, journal=journal)
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert journal.read_text(encoding="utf-8").startswith("".join(lines[:40]))
    assert tuned(fmus, journal=journal) == whole
    # Equal candidates that are simulated at the same time are noted twice.
    assert set(journal.read_text(encoding="utf-8").splitlines(keepends=True)) == set(lines)
    with pytest.raises(ValueError, match="is the journal of another search"):
        tuned(fmus, journal=journal, seed=4)


def test_a_journal_fits_only_the_same_fmus_and_its_damage_is_found(fmus, tmp_path):
    fmu, journal = tmp_path / "Pendulum.fmu", tmp_path / "search.journal"
    shutil.copy(fmus / "Pendulum.fmu", fmu)
    tuned(tmp_path, journal=journal, generations=0)
    with journal.open("a", encoding="utf-8") as file:
        file.write("garbage\n")
    with pytest.raises(ValueError, match=r"search\.journal:\d+: 'garbage', expected parameters"):
        tuned(tmp_path, journal=journal, generations=0)
    shutil.copy(fmus / "Pendulum_fmi3.fmu", fmu)
    with pytest.raises(ValueError, match="is the journal of another search"):
        tuned(tmp_path, journal=journal, generations=0)


def test_tune_says_what_no_run_can_have_and_why_all_fail(fmus, tmp_path):
    all_fail = {"cases": [{"plant.M": -1.0}], "journal": tmp_path / "search.journal"}
    for options, message in (
        ({"cases": [{}, {"plant.m0": 1.0}]}, "has no variable m0"),
        ({"plants": [{"plant.dynamics": 1.0}]}, 'plant.dynamics = "1.0" is invalid'),
        ({"output": "plant.y"}, "has no variable y"),
        ({"cases": []}, "expected at least one parameter and one case"),
        *[(all_fail, "all runs fail, such as that with .*: plant .*, M = -1.0: .* is refused")] * 2,
    ):
        with pytest.raises((FmuError, ValueError), match=message):
            tuned(fmus, generations=0, **options)


def test_tune_does_not_depend_on_the_number_of_cores(fmus, monkeypatch):
    first = tuned(fmus, generations=1)
    monkeypatch.setattr("os.cpu_count", lambda: 7)
    assert tuned(fmus, generations=1) == first


def test_tune_finds_only_what_all_plants_accept(fmus):
    # The heavier cart does not change that a larger angle is farther away.
    limit = 0.03
    found = tuned(
        fmus,
        plants=[{"plant.M": 2.0}],
        accepts=lambda result: result["plant.theta"][-1] <= limit,
        guess={"plant.theta0": 0.01},
    )
    start = {"theta0": found.values["plant.theta0"], "M": 2.0}
    options = {"step_size": 0.01, "stop_time": SECONDS, "start_values": start}
    reached = simulate(fmus / "Pendulum.fmu", **options)["theta"][-1]
    assert 0.9 * limit < reached <= limit
    for guess in (2.0, None):
        message = rf"plant.theta0: the guess {guess} is not from 0.01 to 0.1"
        with pytest.raises(ValueError, match=message):
            tuned(fmus, guess={"plant.theta0": guess} if guess else {})


def test_tune_takes_an_fmu_and_values_of_numpy(fmus, tmp_path):
    given = {"cases": [{"rbf.w0": np.zeros(4), "r": np.float32(0.1)}], "output": ["u"]}
    given |= {"generations": 0, "stop_time": 0.01, "in_process": True}
    given |= {"objective": lambda results: abs(results[0]["u"][-1] - 20.0)}
    searches = [
        tune(fmus / "PidRbf_fmi3.fmu", {"pid.kp": (100.0, 300.0)}, journal=journal, **given)
        for journal in (None, tmp_path / "search.journal", tmp_path / "search.journal")
    ]
    assert searches == searches[:1] * 3
    given["objective"] = lambda results: "no number"
    with pytest.raises(ValueError, match="could not convert string to float: 'no number'"):
        tune(fmus / "PidRbf_fmi3.fmu", {"pid.kp": (100.0, 300.0)}, **given)


FOUND = ROOT / "python" / "pendulum_fmus" / "report" / "gains.toml"
SCRIPT = ROOT / "examples" / "tuning" / "gains.py"


def test_the_gains_of_the_report_are_what_the_example_finds(fmus, tmp_path):
    out = tmp_path / "gains.toml"
    command = [sys.executable, SCRIPT, "pid-rbf", "--out", out, "--journal", tmp_path]
    subprocess.run(command, check=True, capture_output=True)
    expected = FOUND.read_text(encoding="utf-8").split("[ipid-rbf]")[0]
    assert out.read_text(encoding="utf-8") == expected
    assert (tmp_path / "pid-rbf.journal").exists()


def test_the_script_draws_the_pictures_of_the_page(fmus, tmp_path):
    command = [sys.executable, ROOT / "docs" / "pictures.py", tmp_path]
    subprocess.run(command, check=True, capture_output=True)
    page = (ROOT / "docs" / "engineering.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"\]\((\S+\.svg)\)", page))
    assert {file.name for file in tmp_path.iterdir()} == shown
    for name in shown:
        # The texts and the number of the curves; digits of the curves may differ between versions.
        drawn, kept = (etree.parse(folder / name) for folder in (tmp_path, ROOT / "docs"))
        assert [e.text for e in drawn.iter("{*}text")] == [e.text for e in kept.iter("{*}text")]
        assert len(list(drawn.iter("{*}path"))) == len(list(kept.iter("{*}path"))) > 10


# --- linearization --------------------------------------------------------------------------------


@pytest.mark.parametrize("fmu", ["Pendulum", "Pendulum_fmi3"])
def test_linearize_gives_the_linear_plant(fmus, fmu):
    model = linearize(fmus / f"{fmu}.fmu", outputs=["theta"])
    assert model.states == ("theta", "omega", "x", "v")
    assert (model.inputs, model.outputs, model.time) == (("u",), ("theta",), 0)
    np.testing.assert_allclose(model.A, PLANT, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(model.B, FORCE_ON_PLANT, rtol=1e-12)
    np.testing.assert_array_equal(model.C, [[1, 0, 0, 0]])
    np.testing.assert_array_equal(model.D, [[0]])
    expected = sorted(np.roots([1, *np.poly(PLANT)[1:]]).real, reverse=True)
    np.testing.assert_allclose(model.poles, expected, atol=1e-6)


def test_linearize_at_a_point_of_a_run_differentiates_the_nonlinear_plant(fmus, monkeypatch):
    """With the force 2 N, the Jacobian of (7), (8) at the state that SciPy integrates."""
    start = {"theta0": 0.3, "dynamics": "nonlinear"}
    options = {"start_values": start, "input": {"u": lambda t: 2.0}, "outputs": ["theta", "v"]}
    model = linearize(fmus / "Pendulum.fmu", 0.4, **options)
    state, h = reference.integrate([0, 0, 0.3, 0], 2.0, 0.4), 1e-6

    def slope(change: np.ndarray, u: float = 0.0) -> np.ndarray:
        low, high = (reference.derivatives(state + s * change, 2.0 + s * u) for s in (-h, h))
        return ((high - low) / (2 * h))[ORDER]

    A = np.column_stack([slope(unit) for unit in np.eye(4)[ORDER]])
    np.testing.assert_allclose(model.A, A, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(model.B[:, 0], slope(np.zeros(4), 1.0), rtol=1e-5)
    assert model.time == pytest.approx(0.4)
    assert linearize(fmus / "Pendulum.fmu", 0.4, step_size=0.3).time == pytest.approx(0.4)
    # Without directional derivatives, from differences.
    monkeypatch.setattr("fmu_master.linear._directional", fmu_master.linear._differences)
    other = linearize(fmus / "Pendulum.fmu", 0.4, **options)
    np.testing.assert_allclose(other.A, model.A, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(other.B, model.B, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(other.C, model.C, atol=1e-9)
    options["input"] = {"u": lambda t: 20 * t}
    fine, coarse = (
        linearize(fmus / "Pendulum.fmu", 0.4, **options, step_size=h).A for h in (1e-3, 0.01)
    )
    np.testing.assert_allclose(coarse, fine, rtol=1e-3, atol=1e-3)


def test_what_does_not_fit_a_linear_model_is_named(fmus):
    for options, message in (
        ({"inputs": ["theta"]}, "theta has the causality output, expected an input"),
        ({"time": -1.0}, r"time = -1.0, expected at least 0 s"),
        ({"time": 1.0, "step_size": 0.0}, "step_size = 0.0, expected a positive number"),
        ({"tolerance": math.nan}, "tolerance = nan, expected a positive number"),
    ):
        with pytest.raises((FmuError, ValueError), match=message):
            linearize(fmus / "Pendulum.fmu", **options)


def test_the_linear_model_reaches_scipy_and_python_control(fmus):
    model = linearize(fmus / "Pendulum.fmu", outputs=["theta"])
    frequency = 3.0
    # (40), without its s = 0
    numerator = FORCE_ON_PLANT[1, 0] * 1j * frequency
    expected = numerator / np.polyval(np.poly(PLANT)[:4], 1j * frequency)
    of_scipy = model.to_scipy()
    response = of_scipy.C @ np.linalg.solve(1j * frequency * np.eye(4) - of_scipy.A, of_scipy.B)
    assert response[0, 0] == pytest.approx(expected, rel=1e-9)
    assert model.to_control()(1j * frequency) == pytest.approx(expected, rel=1e-9)
    assert model.bode([0.1, 1.0, 10.0]).axes


def test_margins_are_those_of_the_closed_form():
    """The phase of 10 / (s (s + 1) (s + 5)) is -180 degrees at the square root of 5."""
    A = np.array([[0, 1, 0], [0, 0, 1], [0, -5, -6]])
    names = (("x1", "x2", "x3"), ("u",), ("y",))
    loop = Linear(A, np.array([[0], [0], [10]]), np.eye(3)[:1], np.zeros((1, 1)), *names, 0.0)
    gain, phase, at_180, at_1 = loop.margins()
    assert (gain, at_180) == pytest.approx((3, 5**0.5))
    response = 10 / (1j * at_1 * (1j * at_1 + 1) * (1j * at_1 + 5))
    assert abs(response) == pytest.approx(1)
    assert phase == pytest.approx(np.degrees(np.angle(-response)))
    two = dataclasses.replace(loop, B=np.zeros((3, 2)), inputs=("u", "d"))
    with pytest.raises(ValueError, match="inputs: 2, outputs: 1, expected one of each"):
        two.margins()


def test_linearize_gives_the_loop_of_the_linear_plant_and_a_pid(fmus):
    """The PID sums e, then u = kp e + ki x3 + kd (e - e_before) / h, which the plant holds."""
    h, kp, ki, kd = 1e-3, 300.0, 500.0, 100.0
    loop = System(
        components={"controller": fmus / "Pid.fmu", "plant": fmus / "Pendulum.fmu"},
        connections=["plant.theta -> controller.y", "controller.u -> plant.u"],
        step=h,
        stop=2.0,
    )
    names = {"inputs": ["controller.r", "plant.u"], "outputs": ["plant.theta", "controller.u"]}
    model = linearize(loop, 0.1, **names)
    held = scipy.linalg.expm(np.block([[PLANT, FORCE_ON_PLANT], [np.zeros((1, 5))]]) * h)
    A, B, angle = held[:4, :4], held[:4, 4:], np.array([[1, 0, 0, 0]])
    direct = kp + ki * h + kd / h
    force = np.hstack([-direct * angle, [[-kd / h, ki]]])
    F = np.zeros((6, 6))
    F[:4] = np.hstack([A, np.zeros((4, 2))]) + B @ force
    F[4, :4], F[5, :4], F[5, 5] = -angle, -h * angle, 1
    G = np.vstack([np.hstack([B * direct, B]), [[1, 0], [h, 0]]])
    C = np.vstack([np.hstack([angle, np.zeros((1, 2))]), force])

    def response(A, B, C, D, frequency):
        z = np.exp(1j * frequency * h)
        return C @ np.linalg.solve(z * np.eye(len(A)) - A, B) + D

    assert (model.step, model.time) == (h, pytest.approx(0.1))
    for frequency in (0.3, 3, 30, 300):
        expected = response(F, G, C, [[0, 0], [direct, 0]], frequency)
        found = response(model.A, model.B, model.C, model.D, frequency)
        np.testing.assert_allclose(found, expected, rtol=1e-6)
        assert model.to_control()(np.exp(1j * frequency * h)) == pytest.approx(found)
    # The angle does not show the position of the cart.
    poles = np.log(np.linalg.eigvals(F).astype(complex)) / h
    assert len(model.poles) == 5
    assert all(np.min(np.abs(poles - pole)) < 1e-4 * max(1, abs(pole)) for pole in model.poles)
    free = System({**loop.description, "connections": [], "stop": 0.1})
    ends = {"inputs": ["plant.u"], "outputs": ["plant.theta"], "tolerance": 1e-4}
    for force in (0.0, 1.0):
        plant = linearize(free, start_values={"plant.u": force}, **ends)
        np.testing.assert_allclose(plant.C @ plant.B, angle @ B, rtol=1e-4)
    with pytest.raises(
        FmuError, match=r"does not respond to controller\.r in proportion to pulses"
    ):
        linearize(loop, deviation=1e-3, **names)  # the force is limited to 100 N
    # Only the integral of e is in proportion.
    with pytest.raises(FmuError, match=r"plant\.theta does not respond to controller\.r in prop"):
        linearize(loop, deviation=100.0, inputs="controller.r", outputs="plant.theta")
    with pytest.raises(ValueError, match="deviation = 0, expected a positive number"):
        linearize(loop, deviation=0, **names)
    start = {"plant.theta0": 0.3, "plant.dynamics": "nonlinear"}
    with pytest.raises(FmuError, match=r"differ by .* from those of a linear model"):
        linearize(loop, start_values=start, inputs=["plant.u"], outputs=["plant.theta"])


def valve(folder: Path, low: float, high: float) -> Path:
    """Write an FMU with x' = u - sqrt(x) and y = x + u^2 that refuses u outside its bounds."""
    xml = (SOURCES / "valve.xml").read_text(encoding="utf-8")
    xml = replaced(xml, {'min="0" max="1"': f'min="{low}" max="{high}"'})
    return in_c(folder / "Valve.fmu", f"LOW={low}", f"HIGH={high}", xml=xml)


@pytest.mark.parametrize(
    ("low", "high", "u"),
    [(0, 1, 0.0), (0, 1, 1.0), (0, 1, 1e-6), (0.1, 0.3, 0.2), (0, 1e-9, 0.0), (0, 1e-9, 5e-10)],
)
@pytest.mark.parametrize("x", [0.001, 1e-6])
def test_linearize_keeps_to_the_bounds_of_inputs_and_states(tmp_path, low, high, u, x):
    model = linearize(valve(tmp_path, low, high), start_values={"x": x, "u": u})
    assert model.A.item() == pytest.approx(-0.5 / math.sqrt(x), rel=1e-4)
    assert model.B.item() == pytest.approx(1, rel=1e-6)
    assert model.C.item() == pytest.approx(1, rel=1e-6)
    assert model.D.item() == pytest.approx(2 * u, rel=1e-6, abs=1e-9)


def test_linearize_of_an_input_that_cannot_vary_says_so(tmp_path):
    with pytest.raises(FmuError, match=r"u can only be 0\.5, expected a range from `min`"):
        linearize(valve(tmp_path, 0.5, 0.5), start_values={"u": 0.5})


@pytest.mark.parametrize(("low", "high"), [(1, 2), (0, 1), (1, 1.00002), (0.99999, 1.00001)])
def test_linearize_of_a_system_keeps_to_the_bounds_of_inputs(tmp_path, low, high):
    """At x = u = 1, x' = u - x / 2 is held for steps of 0.1 s."""
    component = {"fmu": valve(tmp_path, low, high), "start": {"x": 1.0, "u": 1.0}}
    system = System(components={"v": component}, step=0.1, stop=2.0, tolerance=1e-10)
    model = linearize(system, inputs="v.u", outputs="v.y", tolerance=1e-4)
    assert model.poles.real == pytest.approx([-0.5], rel=1e-4)
    assert model.D.item() == pytest.approx(2, rel=1e-4)
    assert (model.C @ model.B).item() == pytest.approx(2 - 2 * math.exp(-0.05), rel=1e-4)
