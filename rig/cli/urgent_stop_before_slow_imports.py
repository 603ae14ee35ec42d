"""Urgent stop of `rig stop`, begun before slow imports.

The controller is sent its urgent stop, or the process that drives it is asked to end.
It imports nothing that takes time. The command itself follows, and reports what went wrong here.
"""

from __future__ import annotations

import os
from contextlib import contextmanager, suppress

TYPE_CHECKING = False  # typing would take time
if TYPE_CHECKING:
    from collections.abc import Iterator

    from rig.driving.controller_address_and_urgent_stop import UrgentStop
    from rig.errors import RigError


def begin_urgent_stop_or_return_error(words: list[str]) -> UrgentStop | RigError | OSError | KeyboardInterrupt | None:
    """Begin the urgent stop that the words after `rig stop` command; return it, or the error that it met.

    The error is to be raised by the command; None where the words or the rig.toml cannot be
    understood here, and nothing was done
    """
    with real_time_priority():
        from rig.driving.controller_address_and_urgent_stop import UrgentStop, controller_address_in_rig_toml
        from rig.driving.driving_clock import SystemClock
        from rig.errors import RigError

        stated = rig_toml_and_port_in_stop_words(words)
        address = None if stated is None else controller_address_in_rig_toml(*stated)
        try:
            return None if address is None else UrgentStop(address, SystemClock())
        except (RigError, OSError, KeyboardInterrupt) as error:
            return error


def rig_toml_and_port_in_stop_words(words: list[str]) -> tuple[str, str | None] | None:
    """(RIG.toml, --port or None) of the words after `rig stop`; None for words that only its parser understands."""
    paths: list[str] = []
    port, remaining = None, iter(words)
    for word in remaining:
        name, has_value, value = word.partition("=")
        if name in ("--port", "--trace"):
            value = value if has_value else next(remaining, "-")
            if value.startswith("-"):
                return None
            port = value if name == "--port" else port
        elif not word.startswith("-"):
            paths.append(word)
        elif word != "--quiet":
            return None
    return (paths[0], port) if len(paths) == 1 else None


@contextmanager
def real_time_priority() -> Iterator[None]:
    """Real-time priority of this thread within the context (context manager).

    This thread then comes before all processes without real time, on Linux and where the system permits it.
    It permits it to root. Elsewhere nothing changes: a busy computer merely takes longer. A nice value would not do:
    it counts within a session alone where the system groups processes by session.
    """
    before = None
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):  # not permitted, or not there: a stop does without
            before = os.sched_getscheduler(0), os.sched_getparam(0)
            lowest = os.sched_param(os.sched_get_priority_min(os.SCHED_RR))
            os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, lowest)  # threads do not inherit it
    try:
        yield
    finally:
        if before is not None:
            with suppress(OSError):
                os.sched_setscheduler(0, *before)
