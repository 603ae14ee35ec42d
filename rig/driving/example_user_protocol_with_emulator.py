"""A six-axis controller that answers numbered lines, as over TCP: its protocol, and a small emulator to try it with."""

import numpy as np

from rig.driving.base import Dialogue, LineEmulator, LineProtocol, Segment, State


class Acme(LineProtocol):
    """Lines `NUMBER WORD ..`, answered by `NUMBER ..`; positions in nanometres."""

    name = "acme"
    urgent_stop = b"!"
    accepted, refused = r"# OK", r"# NO (.*)"
    home_line, stop_line, unlock_line = "# HOME", "# STOP", "# CLEAR"
    longest = 96

    def identity(self) -> Dialogue[tuple[str, str]]:
        found = yield from self.ask("# WHO", r"# (\w+) start (\d+)")
        return found[1], found[2]

    def state(self) -> Dialogue[State]:
        found = yield from self.ask("# POS", r"# (idle|moving|homing|alarm) ([01]) (\S+)((?: -?\d{1,10}){6})")
        fault = "" if found[3] == "ok" else found[3]
        return State(found[1], np.array(found[4].split(), float) / 1e9, found[2] == "1", fault, found[0])

    def move_line(self, segment: Segment) -> str:
        nm = " ".join(f"{position:.0f}" for position in 1e9 * segment.target)
        return f"# GO {1e3 * segment.duration:.0f} {nm}"


class AcmeEmulator(LineEmulator):
    """The controller's side: each line is answered, and carried out by the emulated axes."""

    protocol, stop_byte = Acme, b"!"

    def answer(self, text: str) -> str | None:
        number, word, *rest = f"{text} -".split()
        yes, no = f"{number} OK", f"{number} NO"
        if word == "WHO":
            return f"{number} Acme start {self.start_number}"
        if word == "POS":
            nm = " ".join(f"{position:.0f}" for position in 1e9 * self.positions)
            return f"{number} {self.activity} {self.homed:d} {self.fault or 'ok'} {nm}"
        if word == "GO":
            try:
                milliseconds, *target = map(float, rest[:-1])
            except ValueError:
                return f"{no} these are no numbers"
            return self.move(1e-9 * np.array(target), milliseconds / 1e3, yes, no)
        if word == "HOME":
            return self.home(yes, no)
        if word == "STOP":
            return self.stop(yes)
        return self.unlock(yes, no) if word == "CLEAR" else f"{no} unknown"
