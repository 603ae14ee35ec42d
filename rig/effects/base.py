"""Base class of effects, for an effect file of the user's own.

With parameters, and the motion and context that it reads.
"""

from rig.effects.framework.effect_base_class import *  # noqa: F403  # all its names are an owner's
