"""Signals that are no numbers: Strings and Binaries from one FMU to another, and MIME types."""

import csv
from pathlib import Path

import pytest

from fmu_master import FmuError, Instance, System, simulate
from native import SOURCES, in_c, printed, refusal, replaced, write_system

LINKS = ["a.said -> b.text", "a.sent -> b.bytes"]
OUTPUTS = ["a.said", "b.heard", "a.sent", "b.received"]

SENT, BYTES = (
    'mimeType="application/x-letters; version=1" maxSize="63"',
    'name="bytes" valueReference="2" causality="input" maxSize="32"',
)
"""The attributes of the Binary that a component sends, and of the one that it receives."""


@pytest.fixture
def letters(tmp_path) -> Path:
    """Return an FMU that sends a text and bytes, which grow by one with each step."""
    return in_c(tmp_path / "Letters.fmu")


def with_mime_types(folder: Path, output: str, received: str) -> Path:
    """Write the FMU with other MIME types; an empty one is left out."""
    of_output, of_input = (f" mimeType='{of}'" if of else "" for of in (output, received))
    xml = (SOURCES / "letters.xml").read_text(encoding="utf-8")
    xml = replaced(xml, {SENT: 'maxSize="63"' + of_output, BYTES: BYTES + of_input})
    return in_c(folder / "Letters.fmu", xml=xml)


def test_texts_and_bytes_are_passed_as_they_are(letters):
    folder = letters.parent
    system = write_system(folder, {"a": {}, "b": {}}, LINKS, "Letters", outputs=OUTPUTS)
    printed("simulate", system, "--csv", folder / "results.csv")
    with (folder / "results.csv").open(encoding="utf-8", newline="") as lines:
        _, *rows = csv.reader(lines)
    # In sequential order, b receives what a sends in the same step.
    expected = [("abcde"[:n], bytes(range(n)).hex()) for n in range(1, 6)]
    assert rows == [
        [str(0.25 * (len(text) - 1)), text, text, sent, sent] for text, sent in expected
    ]
    result = System(system).simulate()
    for name in ("a.sent", "b.received"):
        assert list(result[name]) == [bytes(range(n)) for n in range(1, 6)]
    assert list(result["b.heard"]) == ["abcde"[:n] for n in range(1, 6)]


def test_a_binary_that_is_larger_than_its_input_allows_ends_the_run(letters):
    folder = letters.parent
    system = write_system(folder, {"a": {}, "b": {}}, LINKS, "Letters", outputs=OUTPUTS)
    reason = "the Binary is too large: 33 bytes, expected at most 32"
    message = f"b (Letters.fmu), a.sent -> b.bytes at t = 8.0 s: {reason}"
    assert refusal(folder, "simulate", system, "--stop", 12) == message
    with pytest.raises(FmuError) as caught:
        System(system).changed(stop=12.0).simulate()
    assert str(caught.value) == message


def test_start_values_and_tables_have_bytes_of_the_size_of_their_input(letters):
    folder, most = letters.parent, bytes(range(32))
    for value in (most, b""):
        result = simulate(letters, start_values={"bytes": value}, output="received")
        assert list(result["received"]) == [value] * 5
    system = write_system(folder, {"a": {"bytes": most.hex().upper()}}, fmu="Letters")
    assert System(system).simulate(output="a.received")["a.received"][0] == most
    keys = {"components": {"a": {"fmu": letters, "start": {"bytes": most}}}}
    started = System(**keys, step=0.5, stop=1.0, outputs=["a.received"])
    assert started.simulate()["a.received"][0] == most
    table = {"time": [0.0, 0.5], "bytes": [b"\0", most]}
    received = simulate(letters, input=table, output="received")["received"]
    assert list(received) == [b"\0", b"\0", b"\0", most, most]
    file = folder / "table.csv"
    file.write_text(f"time,bytes\n0,00\n0.5,{'00' * 33}\n", encoding="utf-8")
    text = refusal(folder, "simulate", letters, "--input", file)
    assert text.endswith("row 2: bytes has 33 bytes, expected at most 32")
    digits = "expected two hexadecimal digits for each byte, at most 32 bytes"
    for value, message in (
        (most + b"!", "bytes has 33 bytes, expected at most 32"),
        ("0", 'bytes = "0" is invalid; ' + digits),
        (0, "bytes = 0 is invalid; " + digits),
    ):
        with pytest.raises(FmuError) as caught:
            simulate(letters, start_values={"bytes": value})
        assert str(caught.value).endswith(message)
    with pytest.raises(FmuError, match='text = "00" is invalid; expected a quoted string'):
        simulate(letters, start_values={"text": b"\0"})


