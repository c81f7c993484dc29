# /// script
# dependencies = ["fmugym==0.2.0", "fmpy==0.3.32"]
# ///
"""FMUGym, a Gymnasium environment of one FMU; its observations have single precision."""

import numpy as np
from fmugym import FMUGym, FMUGymConfig, State2Out, TargetValue, VarSpace

from loop import FMUS, FORCE, STEP, STEPS, write


class Environment(FMUGym):
    """The pendulum without random initial states."""

    def _noisy_init(self) -> dict:
        return {}

    def compute_reward(self, *_args, **_kwargs) -> float:
        """Return no reward."""
        return 0.0


inputs, outputs = VarSpace("inputs"), VarSpace("outputs")
inputs.add_var_box("u", -10.0, 10.0)
outputs.add_var_box("theta", -10.0, 10.0)
environment = Environment(
    FMUGymConfig(
        fmu_path=str(FMUS["plant"]),
        stop_time=2 * STEPS * STEP,
        sim_step_size=STEP,
        action_step_size=STEP,
        inputs=inputs,
        input_noise=VarSpace("no noise"),
        outputs=outputs,
        output_noise=VarSpace("no noise"),
        random_vars=VarSpace("no random variables"),
        set_point_map=State2Out("none"),
        set_point_nominal_start=TargetValue("none"),
        set_point_stop=VarSpace("none"),
        terminations=VarSpace("none"),
    )
)
observation, _ = environment.reset()
theta = [observation[0]]
for _ in range(STEPS):
    theta.append(environment.step(np.array([FORCE]))[0][0])
environment.close()
write(theta)
