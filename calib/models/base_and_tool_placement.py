"""Where base and tool of an arm or chain stand, as motions from where they stood in a reference.

What poses do not determine of it is named, and has no figure.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtrc

from rig.array_and_json_types import Floats, Json
from rig.model.pose import exp, skew

ALIKE = 1e-3  # probability with which an end that stands still is taken for moved, which costs little
LOOSE = 1.0  # m, rad; by which an estimate may still be off where it is linearised anew
OPEN = 0.1 * LOOSE  # standard uncertainty from which the poses do not determine a direction
ENDS = ("base", "tool")


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where base and tool stand, as motions from where they stood in the reference.

    base : RigidTransform, about `origin` (3,) m, where the base stood, in the frame of poses; tool : RigidTransform, in
    the target's frame as it was
    covariance : (12, 12) m and rad of both, 0 where an end was not estimated; ends : which were estimated
    p_values : of so much by chance, 1 of an end that was not estimated; centre, turn : (3,) m, (3, 3) mean position and
        rotation of the target, in the frame of poses, by which shifts of tool and base add up
    """

    base: RigidTransform
    tool: RigidTransform
    origin: Floats
    covariance: Floats
    ends: tuple[bool, bool]
    p_values: tuple[float, float] = (1.0, 1.0)
    centre: Floats = field(default_factory=lambda: np.zeros(3))
    turn: Floats = field(default_factory=lambda: np.eye(3))

    @property
    def motion(self) -> RigidTransform:
        """The base's motion in the frame of poses."""
        to_origin = RigidTransform.from_translation(self.origin)
        return to_origin * self.base * to_origin.inv()

    @property
    def moved(self) -> tuple[bool, bool]:
        """Whether chance does not explain that base and tool stand elsewhere."""
        return self.p_values[0] < ALIKE, self.p_values[1] < ALIKE

    def undone(self, T: RigidTransform) -> RigidTransform:
        """Poses (n,) as they would have been measured in the reference."""
        return self.motion.inv() * T * self.tool.inv()

    def stepped(self, step: Floats) -> "Placement":
        """With both motions changed by a step (12,)."""
        return replace(self, base=self.base * exp(step[:6]), tool=exp(step[6:]) * self.tool)

    def parts(self, end: int) -> tuple["PlacementPart", "PlacementPart"]:
        """Position and rotation of the displacement of an end, 0 the base and 1 the tool."""
        T = (self.base, self.tool)[end]
        own = self.covariance[6 * end : 6 * end + 6, 6 * end : 6 * end + 6]
        turn = T.rotation.as_matrix() if end == 0 else np.eye(3)  # a step of the base is in the displaced base's axes
        return (
            PlacementPart.of(T.translation, turn @ own[:3, :3] @ turn.T),
            PlacementPart.of(T.rotation.as_rotvec(), own[3:, 3:]),
        )

    def stands_elsewhere(self, end: int) -> bool | None:
        """Whether chance does not explain that an end stands elsewhere; None where that is not determined.

        Of a position that is open in some directions, what is determined decides: in these the other end may have moved
        in its place.
        """
        position, rotation = self.parts(end)
        if position.directions == 3:
            return self.moved[end]
        known = [part.p_value for part in (position, rotation) if part.directions]
        if known and len(known) * min(known) < ALIKE:
            return True
        return None if any(self.moved) or not position.directions else False

    def shift(self) -> "PlacementPart":
        """By how much base and tool together displace the target, in the middle of the poses."""
        rows = np.hstack([np.eye(3), -skew(self.centre - self.origin), self.turn, np.zeros((3, 3))])
        moved = (self.motion * RigidTransform.from_translation(self.centre)).translation - self.centre
        return PlacementPart.of(moved + self.turn @ self.tool.translation, rows @ self.covariance @ rows.T)

    def entry(self) -> Json:
        """What JSON holds: of each estimated end, whether it stands elsewhere, None where that is not determined, and
        by how much, U with k = 2, of the directions that the poses determine, None where these are none.
        """
        out: Json = {}
        for end, name in enumerate(ENDS):
            if self.ends[end]:
                position, rotation = self.parts(end)
                out[name] = {
                    "stands_elsewhere": self.stands_elsewhere(end),
                    "p_value": self.p_values[end],
                    "position": position.entry(),
                    "rotation": rotation.entry(),
                }
        return out

    def lines(self) -> list[str]:
        """What is stated of each end that was estimated."""
        out = []
        if all(self.ends) and all(self.parts(end)[0].directions < 3 for end in range(2)):
            one = self.shift()
            within = f"+- {one.U * 1e3:.2g} mm (k = 2)"
            apart = "these poses do not distinguish a shift of the base from one of the tool"
            if min(self.p_values) < ALIKE:
                out.append(f"base and tool together displace the poses by {one.size * 1e3:.4g} mm, {within}; {apart}")
            else:
                out.append(f"base and tool together stand where they stood, to {within}; {apart}")
        for end, name in enumerate(ENDS):
            if not self.ends[end]:
                continue
            texts = [part.texts(unit) for part, unit in zip(self.parts(end), ("mm", "mrad"))]
            known = [text for text in texts if text is not None]
            within = f"{' and '.join(U for _, U in known)} (k = 2)"
            if not known:
                out += [] if out else [f"these poses do not determine where the {name} stands"]
            elif texts[0] is None and not self.stands_elsewhere(end):
                out.append(f"the {name} stands as it stood in rotation, to +- {within}")
            elif texts[0] is None:
                out.append(f"the {name} is turned by {known[0][0]}, +- {within}")
            elif self.stands_elsewhere(end):
                out.append(f"the {name} stands elsewhere: by {' and '.join(size for size, _ in known)}, +- {within}")
            else:
                out.append(f"the {name} stands where it stood, to +- {within}")
        return out


