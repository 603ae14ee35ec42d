"""Protocol URScript of Universal Robots' arms.

Joint positions are sent by scripts over the real-time interface.
Moves are movej, straight in joint space: all joints begin and arrive together. A robot answers no script; what became
of one is read back. Its encoders are absolute, so nothing is homed: with homing = true, `rig home` moves to the home
posture. A protective stop is ended at the teach pendant alone.
Source: Universal Robots, the URScript programming language (movej, stopj); client interface (robot, safety modes).
"""

from typing import cast

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.controller_address_and_urgent_stop import STOPS
from rig.driving.protocols.protocol_interface_and_user_line_protocol import (
    POLL,
    Dialogue,
    LineProtocol,
    Segment,
    State,
    Verdict,
    pause_dialogue,
)
from rig.errors import ControllerFault

JOINTS = 6
HOME_SHARE = 0.25  # of the greatest speed, on the way home
NOISE = 1e-6  # rad; a shorter way is none
STARTS = 0.5  # s within which a robot begins what it was sent
RUNNING, NORMAL, REDUCED, PROTECTIVE_STOP = 7, 1, 2, 3
STOPPED, PLAYING, PAUSED = 1, 2, 4
ROBOT_MODES = {
    -1: "no controller",
    0: "disconnected",
    1: "it waits for a safety confirmation",
    2: "booting",
    3: "power off",
    4: "power on",
    5: "brakes are engaged",
    6: "backdrive",
    RUNNING: "running",
    8: "updating firmware",
}
SAFETY_MODES = {
    NORMAL: "normal",
    REDUCED: "reduced",
    PROTECTIVE_STOP: "protective stop",
    4: "recovery: a joint is outside its safety limits",
    5: "safeguard stop",
    6: "emergency stop of the system",
    7: "emergency stop of the robot",
    8: "violation of a safety limit",
    9: "fault",
}
PROGRAMS = {0: "stopping", STOPPED: "stopped", PLAYING: "playing", 3: "pausing", PAUSED: "paused", 5: "resuming"}
_STATE = r"# state (\d+\.\d+) (-?\d+) (\d+) (\d+)((?: -?\d+\.\d+){6})"


class URScript(LineProtocol):
    """See rig.driving.protocols.protocol_interface_and_user_line_protocol.Protocol."""

    name = "urscript"
    urgent_stop = STOPS["urscript"]
    accepted, refused = "# sent", "# no (.*)"
    stop_line = f"# {STOPS['urscript'].decode().strip()}"
    longest = 512
    _time, _anew = 0.0, False  # s since the controller started, as last reported; whether it started since `hello`

    def hello(self) -> Dialogue[str]:
        if self.count != JOINTS:
            raise ControllerFault(f"protocol urscript drives {JOINTS} joints, and this machine has {self.count} axes")
        self._time, self._anew = 0.0, False
        state = yield from self.state()
        return f"Universal Robots controller, {state.controller_text}"

    def fence(self) -> Dialogue[bool]:
        yield from self.state()
        return not self._anew

    def state(self) -> Dialogue[State]:
        found = yield from self.ask("# state", _STATE)
        robot, safety, program = (int(found[k]) for k in (2, 3, 4))
        self._anew, self._time = self._anew or float(found[1]) < self._time, float(found[1])
        fault = "" if safety in (NORMAL, REDUCED) else SAFETY_MODES.get(safety, f"safety mode {safety}")
        text = f"{ROBOT_MODES.get(robot, f'robot mode {robot}')}, safety {SAFETY_MODES.get(safety, safety)}, program "
        text += PROGRAMS.get(program, str(program))
        positions = np.array([float(word) for word in found[5].split()])
        if program not in (STOPPED, PAUSED):
            activity = "moving"
        elif fault:
            activity = "alarm"
        elif robot != RUNNING:
            activity = "off"
        else:
            activity = "idle" if program == STOPPED else "held"
        return State(activity, positions, True, fault, text)  # absolute encoders

    def move_line(self, segment: Segment) -> str:
        ramp = None if segment.acceleration is None else float(segment.acceleration.max())
        return _movej(segment.target, ramp, float(segment.speed.max()))

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        verdict = yield from super().move(segment)
        travel, tolerance = float(np.abs(segment.target - segment.start).max()), self.controller.tolerance
        for _ in range(int(STARTS / POLL) if verdict.accepted and travel > NOISE else 0):
            now = yield from self.state()
            moved = float(np.abs(cast(Floats, now.positions) - segment.start).max())
            if now.activity != "idle" or moved > min(tolerance, travel / 2):
                return verdict
            yield from pause_dialogue()
        if not verdict.accepted or travel <= tolerance:
            return verdict
        return Verdict(None, "the robot did not begin it: it takes scripts in remote control alone")

    def home(self, timeout: float) -> Dialogue[Verdict]:
        c = self.controller
        if c.home is None:
            return Verdict(False, "its encoders are absolute; rig home moves to [controller] home, which is not stated")
        target = c.home - c.zero
        ramp = None if c.max_acceleration is None else HOME_SHARE * float(c.max_acceleration.min())
        verdict = yield from self.command(_movej(target, ramp, HOME_SHARE * float(c.max_speed.min()), ", r=0"))
        idle = 0
        for _ in range(max(int(timeout / POLL), 1)):
            if verdict.accepted is False:
                return verdict
            now = yield from self.state()
            if now.fault or now.activity in ("alarm", "off", "held"):
                return Verdict(False, now.fault or now.controller_text)
            if now.activity == "idle" and np.abs(cast(Floats, now.positions) - target).max() <= c.tolerance:
                return Verdict(True)
            idle = idle + 1 if now.activity == "idle" else 0
            if idle * POLL > 2 * STARTS:
                return Verdict(False, "it stands elsewhere; a robot takes scripts in remote control alone")
            yield from pause_dialogue()
        return Verdict(None, f"not home after {timeout:g} s")

    def unlock(self) -> Dialogue[Verdict]:
        yield from ()
        return Verdict(False, "a robot is unlocked at its teach pendant")


def _movej(target: Floats, acceleration: float | None, speed: float, rest: str = "") -> str:
    """A movej to target (6,) rad at rad/s^2, None for the robot's own, and rad/s of the joint that moves most."""
    ramp = "" if acceleration is None or acceleration == 0 else f", a={acceleration:.6f}"
    return f"# movej([{', '.join(f'{value:.9f}' for value in target)}]{ramp}, v={max(speed, 1e-6):.6f}{rest})"
