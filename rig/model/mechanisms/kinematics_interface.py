"""What every kind of machine answers to: one typed interface, fulfilled by each module of this package."""

from typing import Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

M = TypeVar("M", contravariant=True)  # the geometry of rig.model.design that a kind moves


class Kind(Protocol[M]):
    """A kind of machine: n axes that are commanded (m or rad) move one body, the platform.

    AXIS : what an axis is called in a place ("strut", "joint"); UNIT : of its travel, "m" or "rad"
    An arm's prismatic joint is a "slide", its travel in m and its load in N: `rig.model.mechanisms.axis_places` and
    `units` tell them axis by axis.
    A wrench is (force, moment) in N and N m on the platform's origin, in its axes; a tangent stands on the right (m,
    rad).
    """

    AXIS: str
    UNIT: str

    def forward(self, values: np.ndarray, mechanism: M, guess: RigidTransform | None = None, /) -> RigidTransform:
        """T_base_platform (...) of commanded values (..., axes)."""
        ...

    def inverse(self, T_base_platform: RigidTransform, mechanism: M, /) -> np.ndarray:
        """Commanded values (..., axes) that give poses T_base_platform (...)."""
        ...

    def limits(self, values: np.ndarray, mechanism: M, /) -> np.ndarray:
        """How far commanded values (..., axes) lie outside the travel: negative below, positive above, 0 inside."""
        ...

    def travel(self, mechanism: M, /) -> np.ndarray:
        """(axes, 2) least and greatest value that can be commanded."""
        ...

    def home(self, mechanism: M, /) -> np.ndarray:
        """(axes,) commanded values from which strokes count."""
        ...

    def loads(self, T: RigidTransform, values: np.ndarray, mechanism: M, wrench: np.ndarray, /) -> np.ndarray:
        """(n, axes) force or torque that the axes exert, in the direction of growing values, to hold a wrench (n, 6) on
        the platform.
        """
        ...

    def links(self, T: RigidTransform, values: np.ndarray, mechanism: M, gravity: np.ndarray, /) -> np.ndarray:
        """(n, axes, c) the same per unit of what the machine's own moving members weigh, c numbers of mass (kg) and
        mass moment (kg m); c = 0 where their weight is not borne by the axes."""
        ...

    def grown(
        self, T: RigidTransform, values: np.ndarray, mechanism: M, share: np.ndarray, /
    ) -> tuple[np.ndarray, np.ndarray]:
        """(deviation (n, axes), sway (n, 6)) of the machine whose axes' members have grown by shares (n, axes) of their
        length.
        """
        ...

    def ends(self, T: RigidTransform, mechanism: M, /) -> tuple[np.ndarray, np.ndarray] | None:
        """(base joints (axes, 3), platform joints (n, axes, 3)) m in the base frame; None for a machine that has no
        struts.
        """
        ...
