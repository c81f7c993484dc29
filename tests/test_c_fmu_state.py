"""FMU states: a round trip goes on bit for bit, and damaged bytes are refused."""

import os
import random
from ctypes import byref, c_size_t, c_void_p, create_string_buffer
from pathlib import Path

import pytest

from slave import (
    ERROR,
    FATAL,
    LAST_SUCCESSFUL_TIME,
    MODELS,
    OK,
    Fmu,
    Slave,
    each_model,
    in_child,
    isolated,
    reals,
    references,
    unpack,
)

H = 0.001

# A controller's weights move, and every form of the plant has a state of its own.
CASES = [
    *[("Pendulum", {"theta0": 0.3, "omega0": -0.5, "model": form}) for form in (1, 2, 3)],
    ("Pid", {"pid.kp": 7.0}),
    ("Pid", {"previous_sample_terms": 1, "ts": 0.0025}),
    ("PidRbf", {"rbf.eta": 0.7, "rbf.w0[2]": 1.5}),
    ("IpidRbf", {"rbf.target": 2, "rbf.alpha": 0.5}),
    ("Source", {"signal": 2, "disturbance.amplitude": 1.0, "disturbance.start": 0.02}),
    ("Source", {"signal": 3, "frequency": 130.0}),
]

each_case = pytest.mark.parametrize(
    ("model", "start"), CASES, ids=[f"{model}-{k}" for k, (model, _) in enumerate(CASES)]
)


def drive(slave: Slave, first: int, steps: int) -> list[dict[str, str]]:
    """Step with inputs that change from step to step; returns everything after each."""
    inputs = [v.name for v in slave.fmu.of("Real", "input")]
    trace = []
    for k in range(first, first + steps):
        slave.put_all({name: 0.1 * (k % 7 - j) for j, name in enumerate(inputs)})
        assert slave.step(k * H, H) == OK, slave.told
        trace.append(slave.everything())
    return trace


def moving(fmus: Path, model: str, start: dict) -> Slave:
    """Return an instance after twenty steps."""
    slave = Slave(unpack(fmus, model)).put_all(start).start()
    drive(slave, 0, 20)
    return slave


# --- round trips --------------------------------------------------------------------------------


@each_case
@isolated
def test_the_same_instance_goes_on_bit_for_bit(fmus, model, start):
    slave = moving(fmus, model, start)
    state, before = slave.save(), slave.everything()
    first = drive(slave, 20, 20)
    assert first[-1] != before, "it moves"
    assert slave.fmi2SetFMUstate(state) == OK
    assert slave.everything() == before
    assert drive(slave, 20, 20) == first


@each_case
@isolated
def test_another_instance_goes_on_bit_for_bit(fmus, model, start):
    slave = moving(fmus, model, start)
    other = Slave(slave.fmu, b"other")
    state = slave.save()
    assert other.fmi2SetFMUstate(state) == OK, other.told
    slave.drop(state)
    assert other.snapshot() == slave.snapshot()
    assert drive(other, 20, 20) == drive(slave, 20, 20)


@each_case
def test_another_process_goes_on_bit_for_bit(fmus, model, start):
    def here() -> tuple[bytes, list]:
        slave = moving(fmus, model, start)
        return slave.snapshot(), drive(slave, 20, 20)

    serialized, expected = in_child(here)
    assert in_child(lambda: drive(resumed(fmus, model, serialized), 20, 20)) == expected


def resumed(fmus: Path, model: str, serialized: bytes) -> Slave:
    """Return a new instance in the state that the bytes hold."""
    return Slave(unpack(fmus, model), b"later").resume(serialized)


@each_case
@isolated
def test_bytes_of_a_restored_state_are_the_same(fmus, model, start):
    slave = moving(fmus, model, start)
    serialized = slave.snapshot()
    assert slave.snapshot() == serialized
    assert Slave(slave.fmu).resume(serialized).snapshot() == serialized


@each_model
@isolated
def test_a_state_outlives_the_instance_that_it_was_taken_from(fmus, model):
    slave = moving(fmus, model, {})
    state, expected = slave.save(), slave.everything()
    slave.free()
    other = Slave(slave.fmu)
    assert other.fmi2SetFMUstate(state) == OK
    assert other.everything() == expected
    other.drop(state)


