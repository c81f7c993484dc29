"""WebAssembly components, run by a host of others, the wheel of wasmtime, and by the program.

The tests of the program need the feature `sandbox`: `make sandbox`.
"""

import os
import re
import shutil
from pathlib import Path

import fmpy
import pytest
import wasmtime
import wasmtime.component
from fmpy import read_model_description
from lxml import etree

from native import LOOPS, PROGRAM, call, new_package, prepare, read, run, with_binary
from pendulum_fmus.project import ROOT

WASM = ROOT / "target" / "wasm"
PACKAGE = "fmi:fmi3"
CACHE = WASM / "cache"
EXTRA = "extra/org.modelica.fmi-ls-wasm/manifest.xml"


class Fmu:
    """An instance of a component for co-simulation or model exchange."""

    def __init__(self, path: Path, interface: str = "co-simulation"):
        self.description = read_model_description(path)
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.messages = []
        self.interface = interface
        engine = wasmtime.Engine()
        self.store = wasmtime.Store(engine)
        component = wasmtime.component.Component(engine, binary(path))
        linker = wasmtime.component.Linker(engine)
        with linker.root() as root:
            with root.add_instance(f"{PACKAGE}/callbacks@3.0.0") as callbacks:
                callbacks.add_func("log-message", lambda _, *args: self.messages.append(args))
            with root.add_instance(f"{PACKAGE}/intermediate-update-callbacks@3.0.0") as callbacks:
                callbacks.add_func("intermediate-update", lambda *_: (False, 0.0))
        self.component = linker.instantiate(self.store, component)
        given = ["it", self.description.guid, "", False, False]
        given += [False, False, []] if interface == "co-simulation" else []
        function = f"[static]{interface}-instance.instantiate-{interface}"
        self.instance = self.call(function, *given)

    def call(self, name: str, *args: object) -> object:
        """Call a function of the interface."""
        interface = f"{PACKAGE}/{self.interface}@3.0.0"
        index = self.component.get_export_index(self.store, interface)
        function = self.component.get_export_index(self.store, name, index)
        return self.component.get_func(self.store, function)(self.store, *args)

    def method(self, name: str, *args: object) -> object:
        """Call a function of the instance."""
        return self.call(f"[method]{self.interface}-instance.{name}", self.instance, *args)

    def initialize(self) -> "Fmu":
        """Initialize the instance at 0 s."""
        assert self.method("enter-initialization-mode", None, 0.0, None) == "ok"
        assert self.method("exit-initialization-mode") == "ok"
        return self

    def get(self, name: str, of: str = "float64") -> object:
        """Get a scalar variable."""
        [value] = self.method(f"get-{of}", [self.references[name]])
        return value

    def set(self, name: str, value: object, of: str = "float64") -> str:
        """Set a scalar variable; return the status."""
        return self.method(f"set-{of}", [self.references[name]], [value])


def program(*arguments: object, cache: Path = CACHE) -> tuple[int, str, str]:
    """Run the program with the feature `sandbox`; return its exit code and what it prints."""
    file = ROOT / "target" / "sandbox" / "cargo-fmu"
    done = run(*arguments, program=file, env=os.environ | {"XDG_CACHE_HOME": str(cache)})
    return done.returncode, done.stdout, done.stderr


def binary(path: Path) -> bytes:
    [(name, content)] = [file for file in read(path).items() if file[0].startswith("binaries/")]
    assert name.startswith("binaries/wasm32-wasip2/")
    return content


@pytest.fixture(scope="session")
def panicking(export, once) -> Path:
    """Export a model with texts and bytes, and with a bug."""

    def make(folder: Path) -> None:
        package = new_package("panicking", folder)
        shutil.copy(ROOT / "tests" / "data" / "panicking.rs", package / "src" / "lib.rs")

    package = once("panicking-component", make) / "panicking"
    manifest = str(package / "Cargo.toml")
    options = ["--fmi", "3.0", "--target", "wasm", "--manifest-path", manifest]
    return export(package / "fmu", *options) / "Panicking_fmi3.fmu"


