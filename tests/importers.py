"""Third-party importers of SSP packages. Each steps all components in parallel.

They return the same as the native master: `plant.theta` at each communication point, before the
step, and `controller.u` of the sample taken there, after the step.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import Parameter, ParameterSet, find_components, read_ssd
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver

ANGLE, FORCE = ("plant", "theta"), ("controller", "u")

Results = dict[str, np.ndarray]


def by_fmpy(package: Path, step: float, steps: int) -> Results:
    """Simulate from 0 s with FMPy.

    FMPy sets all inputs to zero in the first step. So the simulation starts one step earlier, where
    all outputs of these loops except the source's are zero, and nothing happens.
    """
    results = simulate_ssp(
        package,
        start_time=-step,
        stop_time=(steps - 0.5) * step,
        step_size=step,
        parameter_set=ParameterSet(name="", parameters=list(_parameters(package))),
    )
    return {
        "plant.theta": results["plant.theta"][:-1],
        "controller.u": results["controller.u"][1:],
    }


def _parameters(package: Path) -> Iterator[Parameter]:
    """Yield the start values in a package, which FMPy reads but does not apply by itself."""
    for component in find_components(read_ssd(package).system):
        for binding in component.parameterBindings:
            for parameter in (p for values in binding.parameterValues for p in values.parameters):
                value = parameter.value
                if parameter.type == "Boolean":
                    value = value == "true"  # FMPy expects typed values
                name = f"{component.name}.{parameter.name}"
                yield Parameter(name=name, type=parameter.type, value=value)


def by_ecos(package: Path, step: float, steps: int) -> Results:
    """Simulate from 0 s with Ecos."""
    import ecospy as ecos  # loads libtbb

    ecos.EcosLib.set_log_level("warn")
    angles, forces = np.empty(steps), np.empty(steps)
    with ecos.EcosSimulation(step, ssp_path=str(package)) as simulation:
        simulation.init(parameter_set="initialValues")
        for k in range(steps):
            angles[k] = simulation.get_real("::".join(ANGLE))
            simulation.step()
            forces[k] = simulation.get_real("::".join(FORCE))
        simulation.terminate()
    return {"plant.theta": angles, "controller.u": forces}


def by_libcosim(package: Path, _step: float, steps: int) -> Results:
    """Simulate with libcosim, with the times and the step of the package."""
    log_output_level(CosimLogLevel.ERROR)
    execution = CosimExecution.from_ssp_file(str(package))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)

    def reader(component: str, variable: str) -> tuple[int, list[int]]:
        index = execution.slave_index_from_instance_name(component)
        variables = execution.slave_variables(index)
        return index, [v.reference for v in variables if v.name == variable.encode()]

    angle, force = reader(*ANGLE), reader(*FORCE)
    angles, forces = np.empty(steps + 1), np.empty(steps)
    execution.step(0)
    (angles[0],) = observer.last_real_values(*angle)
    for k in range(steps):
        execution.step()
        (angles[k + 1],) = observer.last_real_values(*angle)
        (forces[k],) = observer.last_real_values(*force)
    return {"plant.theta": angles[:-1], "controller.u": forces}
