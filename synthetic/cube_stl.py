"""Cube bodies to print in plastic or to mill: an STL for each cube, in mm, as slicers take them."""

import numpy as np

from rig.errors import RigError
from rig.model.design import Design


def cube_stl_files(design: Design, paper: float) -> dict[str, bytes]:
    """{target's name: binary STL} of the cubes, smaller by the paper that is glued around them. paper : m, its
    thickness

    Raises RigError where there is no cube, or nothing is left of one
    """
    import trimesh

    found = {}
    for target in design.targets:
        if target.edge is None:
            continue
        edge = target.edge - 2 * paper
        if not 0 <= paper < target.edge / 2:
            raise RigError(
                f"target {target.name}: nothing of its {target.edge * 1e3:g} mm is left between sheets of "
                f"{paper * 1e3:g} mm"
            )
        found[target.name] = trimesh.creation.box(extents=np.full(3, edge * 1e3)).export(file_type="stl")
    if not found:
        raise RigError("the rig has no cubes; loose markers have no body to print")
    return found
