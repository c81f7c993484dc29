"""The page that runs the FMUs, in headless Chromium, and its calls of components in Node, too."""

import base64
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import wasmtime
from fmpy import read_model_description

import needs
import node
from native import with_binary
from pendulum_fmus.loop import PREVIOUS_SAMPLE_TERMS, TS, Loop
from pendulum_fmus.project import ROOT

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

WASM = ROOT / "target" / "wasm"
MODELS = ["Source", "Pid", "PidRbf", "IpidRbf", "Pendulum"]

LOOP = (ROOT / "tests" / "data" / "loop.js").read_text(encoding="utf-8")

NODE = "const answer = (fmus, loops) => loops.map((loop) => couple(loop, fmus));"


@pytest.fixture
def page(browser: "Browser", page_file: Path) -> Iterator["Page"]:
    """Open the page, which must have no errors and make no requests."""
    page = browser.new_page(bypass_csp=True)  # to wait for expressions
    errors, requests = [], []
    page.on("pageerror", lambda error: errors.append(error))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(page_file.as_uri())
    page.wait_for_function("loops.length > 0 && time > 0.1")
    yield page
    page.close()
    assert errors == []
    assert all(request.startswith(("file:", "data:")) for request in requests)


Coupled = Callable[[list[dict]], list[dict[str, str]]]


def in_node() -> Coupled:
    """Return a function that couples FMUs in Node."""
    files = {name: WASM / f"{name}_fmi3.fmu" for name in MODELS}
    return lambda loops: node.in_node(files, LOOP + NODE, loops)


def in_chromium(page: "Page") -> Coupled:
    """Return a function that couples FMUs on the page, to which it adds the source."""
    source = base64.b64encode((WASM / "Source_fmi3.fmu").read_bytes()).decode()
    page.evaluate("async (text) => { fmus.Source = await readFmu(unpacked(text)); }", source)
    return lambda loops: [
        page.evaluate(f"(loop) => {{ {LOOP} return couple(loop, fmus); }}", loop) for loop in loops
    ]


def described(loop: Loop) -> dict:
    """Return a loop as JSON for `couple`: its start values with their types, by number."""
    components = []
    for name, model in loop.models().items():
        variables = {
            v.name: v for v in read_model_description(WASM / f"{model}_fmi3.fmu").modelVariables
        }
        starts = []
        for variable, value in loop.starts()[name].items():
            v = variables[variable]
            if v.type == "Enumeration":
                value = next(int(item.value) for item in v.declaredType.items if item.name == value)
            kind = "int64" if v.type == "Enumeration" else v.type.lower()
            starts.append([variable, kind, value])
        components.append({"name": name, "fmu": model, "starts": starts})
    connections = loop.connections()
    outputs = sorted({*loop.recorded(), *(output for output, _ in connections)})
    return {
        "components": components,
        "connections": connections,
        "outputs": outputs,
        "step": TS,
        "steps": loop.steps,
    }


@pytest.mark.parametrize(
    "engine",
    [
        pytest.param("node", marks=needs.NODE.mark),
        pytest.param("chromium", marks=needs.CHROMIUM.mark),
    ],
)
def test_the_loops_of_table_1_have_the_bits_of_the_native_fmus(
    engine, request, components, table_results
):
    """20000 steps. A row has the outputs of the sample that a controller takes then."""
    loops = [loop for loop in table_results if not loop.w0]
    assert len(loops) == 12
    couple = in_node() if engine == "node" else in_chromium(request.getfixturevalue("page"))
    for loop, coupled in zip(loops, couple([described(loop) for loop in loops]), strict=True):
        models = loop.models()
        for name in loop.recorded():
            late = models[name.partition(".")[0]] in PREVIOUS_SAMPLE_TERMS
            values = np.frombuffer(base64.b64decode(coupled[name]))[late : late + loop.steps]
            np.testing.assert_array_equal(values, table_results[loop][name], f"{name} of {loop}")


