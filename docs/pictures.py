"""Draws the pictures of docs/engineering.md to a folder, by default docs."""

import sys
import tomllib
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from fmu_master import System, compare
from fmu_master.gym import FmuEnv
from fmu_master.linear import linearize

ROOT = Path(__file__).parents[1]
PLANT = ROOT / "target" / "fmu" / "Pendulum.fmu"
LOOPS = ROOT / "examples" / "closed-loop"
FOUND = ROOT / "python" / "pendulum_fmus" / "report" / "gains.toml"


def linear() -> Figure:
    """Draw the poles of the pendulum at several angles, and the Bode plot of the upright one."""
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    poles, magnitude, phase = figure.subplots(1, 3)
    frequencies = np.geomspace(0.1, 100, 200)
    for degrees in (0, 30, 60, 85):
        start = {"theta0": np.radians(degrees), "dynamics": "nonlinear"}
        model = linearize(PLANT, start_values=start, outputs=["theta"])
        poles.plot(model.poles.real, model.poles.imag, "x", label=f"{degrees}°")
        if degrees == 0:
            shifted = 1j * frequencies[:, None, None] * np.eye(len(model.A)) - model.A
            response = (model.C @ np.linalg.solve(shifted, model.B) + model.D)[:, 0, 0]
            magnitude.semilogx(frequencies, 20 * np.log10(np.abs(response)))
            phase.semilogx(frequencies, np.degrees(np.unwrap(np.angle(response))))
    poles.set(title="poles", xlabel="real part [1/s]", ylabel="imaginary part [1/s]")
    poles.legend(title="angle")
    magnitude.set(title="from u to θ at 0°", xlabel="ω [rad/s]", ylabel="magnitude [dB]")
    phase.set(title="from u to θ at 0°", xlabel="ω [rad/s]", ylabel="phase [°]")
    return figure


def comparison() -> Figure:
    """Draw how a loop with a smaller gain differs."""
    loop, options = System(LOOPS / "pid.toml"), {"stop_time": 2.0}
    names = ["plant.theta", "controller.u"]
    gains = [{"controller.pid.kp": kp} for kp in (300.0, 250.0)]
    runs = [loop.simulate(start, output=names, **options) for start in gains]
    return compare(*runs, relative=1e-3).plot()


def environment() -> Figure:
    """Draw an episode in which the force is proportional to angle and angular velocity."""
    env = FmuEnv(
        PLANT,
        actions={"u": (-100.0, 100.0)},
        observations={"theta": (-0.2, 0.2), "omega": (-5.0, 5.0)},
        reward=lambda observation, action: -(observation[0] ** 2),
        step_size=0.01,
        stop_time=2.0,
    )
    observation, _ = env.reset(options={"theta0": 0.05})
    rows, truncated = [], False
    while not truncated:
        force = -100.0 * observation[0] - 15.0 * observation[1]
        observation, reward, _, truncated, _ = env.step(np.array([force]))
        rows.append([observation[0], force, reward])
    env.close()
    figure = Figure(figsize=(8, 2.6), layout="constrained")
    labels = ("angle θ [rad]", "action u [N]", "reward [rad²]")
    for axis, values, label in zip(figure.subplots(1, 3), np.transpose(rows), labels, strict=True):
        axis.plot(0.01 * np.arange(len(values)), values)
        axis.set(xlabel="time [s]", ylabel=label)
    return figure


def tuning() -> Figure:
    """Draw the errors with the gains of the paper and with those found."""
    figure = Figure(figsize=(8, 2.8), layout="constrained")
    for axis, (name, gains) in zip(
        figure.subplots(1, 2, sharey=True), tomllib.loads(FOUND.read_text()).items(), strict=True
    ):
        for label, values in (("gains of the paper", {}), ("gains found", gains)):
            run = System(LOOPS / f"{name}.toml").simulate(values, output=["controller.e"])
            # Every hundredth row, as all would make the file large
            error = np.maximum(np.abs(run["controller.e"]), 1e-7)
            axis.semilogy(run["time"][::100], error[::100], label=label)
        axis.set(title=f"{name.upper()}, step", xlabel="time [s]", ylabel="|e| [rad]")
        axis.legend()
    return figure


def main() -> None:
    """Write all pictures."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs"
    mpl.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "docs", "font.size": 8}
    for draw in (linear, comparison, environment, tuning):
        file = folder / f"engineering-{draw.__name__}.svg"
        draw().savefig(file, metadata={"Date": None})


if __name__ == "__main__":
    main()
