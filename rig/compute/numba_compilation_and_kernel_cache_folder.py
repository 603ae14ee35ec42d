"""Numba compilation of kernels, and their cache folder.

Kernels are compiled lazily; the folder is private.
Files in the cache are loaded as code, so their folder must be private.
"""

import hashlib
import inspect
import os
import platform
import stat
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, cached_property, update_wrapper
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, TypedDict, TypeVar, Unpack, cast

if TYPE_CHECKING:
    from numba.core.dispatcher import Dispatcher


HERE = Path(__file__).parents[1]
PACKAGES = frozenset({"rig", "vision", "calib", "synthetic"})
# What LLVM calls a processor of which kernels take no more than all of a kind have, and features that it must have for
# that. So kernels that one computer compiled run on another, and a release can contain them.
PORTABLE = {
    "x86_64": ("x86-64-v3", ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")),
    "aarch64": ("generic", ("neon",)),
}
F = TypeVar("F", bound=Callable[..., object])


class CompilerOptions(TypedDict, total=False):
    """Options of numba.njit.

    There is no fastmath here. It lets the compiler round differently in each caller of a kernel. A process links one
    of these copies, another one where kernels come from the cache, and results would depend on the cache.
    """

    cache: bool
    nogil: bool
    error_model: Literal["python", "numpy"]
    inline: Literal["never", "always"]


def set_kernel_cache_folder() -> None:
    """Set numba's cache folder for compiled kernels.

    Before numba is imported, and unless the user has set one.
    """
    folder = kernel_cache_folder()
    if folder is not None:
        os.environ.setdefault("NUMBA_CACHE_DIR", str(folder))


@cache
def kernel_cache_folder() -> Path | None:
    """The cache folder for compiled kernels.

    None where numba writes next to the sources.
    """
    source_cache = HERE / "__pycache__"
    return (
        None
        if os.access(source_cache if source_cache.is_dir() else HERE, os.W_OK)
        else user_kernel_cache_folder(f"{HERE.parent} cannot be written")
    )


def private_or_user_kernel_cache_folder(folder: Path) -> Path:
    """The folder itself where it is private, else the user's private cache folder.

    Private: writable by this user and root only.
    """
    return folder if is_private_folder(folder) else user_kernel_cache_folder(f"others can write to {folder}")


@cache
def is_private_folder(folder: Path) -> bool:
    """Whether a folder is private.

    Nobody but this user and root can write to it or replace it.
    """
    found = Path(os.path.realpath(folder))
    if not hasattr(os, "getuid"):  # Windows, where modes say nothing and the user's own profile is closed to others
        return found.is_relative_to(os.path.realpath(Path.home()))
    states = [place.stat() for place in (found, *found.parents) if place.exists()]
    own = states[0].st_uid in (0, os.getuid()) and not states[0].st_mode & 0o022
    return own and not any(above.st_mode & stat.S_IWOTH and not above.st_mode & stat.S_ISVTX for above in states[1:])


@cache
def user_kernel_cache_folder(reason: str) -> Path:
    """The user's private cache folder for compiled kernels.

    Below the home, else a temporary one.
    reason : why it is needed
    """
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    why = "cannot be written"
    try:
        folder = Path(home) / "rig"
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        if os.access(folder, os.W_OK):
            if is_private_folder(folder):
                return folder
            why = "can be written to by others"
    except OSError:
        pass  # no home, or one that cannot be written: the next place is tried
    if not hasattr(os, "getuid"):
        return _folder_for_this_run()
    folder = Path(tempfile.gettempdir()) / f"rig-kernels-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700)
        _print_note(f"compiled code is kept in {folder}: {reason}, and {home} {why}")
    except FileExistsError:
        status = folder.lstat()
        if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
            return _folder_for_this_run()
    return folder


def _folder_for_this_run() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="rig-kernels-"))
    _print_note(f"compiled code is kept in {folder}, for this run: NUMBA_CACHE_DIR names a permanent folder")
    return folder


def _print_note(text: str) -> None:
    print(f"rig: {text}", file=sys.stderr)


_FOLDERS = threading.RLock()  # held while numba's folder is another: it has one for all threads
_say: Callable[[], None] | None = None  # to be called when something is compiled


@contextmanager
def announce_compilation(callback: Callable[[], None]) -> Iterator[None]:
    """Announce the first kernel compilation by calling `callback`.

    In this process, for as long as this context manager is open.
    """
    global _say
    before, _say = _say, callback
    try:
        yield
    finally:
        _say = before


