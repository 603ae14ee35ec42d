"""A wire whose far end follows a script: what is sent must be what the script says, and it answers with what the script
says.
"""

from rig.driving.request_and_answer_exchange_with_controller import Link
from rig.errors import LinkLost


class ScriptedPort:
    """A Port. script : pairs of bytes, sent and answered; None for an
    answer: the connection is lost.
    """

    def __init__(self, script, clock):
        self.script, self.clock = list(script), clock
        self.pending = b""

    def write(self, data):
        assert self.script, f"nothing more was to be sent, and {data!r} was"
        sent, answer = self.script.pop(0)
        assert data == sent, f"expected {sent!r} to be sent, got {data!r}"
        if answer is None:
            raise LinkLost("pulled")
        self.pending += answer

    def read(self, until):
        data, self.pending = self.pending, b""
        if not data:
            self.clock.sleep(until - self.clock.now())
        return data

    def close(self):
        pass


def talk(protocol, script, clock, what=None):
    """What a protocol's greeting returns, or what is said after it, with all of a script said."""
    port = ScriptedPort(script, clock)
    link = Link(protocol, lambda: port, clock)
    link.connect(0)
    done = link.run(protocol.hello())
    done = done if what is None else link.run(what(protocol))
    assert port.script == []
    return done