@dataclass(frozen=True, slots=True)
class PlacementPart:
    """A displacement's position, m, or rotation, rad. size, U : its length and expanded uncertainty (k = 2), in
    the directions that the poses determine; directions : how many of the three they are, 0 of what was not estimated
    p_value : of so much in these by chance, 1 without any
    """

    size: float
    U: float
    directions: int
    p_value: float = 1.0

    @staticmethod
    def of(vector: Floats, covariance: Floats) -> "PlacementPart":
        """Of a vector (3,) and its covariance (3, 3), 0 where it was not estimated."""
        if not covariance.any():
            return PlacementPart(np.nan, np.nan, 0)
        values, axes = np.linalg.eigh(covariance)
        known = axes[:, values < OPEN**2]
        if not known.shape[1]:
            return PlacementPart(np.nan, np.nan, 0)
        vector, covariance = known.T @ vector, known.T @ covariance @ known
        size, U = float(np.linalg.norm(vector)), 2 * _along(vector, covariance)
        return PlacementPart(size, U, known.shape[1], p_value_of_displacement(vector, covariance))

    def texts(self, unit: str) -> tuple[str, str] | None:
        """(size, U) in mm or mrad, None where nothing is determined."""
        if not self.directions:
            return None
        where = "" if self.directions == 3 else f" in {self.directions} of 3 directions"
        return f"{self.size * 1e3:.4g} {unit}", f"{self.U * 1e3:.2g} {unit}{where}"

    def entry(self) -> Json:
        """What JSON holds of it."""
        if not self.directions:
            return {"value": None, "U": None, "directions": 0}
        return {"value": self.size, "U": self.U, "directions": self.directions}


def p_value_of_displacement(vector: Floats, covariance: Floats) -> float:
    """Probability of a vector (k,) m, rad by chance, where there is none: chi-squared by its covariance (k, k)."""
    return float(chdtrc(len(vector), vector @ np.linalg.solve(covariance, vector)))


def _along(vector: Floats, covariance: Floats) -> float:
    """Standard uncertainty of a vector's length; of one that is nearly 0, the greatest of its directions."""
    size = float(np.linalg.norm(vector))
    greatest = float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
    return float(np.sqrt(vector @ covariance @ vector)) / size if size > greatest else greatest
