"""Thousands of random call sequences, good and bad, against a model of the state machine.

Every sequence has a seed of its own, which a failure names with the calls that led to it. Set
`FMU_SEQUENCES` to run more of them than a test run takes.
"""

import copy
import math
import os
import random
from ctypes import byref, c_int, c_size_t, c_uint, c_void_p, create_string_buffer
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from slave import (
    DISCARD,
    ERROR,
    LAST_SUCCESSFUL_TIME,
    OK,
    TERMINATED,
    WARNING,
    Fmu,
    Slave,
    Status,
    Variable,
    each_model,
    in_child,
    integers,
    reals,
    references,
    texts,
    unpack,
)

SEQUENCES = int(os.environ.get("FMU_SEQUENCES", "1000"))
"""Sequences for every FMU."""

BATCH = 50
"""Sequences in one process."""

CALLS = 60
"""Calls in a sequence."""

HUGE = 1.7e308

# --- what an instance should be -----------------------------------------------------------------

INSTANTIATED, INITIALIZATION, COMPLETE, FAILED, ENDED, BROKEN = PHASES = (
    "instantiated", "initialization mode", "step complete", "step failed", "terminated", "error",
)  # fmt: skip

READABLE = PHASES[1:]
WRITABLE = PHASES[:3]


@dataclass
class Expected:
    """The state that an instance should be in."""

    values: dict[str, float]
    phase: str = INSTANTIATED
    start: float = 0.0
    stop: float = math.inf
    time: float | None = None

    @classmethod
    def fresh(cls, fmu: Fmu) -> "Expected":
        """Return that of a new instance."""
        return cls({v.name: v.start for v in fmu.variables.values() if v.start is not None})

    @property
    def running(self) -> bool:
        """Tell whether the initialization is over."""
        return self.phase not in PHASES[:2]

    @property
    def now(self) -> float:
        """The communication point [s]."""
        return self.start if self.time is None else self.time


def tolerance(time: float, step: float) -> float:
    """Return how far [s] a time may be from what it should be."""
    return 1e-6 * step + 1e-9 * (1 + abs(time))


@dataclass
class Saved:
    """An FMU state in the host's hands, what it should hold, and its bytes."""

    pointer: c_void_p
    expected: Expected
    serialized: bytes


# --- random values ------------------------------------------------------------------------------


def good_value(variable: Variable, dice: random.Random) -> float | int:
    """Return a value that is allowed, and with which no loop diverges."""
    if variable.kind == "Boolean":
        return dice.randrange(2)
    if variable.items:
        return dice.randint(1, variable.items)
    if variable.start:
        return variable.start * dice.uniform(0.5, 1.5)
    return dice.choice((0.0, -0.0, dice.uniform(-1, 1) if not variable.minimum else 0.0, 0.5))


def bad_value(variable: Variable, dice: random.Random) -> float | int:
    """Return a value that is not allowed."""
    if variable.kind == "Boolean":
        return dice.choice((2, -1, 2**31 - 1))
    if variable.items:
        return dice.choice((0, -1, variable.items + 1, -(2**31)))
    bad = [math.nan, math.inf, -math.inf]
    if variable.minimum is not None:
        bad += [variable.minimum - 1, -1e300]
    if variable.maximum is not None:
        bad += [1.5 * variable.maximum + 1, 1e300]
    return dice.choice(bad)


# --- one sequence -------------------------------------------------------------------------------


