"""Who looks on at a run: alarms are said, noted and can stop it; displays show every frame; a terminal's text fits what
happened.
"""

import io
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from calib.certification import measuring_limb_calibration_slips_and_vision_agreement
from calib.online.accepted_measuring_limbs_file import Accepted
from calib.online.live_learner_limb_watch_run_state_and_display import Learner
from calib.online.measuring_limb_poses_checked_by_vision import LiveLimbPoses
from calib.online.observer_of_run_frames import RunObserver, RunStop
from calib.online.run_options_cameras_sensors_and_observer import compile_kernels_for_run
from calib.online.web_page_of_ongoing_run import RunPage, run_verdict
from rig.cli.shared.terminal_run_display_and_printed_controller_status import (
    PlainLineDisplay,
    TerminalBlockDisplay,
    run_state_lines,
)
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import Frame
from rig.driving.driving_clock import SimulatedClock
from rig.driving.move_and_record_loop import RecordedFrame
from rig.driving.run_journal import Arrival, Departure, Ended, Exposed, Readings, Remark
from rig.driving.run_steps_from_plan_and_progress_from_journal import steps_of_plan
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import hexapod
from rig.model.pose import exp
from rig.planning.configuration_generators import sobol_configurations
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.planning.recording_plan import build_plan
from tests.vision.reading.test_moved_camera_and_covered_marker_alarms import sight
from vision.reading.live_measurement_and_corner_refit import Live, sight_from_measuring_limbs
from vision.reading.parallel_image_map_rendered_markers_and_white_level import render_marker_images


class Measured:
    """In place of Live: sights as they are made here; from frame 3 on cam1 has moved by a pixel."""

    noise = 0.02

    def __init__(self, design):
        self.design, self.rng = design, np.random.default_rng(3)
        self.ids = {
            body: [n for target in design.targets if target.body == body for n in target.ids]
            for body in ("base", "platform")
        }

    def take(self, frame, images, expected):
        found = sight(self.design, self.ids, frame, self.rng, shift=(1.0 * (frame >= 3), 0.0))
        n = len(found.residuals)
        found.observations.uv = np.zeros((n, 2))
        found.observations.marker = np.unique(found.observations.marker, return_inverse=True)[1]
        for detection in found.detections.values():
            detection.blur, detection.corners = np.full(10, 0.7), np.zeros((10, 4, 2))
        return found

    def adjust(self):
        return None

    def close(self):
        pass


class Shown:
    def __init__(self):
        self.views, self.closed = [], False

    def show(self, state):
        self.views.append(state)

    def close(self):
        self.closed = True


def looked(design, stop_on, displays=()):
    """A Looking that has seen six frames, its halts and its notes."""
    clock, halts, notes = SimulatedClock(), [], []
    planned = steps_of_plan(build_plan(design, "sobol:6"))
    looking = RunObserver(
        design,
        planned,
        planned[0].goal,
        clock,
        Measured(design),
        None,
        RunStop(stop_on, lambda: halts.append(threading.current_thread())),
    )
    looking.displays += displays
    looking.note = notes.append
    for frame in range(6):
        clock.sleep(2.0)
        goal = planned[frame + 1].goal
        looking.happened(Departure(clock.now(), frame + 1, tuple(goal), tuple(goal)))
        looking.happened(Exposed(clock.now(), frame + 1, frame, (0.0,), ("cam0",), ("a.png",)))
        looking.seen(
            RecordedFrame(
                frame,
                frame + 1,
                clock.now(),
                goal,
                {c.name: Frame(np.zeros((48, 64), np.uint8), clock.now(), 1e-3) for c in design.cameras},
            )
        )
    looking.finish()
    return looking, halts, notes


@pytest.mark.parametrize("stops", [True, False])
def test_a_moved_camera_is_said_noted_and_stops_where_that_was_asked_for(design, stops):
    shown = Shown()
    looking, halts, notes = looked(design, frozenset(["camera"] if stops else ["jump"]), [shown])
    assert (
        [alarm.kind for alarm in looking.state.alarms] == ["camera"]
        and "camera 'cam1' has moved" in notes[0]
        and len(notes) == 1
    )
    assert bool(looking.stop()) == stops and len(halts) == stops
    assert shown.closed and {state.seen.sight.frame for state in shown.views if state.seen} == set(range(6))
    assert shown.views[-1].frame == 6 and 0 < max(state.left for state in shown.views if state.left == state.left) < 60


