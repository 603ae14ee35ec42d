"""Sketches of effects that move the machine, made from their models: an axis through time, the platform displaced, and what gives each away."""

from rig.sketch.example import Sketch
from rig.sketch.moved import drawn

__all__ = ["Sketch", "drawn"]
