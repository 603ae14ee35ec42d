"""Corrections: interpolation beside interpn and SciPy, the chain from a wanted pose to checked commands, forward
kinematics.
"""

import time
from collections.abc import Callable, Iterator

import interpn
import numpy as np
from scipy.interpolate import RegularGridInterpolator

from calib.correction.interpolation.interpolation_on_grid_of_samples import Simplex
from calib.correction.machine_correction import Correction, require_commands_in_axis_ranges
from rig.model.mechanisms import hexapod
from tests.bench.forward_kinematics import mechanism_of_bench

LEVELS, QUERIES = 4, 1_000_000


def best(call: Callable[[], object], times: int = 5) -> float:
    """s, the shortest of so many calls: what other programs took of the machine is least in it."""
    took = []
    for _ in range(times):
        start = time.perf_counter()
        call()
        took.append(time.perf_counter() - start)
    return min(took)


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    rng = np.random.default_rng(0)
    levels = tuple(np.linspace(0.4, 0.5, LEVELS) for _ in range(6))
    values = 1e-5 * rng.normal(size=(LEVELS**6, 6))
    field = Simplex(levels, values, np.zeros(values.shape), np.zeros(6))
    x = rng.uniform(0.4, 0.5, (QUERIES, 6))
    columns, parts = [np.ascontiguousarray(c) for c in x.T], [np.ascontiguousarray(c) for c in values.T]
    scipy = RegularGridInterpolator(levels, values.reshape(*[LEVELS] * 6, 6))
    few = x[: QUERIES // 20]
    field.value(few)
    ours = best(lambda: field.value(x)) / QUERIES
    one_thread = (
        best(lambda: [interpn.interpn(obs=columns, grids=list(levels), vals=part, max_threads=1) for part in parts], 3)
        / QUERIES
    )
    threads = best(lambda: [interpn.interpn(obs=columns, grids=list(levels), vals=part) for part in parts], 3) / QUERIES
    other = best(lambda: scipy(few), 3) / len(few)
    yield "simplices, 6-D, 4^6 samples, 6 outputs, 1e6 queries, a query", f"{ours * 1e9:.0f} ns", ""
    yield "interpn, one thread; as it comes; a query", f"{one_thread * 1e9:.0f} ns; {threads * 1e9:.0f} ns", ""
    yield "faster than interpn, one thread; as it comes", f"{one_thread / ours:.1f} x; {threads / ours:.1f} x", ">= 3 x"
    yield "faster than SciPy's RegularGridInterpolator", f"{other / ours:.1f} x", ">= 15 x"
    single = x[0]
    yield "one query at a time", f"{best(lambda: [field.value(single) for _ in range(1000)]) * 1e3:.2f} us", "<= 3 us"
    yield from _chain()


def _chain():
    mechanism = mechanism_of_bench()
    low, high = mechanism.strut_range.T
    rng = np.random.default_rng(1)
    levels = tuple(np.linspace(a, b, LEVELS) for a, b in mechanism.strut_range)
    values = 2e-5 * rng.normal(size=(LEVELS**6, 6))
    correction = Correction(
        mechanism, mechanism, (None,) * 6, extension=Simplex(levels, values, np.zeros(values.shape), np.zeros(6))
    )
    middle = low + (high - low) * (0.02 + 0.96 * rng.random((200_000, 6)))
    wanted = hexapod.forward(middle, mechanism)
    one = wanted[0]

    def chain(T):
        require_commands_in_axis_ranges(np.atleast_2d(correction.inverse(T)), mechanism, [])

    chain(wanted), chain(one)
    batch = len(middle) / best(lambda: chain(wanted))
    yield "corrected inverse kinematics, pose in, checked commands out, batch", f"{batch:.0f} poses/s", ">= 300 000"
    single = best(lambda: [chain(one) for _ in range(1000)])
    yield "the same, one pose", f"{single * 1e3:.1f} us", "<= 50 us"
    off = np.abs(correction.predict(correction.inverse(wanted)).translation - wanted.translation).max()
    yield "what is left of the wanted positions by the model", f"{off:.1e} m", "<= 1e-10"
