"""`cargo fmu merge`: FMUs of one model from several machines become one, or the reason is named."""

import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import fmpy
import numpy as np
import pytest

from test_exporter import cargo_fmu, refusal

XML = "modelDescription.xml"
LINUX, WINDOWS, MAC = (
    "binaries/linux64/Pid.so",
    "binaries/win64/Pid.dll",
    "binaries/darwin64/Pid.dylib",
)


def contents(fmu: Path) -> dict[str, bytes]:
    """Return the files of an archive in their order."""
    with zipfile.ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def pack(fmu: Path, files: Mapping[str, bytes]) -> Path:
    """Write an archive as other tools do."""
    with zipfile.ZipFile(fmu, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return fmu


@pytest.fixture
def pid(fmus: Path) -> Path:
    return fmus / "Pid.fmu"


@pytest.fixture
def of(pid: Path, tmp_path: Path) -> Callable[[str], Path]:
    """Return a function that writes the FMU of another machine: the same binary by another name."""

    def other(binary: str) -> Path:
        files = {binary if name == LINUX else name: data for name, data in contents(pid).items()}
        return pack(tmp_path / f"{Path(binary).parent.name}.fmu", files)

    return other


def merged(*files: Path, to: Path) -> Path:
    """Join FMUs, which must succeed."""
    result = cargo_fmu("merge", *files, "--out", to)
    assert result.returncode == 0, result.stderr
    return to


def platforms(fmu: Path) -> list[str]:
    """Return what `cargo fmu info` says."""
    line = re.search(r"^platforms +(.*)$", cargo_fmu("info", fmu).stdout, re.MULTILINE)
    assert line
    return line[1].split()


def not_merged(*files: Path) -> str:
    """Join FMUs, which must fail and leave the FMU that is there alone; returns what is said."""
    out = files[0].parent / "out"
    out.mkdir(exist_ok=True)
    (out / "joined.fmu").write_bytes(b"of yesterday")
    message = refusal("merge", *files, "-o", out / "joined.fmu")
    assert [file.read_bytes() for file in out.iterdir()] == [b"of yesterday"]
    return message


# --- what is joined -------------------------------------------------------------------------------


def test_the_joined_fmu_has_the_platforms_and_files_of_all(pid, of, tmp_path) -> None:
    joined = merged(pid, of(WINDOWS), of(MAC), to=tmp_path / "joined.fmu")
    assert platforms(joined) == ["darwin64", "linux64", "win64"]
    expected = contents(pid)
    binary = expected[LINUX]
    assert contents(joined) == expected | {WINDOWS: binary, MAC: binary}


def test_the_joined_fmu_gives_the_same_results(pid, of, tmp_path) -> None:
    joined = merged(of(WINDOWS), pid, to=tmp_path / "joined.fmu")
    signals = np.array(
        [(t, np.sin(t), 0.5) for t in np.linspace(0, 1, 101)],
        dtype=[("time", float), ("r", float), ("y", float)],
    )
    ours, theirs = (
        fmpy.simulate_fmu(file, stop_time=1, step_size=0.001, output_interval=0.01, input=signals)
        for file in (pid, joined)
    )
    assert np.ptp(ours["u"]) > 0
    np.testing.assert_array_equal(theirs, ours)


def test_the_order_is_that_of_an_export(pid, of, tmp_path) -> None:
    joined = contents(merged(of(MAC), pid, to=tmp_path / "joined.fmu"))
    names = [name for name in joined if name != MAC]
    assert names == list(contents(pid))
    assert list(joined)[:3] == [XML, MAC, LINUX]


def test_what_this_tool_has_packed_is_copied_as_it_is(pid, tmp_path) -> None:
    """So neither the order of the FMUs nor a repetition matters, and an export gives the same."""
    binary = tmp_path / "Pid.dll"
    guid = re.search(rb'guid="([^"]+)"', contents(pid)[XML])
    assert guid
    binary.write_bytes(b"MZ " + guid[1])
    export = cargo_fmu("export", "Pid", "--binary", f"win64={binary}", "--out", tmp_path)
    assert export.returncode == 0, export.stderr
    both = tmp_path / "Pid.fmu"
    for files in ((pid, both), (both, pid), (both, pid, both)):
        joined = merged(*files, to=tmp_path / "joined.fmu")
        assert joined.read_bytes() == both.read_bytes()


def test_the_fmu_that_is_written_may_be_one_that_is_read(of, pid, tmp_path) -> None:
    joined = of(WINDOWS)
    merged(joined, pid, to=joined)
    assert platforms(joined) == ["linux64", "win64"]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["win64.fmu"]


def test_an_fmu_of_another_maker_for_model_exchange(tmp_path) -> None:
    xml = b"""<?xml version="1.0"?>\r
<fmiModelDescription fmiVersion="2.0" modelName="Other" guid="x" numberOfEventIndicators="0"
    generationTool="Tool (%s)" generationDateAndTime="2026-01-01T00:00:0%sZ">
  <ModelExchange modelIdentifier="Other"/>
  <VendorAnnotations><Tool name="t">%s</Tool></VendorAnnotations>
  <ModelVariables/>
  <ModelStructure/>
</fmiModelDescription>"""
    on_linux = {"resources/table.csv": b"1,2", "binaries/linux64/Other.so": b"l", "binaries/": b""}
    on_windows = {"resources/table.csv": b"1,2", "binaries/win64/Other.dll": b"w",
                  "binaries/win64/beside.dll": b"b"}  # fmt: skip
    linux = pack(tmp_path / "linux.fmu", on_linux | {XML: xml % (b"linux", b"1", b"1")})
    windows = pack(tmp_path / "windows.fmu", on_windows | {XML: xml % (b"windows", b"2", b"2")})
    result = cargo_fmu("merge", linux, windows, "-o", tmp_path / "joined.fmu")
    assert result.returncode == 0, result.stderr
    for attribute in ("generationTool", "generationDateAndTime"):
        assert f"note: {attribute}: " in result.stderr
    assert result.stderr.count(f"that of {linux} is taken") == 2
    joined = contents(tmp_path / "joined.fmu")
    assert joined == on_linux | on_windows | {XML: xml % (b"linux", b"1", b"1")}
    assert next(iter(joined)) == XML


def test_documentation_that_differs_is_taken_from_the_first_and_named(pid, of, tmp_path) -> None:
    page = "documentation/index.html"
    windows = of(WINDOWS)
    pack(windows, contents(windows) | {page: b"<html/>", "documentation/more.txt": b"more"})
    result = cargo_fmu("merge", windows, pid, "-o", tmp_path / "joined.fmu")
    assert result.returncode == 0, result.stderr
    assert f'note: "{page}" differs' in result.stderr
    joined = contents(tmp_path / "joined.fmu")
    assert joined[page] == b"<html/>"
    assert joined["documentation/more.txt"] == b"more"


# --- what is refused ------------------------------------------------------------------------------


def test_fmus_of_different_models_are_refused_with_what_differs(pid, fmus, tmp_path) -> None:
    files = [pack(tmp_path / name, contents(fmus / name)) for name in ("Pid.fmu", "Source.fmu")]
    message = not_merged(*files)
    first, second = files
    assert f'modelName: "Pid" in {first}, "Source" in {second}' in message
    assert re.search(r'guid: "\{[^"]+\}" in .*, "\{[^"]+\}" in ', message)
    assert f'ScalarVariable "r"/causality: "input" in {first}, "output" in {second}' in message


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('version="0.1.0"', 'version="0.2.0"', 'version: "0.1.0" in {}, "0.2.0" in {}'),
        ('start="300"', 'start="9"', '/ScalarVariable "pid.kp"/Real/start: "300" in {}, "9" in {}'),
        (' fmiVersion="2.0"', "", 'fmiVersion: "2.0" in {}, nothing in {}'),
        ('name="pid.kp"', 'name="k"', ': ScalarVariable "pid.kp" in {}, nothing in {}'),
        ('canSerializeFMUstate="true"', 'canSerializeFMUstate="false"',
         'CoSimulation/canSerializeFMUstate: "true" in {}, "false" in {}'),
    ],
)  # fmt: skip
def test_another_interface_is_refused_with_the_difference(of, old, new, says) -> None:
    first, second = of(WINDOWS), of(MAC)
    files = contents(second)
    text = files[XML].decode()
    assert old in text
    pack(second, files | {XML: text.replace(old, new).encode()})
    message = not_merged(first, second)
    assert says.format(first, second) in message
    assert len(message.splitlines()) <= 3, "nothing else differs"