@each_model
@isolated
def test_a_state_can_be_overwritten_and_used_again(fmus, model):
    slave = Slave(unpack(fmus, model)).start()
    state = slave.save()
    address, first = state.value, slave.serialize(state)
    drive(slave, 0, 5)
    assert slave.fmi2GetFMUstate(byref(state)) == OK
    assert state.value == address
    second = slave.serialize(state)
    assert second == slave.snapshot() != first
    for _ in range(3):
        drive(slave, 5, 5)
        assert slave.fmi2SetFMUstate(state) == OK
        assert slave.snapshot() == second
    slave.drop(state)


@each_model
@isolated
def test_states_are_copies_of_their_own(fmus, model):
    slave = Slave(unpack(fmus, model)).start()
    states, expected = [], []
    for k in range(20):
        drive(slave, k, 1)
        states.append(slave.save())
        expected.append(slave.everything())
    for k in random.Random(1).sample(range(20), 20):
        assert slave.fmi2SetFMUstate(states[k]) == OK
        assert slave.everything() == expected[k]
        slave.drop(states[k])


@each_model
@isolated
def test_a_state_holds_phase_time_and_stop_time(fmus, model):
    slave = Slave(unpack(fmus, model))
    made = slave.snapshot()
    slave.start(1.0, 1.01)
    assert slave.step(1.0, H) == OK
    running = slave.snapshot()
    assert slave.fmi2Terminate() == OK
    ended = slave.snapshot()
    assert slave.resume(running).step(0.5, H) == ERROR
    assert slave.step(1.0 + H, 0.5) == ERROR
    assert slave.step(1.0 + H, H) == OK
    assert slave.resume(ended).step(1.0 + H, H) == ERROR
    assert slave.resume(made).step(1.0 + H, H) == ERROR
    slave.start()
    assert slave.step(0.0, 0.5) == OK, "without a stop time"


@each_model
@isolated
def test_a_state_does_not_hold_what_is_logged(fmus, model):
    """Logging belongs to the host's instance, not to the model."""
    loud, silent = Slave(unpack(fmus, model)), Slave(unpack(fmus, model))
    assert silent.fmi2SetDebugLogging(0, 0, None) == OK
    assert loud.fmi2SetDebugLogging(1, 0, None) == OK
    assert loud.snapshot() == silent.snapshot()
    silent.resume(loud.snapshot())
    assert silent.fmi2Terminate() == ERROR
    assert silent.messages == []


# --- buffers ------------------------------------------------------------------------------------


