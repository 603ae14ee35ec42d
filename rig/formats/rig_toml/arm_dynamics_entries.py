"""Arm dynamics entries of rig.toml, table [dynamics].

Link masses, joint torque limits, friction, sensor noise.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Design
from rig.model.mechanisms.arm_dynamics_and_step_by_step_kinematics import LinkMasses
from rig.model.mechanisms.mechanism_kinds_and_kinematics import axis_units, has_links

HEAVIEST = 1e5  # kg, and kg m^2
STRONGEST = 1e7  # N m or N
UNITS = {  # of what is stated joint by joint: of a turn, of a slide
    "torque_limits": ("N m", "N"),
    "torque_sigma": ("N m", "N"),
    "torque_constants": ("N m/A", "N/A"),
    "angle_sigma": ("rad", "m"),
    "speed_sigma": ("rad/s", "m/s"),
}


@dataclass(frozen=True, slots=True, eq=False)
class ArmDynamics:
    """What is stated of an arm of n joints; None where it is not.

    links : Links, rows of mass (kg), centre x y z (m), inertia xx yy zz xy xz yz (kg m^2); torque_limits : (n,) N m, of
        slides N
    torque_constants : (n,) N m at the joint per A of its motor; friction : (n, 2) N m (Coulomb) and N m s/rad (viscous)
    torque_sigma : (n,) N m, of one reading; angle_sigma : (n,) rad or m, of one; speed_sigma : (n,) rad/s or m/s, of
        one
    """

    links: LinkMasses | None
    torque_limits: Floats | None
    torque_sigma: Floats | None
    torque_constants: Floats | None
    friction: Floats | None
    angle_sigma: Floats | None
    speed_sigma: Floats | None

    def need(self, name: str, path: Path | str) -> Floats:
        """A figure that a command cannot do without. Raises RigError where it is not stated; path : of the file that
        should state it.
        """
        value: Floats | None = getattr(self, name)
        if value is None:
            raise RigError(f"{path}: [dynamics] states no {name}, and this requires it")
        return value


def load_arm_design_and_dynamics(path: Path | str) -> tuple[Design, ArmDynamics]:
    """Load (Design, ArmDynamics) of an arm's rig.toml.

    What [dynamics] lacks is None.
    Raises FileError with line and column for figures that cannot be, RigError for a mechanism that is no arm cannot
    be, RigError for a mechanism that is no arm
    """
    root = design_from_rig_toml.load_entries(path)
    design = design_from_rig_toml.design_of_entries(root)
    if not has_links(design.mechanism):
        raise RigError(f"{path} has a mechanism of kind {design.mechanism.kind!r}; forces at the hand are for arms")
    table = root.in_stated_units().table("dynamics", optional=True)
    return design, dynamics_of_table(table, axis_units(design.mechanism))


def dynamics_of_table(table: Entries, joint_units: tuple[str, ...]) -> ArmDynamics:
    """ArmDynamics of the table [dynamics] of an arm.

    joint_units : "rad", of slides "m".
    Raises FileError with line and column for figures that cannot be
    """
    table.refuse_misspelt(design_from_rig_toml.DYNAMICS)
    joint_count = len(joint_units)
    each = {
        name: table.each(
            name,
            joint_count,
            None,
            units=[of_slide if one == "m" else unit for one in joint_units],
            above=0,
            most=STRONGEST,
        )
        for name, (unit, of_slide) in UNITS.items()
    }
    friction = table.array("friction", (joint_count, 2), None, unit=("N m", "N m s/rad"))
    if friction is not None:
        for i, j in np.argwhere(friction < 0):
            table.fail(f"friction[{i + 1}] must not be negative, not {friction[i, j]:g}", "friction", int(i), int(j))
    return ArmDynamics(links=_links(table, joint_count), friction=friction, **each)


def _links(table: Entries, n: int) -> LinkMasses | None:
    """Links of rows mass, centre x y z, inertia xx yy zz xy xz yz; None where none are stated."""
    rows = table.array("links", (n, 10), None, unit=("kg", *["m"] * 3, *["kg m^2"] * 6))
    if rows is None:
        return None
    inertia = np.empty((n, 3, 3))
    for k, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        inertia[:, i, j] = inertia[:, j, i] = rows[:, 4 + k]
    for i, (mass, least) in enumerate(zip(rows[:, 0], np.linalg.eigvalsh(inertia)[:, 0])):
        if not 0 <= mass <= HEAVIEST:
            table.fail(f"links[{i + 1}] has a mass of {mass:g} kg", "links", i, 0)
        if least < -1e-9 * HEAVIEST or least < -1e-6 * np.abs(inertia[i]).max():
            table.fail(
                f"links[{i + 1}] has an inertia that no body has: a principal moment is {least:g} kg m^2", "links", i
            )
    return LinkMasses(rows[:, 0], rows[:, 1:4], inertia)
