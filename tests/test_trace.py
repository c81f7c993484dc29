"""Traces of calls: what is recorded, what survives a crash, and how calls are repeated."""

import json
import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

from fmu_master import FmuError, System, simulate
from native import in_c, refusal, run, write_system
from test_crashes import FAULTS


def lines(file: Path) -> list[dict]:
    """Return the lines of a trace, each a JSON object."""
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return in_c(tmp_path_factory.mktemp("faulty") / "Faulty.fmu")


@pytest.fixture
def folder(tmp_path: Path, faulty: Path) -> Path:
    """Return a folder with a system of one FMU."""
    shutil.copy(faulty, tmp_path / "Faulty.fmu")
    write_system(tmp_path, {"plant": {}}, fmu="Faulty", step=0.001)
    return tmp_path


def traced(folder: Path, fault: str, *options: str) -> subprocess.CompletedProcess[str]:
    sets = (f"--set=plant.fault={FAULTS.index(fault)}", "--set=plant.at=0.01")
    return run(
        "simulate", "system.toml", "--trace=t.jsonl", "--stop=0.02", *sets, *options, cwd=folder
    )


@pytest.mark.parametrize("name", ["Pendulum.fmu", "Pendulum_fmi3.fmu"])
@pytest.mark.parametrize("interface", ["co-simulation", "model-exchange"])
def test_a_trace_has_the_values_that_cross_the_interface(fmus, tmp_path, name, interface):
    file = tmp_path / "t.jsonl"
    result = simulate(
        fmus / name,
        stop_time=0.01,
        step_size=0.001,
        start_values={"theta0": 0.1},
        interface=interface,
        output=["theta"],
        trace=file,
    )
    head, component, *rest = lines(file)
    assert head["trace"] == 1
    references = {variable: reference for variable, _, reference, *_ in component["variables"]}
    calls = [line for line in rest if "call" in line and "out" in line]
    got = [
        call["out"]["values"][0]
        for call in calls
        if call["function"] in ("fmi2GetReal", "fmi3GetFloat64")
        and call["in"]["references"] == [references["theta"]]
    ]
    # Each row is what one of the calls has returned.
    assert set(result["theta"].tolist()) <= set(got)
    set_ = [c for c in rest if c.get("function") in ("fmi2SetReal", "fmi3SetFloat64")]
    assert {"references": [references["theta0"]], "values": [0.1]}.items() <= set_[0]["in"].items()
    assert [c["call"] for c in rest if "call" in c] == list(
        range(1, 1 + sum("call" in c for c in rest))
    )
    replayed = run("replay", file)
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr
    assert replayed.stdout.startswith("the same within the tolerance: ")


@pytest.mark.parametrize("fault", ["CRASH", "TELL", "EXIT_AT_ONCE"])
def test_the_trace_of_a_crash_ends_with_its_call_and_replay_crashes_there(folder, fault):
    assert traced(folder, fault).returncode == 1
    last = [line for line in lines(folder / "t.jsonl") if "call" in line][-1]
    assert (last["function"], last["in"]["time"]) == ("fmi2DoStep", 0.01)
    assert "status" not in last
    ended = lines(folder / "t.jsonl")[-1]["ended"]
    assert ended.startswith(
        "exited with code 3" if fault == "EXIT_AT_ONCE" else "was ended by signal 11"
    )
    if fault == "TELL":
        assert [line["log"] for line in lines(folder / "t.jsonl") if "log" in line] == [
            "about to crash"
        ]
    replayed = run("replay", "t.jsonl", cwd=folder)
    said = " ".join(replayed.stdout.split())
    place = f"call {last['call']} at t = 0.01 s, plant: fmi2DoStep"
    assert said == f"{place}: the process {ended}; in the trace, it {ended}"
    assert replayed.returncode == 0


def test_a_killed_program_leaves_a_trace_without_an_end(folder):
    """As after a crash within Python, nobody has completed the line."""
    traced(folder, "CRASH")
    text = (folder / "t.jsonl").read_text()
    (folder / "t.jsonl").write_text(text[: text.rindex(',"ended"')])
    replayed = run("replay", "t.jsonl", cwd=folder)
    assert replayed.returncode == 0
    assert "in the trace, it has ended" in " ".join(replayed.stdout.split())
    assert "was ended by signal 11" in replayed.stdout


