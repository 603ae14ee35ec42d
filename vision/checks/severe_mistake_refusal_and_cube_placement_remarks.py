"""Refusal of a recording for severe mistakes, and remarks on the placement of cubes.

Refused where mistakes spoil its poses; remarks are on cubes and their markers placed unevenly by a rig.toml.

None of what is remarked spoils a result; a rig measures better, and alike in all directions, where it is put right.
Source: the on-line learning patent for Stewart platforms, [0005], [0010]: targets evenly on circles about the middles
    of both plates.
"""

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.checks.design_value_camera_and_image_mistakes_and_all_file_checks import (
    mistakes_found_without_looking_at_images,
)
from rig.checks.mistake_dataclass_and_clock_mistakes import Mistake
from rig.errors import RigError
from rig.model.design import Design, Target, markers_of_target, quarter_turns_of_cubes
from rig.model.design_contradictions_and_cube_quarter_turns import WORDS
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.recording_folder import Recording
from vision.checks.mistake_search_by_trial_corrections import find_corner_mistakes
from vision.marker_corner_prediction import (
    MarkerMap,
    are_all_marker_poses_known,
    expected_marker_rows_and_corners_in_image,
    marker_map,
)

Notice = Callable[[str], None]


def ignore_notice(line: str) -> None:
    """Ignore a notice.

    It is the callback where nobody listens, and does nothing.
    """


def require_no_severe_mistakes_and_notice_others(
    mistakes: Iterable[Mistake], allow_mistakes: bool, notice: Notice
) -> None:
    """Refuse severe mistakes, and give notice of the others.

    Severe are those that make results meaningless; they may be allowed.
    The others are noticed, a line each.
    allow_mistakes : whether to go on though a mistake makes results meaningless
    Raises RigError with all of it where one does and nobody goes on anyway
    """
    mistakes = tuple(mistakes)
    if any(one.spoils for one in mistakes) and not allow_mistakes:
        raise RigError("\n".join([*map(str, mistakes), "Nothing was computed; --anyway overrides this"]))
    for one in mistakes:
        notice(str(one))


def require_no_severe_mistakes_in_files_and_images(recording: Recording, allow_mistakes: bool, notice: Notice) -> None:
    """Refuse a recording with mistakes in its files or sampled images, unless mistakes are allowed."""
    require_no_severe_mistakes_and_notice_others(
        mistakes_found_without_looking_at_images(recording), allow_mistakes, notice
    )
    for name, quarters in quarter_turns_of_cubes(recording.design).items():
        notice(
            f"{recording.folder}: cube {name} was removed and remounted, {WORDS[quarters]}; its place is "
            "known only within the tolerance of remounting, so its "
            "markers determine no pose"
        )
    if recording.has_images and recording.corners is None and recording.design.targets:
        from vision.checks.image_sample_corners_and_dictionary_mistakes import dictionary_and_identity_mistakes

        require_no_severe_mistakes_and_notice_others(
            dictionary_and_identity_mistakes(recording), allow_mistakes, notice
        )


def make_corner_check_raising_on_severe_mistakes(
    recording: Recording, allow_mistakes: bool, notice: Notice
) -> Callable[[Corners], None]:
    """Make the function that refuses a recording whose corners, once read, show mistakes.

    As `require_no_severe_mistakes_and_notice_others` does.
    """

    def look(corners: Corners) -> None:
        require_no_severe_mistakes_and_notice_others(find_corner_mistakes(recording, corners), allow_mistakes, notice)

    return look


def recorded_or_sampled_corners(recording: Recording) -> Corners | None:
    """Recorded corners of a recording, else corners sampled from some frames' images.

    None where neither is there.
    """
    if recording.corners is not None:
        return recording.corners
    if not recording.has_images or not recording.design.targets:
        return None
    from vision.checks.image_sample_corners_and_dictionary_mistakes import image_sample_corners_and_mistakes

    return image_sample_corners_and_mistakes(recording)[0]


UNEVEN = 0.02  # of the circle's radius, and of an even gap, beyond which it is said
HEIGHT = 0.05  # of the radius, by which cubes of a body may stand higher than others
ASIDE = 0.02  # of a marker's side, by which it may sit beside its face's middle
UNSEEN = np.radians(65)  # from the nearest face's normal; beyond it a marker is read badly, if at all
FEWEST = 2  # markers of a body that a camera should see
RING = 72  # directions about a body's normal that are looked at
BODIES = {"platform": "the platform", "base": "the base"}


def unevenly_placed_cubes_remarks(design: Design) -> tuple[str, ...]:
    """Remarks on unevenly placed cubes of a Design.

    They say by how many mm and degrees; none where all is even.
    """
    if not design.targets or not are_all_marker_poses_known(design):
        return ()
    found = marker_map(design.without_stages())
    return (
        *_circles(design),
        *(text for target in design.targets for text in _faces(target)),
        *_directions(found),
        *_cameras(design, found),
    )


