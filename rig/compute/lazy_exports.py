"""Lazy exports of a package: a name's module is imported when the name is used.

This module imports nothing that takes time.
"""

from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_exports(package: str, modules: Mapping[str, str]) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Functions `__getattr__` and `__dir__` for the lazy exports of a package.

    The one imports the module of a name when it is used, the other lists the names.
    modules : {name: "module" that has it under that name, or "module:other name"}
    """

    def attribute(name: str) -> object:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, _, other = modules[name].partition(":")
        return getattr(import_module(module), other or name)

    return attribute, lambda: sorted({*modules, *vars(import_module(package))})
