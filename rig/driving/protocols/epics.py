"""Protocol of EPICS motor records.

By Channel Access (rig.driving.serial_and_epics_ports_and_checksummed_frames): one record for each strut, or for each
of a hexapod's X, Y, Z, U, V, W.

A move sets VELO and ACCL so that all motors start and arrive together, then VAL. What the records read back says
whether it is done: RBV, DMOV and MSTA. Poses stand for lengths
(rig.driving.protocols.controller_poses_for_hexapod_strut_lengths). Source: motorRecord.html of the synApps motor
module.
"""

from urllib.parse import unquote

import numpy as np

from rig.array_and_json_types import Booleans, Floats
from rig.driving.axis_display_units_and_controller_counts import controller_counts_per_metre_or_radian
from rig.driving.controller_address_and_urgent_stop import epics_motor_record_stop_bytes
from rig.driving.controller_status_and_limits import ControllerLimits
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import PosesForLengths
from rig.driving.protocols.native_strut_protocol import NUMBERS
from rig.driving.protocols.protocol_interface_and_user_line_protocol import (
    POLL,
    TRIES,
    Dialogue,
    Exchange,
    Lines,
    Segment,
    State,
    Verdict,
    dialogue_awaiting_homed,
    dialogue_awaiting_rest_after_stop,
    pause_dialogue,
)
from rig.driving.serial_and_epics_ports_and_checksummed_frames import encode_numbered_frame, last_valid_frame_in_line
from rig.errors import ControllerFault, NoAnswer
from rig.model.design import Controller
from rig.model.mechanism_geometry_classes import Hexapod

UNITS = {"m": 1.0, "cm": 1e2, "mm": 1e3, "um": 1e6, "micron": 1e6, "microns": 1e6, "nm": 1e9}  # in a metre
ANGLE_UNITS = {
    **dict.fromkeys(("deg", "degree", "degrees"), 180 / np.pi),
    **dict.fromkeys(("rad", "radian", "radians"), 1.0),
    "mrad": 1e3,
    "urad": 1e6,
}  # in a radian
BITS = {  # of MSTA, that keep a motor from moving
    2: "at its upper limit switch",
    6: "slips or stalls",
    9: "has a problem",
    12: "does not answer its controller",
    13: "at its lower limit switch",
}
CONTROLLER_SCALES = controller_counts_per_metre_or_radian(["m"] * 3 + ["rad"] * 3)  # mm and degrees, of X .. W
STILL = 1e-7  # m, rad: a coordinate that changes by less is written, at the speed that its record has
HOMED = 14  # bit of MSTA
SEVERITIES = ("no", "minor", "major", "invalid")
MAJOR = 2  # severity of an alarm, from which a motor is not moved
GO = 3  # of SPMG
HELD = {0: "Stop", 1: "Pause"}  # of SPMG
STATE = ("HOMF", "HOMR", "DMOV", "MSTA", "SEVR", "SPMG", "RBV")  # read in this order: what is final once the first
# says that nothing goes on is read after it
LINGERS = 1.0  # s for which MSTA may still have what a homing clears
EXACT = 1e-6  # share by which a figure may differ that a record reads back