def test_a_run_says_what_it_does_what_is_next_and_what_happened(design):
    looking, _, _ = looked(design, frozenset())
    assert looking.state.activity == "moving" and looking.state.shot.number == 5
    assert looking.state.then.startswith("1 frame there, step 8 (") and looking.state.then.endswith(" mm)")
    goal = tuple(looking.state.goal)
    looking.happened(Arrival(20.0, 6, goal, True))
    assert looking.state.activity == "holding"
    looking.happened(Readings(21.0, ("ambient_temperature_C",), (21.5,)))
    looking.happened(Remark(22.0, "jump: strut 2"))
    looking.happened(Ended(23.0, "stopped from the page"))
    assert looking.state.readings == {"ambient_temperature_C": 21.5} and looking.state.activity == "ended"
    assert [text for _, text in looking.state.events[-4:]] == [
        "frame 5",
        "at step 7",
        "jump: strut 2",
        "ended: stopped from the page",
    ]


class Failing(Shown):
    def show(self, state):
        super().show(state)
        raise RuntimeError("too many open files")


def test_a_display_that_fails_costs_itself_alone_and_is_reported(design, capsys):
    shown, failing = Shown(), Failing()
    looking, halts, notes = looked(design, frozenset(), [failing, shown])
    assert len(failing.views) == 1 and shown.views[-1].frame == 6 and shown.closed and not halts and not looking.stop()
    assert (
        "Failing no longer shows the run, which continues: RuntimeError('too many open files')" in notes[0]
        and notes[0] in capsys.readouterr().err
    )


def test_a_display_that_fails_where_the_error_output_is_closed_does_not_end_the_run(design, monkeypatch):
    closed = io.StringIO()
    closed.close()
    monkeypatch.setattr(sys, "stderr", closed)
    shown = Shown()
    _, halts, notes = looked(design, frozenset(), [Failing(), shown])
    assert shown.views[-1].frame == 6 and shown.closed and not halts and "Failing no longer shows the run" in notes[0]


class TrueMeasurement:
    """In place of Live: vision's poses as they truly are, and which frames it looked at."""

    noise = 0.02

    def __init__(self, poses):
        self.poses, self.looked = poses, []

    def take(self, frame, images, expected):
        self.looked.append(frame)
        return sight_from_measuring_limbs(
            frame, self.poses[frame], np.diag(np.r_[np.full(3, 4e-6), np.full(3, 2e-5)] ** 2)
        )

    def adjust(self):
        return None

    def close(self):
        pass


def by_limbs(folder, slip, at):
    """(Looking that has seen 60 frames by limbs of which the fifth slips by `slip` m from a frame on, its Live, what
    was withdrawn)
    """
    (folder / "rig.toml").write_text(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, legs=(6, 6)))
    design = design_from_rig_toml.load_design(folder / "rig.toml")
    true, nominal, rng = (
        design.mechanism,
        measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(design),
        np.random.default_rng(5),
    )
    commands = sobol_configurations(true.strut_range, 60, 0.6)
    poses = hexapod.forward(commands, true)
    live = TrueMeasurement(poses * exp(np.r_[np.full(3, 4e-6), np.full(3, 2e-5)] * rng.normal(size=(60, 6))))
    clock, withdrawn, planned = SimulatedClock(), [], steps_of_plan(build_plan(design, "sobol:6"))
    agreement = measuring_limb_calibration_slips_and_vision_agreement.limb_agreement(
        poses, poses, np.zeros((60, 6, 6)), (1e-4, 1e-3)
    )
    accepted = Accepted(
        measuring_limb_calibration_slips_and_vision_agreement.Limbs(nominal, 1e-12 * np.eye(42), np.full(6, 1e-6)),
        nominal,
        agreement,
        None,
        {},
    )
    looking = RunObserver(
        design, planned, planned[0].goal, clock, live, Learner(true, shared=42), RunStop(frozenset(), lambda: None)
    )
    looking.source, looking.withdraw = (
        LiveLimbPoses(accepted, 10),
        lambda source, frame, reason: withdrawn.append((frame, reason)),
    )
    for frame, (command, read) in enumerate(zip(commands, hexapod.inverse(poses, nominal))):
        read = read + 1e-6 * rng.normal(size=6) - slip * (frame >= at) * np.eye(6)[4]
        looking.happened(Readings(clock.now(), tuple(f"m{i + 1}" for i in range(6)), tuple(read)))
        looking.seen(RecordedFrame(frame, frame, clock.now(), command, {}))
    looking.finish()
    return looking, live, withdrawn


