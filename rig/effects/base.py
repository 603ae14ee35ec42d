"""Base class of effects for an owner's effect file, with parameters, and the motion and context that it reads."""

from rig.effects.framework.effect import *  # noqa: F403  # all its names are an owner's
