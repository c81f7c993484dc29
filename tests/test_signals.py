"""Signals that are no numbers: Strings and Binaries from one FMU to another, and MIME types."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from fmu_master import (
    FmuError,
    Instance,
    System,
    compare,
    python_component,
    read,
    simulate,
    sweep,
)
from native import SOURCES, in_c, printed, refusal, replaced, run, write_system
from native import read as archive

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


# --- clocked variables ----------------------------------------------------------------------------


@pytest.fixture
def clocked(tmp_path) -> Path:
    """Return a system with ticks at 0, 0.25 and 0.5 s, and rows each 0.1 s up to 0.6 s."""
    in_c(tmp_path / "Ticker.fmu")
    outputs = ["a.value", "a.sent", "a.samples"]
    times = {"stop": 0.6, "step": 0.1}
    start = {"a": {"received": False}}
    return write_system(tmp_path, start, fmu="Ticker", outputs=outputs, **times)


TICKS = [True, False, False, True, False, True, False]
"""The rows since whose last one the clock has ticked."""


def test_a_clocked_variable_is_absent_in_rows_without_a_tick(clocked):
    folder = clocked.parent
    printed_summary = printed("simulate", clocked, "--csv", folder / "a.csv")
    header, *lines = (folder / "a.csv").read_text(encoding="utf-8").splitlines()
    assert header == "time [s],a.value,a.sent,a.samples"
    values, ticks = zip(*(line.split(",")[1:3] for line in lines), strict=True)
    assert list(values) == ["1.0" if tick else "" for tick in TICKS]
    assert list(ticks) == ["true" if tick else "false" for tick in TICKS]
    # The statistics are of the values that there are.
    assert re.search(r"a\.value +1\.000e0 +1\.000e0 +1\.000e0 +absent", printed_summary)
    printed("simulate", clocked, "--csv", folder / "a.parquet")
    column = pyarrow.parquet.read_table(folder / "a.parquet")["a.value"]
    assert column.to_pylist() == [1.0 if tick else None for tick in TICKS]
    same = printed("compare", folder / "a.csv", folder / "a.parquet")
    assert same.startswith("the same within the tolerance")
    changed = (folder / "a.csv").read_text(encoding="utf-8").replace("0.1,,", "0.1,1.0,")
    (folder / "b.csv").write_text(changed, encoding="utf-8")
    found = run("compare", folder / "a.csv", folder / "b.csv")
    assert found.returncode == 1
    assert "a.value differs at t = 0.1 s: missing in" in found.stdout


def test_absent_values_are_masked_in_python(clocked):
    folder, result = clocked.parent, System(clocked).simulate()
    values, times = result["a.value"], result["time"]
    assert np.ma.isMaskedArray(values)
    assert list(~values.mask) == TICKS
    np.testing.assert_allclose(times[~values.mask], [0, 0.3, 0.5], rtol=1e-12)
    assert list(values.compressed()) == [1.0] * 3
    assert list(result["a.sent"]) == TICKS
    assert result.summary["a.value"]["rms"] == 1.0
    assert np.isnan(result.summary["a.value"]["last"])
    # Files and data frames keep them.
    for name in ("a.csv", "a.parquet"):
        printed("simulate", clocked, "--csv", folder / name)
        result.write(folder / f"python-{name}")
        assert (folder / f"python-{name}").read_bytes() == (folder / name).read_bytes()
        assert read(folder / name) == result
        assert compare(folder / name, result).is_same
    assert list(result.to_pandas()["a.value"].notna()) == TICKS
    assert result.to_polars()["a.value"].to_list() == [1.0 if tick else None for tick in TICKS]
    line = result.plot(["a.value"]).axes[0].lines[0]
    np.testing.assert_array_equal(line.get_xdata(), times[~values.mask])
    assert "a.value" in str(result)
    other = System(clocked).changed(outputs=["a.samples", "a.sent"]).simulate()
    assert result != other
    assert other == result[["a.samples", "a.sent"]]


def test_rows_between_have_the_last_of_several_ticks(clocked):
    result = System(clocked).changed(step=0.3, output_step=0.6).simulate()
    assert list(result["a.sent"]) == [True, True]
    assert list(result["a.value"].mask) == [False, False]


def test_a_clocked_variable_is_no_signal_of_a_sweep(clocked):
    signals = dict.fromkeys(("reference", "output", "error", "control"), "a.value")
    with pytest.raises(FmuError, match=r"a\.value cannot be a signal: it is clocked"):
        sweep({"a.interval": [1.0]}, System(clocked), signals=signals)


def test_functions_of_python_take_and_return_texts_and_bytes(letters):
    def answer(time: float, text: str, data: bytes) -> tuple[str, bytes]:
        return text.upper(), bytes(reversed(data))

    types = {"text": "String", "said": "String", "data": "Binary", "sent": "Binary"}
    system = System(
        components={
            "a": letters,
            "f": python_component(["text", "data"], ["said", "sent"], answer, types=types),
            "b": letters,
        },
        connections=[
            ("a.said", "f.text"),
            ("a.sent", "f.data"),
            ("f.said", "b.text"),
            ("f.sent", "b.bytes"),
        ],
        step=0.25,
        stop=1.0,
        outputs=["b.heard", "b.received", "f.sent"],
    )
    for in_process in (False, True):
        result = system.simulate(in_process=in_process)
        assert list(result["b.heard"]) == ["ABCDE"[:n] for n in range(1, 6)]
        assert list(result["b.received"]) == [bytes(reversed(range(n))) for n in range(1, 6)]
    wrong = python_component([], ["sent"], lambda t: "text", types={"sent": "Binary"})
    with pytest.raises(FmuError, match="it returned text for sent, expected a Binary"):
        System(components={"f": wrong}, step=0.5, stop=1.0).simulate()


def test_info_tells_when_clocks_tick_and_what_binaries_are(clocked, letters):
    text = printed("info", clocked.parent / "Ticker.fmu")
    for line in (
        "  sample (input, constant, every 0.25 s)",
        "  received (input, triggered): message",
        "  sent (output, triggered): value",
    ):
        assert f"{line}\n" in text.partition("\nclocks\n")[2]
    found = json.loads(printed("info", "--json", clocked.parent / "Ticker.fmu"))["variables"]
    about = {variable["name"]: variable for variable in found}
    assert about["sample"]["intervalVariability"] == "constant"
    assert (about["sample"]["interval"], about["sample"]["priority"]) == (0.25, None)
    assert about["message"]["clocks"] == ["received"]
    assert "clocks" not in about["u"]
    text = printed("info", letters)
    assert "\nbinaries\n  bytes: at most 32 bytes\n  sent: application/x-letters; " in text


def test_a_trace_has_the_calls_of_clocks_and_is_replayed(clocked):
    trace = clocked.parent / "trace.jsonl"
    printed("simulate", clocked, "--trace", trace)
    assert printed("replay", trace).startswith("the same within the tolerance")
    text = printed("replay", trace, "--print")
    assert "fmi3SetClock" in text
    assert "fmi3GetClock" in text
    assert "fmi3SetClock" in printed("replay", trace, "--c", clocked.parent / "calls.c") or (
        "fmi3SetClock" in (clocked.parent / "calls.c").read_text(encoding="utf-8")
    )


SSD = """<SystemStructureDescription version="2.0" name="clocks"
xmlns="http://ssp-standard.org/SSP1/SystemStructureDescription"
xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"><System name="clocks"><Elements>
  <Component name="a" source="Ticker.fmu"><Connectors>
    <Connector name="sent" kind="output"><ssc:Clock intervalVariability="triggered"/></Connector>
    <Connector name="value" kind="output"><ssc:Float64/><Clock name="sent"/></Connector>
  </Connectors></Component></Elements></System>
  <DefaultExperiment stopTime="0.5"/></SystemStructureDescription>"""


def test_ssp_packages_have_clocks(clocked):
    folder, fmu = clocked.parent, clocked.parent / "Ticker.fmu"
    links = ["a.sent -> b.received", "a.value -> b.message", "b.sent -> a.received"]
    links += ["b.value -> a.message"]
    outputs = ["a.value", "b.sent", "b.seen"]
    components = {"a": {}, "b": {"delay": 0.1}}
    keys = {"outputs": outputs, "step": 0.1, "order": "parallel"}
    system = write_system(folder, components, links, "Ticker", **keys)
    printed("ssp", system, "--out", folder)
    structure = archive(folder / "system.ssp")["SystemStructure.ssd"].decode()
    for part in (
        'version="2.0"',
        '<ssc:Clock intervalVariability="triggered"/>',
        '<ssd:Clock name="sent"/>',
    ):
        assert part in structure
    expected = System(system).simulate()
    assert System(folder / "system.ssp").simulate(output=outputs) == expected
    for old, new, message in (
        ("<ssc:Float64/>", "<ssc:Clock/>", "the connector a.value is a Clock, but a Float64 in"),
        ('Clock name="sent"', 'Clock name="tick"', "a.value belongs to the clock tick, but not in"),
    ):
        (folder / "bad.ssd").write_text(replaced(SSD, {old: new}), encoding="utf-8")
        assert message in refusal(folder, "simulate", folder / "bad.ssd")
    assert fmu.exists()


def test_ssp_packages_have_mime_types_and_bytes(tmp_path):
    with_mime_types(tmp_path, BUS, BUS)
    start = {"a": {"bytes": "00ff"}, "b": {}}
    system = write_system(tmp_path, start, LINKS, "Letters", outputs=OUTPUTS, order="parallel")
    printed("ssp", system, "--out", tmp_path)
    structure = archive(tmp_path / "system.ssp")["SystemStructure.ssd"].decode()
    assert 'version="1.0"' in structure
    assert '<ssv:Binary value="00ff"' in structure
    assert "mime-type=" in structure
    package = System(tmp_path / "system.ssp")
    assert package.simulate(output=OUTPUTS) == System(system).simulate()
    text = structure.replace("resources/", "")
    at = text.index('name="sent"')
    changed = text[:at] + text[at:].replace("ls-bus.can", "ls-bus.lin", 1)
    (tmp_path / "bad.ssd").write_text(changed, encoding="utf-8")
    message = refusal(tmp_path, "simulate", tmp_path / "bad.ssd")
    assert "are connected, but their MIME types differ" in message
