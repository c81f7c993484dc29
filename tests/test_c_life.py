"""Instances and libraries over their lives: threads, leaks, unloading; and trouble that is told."""

import _ctypes
import os
import re
import threading
from ctypes import byref, c_void_p
from pathlib import Path

import pytest

from slave import (
    ERROR,
    MODELS,
    OK,
    Fmu,
    Library,
    Slave,
    each_model,
    isolated,
    unpack,
)

H = 0.001

# --- many instances -----------------------------------------------------------------------------


def run(slave: Slave, seed: int, steps: int = 300) -> list[dict[str, str]]:
    """Run a slave from start to end by the FMU state functions, too; returns what it gave."""
    inputs = [v.name for v in slave.fmu.of("Real", "input")]
    trace = []
    slave.start()
    for k in range(steps):
        slave.put_all({name: 0.01 * ((seed + j) * k % 17) for j, name in enumerate(inputs)})
        assert slave.step(k * H, H) == OK
        if k % 50 == seed:
            slave.resume(slave.snapshot())
        trace.append(slave.everything())
    assert slave.fmi2Terminate() == OK
    return trace


@each_model
@isolated
def test_instances_in_eight_threads_give_what_they_give_alone(fmus, model):
    fmu = unpack(fmus, model)
    alone = [run(Slave(fmu), seed) for seed in range(8)]
    together: list = [None] * 8
    gate = threading.Barrier(8)

    def work(seed: int) -> None:
        gate.wait()
        slave = Slave(fmu)
        together[seed] = run(slave, seed)
        slave.free()

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert together == alone
    if fmu.of("Real", "input"):
        assert alone[1] != alone[2], "the inputs count"


@each_model
@isolated
def test_interleaved_instances_do_not_know_of_each_other(fmus, model):
    fmu = unpack(fmus, model)
    slaves = [Slave(fmu, f"slave {k}".encode()) for k in range(50)]
    parameter = next(v for v in fmu.of("Real", "parameter") if v.name != "ts")
    for k, slave in enumerate(slaves):
        slave.put_all({parameter.name: parameter.start * (1 + k / 100)}).start()
    for slave in slaves[::2]:
        slave.free()
    for k, slave in enumerate(slaves):
        if k % 2:
            assert slave.step(0.0, H) == OK
            assert slave.get(parameter.name) == parameter.start * (1 + k / 100)
            assert slave.messages == []


@each_model
@isolated
def test_messages_go_to_the_logger_of_their_instance(fmus, model):
    first, second = Slave(unpack(fmus, model), b"first"), Slave(unpack(fmus, model), b"second")
    assert second.step(0.0, H) == ERROR
    assert first.messages == []
    assert second.messages[0].instance == b"second"


@each_model
@isolated
def test_the_name_of_an_instance_may_be_gone_after_its_making(fmus, model):
    name = bytearray(b"fleeting")
    slave = Slave(unpack(fmus, model), bytes(name))
    name[:] = b"xxxxxxxx"
    assert slave.step(0.0, H) == ERROR
    assert slave.messages[0].instance == b"fleeting"


# --- memory -------------------------------------------------------------------------------------

CYCLES = 10_000
GROWTH = 200_000
"""Bytes that the process may grow by in all cycles; 32 bytes lost in each make 320 000."""


