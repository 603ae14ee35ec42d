"""What one effect does to a machine's poses, asked of the effect's own model at several of its sizes, all else as it
is.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rig.arrays import Floats
from rig.effects.framework.effect import MOTION_STAGES, Effect
from rig.errors import RigError
from rig.model import motion_simulation
from rig.model.design import Design
from rig.model.pose import pose_difference
from rig.recording.recording_folder import Commands, Sensors
from rig.report.pages import view_3d

FACTORS = (0.0, 0.5, 1.0, 2.0, 4.0)  # of the size that it has
NONE = 1e-9  # m and rad; less than this moves no platform


def effect_displacements(
    design: Design,
    commands: Commands,
    t: Floats,
    effects: Sequence[Effect],
    effect_index: int,
    sensors: Sensors | None = None,
) -> view_3d.Effect | None:
    """Displacements by one of several effects at exposures t (n,) s, at several sizes; None without any"""
    effect = effects[effect_index]
    if effect.stage not in MOTION_STAGES:
        return None
    others = [e for k, e in enumerate(effects) if k != effect_index and e.stage in MOTION_STAGES]
    at_rest = motion_simulation.run_machine(design, commands, t, others, sensors).T_base_platform
    sizes, shifts = ["none"], [np.zeros((len(t), 6))]
    for factor in FACTORS[1:]:
        one = scaled_effect(effect, factor)
        try:
            done = motion_simulation.run_machine(design, commands, t, [*others, one], sensors)
        except RigError:
            if factor <= 1:
                raise
            break
        sizes.append(_effect_size_text(one))
        shifts.append(pose_difference(at_rest, done.T_base_platform))
    shown = np.stack(shifts)
    if np.abs(shown).max() < NONE:
        return None
    return view_3d.Effect(f"{effect.label()} at {effect.place}", tuple(sizes), shown)


def scaled_effect(effect: Effect, factor: float) -> Effect:
    """Effect scaled by a factor: its size parameters multiplied, inverse ones divided."""
    values = {
        p.name: _times(getattr(effect, p.name), factor if p.role != "inverse" else 1 / factor)
        for p in effect.parameters
        if p.role in ("linear", "size", "inverse")
    }
    return replace(effect, **values)


def _effect_size_text(effect: Effect) -> str:
    """Its first parameter that tells its size, in words."""
    sized = [p for p in effect.parameters if p.role in ("linear", "size", "inverse")]
    return "" if not sized else sized[0].at(effect.place).said(getattr(effect, sized[0].name))


def _times(value: float | tuple[float, ...], factor: float) -> float | tuple[float, ...]:
    return tuple(v * factor for v in value) if isinstance(value, tuple) else value * factor
