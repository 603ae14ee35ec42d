"""Emulated controllers: axes that move in time, dialects that answer as the real ones do, and the faults seen
in the field.
"""

from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import TrueCommandsLog
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import emulator_of_design

__all__ = ["TrueCommandsLog", "emulator_of_design"]
