"""The FMUs in one importer: the pendulum alone, or in a loop with IPID-RBF or PID.

Arguments: the importer; `co-simulation` or `model exchange`; `plant`, `loop` or `pid`; the folder
of the FMUs; the ending of their names; the number of steps; the file for the angles [rad] at the
communication points. Each function imports what `run.py` installs for it, returns the angles, and
may assume the cases that `run.py` lists for it.
"""

import csv
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any
from zipfile import ZipFile

IMPORTER, KIND, CASE, FOLDER, ENDING = sys.argv[1:6]
STEPS, FILE = int(sys.argv[6]), Path(sys.argv[7])
STEP = 0.001
STOP = STEPS * STEP
FORCE = 1.0
"""Force on the pendulum alone [N]."""

EXCHANGE, EVENTS, LOOP = KIND == "model exchange", "event" in KIND, CASE != "plant"
MODELS = {"source": "Source", "controller": "Pid" if CASE == "pid" else "IpidRbf"}
FMUS = {
    name: Path(FOLDER) / f"{model}{ENDING}.fmu"
    for name, model in ((MODELS if LOOP else {}) | {"plant": "Pendulum"}).items()
}
CONNECTIONS = [
    ("source", "r", "controller", "r"),
    ("source", "d", "controller", "d"),
    ("plant", "theta", "controller", "y"),
    ("controller", "u", "plant", "u"),
] * LOOP


def by_fmpy() -> Iterable[float]:
    """Use FMPy; CVode integrates with a tolerance of 1e-12."""
    import fmpy

    return fmpy.simulate_fmu(
        FMUS["plant"],
        fmi_type="ModelExchange" if EXCHANGE else "CoSimulation",
        stop_time=STOP,
        output_interval=STEP,
        relative_tolerance=1e-12 if EXCHANGE else None,
        start_values={"u": FORCE},
        output=["theta"],
        use_event_mode=EVENTS,
        early_return_allowed=EVENTS,
    )["theta"]


def fmi_sim() -> Iterable[float]:
    """Use the program `fmi-sim`."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["target/tools/bin/fmi-sim", "--model", FMUS["plant"], "-o", f"{folder}/out.csv"]
        command += [KIND.replace(" ", "-"), "--init-values", f"u={FORCE}"]
        command += ["--output-interval", str(STEP), "-f", str(STOP)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(done.stderr)
        with open(f"{folder}/out.csv") as lines:
            return [row["theta"] for row in csv.DictReader(lines)]


def libcosim() -> Iterable[float]:
    """Use the fixed-step algorithm."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.ERROR)
    run = CosimExecution.from_step_size(round(STEP * 1e9))
    indices = {n: run.add_local_slave(CosimLocalSlave(str(f), n)) for n, f in FMUS.items()}

    def locate(name: str, variable: str) -> tuple[int, int]:
        variables = run.slave_variables(indices[name])
        return indices[name], next(v.reference for v in variables if v.name == variable.encode())

    for source, output, target, input_ in CONNECTIONS:
        run.connect_real_variables(*locate(source, output), *locate(target, input_))
    run.add_observer(observer := CosimObserver.create_last_value())
    plant, angle = locate("plant", "theta")
    run.step(0)
    for _ in range(STEPS + 1):
        yield from observer.last_real_values(plant, [angle])
        run.step()


def ecos() -> Iterable[float]:
    """Use Ecos, which needs the system's libtbb."""
    from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure

    EcosLib.set_log_level("warn")
    structure = EcosSimulationStructure()
    for name, path in FMUS.items():
        structure.add_model(name, path)
    for source, output, target, input_ in CONNECTIONS:
        structure.make_real_connection(f"{source}::{output}", f"{target}::{input_}")
    with EcosSimulation(STEP, structure=structure) as simulation:
        simulation.init()
        for _ in range(STEPS + 1):
            yield simulation.get_real("plant::theta")
            simulation.step()
        simulation.terminate()


