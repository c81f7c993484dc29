"""The loop over a CAN bus: delays by arithmetic, and what is the same without a bus."""

import struct
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_master._values import document
from native import LOOPS, ROOT, printed, replaced, simulate
from pendulum_fmus.project import FMUS

EXAMPLE = ROOT / "examples" / "can" / "loop.toml"
BAUD_RATE = 500e3

same = np.testing.assert_array_equal


@pytest.fixture(scope="module", autouse=True)
def _fmus(fmus: Path, can: Path) -> None:
    pass


def frame_bits(identifier: int, data: bytes) -> int:
    """Return the bits of a data frame of classical CAN with an 11-bit identifier, written out."""
    header = f"0{identifier:011b}000{len(data):04b}"
    text = header + "".join(f"{byte:08b}" for byte in data)
    # The remainder of the division by x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1.
    remainder = int(text, 2) << 15
    for place in reversed(range(15, remainder.bit_length())):
        if remainder >> place & 1:
            remainder ^= 0xC599 << (place - 15)
    text += f"{remainder:015b}"
    sent = ""
    for bit in text:
        sent += bit
        if sent.endswith(("00000", "11111")):
            sent += "10"[int(bit)]
    return len(sent) + len("1" + "01" + "1111111")


def system(
    folder: Path,
    connections: Sequence[str],
    starts: Mapping[str, Mapping[str, Any]] | None = None,
    **keys: Any,
) -> Path:
    """Write a system of the components of the example that these connections have."""
    text = replaced(EXAMPLE.read_text(), {"../../target/fmu": str(FMUS)})
    text = replaced(text, {"../../target/examples": str(FMUS.parent / "examples")})
    example = tomllib.loads(text)
    components = [
        component
        | {"start": component.get("start", {}) | (starts or {}).get(component["name"], {})}
        for component in example.pop("component")
        if any(f"{component['name']}." in connection for connection in connections)
    ]
    example |= {"connections": list(connections), "component": components, "outputs": []} | keys
    if not example["outputs"]:
        del example["outputs"]
    file = folder / "system.toml"
    file.write_text(document(example, "component"))
    return file


def number_bits(identifier: int, value: float) -> int:
    """Return the bits of a frame with a number."""
    return frame_bits(identifier, struct.pack("<d", value))


ANGLE = 0.1
SENT_AND_ARRIVED = ["sensor.sent", "controller.arrival"]


def delays(result: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the times from the sensor to the controller in bits, between the samples."""
    between = np.arange(len(result["time"])) % 5 == 4
    sent, arrived = (result[name][between] for name in SENT_AND_ARRIVED)
    return (arrived - sent) * BAUD_RATE


def test_a_frame_on_the_idle_bus_takes_its_bits(tmp_path: Path) -> None:
    connections = ["sensor.can -> bus.node[1]", "controller.can -> bus.node[2]"]
    keys = {"outputs": SENT_AND_ARRIVED, "output_step": 0.0002, "stop": 0.02}
    starts = {"sensor": {"theta": ANGLE}, "bus": {"nodes": 2}}
    result = simulate(system(tmp_path, connections, starts, **keys), tmp_path)
    expected = number_bits(0x100, ANGLE)
    assert 108 <= expected <= 132
    np.testing.assert_allclose(delays(result), expected, atol=1e-3)


def test_a_frame_waits_for_another_one_and_three_bits(tmp_path: Path) -> None:
    connections = ["sensor.can -> bus.node[1]", "controller.can -> bus.node[2]"]
    connections.append("urgent.can -> bus.node[3]")
    keys = {"outputs": SENT_AND_ARRIVED, "output_step": 0.0002, "stop": 0.02}
    starts = {"sensor": {"theta": ANGLE}, "bus": {"nodes": 3}, "urgent": {"period": 0.001}}
    result = simulate(system(tmp_path, connections, starts, **keys), tmp_path)
    blocking = [frame_bits(0x010, struct.pack("<Q", count)) for count in range(20)]
    expected = [bits + 3 + number_bits(0x100, ANGLE) for bits in blocking]
    np.testing.assert_allclose(delays(result), expected, atol=1e-3)


def plain(folder: Path, **keys: Any) -> Path:
    """Write the same loop without a bus."""
    text = replaced((LOOPS / "pid.toml").read_text(), {"../../target/fmu/": f"{FMUS}/"})
    loop = tomllib.loads(text)
    for component in loop["component"]:
        component["fmu"] = component["fmu"].replace(".fmu", "_fmi3.fmu")
        component.pop("start", None)
    file = folder / "plain.toml"
    file.write_text(document(loop | keys, "component"))
    return file


SIGNALS = ["source.r -> controller.r", "source.d -> controller.d", "plant.theta -> sensor.theta"]
OUTPUTS = ["plant.theta", "controller.u"]


def test_nodes_that_are_connected_directly_make_the_loop_without_a_bus(tmp_path: Path) -> None:
    keys = {"start": 0.0, "stop": 2.0, "step": 0.001, "outputs": OUTPUTS}
    connections = [*SIGNALS, "sensor.can -> controller.can", "controller.u -> plant.u"]
    direct = simulate(system(tmp_path, connections, **keys), tmp_path)
    without = simulate(plain(tmp_path, **keys), tmp_path)
    for name in OUTPUTS:
        same(direct[name], without[name])
    assert abs(without["plant.theta"][-1] - 1) < 0.1


def test_a_bus_without_other_traffic_is_a_delay(tmp_path: Path) -> None:
    # Two frames and the bits between them take 438 to 534 us. The plant takes steps of 0.2 ms, so
    # it gets the force in the third step. The disturbance begins between two samples.
    source = {"amplitude": 0.0, "disturbance.amplitude": 0.1, "disturbance.start": 0.0105}
    keys = {"start": 0.0, "stop": 1.0, "step": 0.0002, "output_step": 0.001, "outputs": OUTPUTS}
    connections = [*SIGNALS, "actuator.u -> plant.u"]
    nodes = ["sensor", "controller", "actuator"]
    connections += [f"{name}.can -> bus.node[{i}]" for i, name in enumerate(nodes, 1)]
    starts = {"bus": {"nodes": 3}, "source": source}
    bus = simulate(system(tmp_path, connections, starts, **keys), tmp_path)
    delayed = {"from": "controller.u", "to": "plant.u", "faults": [{"delay": 0.0004}]}
    connections = [*SIGNALS[:2], "plant.theta -> controller.y", delayed]
    options = [f"--set=source.{name}={value}" for name, value in source.items()]
    loop = plain(tmp_path, connections=connections, **keys)
    same(bus["plant.theta"], simulate(loop, tmp_path, *options)["plant.theta"])
    assert abs(bus["plant.theta"]).max() > 0.05


def test_an_ssp_package_of_a_network_gives_the_bits_of_its_system(tmp_path: Path) -> None:
    keys = {"stop": 0.1, "step": 0.0002, "output_step": 0.0002, "order": "parallel"}
    nodes = ["sensor", "controller", "actuator", "urgent"]
    connections = [*SIGNALS, "actuator.u -> plant.u"]
    connections += [f"{name}.can -> bus.node[{i}]" for i, name in enumerate(nodes, 1)]
    file = system(tmp_path, connections, {"bus": {"nodes": len(nodes)}}, **keys)
    expected = simulate(file, tmp_path)
    assert expected["bus.busy"][-1] > 0.01
    printed("ssp", file, "--out", tmp_path)
    found = simulate(tmp_path / "system.ssp", tmp_path)
    for name in expected:
        same(found[name], expected[name])
