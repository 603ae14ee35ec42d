"""Lazy exports of a package: a module is imported when one of its names is first used."""

from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_getattr(package: str, modules: Mapping[str, str]) -> Callable[[str], object]:
    """The `__getattr__` of a package that imports the module of a name lazily.
    modules : {name: "module" that has it under that name, or "module:other name"}
    """

    def attribute(name: str) -> object:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, _, other = modules[name].partition(":")
        return getattr(import_module(module), other or name)

    return attribute