def _middle(target: Target) -> Floats | None:
    """(3,) m, where the normals of a target's markers meet, in its body; None for a target that is no cube."""
    if target.pose is not None:
        return np.asarray(target.pose.translation)
    own = markers_of_target(target)
    normals = np.array([marker.T_body_marker.rotation.as_matrix()[:, 2] for marker in own])
    if len(own) < 3 or np.linalg.matrix_rank(normals, tol=0.1) < 3:
        return None
    across = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    places = np.array([marker.T_body_marker.translation for marker in own])
    return np.linalg.lstsq(across.reshape(-1, 3), (across @ places[:, :, None]).reshape(-1), rcond=None)[0]


def _circles(design: Design) -> Iterator[str]:
    for body, words in BODIES.items():
        cubes = [
            (target.name, place)
            for target in design.targets
            if target.body == body and (place := _middle(target)) is not None
        ]
        if len(cubes) < 3:
            continue
        places = np.array([place for _, place in cubes])
        radius, angle = np.hypot(places[:, 0], places[:, 1]), np.arctan2(places[:, 1], places[:, 0])
        order = np.argsort(angle)
        gaps, even = np.degrees(np.diff(np.r_[angle[order], angle[order[0]] + 2 * np.pi])), 360 / len(cubes)
        far = int(np.abs(radius - np.median(radius)).argmax())
        if np.ptp(radius) > UNEVEN * radius.mean() or np.abs(gaps - even).max() > UNEVEN * even:
            yield (
                f"rig.toml: the cubes on {words} are not evenly on a circle about its centre: radii "
                f"{radius.min() * 1e3:.1f} to "
                f"{radius.max() * 1e3:.1f} mm ({cubes[far][0]} is farthest from the others), gaps "
                f"{gaps.min():.1f} to {gaps.max():.1f} degrees "
                f"where {even:.1f} are even"
            )
        if np.ptp(places[:, 2]) > HEIGHT * radius.mean():
            yield (
                f"rig.toml: the cubes on {words} are at heights from {places[:, 2].min() * 1e3:.1f} to "
                f"{places[:, 2].max() * 1e3:.1f} mm"
            )


def _faces(target: Target) -> Iterator[str]:
    """Markers of a cube, listed one by one, that sit beside their faces' middles."""
    middle = None if target.pose is not None else _middle(target)
    if middle is None:
        return
    off = [
        (marker.id, marker.side, (marker.T_body_marker.inv().apply(middle))[:2] * -1)
        for marker in markers_of_target(target)
    ]
    aside = [
        f"{number} by {by[0] * 1e3:+.2f}, {by[1] * 1e3:+.2f}"
        for number, side, by in off
        if np.linalg.norm(by) > ASIDE * side
    ]
    if aside:
        yield (
            f"rig.toml: faces of {target.name} are not centred: marker {'; '.join(aside)} mm (right, up) from "
            "the centre of the face"
        )


def _directions(found: MarkerMap) -> Iterator[str]:
    """Directions round a body, level and half way up, that no face of it looks into."""
    turn = np.linspace(0, 2 * np.pi, RING, endpoint=False)
    for body, words in BODIES.items():
        normals = found.T_body_marker[found.on_platform == (body == "platform")].rotation.as_matrix()[:, :, 2]
        if not len(normals):
            continue
        for up, name in ((0.0, "level"), (np.radians(45), "45 degrees up")):
            ways = np.stack([np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.full(RING, np.sin(up))], axis=1)
            nearest = np.arccos(np.clip(ways @ normals.T, -1, 1)).min(axis=1)
            worst = int(nearest.argmax())
            if nearest[worst] > UNSEEN:
                yield (
                    f"rig.toml: {words} shows no face towards {np.degrees(turn[worst]):.0f} degrees "
                    f"({name}): the nearest face there looks "
                    f"{np.degrees(nearest[worst]):.0f} degrees away, {(nearest > UNSEEN).mean():.0%} of that "
                    "circle are not visible"
                )


def _cameras(design: Design, found: MarkerMap) -> Iterator[str]:
    """Fixed cameras that see too little of a body with the platform at home."""
    home = design.mechanism.home_pose
    if home is None:
        return
    for camera in design.cameras:
        if camera.mount != "fixed":
            continue
        rows = expected_marker_rows_and_corners_in_image(camera, RigidTransform.from_matrix(home.as_matrix()), found)[0]
        for body, words in BODIES.items():
            on_body = found.on_platform == (body == "platform")
            count = int(on_body[rows].sum())
            if on_body.any() and count < FEWEST:
                yield (
                    f"rig.toml: camera {camera.name} sees {count} of {on_body.sum()} markers of {words} with the "
                    "platform at home"
                )
