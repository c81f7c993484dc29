"""Systems with components in Python, which are stepped by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from .instance import Instance
from .result import FmuError, Result


@dataclass(frozen=True)
class PythonComponent:
    """A component of a system that is a function of Python; see `python_component`."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    step: Callable[..., Any]
    sample_time: float | None
    units: Mapping[str, str]


def python_component(
    inputs: Sequence[str],
    outputs: Sequence[str],
    step: Callable[..., Any],
    sample_time: float | None = None,
    units: Mapping[str, str] | None = None,
) -> PythonComponent:
    """Make a component of a system from a function.

    Parameters
    ----------
    inputs, outputs
        Names of its variables.
    step
        Called with the time [s] and the values of the inputs, in their order; returns the value of
        the output, or a sequence with those of all outputs, which hold until the next call.
    sample_time
        Time between two calls [s], by default the communication step.
    units
        Units of outputs by name.

    Examples
    --------
    >>> controller = python_component(["y"], ["u"], lambda t, y: -30.0 * y)
    """
    return PythonComponent(tuple(inputs), tuple(outputs), step, sample_time, units or {})


class _Part:
    """A component of a run: the values of its outputs, and what feeds its inputs."""

    def __init__(self, name: str, units: Mapping[str, str], is_sampled: bool):
        self.name, self.units, self.is_sampled = name, dict(units), is_sampled
        self.values: list[Any] = [0.0] * len(units)
        self.links: dict[str, tuple[_Part, int, float | None, float]] = {}

    def output(self, name: str) -> int:
        """Return the index of an output."""
        if name not in self.units:
            known = ", ".join(self.units)
            raise FmuError(f"{self.name}.{name}: {self.name} has no output {name}, only {known}")
        return list(self.units).index(name)

    def fetch(self) -> None:
        """Take the values of the inputs."""
        self.inputs = [
            part.values[index] if factor is None else factor * part.values[index] + offset
            for part, index, factor, offset in self.links.values()
        ]

    def begin(self) -> None:
        """Initialize, once everything is connected."""

    def step(self, time: float, size: float) -> None:
        """Step from a time by a size [s]."""
        raise NotImplementedError


class _Function(_Part):
    def __init__(self, name: str, component: PythonComponent, start: float):
        units = {output: component.units.get(output, "") for output in component.outputs}
        super().__init__(name, units, True)
        self.component, self.next = component, start

    def begin(self) -> None:
        if missing := [name for name in self.component.inputs if name not in self.links]:
            raise FmuError(f"{self.name}.{missing[0]} is not connected")
        if unknown := [name for name in self.links if name not in self.component.inputs]:
            raise FmuError(f"{self.name} has no input {unknown[0]}")
        self.links = {name: self.links[name] for name in self.component.inputs}

    def step(self, time: float, size: float) -> None:
        if time < self.next - 1e-6 * size:
            return
        self.next += self.component.sample_time or size
        result = self.component.step(time, *self.inputs)
        self.values = list(result) if isinstance(result, Sequence) else [result]
        if len(self.values) != len(self.units):
            got, expected = len(self.values), len(self.units)
            raise ValueError(f"{self.name} returned {got} values, expected {expected}")


class _Fmu(_Part):
    def __init__(self, name: str, instance: Instance, is_sampled: bool | None):
        outputs = [v for v in instance.variables.values() if v.causality == "output"]
        outputs = [v for v in outputs if not v.dimensions and v.type not in ("String", "Binary")]
        by_default = bool(outputs) and all(v.variability == "discrete" for v in outputs)
        super().__init__(
            name,
            {v.name: v.unit for v in outputs},
            by_default if is_sampled is None else is_sampled,
        )
        self.instance = instance

    def begin(self) -> None:
        self.instance.initialize()
        self._read()

    def step(self, time: float, size: float) -> None:
        if self.links:
            self.instance.set(dict(zip(self.links, self.inputs, strict=True)))
        self.instance.step(size)
        self._read()

    def _read(self) -> None:
        self.values = self.instance.get_list(self.units)


