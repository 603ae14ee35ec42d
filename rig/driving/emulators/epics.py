"""Emulated EPICS motor records.

They stand behind the lines of rig.driving.serial_and_epics_ports_and_checksummed_frames, sound or with faults.
"""

from urllib.parse import quote

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.driving_clock import Clock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import MOTOR, EmulatedMachine, Faults
from rig.driving.emulators.emulated_hexapod_controller_pose_geometry import EmulatedPlatform
from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import Emulator
from rig.driving.serial_and_epics_ports_and_checksummed_frames import encode_numbered_frame, last_valid_frame_in_line
from rig.errors import NotConverged

MM = 1e3
PROBLEM, HOMED, MAJOR = 1 << 9, 1 << 14, 2
GO = 3.0


class EpicsMotors(Emulator):
    """motors : names of the records; limits : (n, 2) m of the counters

    units : (n,) of their readings; ranges : (n, 2) of LLM and HLM, in these
    """

    ends = b"\n"

    def __init__(
        self, machine: EmulatedMachine, faults: Faults, clock: Clock, motors: tuple[str, ...], limits: Floats
    ) -> None:
        super().__init__(machine, faults, clock, limits)
        self.motors, self.buffer = motors, 4096  # a circuit of TCP drops nothing
        self.units, self.ranges = ("mm",) * len(motors), MM * self.limits
        self._speed, self._ramp = MM * machine.axes.speed, np.full(len(motors), 0.2)
        self._goal, self._violated = np.zeros(len(motors)), np.zeros(len(motors))
        self._mode = np.full(len(motors), GO)

    def line(self, line: bytes) -> None:
        frame = last_valid_frame_in_line(">", line.decode("latin-1"))
        words = [] if frame is None else frame.text.split()
        if frame is None or len(words) < 2 or words[0] not in ("GET", "PUT"):
            return
        number, (verb, *rest) = frame.number, words
        struck = set[str]()
        if verb == "PUT":
            struck = self._write(rest)
        if "resend" in struck or "resend-moving" in struck:
            return  # the answer is lost with the circuit's buffer
        try:
            values = [self._value(*self._field(word.partition("=")[0])) for word in rest]
        except KeyError as error:
            self.send(encode_numbered_frame("<", number, f"ERR the%20server%20has%20no%20{error.args[0]}").decode())
            return
        if "runs-after-error" in struck or "ok-after-error" in struck:
            self.send(encode_numbered_frame("<", number, "ERR write%20failed").decode())
            if "runs-after-error" in struck:
                return
        self.send(encode_numbered_frame("<", number, f"OK {' '.join(values)}").decode(), acknowledges=verb == "PUT")

    def _field(self, name: str) -> tuple[int, str]:
        motor, _, field = name.rpartition(".")
        if motor not in self.motors:
            raise KeyError(name)
        return self.motors.index(motor), field

    def _value(self, i: int, field: str) -> str:
        t = self.now
        texts = {"EGU": self.units[i], "RTYP": "motor"}
        if field in texts:
            return quote(texts[field])
        moving, fault = self.machine.moving(t) or self.machine.homing(t), self.machine.fault(t)
        wrong = bool(fault) and (not fault.startswith(MOTOR) or fault.split()[-1] == str(i + 1))
        low, high = self.ranges[i]
        values = {
            "RBV": self.readings()[i],
            "VAL": self._goal[i],
            "DMOV": float(not moving),
            "MSTA": float(HOMED * self.machine.homed + PROBLEM * wrong),
            "SEVR": float(MAJOR * wrong),
            "SPMG": self._mode[i],
            "HOMF": float(self.machine.homing(t)),
            "HOMR": 0.0,
            "STOP": 0.0,
            "LLM": low,
            "HLM": high,
            "LVIO": self._violated[i],
            "VELO": self._speed[i],
            "VMAX": MM * self.machine.axes.speed[i],
            "ACCL": self._ramp[i],
        }
        if field not in values:
            raise KeyError(f"{self.motors[i]}.{field}")
        return repr(float(values[field]))

    def _write(self, words: list[str]) -> set[str]:
        """Carry out writes; the faults of their answer. A field that there is not is refused by what reads it back."""
        written = [(*self._field(name), float(value)) for name, _, value in (word.partition("=") for word in words)]
        field = written[0][1]
        at = [i for i, _, _ in written]
        values = np.array([value for _, _, value in written])
        if field == "STOP":
            self.machine.halt(self.now)
        elif field == "VELO":
            self._speed[at] = values
        elif field == "ACCL":
            self._ramp[at] = values
        elif field == "SPMG":
            self._mode[at] = values
        elif field == "HOMF" and not self.machine.deaf:
            self.faults.begin(homing=True)
            end, well = self.machine.start_homing(self.now)
            if not well:
                self.later(end, lambda: self.machine.fail(self.now, "home"))
        elif field == "VAL":
            return self._go(at, values)
        return set()

    def _go(self, at: list[int], values: Floats) -> set[str]:
        before = self.readings()
        goals = before.copy()
        goals[at] = values
        try:
            target = self.counters(goals)
        except NotConverged:
            self._violated[:] = 1.0
            return set()
        self._violated[:] = 1.0 * self.is_beyond_limits(target)
        refused = self._violated.any() or self.machine.fault(self.now) or (self._mode != GO).any() or self.machine.deaf
        if refused or not self.machine.homed and self.busy:
            return set()
        self._goal[at] = values
        return self.start_move(target, float((np.abs(goals - before)[at] / self._speed[at]).max()))

    def readings(self) -> Floats:
        """(n,) what the records read back, in their units."""
        return MM * self.machine.counters(self.now)

    def counters(self, readings: Floats) -> Floats:
        """(n,) m of the struts at readings (n,). Raises NotConverged where no lengths give them."""
        return readings / MM


class EpicsPoseRecords(EpicsMotors):
    """Records of a hexapod's X, Y, Z in mm and U, V, W in degrees. platform : computes poses by its own geometry"""

    def __init__(
        self,
        machine: EmulatedMachine,
        faults: Faults,
        clock: Clock,
        motors: tuple[str, ...],
        limits: Floats,
        platform: EmulatedPlatform,
    ) -> None:
        super().__init__(machine, faults, clock, motors, limits)
        self.platform, self.units = platform, ("mm",) * 3 + ("deg",) * 3
        self.ranges = np.repeat([[-500.0, 500.0], [-60.0, 60.0]], 3, axis=0)

    def readings(self) -> Floats:
        return self.platform.values(self.machine.counters(self.now) + self.machine.zero)

    def counters(self, readings: Floats) -> Floats:
        return self.platform.lengths(readings) - self.machine.zero