def pathsim() -> Iterable[float]:
    """Use the blocks for co-simulation and model exchange, which needs continuous states."""
    from pathsim import Connection, Simulation
    from pathsim.blocks import Constant
    from pathsim.solvers import RK4
    from pathsim_fmi import CoSimulationFMU, ModelExchangeFMU

    blocks = {
        name: ModelExchangeFMU(str(path), name)
        if EXCHANGE and name == "plant"
        else CoSimulationFMU(str(path), name, dt=STEP)
        for name, path in FMUS.items()
    }
    plant = blocks["plant"]
    if LOOP:
        links = [Connection(blocks[a][output], blocks[b][i]) for a, output, b, i in CONNECTIONS]
    else:
        blocks["force"] = Constant(FORCE)
        links = [Connection(blocks["force"], plant["u"])]
    simulation = Simulation(list(blocks.values()), links, dt=STEP, Solver=RK4, log=False)
    for _ in range(STEPS + 1):
        yield plant.outputs["theta"]
        simulation.timestep(STEP)


def cofmupy() -> Iterable[float]:
    """Use the Jacobi master."""
    from cofmupy import Coordinator

    def end(name: str, variable: str) -> dict:
        return {"id": name, "variable": variable}

    start = {} if LOOP else {"u": FORCE}
    fmus = [{"id": n, "path": str(path), "initialization": start} for n, path in FMUS.items()]
    links = [{"source": end(*link[:2]), "target": end(*link[2:])} for link in CONNECTIONS]
    settings = {"cosim_method": "jacobi", "iterative": False, "fmus": fmus, "connections": links}
    with tempfile.TemporaryDirectory() as folder:
        (file := Path(folder) / "settings.json").write_text(json.dumps(settings))
        coordinator = Coordinator()
        coordinator.start(str(file))
        for _ in range(STEPS):
            coordinator.do_step(STEP)
    return [0.0, *coordinator.get_results()["plant", "theta"]]  # those after each step


def sofirpy() -> Iterable[float]:
    """Use SOFIRpy."""
    from sofirpy import simulate

    links: dict[str, list] = {}
    for source, output, target, input_ in CONNECTIONS:
        origin = {"connect_to_system": source, "connect_to_external_parameter": output}
        links.setdefault(target, []).append({"parameter_name": input_} | origin)
    return simulate(
        stop_time=STOP,
        step_size=STEP,
        fmu_paths=FMUS,
        connections_config=links or None,
        start_values=None if LOOP else {"plant": {"u": FORCE}},
        parameters_to_log={"plant": ["theta"]},
    )["plant.theta"]


def toolbox() -> Iterable[float]:
    """Use a container of the FMU Manipulation Toolbox, simulated by FMPy.

    It prefers co-simulation, so this is removed from the model descriptions for model exchange.
    """
    import fmpy
    from fmu_manipulation_toolbox.assembly import AssemblyNode

    with tempfile.TemporaryDirectory() as folder:
        for path in FMUS.values():
            with ZipFile(path) as given, ZipFile(f"{folder}/{path.name}", "w") as written:
                for entry in given.infolist():
                    content = given.read(entry)
                    if EXCHANGE and b"<ModelExchange" in content:
                        content = re.sub(rb"<CoSimulation[^>]*/>", b"", content)
                    written.writestr(entry, content)
        files = {name: path.name for name, path in FMUS.items()}
        node = AssemblyNode("loop.fmu", step_size=STEP)
        for file in files.values():
            node.add_fmu(file)
        for source, output, target, input_ in CONNECTIONS:
            node.add_link(files[source], output, files[target], input_)
        node.add_output(files["plant"], "theta", "theta")
        node.make_fmu(Path(folder), fmi_version=2)
        return fmpy.simulate_fmu(
            f"{folder}/loop.fmu",
            stop_time=STOP,
            step_size=STEP,
            output_interval=STEP,
            start_values={"container.solver": 1} if EXCHANGE else {},  # Runge-Kutta, not Euler
        )["theta"]


