"""The C interface of each model's binary: what its own equations decide.

What all models share is in `crates/fmu-export/tests/c_interface`. `cargo fmu validate`, which
`test_validate.py` runs, compares start values, derivatives and ramps with the binaries;
`tests/c/loop.c` continues every model from the bytes of its state.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import reference
from pendulum_fmus.master import Component, MasterError

H = 0.001


def test_the_library_is_unloaded_after_use(fmus):
    def is_mapped() -> bool:
        return library in Path("/proc/self/maps").read_text()

    for _ in range(3):
        with Component("plant", fmus / "Pendulum.fmu") as component:
            library = component.fmu.dll._name
            component.initialize(0.0)
            component.step(0.0, H)
            assert is_mapped()
        assert not is_mapped()


DIVERGES = [
    ("Pendulum", {"theta0": 0.1}, {}, 1e300, "(theta|omega|x|v) became (NaN|-?inf)"),
    ("Pendulum", {"dynamics": "nonlinear"}, {"u": 1e200}, H, "u = 1e200 N"),
    ("Pid", {}, {"r": 1.7e308}, H, "(e|u_p|u) became inf"),
    ("PidRbf", {"rbf.eta": 10.0}, {"r": 1.0}, 0.5, r"(rbf\.w\[\d\]|u|u_p|u_n) became (NaN|-?inf)"),
    ("IpidRbf", {"rbf.eta": 10.0}, {"r": 1.0}, 0.5, r"(rbf\.w\[\d\]|u|u_p|u_n) became (NaN|-?inf)"),
    ("Source", {"signal": "sine", "frequency": 1e6}, {}, 1e303, "r became NaN"),
]
"""Parameters, inputs, a step [s] that overflows, and the expected message."""


@pytest.mark.parametrize(("model", "parameters", "inputs", "step", "reason"), DIVERGES)
def test_divergence_is_reported_and_a_reset_recovers(
    instance, model, parameters, inputs, step, reason
):
    component = instance(model, parameters)
    component.step(0.0, H)
    for name, value in inputs.items():
        component.set(name, value)
    with pytest.raises(MasterError, match=rf"status 3: .*from t = 0.001 s .*{reason}"):
        component.step(H, step)
    component.fmu.reset()
    for name in inputs:
        component.set(name, 0.0)  # not what the master remembers
    component.initialize(0.0)
    component.step(0.0, H)


def test_the_transfer_function_samples_a_ramp_of_the_force(instance):
    """(41) holds the force over a sample, so it takes u + u' t at the sample instants."""
    plant = instance("Pendulum", {"dynamics": "transfer_function"})
    plant.set("u", 2.0)
    samples, slope = 50, 40.0
    plant.fmu.setRealInputDerivatives([plant.variable("u").valueReference], [1], [slope])
    plant.step(0.0, samples * H)
    forces = 2.0 + slope * H * np.arange(samples)
    expected = lfilter(*reference.difference_equation(), [*forces, 0.0])[-1]
    assert plant.get("theta") == pytest.approx(expected, rel=1e-6)