class Epics:
    """See rig.driving.protocols.protocol_interface_and_user_line_protocol.Protocol.

    motors : names of the records, without a field
    """

    name = "epics"

    def __init__(self, motors: tuple[str, ...]) -> None:
        self.motors, self.started_anew = motors, False
        self.units = (UNITS,) * len(motors)
        self.urgent_stop = epics_motor_record_stop_bytes(motors)
        self._unit, self._number = np.ones(len(motors)), 0
        self._homed = False

    def hello(self) -> Dialogue[str]:
        units = [text.strip().lower() for text in (yield from self._texts("EGU"))]
        kinds = yield from self._texts("RTYP")
        for motor, unit, kind, known in zip(self.motors, units, kinds, self.units):
            if kind != "motor":
                raise ControllerFault(f"{motor} is a record of type {kind!r}, not a motor record")
            if unit not in known:
                raise ControllerFault(f"{motor}.EGU is {unit!r}; it must be one of {', '.join(known)}")
        self._unit = np.array([known[unit] for unit, known in zip(units, self.units)])
        self._homed = bool((yield from self._state()).homed)
        return f"EPICS motor records {', '.join(self.motors)}"

    def fence(self) -> Dialogue[bool]:
        homed = bool((yield from self._state()).homed)
        return homed or not self._homed

    def state(self) -> Dialogue[State]:
        found = yield from self._state()
        self._homed = self._homed or bool(found.homed)
        return found

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        moving = segment.speed > 0
        return (yield from self._go(segment, segment.target * self._unit, segment.speed * self._unit, moving, moving))

    def _go(
        self, segment: Segment, goals: Floats, speeds: Floats, moving: Booleans, written: Booleans
    ) -> Dialogue[Verdict]:
        """Begin a move to goals (n,) at speeds (n,), each in its record's unit.

        moving : (n,) records whose speed is set; written : (n,) records whose goal is
        """
        for motor, goal, (low, high) in zip(self.motors, goals, (yield from self._travel())):
            if not low <= goal <= high:
                return Verdict(False, f"{motor}: {goal:.6g} is outside LLM {low:.6g} .. HLM {high:.6g} (in its EGU)")
        ramp = (yield from self._read("ACCL")).max()
        if segment.acceleration is not None and (segment.acceleration > 0).any():
            fast = segment.speed > 0
            ramp = float((segment.speed[fast] / segment.acceleration[fast]).max())
        verdict = yield from self._set("ACCL", np.full(len(self.motors), max(ramp, 1e-3)), moving)
        if verdict.accepted:
            verdict = yield from self._set("VELO", speeds, moving)
        if not verdict.accepted:
            return verdict
        verdict = yield from self._put("VAL", goals, written, tries=1)
        if verdict.accepted and (yield from self._read("LVIO")).any():
            return Verdict(False, "a record reports a limit violation (LVIO)")
        return verdict

    def home(self, timeout: float) -> Dialogue[Verdict]:
        everyone = np.ones(len(self.motors), bool)
        self._homed, before = False, (yield from self._state()).fault
        begun = yield from self._put("HOMF", 1.0 * everyone, everyone, tries=1, read_back=False)
        for _ in range(int(LINGERS / POLL)):
            if not before or (yield from self._state()).fault != before:
                break
            yield from pause_dialogue()
        return (yield from dialogue_awaiting_homed(begun, self.state, timeout))

    def stop(self) -> Dialogue[Verdict]:
        everyone = np.ones(len(self.motors), bool)
        sent = yield from self._put("STOP", 1.0 * everyone, everyone, tries=4, read_back=False)
        if sent.accepted is False:  # of some motors, while the others were stopped
            return Verdict(None, f"STOP: {sent.reason}")
        return (yield from dialogue_awaiting_rest_after_stop(self.state, "STOP"))

    def unlock(self) -> Dialogue[Verdict]:
        everyone = np.ones(len(self.motors), bool)
        return (yield from self._put("SPMG", GO * everyone, everyone, tries=4))

    def confirm(self) -> Dialogue[None]:
        self.started_anew = False
        yield from ()

    def limits(self) -> Dialogue[ControllerLimits | None]:
        travel = (yield from self._travel()) / self._unit[:, None]
        fastest = yield from self._read("VMAX")
        return ControllerLimits(
            travel,
            np.ptp(travel, axis=1),
            np.where(fastest > 0, fastest / self._unit, np.nan),
            np.full(len(self.motors), np.nan),
            "LLM, HLM",
            "VMAX",
            "ACCL",
        )

    def event(self, line: str) -> str:
        return ""

    def _travel(self) -> Dialogue[Floats]:
        """(n, 2) least and greatest goals, in each record's unit."""
        low, high = (yield from self._read("LLM")), (yield from self._read("HLM"))
        travel = np.stack([low, high], axis=1)
        travel[(low == 0) & (high == 0)] = -np.inf, np.inf  # which a record takes for no limits
        return travel

    def _positions(self, readings: Floats) -> Floats:
        """(n,) m of the struts, of what the records read back (n,) in their units."""
        return readings / self._unit

    def _state(self) -> Dialogue[State]:
        names = [f"{motor}.{field}" for motor in self.motors for field in STATE]
        values = np.array([float(word) for word in (yield from self._values_of_fields(names))]).reshape(
            len(self.motors), -1
        )
        forward, reverse, done, status, severity, mode, readings = values.T
        bits = status.astype(int)
        faults = [
            f"{motor} {text}" for motor, word in zip(self.motors, bits) for bit, text in BITS.items() if word >> bit & 1
        ]
        faults += [
            f"{motor} has an alarm of severity {SEVERITIES[min(int(level), 3)]}"
            for motor, level in zip(self.motors, severity)
            if level >= MAJOR and not any(fault.startswith(f"{motor} ") for fault in faults)
        ]
        held = [HELD[int(word)] for word in mode if int(word) in HELD]
        if forward.any() or reverse.any():
            activity = "homing"
        elif not done.all():
            activity = "moving"
        else:
            activity = "held" if held else "idle"
        report = f"DMOV {''.join(str(int(word)) for word in done)}, MSTA {' '.join(f'{word:#x}' for word in bits)}"
        report += f", SPMG {held[0]}" if held else ""
        return State(activity, self._positions(readings), bool((bits >> HOMED & 1).all()), "; ".join(faults), report)

    def _texts(self, field: str) -> Dialogue[list[str]]:
        return [
            unquote(word) for word in (yield from self._values_of_fields([f"{motor}.{field}" for motor in self.motors]))
        ]

    def _read(self, field: str) -> Dialogue[Floats]:
        """(n,) of a field, in the record's own unit."""
        words = yield from self._values_of_fields([f"{motor}.{field}" for motor in self.motors])
        return np.array([float(word) for word in words])

    def _values_of_fields(self, names: list[str]) -> Dialogue[tuple[str, ...]]:
        """Values of fields as words. Raises NoAnswer, ControllerFault for one that there is not."""
        for _ in range(TRIES):
            kind, words = yield from self._exchanged(f"GET {' '.join(names)}")
            if kind == "ERR":
                raise ControllerFault(unquote(" ".join(words)))
            if kind == "OK" and len(words) == len(names):
                return tuple(words)
        raise NoAnswer(f"no answer to a request of {names[0]} .. {names[-1]}, asked {TRIES} times")

    def _exchanged(self, text: str) -> Dialogue[tuple[str, list[str]]]:
        """("OK" or "ERR", words) of an answer; ("", []) where none came."""
        self._number = number = self._number % (NUMBERS - 1) + 1
        lines: Lines = yield Exchange(
            encode_numbered_frame(">", number, text), lambda lines: _answer(lines[-1], number) is not None
        )
        answer = None if lines is None else _answer(lines[-1], number)
        if answer is None:
            return "", []
        kind, *words = answer.split(" ")
        return kind, words

    def _set(self, field: str, values: Floats, on: Booleans) -> Dialogue[Verdict]:
        """Write a figure that moves nothing, where it differs."""
        differs = np.abs((yield from self._read(field)) - values) > EXACT * np.abs(values)
        return (yield from self._put(field, values, on & differs, tries=4))

    def _put(self, field: str, values: Floats, on: Booleans, tries: int, read_back: bool = True) -> Dialogue[Verdict]:
        """Write a field of some motors, (n,) each in its record's unit, and compare with what is read back.

        tries : how often, 1 for what moves
        """
        names = [motor for motor, chosen in zip(self.motors, on) if chosen]
        if not names:
            return Verdict(True)
        wanted = values[on]
        words = " ".join(f"{motor}.{field}={value:.9g}" for motor, value in zip(names, wanted))
        for _ in range(tries):
            kind, found = yield from self._exchanged(f"PUT {words}")
            if kind:
                break
        if not kind:
            return Verdict(None, f"no answer to the writing of {field}")
        if kind == "ERR":
            return Verdict(False, unquote(" ".join(found)))
        for motor, value, word in zip(names, wanted, found if read_back else ()):
            if abs(float(word) - value) > EXACT * max(abs(value), 1.0):
                return Verdict(
                    False, f"{motor}.{field} is {float(word):.9g} after {value:.9g} was written (in its EGU)"
                )
        return Verdict(True)