def test_a_run_by_limbs_looks_at_few_poses_and_goes_on_by_vision_once_one_slips(tmp_path):
    looking, live, withdrawn = by_limbs(tmp_path, 0.0, 60)
    assert (
        not withdrawn
        and len(live.looked) < 20
        and {0, 10, 20, 30, 40, 50} <= set(live.looked)
        and not looking.state.alarms
    )
    looking, live, withdrawn = by_limbs(tmp_path, 3e-5, 33)
    ((frame, reason),) = withdrawn
    assert 33 <= frame < 38 and "limb 5 is longer by +" in reason
    assert [alarm.kind for alarm in looking.state.alarms] == ["limbs"], "and no strut is said to have jumped"
    assert set(range(frame, 60)) <= set(live.looked), "from there on vision measures"
    assert looking.state.seen.learnt.innovation < 3


def test_a_mistake_of_ours_stops_the_run_and_is_raised(design, monkeypatch):
    def fail(self, frame, images, expected):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(Measured, "take", fail)
    with pytest.raises(ZeroDivisionError, match="a bug"):
        looked(design, frozenset())


def test_what_is_drawn_to_warm_up_with_is_the_rig_at_home(design):
    live = Live(design)
    sight = live.take(0, render_marker_images(design.cameras, design.mechanism.home, live.markers))
    live.close()
    off = design.mechanism.home.inv() * sight.T_base_platform
    assert np.linalg.norm(off.translation) < 1e-3 and all(
        len(detection.marker) >= 4 for detection in sight.detections.values()
    )
    compile_kernels_for_run(design)


def test_a_terminal_says_what_happened(design):
    out, screen = io.StringIO(), io.StringIO()
    looking, _, _ = looked(design, frozenset(), [PlainLineDisplay(out), TerminalBlockDisplay(screen)])
    looking.happened(Ended(20.0, "stopped from the page"))
    text = out.getvalue()
    assert (
        text.count("moving to step") == 6
        and text.count("! camera") == 1
        and "[6/6] ended: stopped from the page" in text
    )
    assert "frame 5: 0.000 0.000 450.000 mm" in text and "\x1b" not in text
    lines = run_state_lines(looking.state)
    assert (
        lines[0].startswith("frame 6 of 6, step 7 of 13")
        and sum(line.startswith("strut") for line in lines) == 6
        and "! camera" in lines[-1]
    )
    assert screen.getvalue().count("\x1b[J") > 6 and f"\x1b[{len(lines)}A" in screen.getvalue()


def test_the_button_on_the_page_stops_the_run_and_its_event_is_whole(design):
    halts = []
    planned = steps_of_plan(build_plan(design, "sobol:6"))
    looking = RunObserver(
        design,
        planned,
        planned[0].goal,
        SimulatedClock(),
        Measured(design),
        None,
        RunStop(frozenset(), lambda: halts.append(1)),
    )
    with RunPage(looking, 0) as page:
        looking.displays.append(page)
        looking.seen(
            RecordedFrame(
                0,
                1,
                0.0,
                planned[1].goal,
                {c.name: Frame(np.full((48, 64), 9, np.uint8), 0.0, 1e-3) for c in design.cameras},
            )
        )
        looking.finish()
        _, event, _ = page._server.listen(-1, 0)
        assert b'"frame": 0' in event and event.count(b'"read"') == len(design.cameras) and b"NaN" not in event
        assert page._server.image("cam1").startswith(b"\xff\xd8")
        page._server.pressed()
    assert looking.stop() == "stopped from the page" and halts == [1]


def test_a_pose_far_off_what_was_expected_is_no_good_run():
    """However unsure the learner still is: 67 um at +-2.1 um is to be looked at."""
    measured = SimpleNamespace(covariance=np.eye(6) * 2.1e-6**2)
    state = SimpleNamespace(
        phase="exposed",
        ended=None,
        alarms=(),
        seen=SimpleNamespace(
            sight=measured, learnt=SimpleNamespace(error=np.array([0, 0, 67e-6, 0, 0, 0]), innovation=0.17)
        ),
    )
    verdict = run_verdict(state)
    assert verdict.state == "check" and "13 times its own uncertainty" in verdict.why
    state.seen.learnt.error = np.array([0, 0, 2e-6, 0, 0, 0])
    assert run_verdict(state).state == "good"
    state.ended = "position lost"
    assert run_verdict(state).state == "bad"
