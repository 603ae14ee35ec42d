"""Forward kinematics of a hexapod, the whole batch at once, beside one optimiser call per pose."""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Hexapod
from rig.model.mechanisms import hexapod
from rig.model.pose import exp
from rig.planning.layout import hexapod_layout_and_camera_placement


def mechanism_of_bench() -> Hexapod:
    """The Hexapod of `rig new design --radius 0.3`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3))
        return design_from_rig_toml.load_design(path).mechanism


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    mechanism = mechanism_of_bench()
    low, high = mechanism.strut_range.T
    lengths = low + (high - low) * np.random.default_rng(0).random((100_000, 6))
    T, times = hexapod.forward(lengths, mechanism), []  # compiled on the first call
    for _ in range(5):
        start = time.perf_counter()
        T = hexapod.forward(lengths, mechanism)
        times.append(time.perf_counter() - start)
    error = np.abs(hexapod.inverse(T, mechanism) - lengths).max()
    start = time.perf_counter()
    for target in lengths[:20]:
        least_squares(
            lambda xi, target=target: hexapod.inverse(mechanism.home * exp(xi), mechanism) - target,
            np.zeros(6),
            xtol=1e-15,
            ftol=1e-15,
        )
    other = (time.perf_counter() - start) / 20
    yield (
        "forward kinematics, batch of 100 000, median of 5",
        f"{1e5 / np.median(times):.0f} poses/s",
        ">= 500 000 on one core",
    )
    yield "inverse of forward", f"{error:.1e} m", "<= 1e-10"
    yield "ratio to scipy's least_squares, pose by pose", f"{other / np.median(times) * 1e5:.0f} x", ""
