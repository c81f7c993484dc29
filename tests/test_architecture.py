"""Rules of ARCHITECTURE.md that the compiler does not check."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from pendulum_fmus.project import ROOT

MEMBERS = ("crates/*", "fmu-*", "modelDescription", "examples/*")
CRATES = sorted(source for member in MEMBERS for source in ROOT.glob(f"{member}/src"))
NOT_CODE = re.compile(r'//[^\n]*|r#".*?"#|"(?:\\.|[^"\\])*"', re.DOTALL)
TESTS = re.compile(r"#\[cfg\(test\)\]\s*(?:pub(?:\(\w+\))? )?mod \w+ \{.*", re.DOTALL)
USE = re.compile(r"(\bpub(?:\([\w: ]+\))?\s+)?\buse ([^;]+);")
PATH = re.compile(r"\b(?:crate|super|self)(?:::\w+)+")
DEFINITION = re.compile(r"\b(?:fn|struct|enum|union|trait|type|const|static|macro_rules!) +(\w+)")

Route = tuple[str, ...]


@dataclass
class Module:
    """A file of a crate: its definitions, the names it re-exports, and the paths it uses."""

    defined: set[str]
    exported: dict[str, Route] = field(default_factory=dict)
    globs: list[Route] = field(default_factory=list)
    used: list[Route] = field(default_factory=list)


def leaves(tree: str) -> Iterator[tuple[Route, str]]:
    """Return each path of a `use` tree with the name that it gets."""
    head, brace, inner = tree.partition("{")
    prefix = tuple(part.strip() for part in head.split("::") if part.strip())
    if not brace:
        path, _, name = head.partition(" as ")
        route = tuple(part.strip() for part in path.split("::"))
        yield route, name.strip() or route[-1]
        return
    for part in re.findall(r"(?:[^,{}]|\{(?:[^{}]|\{[^{}]*\})*\})+", inner[: inner.rindex("}")]):
        if part.strip():
            for route, name in leaves(part.strip()):
                yield prefix + route, name


def read(file: Path) -> Module:
    """Return what a file defines and uses, without its tests."""
    code = NOT_CODE.sub(lambda found: '""' if '"' in found[0][:3] else "", file.read_text())
    text = TESTS.sub("", code)
    module = Module(set(DEFINITION.findall(text)))
    for public, tree in USE.findall(text):
        for route, name in leaves(tree):
            if public and name == "*":
                module.globs.append(route[:-1])
            elif public:
                module.exported.setdefault(name, route)
            else:
                module.used.append(route)
    module.used += [tuple(path.split("::")) for path in PATH.findall(USE.sub("", text))]
    return module


def modules(source: Path) -> dict[Route, Module]:
    """Return the files of a crate by their path in the crate."""
    found = {}
    for file in source.rglob("*.rs"):
        route = file.relative_to(source).with_suffix("").parts
        found[route[:-1] if route[-1] in ("lib", "main", "mod") else route] = read(file)
    return found


def resolve(crate: dict[Route, Module], here: Route, path: Route) -> Route | None:
    """Return the file that defines the item at a path used in a file; `None` outside the crate."""
    match path:
        case ("crate", *rest):
            here = ()
        case ("super", *rest):
            here = here[:-1]
        case ("self", *rest):
            pass
        case (first, *_) if (*here, first) in crate:
            rest = list(path)
        case _:
            return None
    while rest and rest[0] == "super":
        here, rest = here[:-1], rest[1:]
    while rest and (*here, rest[0]) in crate:
        here, rest = (*here, rest[0]), rest[1:]
    if here not in crate or not rest or rest[0] in crate[here].defined:
        return here if here in crate else None
    if exported := crate[here].exported.get(rest[0]):
        return resolve(crate, here, exported)
    for glob in crate[here].globs:
        target = resolve(crate, here, glob)
        if target and target != here and rest[0] in crate[target].defined:
            return target
    return here


@pytest.mark.parametrize("source", CRATES, ids=lambda source: source.parent.name)
def test_the_files_of_a_crate_do_not_import_each_other_in_a_circle(source):
    crate = modules(source)
    graph = {
        here: {resolve(crate, here, path) for path in module.used} - {None, here}
        for here, module in crate.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        circle = ["::".join(("crate", *route)) for route in error.args[1]]
        pytest.fail(" uses ".join(reversed(circle)))
