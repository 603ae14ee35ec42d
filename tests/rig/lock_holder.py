"""The process that holds a controller's lock, stopped as `rig stop` does it."""

from rig.driving.controller_lock_and_stop_of_its_holder import ask_lock_holder_to_end, await_or_kill_lock_holder
from rig.driving.driving_clock import SystemClock


def stop_lock_holder(port, timeout):
    """Its number once it has ended, killed after `timeout` (s) where it has not; None where nobody drives."""
    holder = ask_lock_holder_to_end(port)
    if holder is not None:
        await_or_kill_lock_holder(holder, port, SystemClock(), timeout)
    return None if holder is None else holder.pid
