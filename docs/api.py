"""Writes docs/python-api.md, the reference of the Python modules, from their docstrings."""

import ast
import inspect
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "crates" / "fmu-python" / "python" / "fmu_master"
PAGE = ROOT / "docs" / "python-api.md"

MODULES = {
    "fmu_master": ["system", "instance", "result", "comparison", "sweeps", "components"],
    "fmu_master.linear": ["linear"],
    "fmu_master.tuning": ["tuning"],
    "fmu_master.gym": ["gym"],
    "fmu_master.testing": ["testing"],
}
"""The modules that users import, and the files that define their names."""

HEAD = """\
# Python reference

Made from the docstrings by `docs/api.py`. [The master in Python](python.md) and
[Tests and tuning](engineering.md) are the introductions.
"""

WIDTH = 100
"""The length of a line of code."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def text(docstring: str) -> str:
    """Return a docstring, whose sections have underlined headings, as Markdown."""
    parts = re.split(r"^(\w+)\n-+\n", docstring, flags=re.MULTILINE)
    sections = [parts[0].strip()]
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        if title == "Examples":
            sections.append(f"```pycon\n{body.strip()}\n```")
            continue
        # What is described stands at the margin, its description is indented.
        entries = re.split(r"^(?=\S)", body.strip(), flags=re.MULTILINE)
        lines = [re.sub(r"^(.*)\n\s+", r"- `\1`: ", entry.rstrip()) for entry in entries if entry]
        lines = [re.sub(r"\n +", "\n  ", line) for line in lines]
        listed = [line for line in lines if line.startswith("- ")]
        others = lines[len(listed) :]
        sections.append("\n".join([f"**{title}**", "", *listed]))
        sections += ["\n".join(others)] if others else []
    return "\n\n".join(sections)


def arguments(node: ast.arguments) -> Iterator[str]:
    """Yield the arguments of a function, one by one."""
    plain = [*node.posonlyargs, *node.args]
    missing = [None] * (len(plain) - len(node.defaults))
    pairs = list(zip(plain, [*missing, *node.defaults], strict=True))
    named = list(zip(node.kwonlyargs, node.kw_defaults, strict=True))
    for index, (argument, default) in enumerate([*pairs, *named]):
        if index == len(plain):
            yield "*"
        begin = ast.unparse(argument)
        if begin not in ("self", "cls"):
            yield begin if default is None else f"{begin} = {ast.unparse(default)}"
        if index == len(node.posonlyargs) - 1:
            yield "/"
    if node.kwarg:
        yield f"**{ast.unparse(node.kwarg)}"


def signature(name: str, node: Function) -> str:
    """Return a function as it is called, on several lines if it is long."""
    each = list(arguments(node.args))
    returns = f" -> {ast.unparse(node.returns)}" if node.name != "__init__" else ""
    line = f"{name}({', '.join(each)}){returns}"
    if len(line) <= WIDTH:
        return line
    return "\n".join([f"{name}(", *[f"    {argument}," for argument in each], f"){returns}"])


def is_property(node: Function) -> bool:
    """Return whether a method is read like an attribute."""
    names = {ast.unparse(decorator) for decorator in node.decorator_list}
    return bool(names & {"property", "cached_property"})


def variables(body: list[ast.stmt]) -> Iterator[tuple[str, str]]:
    """Yield the public variables of a class or module, and their docstrings."""
    for node, after in zip(body, [*body[1:], ast.Pass()], strict=True):
        if isinstance(node, ast.AnnAssign):
            name = f"{ast.unparse(node.target)}: {ast.unparse(node.annotation)}"
        elif isinstance(node, ast.Assign):
            name = ast.unparse(node)
        else:
            continue
        about = after.value if isinstance(after, ast.Expr) else None
        if isinstance(about, ast.Constant) and re.match("[a-z]|[A-Z][a-z]", name):
            yield name, inspect.cleandoc(about.value)
        elif isinstance(node, ast.AnnAssign) and not name.startswith("_"):
            yield name, ""


def members(of: ast.ClassDef) -> Iterator[tuple[str, str]]:
    """Yield the public attributes, properties and methods of a class, and their docstrings."""
    if "Attributes\n" not in (ast.get_docstring(of) or ""):
        yield from variables(of.body)
    for node in of.body:
        if not isinstance(node, Function) or node.name.startswith("_"):
            continue
        if docstring := ast.get_docstring(node):
            returns = f": {ast.unparse(node.returns)}" if node.returns else ""
            is_read = is_property(node)
            yield node.name + returns if is_read else signature(node.name, node), docstring


def described(node: ast.ClassDef | Function) -> str:
    """Return the section of a class or function."""
    docstring = ast.get_docstring(node) or ""
    shown = [] if isinstance(node, ast.ClassDef) else [node]
    if "Parameters\n" in docstring and not shown:
        shown = [item for item in node.body if getattr(item, "name", "") == "__init__"]
    parts = [f"### {node.name}"]
    parts += [f"```text\n{signature(node.name, function)}\n```" for function in shown]
    parts.append(text(docstring))
    names = []
    for name, about in members(node) if isinstance(node, ast.ClassDef) else ():
        names.append(name)
        if about:
            parts += ["```text\n{}\n```".format("\n".join(names)), text(about)]
            names = []
    if names:
        parts.append("```text\n{}\n```".format("\n".join(names)))
    return "\n\n".join(part for part in parts if part)


def page() -> str:
    """Return the page."""
    exported = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    public = next(
        ast.literal_eval(node.value)
        for node in exported.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
    )
    sections = [HEAD]
    for module, files in MODULES.items():
        sections.append(f"## {module}\n")
        for file in files:
            tree = ast.parse((PACKAGE / f"{file}.py").read_text(encoding="utf-8"))
            sections += [f"`{name}`: {about}\n" for name, about in variables(tree.body)]
            for node in tree.body:
                if not isinstance(node, ast.ClassDef | Function) or node.name.startswith("_"):
                    continue
                if module != "fmu_master" or node.name in public:
                    sections.append(f"{described(node)}\n")
    return "\n".join(sections)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
