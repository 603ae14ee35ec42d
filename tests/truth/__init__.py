"""A truth of its own: machines, plans, faults and recordings by a second writer, which shares no code with what it
judges.

    case = draw(seed, effect="backlash", strength="strong", plan="ladders", kind="hexapod")   # all of it drawn from a
                                                            seed
    record(case, folder)                        # the recording folder as an owner would hand it over; new each time
    record(recorded_anew(case), other)                 # the same machine recorded a second time
    poses = wanted(case)                        # (n, 4, 4) fresh poses within what was recorded; write_wanted(poses,
                                                path) for `correct`
    real = drive(case, values)                  # (n, 4, 4) where the machine really goes when commanded to values (n,
                                                axes), in time
    real = drive_in_time(case, t, values, looked)    # the same for commands with times, from the day's beginning;
                                                     write_sensors for its log
    rms(errors(real, poses))                    # (position m, rotation rad)

Effects are the names of FAULTS, and of SIGHTS, which cameras see (corners.csv in place of poses.csv; seen=True for
others too), each with several laws of the same physics; strengths "none", "weak" (one to two standard deviations of the
instrument), "strong" (ten to fifty, as far as such things go). Only numpy and scipy are imported here; a test holds
that.
"""

from tests.truth.case import STRENGTHS, Case, draw, drive, drive_in_time, recorded_anew, wanted
from tests.truth.draw_faults import FAULTS
from tests.truth.draw_machines import KINDS
from tests.truth.journey import PLANS
from tests.truth.rigid import errors, matrices, rms, rows_of
from tests.truth.sights import SIGHTS
from tests.truth.written import record, write_sensors, write_wanted

__all__ = [
    "FAULTS",
    "KINDS",
    "PLANS",
    "SIGHTS",
    "STRENGTHS",
    "Case",
    "recorded_anew",
    "draw",
    "drive",
    "drive_in_time",
    "errors",
    "matrices",
    "record",
    "rms",
    "rows_of",
    "wanted",
    "write_sensors",
    "write_wanted",
]
