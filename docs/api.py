"""Writes docs/python-api.md, the reference of the Python modules, from their docstrings."""

import subprocess
import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import griffe
from jinja2 import Environment, FileSystemLoader, StrictUndefined

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "crates" / "fmu-python" / "python" / "fmu_master"
PAGE = ROOT / "docs" / "python-api.md"

MODULES = {
    "fmu_master": ["system", "instance", "result", "summary", "comparison", "sweeps", "components"],
    "fmu_master.linear": ["linear"],
    "fmu_master.tuning": ["tuning"],
    "fmu_master.gym": ["gym"],
    "fmu_master.testing": ["testing"],
}
"""The modules that users import, and the files that define their names."""


def signature(of: griffe.Class | griffe.Function) -> str:
    """Return a function, or the construction of a class, on several lines if it is long."""
    is_class = isinstance(of, griffe.Class)
    function = of["__init__"] if is_class else of
    text = f"def {function.signature(name=of.name, return_type=not is_class)}: ..."
    command = [sys.executable, "-m", "ruff", "format", f"--config={ROOT / 'pyproject.toml'}", "-"]
    done = subprocess.run(command, input=text, stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout.strip().removeprefix("def ").removesuffix(": ...")


def groups(section: griffe.DocstringSection) -> Iterator[tuple[str, str]]:
    """Yield the names that have a description in common, and the description."""
    for about, grouped in groupby(section.value, lambda item: item.description):
        items = list(grouped)
        # An exception has no name but a type.
        names = ", ".join(getattr(item, "name", str(item.annotation)) for item in items)
        is_typed = section.kind.value == "attributes"
        yield f"{names} : {items[0].annotation}" if is_typed else names, about


def kinds(of: griffe.Object) -> set[str]:
    """Return the kinds of the sections of a docstring."""
    return {section.kind.value for section in of.docstring.parsed} if of.docstring else set()


def members(of: griffe.Class) -> Iterator[tuple[str, griffe.Docstring | None]]:
    """Yield the public members of a class and their docstrings, fields without one together.

    Those of a native base class come first; the last overload of a function has its docstring.
    """
    for base in of.resolved_bases:
        if base.module.name == "_native":
            for overloads in filter(None, base.overloads.values()):
                yield "\n".join(map(signature, overloads)), overloads[-1].docstring
            yield from members(base)
    fields = []
    is_record = "dataclass" in of.labels or "__init__" not in of.members
    has_fields = is_record and "attributes" not in kinds(of)
    for name, member in of.members.items():
        if name.startswith("_") or not (member.docstring or (has_fields and member.is_attribute)):
            continue
        is_read = member.is_attribute
        fields.append(f"{name}: {member.annotation}" if is_read else signature(member))
        if member.docstring:
            yield "\n".join(fields), member.docstring
            fields = []
    if fields:
        yield "\n".join(fields), None


def page() -> str:
    """Return the page."""
    package = griffe.load(
        PACKAGE.name,
        search_paths=[PACKAGE.parent],
        docstring_parser="numpy",
        docstring_options={"warn_unknown_params": False, "warn_missing_types": False},
        allow_inspection=False,
    )
    loader = FileSystemLoader(Path(__file__).parent)
    options = {"trim_blocks": True, "lstrip_blocks": True, "keep_trailing_newline": True}
    environment = Environment(loader=loader, undefined=StrictUndefined, **options)
    filters = (groups, kinds, members, signature)
    environment.filters |= {function.__name__: function for function in filters}

    def public(module: str, files: list[str]) -> list[griffe.Object]:
        found = [item for file in files for item in package[file].members.items()]
        return [
            member
            for name, member in found
            if not (member.is_alias or name.startswith("_")) and member.docstring
            if module != PACKAGE.name or member.is_attribute or name in package.exports
        ]

    named = {module: public(module, files) for module, files in MODULES.items()}
    return environment.get_template("python-api.md.j2").render(named=named)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
