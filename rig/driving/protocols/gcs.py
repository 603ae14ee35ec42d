"""PI GCS protocol.

For single axes and for hexapods.
Struts are closed-loop axes, errors are read by `ERR?`.

Answers carry no number. After a silence the line is brought in step by `*IDN?`, whose answer cannot be taken for
another. Source: PI GCS 2.0 manuals (e.g. SM151E, MS204E): `#5`, `#7`, `#24` are single bytes; an answer of several
lines has a blank before all line feeds but the last.

C-887: GCS 2.0 with poses, X Y Z in mm and U V W in degrees.

Poses stand for lengths (rig.driving.protocols.controller_poses_for_hexapod_strut_lengths). The pivot point (SPI) is
asked of the controller before every move.
Source: PI MS204E (C-887), MOV, POS?, SPI, VLS; poses: PI MS207E (H-820), 3.7.4; work and tool frames: C887T0007
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats
from rig.driving.controller_address_and_urgent_stop import STOPS
from rig.driving.controller_status_and_limits import ControllerLimits
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import AXES, MM, PosesForLengths
from rig.driving.protocols.protocol_interface_and_user_line_protocol import (
    POLL,
    REST,
    TRIES,
    Dialogue,
    Exchange,
    Lines,
    Segment,
    State,
    Verdict,
    is_never_complete,
    pause_dialogue,
    query_dialogue,
)
from rig.errors import ControllerFault, NoAnswer
from rig.model.mechanism_geometry_classes import Hexapod

UNITS = {"M": 1.0, "MM": 1e3, "UM": 1e6, "µM": 1e6}  # of a metre
STOPPED = 10  # the error that every stop leaves
_AXIS = r"[A-Za-z0-9_-]+"
_NUMBER = r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?"
ERRORS = {
    1: "parameter syntax",
    2: "unknown command",
    5: "not referenced, or servo off",
    7: "position out of limits",
    8: "velocity out of limits",
    STOPPED: "stopped by command",
    15: "invalid axis",
    17: "parameter out of range",
    23: "illegal axis",
    24: "wrong number of parameters",
    25: "invalid number",
    216: "on a limit switch",
    -1024: "motion error: position error too large, servo switched off",
}


class GCS:
    """See rig.driving.protocols.protocol_interface_and_user_line_protocol.Protocol.

    axes : the controller's names, () for the first `count` that it lists itself
    """

    name = "gcs"
    urgent_stop = STOPS["gcs"]

    def __init__(self, axes: Sequence[str], count: int) -> None:
        self.axes, self._count = tuple(axes), count
        self._identity = ""
        self._unit = 1e3
        self.started_anew = False

    def hello(self) -> Dialogue[str]:
        lines = yield from query_dialogue(b"*IDN?\n", lambda lines: lines[-1].count(",") >= 2)
        self._identity = lines[-1].strip()
        listed = tuple(line.strip() for line in (yield from self._ask(b"SAI?\n", _whole(_AXIS))))
        self.axes = self.axes or listed[: self._count]
        missing = [axis for axis in self.axes if axis not in listed]
        if missing or len(self.axes) != self._count:
            raise ControllerFault(
                f"the controller has the axes {' '.join(listed)}; the rig needs {' '.join(missing) or self._count}"
            )
        yield from self._error()  # what was left by whoever came before
        yield from self._learn_unit()
        servo = yield from self._values("SVO?")
        self.started_anew = self.started_anew or not servo.any()
        if not servo.all():
            verdict = yield from self._command("SVO " + " ".join(f"{axis} 1" for axis in self.axes))
            if not verdict.accepted:
                raise ControllerFault(f"the servos cannot be switched on: {verdict.reason}")
        return f"{self._identity}, axes {' '.join(self.axes)}"

    def fence(self) -> Dialogue[bool]:
        yield from self._in_step()
        return bool((yield from self._values("SVO?")).any())

    def state(self) -> Dialogue[State]:
        moving = yield from self._moving()
        positions = yield from self._positions()
        error = yield from self._error()
        fault = "" if error == 0 else _reason(error)
        if moving:
            return State("moving", positions, None, fault, f"moving {moving:X}")
        on_target, servo, referenced = (
            (yield from self._values("ONT?")),
            (yield from self._values("SVO?")),
            (yield from self._values("FRF?")),
        )
        off = [axis for axis, on in zip(self.axes, servo) if not on]
        if off:
            fault = "; ".join(filter(None, (fault, f"the servo of {' '.join(off)} is off")))
        message = (
            f"ONT {on_target.astype(int).tolist()} SVO {servo.astype(int).tolist()} FRF "
            f"{referenced.astype(int).tolist()} ERR {error}"
        )
        return State(
            "off" if off else "idle" if on_target.all() else "moving", positions, bool(referenced.all()), fault, message
        )

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        going = segment.speed > 0
        for word, values in (("VEL", segment.speed), ("ACC", segment.acceleration), ("DEC", segment.acceleration)):
            if values is not None and going.any():
                verdict = yield from self._command(f"{word} " + self._pairs(values, going))
                if not verdict.accepted:
                    return verdict
        return (yield from self._command("MOV " + self._pairs(segment.target, np.ones(len(self.axes), bool))))

    def home(self, timeout: float) -> Dialogue[Verdict]:
        verdict = yield from self._command("FRF " + " ".join(self.axes))
        for _ in range(max(int(timeout / POLL), 1)):
            if not verdict.accepted:
                return verdict
            moving = yield from self._moving()
            error = yield from self._error()
            if error:
                return Verdict(False, _reason(error))
            if not moving:
                referenced = yield from self._values("FRF?")
                self.started_anew = self.started_anew and not referenced.all()
                missing = [axis for axis, done in zip(self.axes, referenced) if not done]
                return Verdict(not missing, f"not referenced: {' '.join(missing)}" if missing else "")
            yield from pause_dialogue()
        return Verdict(None, f"not referenced after {timeout:g} s")

    def stop(self) -> Dialogue[Verdict]:
        yield Exchange(b"HLT\n", is_never_complete, 0.0)
        for _ in range(int(REST / POLL)):
            if not (yield from self._moving()):
                error = yield from self._error()
                return Verdict(True) if error in (0, STOPPED) else Verdict(False, _reason(error))
            yield from pause_dialogue()
        return Verdict(None, f"still moving {REST:g} s after HLT")

    def unlock(self) -> Dialogue[Verdict]:
        yield from self._error()
        return (yield from self._command("SVO " + " ".join(f"{axis} 1" for axis in self.axes)))

    def confirm(self) -> Dialogue[None]:
        self.started_anew = False
        yield from ()

    def limits(self) -> Dialogue[ControllerLimits | None]:
        ends = []
        for question in ("TMN?", "TMX?"):
            lines = yield Exchange(f"{question} {' '.join(self.axes)}\n".encode(), _whole(rf"{_AXIS}={_NUMBER}"))
            pairs = [re.fullmatch(rf"({_AXIS})=({_NUMBER})", line.strip()) for line in lines or ()]
            found = {pair[1]: float(pair[2]) / self._unit for pair in pairs if pair}
            if set(found) != set(self.axes):  # it does not know the question, or answers for other axes
                yield from self._in_step()
                yield from self._error()
                return None
            ends.append([found[axis] for axis in self.axes])
        travel, unsaid = np.array(ends).T, np.full(len(self.axes), np.nan)
        return ControllerLimits(travel, np.ptp(travel, axis=1), unsaid, unsaid, "TMN?, TMX?", "", "")

    def event(self, line: str) -> str:
        return ""

    def _positions(self) -> Dialogue[Floats]:
        """(n,) m as it counts."""
        return (yield from self._values("POS?")) / self._unit

    def _pairs(self, metres: Floats, which: Booleans) -> str:
        return " ".join(f"{axis} {value:.6f}" for axis, value, on in zip(self.axes, self._unit * metres, which) if on)

    def _learn_unit(self) -> Dialogue[None]:
        lines = yield Exchange(b"PUN?\n", _whole(rf"{_AXIS}=\S+"))
        if lines is None:  # older controllers know no other than mm
            yield from self._in_step()
            yield from self._error()
            return
        units = {
            match[2].upper()
            for line in lines
            if (match := re.search(rf"({_AXIS})=(\S+)", line)) and match[1] in self.axes
        }
        if len(units) != 1 or not units <= set(UNITS):
            raise ControllerFault(
                f"the axes count in {' '.join(sorted(units))}; they must all count in one of {' '.join(UNITS)}"
                + ("; a hexapod's own controller is driven by protocol gcs-hexapod" if "DEG" in units else "")
            )
        self._unit = UNITS[units.pop()]

    def _moving(self) -> Dialogue[int]:
        lines = yield from self._ask(
            b"\x05", lambda lines: re.fullmatch(r"(0[xX])?[0-9a-fA-F]+", lines[-1].strip()) is not None
        )
        return int(lines[-1].strip(), 16)

    def _error(self) -> Dialogue[int]:
        lines = yield from self._ask(b"ERR?\n", _is_error)
        return int(lines[-1].strip())

    def _values(self, question: str) -> Dialogue[Floats]:
        """(n,) what a question about axes is answered with. Raises NoAnswer where axes are missing in the answer."""
        found = yield from self._readings(f"{question} {' '.join(self.axes)}", self.axes)
        return np.array([float(found[axis]) for axis in self.axes])

    def _readings(self, question: str, names: Sequence[str], pattern: str = _NUMBER) -> Dialogue[dict[str, str]]:
        """{name: text} that a question is answered with. Raises NoAnswer where names are missing in the answer.

        pattern : that a text fits
        """
        for _ in range(TRIES):
            lines = yield from self._ask(f"{question}\n".encode(), _whole(rf"{_AXIS}={pattern}"))
            pairs = [re.fullmatch(rf"({_AXIS})=({pattern})", line.strip()) for line in lines]
            found = {pair[1]: pair[2] for pair in pairs if pair}
            if set(found) == set(names):
                return found
            yield from self._in_step()
        raise NoAnswer(f"{question} was answered by {lines!r}")

    def _ask(self, data: bytes, complete: Callable[[Sequence[str]], bool]) -> Dialogue[tuple[str, ...]]:
        for _ in range(TRIES):
            lines = yield Exchange(data, complete)
            if lines is not None:
                return lines
            yield from self._in_step()
        error = yield Exchange(b"ERR?\n", _is_error)
        raise NoAnswer(
            f"no answer to {data!r}, asked {TRIES} times"
            + (f"; the controller's error is {_reason(int(error[-1].strip()))}" if error else "")
        )

    def _command(self, line: str) -> Dialogue[Verdict]:
        """A command and the error that it leaves, sent together and once."""
        lines: Lines = yield Exchange(f"{line}\nERR?\n".encode(), _is_error)
        if lines is None:
            yield from self._in_step()
            return Verdict(None, f"no answer to ERR? after {line}")
        error = int(lines[-1].strip())
        return Verdict(error == 0, "" if error == 0 else f"{line.split()[0]}: {_reason(error)}")

    def _in_step(self) -> Dialogue[None]:
        """Have every older answer come and go."""
        yield from query_dialogue(b"*IDN?\n", lambda lines: lines[-1].strip() == self._identity)


def _whole(pattern: str) -> Callable[[Sequence[str]], bool]:
    """Whether the last line of an answer is there: it fits, and has no blank before its line feed."""
    return lambda lines: not lines[-1].endswith(" ") and re.fullmatch(pattern, lines[-1].strip()) is not None


def _is_error(lines: Sequence[str]) -> bool:
    return re.fullmatch(r"-?\d{1,5}", lines[-1].strip()) is not None


def _reason(error: int) -> str:
    return f"error {error} ({ERRORS.get(error, 'see its manual')})"


PIVOT = ("R", "S", "T")  # names of the pivot point's coordinates
HEXAPOD_UNITS = ("MM",) * 3 + ("DEG",) * 3


class GCSHexapod(GCS):
    """See rig.driving.protocols.protocol_interface_and_user_line_protocol.Protocol.

    Its positions are the struts' lengths.
    hexapod : the geometry by which the controller computes; zero : (6,) m, lengths that are called 0
    work : T_base_work, None for the platform at home; tool : T_platform_tool, None for the platform itself
    """

    name = "gcs-hexapod"

    def __init__(
        self, hexapod: Hexapod, zero: Floats, work: RigidTransform | None, tool: RigidTransform | None
    ) -> None:
        super().__init__(AXES, len(AXES))
        self.poses = PosesForLengths(hexapod, zero, work, tool)

    def hello(self) -> Dialogue[str]:
        answer = yield from super().hello()
        yield from self._learn_pivot()
        return f"{answer}, pivot point {' '.join(f'{MM * value:g}' for value in self.poses.frames.pivot)} mm"

    def fence(self) -> Dialogue[bool]:
        same = yield from super().fence()
        yield from self._learn_pivot()
        return same

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        ends = np.stack([segment.start, segment.target])
        start, T = self.poses.platform(ends)
        distance = max(np.linalg.norm(T.translation - start.translation), np.abs(np.diff(ends, axis=0)).max())
        if distance > 0:  # the platform's velocity, with which the fastest strut has the speed that is asked for
            verdict = yield from self._command(f"VLS {MM * distance / segment.duration:.6f}")
            if not verdict.accepted:
                return verdict
        values = self.poses.values(segment.target)
        return (yield from self._command("MOV " + " ".join(f"{a} {value:.6f}" for a, value in zip(AXES, values))))

    def limits(self) -> Dialogue[ControllerLimits | None]:
        yield from ()
        return None  # what TMN? and TMX? say is of each coordinate alone, the others at 0, and not of struts

    def _positions(self) -> Dialogue[Floats]:
        return self.poses.positions((yield from self._values("POS?")))

    def _learn_unit(self) -> Dialogue[None]:
        stated = yield from self._readings("PUN?", AXES, r"\S+")
        found = tuple(stated[axis].upper() for axis in AXES)
        if found != HEXAPOD_UNITS:
            raise ControllerFault(
                f"its axes X Y Z U V W count in {' '.join(found)}, and those of a hexapod's controller in "
                f"{' '.join(HEXAPOD_UNITS)}: is [controller] protocol right?"
            )

    def _learn_pivot(self) -> Dialogue[None]:
        """Learn about which point the platform turns: it may be another since."""
        found = yield from self._readings("SPI?", PIVOT)
        at = np.array([float(found[name]) for name in PIVOT]) / MM
        self.poses.frames = replace(self.poses.frames, pivot=at)