def test_a_new_version_that_no_longer_crashes_differs_from_the_trace(folder):
    traced(folder, "CRASH")
    text = (folder / "t.jsonl").read_text()
    crash, none = (f'"values":[{FAULTS.index(fault)}]' for fault in ("CRASH", "NONE"))
    assert text.count(crash) == 1
    (folder / "t.jsonl").write_text(text.replace(crash, none))
    replayed = run("replay", "t.jsonl", cwd=folder)
    assert replayed.returncode == 1
    assert "it returned fmi2OK, in the trace the process was ended by signal 11" in " ".join(
        replayed.stdout.split()
    )


def test_replay_finds_the_first_value_of_another_fmu_by_the_names_of_variables(fmus, tmp_path):
    old, new, trace = (tmp_path / name for name in ("Old.fmu", "New.fmu", "t.jsonl"))
    shutil.copy(fmus / "Pendulum.fmu", old)
    simulate(old, stop_time=0.02, step_size=0.001, input={"u": 1.0}, trace=trace)
    # The trace of another model has another angle.
    all_lines = lines(trace)
    gets = (line for line in all_lines if line.get("function") == "fmi2GetReal")
    first = next(line for line in gets if line["out"]["values"][0])
    value, first["out"]["values"][0] = first["out"]["values"][0], 0.5
    trace.write_text("".join(json.dumps(line) + "\n" for line in all_lines))
    replayed = run("replay", trace, old)
    said = " ".join(replayed.stdout.split())
    assert replayed.returncode == 1
    assert said.startswith(f"call {first['call']} at t = ")
    now = re.search(r"theta = (\S+), in the trace 0.5", said)
    assert now is not None, said
    assert float(now[1]) == value
    assert "different: 1 of " in said
    loose = run("replay", trace, old, "--absolute=1")
    assert loose.returncode == 0
    # A version whose value references have moved is called by the new ones.
    with zipfile.ZipFile(old) as source, zipfile.ZipFile(new, "w") as target:
        for entry in source.infolist():
            data = source.read(entry)
            if entry.filename == "modelDescription.xml":
                data = data.replace(b'name="theta"', b'name="angle"')
            target.writestr(entry, data)
    missing = run("replay", trace, new)
    assert missing.returncode == 1
    assert "New.fmu has no such variable theta" in " ".join(missing.stdout.split())


def compiled(folder: Path, *options: object) -> subprocess.CompletedProcess[str]:
    """Write a program, compile it by the C compiler alone, and run it on the unpacked FMU."""
    done = run("replay", "t.jsonl", "--c=program.c", *options, cwd=folder)
    assert done.returncode == 0, done.stderr
    command = [
        "cc",
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-o",
        "program",
        "program.c",
        "-ldl",
    ]
    subprocess.run(command, cwd=folder, check=True)
    return subprocess.run(
        ["./program", "unpacked"], cwd=folder, check=False, capture_output=True, text=True
    )


def unpack(fmu: Path, folder: Path) -> None:
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder / "unpacked")


@pytest.mark.parametrize("name", ["Pid.fmu", "Pid_fmi3.fmu"])
def test_the_c_program_of_a_trace_finds_no_difference(fmus, tmp_path, name):
    shutil.copy(fmus / name, tmp_path)
    simulate(tmp_path / name, stop_time=0.05, step_size=0.001, trace=tmp_path / "t.jsonl")
    unpack(fmus / name, tmp_path)
    done = compiled(tmp_path)
    assert done.returncode == 0, done.stdout
    assert done.stdout.endswith("differences: 0\n")
    # It says what differs, too.
    text = (tmp_path / "program.c").read_text()
    assert "CHECK(double, values, {" in text
    text = text.replace("CHECK(double, values, {", "CHECK(double, values, {123.0 + ", 1)
    (tmp_path / "program.c").write_text(text)
    subprocess.run(["cc", "-o", "program", "program.c", "-ldl"], cwd=tmp_path, check=True)
    differing = subprocess.run(
        ["./program", "unpacked"], cwd=tmp_path, check=False, capture_output=True, text=True
    )
    assert differing.returncode == 1
    assert "DIFFERS: values[0] = " in differing.stdout


@pytest.mark.parametrize(("fault", "status"), [("CRASH", -11), ("FAIL", 0)])
def test_the_c_program_reproduces_a_fault_without_the_program(folder, fault, status):
    traced(folder, fault)
    unpack(folder / "Faulty.fmu", folder)
    done = compiled(folder, "--component=plant")
    assert done.returncode == status, done.stdout
    steps = [line for line in done.stdout.splitlines() if "fmi2DoStep" in line]
    assert len(steps) == 11
    assert "t = 0.01 s: fmi2DoStep" in steps[-1]


