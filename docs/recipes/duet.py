"""Six struts by a Duet with RepRapFirmware 3.5 and the macros of the recipe: axes X Y Z U V W. Not tried on real
hardware.
"""

import secrets

import numpy as np

from rig.driving.base import Dialogue, LineEmulator, LineProtocol, Segment, State, Verdict


class Duet(LineProtocol):
    """Macros answer by a line with the number that they were given; positions in millimetres."""

    name, longest = "duet", 128
    urgent_stop = b"M112\n"
    accepted, refused = r"rig # result 0|rig # \d+ \w+ .*", r"rig # (result [12])"
    home_line, stop_line = 'M98 P"righome.g" K#', 'M112\nM98 P"rig.g" K#'
    answer = r"rig # (\d+) (\w+) (\d) (-?\d+\.?\d*)((?: (?:true|false) -?\d{1,4}\.\d{3}){6})"

    def identity(self) -> Dialogue[tuple[str, str]]:
        start = (yield from self.ask('M98 P"rig.g" K#', self.answer))[1]
        if start == "0":  # it has started: the macros' variables are as in config.g
            start = str(1 + secrets.randbelow(10**6))
            yield from self.ask(f'M98 P"rig.g" K# S{start}', rf"rig # {start} .*")
        return "Duet", start

    def state(self) -> Dialogue[State]:
        _, said, homing, speed, axes = (yield from self.ask('M98 P"rig.g" K#', self.answer)).groups()
        words = axes.split()
        fault = said if said in ("halted", "off") else ""
        activity = "alarm" if fault else "homing" if homing != "0" else "moving" if float(speed) else "idle"
        return State(activity, 1e-3 * np.array(words[1::2], float), "false" not in words[::2], fault, said)

    def move_line(self, segment: Segment) -> str:
        words = " ".join(f"{axis}{value:.3f}" for axis, value in zip("XYZUVW", 1e3 * segment.target))
        return f'M98 P"rigmove.g" K# F{60 / max(segment.duration, 1e-2):.5f} {words} L1'

    def unlock(self) -> Dialogue[Verdict]:
        yield from self.command("M999")  # which restarts it, without an answer
        return Verdict(True)


class DuetEmulator(LineEmulator):
    """The board's side: its macros, without their G-code."""

    protocol = Duet

    def __init__(self, *parts) -> None:
        super().__init__(*parts)
        self.start, self.halted = "0", False

    def power_cycle(self) -> None:
        self.start, self.halted = "0", False
        super().power_cycle()

    def answer(self, text: str) -> str | None:
        code, *words = text.split()
        if code == "M112":
            self.halted = True
            self.stop("")
            self.machine.axes.freeze(self.now)  # no more steps at once, without a ramp
        if code == "M999" and not self.machine.deaf:
            self.power_cycle()
        if code != "M98" or len(words) < 2:
            return None
        try:
            given = {word[0]: float(word[1:]) for word in words[1:]}
            number = f"rig {given['K']:.0f}"
        except (ValueError, KeyError):
            return None
        if words[0] == 'P"rig.g"':
            self.start = f"{given['S']:.0f}" if "S" in given else self.start
            return f"{number} {self.report()}"
        yes, no = f"{number} result 0", f"{number} result 2"
        if self.halted or not (words[0] == 'P"righome.g"' or "L" in given):
            return no
        if words[0] == 'P"righome.g"':
            return self.home(yes, no)
        answer = self.move([1e-3 * given[axis] for axis in "XYZUVW"], 60 / given["F"], yes, no)
        return no if answer and answer.startswith(no) else answer

    def report(self) -> str:
        said = "halted" if self.halted or self.fault else "idle"
        homed = str(self.homed and not self.halted).lower()
        axes = " ".join(f"{homed} {1e3 * position:.3f}" for position in self.positions)
        return f"{self.start} {said} {self.activity == 'homing':d} {25.0 * (self.activity == 'moving')} {axes}"
