"""Protocol of Newport HXP hexapod controllers.

It takes poses, X Y Z in mm and U V W in degrees.
Poses stand for lengths (rig.driving.protocols.controller_poses_for_hexapod_strut_lengths); they are those of its Tool
coordinate system in its Work coordinate system. Calls and answers are lines of
rig.driving.newport_function_call_tcp_port. A move and a homing are
answered at their end; the group's state says meanwhile that they have begun.
U V W are taken as Bryant angles, about axes that move along, R = Rx(U) Ry(V) Rz(W). That is not verified: neither read
in a manual nor seen at a controller; [controller] angles states the other order.
Source: functions, group states and errors as public drivers of the XPS controllers have them; a strut's own name is
HEXAPOD.1 .. HEXAPOD.6.
"""

import re
from collections.abc import Sequence

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.controller_address_and_urgent_stop import STOPS
from rig.driving.controller_status_and_limits import ControllerLimits
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import (
    EXACT,
    MM,
    PosesForLengths,
    require_unchanged_coordinate_systems,
)
from rig.driving.protocols.protocol_interface_and_user_line_protocol import (
    NUMBERS,
    POLL,
    REST,
    Dialogue,
    Exchange,
    LineProtocol,
    Segment,
    State,
    Verdict,
    dialogue_awaiting_homed,
    pause_dialogue,
)
from rig.errors import ControllerFault
from rig.model.design import Controller
from rig.model.mechanism_geometry_classes import Hexapod

GROUP = "HEXAPOD"
STRUTS = tuple(f"{GROUP}.{i + 1}" for i in range(6))
POSITIONS = ("HexapodPositionCurrentGet", "GroupPositionCurrentGet")  # of XPS-D firmware; of that before it
SYSTEMS = {"Work": "work", "Tool": "tool"}  # coordinate systems: keys of [controller]
READY = {*range(10, 20), 56, 70, 77, 79}  # group states
DISABLED = {*range(20, 40), 58, 59, *range(74, 77), *range(80, 83), *range(84, 104)}
HOMING, MOVING = {41, 43, 64}, {*range(44, 50), 51}
BRAKING = 40
UNREFERENCED, SWITCHED_OFF = {0, 7, 42}, 20  # after power on, after a kill, after initialising; by MotionDisable
INITIALISED = 42
ABORTED = -27  # error of a move that was stopped
AT_ONCE = 0.05  # s in which a call that cannot begin is refused
BEGIN = 2.0  # s in which one that was sent has begun
NUMBER = r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?"
_ANSWER = re.compile(r"(\d+) (-?\d+),(.*),EndOfAPI")