def test_states_and_messages_are_in_the_trace_and_replayed(fmus, tmp_path):
    from fmu_master import Instance

    file = tmp_path / "t.jsonl"
    with Instance(fmus / "Pendulum.fmu", trace=file) as plant:
        state = plant.save()
        plant.step(0.01)
        plant.restore(state)
        plant.step(0.01)
    calls = [line for line in lines(file) if "call" in line]
    saved = next(c for c in calls if c["function"] == "fmi2GetFMUstate")
    restored = next(c for c in calls if c["function"] == "fmi2SetFMUstate")
    assert (saved["out"]["state"], restored["in"]["state"]) == (1, 1)
    assert run("replay", file).returncode == 0


def test_a_profile_has_the_calls_of_each_component(fmus):
    loop = System(
        components={"controller": fmus / "Pid.fmu", "plant": fmus / "Pendulum.fmu"},
        connections=[("plant.theta", "controller.y"), ("controller.u", "plant.u")],
        step=0.001,
        stop=0.1,
    )
    for in_process in (False, True):
        result = loop.simulate(profile=True, in_process=in_process)
        times = {(t.component, t.function): t for t in result.profile}
        steps = times["plant", "fmi2DoStep"]
        assert steps.calls == times["controller", "fmi2DoStep"].calls
        assert steps.failed == 0
        assert 0 < steps.mean <= steps.longest <= steps.total
        assert result.profile[-1][:2] == ("", "")
    assert loop.simulate().profile == []
    # What is observed changes no bit.
    assert loop.simulate() == result


def test_the_command_prints_the_profile(fmus):
    done = run("simulate", fmus / "Pendulum.fmu", "--stop=0.1", "--profile")
    assert done.returncode == 0, done.stderr
    table = done.stdout.splitlines()
    titles = next(k for k, line in enumerate(table) if line.startswith("function "))
    assert table[titles].split() == [
        "function",
        "calls",
        "failed",
        "total",
        "ms",
        "mean",
        "µs",
        "longest",
        "µs",
        "share",
    ]
    assert table[-1].startswith("total")
    assert table[-1].endswith("100.0 %")
    assert table[-2].startswith("master")


def test_a_bad_trace_is_refused_with_its_line(folder):
    traced(folder, "NONE")
    text = (folder / "t.jsonl").read_text()

    def said(content: str) -> str:
        (folder / "bad.jsonl").write_text(content)
        return " ".join(refusal(folder, "replay", "bad.jsonl").split())

    assert said("") == "bad.jsonl is no trace, expected a file of `cargo fmu simulate --trace`"
    assert said("time,y\n0,1\n").startswith("bad.jsonl is no trace, expected")
    assert said(text.replace('"trace":1', '"trace":2', 1)) == (
        "bad.jsonl is a trace of version 2, expected 1; the program that wrote it reads it"
    )
    damaged = text.splitlines()
    damaged[4] = damaged[4][:-5]
    assert said("\n".join(damaged) + "\n").startswith(
        "line 5 of bad.jsonl is damaged, expected an object"
    )
    assert said("\n".join(text.splitlines()[:2]) + "\n") == "the trace has no calls to repeat"
    # A file that was cut is repeated as far as it goes.
    (folder / "cut.jsonl").write_text(text[: text.rindex('"function"') + 5])
    done = run("replay", "cut.jsonl", cwd=folder)
    assert done.returncode == 0
    assert "note: the trace ends within a line, which was left out" in done.stdout
    assert "no component pump; the components are plant" in refusal(
        folder, "replay", "t.jsonl", "--component=pump"
    )
    assert "cannot write" in refusal(folder, "simulate", "system.toml", "--trace=nowhere/t.jsonl")


def test_an_error_in_python_keeps_the_trace(folder):
    start_values = {"fault": FAULTS.index("CRASH"), "at": 0.01}
    with pytest.raises(FmuError, match="signal 11"):
        simulate(
            folder / "Faulty.fmu",
            stop_time=0.02,
            step_size=0.001,
            start_values=start_values,
            trace=folder / "t.jsonl",
        )
    assert lines(folder / "t.jsonl")[-1]["function"] == "fmi2DoStep"
