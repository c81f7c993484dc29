"""The page that runs the FMUs, in headless Chromium."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import fmpy
import pytest
from fmpy import read_model_description

from pendulum_fmus.project import ROOT

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

WASM = ROOT / "target" / "wasm"
STEPS = 20_000

LOOP = """([name, steps]) => {
    const controller = new Instance(fmus[name]), plant = new Instance(fmus.Pendulum);
    controller.set("r", 0.1);
    const angles = [];
    for (let k = 0; k < steps; k++) {
        const time = k * 1e-3;
        controller.set("y", plant.get("theta"));
        controller.step(time, 1e-3);
        plant.set("u", controller.get("u"));
        plant.step(time, 1e-3);
        angles.push(plant.get("theta"));
    }
    return angles;
}"""


@pytest.fixture
def page(browser: "Browser", export, once) -> Iterator["Page"]:
    """Open the page, which must have no errors and make no requests."""
    export(WASM, "--fmi", "3.0", "--target", "wasm")
    once("page", lambda _: subprocess.run([sys.executable, ROOT / "web/build.py"], check=True))
    page = browser.new_page(bypass_csp=True)  # to wait for expressions
    errors, requests = [], []
    page.on("pageerror", lambda error: errors.append(error))
    page.on("request", lambda request: requests.append(request.url))
    page.goto((ROOT / "target/page/index.html").as_uri())
    page.wait_for_function("loops.length > 0 && time > 0.1")
    yield page
    page.close()
    assert errors == []
    assert all(request.startswith("file:") for request in requests)


def native_angles(folder: Path, name: str) -> list[float]:
    """Return the angles of the same loop of native FMUs."""
    folders = [fmpy.extract(folder / f"{fmu}_fmi3.fmu") for fmu in (name, "Pendulum")]
    descriptions = [read_model_description(path) for path in folders]
    controller, plant = (
        fmpy.instantiate_fmu(path, description, "CoSimulation")
        for path, description in zip(folders, descriptions, strict=True)
    )
    of_controller, of_plant = (
        {v.name: v.valueReference for v in description.modelVariables}
        for description in descriptions
    )
    for fmu in (controller, plant):
        fmu.enterInitializationMode()
        if fmu is controller:
            fmu.setFloat64([of_controller["r"]], [0.1])
        fmu.exitInitializationMode()
    angles = []
    for k in range(STEPS):
        controller.setFloat64([of_controller["y"]], plant.getFloat64([of_plant["theta"]]))
        controller.doStep(k * 1e-3, 1e-3)
        plant.setFloat64([of_plant["u"]], controller.getFloat64([of_controller["u"]]))
        plant.doStep(k * 1e-3, 1e-3)
        angles += plant.getFloat64([of_plant["theta"]])
    for fmu, path in zip((controller, plant), folders, strict=True):
        fmu.terminate()
        fmu.freeInstance()
        shutil.rmtree(path, ignore_errors=True)
    return angles


@pytest.mark.parametrize("name", ["Pid", "PidRbf", "IpidRbf"])
def test_loops_have_the_bits_of_the_native_fmus(page, fmus, name):
    angles = page.evaluate(LOOP, [name, STEPS])
    assert angles == native_angles(fmus, name)
    assert angles[-1] == pytest.approx(0.1, abs=0.01)


def test_controls_change_what_they_say(page):
    page.locator("#run").click()
    assert page.locator("#run").inner_text() == "Run"
    before = page.evaluate("time")
    page.locator("#once").click()
    assert page.evaluate("time") == pytest.approx(before + 0.001)
    page.locator("#on-PidRbf").check()
    assert page.evaluate("loops.map((loop) => loop.name)") == ["Pid", "PidRbf", "IpidRbf"]
    for setting, variable in (("kp", "pid.kp"), ("eta", "rbf.eta"), ("umax", "u_max")):
        page.locator(f"#{setting}").fill("100" if setting == "kp" else "1")
        got = page.evaluate("(name) => loops[1].controller.get(name)", variable)
        assert got == (100.0 if setting == "kp" else 1.0)
    for mass in ("M", "m", "l"):
        page.locator(f"#{mass}").fill("0.5")
        assert page.evaluate("(name) => loops[0].plant.get(name)", mass) == pytest.approx(0.5)
    assert "kp=100&" in page.evaluate("location.hash")
    page.reload()
    page.wait_for_function("loops.length > 0")
    assert page.locator("#kp").input_value() == "100"


def test_an_fmu_of_ones_own_runs_and_a_broken_one_is_reported(page, tmp_path):
    page.locator("#file").set_input_files(WASM / "Pid_fmi3.fmu")
    page.wait_for_function("loops.some((loop) => loop.name === 'Pid (yours)')")
    broken = tmp_path / "broken.fmu"
    broken.write_bytes(b"PK")
    page.locator("#file").set_input_files(broken)
    page.wait_for_selector("#message.error")
    message = page.locator("#message").inner_text()
    assert message == "broken.fmu cannot be used: it is not a zip archive, as an FMU is"
    page.locator("#file").set_input_files(WASM / "Source_fmi3.fmu")
    page.wait_for_function("document.getElementById('message').textContent.includes('Source')")
    assert page.locator("#message").inner_text().endswith("it has no input r")