@each_model
@isolated
def test_a_buffer_that_is_too_small_is_not_touched(fmus, model):
    slave = Slave(unpack(fmus, model)).start()
    state = slave.save()
    size = len(slave.serialize(state))
    for room in (0, 1, size // 2, size - 1):
        buffer = create_string_buffer(b"\xaa" * size, size)
        assert slave.fmi2SerializeFMUstate(state, buffer, room) == ERROR
        assert str(size) in slave.told
        assert buffer.raw == b"\xaa" * size


@each_model
@isolated
def test_a_buffer_may_be_larger(fmus, model):
    slave = Slave(unpack(fmus, model)).start()
    state = slave.save()
    serialized = slave.serialize(state)
    buffer = create_string_buffer(b"\xaa" * (len(serialized) + 50), len(serialized) + 50)
    assert slave.fmi2SerializeFMUstate(state, buffer, len(buffer)) == OK
    assert buffer.raw == serialized + b"\xaa" * 50
    # As hosts say that do not know how large it is
    for size in (2**63 - 1, 2**63, 2**64 - 1):
        assert slave.fmi2SerializeFMUstate(state, buffer, size) == OK
    assert buffer.raw == serialized + b"\xaa" * 50


@each_case
@isolated
def test_the_size_is_that_of_the_state_whatever_the_instance_does_now(fmus, model, start):
    slave = moving(fmus, model, start)
    state, size = slave.save(), c_size_t()
    expected = len(slave.serialize(state))
    assert slave.fmi2Reset() == OK
    assert slave.fmi2SerializedFMUstateSize(state, byref(size)) == OK
    assert size.value == expected


# --- bytes that are not those of a state --------------------------------------------------------


def assert_refused(slave: Slave, damaged: bytes) -> None:
    """Check that bytes are refused, with a reason and into no state."""
    logged, state = len(slave.messages), c_void_p()
    assert slave.deserialize(damaged, state) == ERROR
    assert state.value is None
    assert len(slave.messages) == logged + 1
    assert "fmi2DeSerializeFMUstate" in slave.told


@each_case
@isolated
def test_bytes_cut_anywhere_are_refused(fmus, model, start):
    slave = moving(fmus, model, start)
    serialized = slave.snapshot()
    for length in range(len(serialized)):
        assert_refused(slave, serialized[:length])
        if length:
            assert_refused(slave, serialized[length:])
    assert slave.snapshot() == serialized


@each_case
@isolated
def test_a_single_flipped_bit_is_refused(fmus, model, start):
    slave = moving(fmus, model, start)
    serialized = slave.snapshot()
    for bit in range(8 * len(serialized)):
        damaged = bytearray(serialized)
        damaged[bit // 8] ^= 1 << bit % 8
        assert_refused(slave, bytes(damaged))
    assert slave.snapshot() == serialized


@each_model
@isolated
def test_bytes_with_something_added_are_refused(fmus, model):
    slave = moving(fmus, model, {})
    serialized = slave.snapshot()
    for added in (b"\0", b"\xff", b"\0" * 16, serialized):
        assert_refused(slave, serialized + added)
        assert_refused(slave, added + serialized)
    for place in range(len(serialized)):
        assert_refused(slave, serialized[:place] + b"\0" + serialized[place:])


@each_model
@isolated
def test_noise_is_refused(fmus, model):
    slave = moving(fmus, model, {})
    serialized, dice = slave.snapshot(), random.Random(3)
    for length in [*range(64), len(serialized), 10**6]:
        assert_refused(slave, dice.randbytes(length))
        assert_refused(slave, bytes(length))
        assert_refused(slave, serialized[:16] + dice.randbytes(length))


@each_model
@isolated
def test_a_refused_state_leaves_the_one_in_hand(fmus, model):
    slave = moving(fmus, model, {})
    state = slave.save()
    address, serialized = state.value, slave.serialize(state)
    assert slave.deserialize(serialized[:-1], state) == ERROR
    assert state.value == address
    assert slave.serialize(state) == serialized


OTHERS = [(model, other) for model in MODELS for other in MODELS if model != other]


@pytest.mark.parametrize(("model", "other"), OTHERS)
@isolated
def test_bytes_of_another_model_are_refused(fmus, model, other):
    slave = moving(fmus, model, {})
    foreign = moving(fmus, other, {}).snapshot()
    assert_refused(slave, foreign)


CONTROLLERS = ["Pid", "PidRbf", "IpidRbf"]


@pytest.mark.parametrize(
    ("model", "other"), [(m, o) for m, o in OTHERS if {m, o} <= set(CONTROLLERS)]
)
@isolated
def test_a_state_of_another_model_of_the_same_binary_is_refused(fmus, model, other):
    slave = moving(fmus, model, {})
    foreign = Slave(unpack(fmus, other), library=slave.library)
    assert foreign.component
    before, state = slave.snapshot(), foreign.start().save()
    assert slave.fmi2SetFMUstate(state) == ERROR
    assert "fmi2SetFMUstate" in slave.told
    assert slave.snapshot() == before


# --- bytes with a right checksum, and with anything in them -------------------------------------

CHECKSUM = 16
"""Bytes of the checksum, at the end."""


def fnv(data: bytes) -> int:
    """Return the 128-bit FNV-1a hash."""
    value = 0x6C62272E07BB014262B821756295C58D
    for byte in data:
        value = (value ^ byte) * 0x0000000001000000000000000000013B % (1 << 128)
    return value


def seal(content: bytes, genuine: bytes) -> bytes:
    """Append the checksum that makes the content pass, in the byte order of a genuine state."""
    (order,) = (
        order for order in ("little", "big")
        if fnv(genuine[:-CHECKSUM]).to_bytes(CHECKSUM, order) == genuine[-CHECKSUM:]
    )  # fmt: skip
    return content + fnv(content).to_bytes(CHECKSUM, order)


@each_model
@isolated
def test_the_checksum_is_fnv_1a_of_128_bits(fmus, model):
    genuine = moving(fmus, model, {}).snapshot()
    assert fnv(b"") == 0x6C62272E07BB014262B821756295C58D
    assert fnv(b"a") == 0xD228CB696F1A8CAF78912B704E4A8964
    assert seal(genuine[:-CHECKSUM], genuine) == genuine


MUTATIONS = int(os.environ.get("FMU_MUTATIONS", "1500"))
SPECIAL = [
    b"\0" * 8, b"\xff" * 8, b"\0\0\0\0\0\0\xf8\x7f", b"\0\0\0\0\0\0\xf0\x7f",
    b"\0\0\0\0\0\0\xf0\xff", b"\xff\xff\xff\xff\xff\xff\xef\x7f", b"\1" + b"\0" * 7,
]  # fmt: skip
"""Zero, ones, NaN, infinities, the largest and the smallest number, each of 8 bytes."""


def mutate(content: bytes, dice: random.Random) -> bytes:
    """Change a few bytes behind the magic, or how many there are."""
    damaged = bytearray(content)
    for _ in range(dice.choice((1, 1, 1, 2, 5))):
        place = dice.randrange(8, len(damaged))
        match dice.randrange(4):
            case 0:
                damaged[place] = dice.randrange(256)
            case 1:
                damaged[place] ^= 1 << dice.randrange(8)
            case 2:
                special = dice.choice(SPECIAL)
                damaged[place : place + 8] = special[: len(damaged) - place]
            case _:
                part = damaged[place : place + dice.randrange(1, 20)]
                damaged[place:place] = part if dice.random() < 0.5 else b""
                damaged[place : place + len(part)] = b"" if dice.random() < 0.5 else part
    return bytes(damaged)


def use(slave: Slave) -> None:
    """Do with an instance whatever its state allows; nothing of it may crash, panic or hang."""
    fmu = slave.fmu
    statuses = [
        slave.fmi2GetReal(*request(fmu, "Real")),
        slave.fmi2GetInteger(*request(fmu, "Integer")),
        slave.fmi2GetBoolean(*request(fmu, "Boolean")),
        *[slave.set(v.name, 0.5) for v in fmu.of("Real", "input")],
        slave.fmi2ExitInitializationMode(),
    ]
    time = status_time(slave)
    statuses += [slave.step(time, H), slave.step(time + H, 0.05), slave.fmi2Terminate()]
    assert FATAL not in statuses, [str(message) for message in slave.messages]
    assert slave.fmi2Reset() == OK


def request(fmu: Fmu, kind: str) -> tuple:
    """Return the arguments by which all variables of a type are read."""
    variables = fmu.of(kind)
    if not variables:
        return None, 0, None
    return references(variables), len(variables), (variables[0].c_type * len(variables))()


def status_time(slave: Slave) -> float:
    """Return the last successful time [s], 0 where there is none."""
    time = reals(0.0)
    slave.fmi2GetRealStatus(LAST_SUCCESSFUL_TIME, time)
    return time[0]


@each_case
@isolated(timeout=100)
def test_no_forged_state_crashes_panics_or_hangs(fmus, model, start):
    """What has a right checksum may be accepted; what is done with it afterwards ends well."""
    slave, dice = moving(fmus, model, start), random.Random(f"{model} {start}")
    genuine = slave.snapshot()
    fresh = Slave(slave.fmu).snapshot()
    accepted = 0
    for _ in range(MUTATIONS):
        forged = seal(mutate(dice.choice((genuine, fresh))[:-CHECKSUM], dice), genuine)
        state = c_void_p()
        status = slave.deserialize(forged, state)
        assert status in (OK, ERROR), slave.told
        if status == OK:
            accepted += 1
            assert slave.fmi2SetFMUstate(state) in (OK, ERROR), slave.told
            use(slave)
            slave.drop(state)
        slave.messages.clear()
    assert 0 < accepted < MUTATIONS