class HXP(LineProtocol):
    """See rig.driving.protocols.protocol_interface_and_user_line_protocol.Protocol. hexapod : the geometry by which
    the controller computes
    """

    name = "hxp"
    urgent_stop = STOPS["hxp"]
    accepted, refused = r"# 0,.*,EndOfAPI", r"# (-[1-9]\d*),.*,EndOfAPI"
    stop_line = f"# GroupMoveAbort({GROUP})"
    longest = 256

    def __init__(self, controller: Controller, hexapod: Hexapod) -> None:
        super().__init__(controller, 6)
        self.poses = PosesForLengths(hexapod, controller.zero, controller.work, controller.tool, controller.angles)
        self._position, self._homed = POSITIONS[0], False
        self._systems: list[Floats] = []
        self._begun: int | None = None  # number of the motion that is not answered yet
        self._outcome: int | None = None

    def hello(self) -> Dialogue[str]:
        firmware = yield from self._called("FirmwareVersionGet(char *)")
        for self._position in POSITIONS:
            found = yield from self.ask(f"# {_call(self._position, GROUP, 6)}", f"{self.accepted}|{self.refused}")
            if found[1] is None:
                break
        self._systems = yield from self._coordinate_systems()
        self._homed = bool((yield from self.state()).homed)
        return f"Newport {firmware}, group {GROUP}"

    def fence(self) -> Dialogue[bool]:
        require_unchanged_coordinate_systems(SYSTEMS, self._systems, (yield from self._coordinate_systems()))
        state = yield from self.state()
        return bool(state.homed) or not self._homed

    def state(self) -> Dialogue[State]:
        code = yield from self._group_state()
        positions = self.poses.positions((yield from self._numbers(self._position, GROUP, 6)))
        activity, homed = _activity(code)
        self._homed = self._homed or homed
        text = f"group state {code}"
        quiet = code in UNREFERENCED | READY | HOMING | MOVING or code == SWITCHED_OFF
        if not quiet:
            text += f", {(yield from self._called(f'GroupStatusStringGet({code},char *)'))}"
        return State(activity, positions, homed, "" if quiet else text, text, code in UNREFERENCED)

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        for strut, speed, i in zip(STRUTS, MM * segment.speed, range(6)):
            if speed > 0:
                now = yield from self._numbers("PositionerSGammaParametersGet", strut, 4)
                wanted = now.copy()
                wanted[0] = speed
                if segment.acceleration is not None:
                    wanted[1] = MM * segment.acceleration[i]
                if not np.allclose(now, wanted, rtol=EXACT, atol=0):
                    words = ",".join(f"{value:.9g}" for value in wanted)
                    verdict = yield from self.command(f"# PositionerSGammaParametersSet({strut},{words})")
                    if not verdict.accepted:
                        return verdict
        pose = ",".join(f"{value:.6f}" for value in self.poses.values(segment.target))
        return (yield from self._begin(f"HexapodMoveAbsolute({GROUP},Work,{pose})"))

    def home(self, timeout: float) -> Dialogue[Verdict]:
        self._homed = False
        verdict = yield from self.command(f"# GroupKill({GROUP})")
        if verdict.accepted:
            verdict = yield from self._begin(f"GroupInitialize({GROUP})", INITIALISED)
        for _ in range(max(int(timeout / POLL), 1)):
            if not verdict.accepted or (yield from self._group_state()) == INITIALISED:
                break
            yield from pause_dialogue()
            if self._outcome:
                verdict = yield from self._refusal("GroupInitialize", self._outcome)
        if verdict.accepted:
            verdict = yield from self._begin(f"GroupHomeSearch({GROUP})")
        return verdict if not verdict.accepted else (yield from dialogue_awaiting_homed(verdict, self.state, timeout))

    def stop(self) -> Dialogue[Verdict]:
        yield from self.command(self.stop_line)
        is_killed = False
        for _ in range(int(REST / POLL)):
            code = yield from self._group_state()
            activity, homed = _activity(code)
            if activity == "moving":
                yield from self.command(self.stop_line)
            elif code != BRAKING and (homed or is_killed):
                return Verdict(True)
            elif not is_killed:  # no homing can be aborted, and where the struts are is not known anyway
                is_killed = (yield from self.command(f"# GroupKill({GROUP})")).accepted is True
            yield from pause_dialogue()
        return Verdict(None, f"still moving {REST:g} s after GroupMoveAbort")

    def unlock(self) -> Dialogue[Verdict]:
        code = yield from self._group_state()
        if code in DISABLED:
            return (yield from self.command(f"# GroupMotionEnable({GROUP})"))
        if code in UNREFERENCED | READY:
            return Verdict(True)
        return (yield from self._begin(f"GroupInitialize({GROUP})", INITIALISED))

    def limits(self) -> Dialogue[ControllerLimits | None]:
        ends, fastest = [], []
        for strut in STRUTS:
            ends.append((yield from self._numbers("PositionerUserTravelLimitsGet", strut, 2)))
            fastest.append((yield from self._numbers("PositionerMaximumVelocityAndAccelerationGet", strut, 2)))
        speed, acceleration = np.array(fastest).T / MM
        everywhere = np.tile([-np.inf, np.inf], (6, 1))  # a strut's own zero is not that of lengths
        span = np.ptp(np.array(ends), axis=1) / MM
        return ControllerLimits(
            everywhere, span, speed, acceleration, "user travel limits", "maximum velocity", "maximum acceleration"
        )

    def command(self, text: str) -> Dialogue[Verdict]:
        verdict = yield from super().command(text)
        if verdict.accepted is not False:
            return verdict
        return (yield from self._refusal(text.split()[1].partition("(")[0], int(verdict.reason)))

    def event(self, line: str) -> str:
        found = _ANSWER.fullmatch(line.strip())
        if found is None or int(found[1]) != self._begun:
            return ""
        self._outcome, self._begun = int(found[2]), None  # its number comes round
        return "" if self._outcome in (0, ABORTED) else f"the motion ended with error {self._outcome}"

    def _begin(self, call: str, ends_in: int | None = None) -> Dialogue[Verdict]:
        """Send a call once that is answered at its end, and wait until it has begun. ends_in : group state after it"""
        self._number = self._begun = self._number % (NUMBERS - 1) + 1
        self._outcome = None
        data = self.encode(f"{self._number} {call}")
        yield Exchange(data, self._has_outcome, AT_ONCE)
        for _ in range(int(BEGIN / POLL)):
            if self._outcome is not None:
                break
            code = yield from self._group_state()
            if code in MOVING | HOMING or code == ends_in:
                return Verdict(True)
            yield from pause_dialogue()
        if self._outcome is None:
            return Verdict(None, f"no answer to {call}")
        if self._outcome == 0:
            return Verdict(True)
        return (yield from self._refusal(call.partition("(")[0], self._outcome))

    def _has_outcome(self, lines: Sequence[str]) -> bool:
        """Whether the call that was begun has been answered, which `event` has noted."""
        return self._outcome is not None

    def _coordinate_systems(self) -> Dialogue[list[Floats]]:
        """(6,) mm and degrees of each of SYSTEMS."""
        found = []
        for name in SYSTEMS:
            found.append((yield from self._numbers("HexapodCoordinateSystemGet", f"{GROUP},{name}", 6)))
        return found

    def _group_state(self) -> Dialogue[int]:
        return int((yield from self._called(f"GroupStatusGet({GROUP},int *)", r"\d{1,3}")))

    def _numbers(self, function: str, what: str, count: int) -> Dialogue[Floats]:
        """(count,) numbers that a function returns. Raises NoAnswer, ControllerFault."""
        text = yield from self._called(_call(function, what, count), rf"{NUMBER}(?:,{NUMBER}){{{count - 1}}}")
        return np.array([float(word) for word in text.split(",")])

    def _called(self, call: str, pattern: str = ".*") -> Dialogue[str]:
        """What a call that moves nothing returns, of a pattern. Raises NoAnswer, ControllerFault for its error."""
        found = yield from self.ask(f"# {call}", f"# 0,(?P<values>{pattern}),EndOfAPI|{self.refused}")
        if found["values"] is None:
            raise ControllerFault((yield from self._refusal(call, int(found[2]))).reason)
        return str(found["values"])

    def _refusal(self, function: str, error: int) -> Dialogue[Verdict]:
        """Verdict on a function that gave an error, in the controller's words."""
        found = yield from self.ask(f"# ErrorStringGet({error},char *)", r"# -?\d+,(.*),EndOfAPI")
        return Verdict(False, f"{function}: error {error} ({found[1] or 'see its manual'})")


def _call(function: str, what: str, count: int) -> str:
    """Text of a call that returns numbers."""
    return f"{function}({what},{','.join(['double *'] * count)})"


def _activity(code: int) -> tuple[str, bool]:
    """(activity, whether it is homed) of a group state."""
    for codes, activity, homed in (
        (READY, "idle", True),
        (MOVING, "moving", True),
        (DISABLED, "off", True),
        (HOMING, "homing", False),
    ):
        if code in codes:
            return activity, homed
    return "alarm", False