@cache
def _listen() -> None:
    """Hear from numba what it compiles: what it loads, which takes no time to speak of, it does not tell of."""
    from numba.core import event

    class Heard(event.Listener):
        """reported : whether something was compiled already"""

        reported = False

        def on_start(self, event: object) -> None:
            """Say it, the first time."""
            if _say is not None and not self.reported:
                self.reported = True
                _say()

        def on_end(self, event: object) -> None:
            """Nothing is said of an end."""

    event.register("numba:compile", Heard())


@cache
def _set_portable_processor() -> None:
    """Make numba compile for every processor of this computer's kind, unless the user has named one."""
    import numba
    from llvmlite.binding import get_host_cpu_features

    settings: Any = numba.config
    machine = platform.machine().lower()
    name, needed = PORTABLE.get({"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine), ("", ()))
    here: Mapping[str, bool] = get_host_cpu_features()
    if name and settings.CPU_NAME is None and settings.CPU_FEATURES is None and all(here.get(one) for one in needed):
        settings.CPU_NAME, settings.CPU_FEATURES = name, ""


@cache
def _file_digest(path: str) -> bytes:
    return hashlib.sha256(Path(path).read_bytes()).digest()


class Kernel:
    """A function that is compiled, or loaded as an earlier run compiled it, at its first call; other kernels may call
    it.

    function : as written; options : of numba.njit
    """

    def __init__(self, function: Callable[..., object], options: CompilerOptions) -> None:
        self._function, self._options = function, options
        update_wrapper(self, function)

    @cached_property
    def _compiled(self) -> Callable[..., object]:
        import numba

        _listen()
        _set_portable_processor()
        settings: Any = numba.config  # its names come and go with the environment
        with _FOLDERS:
            before = settings.CACHE_DIR
            try:
                source_cache = Path(inspect.getfile(self._function)).parent / "__pycache__"
                folder = private_or_user_kernel_cache_folder(Path(settings.CACHE_DIR or source_cache))
                if folder != source_cache:
                    settings.CACHE_DIR = str(folder)
                compiled: Any = numba.njit(**self._options)(self._function)
            finally:
                settings.CACHE_DIR = before
        if self._options.get("cache") and hasattr(compiled, "_cache"):  # none where compilation is switched off
            file = compiled._cache._cache_file
            file._source_stamp = self.digest
            file._version += self.digest.hex()  # read first: what follows it may need modules that have moved
        return cast(Callable[..., object], compiled)

    @cached_property
    def digest(self) -> bytes:
        """SHA-256 of all that the compiled kernel depends on: its file, the kernels that it calls, the values and the
        tuples of other files. Numba itself looks at the kernel's own file alone.
        """
        found = hashlib.sha256(_file_digest(inspect.getfile(self._function)))
        names = self._function.__code__.co_names
        known = [self._function.__globals__.get(name) for name in names]
        known += [
            getattr(module, name)
            for module in known
            if isinstance(module, ModuleType)
            for name in names
            if module.__name__.partition(".")[0] in PACKAGES and hasattr(module, name)
        ]
        for value in known:
            if isinstance(value, Kernel):
                found.update(value.digest)
            elif isinstance(value, type) and value.__module__.partition(".")[0] in PACKAGES:
                found.update(_file_digest(inspect.getfile(value)))
            elif value is not None and hasattr(value, "tobytes"):
                found.update(value.tobytes())
            elif isinstance(value, (int, float, str, tuple)):
                found.update(repr(value).encode())
        return found.digest()

    @cached_property
    def _numba_type_(self) -> object:
        """What numba takes it for where another kernel calls it."""
        from numba import types

        return types.Dispatcher(cast("Dispatcher[Callable[..., object]]", self._compiled))

    @property
    def py_func(self) -> Callable[..., object]:
        """The function as written, by which numba takes it into another kernel where its options say so."""
        return self._function

    @property
    def targetoptions(self) -> CompilerOptions:
        """Options of numba.njit, under the name by which numba looks for them."""
        return self._options

    def __call__(self, *arguments: object) -> object:
        return self._compiled(*arguments)


def njit(**options: Unpack[CompilerOptions]) -> Callable[[F], F]:
    """Decorator like numba.njit.

    It compiles on the first call. options : of numba.njit
    """

    def kernel(function: F) -> F:
        return cast(F, Kernel(function, options))

    return kernel


set_kernel_cache_folder()