@pytest.mark.parametrize("name", [WINDOWS, "resources/table.csv", "sources/pid.c"])
def test_what_the_model_computes_with_must_not_differ(of, name: str) -> None:
    first, second = of(WINDOWS), of(MAC)
    for file, content in ((first, b"1"), (second, b"2")):
        pack(file, contents(file) | {name: content})
    assert f'"{name}" differs in {first} and {second}' in not_merged(first, second)


def test_a_file_that_is_no_fmu_is_named(of, tmp_path) -> None:
    sound = of(WINDOWS)
    bad = tmp_path / "bad.fmu"
    whole = bytearray(sound.read_bytes())
    whole[5000] ^= 1  # within the binary, which the model description is not
    for content, says in [
        (b"no archive", "damaged, or not an FMU"),
        (bytes(whole[:-100]), "damaged, or not an FMU"),
        (bytes(whole), "is damaged"),
    ]:
        bad.write_bytes(content)
        for files in ((bad, sound), (sound, bad)):
            message = not_merged(*files)
            assert str(bad) in message
            assert says in message
    bad.unlink()
    assert str(bad) in not_merged(sound, bad)


def test_a_hostile_archive_is_refused(of, tmp_path) -> None:
    sound = of(WINDOWS)
    for name in ("../escaped", "/etc/passwd", "binaries\\a"):
        hostile = pack(tmp_path / "hostile.fmu", contents(sound) | {name: b""})
        assert str(hostile) in not_merged(sound, hostile)


def test_one_fmu_is_too_few(of) -> None:
    assert "expected two or more" in not_merged(of(WINDOWS))


def test_the_fmu_to_be_written_must_be_named(of) -> None:
    assert "--out <FILE>" in refusal("merge", of(WINDOWS), of(MAC))


def test_a_folder_that_is_not_there_is_named(of, tmp_path) -> None:
    out = tmp_path / "nowhere" / "joined.fmu"
    assert str(out.parent) in refusal("merge", of(WINDOWS), of(MAC), "-o", out)