def resident() -> int:
    """Return the memory that this process has in RAM, in bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def live(fmu: Fmu, template: Slave) -> None:
    """Make an instance, use it well and badly, and free it."""
    call = fmu.library.functions
    callbacks = byref(template._callbacks)
    c = fmu.library.instantiate(b"cycle", 1, fmu.guid, None, callbacks, 0, 0)
    assert call["fmi2EnterInitializationMode"](c) == OK
    assert call["fmi2ExitInitializationMode"](c) == OK
    assert call["fmi2DoStep"](c, 0.0, H, 1) == OK
    assert call["fmi2DoStep"](c, 7.0, H, 1) == ERROR
    state = c_void_p()
    assert call["fmi2GetFMUstate"](c, byref(state)) == OK
    assert call["fmi2GetFMUstate"](c, byref(state)) == OK
    assert call["fmi2SetFMUstate"](c, state) == OK
    assert call["fmi2FreeFMUstate"](c, byref(state)) == OK
    assert call["fmi2DeSerializeFMUstate"](c, b"nonsense", 8, byref(state)) == ERROR
    fmu.library.free_instance(c)


@each_model
@isolated
def test_ten_thousand_lives_leave_nothing_behind(fmus, model):
    fmu = unpack(fmus, model)
    template = Slave(fmu)
    for _ in range(2000):
        live(fmu, template)
    template.messages.clear()
    before = resident()
    for _ in range(CYCLES):
        live(fmu, template)
        template.messages.clear()
    assert resident() - before < GROWTH


@each_model
@isolated
def test_resets_leave_nothing_behind(fmus, model):
    slave = Slave(unpack(fmus, model))
    for _ in range(500):
        slave.start()
        assert slave.fmi2Reset() == OK
    before = resident()
    for _ in range(CYCLES):
        slave.start()
        assert slave.fmi2Reset() == OK
    assert resident() - before < GROWTH


# --- the library --------------------------------------------------------------------------------


def is_mapped(path: Path) -> bool:
    """Tell whether a file is mapped into this process."""
    return str(path) in Path("/proc/self/maps").read_text()


@each_model
@isolated
def test_the_library_unloads_and_loads_again(fmus, model):
    fmu = unpack(fmus, model)
    for _ in range(100):
        library = Library(fmu.binary)
        assert is_mapped(fmu.binary)
        slave = Slave(fmu, library=library, debug=True).start()
        assert slave.step(0.0, H) == OK
        assert slave.step(0.0, -H) == ERROR
        slave.resume(slave.snapshot())
        slave.free()
        assert Slave(fmu, library=library, guid=b"wrong").component is None
        _ctypes.dlclose(library.cdll._handle)
        assert not is_mapped(fmu.binary)


@each_model
@isolated
def test_the_library_unloads_after_work_in_another_thread(fmus, model):
    fmu = unpack(fmus, model)
    library = Library(fmu.binary)

    def work() -> None:
        slave = Slave(fmu, library=library)
        run(slave, 1, 20)
        slave.free()

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    _ctypes.dlclose(library.cdll._handle)
    assert not is_mapped(fmu.binary)


@isolated
def test_all_fmus_live_in_one_process(fmus):
    slaves = [Slave(unpack(fmus, model)) for model in MODELS]
    traces = [run(slave, 1, 50) for slave in slaves]
    for slave, trace in zip(slaves, traces, strict=True):
        slave.free()
        assert run(Slave(slave.fmu), 1, 50) == trace


# --- numerical trouble is told ------------------------------------------------------------------

NOT_FINITE = r"(?i)\b(nan|-?inf)\b"


def assert_trouble_told(slave: Slave, variables: str, time: float) -> None:
    """Check that the newest message says which variable became what, and when."""
    message = slave.messages[-1]
    assert (message.status, message.category) == (ERROR, b"logStatusError")
    assert re.search(rf"(?<![\w.])({variables})(?![\w.])", slave.told), slave.told
    assert re.search(NOT_FINITE, slave.told), slave.told
    assert str(time) in slave.told, slave.told


def assert_mended_by_reset(slave: Slave) -> None:
    """Check that a reset makes the instance as good as new."""
    fresh = Slave(slave.fmu)
    assert slave.fmi2Reset() == OK
    assert slave.snapshot() == fresh.snapshot()
    assert run(slave, 1, 20) == run(fresh, 1, 20)


@pytest.mark.parametrize("form", [1, 2])
@isolated
def test_the_open_loop_diverges_and_says_so(fmus, form):
    """The unstable pole is at 5.3/s: 0.1 rad exceed the largest double after about 134 s."""
    slave = Slave(unpack(fmus, "Pendulum")).put(theta0=0.1, model=form).start()
    second = next(second for second in range(1000) if slave.step(second, 1.0) != OK)
    assert 132 < second < 138
    assert_trouble_told(slave, "theta|omega|x|v", second)
    assert slave.step(second + 1.0, 1.0) == ERROR
    assert_mended_by_reset(slave)


@pytest.mark.parametrize("force", [1e200, 1.7e308])
@isolated(timeout=20)
def test_a_force_beyond_all_measure_is_told(fmus, force):
    slave = Slave(unpack(fmus, "Pendulum")).put(model=3).start()
    assert slave.step(0.0, H) == OK
    slave.put(u=force)
    assert slave.step(H, H) == ERROR
    assert str(H) in slave.told
    assert re.search(r"\b(theta|omega|x|v|u)\b", slave.told), slave.told
    assert_mended_by_reset(slave)


@pytest.mark.parametrize("model", ["PidRbf", "IpidRbf"])
@isolated
def test_weights_that_overflow_are_told(fmus, model):
    """At r = 1 a learning rate of 10 takes the error of the network times -9 at every sample."""
    slave = Slave(unpack(fmus, model)).put_all({"rbf.eta": 10.0}).put(r=1.0).start()
    sample = next(k for k in range(1000) if slave.step(k * 0.5, 0.5) != OK)
    assert sample == 0, "9^500 is more than a double holds"
    assert_trouble_told(slave, r"rbf\.w\[\d\]|u_n", 0)
    assert_mended_by_reset(slave)


@pytest.mark.parametrize("model", ["PidRbf", "IpidRbf"])
@isolated
def test_weights_overflow_when_arithmetic_says_so(fmus, model):
    slave = Slave(unpack(fmus, model))
    slave.put_all({"rbf.eta": 10.0, "rbf.alpha": 0.0, "r": 1.0}).start()
    sample = next(k for k in range(1000) if slave.step(k * H, H) != OK)
    # |u_n| = 100 * 9.2^k passes 1.8e308 at k = 318 (|h|² = 1.018), its square terms a little before
    assert 300 < sample < 330
    assert_trouble_told(slave, r"rbf\.w\[\d\]|u_n", sample * H)
    assert_mended_by_reset(slave)


@pytest.mark.parametrize("model", ["Pid", "PidRbf", "IpidRbf"])
@pytest.mark.parametrize(
    ("start", "inputs"),
    [({}, {"r": 1.7e308}), ({"pid.kp": 1e9}, {"y": 1e305}), ({}, {"r": 1e308, "y": -1e308})],
)
@isolated
def test_a_force_that_overflows_is_told(fmus, model, start, inputs):
    slave = Slave(unpack(fmus, model)).put_all(start).start()
    assert slave.step(0.0, H) == OK
    assert slave.put_all(inputs).step(H, H) == ERROR
    assert_trouble_told(slave, r"e|u_p|u_n|u|rbf\.w\[\d\]", H)
    assert_mended_by_reset(slave)


@pytest.mark.parametrize(("frequency", "step"), [(1e6, 1e303), (0.2, 1.7e308)])
@isolated
def test_a_set_point_that_is_no_number_is_told(fmus, frequency, step):
    """The phase 2 pi f t of the sine is beyond the largest double."""
    slave = Slave(unpack(fmus, "Source")).put(signal=2, frequency=frequency).start()
    assert slave.step(0.0, step) == ERROR
    assert_trouble_told(slave, "r", 0)
    assert_mended_by_reset(slave)


@isolated
def test_a_start_time_without_a_set_point_is_told(fmus):
    slave = Slave(unpack(fmus, "Source")).put(signal=2, frequency=1e6)
    assert slave.fmi2SetupExperiment(0, 0.0, 1e304, 0, 0.0) == OK
    assert slave.fmi2EnterInitializationMode() == OK
    assert slave.fmi2ExitInitializationMode() == ERROR
    assert re.search(r"\br\b", slave.told)
    assert slave.fmi2Reset() == OK
    slave.start()
