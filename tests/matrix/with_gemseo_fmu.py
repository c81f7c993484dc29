# /// script
# dependencies = ["gemseo-fmu==3.1.1"]
# ///
"""The GEMSEO plugin for FMUs."""

from gemseo_fmu.disciplines.fmu_discipline import FMUDiscipline
from numpy import array

from loop import FMUS, FORCE, MODEL_EXCHANGE, STEP, STEPS, write

plant = FMUDiscipline(
    FMUS["plant"],
    ["u"],
    ["theta"],
    initial_time=0.0,
    final_time=STEPS * STEP,
    time_step=STEP,
    use_co_simulation=not MODEL_EXCHANGE,
)
write(plant.execute({"u": array([FORCE])})["theta"])
