"""What an owner's effect file imports: the effect, its parameters, the motion and context that it may look at."""

from rig.effects.framework.effect import *  # noqa: F403  # all its names are an owner's
