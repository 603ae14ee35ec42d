"""Kernels that numba compiles when they are first called, so that a command which calls none does not open it."""

import inspect
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, cached_property, update_wrapper
from pathlib import Path
from typing import Any, cast

from rig.compute.kernel_cache import trusted_folder

_FOLDERS = threading.RLock()  # held while numba's folder is another: it has one for all threads
_say: Callable[[], None] | None = None  # to be called when something is compiled


@contextmanager
def announce_compilation(say: Callable[[], None]) -> Iterator[None]:
    """Within it `say` is called before anything is compiled that no earlier run left to be loaded, once in a
    process.
    """
    global _say
    before, _say = _say, say
    try:
        yield
    finally:
        _say = before


@cache
def _listen() -> None:
    """Hear from numba what it compiles: what it loads, which takes no time to speak of, it does not tell of."""
    from numba.core import event

    class Heard(event.Listener):
        """said : whether something was compiled already"""

        said = False

        def on_start(self, event: Any) -> None:
            """Say it, the first time."""
            if _say is not None and not self.said:
                self.said = True
                _say()

        def on_end(self, event: Any) -> None:
            """Nothing is said of an end."""

    event.register("numba:compile", Heard())


class Kernel:
    """A function that is compiled, or loaded as an earlier run compiled it, at its first call; other kernels may call
    it.

    function : as written; options : of numba.njit; folder : where what is compiled is kept, None where numba's settings
    say; to which no other user can write, or else it is another
    """

    def __init__(self, function: Callable, options: dict[str, Any], folder: Callable[[], str] | None = None) -> None:
        self._function, self._options, self._folder = function, options, folder
        update_wrapper(self, function)

    @cached_property
    def _compiled(self) -> Callable:
        import numba

        _listen()
        settings: Any = numba.config  # its names come and go with the environment
        with _FOLDERS:
            before = settings.CACHE_DIR
            try:
                beside = Path(inspect.getfile(self._function)).parent / "__pycache__"
                wanted = Path(self._folder() if self._folder is not None else settings.CACHE_DIR or beside)
                kept = trusted_folder(wanted)
                if kept != wanted and self._folder is not None:
                    kept = kept / wanted.name  # which tells one version of the sources from another
                if kept != beside:
                    settings.CACHE_DIR = str(kept)
                return cast(Callable, numba.njit(**self._options)(self._function))
            finally:
                settings.CACHE_DIR = before

    @cached_property
    def _numba_type_(self) -> Any:
        """What numba takes it for where another kernel calls it."""
        from numba import types

        return types.Dispatcher(self._compiled)

    @property
    def py_func(self) -> Callable:
        """The function as written, by which numba takes it into another kernel where its options say so."""
        return self._function

    @property
    def targetoptions(self) -> dict[str, Any]:
        """Options of numba.njit, under the name by which numba looks for them."""
        return self._options

    def __call__(self, *arguments: Any) -> Any:
        return self._compiled(*arguments)


def njit(**options: Any) -> Callable[[Callable], Any]:
    """Decorator that makes a Kernel of a function. options : of numba.njit"""
    return lambda function: Kernel(function, options)