def syssimx() -> Iterable[float]:
    """Use the Jacobi master."""
    from syssimx import Connection, System
    from syssimx.components.fmu import FMUComponent
    from syssimx.system.algorithms import JacobiAlgorithm

    system = System("loop")
    for name, path in FMUS.items():
        system.add_component(FMUComponent(name, str(path)))
    for connection in CONNECTIONS:
        system.add_connection(Connection(*connection))
    system.set_algorithm(JacobiAlgorithm())
    system.initialize(t0=0.0)
    return system.run(t0=0.0, tf=STOP, dt=STEP)["plant"][1]["theta"]


def jaxonomy() -> Iterable[float]:
    """Use jaxonomy, a block diagram; its names of ports are identifiers, unlike `rbf.w[1]`."""
    import jaxonomy
    from jaxonomy.library import Constant, ModelicaFMU

    diagram = jaxonomy.DiagramBuilder()
    blocks = {}
    for name, path in FMUS.items():
        used = {
            "input_names": [i for _, _, b, i in CONNECTIONS if b == name] if LOOP else ["u"],
            "output_names": [o for a, o, _, _ in CONNECTIONS if a == name] if LOOP else ["theta"],
        }
        fmu = ModelicaFMU(str(path), STEP, name=name, first_step_at_zero=True, **used)
        blocks[name] = diagram.add(fmu)

    def port(ports: list, name: str) -> object:
        return next(port for port in ports if port.name == name)

    for source, output, target, input_ in CONNECTIONS:
        ends = blocks[source].output_ports, blocks[target].input_ports
        diagram.connect(port(ends[0], output), port(ends[1], input_))
    plant = blocks["plant"]
    if not LOOP:
        force = diagram.add(Constant(FORCE))
        diagram.connect(force.output_ports[0], port(plant.input_ports, "u"))
    angle = {"theta": port(plant.output_ports, "theta")}
    built = diagram.build()
    times = (0.0, STOP)
    done = jaxonomy.simulate(built, built.create_context(), times, recorded_signals=angle)
    return done.outputs["theta"]


def casadi() -> Iterable[float]:
    """Use CVODES."""
    from casadi import MX, DaeBuilder, integrator

    with tempfile.TemporaryDirectory() as folder:
        ZipFile(FMUS["plant"]).extractall(folder)
        plant = DaeBuilder("plant", folder)
        x, u = MX.sym("x", len(plant.x())), MX.sym("u")
        equations = {"x": x, "u": u, "ode": plant.create("f", ["x", "u"], ["ode"])(x, u)}
        options = {"reltol": 1e-12, "abstol": 1e-14}
        times = [k * STEP for k in range(STEPS + 1)]
        solver = integrator("plant", "cvodes", equations, 0.0, times, options)
        states = solver(x0=plant.get(plant.x()), u=FORCE)["xf"]
        return states[plant.x().index("theta"), :].full()[0]


def gemseo() -> Iterable[float]:
    """Use the GEMSEO plugin for FMUs."""
    from gemseo_fmu.disciplines.fmu_discipline import FMUDiscipline
    from numpy import array

    times = {"initial_time": 0.0, "final_time": STOP, "time_step": STEP}
    kind = {"use_co_simulation": not EXCHANGE}
    plant = FMUDiscipline(FMUS["plant"], ["u"], ["theta"], **times, **kind)
    return plant.execute({"u": array([FORCE])})["theta"]


def estim8() -> Iterable[float]:
    """Use estim8, which estimates parameters of one FMU."""
    from estim8.models import FmuModel

    kind = "ModelExchange" if EXCHANGE else "CoSimulation"
    model = FmuModel(str(FMUS["plant"]), r_tol=1e-12, fmi_type=kind)
    results = model.simulate(0, STOP, STEP, parameters={"u": FORCE}, observe=["theta"])
    return results["theta"].values


