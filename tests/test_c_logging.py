"""What the logger is called with, and when; and that nothing goes elsewhere."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from slave import (
    ERROR,
    OK,
    Slave,
    each_model,
    in_child,
    isolated,
    texts,
    unpack,
)

CATEGORIES = [
    "logStatusError", "logStatusWarning", "logStatusDiscard", "logStatusFatal",
    "logEvents", "logAll",
]  # fmt: skip

HOSTILE = "%s%n%d%*d %%"
"""Text that crashes who takes it for a format."""


def switch(slave: Slave, on: bool, *categories: str | bytes) -> int:
    """Switch log categories; without any, all."""
    names = [name.encode() if isinstance(name, str) else name for name in categories]
    return slave.fmi2SetDebugLogging(int(on), len(names), texts(*names) if names else None)


def provoke(slave: Slave) -> set[str]:
    """Cause an event, a warning and an error; returns the categories that were logged."""
    slave.messages.clear()
    assert slave.fmi2Reset() == OK
    slave.start()
    slave.step(0.001, 0.001)
    assert slave.fmi2EnterInitializationMode() == ERROR
    return {message.category.decode() for message in slave.messages}


EVENTS, ERRORS, WARNINGS = "logEvents", "logStatusError", "logStatusWarning"
EVERY = {EVENTS, ERRORS, WARNINGS}


@each_model
@isolated
def test_categories_of_the_model_description_are_those_of_the_standard(fmus, model):
    assert unpack(fmus, model).categories == CATEGORIES


@each_model
@isolated
def test_trouble_is_told_and_events_only_if_asked_for(fmus, model):
    fmu = unpack(fmus, model)
    assert provoke(Slave(fmu)) == {ERRORS, WARNINGS}
    assert provoke(Slave(fmu, debug=True)) == EVERY


SWITCHES = [
    ([(False,)], set()),
    ([(True,)], EVERY),
    ([(False,), (True,)], EVERY),
    ([(True, EVENTS)], {EVENTS}),
    ([(True, ERRORS)], {ERRORS}),
    ([(True, WARNINGS)], {WARNINGS}),
    ([(True, "logStatusDiscard")], set()),
    ([(True, "logStatusFatal")], set()),
    ([(True, "logAll")], EVERY),
    ([(True, ERRORS, EVENTS)], {ERRORS, EVENTS}),
    ([(True, ERRORS, ERRORS)], {ERRORS}),
    ([(True, ERRORS), (True, EVENTS)], {EVENTS}),
    ([(False, EVENTS)], {ERRORS, WARNINGS}),
    ([(True,), (False, EVENTS)], {ERRORS, WARNINGS}),
    ([(True,), (False, ERRORS, WARNINGS)], {EVENTS}),
    ([(True,), (False, "logAll")], set()),
    ([(True,), (False,), (False, EVENTS)], set()),
]


@each_model
@pytest.mark.parametrize(("switches", "expected"), SWITCHES, ids=range(len(SWITCHES)))
@isolated
def test_categories_are_switched_as_they_are_named(fmus, model, switches, expected):
    slave = Slave(unpack(fmus, model))
    for on, *names in switches:
        assert switch(slave, on, *names) == OK
    assert provoke(slave) == expected


UNKNOWN = ["nonsense", "", "logall", "logStatusPending", " logAll", HOSTILE, "x" * 10_000, "grün",
           b"\xff\xfelog", b"logAll\xc3"]  # fmt: skip


@each_model
@pytest.mark.parametrize("name", UNKNOWN, ids=range(len(UNKNOWN)))
@isolated
def test_an_unknown_category_is_refused_and_switches_nothing(fmus, model, name):
    slave = Slave(unpack(fmus, model))
    assert switch(slave, True, EVENTS, name) == ERROR
    assert slave.messages[-1].category == b"logStatusError"
    assert "fmi2SetDebugLogging" in slave.told
    assert provoke(slave) == {ERRORS, WARNINGS}
    assert switch(slave, False, ERRORS, name) == ERROR
    assert provoke(slave) == {ERRORS, WARNINGS}


@each_model
@isolated
def test_text_of_the_host_is_printed_as_it_is(fmus, model):
    slave = Slave(unpack(fmus, model), HOSTILE.encode())
    assert switch(slave, True, HOSTILE) == ERROR
    assert HOSTILE in slave.told
    provoke(slave)
    assert {m.instance for m in slave.messages} == {HOSTILE.encode()}
    refused = Slave(unpack(fmus, model), HOSTILE.encode(), guid=HOSTILE.encode())
    assert refused.component is None
    assert HOSTILE in refused.told


@each_model
@isolated
def test_every_message_is_well_formed(fmus, model):
    slave = Slave(unpack(fmus, model), "Pendel ϑ".encode(), debug=True)
    provoke(slave)
    switch(slave, True, b"\xff")
    assert len(slave.messages) > 4
    statuses = {ERRORS: 3, WARNINGS: 1, EVENTS: 0}
    for message in slave.messages:
        assert message.environment == Slave.environment
        assert message.instance == "Pendel ϑ".encode()
        assert message.format == b"%s"
        assert message.status == statuses[message.category.decode()]
        assert str(message).strip() == str(message) != ""
        assert "\n" not in str(message)


@each_model
@isolated
def test_events_tell_of_every_change_of_the_state(fmus, model):
    slave = Slave(unpack(fmus, model), debug=True).start()
    assert slave.fmi2Terminate() == OK
    assert slave.fmi2Reset() == OK
    told = " | ".join(str(m) for m in slave.messages if m.category == b"logEvents")
    states = ("initialization mode", "step complete", "terminated", "instantiated")
    places = [told.rfind(state) for state in states]
    assert -1 not in places
    assert places == sorted(places)


@contextmanager
def recorded() -> Iterator[list[bytes]]:
    """Collect what this process writes to stdout and stderr."""
    found: list[bytes] = []
    with tempfile.TemporaryFile() as file:
        kept = os.dup(1), os.dup(2)
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        try:
            yield found
        finally:
            os.dup2(kept[0], 1)
            os.dup2(kept[1], 2)
            file.seek(0)
            found.append(file.read())


@each_model
@pytest.mark.parametrize("debug", [False, True])
def test_nothing_is_written_to_stdout_or_stderr(fmus, model, debug):
    def everything_that_can_go_wrong() -> bytes:
        with recorded() as found:
            fmu = unpack(fmus, model)
            slave = Slave(fmu, debug=debug)
            provoke(slave)
            refused = [slave.set(name, -(2**31)) for name in fmu.variables]
            assert ERROR in refused
            for step in (float("nan"), -1.0, 1e300):
                slave.step(0.002, step)
            slave.resume(slave.snapshot())
            slave.deserialize(b"nonsense")
            slave.free()
            Slave(fmu, guid=b"wrong")
            fmu.library.free_instance(None)
        return found[0]

    assert in_child(everything_that_can_go_wrong) == b""


def test_the_recorder_of_stdout_and_stderr_works():
    def write() -> bytes:
        with recorded() as found:
            os.write(1, b"out ")
            os.write(2, b"err")
        return found[0]

    assert in_child(write) == b"out err"
