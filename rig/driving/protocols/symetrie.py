"""Symétrie protocol: hexapods' own controllers on a Power PMAC that take poses, X Y Z in mm and U V W in degrees.

Poses stand for lengths (rig.driving.protocols.controller_poses_for_hexapod_strut_lengths); they are those of its
Object coordinate system in its User coordinate system, angles about axes that stay. Lines go to the PMAC's program
`gpascii -2` and are answered by lines and 0x06. A command is written to the variable c_cmd, its parameters to c_par:
c_cmd is above 0 until it was carried out (of a move or a homing, until that has begun), then 0, or below 0 where it
was refused. Each line writes a number to c_par(19), which no command here takes, and reads it back at its end: it
marks the answer.
Source: variables, bits, commands, codes: github.com/IvS-KULeuven/cgse (dynalpha.py), gitlab.esrf.fr/bliss/bliss
(shexapod), github.com/epics-motor/motorSymetrie with its manual MAN_SOFT_EPICS; order of turns: MAN_A_Software API
4.0, 2.4, as git.tdehaeze.xyz/tdehaeze/nass-simscape quotes it. No controller was tried.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.controller_address_and_urgent_stop import STOPS
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import (
    MM,
    PosesForLengths,
    require_unchanged_coordinate_systems,
    xyz_mm_uvw_degrees_of_poses,
)
from rig.driving.protocols.protocol_interface_and_user_line_protocol import (
    POLL,
    Dialogue,
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

TURNS = "fixed"
ACK = "\x06"  # ends every answer
MARK = "c_par(19)"
SYSTEMS = {"User": "work", "Object": "tool"}  # coordinate systems: keys of [controller]
ERROR, INITIALISED, CONTROL_ON, IN_POSITION, MOTION, HOMING, HOMED = (1 << bit for bit in range(7))  # of s_hexa
EMERGENCY_STOP = 1 << 14
NO_ACTION, HOME_ACTIONS = 0, (4, 5)  # of s_action
STATUS = 45  # values of s_hexa and of what follows it: s_action, the two poses, struts, inputs, s_err_nr
STRUT_FAULTS = {9: "limit switch", 10: "limit switch", 11: "limit", 12: "following error", 13: "drive", 14: "encoder"}
CARRIED_OUT = 5.0  # s in which a command is carried out or refused; the maker's own program waits as long
REASONS = {
    -34: "it is stopping",
    -35: "the motors are not controlled",
    -37: "the emergency stop is pressed",
    -38: "it is moving",
    -39: "it is homing",
    -40: "the pose is beyond its limits",
    -43: "an error that only a restart ends",
    -44: "an error that has to be cleared",
    -45: "it is not homed",
    -51: "another command is under way",
    -77: "its kinematics find no solution",
}
NUMBER = r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d{1,2})?"
NAME = r"(?:[^\s=]+=)?"  # before a value, until `echo7` was sent on a connection
REFUSED = r".*(error \x23\d+.*?)(?: \x06)?"


class Symetrie(LineProtocol):
    """See rig.driving.protocols.protocol_interface_and_user_line_protocol.Protocol. hexapod : the geometry by which
    the controller computes
    """

    name = "symetrie"
    urgent_stop = STOPS["symetrie"]
    accepted, refused = f"{NAME}# {ACK}", REFUSED
    home_line, stop_line, unlock_line = "c_cmd=C_HOME", "c_cmd=C_STOP", "c_cmd=C_CLEARERROR"
    longest = 256

    def __init__(self, controller: Controller, hexapod: Hexapod) -> None:
        super().__init__(controller, 6)
        self.poses = PosesForLengths(hexapod, controller.zero, controller.work, controller.tool, TURNS)
        self._systems: list[Floats] | None = None
        self._homed, self._tolerance = False, controller.tolerance
        self._least, self._greatest = np.zeros(2), np.zeros(2)  # speeds, mm/s and deg/s
        self._shortest_ramp = 0.0  # s

    def hello(self) -> Dialogue[str]:
        yield from super().ask("echo7", f"(?:.* )?{ACK}")  # numbers alone, without the names of variables
        values = yield from self._read("c_cmd=C_VERSION", 12)
        _, self._least, self._greatest = np.split((yield from self._read("c_cfg=0 c_cmd=C_CFG_SPEED", 6)), 3)
        self._shortest_ramp = float((yield from self._read("c_cfg=0 c_cmd=C_CFG_TA", 3))[1])
        self._homed = False
        yield from self.fence()  # after a restart the coordinate systems may be others
        software, interface = (".".join(f"{value:.0f}" for value in values[k : k + 4]) for k in (1, 5))
        return f"Symétrie hexapod {values[9]:.0f}-{values[10]:.0f}, controller {software}, interface {interface}"

    def fence(self) -> Dialogue[bool]:
        verdict = yield from self._carried_out("what was sent before")
        if verdict.accepted is None:
            raise ControllerFault(verdict.reason)
        state = yield from self.state()
        now = np.split((yield from self._read("c_cfg=0 c_cmd=C_CFG_CS", 12)), 2)
        require_unchanged_coordinate_systems(SYSTEMS, self._systems or now, now)
        self._systems = now
        return bool(state.homed) or not self._homed

    def state(self) -> Dialogue[State]:
        values = yield from self._values(f"s_hexa,{STATUS},1", STATUS)
        bits, action, errors = int(values[0]), int(values[1]), int(values[STATUS - 1])
        homed = bool(bits & HOMED)
        self._homed = self._homed or homed
        if bits & HOMING or action in HOME_ACTIONS:
            activity = "homing"
        elif bits & MOTION or action != NO_ACTION:
            activity = "moving"
        elif bits & (ERROR | EMERGENCY_STOP) or not bits & INITIALISED:
            activity = "alarm"
        elif homed and not bits & CONTROL_ON:
            activity = "off"  # one that is not homed is switched on by homing it
        else:
            activity = "idle" if bits & IN_POSITION or not homed else "moving"
        text = f"s_hexa {bits}, s_action {action}, s_err_nr {errors}"
        return State(activity, self.poses.positions(values[2:8]), homed, _fault(bits, errors, values[14:20]), text)

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        T = self.poses.frames.command_of_pose(self.poses.platform(np.stack([segment.start, segment.target])))
        turn = (T[0].rotation.inv() * T[1].rotation).magnitude()
        way = MM * np.linalg.norm(np.diff(T.translation, axis=0)), np.degrees(turn)
        wanted = np.array(way) / segment.duration if segment.duration > 0 else np.zeros(2)
        if (wanted > self._greatest).any() or (wanted.any() and (wanted < self._least).all()):
            ranges = zip(self._least, self._greatest, ("mm/s", "deg/s"), wanted)
            words = (f"{least:g} to {most:g} {unit}, not at {speed:.3g}" for least, most, unit, speed in ranges)
            return Verdict(False, f"it goes at {' and '.join(words)}: state another max_speed")
        speeds = np.maximum(wanted, self._least)  # the other of the two determines the time
        verdict = yield from self.command(f"c_cfg=1 {_parameters(speeds)} c_cmd=C_CFG_SPEED")
        going = segment.speed > 0
        if verdict.accepted and segment.acceleration is not None and going.any():
            ramp = (segment.speed[going] / segment.acceleration[going]).max()
            ramp = max(ramp, self._shortest_ramp)
            verdict = yield from self.command(f"c_cfg=1 {_parameters([ramp])} c_cmd=C_CFG_TA")
        if not verdict.accepted:
            return verdict
        standing = self.poses.positions((yield from self._values(f"s_hexa,{STATUS},1", STATUS))[2:8])
        if np.abs(standing - segment.start).max() > self._tolerance:
            return Verdict(False, "it no longer stands where the move begins")  # it drifted, as the speeds were set
        pose = xyz_mm_uvw_degrees_of_poses(T[1], TURNS)
        return (yield from self.command(f"c_par(0)=0 {_parameters(pose, 1)} c_cmd=C_MOVE_PTP"))

    def home(self, timeout: float) -> Dialogue[Verdict]:
        self._homed = False
        verdict = yield from self._controlled()
        if verdict.accepted:
            verdict = yield from self.command(self.home_line)
            if verdict.accepted is None and not (yield from self._homing_begun()):
                return verdict
            verdict = yield from dialogue_awaiting_homed(verdict, self._homing_state, timeout)
        return (yield from self._controlled()) if verdict.accepted else verdict

    def unlock(self) -> Dialogue[Verdict]:
        verdict = yield from self.command(self.unlock_line)
        return (yield from self._controlled()) if verdict.accepted else verdict

    def command(self, text: str) -> Dialogue[Verdict]:
        verdict = yield from super().command(f"{MARK}=# {text} {MARK}")
        return (yield from self._carried_out(text)) if verdict.accepted else verdict

    def answer_ended_by_last_line(self, lines: Sequence[str]) -> str:
        """Lines since the answer before, in one; an answer ends with ACK, that to an unknown command maybe without."""
        if lines[-1].strip() != ACK and "error #" not in lines[-1]:
            return ""
        begins = max((k + 1 for k, line in enumerate(lines[:-1]) if line.strip() == ACK), default=0)
        return " ".join(line.strip() for line in lines[begins:])

    def _controlled(self) -> Dialogue[Verdict]:
        """Switch the motors' control on where it is off."""
        bits = int((yield from self._values("s_hexa", 1))[0])
        return Verdict(True) if bits & CONTROL_ON else (yield from self.command("c_cmd=C_CONTROLON"))

    def _homing_begun(self) -> Dialogue[bool]:
        """Whether it homes, or is not homed, after a command that may be lost: else it was homed before."""
        for _ in range(int(CARRIED_OUT / POLL)):
            state = yield from self.state()
            if state.activity == "homing" or not state.homed:
                return True
            yield from pause_dialogue()
        return False

    def _homing_state(self) -> Dialogue[State]:
        """State in which motors that a homing has left without control count as at rest."""
        state = yield from self.state()
        return replace(state, activity="idle") if state.activity == "off" else state

    def _carried_out(self, command: str) -> Dialogue[Verdict]:
        """What the command that was written last comes to, awaited."""
        for _ in range(int(CARRIED_OUT / POLL)):
            code = int((yield from self._values("c_cmd", 1))[0])
            if code <= 0:
                return Verdict(code == 0, f"{command.split('=')[-1]}: code {code} ({_reason(code)})" if code else "")
            yield from pause_dialogue()
        return Verdict(None, f"{command}: not carried out after {CARRIED_OUT:g} s")

    def _read(self, command: str, count: int) -> Dialogue[Floats]:
        """(count,) numbers that a command leaves in c_par. Raises ControllerFault where it is refused, NoAnswer."""
        verdict = yield from self.command(command)
        if not verdict.accepted:
            raise ControllerFault(verdict.reason)
        return (yield from self._values(f"c_par(0),{count},1", count))

    def _values(self, question: str, count: int) -> Dialogue[Floats]:
        """(count,) numbers of variables. Raises ControllerFault where the controller does not know them, NoAnswer."""
        wanted = rf"((?:{NAME}{NUMBER} ){{{count}}}){NAME}# {ACK}"
        found = yield from super().ask(f"{MARK}=# {question} {MARK}", f"{wanted}|{self.refused}")
        if found[1] is None:
            raise ControllerFault(f"{question}: {found[2]}: is this a hexapod of Symétrie?")
        return np.array([value.rpartition("=")[2] for value in found[1].split()], float)


def _parameters(values: Sequence[float] | Floats, first: int = 0) -> str:
    """Text that writes values to c_par, from an index on."""
    return " ".join(f"c_par({k})={value:.6f}" for k, value in enumerate(values, first))


def _reason(code: int) -> str:
    """What a code of c_cmd below 0 means."""
    return f"parameter {-10 - code} is wrong" if -29 <= code <= -10 else REASONS.get(code, "see its manual")


def _fault(bits: int, errors: int, struts: Floats) -> str:
    """Why it cannot be moved, "" for nothing. bits : of s_hexa; errors : their number; struts : (6,) bits of s_ax"""
    if bits & EMERGENCY_STOP:
        return "the emergency stop is pressed"
    if not bits & INITIALISED:
        return "it is starting, which takes about two minutes"
    if not bits & ERROR:
        return ""
    words = [
        f"strut {k} ({text})"
        for k, strut in enumerate(struts, 1)
        for bit, text in STRUT_FAULTS.items()
        if int(strut) >> bit & 1
    ]
    return f"{errors} error{'s' * (errors != 1)}{': ' * bool(words)}{', '.join(words)}"
