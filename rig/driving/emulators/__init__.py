"""Emulated controllers: axes that move in time, dialects that answer as the real ones do, and the faults seen
in the field.
"""

from rig.driving.emulators.controller_emulator_opening_and_ports import emulator_of_design
from rig.driving.emulators.emulator_base_classes import TrueCommandsLog

__all__ = ["TrueCommandsLog", "emulator_of_design"]
