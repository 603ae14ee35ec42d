"""Plan of the fewest configurations that keep a promised accuracy."""

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.api.plan_options_and_result import SEED, PlanOptions, PlanResult, plan_geometry_and_exclusion_of_lost_poses
from calib.certification.platform_certification import Progress
from calib.correction.machine_correction import indices_and_poses_of_solvable_commands
from calib.models.fewest_configurations_for_accuracy import fewest_configurations_for_accuracy
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import RigError
from rig.formats.numbers_and_units import quantity_text
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, is_hexapod, require_axes, require_hexapod
from vision.marker_corner_prediction import marker_map, visible_marker_counts_over_all_cameras

FEWEST = 2  # markers of what moves that a configuration must show


def make_visible_marker_counter(design: Design) -> Callable[[RigidTransform], Integers] | None:
    """Make the function that counts visible markers at poses (n,).

    Visible to a design's cameras; None where an instrument measures.
    """
    if not design.cameras or not design.targets:
        return None
    return partial(visible_marker_counts_over_all_cameras, design.cameras, markers=marker_map(design.without_stages()))


def _unseen(counts: Callable[[RigidTransform], Integers], mechanism: Commanded, values: Floats) -> Booleans:
    """(n,) bool, whether fewer than FEWEST markers are seen at configurations (n, axes)."""
    out = np.ones(len(values), bool)
    index, T = indices_and_poses_of_solvable_commands(
        values, lambda some: mechanisms.kinematics_of(mechanism).forward(some, mechanism)
    )
    out[index] = counts(T) < FEWEST
    return out


def plan_keeping_promise(design: Design, promise: float, options: PlanOptions, progress: Progress) -> PlanResult:
    """PlanResult of configurations that keep a promise (m).

    They are the fewest; none where it is met without any.
    Raises RigError for an instrument of directions or distances, and as `fewest_configurations_for_accuracy` does
    """
    mechanism, avoided, sigma = require_axes(design.mechanism), None, options.sigma
    if is_hexapod(mechanism):
        mechanism, avoided = plan_geometry_and_exclusion_of_lost_poses(options, require_hexapod(mechanism))
    elif options.calibration is not None:
        raise RigError("--calibration is for hexapods")
    elif (counts := make_visible_marker_counter(design)) is not None:
        avoided = partial(_unseen, counts, mechanism)
    instrument = design.instrument
    if instrument is not None and instrument.kind not in ("pose", "position"):
        raise RigError(f"plans for a promise require poses or positions, not a {instrument.kind}")
    if instrument is not None and instrument.kind == "position":
        sigma = (sigma[0], np.inf)
    found = fewest_configurations_for_accuracy(
        mechanism, promise, sigma, options.given, SEED, lambda done, of: progress("choosing", done, of), avoided
    )
    count, visited = len(found.commands), 0 if options.given is None else len(options.given)
    if not count:
        met = (
            f"by the {visited} configurations given"
            if visited
            else "by the stated geometry, with no configuration visited"
        )
        lines = [
            f"the promise of {quantity_text(promise, 'm')} is met {met}: "
            f"{quantity_text(found.left[0], 'm')} remaining; there is nothing to "
            f"visit"
        ]
    else:
        lines = [
            f"{count} configurations besides {visited} given meet {promise * 1e6:.4g} um: "
            f"{found.left[0] * 1e6:.4g} -> "
            f"{found.left[-1] * 1e6:.4g} um RMS over the workspace, which 97.5 % of machines meet; errors "
            "that all poses share are additional",
            "remaining after each: " + " ".join(f"{value * 1e6:.3g}" for value in found.left[1:]) + " um",
        ]
    return PlanResult(design, found.commands, True, lines[0], lines)
