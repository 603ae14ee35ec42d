"""Six struts by Klipper's API socket: axes X Y Z, and A B C of manual steppers. Not tried on real hardware."""

import json
import secrets

import numpy as np

from rig.driving.base import Dialogue, LineEmulator, LineProtocol, Segment, State

QUERY = (
    '{"id":#,"method":"objects/query","params":{"objects":{"webhooks":["state"],"motion_report":["live_position"],'
    '"toolhead":["print_time","estimated_print_time"],"gcode_macro RIG":["homed","start"]}}}'
)
SCRIPT = '{"id":#,"method":"gcode/script","params":{"script":"%s"}}'


class Klipper(LineProtocol):
    """Numbered JSON messages that end in byte 3; positions in millimetres."""

    name, longest = "klipper", 512
    urgent_stop = b'{"id":0,"method":"emergency_stop"}\x03'
    accepted, refused = r'\{"id":#,"result":\{\}\}', r'\{"id":#,"error":\{.*"message":"(.*)"\}\}'
    home_line, unlock_line = SCRIPT % "RIG_HOME", SCRIPT % "FIRMWARE_RESTART"
    stop_line = '{"id":#,"method":"emergency_stop"}'

    def encode(self, text: str) -> bytes:
        return text.encode("ascii") + b"\x03"

    def decode(self, line: str) -> str:
        try:
            return line if isinstance(json.loads(line), dict) else ""
        except ValueError:
            return ""

    def status(self) -> Dialogue[dict]:
        """What the objects say of themselves."""
        found = yield from self.ask(QUERY, r'\{"id":#,"result":(\{.*"gcode_macro RIG":\{"homed".*\})\}')
        return json.loads(found[1])["status"]

    def identity(self) -> Dialogue[tuple[str, str]]:
        start = (yield from self.status())["gcode_macro RIG"]["start"]
        if not start:  # it has started: the macro's variables are as in its configuration
            start = 1 + secrets.randbelow(10**6)
            line = f"SET_GCODE_VARIABLE MACRO=RIG VARIABLE=start VALUE={start}"
            yield from self.ask(SCRIPT % line, self.accepted)
        return "Klipper", str(start)

    def state(self) -> Dialogue[State]:
        found = yield from self.status()
        live, head = found["motion_report"]["live_position"], found["toolhead"]
        homed, said = found["gcode_macro RIG"]["homed"], found["webhooks"]["state"]
        moves = head["print_time"] > head["estimated_print_time"]
        activity = "alarm" if said != "ready" else "homing" if homed < 0 else "moving" if moves else "idle"
        struts = [*live[:3], *live[4:], 0.0, 0.0, 0.0][:6]  # the fourth is the extruder; A B C are there once homed
        return State(activity, 1e-3 * np.array(struts, float), homed > 0, "" if said == "ready" else said, said)

    def move_line(self, segment: Segment) -> str:
        target, way = 1e3 * segment.target, 1e3 * (segment.target - segment.start)
        length = np.linalg.norm(way[:3]) if np.abs(way[:3]).max() > 1e-4 else np.abs(way[3:]).max()
        words = " ".join(f"{axis}{value:.4f}" for axis, value in zip("XYZABC", target))
        feed = 60 * max(length, 1e-3) / max(segment.duration, 1e-2)  # mm/min of X Y Z, or where they rest of the others
        return SCRIPT % f"G90\\nG1 {words} F{feed:.9g}"


class KlipperEmulator(LineEmulator):
    """Klipper's side. Its socket drops nothing, so the faults of small buffers are not shown."""

    protocol, ends = Klipper, b"\x03"

    def __init__(self, *parts) -> None:
        super().__init__(*parts)
        self.buffer, self.start, self.shut_down = 4096, 0, False

    def encode(self, text: str) -> str:
        return text + "\x03"

    def power_cycle(self) -> None:
        self.start, self.shut_down = 0, False
        super().power_cycle()

    def answer(self, text: str) -> str | None:
        try:
            request = json.loads(text)
            number, method, script = request["id"], request["method"], request.get("params", {}).get("script", "")
        except (ValueError, KeyError, TypeError, AttributeError):
            return None
        yes = f'{{"id":{number},"result":{{}}}}'
        no = f'{{"id":{number},"error":{{"error":"WebRequestError","message":"'
        if method == "objects/query":
            return f'{{"id":{number},"result":{json.dumps(self.report(), separators=(",", ":"))}}}'
        if method == "emergency_stop":
            self.shut_down = True
            self.stop(yes)
            self.machine.axes.freeze(self.now)  # no more steps at once, without a ramp
            return yes
        if script == "FIRMWARE_RESTART" and not self.machine.deaf:
            self.power_cycle()
            return yes
        if script.startswith("SET_GCODE_VARIABLE"):
            self.start = int(script.rpartition("=")[2])
            return yes
        if self.shut_down or self.fault:
            return no + 'Shutdown"}}'
        if script == "RIG_HOME":
            return self.home(yes, no)
        words = {word[0]: float(word[1:]) for word in script.split()[2:]}
        target = 1e-3 * np.array([words[axis] for axis in "XYZABC"])
        way = target - self.positions
        length = np.linalg.norm(way[:3]) if np.abs(way[:3]).max() > 1e-7 else np.abs(way[3:]).max()
        answer = self.move(target, 60e3 * length / words["F"], yes, no)
        return answer + '"}}' if answer and answer.startswith(no) else answer

    def report(self) -> dict:
        x, y, z, a, b, c = 1e3 * self.positions
        homed = 0 if self.shut_down else -1 if self.activity == "homing" else int(self.homed)
        return {
            "eventtime": self.now,
            "status": {
                "webhooks": {"state": "shutdown" if self.shut_down or self.fault else "ready"},
                "motion_report": {"live_position": [x, y, z, 0.0, a, b, c]},
                "toolhead": {"print_time": 2.0 * (self.activity == "moving"), "estimated_print_time": 1.0},
                "gcode_macro RIG": {"homed": homed, "start": self.start},
            },
        }