def run(
    system: Mapping[str, Any], starts: Mapping[str, Any], output: Sequence[str], in_process: bool
) -> Result:
    """Run a system with components in Python; `system` has the keys of a system file.

    The rows are those of the native master: outputs before a step, or of sampled components after
    it. During the initialization, inputs keep their start values.
    """
    start, step = system.get("start", 0.0), system["step"]
    count = int((system["stop"] - start) / step + 1e-6) + 1
    with ExitStack() as stack:
        parts: dict[str, _Part] = {}
        for table in system["component"]:
            name, part = table["name"], table["fmu"]
            if isinstance(part, PythonComponent):
                parts[name] = _Function(name, part, start)
                continue
            own = {k[len(name) + 1 :]: v for k, v in starts.items() if k.startswith(f"{name}.")}
            tolerance = table.get("tolerance", system.get("tolerance"))
            instance = Instance(
                part,
                table.get("interface"),
                {**table.get("start", {}), **own},
                start,
                tolerance=tolerance,
                name=name,
                in_process=in_process,
            )
            parts[name] = _Fmu(name, stack.enter_context(instance), table.get("sampled"))
        for connection in system["connections"]:
            _connect(parts, connection)
        names = list(output) or [
            f"{part.name}.{name}" for part in parts.values() for name in part.units
        ]
        recorded = [_place(parts, name) for name in names]
        times = [start + k * step for k in range(count)]
        rows: list[list[Any]] = []
        try:
            for part in parts.values():
                part.begin()
            last = count if any(part.is_sampled for part, _ in recorded) else count - 1
            for k, time in enumerate(times):
                row = [part.values[index] for part, index in recorded]
                if k < last:
                    _step(list(parts.values()), system.get("order", "sequential"), time, step)
                for column, (part, index) in enumerate(recorded):
                    if part.is_sampled:
                        row[column] = part.values[index]
                rows.append(row)
        except FmuError as error:
            error.result = _result(times, names, recorded, rows)
            raise
        return _result(times, names, recorded, rows)


def _step(parts: Sequence[_Part], order: str, time: float, step: float) -> None:
    if order == "parallel":
        for part in parts:
            part.fetch()
    for part in parts:
        if order != "parallel":
            part.fetch()
        part.step(time, step)


def _place(parts: Mapping[str, _Part], name: str) -> tuple[_Part, int]:
    """Return the component of `component.output`, and the index of the output."""
    component, _, variable = name.partition(".")
    if component not in parts:
        raise FmuError(f"{name}: there is no component {component}; there are {', '.join(parts)}")
    return parts[component], parts[component].output(variable)


def _connect(parts: Mapping[str, _Part], connection: str | Mapping[str, Any]) -> None:
    factor, offset = None, 0.0
    if isinstance(connection, str):
        source, _, target = (part.strip() for part in connection.partition("->"))
    else:
        source, target = connection["from"], connection["to"]
        if unsupported := connection.keys() - {"from", "to", "factor", "offset"}:
            raise FmuError(f"{source} -> {target}: no {min(unsupported)} with Python components")
        if "factor" in connection or "offset" in connection:
            factor, offset = connection.get("factor", 1.0), connection.get("offset", 0.0)
    component, _, variable = target.partition(".")
    if component not in parts:
        raise FmuError(f"{target}: there is no component {component}")
    parts[component].links[variable] = (*_place(parts, source), factor, offset)


def _result(
    times: Sequence[float],
    names: Sequence[str],
    recorded: Sequence[tuple[_Part, int]],
    rows: Sequence[Sequence[Any]],
) -> Result:
    columns: list[Any] = [("time", "s", times[: len(rows)])]
    values = zip(*rows, strict=True) if rows else [()] * len(names)
    units = [list(part.units.values())[index] for part, index in recorded]
    columns += zip(names, units, values, strict=True)
    return Result.of({name: column for name, _, column in columns}, {n: u for n, u, _ in columns})
