"""What tests of the driver share: a step to go, faults in order, where the struts truly stand."""

import numpy as np

from rig.driving.emulators.emulated_axis_motion_and_controller_faults import FaultOrder

STEP = np.array([1, -1, 1, 0.5, 0.25, -1]) * 1e-3


def order(emulator, *kinds):
    emulator.faults.orders.extend(FaultOrder(kind, None) for kind in kinds)


def truly(emulator, clock):
    return emulator.machine.axes.at(clock.now())
