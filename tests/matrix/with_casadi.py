# /// script
# dependencies = ["casadi==3.8.2"]
# ///
"""CasADi with CVODES."""

import tempfile
import zipfile

from casadi import MX, DaeBuilder, integrator

from loop import FMUS, FORCE, STEP, STEPS, write

with tempfile.TemporaryDirectory() as folder:
    zipfile.ZipFile(FMUS["plant"]).extractall(folder)
    plant = DaeBuilder("plant", folder)
    x, u = MX.sym("x", len(plant.x())), MX.sym("u")
    equations = {"x": x, "u": u, "ode": plant.create("f", ["x", "u"], ["ode"])(x, u)}
    options = {"reltol": 1e-12, "abstol": 1e-14}
    times = [k * STEP for k in range(STEPS + 1)]
    solution = integrator("plant", "cvodes", equations, 0.0, times, options)(
        x0=plant.get(plant.x()), u=FORCE
    )
    write(solution["xf"][plant.x().index("theta"), :].full()[0])
