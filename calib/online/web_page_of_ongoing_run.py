"""Live page of a run.

Verdict, figures in mm and mrad, camera images and the rig in 3-D while a run lasts.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.online.live_learner_limb_watch_run_state_and_display import MeasuredFrame, RunState
from calib.online.observer_of_run_frames import RunObserver
from calib.report.pose_and_effect_figures import (
    closed_outline_sorted_by_angle,
    drawn_lines_of_base_targets_and_camera_sights,
)
from rig.array_and_json_types import Floats, Integers, Json
from rig.driving.axis_display_units_and_controller_counts import SHOWN
from rig.driving.move_and_record_loop import RecordedFrame
from rig.model.design import Camera, Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import is_hexapod
from rig.model.pose import pose_to_vector, transform_points
from rig.report.pages.run_page_server import PageServer
from rig.report.verdict_refutations_and_result_display import Evidence, MissingEvidence, Verdict, judge_evidence
from vision.marker_corner_prediction import MarkerMap, marker_map
from vision.measured_frame_drawings_and_frame_jpegs import encode_jpeg_reduced_to_page_width

OFF = 3.0  # standard uncertainties, RMS over the axes that were measured: beyond it one pose is off by more than chance
CALIBRATE = (
    "Calibrate once the run is over: `rig calibrate REC --out calibration.json`, or begin with `--calibration FILE`"
)


def run_verdict(state: RunState) -> Verdict:
    """Verdict on a run so far, from its RunState.

    Alarms, early end, deviation of the last pose.
    """
    refuted = (f"it ended prematurely: {state.ended}",) if state.ended else ()
    alarms = tuple(MissingEvidence(f"{alarm.kind}: {alarm.text}") for alarm in state.alarms)
    off = math.nan if state.seen is None else _pose_deviation_in_sigmas(state.seen)
    unexplained = (f"the last pose is {off:.3g} times its own uncertainty from the prediction",) if off > OFF else ()
    return judge_evidence(
        Evidence(state.phase, missing=alarms, unexplained=unexplained, refuted=refuted, look=CALIBRATE)
    )


def _pose_deviation_in_sigmas(seen: MeasuredFrame) -> float:
    """By how many of its own standard uncertainties a pose is off what was expected, RMS over the axes; NaN where that
    is not known.
    """
    if seen.learnt is None or seen.sight.covariance is None:
        return math.nan
    sigma = np.sqrt(np.diag(seen.sight.covariance))
    known = np.isfinite(sigma) & (sigma > 0)
    return float(np.sqrt(np.mean((seen.learnt.error[known] / sigma[known]) ** 2))) if known.any() else math.nan


LATEST = 400  # frames whose figures are shown


class RunPage:
    """Page that serves the RunState of a RunObserver: a RunDisplay, open while it is a context."""

    def __init__(self, looking: RunObserver, port: int) -> None:
        self._design = looking.design
        self._server = PageServer(lambda: looking.ask_stop("stopped from the page"), port, looking.answer)
        self.url = self._server.url
        self._history: list[Json] = []
        self._shown: MeasuredFrame | None = None
        self._pictured: RecordedFrame | None = None
        self._markers = marker_map(self._design.without_stages()) if self._design.targets else None
        self._fixed = drawn_lines_of_base_targets_and_camera_sights(self._design, self._markers)

    def __enter__(self) -> "RunPage":
        return self

    def __exit__(self, *_: object) -> None:
        self._server.close()

    def show(self, state: RunState) -> None:
        """Have the page show a RunState."""
        images: dict[str, Callable[[], bytes]] | None = None
        if state.seen is not None and state.seen is not self._shown:
            self._shown = state.seen
            self._history = [*self._history[1 - LATEST :], _figures(state.seen)]
            images = _jpegs(state.seen.shot)
        elif state.seen is None and state.shot is not None and state.shot is not self._pictured:
            self._pictured, images = state.shot, _jpegs(state.shot)
        self._server.show(partial(self._event, state, self._history), images)

    def close(self) -> None:
        """The run is over; the page stays until the context ends."""

    def _event(self, state: RunState, history: list[Json]) -> Json:
        struts = [
            {
                "low": low * SHOWN[unit][0],
                "high": high * SHOWN[unit][0],
                "at": at * SHOWN[unit][0],
                "goal": goal * SHOWN[unit][0],
                "room": min(at - low, high - at) * SHOWN[unit][0],
                "unit": SHOWN[unit][1],
            }
            for (_, unit), (low, high), at, goal in zip(
                state.places_and_units, state.ranges.tolist(), state.lengths.tolist(), state.goal.tolist()
            )
        ]
        T = state.seen.sight.T_base_platform if state.seen is not None else None
        return {
            "verdict": run_verdict(state).tree(),
            "activity": state.activity,
            "then": state.then,
            "events": [{"t": t, "text": text} for t, text in state.events],
            "readings": [{"name": name, "value": value} for name, value in state.readings.items()],
            "pictures": None if state.shot is None or state.seen is not None else _pictures(state.shot, self._design),
            "phase": state.phase,
            "frame": state.frame,
            "frames": state.frames,
            "step": state.step,
            "steps": state.steps,
            "left": state.left if np.isfinite(state.left) else 0.0,
            "ended": state.ended,
            "struts": struts,
            "history": history,
            "question": None if state.question is None else dict(zip(("frame", "text"), state.question)),
            "alarms": [{"kind": alarm.kind, "text": alarm.text} for alarm in state.alarms],
            "seen": None if state.seen is None else _seen(state.seen, self._design, self._markers),
            "rig": _rig(self._design, self._fixed, self._markers, T),
        }


def _jpegs(shot: RecordedFrame) -> dict[str, Callable[[], bytes]]:
    """{camera: makes its JPEG}."""
    return {name: partial(encode_jpeg_reduced_to_page_width, frame.image) for name, frame in shot.frames.items()}


def _pictures(shot: RecordedFrame, design: Design) -> Json:
    """Cameras of a frame that is not measured."""
    sizes = {camera.name: (camera.width, camera.height) for camera in design.cameras}
    return {
        "frame": shot.number,
        "cameras": [{"name": name, "width": sizes[name][0], "height": sizes[name][1]} for name in shot.frames],
    }


def _figures(seen: MeasuredFrame) -> Json:
    """What charts show of a frame."""
    rms = float(np.sqrt(np.mean(np.square(list(seen.rms.values()))))) if seen.rms else None
    learnt = seen.learnt
    return {
        "frame": seen.sight.frame,
        "rms": rms,
        "error": None if learnt is None else float(np.linalg.norm(learnt.error[:3]) * 1e6),
        "innovation": None if learnt is None else learnt.innovation,
    }


def _seen(seen: MeasuredFrame, design: Design, markers: MarkerMap | None) -> Json:
    ids = np.zeros(0, int) if markers is None else markers.id
    sight, learnt, T = seen.sight, seen.learnt, seen.sight.T_base_platform

    def scaled(values: Floats, scale: float) -> list[float]:
        return (np.asarray(values) * scale).tolist()

    return {
        "frame": sight.frame,
        "reason": sight.reason,
        "delay": seen.delay,
        "pose": None if T is None else scaled(pose_to_vector(T), 1e3),
        "sigma": None if sight.covariance is None else scaled(np.sqrt(np.diag(sight.covariance)), 1e6),
        "error": None if learnt is None else scaled(learnt.error, 1e6),
        "innovation": None if learnt is None else learnt.innovation,
        "cameras": [
            _camera(seen, i, camera, ids) for i, camera in enumerate(design.cameras) if camera.name in sight.detections
        ],
    }


def _camera(seen: MeasuredFrame, i: int, camera: Camera, ids: Integers) -> Json:
    """What one camera saw. ids : identity of each row of the marker map"""
    sight, detection = seen.sight, seen.sight.detections[camera.name]
    o = sight.observations
    rows = np.flatnonzero(o.camera == i)
    aside = set(ids[o.marker[rows[~sight.inliers[rows]]]].tolist())
    solved = rows[np.isfinite(sight.residuals[rows, 0])]
    return {
        "name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "read": len(detection.marker),
        "expected": len(sight.expected.get(camera.name, detection.marker)),
        "rms": seen.rms.get(camera.name),
        "blur": seen.blur.get(camera.name),
        "quads": [
            [int(number), number not in aside, *np.round(quad.ravel(), 2).tolist()]
            for number, quad in zip(detection.marker.tolist(), detection.corners)
        ],
        "arrows": np.round(np.hstack([o.uv[solved], sight.residuals[solved]]), 4).tolist(),
    }


def _rig(design: Design, fixed: list[Json], markers: MarkerMap | None, T: RigidTransform | None) -> Json:
    """The rig as lines at a pose of the platform, at home before one is known."""
    m, parts = design.mechanism, list(fixed)
    middle = [0.0, 0.0, 0.0]
    if is_hexapod(m):
        T = m.home if T is None else T
        top = T.apply(m.platform_joints)
        parts += [
            {"kind": "strut", "name": str(k), "points": [low.tolist(), high.tolist()]}
            for k, (low, high) in enumerate(zip(m.base_joints, top), 1)
        ]
        parts += [
            {"kind": "plate", "points": around}
            for around in (closed_outline_sorted_by_angle(m.base_joints), closed_outline_sorted_by_angle(top))
        ]
        middle = (m.home.translation / 2).tolist()
    if markers is not None and T is not None:
        corners = transform_points(T, markers.corners[markers.on_platform].reshape(-1, 3))
        parts += [{"kind": "face", "points": quad.tolist()} for quad in corners.reshape(-1, 4, 3)]
    size = max([float(np.linalg.norm(camera.pose.translation)) for camera in design.cameras] or [1.0])
    return {"parts": parts, "middle": middle, "size": size}
