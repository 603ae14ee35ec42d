"""What frames say of cameras and markers: a knocked camera, a covered marker, a frame without a pose; and nothing of a
quiet run.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from vision.reading.live_measurement_and_corner_refit import Sight
from vision.reading.moved_camera_and_covered_marker_alarms import Watch

NOISE = 0.02


def detection(seen):
    return SimpleNamespace(marker=np.array(seen, int), left_out=())


@pytest.fixture
def ids(design):
    return {
        body: [number for target in design.targets if target.body == body for number in target.ids]
        for body in ("base", "platform")
    }


def sight(design, ids, frame, rng, shift=(0.0, 0.0), missing=(), solved=True):
    """A sight in which every camera sees four base markers and six of the platform; `shift` px is what cam1 has moved
    by.
    """
    names = [camera.name for camera in design.cameras]
    ought = ids["base"][:4] + ids["platform"][:6]
    rows = [
        (c, number, k)
        for c in range(len(names))
        for number in ought
        if (names[c], number) not in missing
        for k in range(4)
    ]
    camera, number = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    on = np.isin(number, ids["platform"])
    residuals = NOISE * rng.normal(size=(len(rows), 2))
    residuals[(camera == 1) & ~on] += shift
    observations = SimpleNamespace(camera=camera, marker=number, on_platform=on)
    found = {name: detection([n for n in ought if (name, n) not in missing]) for name in names}
    T = design.mechanism.home if solved else None
    return Sight(
        frame,
        T,
        np.eye(6) if solved else None,
        "" if solved else "the markers contradict each other",
        observations,
        residuals,
        np.ones(len(rows), bool),
        found,
        dict.fromkeys(names, tuple(ought)),
    )


def test_a_quiet_run_is_left_in_peace(design, ids):
    rng, watch = np.random.default_rng(1), Watch(design)
    hidden = [("cam0", ids["platform"][k]) for k in range(3)]  # behind a strut now and then
    for frame in range(200):
        missing = [key for key in hidden if rng.random() < 0.3]
        assert watch.look(sight(design, ids, frame, rng, missing=missing), NOISE) == []


@pytest.mark.parametrize("size", [0.4, 2.0])
def test_a_moved_camera_is_named_at_once_and_once(design, ids, size):
    rng, watch = np.random.default_rng(2), Watch(design)
    for frame in range(5):
        assert watch.look(sight(design, ids, frame, rng), NOISE) == []
    looks = [watch.look(sight(design, ids, frame, rng, shift=(size, 0.0)), NOISE) for frame in range(5, 9)]
    assert [len(alarms) for alarms in looks] == [1, 0, 0, 0]
    assert (
        looks[0][0].kind == "camera"
        and "camera 'cam1' has moved" in looks[0][0].text
        and f"{size:.1f}" in looks[0][0].text
    )
    assert Watch(design).look(sight(design, ids, 0, rng, shift=(size, 0.0)), None) == [], (
        "before cameras are adjusted nothing is known of them"
    )


def test_a_covered_marker_is_named_soon_and_a_hand_before_a_camera_at_once(design, ids):
    rng, watch = np.random.default_rng(3), Watch(design)
    for frame in range(30):
        assert watch.look(sight(design, ids, frame, rng), NOISE) == []
    one, frames = [("cam2", ids["base"][1])], 0
    while not (alarms := watch.look(sight(design, ids, 30 + frames, rng, missing=one), NOISE)):
        frames += 1
        assert frames < 6
    assert alarms[0].kind == "covered" and f"marker {ids['base'][1]} in camera 'cam2'" in alarms[0].text
    assert watch.look(sight(design, ids, 40, rng, missing=one), NOISE) == [], "once"
    hand = [("cam0", number) for number in ids["base"][:4] + ids["platform"][:2]]
    alarms = watch.look(sight(design, ids, 41, rng, missing=hand), NOISE)
    assert [alarm.kind for alarm in alarms] == ["covered"] and "all at once" in alarms[0].text


def test_a_frame_without_a_pose_is_said_once_cameras_are_known(design, ids):
    rng, watch = np.random.default_rng(4), Watch(design)
    assert watch.look(sight(design, ids, 0, rng, solved=False), None) == []
    alarms = watch.look(sight(design, ids, 1, rng, solved=False), NOISE)
    assert alarms[0].kind == "unseen" and "contradict each other" in alarms[0].text
