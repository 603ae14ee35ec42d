"""Sketches of effects that move the machine, made from their models: an axis through time, the platform displaced, and
what gives each away.
"""

from rig.effects.sketches.arm_effect_sketches import draw_arm_effect_sketch
from rig.effects.sketches.motion_effect_sketches import Sketch, draw_motion_effect_sketch

__all__ = ["Sketch", "draw_arm_effect_sketch", "draw_motion_effect_sketch"]
