"""State of a run as displays show it: how far it is, the latest frame and pose, alarms and events."""

from dataclasses import dataclass, field
from typing import Protocol, TypedDict

from calib.online.live_learner_and_limb_agreement import Learnt
from rig.array_and_json_types import Floats
from rig.driving.move_and_record_loop import RecordedFrame
from rig.driving.run_journal import Arrival, Departure, Ended, Exposed, PositionUnknown, Remark, Resumed, Row
from vision.reading.camera_and_marker_alarms import Alarm
from vision.reading.live_measurement import Sight


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredFrame:
    """A frame that was measured. delay : s from the end of its exposure to its pose; learnt : what the learner made of
    it, or None
    blur : {camera: px, width of the markers' edges}, a figure of focus; rms : px of its corners, {camera: px}."""

    shot: RecordedFrame
    sight: Sight
    learnt: Learnt | None
    delay: float
    rms: dict[str, float]
    blur: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class RunState:
    """What displays show. phase : in words; frame, frames, step, steps : how far; left : s; lengths, goal : (axes,) m
    ranges : (axes, 2) m; alarms : the latest; seen : the latest Seen, None before the first;
        frames is 0 where nobody knows how many there will be; ended : why, None while it goes
    activity : "starting", "moving", "holding" (the struts are to rest) or "ended"; then : what comes next, in words
    events : the latest (s, in words); readings : {channel: value} of the sensors; shot : the latest frame, measured or
        not, None before the first
    """

    phase: str
    frame: int
    frames: int
    step: int
    steps: int
    left: float
    lengths: Floats
    goal: Floats
    ranges: Floats
    alarms: tuple[Alarm, ...]
    seen: MeasuredFrame | None
    ended: str | None
    activity: str = "starting"
    then: str = ""
    events: tuple[tuple[float, str], ...] = ()
    readings: dict[str, float] = field(default_factory=dict)
    shot: RecordedFrame | None = None


class RunStateChanges(TypedDict, total=False):
    """Fields of a RunState that have changed."""

    phase: str
    frame: int
    frames: int
    step: int
    steps: int
    left: float
    lengths: Floats
    goal: Floats
    ranges: Floats
    alarms: tuple[Alarm, ...]
    seen: MeasuredFrame | None
    ended: str | None
    activity: str
    then: str
    events: tuple[tuple[float, str], ...]
    readings: dict[str, float]
    shot: RecordedFrame | None


def journal_row_in_words(row: Row) -> str:
    """A row for the log of a display; "" for what is no event."""
    if isinstance(row, Departure):
        far = max(abs(goal - start) for goal, start in zip(row.goal, row.start))
        return f"to step {row.step + 1}, {far * 1e3:.1f} mm"
    if isinstance(row, Arrival):
        return f"at step {row.step + 1}" if row.reached else f"not at step {row.step + 1}"
    if isinstance(row, Exposed):
        return f"frame {row.frame}" + (" in motion" if row.times else "")
    if isinstance(row, Resumed):
        return f"resumed: {row.found}"
    if isinstance(row, Remark):
        return row.text
    if isinstance(row, PositionUnknown):
        return f"the position is not known: {row.reason}"
    if isinstance(row, Ended):
        return f"ended: {row.reason}" if row.reason else "done"
    return ""


class RunDisplay(Protocol):
    """Something that shows a run."""

    def show(self, state: RunState) -> None:
        """The run as it stands now."""

    def close(self) -> None:
        """The run is over."""
