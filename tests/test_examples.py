"""The examples: an FMU in plain C, a sensor, and models with equations."""

import subprocess
import sys
from math import exp, inf, log, sqrt
from pathlib import Path

import fmpy
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from native import ROOT, read, run, simulate

OWN = ROOT / "examples" / "own-fmu"


@pytest.fixture(scope="module")
def own_fmu() -> Path:
    """Build the FMU in plain C as documented."""
    subprocess.run([sys.executable, OWN / "build.py"], check=True, stdout=subprocess.DEVNULL)
    return ROOT / "target" / "own-fmu" / "CPid.fmu"


def test_the_examples_are_valid(own_fmu: Path, sensor: Path, equations: Path, fmus: Path) -> None:
    """To stay short, the FMU in C accepts wrong calls, which the validator warns about."""
    names = ("BouncingBall", "BouncingBall_fmi3", "VanDerPol", "VanDerPol_fmi3")
    files = [sensor, *(equations / f"{name}.fmu" for name in names)]
    assert "no error, " in run("validate", own_fmu).stdout
    assert run("validate", "--quick", *files).stdout.count("no error, no warning") == len(files)
    assert not (fmus / sensor.name).exists(), "it is no default member of the workspace"


def test_the_pid_in_c_gives_the_same_bits(own_fmu: Path, fmus: Path, tmp_path: Path) -> None:
    folders = [tmp_path / "c", tmp_path / "rust"]
    for folder in folders:
        folder.mkdir()
    in_c = simulate(OWN / "system.toml", folders[0])
    loop = ROOT / "examples" / "closed-loop" / "pid.toml"
    ours = simulate(loop, folders[1], "--set", "controller.previous_sample_terms=false")
    for name, values in in_c.items():
        assert values.tobytes() == ours[name].tobytes(), name


# --- models with equations ------------------------------------------------------------------------

CS, ME = {"fmi_type": "CoSimulation"}, {"fmi_type": "ModelExchange"}
KINDS = {
    "FMI 2.0 CS": ("", CS),
    "FMI 2.0 CS, native master": ("", "co-simulation"),
    "FMI 2.0 ME": ("", ME),
    "FMI 2.0 ME, native master": ("", "model-exchange"),
    "FMI 3.0 CS": ("_fmi3", CS),
    "FMI 3.0 CS with events": (
        "_fmi3",
        CS | {"use_event_mode": True, "early_return_allowed": True},
    ),
    "FMI 3.0 ME": ("_fmi3", ME),
    "FMI 3.0 ME, native master": ("_fmi3", "model-exchange"),
}


@pytest.fixture(scope="module", params=KINDS.values(), ids=KINDS)
def simulated(request, equations: Path, tmp_path_factory):
    """Return a function that simulates a model with FMPy, or the native master."""
    ending, options = request.param

    def call(model: str, start_values: dict[str, float] | None = None, input=None, **more: float):
        fmu = equations / f"{model}{ending}.fmu"
        if isinstance(options, dict):
            more |= options
            return fmpy.simulate_fmu(fmu, start_values=start_values or {}, input=input, **more)
        folder = tmp_path_factory.mktemp("native")
        sets = [f"--set={name}={value}" for name, value in (start_values or {}).items()]
        sets += [f"--tolerance={tolerance}" for tolerance in more.values()]
        if input is not None:
            fmpy.util.write_csv(folder / "input.csv", input)
            sets += ["--input", folder / "input.csv"]
        return simulate(fmu, folder, f"--interface={options}", *sets)

    return call


def height(times: np.ndarray, g: float = 9.81, e: float = 0.7) -> np.ndarray:
    """Return the height [m] of a ball that falls 1 m, and rests if it rises slower than 0.1 m/s."""
    heights, start, v = 1 - g * times**2 / 2, sqrt(2 / g), e * sqrt(2 * g)
    while v > 0.1:
        since = times - start
        heights = np.where(since < 0, heights, v * since - g * since**2 / 2)
        start, v = start + 2 * v / g, e * v
    return np.where(times < start, heights, 0)


def test_a_ball_bounces_until_it_rests(simulated) -> None:
    result = simulated("BouncingBall", relative_tolerance=1e-9)
    assert result["h"] == pytest.approx(height(result["time"]), abs=1e-6)
    assert result["v"][-1] == 0


def test_a_counter_counts_at_its_events(simulated) -> None:
    """At an event, the result may have the value before it, after it or both."""
    result = simulated("Stair")
    seconds = np.floor(result["time"] + 1e-9) + 1
    at_event = abs(result["time"] - np.round(result["time"])) < 1e-9
    assert np.array_equal(result["counter"][~at_event], seconds[~at_event])
    assert set((seconds - result["counter"])[at_event]) <= {0, 1}
    assert result["counter"][-1] == 11


