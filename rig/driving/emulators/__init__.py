"""Controllers that are not there: axes that move in time, dialects that answer as the real ones do, and the faults seen
in the field.
"""

from rig.driving.emulators.emulator_construction import emulator_of_design
from rig.driving.emulators.true_commands_log import History

__all__ = ["History", "emulator_of_design"]
