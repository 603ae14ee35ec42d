"""What one effect does to a machine's poses, asked of the effect's own model at several of its sizes, all else as it
is.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

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
    t: np.ndarray,
    effects: Sequence[Effect],
    which: int,
    sensors: Sensors | None = None,
) -> view_3d.Effect | None:
    """What number `which` of some effects does at exposures at t (n,) s, the others acting with it; None for one that
    moves no platform, and at sizes at which the machine cannot follow no more than at the others is shown. Raises as
    `machine.run`"""
    effect = effects[which]
    if effect.stage not in MOTION_STAGES:
        return None
    others = [e for k, e in enumerate(effects) if k != which and e.stage in MOTION_STAGES]
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
        sizes.append(effect_size_text(one))
        shifts.append(pose_difference(at_rest, done.T_base_platform))
    shown = np.stack(shifts)
    if np.abs(shown).max() < NONE:
        return None
    return view_3d.Effect(f"{effect.label()} at {effect.place}", tuple(sizes), shown)


def scaled_effect(effect: Effect, factor: float) -> Effect:
    """The same effect so many times as large: what it is linear in times that, what it is inverse in by that, all else
    as it is.
    """
    values = {
        p.name: _times(getattr(effect, p.name), factor if p.role != "inverse" else 1 / factor)
        for p in effect.parameters
        if p.role in ("linear", "size", "inverse")
    }
    return replace(effect, **values)


def effect_size_text(effect: Effect) -> str:
    """Its first parameter that tells its size, in words."""
    sized = [p for p in effect.parameters if p.role in ("linear", "size", "inverse")]
    return "" if not sized else sized[0].at(effect.place).said(getattr(effect, sized[0].name))


def _times(value: Any, factor: float) -> Any:
    return tuple(v * factor for v in value) if isinstance(value, tuple) else value * factor
