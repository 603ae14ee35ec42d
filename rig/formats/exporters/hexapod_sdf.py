"""A hexapod as SDF, loops and all: universal joints at the base, slides, balls at the platform, which stands at home.

A slide l1 .. l6 is zero at home, as every joint of SDF is where its links stand: what is commanded is its position plus
the length commanded at home, of which its limits know. Masses are SDF's default, 1 kg for each link, until somebody
states them.
Source: SDFormat 1.9 specification, <joint>
"""

from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.formats.exporters.arm_urdf import rpy
from rig.formats.exporters.simulator_struts import Strut, simulator_struts
from rig.model.design import Hexapod


def hexapod_sdf(hexapod: Hexapod, name: str = "hexapod") -> str:
    """SDF of a Hexapod: links base, strut_N, strut_N_rod and platform, frames as the base's at home. Raises RigError
    where no cardan can be.
    """
    lines = [
        '<?xml version="1.0"?>',
        '<sdf version="1.9">',
        f"  <model name={quoteattr(name)}>",
        '    <link name="base"/>',
        f'    <link name="platform">{_pose(hexapod.home)}</link>',
        '    <joint name="ground" type="fixed"><parent>world</parent><child>base</child></joint>',
    ]
    for n, strut in enumerate(simulator_struts(hexapod), 1):
        lines += _strut(n, strut)
    return "\n".join([*lines, "  </model>", "</sdf>"]) + "\n"


def _strut(n: int, strut: Strut) -> list[str]:
    """Links and joints of one strut; a joint's frame is its child's link."""
    standing, R = strut.T_base_strut(), strut.T_base_cross.rotation.as_matrix()
    end = standing * RigidTransform.from_translation([0, 0, strut.home])
    low, high = strut.limits + strut.zero - strut.home
    axes = "".join(
        f'<axis{k or ""}><xyz expressed_in="__model__">{_figures(R[:, column])}</xyz></axis{k or ""}>'
        for column, k in ((0, ""), (1, 2))
    )
    return [
        f'    <link name="strut_{n}">{_pose(standing)}</link>',
        f'    <link name="strut_{n}_rod">{_pose(end)}</link>',
        f'    <joint name="strut_{n}_base" '
        f'type="universal"><parent>base</parent><child>strut_{n}</child>{axes}</joint>',
        f'    <joint name="l{n}" type="prismatic"><parent>strut_{n}</parent><child>strut_{n}_rod</child>'
        f"<axis><xyz>0 0 1</xyz><limit><lower>{low:.12g}</lower><upper>{high:.12g}</upper></limit></axis></joint>",
        f'    <joint name="strut_{n}_platform" type="ball"><pose '
        f'relative_to="strut_{n}_rod"/><parent>strut_{n}_rod</parent>'
        "<child>platform</child></joint>",
    ]


def _pose(T: RigidTransform) -> str:
    return f"<pose>{_figures(T.translation)} {_figures(rpy(T.rotation))}</pose>"


def _figures(values: np.ndarray) -> str:
    return " ".join(f"{value:.16g}" for value in values)
