"""Two struts and one hinge, four samples: what is commanded, measured, worked back and corrected.

Source: configuration-space patent, [0079] to [0091]: two lengths L1 and L2 of either strut make the sample set (L1,
L1), (L1, L2), (L2, L1), (L2, L2); each gives a theoretical and a measured pose; IK of the measured one gives (L1',
L2'). It states no figures in metres: those here are ours.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correct.correction import Correction
from calib.correct.summand_extension import fit_summand_field, summands
from calib.samples.pose_samples import Samples
from rig.model.design import Planar2
from rig.model.mechanisms import two_strut_plane
from rig.planning.configuration_sets import FILL, grid_division

L1, L2 = 0.42, 0.58  # m
NOMINAL = Planar2(np.array([[-0.3, 0.0], [0.3, 0.0]]), np.array([[L1, L2], [L1, L2]]))
REAL = Planar2(
    np.array([[-0.3021, 0.0014], [0.3012, -0.0018]]), NOMINAL.strut_range, np.array([0.0011, 0.0016])
)  # nobody knows it


@dataclass(frozen=True, slots=True, eq=False)
class Worked:
    """x : (4, 2) m, the sample set PM; theory, measured : DK(x), GDK(x), RigidTransform (4,); second : (4, 2) m,
    IK(GDK(x))
    summand : (4, 2) m, KSF_PM = x - second; correction : Correction by these alone, linear between them (KSF_KR)."""

    x: np.ndarray
    theory: RigidTransform
    measured: RigidTransform
    second: np.ndarray
    summand: np.ndarray
    correction: Correction


def worked_example() -> Worked:
    """The example, worked."""
    x = grid_division(NOMINAL.strut_range, "1@1")
    x = x[np.lexsort((x[:, 1], x[:, 0]))]
    measured = two_strut_plane.forward(x, REAL)
    samples = Samples(np.arange(4), np.arange(4.0), x, measured, np.zeros((4, 6, 6)), np.zeros((4, 6, 0)))
    known = summands(samples, NOMINAL)
    correction: Correction = Correction(NOMINAL, NOMINAL, (None, None), extension=fit_summand_field(known, "linear"))
    return Worked(
        x,
        two_strut_plane.forward(x, NOMINAL),
        measured,
        two_strut_plane.inverse(measured, NOMINAL),
        known.values,
        correction,
    )


def corrected_hinge_positions(correction: Correction | None, wanted: np.ndarray) -> np.ndarray:
    """(n, 2) m where the real hinge comes to lie when it is sent to places wanted (n, 2) m: by the owner's model, or in
    the source's one step X + KSF(X), [0090], [0091]."""
    T = RigidTransform.from_translation(np.pad(wanted, ((0, 0), (0, 1))))
    commands = two_strut_plane.inverse(T, NOMINAL) if correction is None else correction.single_step(T)
    return two_strut_plane.forward(commands, REAL).translation[:, :2]


def workspace(mechanism: Planar2, count: int = 24) -> np.ndarray:
    """(4 count, 2) m, the hinge along the edge of the configuration space: the workspace's own edge."""
    low, high = mechanism.strut_range.T
    s = np.linspace(0, 1, count)
    sides = [(s, 0 * s), (0 * s + 1, s), (s[::-1], 0 * s + 1), (0 * s, s[::-1])]
    x = np.concatenate([low + (high - low) * np.stack(side, axis=1) for side in sides])
    return two_strut_plane.forward(x, mechanism).translation[:, :2]


def grid(per_axis: int = 9) -> np.ndarray:
    """(per_axis^2, 2) m, places all over the middle of the workspace, between the samples as well."""
    levels = (
        NOMINAL.strut_range.mean(axis=1)
        + FILL * np.ptp(NOMINAL.strut_range, axis=1) / 2 * np.linspace(-1, 1, per_axis)[:, None]
    )
    x = np.stack(np.meshgrid(*levels.T, indexing="ij"), axis=-1).reshape(-1, 2)
    return two_strut_plane.forward(x, NOMINAL).translation[:, :2]