def test_controls_change_what_they_say(page):
    assert page.get_by_role("slider", name=re.compile(r"\w")).count() == 12
    page.locator("#run").click()
    assert page.locator("#run").inner_text() == "Run"
    page.locator("#run").click()
    page.locator("#once").click()
    before = page.evaluate("time")
    page.locator("#once").click()
    assert page.evaluate("time") == pytest.approx(before + 0.001)
    page.locator("#on-IpidRbf").check()
    assert page.evaluate("loops.map((loop) => loop.name)") == ["Pid", "PidRbf", "IpidRbf"]
    for setting, variable in (("kp", "pid.kp"), ("eta", "rbf.eta"), ("umax", "u_max")):
        page.locator(f"#{setting}").fill("100" if setting == "kp" else "1")
        got = page.evaluate("(name) => loops[1].controller.get(name)", variable)
        assert got == (100.0 if setting == "kp" else 1.0)
    for mass in ("M", "m", "l"):
        page.locator(f"#{mass}").fill("0.5")
        assert page.evaluate("(name) => loops[0].plant.get(name)", mass) == pytest.approx(0.5)
    for setting, variable in (("ki", "pid.ki"), ("kd", "pid.kd")):
        page.locator(f"#{setting}").fill("10")
        assert page.evaluate("(name) => loops[0].controller.get(name)", variable) == 10.0
    page.locator("#dynamics").select_option("2")
    page.locator("#speed").select_option("0.25")
    page.locator("#delay").fill("5")
    page.locator("#r").fill("10")
    page.locator("#d").fill("1")
    page.evaluate("advance(10)")
    of = "(name) => loops[0].controller.get(name) * 180 / Math.PI"
    assert [page.evaluate(of, name) for name in "rd"] == pytest.approx([10.0, 1.0])
    assert page.evaluate("loops[0].measured.length") == 6
    page.locator("#push").fill("30")
    page.locator("#left").click()
    assert page.evaluate("push") == -30
    page.keyboard.press("ArrowRight")
    assert page.evaluate("push") == 30
    page.locator("#scene").click()  # a little to the right of the cart
    assert page.evaluate("push") == -30
    page.locator("#reset").click()
    assert page.evaluate("time") == 0
    known = page.evaluate("location.hash")
    assert all(f"{text}&" in f"{known}&" for text in ("kp=100", "dynamics=2", "speed=0.25"))
    page.reload()
    page.wait_for_function("loops.length > 0")
    shown = [page.locator(name).input_value() for name in ("#kp", "#dynamics", "#speed")]
    assert shown == ["100", "2", "0.25"]
    page.locator("#defaults").click()
    assert page.evaluate("loops[0].controller.get('pid.kp')") == 300.0
    assert page.evaluate("settings.dynamics") == "3"


DROP = """([name, text]) => {
    const transfer = new DataTransfer();
    transfer.items.add(new File([unpacked(text)], name));
    document.body.dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, bubbles: true }));
}"""


RENAME = """(name) => {
    const read = readFmu;
    readFmu = async (bytes) => Object.assign(await read(bytes), { name });
}"""


def test_an_fmu_of_ones_own_runs_and_a_broken_one_is_reported(page, tmp_path):
    def drop(name: str, content: bytes) -> None:
        page.evaluate(DROP, [name, base64.b64encode(content).decode()])

    drop("Pid_fmi3.fmu", (WASM / "Pid_fmi3.fmu").read_bytes())
    page.wait_for_function("loops.some((loop) => loop.name === 'Pid (yours)')")
    assert page.evaluate("pushes.length") == 1
    # Without the input d, the disturbance is in what is measured.
    page.evaluate("delete fmus['Pid (yours)'].variables.d; settings.d = 1; restart(); advance(100)")
    own, other = page.evaluate(
        "['Pid (yours)', 'Pid'].map((name) => loops.find((loop) => loop.name === name).state.theta)"
    )
    assert own == other != 0.0
    drop("broken.fmu", b"PK")
    page.wait_for_selector("#message.error")
    message = page.locator("#message").inner_text()
    assert message == "broken.fmu cannot be used: it is not a zip archive, as an FMU is"
    parts = """(component (core module (memory (export "memory") 1)) (core module
        (import "env" "memory" (memory 1)) (func (export "do_step"))))"""
    page.locator("#file").set_input_files(
        with_binary(WASM / "Pid_fmi3.fmu", wasmtime.wat2wasm(parts), tmp_path / "parts.fmu")
    )
    page.wait_for_function("document.getElementById('message').textContent.includes('parts')")
    assert "no module of its component has all of the code" in page.locator("#message").inner_text()
    page.locator("#file").set_input_files(WASM / "Source_fmi3.fmu")
    page.wait_for_function("document.getElementById('message').textContent.includes('Source')")
    assert page.locator("#message").inner_text().endswith("it has no input r")
    for title, name in (("PI, tuned", "PI; tuned"), ("Pendulum", "Pendulum (yours)")):
        page.evaluate(RENAME, title)
        drop("Pid_fmi3.fmu", (WASM / "Pid_fmi3.fmu").read_bytes())
        page.wait_for_function("(name) => loops.some((loop) => loop.name === name)", arg=name)


