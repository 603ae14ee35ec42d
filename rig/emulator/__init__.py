"""Controllers that are not there: axes that move in time, dialects that answer as the real ones do, and the faults seen in the field."""

from rig.emulator.build import of
from rig.emulator.history import History

__all__ = ["History", "of"]
