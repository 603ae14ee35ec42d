"""The verdict on a run that goes on: ended before its end, alarms, poses that are off what was expected by more than
measuring them allows.
"""

import math

import numpy as np

from rig.cli.shared.run_observation import Seen, View
from rig.report.verdict import Evidence, Missing, Verdict, judge_evidence

OFF = 3.0  # standard uncertainties, RMS over the axes that were measured: beyond it one pose is off by more than chance
CALIBRATE = (
    "Calibrate once the run is over: `rig calibrate REC --out calibration.json`, or begin with `--calibration FILE`"
)


def run_verdict(view: View) -> Verdict:
    """The Verdict on a View."""
    refuted = (f"it ended before its end: {view.ended}",) if view.ended else ()
    alarms = tuple(Missing(f"{alarm.kind}: {alarm.text}") for alarm in view.alarms)
    off = math.nan if view.seen is None else pose_deviation_in_sigmas(view.seen)
    unexplained = (f"the last pose is {off:.3g} times its own uncertainty off what was expected",) if off > OFF else ()
    return judge_evidence(
        Evidence(view.phase, missing=alarms, unexplained=unexplained, refuted=refuted, look=CALIBRATE)
    )


def pose_deviation_in_sigmas(seen: Seen) -> float:
    """By how many of its own standard uncertainties a pose is off what was expected, RMS over the axes; NaN where that
    is not known.
    """
    if seen.learnt is None or seen.sight.covariance is None:
        return math.nan
    sigma = np.sqrt(np.diag(seen.sight.covariance))
    known = np.isfinite(sigma) & (sigma > 0)
    return float(np.sqrt(np.mean((seen.learnt.error[known] / sigma[known]) ** 2))) if known.any() else math.nan
