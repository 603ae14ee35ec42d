"""What a package hands on of its modules, which are opened when it is first asked for: importing the package takes no
time.
"""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def handed_on(package: str, places: Mapping[str, str]) -> Callable[[str], Any]:
    """A package's `__getattr__`. places : {name: "module" that has it under that name, or "module:other name"}"""

    def attribute(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, _, other = places[name].partition(":")
        return getattr(import_module(module), other or name)

    return attribute
