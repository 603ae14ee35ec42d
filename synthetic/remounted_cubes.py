"""Cubes of a secret machine taken off and put back turned: not quite where they were, and each time of a machine in the
same place.
"""

import zlib
from collections.abc import Mapping

import numpy as np

from rig.effects.catalogue.cube_misplacement import CubeMisplacement
from rig.model.cube_remounting import design_with_turned_cubes, quarter_turns
from synthetic.secret_machine import World

SEAT = np.repeat([1e-4, 1e-3], 3)  # m, rad, by which a cube that is put back sits off


def remount_cubes(world: World, quarters: Mapping[str, int]) -> World:
    """The World with cubes turned as these say ({cube: quarter turns}), and as its rig.toml does: off their places by
    what remounting does.

    Raises RigError for a cube that there is not
    """
    stated = design_with_turned_cubes(world.stated, quarters)
    stands = quarter_turns(stated)
    if not stands:
        return world
    own = zlib.crc32(
        np.array([np.round(camera.matrix, 6) for camera in world.true.cameras]).tobytes()
    )  # a truth file has the same

    def off(name: str, quarter: int) -> CubeMisplacement:
        rng = np.random.default_rng([own, zlib.crc32(name.encode()), quarter])
        return CubeMisplacement(f"target {name}", tuple((SEAT * rng.normal(size=6)).tolist()))

    return World(
        stated,
        design_with_turned_cubes(world.true, stands),
        (*world.effects, *(off(name, quarter) for name, quarter in stands.items())),
    )