def fmugym() -> Iterable[float]:
    """Use FMUGym, a Gymnasium environment of one FMU; its observations have single precision."""
    import numpy as np
    from fmugym import FMUGym, FMUGymConfig, State2Out, TargetValue, VarSpace

    class Environment(FMUGym):
        """The pendulum without random initial states and rewards."""

        def _noisy_init(self) -> dict:
            return {}

        def compute_reward(self, *_args, **_kwargs) -> float:
            return 0.0

    inputs, outputs = VarSpace("inputs"), VarSpace("outputs")
    inputs.add_var_box("u", -10.0, 10.0)
    outputs.add_var_box("theta", -10.0, 10.0)
    others = "input_noise output_noise random_vars set_point_stop terminations".split()
    settings = {
        "set_point_map": State2Out("none"), "set_point_nominal_start": TargetValue("none"),
        "stop_time": 2 * STOP, "sim_step_size": STEP, "action_step_size": STEP,
    }  # fmt: skip
    settings |= {"inputs": inputs, "outputs": outputs} | {n: VarSpace("none") for n in others}
    environment = Environment(FMUGymConfig(fmu_path=str(FMUS["plant"]), **settings))
    yield environment.reset()[0][0]
    for _ in range(STEPS):
        yield environment.step(np.array([FORCE]))[0][0]
    environment.close()


def fmuloader() -> Iterable[float]:
    """Step the loop here, since the bindings have no master."""
    fmus = {name: Loaded(path) for name, path in FMUS.items()}
    return in_parallel(fmus, lambda fmu, k: fmu.fmi.do_step(k * STEP, STEP))


def in_parallel(fmus: Mapping[str, Any], step: Callable[[Any, int], object]) -> Iterable[float]:
    """Step FMUs with `get` and `set` in parallel order, each by a function of it and the number."""
    for k in range(STEPS + 1):
        yield fmus["plant"].get("theta")
        values = [fmus[source].get(output) for source, output, _, _ in CONNECTIONS]
        for (_, _, target, input_), value in zip(CONNECTIONS, values, strict=True):
            fmus[target].set(input_, value)
        for fmu in fmus.values():
            step(fmu, k)


class Loaded:
    """An FMU that fmuloader has initialized, and the value references of its variables by name."""

    def __init__(self, path: Path):
        from fmuloader import fmi2, fmi3

        xml = ZipFile(path).read("modelDescription.xml").decode()
        (token,) = re.findall(r'(?:guid|instantiationToken)="([^"]*)"', xml)
        variables = re.findall(r'<\w+ name="([^"]*)" valueReference="(\d+)"', xml)
        self.references = {name: int(reference) for name, reference in variables}
        (model,) = set(re.findall(r'modelIdentifier="([^"]*)"', xml))
        if ENDING:
            self.fmi = fmi = fmi3.Fmi3Slave(path, model_identifier=model)
            fmi.instantiate_co_simulation(model, instantiation_token=token)
            self.getter, self.setter = fmi.get_float64, fmi.set_float64
        else:
            self.fmi = fmi = fmi2.Fmi2Slave(path, model_identifier=model)
            fmi.instantiate(model, fmi2.Fmi2Type.CO_SIMULATION, guid=token)
            fmi.setup_experiment()
            self.getter, self.setter = fmi.get_real, fmi.set_real
        if not LOOP:
            self.set("u", FORCE)
        fmi.enter_initialization_mode()
        fmi.exit_initialization_mode()

    def get(self, name: str) -> float:
        """Return a variable."""
        return self.getter([self.references[name]])[0]

    def set(self, name: str, value: float) -> None:
        """Set a variable."""
        self.setter([self.references[name]], [value])


if __name__ == "__main__":
    FILE.write_text(json.dumps([float(angle) for angle in globals()[IMPORTER]()][: STEPS + 1]))
