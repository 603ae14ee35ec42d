"""The secret geometry of a machine: drawn about what its owner states."""

from dataclasses import replace

import numpy as np

from rig.errors import RigError
from rig.formats.machine_json import GEOMETRY, PLACES
from rig.model.design import Arm, Chain, Design, Hexapod, Planar2
from rig.model.pose import exp, pose

JOINT = 3e-4  # m, standard deviation of a joint's coordinate from where the owner has it
ZERO = 3e-4  # m, of a strut's zero
ROW = np.array([1e-3, 3e-4, 3e-4, 1e-3, 0.0])  # rad, m, m, rad, rad: of an arm's theta, d, a, alpha, beta
ASKEW = 1e-4  # rad, greatest of axes that are parallel by design
STOOD = (3e-3, 5e-3)  # m, rad, of where an arm that cameras see stands, and of its hand
AWAY, HAND = 1.0, 0.1  # m, of where an instrument stands and of its target on the hand, where nobody knows


def draw_geometry(stated: Design, rng: np.random.Generator, size: float) -> Hexapod | Planar2 | Arm | Chain:
    """The mechanism of a stated design as it really is. size : multiplies every deviation. Raises RigError for what
    cannot be simulated.
    """
    m = stated.mechanism
    if m.kind == "hexapod":
        return replace(
            m,
            base_joints=m.base_joints + size * JOINT * rng.normal(size=(6, 3)),
            platform_joints=m.platform_joints + size * JOINT * rng.normal(size=(6, 3)),
            strut_zeros=m.strut_zeros + size * ZERO * rng.normal(size=6),
        )
    if m.kind == "planar2":
        return replace(
            m,
            base_joints=m.base_joints + size * JOINT * rng.normal(size=(2, 2)),
            strut_zeros=m.strut_zeros + size * ZERO * rng.normal(size=2),
        )
    if m.kind == "arm":
        return _arm(m, stated, rng, size)
    if isinstance(m, Chain):
        stages = tuple(draw_geometry(replace(stated, mechanism=stage, cameras=()), rng, size) for stage in m.stages)
        return replace(m, stages=stages)  # type: ignore[arg-type]
    raise RigError(f"a mechanism of kind {m.kind!r} cannot be simulated; {', '.join(GEOMETRY)} can")


def _arm(m: Arm, stated: Design, rng: np.random.Generator, size: float) -> Arm:
    rows = m.rows + size * ROW * rng.normal(size=m.rows.shape)
    flat = np.abs(np.cos(m.rows[:, 3])) > 0.999
    rows[flat, 3:] = m.rows[flat, 3:] + size * ASKEW * rng.uniform(-1, 1, (flat.sum(), 2))
    ends, instrument = [m.base, m.tool], stated.instrument
    if (
        instrument is None and stated.cameras and stated.targets
    ):  # where it stands among the cubes, and how its hand holds them
        ends = [end * exp(size * np.repeat(STOOD, 3) * rng.normal(size=6)) for end in ends]
    for k, (place, far) in enumerate(zip(PLACES, (AWAY, HAND))):
        if instrument is not None and getattr(instrument, place) == "free":
            ends[k] = pose(far * rng.uniform(-1, 1, 3), rng.normal(size=3))
    return replace(m, joints=rows, base=ends[0], tool=ends[1])