def test_a_component_that_was_compiled_for_wasi_runs(page, tmp_path):
    text = (ROOT / "tests" / "data" / "printing.wat").read_text(encoding="utf-8")
    for v in read_model_description(WASM / "Pid_fmi3.fmu").modelVariables:
        if v.name in ("r", "y", "u"):
            text = text.replace(f"(i32.const {v.name.upper()})", f"(i32.const {v.valueReference})")
    text = text.replace("(component", "(component (core module)")  # not the first one has the code
    printed = []
    page.on("console", lambda message: printed.append(message.text))
    fmu = with_binary(WASM / "Pid_fmi3.fmu", wasmtime.wat2wasm(text), tmp_path / "printing.fmu")
    page.locator("#file").set_input_files(fmu)
    page.wait_for_function("loops.some((loop) => loop.name === 'Pid (yours)')")
    page.evaluate("running = false; settings.r = 5; restart(); advance(100)")
    of = "(name) => loops.at(-1).controller.get(name)"
    r, y, u = (page.evaluate(of, name) for name in "ryu")
    assert u == 30.0 * (r - y) != 0.0
    assert set(printed) == {"two lines"}
    page.evaluate("settings.r = 20; advance(1)")
    needed = "the component needs wasi:cli/exit@0.2.0 exit, which this page does not have"
    assert page.locator("#message").inner_text().endswith(needed)
    page.evaluate("advance(1); draw()")  # without the row of the loop that has stopped
    assert page.locator(".swing").count() == page.evaluate("loops.length") == 2


def test_a_push_is_reported_and_the_fmus_can_be_saved(page):
    page.evaluate("running = false; restart(); shove(60)")
    angles = [
        page.evaluate("advance(1); loops.map((loop) => loop.state.theta)") for _ in range(300)
    ]
    page.evaluate("advance(1); draw()")  # which looks at the angle before it
    alone, with_network = np.degrees(np.max(angles, axis=0))
    assert alone > 1.5 * with_network
    told = [text.split() for text in page.locator(".swing").all_inner_texts()]
    assert told == [["PID", f"{alone:.2f}°"], ["PID-RBF", f"{with_network:.2f}°"]]
    page.locator("#run").click()
    page.locator("#push").fill("150")
    page.locator("#right").click()
    page.wait_for_function("element('swung').textContent.startsWith('All fell over')")
    page.locator("#reset").click()
    assert not any(page.evaluate("loops.map((loop) => loop.hasFallen)"))
    with page.expect_download() as saved:
        page.locator("#downloads a", has_text="PidRbf").first.click()
    assert Path(saved.value.path()).read_bytes() == (WASM / "PidRbf_fmi3.fmu").read_bytes()


OUTCOME = """loops.map(({ largestError, hasFallen, history }) => {
    const forces = history.filter(({ t }) => t > time - 1).map(({ force }) => force[0]);
    const range = Math.max(...forces) - Math.min(...forces);
    return { error: hasFallen ? Infinity : degrees(largestError), range };
})"""
"""The largest error of each loop since the push in degrees, and the range of its last forces."""

CLAIMS: dict[str, Callable[[dict, dict], bool]] = {
    "A push": lambda pid, network: pid["error"] > 3 * network["error"] > 3,
    "The paper's step": lambda pid, network: network["error"] < pid["error"] / 10,
    "8 ms late: the network loses": lambda pid, network: network["error"] > 2 * pid["error"] > 5,
    "No integral": lambda pid, network: pid["before"] > 1 > 100 * network["before"],
    "Weak gains": lambda pid, network: math.isinf(pid["error"]) and network["error"] < 60,
    "Learning too fast": lambda pid, network: network["range"] > 100 > 10 * pid["range"],
    "At the limit": lambda pid, network: 40 < 0.9 * pid["error"] < network["error"] < 90,
}
"""What the sentence of each preset says, of PID and of each network."""


@pytest.mark.parametrize("preset", CLAIMS)
def test_a_preset_shows_what_its_sentence_says(page, preset):
    page.evaluate("running = false")
    page.locator("#on-IpidRbf").check()
    assert page.locator("#presets a").all_inner_texts() == list(CLAIMS)
    page.locator("#presets a", has_text=preset).click()
    page.wait_for_selector(f'#presets a[aria-current=true]:text-is("{preset}")')
    page.wait_for_function("time === 0 || Math.abs(time - SETTLE) < 1e-9")
    before = page.evaluate("loops.map(({ history }) => Math.abs(history.at(-1).error[0]))")
    page.evaluate("pass(3); draw()")
    outcome = page.evaluate(OUTCOME)
    pid, *networks = [{**loop, "before": e} for loop, e in zip(outcome, before, strict=True)]
    assert len(networks) == 2
    assert all(CLAIMS[preset](pid, network) for network in networks), outcome


def test_the_default_push_can_be_seen_and_no_controller_falls(page):
    page.evaluate("running = false")
    page.locator("#on-IpidRbf").check()
    for side in ("left", "right"):
        page.evaluate("restart()")
        page.locator(f"#{side}").click()
        page.evaluate("pass(5)")
        errors = [loop["error"] for loop in page.evaluate(OUTCOME)]
        assert all(2 < error < 10 for error in errors), errors
        assert max(map(abs, page.evaluate("loops.map((loop) => degrees(loop.state.theta))"))) < 0.1