def test_an_fmu_has_a_component_and_the_manifest_of_the_draft(components):
    schema = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3LayeredStandardManifest.xsd"
    paths = sorted(components.glob("*.fmu"))
    assert len(paths) == 5
    for path in paths:
        etree.XMLSchema(file=str(schema)).assertValid(etree.fromstring(read(path)[EXTRA]))
        assert b"wasi:" not in binary(path)
        assert len(binary(path)) <= 206_000
        has_exchange = read_model_description(path).modelExchange is not None
        assert (b"model-exchange-instance" in binary(path)) == has_exchange


def test_states_arrays_and_errors_pass(components):
    plant = Fmu(components / "Pendulum_fmi3.fmu").initialize()
    state = plant.method("get-fmu-state")
    before = plant.get("theta")
    plant.set("u", 5.0)
    plant.method("do-step", 0.0, 0.01, True)
    assert plant.get("theta") != before
    assert plant.method("set-fmu-state", state) == "ok"
    assert plant.get("theta") == before
    assert plant.method("set-fmu-state", state[:-1]) == "error"
    assert "damaged" in plant.messages[-1][3]
    assert plant.method("get-float64", [999]) == "error"
    name, status, category, text = plant.messages[-1]
    assert (name, status, category) == ("it", "error", "logStatusError")
    assert text == "fmi3GetFloat64: value reference 999 is unknown"
    controller = Fmu(components / "IpidRbf_fmi3.fmu").initialize()
    arrays = [v for v in controller.description.modelVariables if v.dimensions]
    assert arrays
    for variable in arrays:
        values = controller.method("get-float64", [variable.valueReference])
        assert isinstance(values, list)
        assert len(values) > 1


def test_model_exchange_has_the_derivatives_of_the_plant(components):
    plant = Fmu(components / "Pendulum_fmi3.fmu", "model-exchange").initialize()
    info = plant.method("update-discrete-states")
    assert not vars(info)["new-discrete-states-needed"]
    assert plant.method("enter-continuous-time-mode") == "ok"
    assert plant.method("get-number-of-continuous-states") == 4
    states = [0.1, 0.2, 0.3, 0.4]
    assert plant.method("set-continuous-states", states) == "ok"
    assert plant.method("get-continuous-states") == states
    rates = plant.method("get-continuous-state-derivatives")
    names = ["der(theta)", "der(omega)", "der(x)", "der(v)"]
    assert sorted(rates) == sorted(plant.get(name) for name in names)
    theta, omega = plant.references["theta"], plant.references["der(omega)"]
    [slope] = plant.method("get-directional-derivative", [omega], [theta], [1.0])
    plant.set("theta", 0.1 + 1e-6)
    quotient = (plant.get("der(omega)") - rates[1]) / 1e-6
    assert slope == pytest.approx(quotient, rel=1e-4)


def test_texts_and_bytes_pass_and_a_panic_ends_the_component_with_a_message(panicking):
    fmu = Fmu(panicking).initialize()
    assert fmu.set("text", "θ = 1", "string") == "ok"
    assert fmu.set("data", b"\0\x01", "binary") == "ok"
    fmu.method("do-step", 0.0, 0.1, True)
    assert fmu.get("echo", "string") == "θ = 1"
    assert bytes(fmu.get("copy", "binary")) == b"\0\x01"
    fmu.set("u", -1.0)
    with pytest.raises(wasmtime.WasmtimeError, match="unreachable"):
        fmu.method("do-step", 0.1, 0.1, True)
    name, status, category, text = fmu.messages[-1]
    assert (name, status, category) == ("it", "fatal", "logStatusFatal")
    assert text.endswith("the model panicked, and the component ends: u is -1.0")