class EpicsHexapod(Epics):
    """See rig.driving.protocols.protocol_interface_and_user_line_protocol.Protocol. Its positions are the struts'
    lengths.

    motors : names of the records of X, Y, Z, U, V, W; hexapod : the geometry by which the controller computes
    """

    name = "epics-hexapod"

    def __init__(self, motors: tuple[str, ...], controller: Controller, hexapod: Hexapod) -> None:
        super().__init__(motors)
        self.units = (UNITS,) * 3 + (ANGLE_UNITS,) * 3
        self.poses = PosesForLengths(hexapod, controller.zero, controller.work, controller.tool, controller.angles)

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        start, goals = self.poses.values(np.stack([segment.start, segment.target])) / CONTROLLER_SCALES
        change = np.abs(goals - start)
        speeds = (
            change / segment.duration if segment.duration > 0 else np.zeros(6)
        )  # the fastest strut's is that asked for
        everyone = np.ones(6, bool)
        return (yield from self._go(segment, goals * self._unit, speeds * self._unit, change > STILL, everyone))

    def limits(self) -> Dialogue[ControllerLimits | None]:
        yield from ()
        return None  # LLM and HLM are of coordinates, and not of struts

    def _positions(self, readings: Floats) -> Floats:
        return self.poses.positions(readings / self._unit * CONTROLLER_SCALES)


def _answer(line: str, number: int) -> str | None:
    """Text of the answer to a request of this number in a line; None where there is none."""
    frame = last_valid_frame_in_line("<", line)
    return None if frame is None or frame.number != number else frame.text