@pytest.mark.parametrize("in_process", [False, True])
def test_an_instance_takes_and_returns_bytes_and_texts(letters, in_process):
    with Instance(letters, start_values={"bytes": b"\0\xff"}, in_process=in_process) as instance:
        assert instance.get("received") == b"\0\xff"
        instance.set({"bytes": b"a" * 32, "text": "é"})
        instance.step(0.25)
        received, heard, sent = instance.get(["received", "heard", "sent"])
        assert (received, heard, sent) == (b"a" * 32, "é", b"\0")
        with pytest.raises(FmuError, match=r"bytes has 33 bytes, expected at most 32$"):
            instance.set("bytes", b"a" * 33)
        with pytest.raises(FmuError, match=r'bytes = "61" is invalid'):
            instance.set("bytes", "61")
        with pytest.raises(FmuError, match=r'text = "61" is invalid'):
            instance.set("text", b"a")


BUS = 'application/org.fmi-standard.fmi-ls-bus.can; version="1.0.0"'


@pytest.mark.parametrize(
    ("output", "received"),
    [
        (BUS, BUS.replace('"', "").upper().replace("VERSION=", "Version =")),
        ("a/b; x=1; y=2", "A/B;Y=2;X=1"),
        (BUS, ""),
        ("", BUS),
        (BUS, "application/octet-stream"),
    ],
)
def test_mime_types_that_mean_the_same_are_connected(tmp_path, output, received):
    with_mime_types(tmp_path, output, received)
    system = write_system(tmp_path, {"a": {}, "b": {}}, LINKS, "Letters")
    assert System(system).simulate(output="b.received")["b.received"][-1] == bytes(range(5))


@pytest.mark.parametrize(
    "received",
    [BUS.replace("can", "lin"), BUS.replace("1.0.0", "1.1.0"), "a/b; version=1.0.0", BUS + "; x=1"],
)
def test_other_mime_types_are_refused_by_name(tmp_path, received):
    with_mime_types(tmp_path, BUS, received)
    system = write_system(tmp_path, {"a": {}, "b": {}}, LINKS, "Letters")
    message = f"a.sent ({BUS}) cannot feed b.bytes ({received}): the MIME types differ"
    assert refusal(tmp_path, "simulate", system).endswith(message)
    with pytest.raises(FmuError) as caught:
        System(system).simulate()
    assert str(caught.value).endswith(message)


@pytest.mark.parametrize(
    ("link", "message"),
    [
        ("a.said -> b.bytes", "a.said (String) cannot feed b.bytes (Binary): the types differ"),
        ("a.sent -> b.text", "a.sent (Binary) cannot feed b.text (String): the types differ"),
        (
            {"from": "a.sent", "to": "b.bytes", "factor": 2.0},
            "a.sent cannot feed b.bytes with a factor: both must be real numbers",
        ),
        (
            {"from": "a.said", "to": "b.text", "faults": [{"delay": 0.5}]},
            "a.said cannot feed b.text with faults: both must be real numbers",
        ),
    ],
)
def test_texts_and_bytes_feed_their_own_type_unchanged(letters, link, message):
    system = write_system(letters.parent, {"a": {}, "b": {}}, [link], "Letters")
    assert refusal(letters.parent, "simulate", system).endswith(message)
