"""Base class of mechanisms.

What each answers of itself: its axes, bodies, plates, struts, links, reach and files.
"""

from typing import ClassVar, Literal

from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats


class StatedMechanism:
    """What every mechanism answers of itself. A mechanism of which something else holds says so in its own class.

    axis_unit : of the travel of its axes, the slides of an arm aside
    pose_coordinates : which of a pose's six coordinates (x y z rx ry rz, from 0) its platform can change
    placements : names of the poses that say where it stands and what it holds, fitted along with its geometry
    closes_loops : whether each of its axes follows from the platform's pose by an equation of its own (parallel
        mechanisms)
    """

    __slots__ = ()
    axis_unit: ClassVar[Literal["m", "rad"]] = "m"
    pose_coordinates: ClassVar[tuple[int, ...]] = (0, 1, 2, 3, 4, 5)
    placements: ClassVar[tuple[str, ...]] = ()
    closes_loops: ClassVar[bool] = False

    @property
    def axis_words(self) -> tuple[str, ...]:
        """What each of its axes is called: "strut", "joint" or "slide"."""
        return ()

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that it moves below the platform; none where its platform stands on its base."""
        return ()

    @property
    def home_pose(self) -> RigidTransform | None:
        """T_base_platform at home, as its owner states it; None where no such pose is stated."""
        return None

    @property
    def plates(self) -> tuple[Floats, Floats] | None:
        """(base joints, platform joints) (axes, 3) m, each in its own plate's frame; None without two plates."""
        return None

    @property
    def strut_joints(self) -> tuple[Floats, Floats] | None:
        """(base joints (axes, 3) m in the base frame, the struts' other ends (axes, 3) m in the platform's); None
        without struts.
        """
        return None

    @property
    def link_rows(self) -> Floats | None:
        """(axes, 5) theta, d, a, alpha, beta of the links between its joints; None without links."""
        return None

    @property
    def reach(self) -> float | None:
        """m, how long it is at the most; None where that is not known of it as a whole."""
        return None

    @property
    def geometry_arrays(self) -> dict[str, Floats]:
        """{name: array} of the figures of its geometry that a calibration fits, m and rad."""
        return {}

    @property
    def files(self) -> dict[str, str]:
        """{name: text} of the files that state its kinematics, beside its rig.toml."""
        return {}
