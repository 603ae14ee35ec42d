"""Sketches of effects that move the machine, made from their models: an axis through time, the platform displaced, and
what gives each away.
"""

from rig.effects.sketches.effect_example import Sketch
from rig.effects.sketches.motion_effect_figures import draw_sketch

__all__ = ["Sketch", "draw_sketch"]