@dataclass
class Sequence:
    """Makes random calls, and checks every answer."""

    slave: Slave
    dice: random.Random
    trace: Path
    expected: Expected = field(init=False)
    saved: list[Saved] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.expected = Expected.fresh(self.slave.fmu)
        self.log = self.trace.open("a", buffering=1)
        self.moves = [getattr(self, name) for name in dir(type(self)) if name.startswith("_do_")]
        self.weights = [WEIGHTS.get(move.__name__, 1) for move in self.moves]

    def run(self) -> None:
        """Make the calls, and free everything."""
        for move in self.dice.choices(self.moves, self.weights, k=CALLS):
            move()
        for saved in self.saved:
            self.slave.drop(saved.pointer)
        self.slave.free()
        self.log.close()

    def call(self, name: str, *arguments, allowed: bool, shown: object = "") -> int:
        """Make a call, and check that it works, or that it is refused and changes nothing."""
        # A getter may compute outputs before it looks at the references.
        may_compute = self.expected.phase == INITIALIZATION and name.startswith("fmi2Get")
        unchanged = not allowed and not may_compute and self.dice.random() < 0.2
        before = self.slave.snapshot() if unchanged else b""
        answer = self.answer(name, *arguments, shown=shown)
        assert answer == (OK if allowed else ERROR), (answer, self.expected, self.told)
        if not allowed:
            assert name in self.told
            self.slave.messages.clear()
        if unchanged:
            assert self.slave.snapshot() == before, "a refused call changed something"
        return answer

    def answer(self, name: str, *arguments, shown: object = "") -> Status:
        """Make a call and return its status; it is traced first, as it may crash."""
        self.log.write(f"{name} {shown}\n")
        return Status(getattr(self.slave, name)(*arguments))

    @property
    def told(self) -> str:
        """The newest message."""
        return str(self.slave.messages[-1]) if self.slave.messages else "nothing was logged"

    # --- life cycle

    def _do_setup_experiment(self) -> None:
        start = self.dice.choice((0.0, 2.0, -1.0, 1e6))
        good = self.dice.random() < 0.8
        stop = start + (self.dice.choice((0.0, 0.05, 10.0)) if good else -1.0)
        if not good and self.dice.random() < 0.5:
            start = self.dice.choice((math.nan, math.inf))
        defined = self.dice.random() < 0.3 or not good
        allowed = good and self.expected.phase == INSTANTIATED
        arguments = (0, 0.0, start, int(defined), stop)
        self.call("fmi2SetupExperiment", *arguments, allowed=allowed, shown=arguments)
        if allowed:
            self.expected.start = start
            self.expected.stop = stop if defined else math.inf

    def change(self, name: str, origins: tuple[str, ...], target: str) -> None:
        """Make a call that leads from some phases to another."""
        allowed = self.expected.phase in origins
        self.call(name, allowed=allowed)
        if allowed:
            self.expected.phase = target

    def _do_enter_initialization_mode(self) -> None:
        self.change("fmi2EnterInitializationMode", (INSTANTIATED,), INITIALIZATION)

    def _do_exit_initialization_mode(self) -> None:
        self.change("fmi2ExitInitializationMode", (INITIALIZATION,), COMPLETE)

    def _do_terminate(self) -> None:
        self.change("fmi2Terminate", (COMPLETE, FAILED), ENDED)

    def _do_reset(self) -> None:
        self.call("fmi2Reset", allowed=True)
        self.expected = Expected.fresh(self.slave.fmu)

    # --- steps

    def _do_step(self) -> None:
        """Take a step that is a whole number of samples, if it is not a bad one."""
        ts = self.expected.values.get("ts", 0.001)
        self.step(self.expected.now, self.dice.choice((0, 1, 1, 1, 2, 5, 37)) * ts)

    def _do_step_with_rounding(self) -> None:
        ts = self.expected.values.get("ts", 0.001)
        now = self.expected.now
        self.step(now + self.dice.uniform(-0.5, 0.5) * tolerance(now, ts), ts)

    def _do_step_from_elsewhere(self) -> None:
        ts = self.expected.values.get("ts", 0.001)
        gap = self.dice.choice((-1.0, -ts, 0.5 * ts, ts, 1.5 * ts, 1.0, math.nan, -math.inf))
        self.step(self.expected.now + gap, ts)

    def _do_step_that_is_none(self) -> None:
        self.step(self.expected.now, self.dice.choice((math.nan, math.inf, -math.inf, -0.001)))

    def _do_endless_step(self) -> None:
        """Take more samples than are computed; the continuous pendulum would diverge."""
        fmu, values = self.slave.fmu.model, self.expected.values
        if fmu != "Source" and (fmu != "Pendulum" or values["model"] == 1):
            self.step(self.expected.now, 2e8 * values["ts"])

    def step(self, time: float, step: float) -> None:
        """Step, and check the answer against what the times say."""
        expected = self.expected
        if expected.phase != COMPLETE or not self.fits(time, step):
            self.call("fmi2DoStep", time, step, 1, allowed=False, shown=(time, step))
            return
        answers = {OK, WARNING}
        if any(abs(value) > 1e300 for value in expected.values.values()):
            answers |= {ERROR}
        if step > 1e8 * expected.values.get("ts", math.inf):
            answers = {DISCARD}
        answer = self.answer("fmi2DoStep", time, step, 1, shown=(time, step))
        assert answer in answers, (answer, answers, expected, self.told)
        if answer not in (OK, WARNING):
            expected.phase = FAILED if answer == DISCARD else BROKEN
        elif step:
            expected.time = time + step

    def fits(self, time: float, step: float) -> bool:
        """Tell whether a step begins and ends where it may."""
        if not (math.isfinite(time) and math.isfinite(step) and step >= 0):
            return False
        gap, near = time - self.expected.now, tolerance(self.expected.now, step)
        late = step if self.expected.time is None and step else 0.0
        return -near <= gap <= late + near and time + step <= self.expected.stop + near

    def _do_make_the_next_step_overflow(self) -> None:
        if "r" in self.expected.values and self.expected.phase == COMPLETE:
            assert self.slave.set("r", HUGE) == OK
            self.expected.values["r"] = HUGE
            self.log.write(f"fmi2SetReal r = {HUGE}\n")

    # --- values

    def some_variables(self, kind: str) -> list[Variable]:
        """Return a few variables, mostly of one type."""
        pool = self.slave.fmu.of(kind) if self.dice.random() < 0.9 else []
        return self.dice.choices(pool or list(self.slave.fmu.variables.values()), k=self.few())

    def few(self) -> int:
        """Return a small number."""
        return self.dice.choice((1, 1, 2, 3, 8))

    def kind(self) -> str:
        """Return a type."""
        return self.dice.choice(("Real", "Real", "Integer", "Boolean"))

    def _do_set(self) -> None:
        kind = self.kind()
        variables = self.some_variables(kind)
        good = self.dice.random() < 0.8
        values = [good_value(v, self.dice) for v in variables]
        if not good:
            place = self.dice.randrange(len(variables))
            values[place] = bad_value(variables[place], self.dice)
        settable = all(
            v.kind == kind and v.settable(running=self.expected.running) for v in variables
        )
        allowed = good and settable and self.expected.phase in WRITABLE
        array = reals(*values) if kind == "Real" else integers(*map(int_or_zero, values))
        self.call(
            f"fmi2Set{kind}", references(variables), len(values), array, allowed=allowed,
            shown={v.name: x for v, x in zip(variables, values, strict=True)},
        )  # fmt: skip
        if allowed:
            names = [v.name for v in variables]
            self.expected.values |= zip(names, values, strict=True)

    def _do_get(self) -> None:
        kind = self.kind()
        variables = self.some_variables(kind)
        allowed = self.expected.phase in READABLE and all(v.kind == kind for v in variables)
        values = (reals if kind == "Real" else integers)(*[0] * len(variables))
        self.call(
            f"fmi2Get{kind}", references(variables), len(values), values, allowed=allowed,
            shown=[v.name for v in variables],
        )  # fmt: skip
        for variable, value in zip(variables, values, strict=True):
            if allowed and variable.name in self.expected.values:
                assert value == self.expected.values[variable.name], variable.name

    def _do_access_nonsense(self) -> None:
        """Ask for a variable that is not there, for a String, or for an array at NULL."""
        action, kind = self.dice.choice(("Get", "Set")), self.kind()
        unknown = (c_uint * 1)(self.dice.choice((len(self.slave.fmu.variables), 2**32 - 1)))
        array = reals(0.0) if kind == "Real" else integers(0)
        some = references(list(self.slave.fmu.variables.values())[:1])
        calls = [
            (f"fmi2{action}{kind}", unknown, 1, array), (f"fmi2{action}{kind}", None, 1, array),
            (f"fmi2{action}{kind}", some, 1, None), (f"fmi2{action}String", some, 1, texts(b"")),
        ]  # fmt: skip
        self.call(*self.dice.choice(calls), allowed=False)

    def _do_access_nothing(self) -> None:
        action = self.dice.choice(("Get", "Set"))
        allowed = self.expected.phase in (READABLE if action == "Get" else WRITABLE)
        kind = self.dice.choice(("Real", "Integer", "Boolean", "String"))
        self.call(f"fmi2{action}{kind}", None, 0, None, allowed=allowed)

    def _do_derive(self) -> None:
        allowed = self.slave.fmu.model == "Pendulum" and self.expected.phase in READABLE
        fmu, result = self.slave.fmu, reals(math.nan)
        known = references(fmu.of("Real", "input")[:1] or fmu.of("Real")[:1])
        unknown = references([self.dice.choice(fmu.of("Real", "output"))])
        arguments = (unknown, 1, known, 1, reals(1.0), result)
        self.call("fmi2GetDirectionalDerivative", *arguments, allowed=allowed)
        assert math.isfinite(result[0]) == (allowed or not math.isnan(result[0]))

    def _do_ramp(self) -> None:
        inputs = self.slave.fmu.of("Real", "input")[:1] or self.slave.fmu.of("Real")[:1]
        order = self.dice.choice((1, 1, 0, 2))
        allowed = (
            self.slave.fmu.model == "Pendulum" and order == 1 and self.expected.phase in WRITABLE
        )
        slope = reals(self.dice.uniform(-9, 9))
        arguments = (references(inputs), 1, integers(order), slope)
        self.call("fmi2SetRealInputDerivatives", *arguments, allowed=allowed, shown=order)

    # --- FMU states

    def _do_save(self) -> None:
        pointer = self.slave.save()
        self.log.write("fmi2GetFMUstate new\n")
        self.keep(pointer)

    def keep(self, pointer: c_void_p) -> None:
        """Remember what an FMU state should hold."""
        expected = copy.deepcopy(self.expected)
        self.saved.append(Saved(pointer, expected, self.slave.serialize(pointer)))

    def any_saved(self) -> Saved | None:
        """Return one of the FMU states in hand."""
        return self.dice.choice(self.saved) if self.saved else None

    def _do_overwrite(self) -> None:
        if saved := self.any_saved():
            self.saved.remove(saved)
            self.call("fmi2GetFMUstate", byref(saved.pointer), allowed=True, shown="over")
            self.keep(saved.pointer)

    def _do_restore(self) -> None:
        saved = self.any_saved()
        pointer = saved.pointer if saved else None
        self.call("fmi2SetFMUstate", pointer, allowed=saved is not None)
        if saved:
            self.expected = copy.deepcopy(saved.expected)
            assert self.slave.snapshot() == saved.serialized

    def _do_drop(self) -> None:
        pointer = c_void_p()
        if saved := self.any_saved():
            self.saved.remove(saved)
            pointer = saved.pointer
        self.call("fmi2FreeFMUstate", byref(pointer), allowed=True)
        assert pointer.value is None

    def _do_serialize(self) -> None:
        if saved := self.any_saved():
            size = c_size_t()
            self.call("fmi2SerializedFMUstateSize", saved.pointer, byref(size), allowed=True)
            room = max(0, size.value + self.dice.choice((-size.value, -1, 0, 0, 7)))
            buffer, allowed = create_string_buffer(room or 1), room >= size.value
            arguments = (saved.pointer, buffer, room)
            self.call("fmi2SerializeFMUstate", *arguments, allowed=allowed, shown=room)
            assert not allowed or buffer.raw[: size.value] == saved.serialized

    def _do_deserialize(self) -> None:
        if saved := self.any_saved():
            pointer, size = c_void_p(), len(saved.serialized)
            arguments = (saved.serialized, size, byref(pointer))
            self.call("fmi2DeSerializeFMUstate", *arguments, allowed=True)
            self.saved.append(Saved(pointer, copy.deepcopy(saved.expected), saved.serialized))

    def _do_deserialize_damage(self) -> None:
        if saved := self.any_saved():
            damaged, dice = bytearray(saved.serialized), self.dice
            damaged[dice.randrange(len(damaged))] ^= dice.randint(1, 255)
            damage = bytes(damaged[: dice.choice((len(damaged), dice.randrange(len(damaged))))])
            pointer = c_void_p()
            arguments = (damage, len(damage), byref(pointer))
            self.call("fmi2DeSerializeFMUstate", *arguments, allowed=False, shown=damage.hex())
            assert pointer.value is None

    # --- the rest

    def _do_switch_logging(self) -> None:
        on = self.dice.choice((0, 1))
        names = self.dice.sample(self.slave.fmu.categories, 2)
        if "logStatusError" in names or "logAll" in names or not on:
            on = 1
            names = ["logAll"]  # errors are always to be seen here
        good = self.dice.random() < 0.7
        if on and "logAll" not in names:
            names.append("logStatusError")
        encoded = [name.encode() for name in names] + [b"%s%n"] * (not good)
        arguments = (on, len(encoded), texts(*encoded))
        self.call("fmi2SetDebugLogging", *arguments, allowed=good, shown=encoded)

    def _do_ask_for_the_status(self) -> None:
        allowed = self.expected.phase in (COMPLETE, FAILED, ENDED)
        time, ended = reals(math.nan), c_int(7)
        self.call("fmi2GetRealStatus", LAST_SUCCESSFUL_TIME, time, allowed=allowed)
        self.call("fmi2GetBooleanStatus", TERMINATED, byref(ended), allowed=allowed)
        if allowed:
            assert time[0] == pytest.approx(self.expected.now, rel=1e-12)
            assert ended.value == 0

    def _do_what_is_never_allowed(self) -> None:
        some, one = references(self.slave.fmu.of("Real", "output")[:1]), reals(0.0)
        calls = [
            ("fmi2CancelStep",), ("fmi2GetStatus", 0, integers(0)), ("fmi2SetTime", 0.0),
            ("fmi2GetRealOutputDerivatives", some, 1, integers(1), one),
            ("fmi2GetIntegerStatus", 0, integers(0)), ("fmi2GetRealStatus", 0, one),
            ("fmi2EnterEventMode",), ("fmi2EnterContinuousTimeMode",),
            ("fmi2SetContinuousStates", one, 1), ("fmi2GetDerivatives", one, 1),
            ("fmi2SetFMUstate", None), ("fmi2GetFMUstate", None),
            ("fmi2DeSerializeFMUstate", None, 9, byref(c_void_p())),
        ]  # fmt: skip
        self.call(*self.dice.choice(calls), allowed=False)


