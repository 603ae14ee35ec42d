"""Numba kernels: Cholesky solution and order statistics.

The compilation of corner kernels, and their small numerics.
"""

import hashlib
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from rig.array_and_json_types import Floats
from rig.compute.numba_kernels_and_lazy_exports import CompilerOptions, Kernel, kernel_cache_folder

_OPTIONS: CompilerOptions = {"cache": True, "nogil": True, "error_model": "numpy"}

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
    """Decorator: a function as a numba kernel.

    Compiled at its first call or loaded from an earlier run.
    """
    return cast(F, Kernel(function, _OPTIONS, _folder))


def inlined_kernel(function: F) -> F:
    """Decorator: a numba kernel that is inlined into the one kernel that calls it."""
    return cast(F, Kernel(function, {**_OPTIONS, "inline": "always"}, _folder))


@kernel
def cholesky_factor(H: Floats, first: int, size: int, L: Floats) -> bool:
    """Write the Cholesky factor of H[first:first + size, first:first + size] into L.

    False if not definite.
    H, L : (n, n)
    """
    for i in range(size):
        for j in range(i + 1):
            total = H[first + i, first + j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > 1e-9 * H[first + i, first + i]:
                    return False
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@kernel
def cholesky_solve(L: Floats, size: int, b: Floats, x: Floats) -> None:
    """Solve L L' x = b for x (size,), with the Cholesky factor L."""
    for i in range(size):
        total = b[i]
        for k in range(i):
            total -= L[i, k] * x[k]
        x[i] = total / L[i, i]
    for i in range(size - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, size):
            total -= L[k, i] * x[k]
        x[i] = total / L[i, i]


HALVINGS = 14  # of the numbers' range


@kernel
def order_statistic(values: Floats, rank: int) -> float:
    """Order statistic of values (k,).

    The one of that rank, to a 16 000th of their range; 0 for none.
    """
    if len(values) == 0:
        return 0.0
    low = high = float(values[0])
    for value in values:
        low, high = min(low, value), max(high, value)
    for _ in range(HALVINGS):
        middle, below = 0.5 * (low + high), 0
        for value in values:
            below += value < middle
        low, high = (middle, high) if below <= rank else (low, middle)
    return high
