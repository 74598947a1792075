"""The stub of the compiled part says what is there: the same names, and the same parameters in the same order."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path

import trex
from trex import _trex

STUB = ast.parse((Path(trex.__file__).parent / "_trex.pyi").read_text())
#: What every class has.
INHERITED = set(dir(object)) - {"__new__"}


def stub_functions(body: list[ast.stmt]) -> dict[str, list[str]]:
    """Names of parameters by function; properties have `None` in place of them."""
    found = {}
    for node in body:
        if isinstance(node, ast.FunctionDef):
            arguments = [argument.arg for argument in node.args.args if argument.arg not in ("self", "cls")]
            is_property = any(isinstance(mark, ast.Name) and mark.id == "property" for mark in node.decorator_list)
            found[node.name] = None if is_property else arguments
    return found


def real_parameters(function) -> list[str]:
    return [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]


def test_functions_of_the_module():
    stub = stub_functions(STUB.body)
    real = {name: value for name, value in vars(_trex).items() if inspect.isbuiltin(value)}
    assert stub.keys() == real.keys()
    for name, function in real.items():
        assert stub[name] == real_parameters(function), name


def test_classes_of_the_module():
    stubs = {node.name: node for node in STUB.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_")}
    real = {name: value for name, value in vars(_trex).items() if inspect.isclass(value)}
    assert stubs.keys() == real.keys()
    for name, kind in real.items():
        stub = stub_functions(stubs[name].body)
        members = {key: value for key, value in vars(kind).items() if key not in INHERITED and key != "__doc__"}
        members.pop("__module__", None)
        assert stub.keys() == members.keys(), name
        for member, value in members.items():
            if member == "__new__":
                assert stub[member] == real_parameters(kind), name
            elif inspect.isgetsetdescriptor(value):
                assert stub[member] is None, f"{name}.{member}"
            else:
                assert stub[member] == real_parameters(value), f"{name}.{member}"


def test_everything_of_the_package_has_types_and_words():
    for name in trex.__all__:
        thing = getattr(trex, name)
        assert thing.__doc__, name
        if inspect.isfunction(thing):
            hints = inspect.signature(thing)
            assert all(p.annotation is not p.empty for p in hints.parameters.values()), name
            assert hints.return_annotation is not hints.empty, name
    for name, member in vars(trex.Model).items():
        if not name.startswith("_"):
            assert (member.fget if isinstance(member, property) else member).__doc__, name