WEIGHTS = {
    "_do_setup_experiment": 2,
    "_do_enter_initialization_mode": 4, "_do_exit_initialization_mode": 4,
    "_do_terminate": 0.5, "_do_reset": 0.5, "_do_step": 8, "_do_set": 6, "_do_get": 4,
    "_do_endless_step": 0.5, "_do_make_the_next_step_overflow": 0.3, "_do_restore": 2,
}  # fmt: skip
"""How often a move is made, where it is not as often as the others."""


def int_or_zero(value: float) -> int:
    """Return a whole number for a variable that may be a Real."""
    return int(value) if math.isfinite(value) and abs(value) < 2**31 else 0


# --- the test -----------------------------------------------------------------------------------


@each_model
@pytest.mark.parametrize("first", range(0, SEQUENCES, BATCH))
def test_random_calls_are_answered_as_the_state_machine_says(fmus, tmp_path, model, first):
    trace = tmp_path / "trace"

    def sequences() -> None:
        for seed in range(first, first + BATCH):
            trace.write_text(f"{model}, sequence {seed}:\n")
            slave = Slave(unpack(fmus, model), debug=bool(seed % 2))
            Sequence(slave, random.Random(f"{model} {seed}"), trace).run()

    try:
        in_child(sequences, timeout=120)
    except pytest.fail.Exception as failure:
        pytest.fail(f"{trace.read_text()}{failure.msg}", pytrace=False)


def test_the_moves_reach_every_phase_of_every_kind(fmus, tmp_path):
    """Else the test above would test little."""

    def count() -> dict[str, int]:
        seen = dict.fromkeys(PHASES, 0)
        for seed in range(200):
            slave = Slave(unpack(fmus, "Pid"))
            sequence = Sequence(slave, random.Random(seed), tmp_path / "trace")
            sequence.moves = [counted(sequence, move, seen) for move in sequence.moves]
            sequence.run()
        return seen

    assert min(in_child(count).values()) > 100


def counted(sequence: Sequence, move, seen: dict[str, int]):
    """Return a move that counts the phase in which it is made."""

    def run() -> None:
        seen[sequence.expected.phase] += 1
        move()

    return run
