"""Status of the controller as commands print it: activity, lengths, the pose by the nominal model."""

from rig.array_types import Floats
from rig.driving.controller_status_and_operator_advice import ControllerStatus
from rig.model.design import Design


def lengths_text(lengths: Floats) -> str:
    """Lengths (n,) m as text, in mm."""
    return " ".join(f"{value * 1e3:.4f}" for value in lengths) + " mm"


def print_status(status: ControllerStatus, design: Design) -> None:
    """Print a Status, with the pose that its lengths give by the nominal model."""
    from rig.driving.controller_status_and_operator_advice import operator_advice
    from rig.errors import NotConverged
    from rig.model import mechanisms
    from rig.model.pose import pose_to_vector

    homing = design.driver().homing
    fault = f" ({status.fault})" if status.fault not in ("", status.activity) else ""
    print(f"{status.activity}{fault}{operator_advice(status.activity, homing)}")
    if not status.known:
        print("position not known: " + ("home it" if homing else "see that it is true, then say --trust"))
    print(f"lengths {lengths_text(status.lengths)}")
    if design.mechanism.plates is not None and status.known:
        try:
            v = pose_to_vector(mechanisms.kinematics_of(design.mechanism).forward(status.lengths, design.mechanism))
        except NotConverged:
            print("these lengths close on no pose of the owner's model")
            return
        print(
            f"pose by the owner's model {' '.join(f'{x * 1e3:.4f}' for x in v[:3])} mm, "
            f"{' '.join(f'{x * 1e3:.4f}' for x in v[3:])} mrad"
        )