@pytest.mark.parametrize(
    ("address", "told", "setting", "used"),
    [
        ("on=Nope", "on=Nope: expected Pid, PidRbf, IpidRbf, or an FMU", "on", "Pid,PidRbf"),
        ("on=Pendulum", "on=Pendulum: expected Pid, PidRbf", "on", "Pid,PidRbf"),
        ("on=IpidRbf,Nope,constructor", "on=Nope,constructor: expected", "on", "IpidRbf"),
        ("dynamics=1", "dynamics=1: expected 3 (nonlinear) or 2 (linear); 3 is", "dynamics", "3"),
        ("r=61", "r=61: expected a number from -60 to 60; 0 is used instead", "r", 0),
        ("kp=NaN", "kp=NaN: expected a number from 0 to 1000; 300 is", "kp", 300),
        ("M=", "M=: expected a number from 0.2 to 5; 1.096 is", "M", 1.096),
        ("delay=1.5", "delay=1.5: expected a whole number from 0 to 30", "delay", 0),
        ("kq=1&kp=7", "kq=1: expected one of the settings r, d, push", "kp", 7),
    ],
)
def test_what_an_address_has_wrong_is_said(page, address, told, setting, used):
    page.evaluate("(address) => { location.hash = address; }", address)
    page.wait_for_selector("#message.error")
    assert page.locator("#message").inner_text().startswith(f"Not used of the address:\n{told}")
    assert page.evaluate("(name) => settings[name]", setting) == used
    assert page.evaluate("loops.map(({ name }) => name).join()") == page.evaluate("settings.on")
    page.locator("#reset").click()
    assert page.locator("#message").inner_text() == ""


def test_many_wrong_values_are_counted_and_no_controller_is_said(page):
    page.evaluate("location.hash = 'on=&a=1&b=1&c=1&e=1&f=1'")
    page.wait_for_selector("#message.error")
    assert page.locator("#message").inner_text().endswith("\nand 2 more")
    page.wait_for_function("element('swung').textContent.startsWith('No controller')")


def test_the_link_has_all_settings_and_the_browser_goes_back(page):
    page.locator("#presets a", has_text="8 ms late").click()
    page.wait_for_function("settings.delay === 8")
    page.locator("#kd").fill("90")
    page.locator("#on-IpidRbf").check()
    page.locator("#copy").click()
    page.wait_for_function("element('copy').textContent === 'Copied'")
    page.evaluate("element('message').outerHTML += '<textarea id=pasted></textarea>'")
    page.locator("#pasted").focus()
    page.keyboard.press("Control+V")
    link = page.locator("#pasted").input_value()
    shared = "({ ...settings, names: loops.map(({ name }) => name) })"
    settings = page.evaluate(shared)
    assert all(name in f"&{link.partition('#')[2]}" for name in settings if name != "names")
    page.locator("#presets a", has_text="A push").click()
    page.wait_for_function("settings.delay === 0")
    assert page.evaluate("settings.kd") == 100
    page.go_back()
    page.wait_for_function("settings.delay === 8")
    assert page.evaluate(shared) == settings
    assert page.locator("#kd").input_value() == "90"
    page.goto("about:blank")
    page.goto(link)
    page.wait_for_function("loops.length > 0")
    assert page.evaluate(shared) == settings


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_the_carts_first_and_its_controls_can_be_touched(
    browser, page_file, scheme, components
):
    context = browser.new_context(
        viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True, color_scheme=scheme
    )
    page = context.new_page()
    page.goto(f"{page_file.as_uri()}#on=Pid,PidRbf,IpidRbf,A-name-that-is-longer-than-the-others")
    page.wait_for_selector("#message.error")
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    controls = page.locator("button, select, input[type=range], input[type=file], a, .controller")
    boxes = [control.bounding_box() for control in controls.all()]
    assert len(boxes) > 30
    assert all(box["height"] >= 44 for box in boxes)
    assert all(0 <= box["x"] <= box["x"] + box["width"] <= 390 for box in boxes)
    page.locator("#reset").click()
    assert page.locator("#right").bounding_box()["y"] < 844 - 44
    context.close()


def test_without_motion_a_push_shows_what_follows_it(browser, page_file):
    page = browser.new_page(reduced_motion="reduce", bypass_csp=True)
    page.goto(page_file.as_uri())
    page.wait_for_function("loops.length > 0")
    assert page.locator("#run").inner_text() == "Run"
    assert page.evaluate("time") == pytest.approx(3.0)
    page.locator("#right").click()
    assert page.evaluate("time") == pytest.approx(6.0)
    page.wait_for_function(
        "element('told').textContent.endsWith(element('effect').innerText.split('\\n').at(-1))"
    )
    page.close()
