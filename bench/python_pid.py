"""A typical PythonFMU implementation of a PID controller, with the law of `Pid` (current terms)."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class PythonPid(Fmi2Slave):
    """u = kp e + ki sum(e ts) + kd de/dt, limited."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.r = self.y = self.d = self.u = 0.0
        self.kp, self.ki, self.kd, self.u_max, self.ts = 300.0, 500.0, 100.0, 100.0, 0.001
        self.error_before = self.integral = 0.0
        for name in ("r", "y", "d"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        self.register_variable(Real("u", causality=Fmi2Causality.output))

    def do_step(self, _time, _step):
        """Take one sample."""
        error = self.r - (self.y + self.d)
        slope = (error - self.error_before) / self.ts
        self.integral += error * self.ts
        self.error_before = error
        force = self.kp * error + self.kd * slope + self.ki * self.integral
        self.u = min(max(force, -self.u_max), self.u_max)
        return True
