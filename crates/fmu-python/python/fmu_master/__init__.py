"""Simulates FMUs of FMI 2.0 and 3.0, and systems of them, with a fast native master.

    from fmu_master import simulate

    result = simulate("Controller.fmu", stop_time=2.0, start_values={"kp": 3.0})
    result["u"]  # a NumPy array
    result.plot()

`simulate` runs one FMU or a system file, `System` couples FMUs, `Instance` steps one by hand. Their
binaries run in a process of their own: if one crashes, `FmuError` says where.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .comparison import Comparison, Difference, compare
    from .components import PythonComponent, python_component
    from .instance import Instance, State, Variable
    from .result import FmuError, FunctionTime, Message, Result, read
    from .summary import Summary
    from .sweeps import Sweep, sweep
    from .system import System, simulate

__all__ = [
    "Comparison",
    "Difference",
    "FmuError",
    "FunctionTime",
    "Instance",
    "Message",
    "PythonComponent",
    "Result",
    "State",
    "Summary",
    "Sweep",
    "System",
    "Variable",
    "compare",
    "python_component",
    "read",
    "simulate",
    "sweep",
]


def __getattr__(name: str) -> Any:
    # On first use: the command line needs no NumPy.
    modules = "system result instance components comparison sweeps summary".split()
    for module in modules if name in __all__ else ():
        found = importlib.import_module(f".{module}", __name__)
        if hasattr(found, name):
            return getattr(found, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