@pytest.mark.sandbox
@pytest.mark.parametrize("disturbance", [0.0, 1.0])
@pytest.mark.parametrize("example", ["pid", "pid-rbf", "ipid-rbf", "supervised"])
def test_the_program_runs_all_loops_with_the_bits_of_the_native_fmus(
    example, disturbance, components, fmus, tmp_path
):
    system = tmp_path / "system.toml"
    text = (LOOPS / f"{example}.toml").read_text(encoding="utf-8")
    system.write_text(re.sub(r"(\w+)\.fmu", r"\1_fmi3.fmu", text), encoding="utf-8")
    tables = []
    for folder in (fmus, components):
        table = tmp_path / "table.csv"
        options = ["--set", f"source.disturbance.amplitude={disturbance}", "--csv", table]
        code, said, problems = program("simulate", system, "--fmus", folder, *options)
        assert code == 0, problems
        assert ("run as WebAssembly components: " in said) == (folder == components)
        tables.append(table.read_bytes())
    assert tables[0] == tables[1]
    assert tables[0].count(b"\n") > 20000


@pytest.mark.sandbox
def test_a_native_binary_is_run_unless_it_is_refused(components, fmus, tmp_path):
    both, name = tmp_path / "both.fmu", "Pendulum_fmi3.fmu"
    assert program("merge", fmus / name, components / name, "-o", both)[0] == 0
    tables = []
    for options in ([], ["--sandbox"]):
        options += ["--interface", "model-exchange", "--stop", "1", "--csv", tmp_path / "table.csv"]
        code, said, _ = program("simulate", both, "--set", "theta0=0.1", *options)
        assert code == 0
        assert ("run as WebAssembly components: both" in said) == ("--sandbox" in options)
        tables.append((tmp_path / "table.csv").read_bytes())
    assert tables[0] == tables[1]
    code, _, problems = program("simulate", fmus / name, "--sandbox")
    assert code == 1
    assert "it has no WebAssembly component, and native binaries were refused" in problems


# Without texts and bytes, the calls of a step are one.
@pytest.mark.sandbox
@pytest.mark.parametrize("output", ["y", "echo"])
@pytest.mark.parametrize(
    ("u", "reason"),
    [
        ("-1", "the model panicked, and the component ends: u is -1.0"),
        ("2", "not done after 0.5 s"),
        ("3", "it exceeds its memory limit by growing memory"),
    ],
)
def test_a_trap_is_reported_with_function_time_and_reason(u, reason, output, panicking):
    options = ["--sandbox", "--call-timeout", "0.5", "--memory-limit", "1", "--step", "0.1"]
    options += ["--output", output]
    # Compiling the component may take longer than the limit of a call.
    assert program("simulate", panicking, "--stop", "0.1")[0] == 0
    code, _, problems = program("simulate", panicking, "--set", f"u={u}", *options)
    assert code == 1
    what = "step of 0.1 s at t = 0.0 s: fmi3DoStep ended with a trap: "
    assert f"(Panicking_fmi3.fmu), {what}" in problems
    assert reason in problems


@pytest.mark.sandbox
@pytest.mark.parametrize("outputs", [["it.y"], ["it.y", "it.echo"]])
def test_an_input_that_is_refused_is_reported_with_function_and_time(
    outputs, panicking, components, tmp_path
):
    system = tmp_path / "system.toml"
    source = (components / "Source_fmi3.fmu").as_posix()
    system.write_text(
        f"""stop = 6.0
step = 0.5
connections = ["source.d -> it.u"]
outputs = {outputs}
component = [
  {{ name = "source", fmu = "{source}", start = {{ "disturbance.amplitude" = 10.0 }} }},
  {{ name = "it", fmu = "{panicking.as_posix()}" }},
]
""",
        encoding="utf-8",
    )
    code, _, problems = program("simulate", system)
    assert code == 1
    assert (
        "(Panicking_fmi3.fmu), u = 10.0 at t = 4.5 s: fmi3SetFloat64 returned fmi3Error" in problems
    )


