"""Numba compilation of kernels: cached by a hash of all kernels' sources, without the interpreter's lock."""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from rig.compute.numba_kernels_and_lazy_exports import CompilerOptions, Kernel, kernel_cache_folder

# all of fast mathematics but the promise that nothing is infinite or no number
_FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}
_OPTIONS: CompilerOptions = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": _FAST}

F = TypeVar("F", bound=Callable[..., object])


@cache
def _folder() -> str:
    """Where compiled kernels are kept. Numba itself would not notice that a kernel in another file, called from this
    one, has changed.
    """
    from numba import config

    here, settings = Path(__file__).parent, cast(Any, config)
    sources = [path.read_bytes() for path in sorted(here.glob("*.py"))]
    digest = hashlib.sha256(b"".join(source for source in sources if b"@kernel" in source)).hexdigest()[:16]
    parent = Path(settings.CACHE_DIR) if settings.CACHE_DIR else kernel_cache_folder() or here / "__pycache__"
    return str(parent / f"kernels-{digest}")


def kernel(function: F) -> F:
    """Decorator: a function as a numba kernel, compiled at its first call or loaded from an earlier run."""
    return cast(F, Kernel(function, _OPTIONS, _folder))


def inlined_kernel(function: F) -> F:
    """Decorator: a numba kernel that is inlined into the one kernel that calls it."""
    return cast(F, Kernel(function, {**_OPTIONS, "inline": "always"}, _folder))