def test_an_oscillator_has_the_solution_of_scipy(simulated) -> None:
    result = simulated("VanDerPol", start_values={"mu": 5}, relative_tolerance=1e-10)

    def equation(_time: float, x: np.ndarray) -> list[float]:
        return [x[1], 5 * (1 - x[0] ** 2) * x[1] - x[0]]

    expected = solve_ivp(
        equation, (0, 20), [2, 0], "DOP853", dense_output=True, rtol=1e-12, atol=1e-12
    )
    x0, x1 = expected.sol(np.minimum(result["time"], 20))
    assert result["x0"] == pytest.approx(x0, abs=1e-5)
    assert result["x1"] == pytest.approx(x1, abs=1e-5)


def test_an_array_of_structs_has_the_solution_of_scipy(simulated) -> None:
    start_values = {"inflow": 0.5, "tank[2].area": 1.0, "tank[3].outlet": 0.25}
    start_values |= {f"tank[{i}].height": 9.0 for i in (1, 2, 3)}  # none is full
    result = simulated("Cascade", start_values=start_values, relative_tolerance=1e-10)

    def equation(_time: float, x: np.ndarray) -> np.ndarray:
        flows = [0.5, x[0], x[1], 0.25 * x[2]]
        return -np.diff(flows) / [2, 1, 2]

    expected = solve_ivp(equation, (0, 20), [0, 0, 0], "DOP853", dense_output=True, rtol=1e-12)
    levels = expected.sol(np.minimum(result["time"], 20))
    for i, level in enumerate(levels, 1):
        assert result[f"tank[{i}].level"] == pytest.approx(level, abs=1e-5)
    assert result["outflow"] == pytest.approx(0.25 * levels[2], abs=1e-5)


def temperature(set_point: float, at: float, opened: float, closed: float) -> list[tuple]:
    """Return start [s], temperature [°C] there, its limit and time constant [s] of each piece."""
    pieces, time, value, is_on, is_open = [], at, 20.0, True, False
    while time < 100:
        tau = 10 if is_open else 50
        limit = 20 + tau * (0.5 if is_on else 0)
        pieces.append((time, value, limit, tau))
        threshold = set_point + (0.5 if is_on else -0.5)
        ratio = (value - limit) / (threshold - limit)
        switched = time + tau * log(ratio) if ratio > 1 else inf
        change = min(t for t in (opened, closed, inf) if t > time)
        until = min(switched, change)
        value = limit + (value - limit) * exp(-(until - time) / tau)
        if until == switched:
            is_on = not is_on
        else:
            is_open = until == opened
        time = until
    return pieces


# FMPy sets all inputs when it locates events, and ignores that new discrete values are refused.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_thermostat_switches_when_its_inputs_jump(simulated) -> None:
    jumps = [10.0, 40.0, 50.0]
    # FMPy applies a jump in the step that begins after it.
    before, after, opened, closed = 0.0, *(time - 1e-7 for time in jumps)
    rows = [(before, 20, False), (after, 20, False), (after, 30, False), (opened, 30, True)]
    rows += [(closed, 30, False), (100, 30, False)]
    types = [("time", float), ("set_point", float), ("window", bool)]
    result = simulated("Thermostat", input=np.array(rows, types), relative_tolerance=1e-9)
    expected = np.full(len(result["time"]), 20.0)
    for start, value, limit, tau in temperature(30, *jumps):
        since = result["time"] - start
        piece = limit + (value - limit) * np.exp(-since / tau)
        expected = np.where(since < 0, expected, piece)
    assert result["temperature"] == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("ending", ["", "_fmi3"])
def test_messages_of_a_model_reach_the_logger(ending: str, equations: Path) -> None:
    fmu, messages = equations / f"Cascade{ending}.fmu", []
    assert b'"logModel"' in read(fmu)["modelDescription.xml"]
    for is_debugged in (True, False):
        messages.clear()
        fmpy.simulate_fmu(
            fmu,
            fmi_type="CoSimulation",
            logger=lambda *arguments: messages.append(arguments[-3:]),
            debug_logging=is_debugged,
        )
        said = [(status, name.decode()) for status, name, text in messages if b" t = " in text]
        assert (1, "logStatusWarning") in said
        assert ((0, "logModel") in said) == is_debugged
        full = [text.decode() for _, _, text in messages if b"is full" in text]
        assert full[0] == "at t = 3.219 s: tank 1 is full", "1 - exp(-t / 2) = 0.8"
        assert [text[-14:-8] for text in full] == ["tank 1", "tank 2", "tank 3"]