@pytest.mark.sandbox
def test_compiled_code_is_kept_and_damage_to_it_is_repaired(panicking, tmp_path):
    command = ["simulate", panicking, "--sandbox", "--set", "text=θ", "--output", "echo"]
    for _ in range(2):
        code, said, problems = program(*command, cache=tmp_path)
        assert code == 0, problems
        assert "θ" in said
        sizes = {file: file.stat().st_size for file in (tmp_path / "cargo-fmu").iterdir()}
        assert sizes
        assert all(sizes.values())
        for file in sizes:
            file.write_bytes(b"")


def hostile(start: str = "", instantiate: str = "", enter: str = "", options: str = "") -> bytes:
    """Return a component whose functions run some code, with further options of its ABI."""
    text = (ROOT / "tests" / "data" / "hostile.wat").read_text(encoding="utf-8")
    places = {"START": start, "INSTANTIATE": instantiate, "ENTER": enter, "OPTIONS": options}
    for name, code in places.items():
        text = text.replace(name, code)
    return wasmtime.wat2wasm(text)


LOOP = "(loop (br 0))"
AGAIN = "(i32.const 0) (i32.const 0) (f64.const 0) (f64.const 0) (i32.const 0) (f64.const 0)"
LOG = "(call $log (i32.const 8) (i32.const {}) (i32.const 0) (i32.const 8) (i32.const 0) {})"
TEXT = "(i32.const 8) (i32.const 1)"
NUMBER = "(local $n i32) (local.set $n (call $create (i32.const 66)))"


@pytest.mark.sandbox
@pytest.mark.parametrize(
    ("place", "code", "reason"),
    [
        ("start", LOOP, "fmi3InstantiateCoSimulation | 5 s"),
        ("start", "unreachable", "fmi3InstantiateCoSimulation|`unreachable`"),
        ("instantiate", LOOP, "fmi3InstantiateCoSimulation | 5 s"),
        ("enter", LOOP, "fmi3EnterInitializationMode | 5 s"),
        ("enter", f"(drop (call $enter {AGAIN}))", "call stack exhausted"),
        ("enter", "(drop (memory.grow (i32.const 60000)))", "growing memory"),
        (
            "enter",
            "(drop (memory.grow (i32.const 8000))) (drop (memory.grow $own (i32.const 8000)))",
            "growing memory",
        ),
        ("enter", "(drop (table.grow (ref.null func) (i32.const 0x20000000)))", "growing table"),
        ("enter", f"(i32.store8 (i32.const 8) (i32.const 255)) {LOG.format(0, TEXT)}", "utf-8"),
        ("enter", LOG.format(-1, TEXT), "out of bounds"),
        ("enter", "(return (i32.const 77))", "discriminant"),
        (
            "enter",
            "(call $exit (i32.const 0))",
            "it calls exit of wasi:cli/exit@0.2.6, which is not granted",
        ),
        (
            "enter",
            "(i64.store (i32.const 16) (i64.const 99)) (call $date (i32.const 16))"
            "(if (i64.ne (i64.load (i32.const 16)) (call $now)) (then unreachable))",
            "fmi3ExitInitializationMode is missing from the component",
        ),
        (
            "enter",
            "(drop (call $random))",
            "fmi3ExitInitializationMode is missing from the component",
        ),
        (
            "enter",
            "(i32.store (i32.const 16) (i32.const 99)) (call $arguments (i32.const 12))"
            "(if (i32.load (i32.const 16)) (then unreachable))",
            "fmi3ExitInitializationMode is missing from the component",
        ),
        (
            "enter",
            "(i32.store16 (i32.const 8) (i32.const 0x0a61))"
            "(i32.store8 (i32.const 32) (i32.const 99))"
            "(call $write (call $stderr) (i32.const 8) (i32.const 1) (i32.const 32))"
            "(call $write (call $stderr) (i32.const 8) (i32.const 2) (i32.const 32))"
            "(call $write (call $stderr) (i32.const 8) (i32.const 1) (i32.const 32))"
            "(if (i32.load8_u (i32.const 32)) (then unreachable))",
            "warning: hostile: aa\n|warning: hostile: a\n|"
            "fmi3ExitInitializationMode is missing from the component",
        ),
        (
            "enter",
            "(i32.store16 (i32.const 8) (i32.const 0x6968))"
            "(call $greet (call $create (i32.const 65)) (i32.const 8) (i32.const 2) (i32.const 16))"
            "(if (i32.ne (i32.load16_u (i32.load (i32.const 16))) (i32.const 0x6941))"
            "(then unreachable))",
            "fmi3ExitInitializationMode is missing from the component",
        ),
        # The destructor of the nested component's resource traps for this number.
        (
            "enter",
            f"{NUMBER} (call $look (local.get $n))",
            "fmi3ExitInitializationMode is missing from the component",
        ),
        (
            "enter",
            f"{NUMBER} (call $look (local.get $n)) (call $drop (local.get $n))",
            "fmi3EnterInitializationMode|`unreachable`",
        ),
        ("options", "string-encoding=utf16", "text other than UTF-8"),
    ],
)
def test_a_hostile_component_ends_with_a_message(place, code, reason, components, tmp_path):
    component = hostile(**{place: code})
    fmu = with_binary(components / "Pid_fmi3.fmu", component, tmp_path / "hostile.fmu")
    # Loading includes compiling, within the same limit of time.
    code, _, problems = program("simulate", fmu, "--call-timeout", "5", "--memory-limit", "1")
    assert code == 1
    assert all(part in problems for part in reason.split("|")), problems


