"""Commands through time -> poses: the one forward model of motion."""

from rig import mechanisms


def poses(mechanism, commands, t):
    """T_base_platform : RigidTransform (n,) of a mechanism at times t (n,) s under Commands. Raises what `forward` raises."""
    return mechanisms.of(mechanism).forward(commands.at(t), mechanism)
