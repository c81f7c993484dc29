# /// script
# dependencies = ["fmuloader==0.1.2rc0"]
# ///
"""The bindings fmuloader, which have no master.

The loop is stepped here, in parallel; in model exchange, all models handle an event at each sample,
and the classical Runge-Kutta method integrates the plant in between.
"""

import re
import zipfile
from pathlib import Path

from fmuloader.fmi2 import Fmi2Slave, Fmi2Type
from fmuloader.fmi3 import Fmi3Slave

from loop import CONNECTIONS, ENDING, FMUS, FORCE, LOOP, MODEL_EXCHANGE, STEP, STEPS, write


class Fmu:
    """An initialized FMU, and the value references of its variables by name."""

    def __init__(self, path: Path, start: dict[str, float]):
        xml = zipfile.ZipFile(path).read("modelDescription.xml").decode()
        (token,) = re.findall(r'(?:guid|instantiationToken)="([^"]*)"', xml)
        variables = re.findall(r'<\w+ name="([^"]*)" valueReference="(\d+)"', xml)
        self.references = {name: int(reference) for name, reference in variables}
        self.exchanged = MODEL_EXCHANGE and "<ModelExchange" in xml  # the source is not
        self.states = len(re.findall(r' derivative="', xml))
        (model,) = set(re.findall(r'modelIdentifier="([^"]*)"', xml))
        if ENDING:
            self.slave = fmi = Fmi3Slave(path, model_identifier=model)
            kind = "model_exchange" if self.exchanged else "co_simulation"
            getattr(fmi, f"instantiate_{kind}")(model, instantiation_token=token)
            self.getter, self.setter = fmi.get_float64, fmi.set_float64
            self.update = fmi.update_discrete_states
            self.rates = fmi.get_continuous_state_derivatives
        else:
            self.slave = fmi = Fmi2Slave(path, model_identifier=model)
            kind = Fmi2Type.MODEL_EXCHANGE if self.exchanged else Fmi2Type.CO_SIMULATION
            fmi.instantiate(model, kind, guid=token)
            fmi.setup_experiment()
            self.getter, self.setter = fmi.get_real, fmi.set_real
            self.update, self.rates = fmi.new_discrete_states, fmi.get_derivatives
        for name, value in start.items():
            self.set(name, value)
        fmi.enter_initialization_mode()
        fmi.exit_initialization_mode()

    def get(self, name: str) -> float:
        """Return a Real."""
        return self.getter([self.references[name]])[0]

    def set(self, name: str, value: float) -> None:
        """Set a Real."""
        self.setter([self.references[name]], [value])

    def proceed(self, time: float) -> None:
        """Step, or integrate, from a time to the next communication point."""
        if not self.exchanged:
            self.slave.do_step(time, STEP)
            return
        start = self.slave.get_continuous_states(self.states) if self.states else []
        slopes = [[0.0] * self.states]
        for late in (0, STEP / 2, STEP / 2, STEP):
            slopes.append(self.evaluate(time, late, start, slopes[-1]))
        _, first, second, third, last = slopes
        middle = [(b + c) / 2 for b, c in zip(second, third, strict=True)]
        mean = [(a + 4 * m + d) / 6 for a, m, d in zip(first, middle, last, strict=True)]
        self.evaluate(time, STEP, start, mean)
        self.slave.completed_integrator_step()
        self.slave.enter_event_mode()

    def evaluate(self, time: float, late: float, start: list[float], slope: list[float]) -> list:
        """Return the derivatives on a line from the states at the start."""
        self.slave.set_time(time + late)
        if not self.states:
            return []
        states = [x + late * dx for x, dx in zip(start, slope, strict=True)]
        self.slave.set_continuous_states(states)
        return self.rates(self.states)


names = FMUS if LOOP else ["plant"]
fmus = {name: Fmu(FMUS[name], {} if LOOP else {"u": FORCE}) for name in names}
connections = CONNECTIONS if LOOP else []
theta = []
for k in range(STEPS + 1):
    theta.append(fmus["plant"].get("theta"))
    values = [fmus[source].get(output) for source, output, _, _ in connections]
    for (_, _, target, input_), value in zip(connections, values, strict=True):
        fmus[target].set(input_, value)
    for name, fmu in fmus.items():
        if fmu.exchanged:
            if name == "plant" and LOOP:  # after the sample
                fmu.set("u", fmus["controller"].get("u"))
            fmu.update()
            fmu.slave.enter_continuous_time_mode()
    for fmu in fmus.values():
        fmu.proceed(k * STEP)
write(theta)