@pytest.mark.sandbox
def test_a_model_that_reads_a_resource_needs_the_later_draft(tmp_path):
    package = tmp_path / "own"
    shutil.copytree(ROOT / "tests" / "data" / "own", package)
    manifest = package / "Cargo.toml"
    manifest.write_text(manifest.read_text().replace("[REPOSITORY]", str(ROOT)))
    command = [PROGRAM, "export", "--fmi", "3.0", "--target", "wasm", "--out", tmp_path]
    refused = call(command, prepare(package))
    assert refused.returncode == 1
    assert "has no function; export it with `--wasm-draft 77277f4`" in refused.stderr
    done = call([*command, "--wasm-draft", "77277f4"], package)
    assert done.returncode == 0, done.stderr
    # The component adds 0.25, from its file.
    options = ["--sandbox", "--set", "u=1", "--stop", "0.1", "--step", "0.1", "--output", "y"]
    code, said, problems = program("simulate", tmp_path / "Own_fmi3.fmu", *options)
    assert code == 0, problems
    assert "1.25" in said


@pytest.mark.sandbox
@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "it is not a WebAssembly component"),
        (wasmtime.wat2wasm("(module)"), "it is not a WebAssembly component"),
        (hostile()[:-9], "unexpected end"),
        (wasmtime.wat2wasm("(component)"), "it has no co-simulation"),
        (
            wasmtime.wat2wasm('(component (import "a:b/c" (instance)))'),
            "it imports a:b/c, expected imports of fmi:fmi3 and of WASI only",
        ),
    ],
)
def test_a_file_that_is_no_component_of_the_draft_is_refused(content, reason, components, tmp_path):
    fmu = with_binary(components / "Pid_fmi3.fmu", content, tmp_path / "foreign.fmu")
    code, _, problems = program("simulate", fmu)
    assert code == 1
    assert reason in problems


@pytest.mark.sandbox
def test_the_validator_runs_components(components, panicking):
    for name in ("IpidRbf_fmi3.fmu", "Pendulum_fmi3.fmu"):
        code, said, _ = program("validate", "--quick", components / name)
        assert code == 0, said
        assert "no error, no warning" in said
    code, said, _ = program("validate", panicking)
    assert code == 1
    assert "binaries/wasm32-wasip2/Panicking.wasm: " in said
    assert "fmi3DoStep" in said
