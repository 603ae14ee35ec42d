"""Exposures in motion: frames taken during one move."""

import threading
from bisect import bisect_left
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import TracebackType

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import (
    CameraError,
    Frame,
    SynchronisedCameras,
)
from rig.driving.controller_status_and_limits import PositionReport
from rig.driving.driving_clock import Clock
from rig.driving.run_journal import PositionReports
from rig.errors import RigError
from rig.recording.exposures_and_image_files import ONE_FRAME

ACCIDENTS = 4  # frames in a row
LOOK = 0.005  # s between looks at whether the move is over, and whether a report has come


class FramesDuringMove:
    """Context manager about a move: a thread of its own takes frames until the move is over.

    shutter : all cameras; interval : s from one exposure to the next, at least
    keep : takes ({camera: Frame}, reports that it was not given before), from that thread; halt : stops the axes
    remark : takes a line on a frame that was not kept
    reports : PositionReports of the move so far
    Leaving it raises what taking or keeping a frame raised; that stops the axes at once.
    """

    def __init__(
        self,
        shutter: SynchronisedCameras,
        clock: Clock,
        interval: float,
        keep: Callable[[dict[str, Frame], list[PositionReport]], None],
        halt: Callable[[], object],
        remark: Callable[[str], None],
    ) -> None:
        self.reports: list[PositionReport] = []
        self._shutter, self._clock, self._interval, self._keep, self._halt = shutter, clock, interval, keep, halt
        self._remark, self._written, self._apart = remark, 0, 0
        self._over, self._failed = threading.Event(), False
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._expose, daemon=True)

    def __enter__(self) -> "FramesDuringMove":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._failed = error is not None
        self._over.set()
        self._thread.join()
        if self._error is not None and self._error is not error:
            raise self._error from error

    def require_no_failure(self) -> None:
        """Raise what taking or keeping a frame raised."""
        if self._error is not None:
            raise self._error

    def report(self, report: PositionReport) -> None:
        """Take a position that the controller reported."""
        self.reports.append(report)

    def unwritten(self) -> list[PositionReport]:
        """Reports that were not handed out before."""
        reports = self.reports[self._written :]
        self._written += len(reports)
        return reports

    def _expose(self) -> None:
        try:
            due = self._clock.now()
            while not self._over.is_set():
                if self._clock.now() < due:
                    self._clock.sleep(LOOK)
                    continue
                due = self._clock.now() + self._interval
                frames = self._shutter.grab()
                if self._are_one_frame(frames) and self._is_covered(max(frame.t for frame in frames.values())):
                    self._keep(frames, self.unwritten())
        except BaseException as error:  # whatever it is ends the move, and the run with it
            self._error = error
            with suppress(RigError):  # the run stops them again as it ends, and says where that fails
                self._halt()

    def _are_one_frame(self, frames: dict[str, Frame]) -> bool:
        """Whether cameras exposed within the time that a frame may take. Raises CameraError where they did not so often
        in a row that it is no accident.
        """
        first, *others = frames.items()
        late = {name: frame.t - first[1].t for name, frame in others if abs(frame.t - first[1].t) > ONE_FRAME}
        self._apart = self._apart + 1 if late else 0
        if not late:
            return True
        text = ", ".join(f"{name} {seconds:+.3f} s" for name, seconds in late.items())
        text = f"exposed more than {ONE_FRAME:g} s from {first[0]}: {text}"
        if self._apart >= ACCIDENTS:
            raise CameraError(f"{ACCIDENTS} frames in a row, {text}; such cameras cannot expose in motion together")
        self._remark(f"a frame was discarded, as cameras {text}")
        return False

    def _is_covered(self, t: float) -> bool:
        """Whether it is known where the axes were at t (s): by a later report, which is waited for, or as they stand
        at the goal. Nobody knows it of a frame after the last report of a move that failed.
        """
        while not (self.reports and self.reports[-1].requested >= t):
            if self._over.is_set():
                return not self._failed
            self._clock.sleep(LOOK)
        return True


def interpolated_reported_strut_lengths(reports: Sequence[PositionReport], t: float, start_lengths: Floats) -> Floats:
    """Strut lengths (n,) m at time t s, interpolated between the position reports about it.

    reports : in the order of their times; another thread may append to them meanwhile
    """
    after = bisect_left(reports, t, hi=len(reports), key=lambda report: report.t)
    near = tuple(reports[max(after - 1, 0) : after + 1])
    if not near:
        return start_lengths
    times = [report.t for report in near]
    return np.array([np.interp(t, times, column) for column in np.array([report.lengths for report in near]).T])


def journal_row_of_position_reports(t: float, reports: Sequence[PositionReport], origin: float) -> PositionReports:
    """Journal row, written at t (s), of the controller's position reports, timed from the origin (s)."""
    return PositionReports(
        t,
        tuple(report.t - origin for report in reports),
        tuple(report.answered - report.requested for report in reports),
        tuple(tuple(report.lengths.tolist()) for report in reports),
    )
