"""Measurement of a recording.

From its corners or images: reading, adjustment, reading of missed markers.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform
from threadpoolctl import threadpool_limits

from rig.array_and_json_types import Floats
from rig.errors import NotEnoughData, RigError
from rig.model.design import Camera, Design
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.recording_folder import Recording
from vision import platform_motion_between_frame_time_and_corner_exposure
from vision import recording_adjustment_with_hand_and_stages as recording_adjustment
from vision.bundle.bundle_adjustment import NoOptimum
from vision.bundle.marker_and_target_displacements import (
    HALVED,
    adjusted_markers,
    are_stated_places_doubtful,
    marker_and_target_displacements,
)
from vision.corner_observations_and_merging import Observations, observations_from_corners, observations_of_frames
from vision.lenses.lens_calibration_from_board_views import alternative_initial_lenses, are_lenses_plausible
from vision.marker_corner_prediction import MarkerMap, marker_map
from vision.platform_motion_between_frame_time_and_corner_exposure import Rates, ReadoutMotion
from vision.pose.marker_places_from_sightings import marker_places_from_sightings
from vision.reading.corner_reading_from_recording_images import (
    Collected,
    image_reader,
    read_corners_of_all_images,
    search_missed_markers,
)
from vision.reading.live_measurement_and_corner_refit import (
    ROUNDS,
    SETTLED,
    largest_pixel_shift_between_lenses,
    refit_corners,
)
from vision.reading.marker_identity_mistakes_and_expected_marker_places import LOOKED_AT, no_marker_reason
from vision.recording_adjustment_with_hand_and_stages import (
    Measurement,
    has_hand_cameras,
    is_on_remounted_cube,
    measure_observations,
    measure_without_remounted_cubes,
    measurement_with_inverted_poses,
    recording_seen_from_hand,
)

REFUSED = 0.05  # of the frames; where more show enough and are refused, the stated places are doubted
ASIDE = 0.2  # of the corners of solved frames; where more are set aside, the stated lenses are doubted
FRAMES = 8  # on which other lenses are tried
PLACES = ("auto", "stated", "free")


@threadpool_limits.wrap(limits=1)  # small products wait for threads; and sums are rounded by how many share them
def measure_recording(
    recording: Recording,
    free: Sequence[str] = ("poses", "lenses"),
    read_images: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
    places: str = "stated",
    check_corners: Callable[[Corners], None] | None = None,
) -> tuple[Measurement, Collected | None]:
    """Measure a recording.

    free : what is adjusted, see vision.bundle.bundle_adjustment; places : whether the markers' places on their bodies
    are adjusted too: "stated", "free", or "auto": where the stated ones contradict what is seen in more than REFUSED of
    the frames, or most of the corners' scatter comes from them
    read_images : read the images even where corners.csv is there
    progress : called with (label, done, of), or None; check_corners : called with the Corners before they are measured,
        or None; what it raises ends it
    Returns (Measurement, Collected or None)
    Raises NotEnoughData for a recording with neither corners nor images, and what reading and measuring raise
    """
    recording = recording_with_unstated_markers_placed(recording, read_images, progress)
    options = (free, read_images, progress, places, check_corners)
    if not has_hand_cameras(recording.design):
        return _measured(
            recording,
            *options,
            platform_motion_between_frame_time_and_corner_exposure.commanded_platform_rates(recording),
        )
    measured, collected = _measured(recording_seen_from_hand(recording), *options, None)
    return measurement_with_inverted_poses(measured), collected


def recording_with_unstated_markers_placed(
    recording: Recording, read_images: bool = False, progress: Callable[[str, int, int], None] | None = None
) -> Recording:
    """The recording with unstated markers placed.

    Markers whose pose is not stated in its design stand where its corners or images put them.
    read_images, progress : as of `measure_recording`; those that are never seen are left out of the design
    Raises NotEnoughData for markers that are seen, and never in one image with another that is placed; RigError for
    markers on a stage of a chain, whose poses must be stated
    """
    design = recording.design
    unplaced = [(target, one) for target in design.targets for one in target.listed if one.pose is None]
    if not unplaced or not design.cameras:
        return recording
    if any(target.stage for target, _ in unplaced):
        require_no_free_marker_places_on_stages("free")
    seen = recording_seen_from_hand(recording).design
    markers, (frames, t) = marker_map(seen, RigidTransform.identity()), recording.exposures.times()
    corners = recording.corners
    if corners is None or read_images:
        label = None if progress is None else partial(progress, "reading images for places of markers")
        corners = read_corners_of_all_images(replace(recording, design=seen), markers, label).corners
    observed = observations_from_corners(corners, frames, seen, markers)
    _, linked = marker_places_from_sightings(observed, seen.cameras, markers)
    shown = np.isin(np.arange(len(markers.id)), observed.marker)
    alone = markers.id[shown & ~markers.stated & ~linked].tolist()
    if not alone:
        found = measure_observations(observed, seen, markers, ("poses", "lenses", "markers"), progress, t)
        placed = {marker.id: marker.pose for rows in adjusted_markers(found).values() for marker in rows}
        held = set(markers.id[list(found.adjustment.unknowns.markers)].tolist())
        alone = [int(markers.id[row]) for row in np.flatnonzero(shown & ~markers.stated) if markers.id[row] not in held]
    if alone:
        raise NotEnoughData(
            f"rig.toml does not state the pose of markers {', '.join(map(str, alone))}, and no image in which a pose "
            "can be found shows them together with markers that are placed: state their poses, roughly, or record "
            "images that show both"
        )
    left_out = {marker.id for _, marker in unplaced} - held
    targets = tuple(
        replace(
            target,
            listed=tuple(
                replace(marker, pose=placed[marker.id]) if marker.pose is None else marker
                for marker in target.listed
                if marker.id not in left_out
            ),
        )
        for target in design.targets
    )
    return replace(recording, design=replace(design, targets=targets))


def _measured(
    recording: Recording,
    free: Sequence[str],
    detect_anew: bool,
    progress: Callable[[str, int, int], None] | None,
    places: str,
    look: Callable[[Corners], None] | None,
    rates: Rates | None,
) -> tuple[Measurement, Collected | None]:
    """The same by cameras that stand still or go their own ways. rates : of the platform while
    rows of a rolling shutter are exposed, or None
    """
    design = recording.design
    if not design.cameras or not design.targets:
        raise NotEnoughData(
            f"{recording.folder}: rig.toml has {len(design.cameras)} cameras and {len(design.targets)} targets; "
            "measuring requires at least one of each"
        )
    if not any(target.body == "platform" for target in design.targets):
        raise NotEnoughData(f"{recording.folder}: rig.toml has no target on the platform, so its pose cannot be seen")
    if places not in PLACES:
        raise ValueError(f"places takes {PLACES}, got {places!r}")
    frames, t = recording.exposures.times()
    markers, motion = marker_map(design), None if rates is None else ReadoutMotion(recording, rates)

    def labelled(label: str) -> Callable[[int, int], None] | None:
        return (lambda done, of: progress(label, done, of)) if progress else None

    def solved(
        corners: Corners, correlation: Floats | None = None, look: Callable[[Corners], None] | None = None
    ) -> Measurement:
        if look:
            look(corners)
        observed = observations_from_corners(corners, frames, design, markers, correlation)
        if motion is None or markers.stage.any():  # of a chain's stages only the last has rates
            return adjusted(observed)
        return motion.measured(observed, adjusted)

    def adjusted(observed: Observations) -> Measurement:
        loose = is_on_remounted_cube(observed, design, markers)
        if markers.stage.any():
            return measure_with_stated_or_free_markers(
                observed.take(~loose), design, markers, free, progress, t, places
            )
        return measure_without_remounted_cubes(
            observed,
            loose,
            lambda held: measure_with_stated_or_free_markers(held, design, markers, free, progress, t, places),
        )

    if recording.corners is not None and not detect_anew:
        return solved(recording.corners, look=look), None
    if not recording.has_images:
        raise NotEnoughData(
            f"{recording.folder}: frames.csv names no images and there is no corners.csv, so there is "
            "nothing to measure"
        )
    found = read_corners_of_all_images(recording, markers, labelled("reading images"))
    if not len(found.corners.frame):
        raise NotEnoughData(
            f"{recording.folder}: no marker of rig.toml was found in any of {_why_none(recording, found, markers)}"
        )
    measured = solved(found.corners, found.correlation, look)
    more = search_missed_markers(recording, found, measured, markers, labelled("looking again"))
    if len(more.corners.frame) > len(found.corners.frame):
        found = more
        measured = solved(found.corners, found.correlation)
    for _ in range(ROUNDS):
        if largest_pixel_shift_between_lenses(found.corners, found.cameras, measured.design.cameras) < SETTLED:
            break
        found = refit_corners(recording, found, measured.design.cameras, markers, labelled("placing anew"))
        measured = solved(found.corners, found.correlation)
    return measured, found


def require_no_free_marker_places_on_stages(places: str) -> None:
    """Raise RigError where marker places are to be free on stages.

    On a rig with targets on stages of a chain.
    """
    if places == "free":
        raise RigError(
            "positions of markers cannot be adjusted on a rig with targets on stages of a chain: the stated "
            "places of all a stage's markers "
            "determine its pose; measure with positions as stated"
        )


def measure_with_stated_or_free_markers(
    observed: Observations,
    design: Design,
    markers: MarkerMap,
    free: Sequence[str],
    progress: Callable[[str, int, int], None] | None,
    t: Floats,
    places: str,
) -> Measurement:
    """Measurement with stated or free places of markers.

    Their poses are as stated, or estimated too where requested or where the stated are doubtful.
    t : (F,) s
    """
    if markers.stage.any():
        require_no_free_marker_places_on_stages(places)
        return recording_adjustment.separate_stage_measurements(
            measure_observations(
                recording_adjustment.observations_with_separate_stage_frames(observed, markers),
                design,
                markers,
                free,
                progress,
                recording_adjustment.stage_frame_times_shifted_apart(t, markers),
            ),
            markers,
        )
    loose, measured = (*free, "markers"), None
    if places == "free" or not markers.stated[observed.marker].all():
        return measure_observations(observed, design, markers, loose, progress, t)
    try:
        measured = measure_observations(observed, design, markers, free, progress, t)
    except (NotEnoughData, NoOptimum):
        begun = _other_lenses(observed, design, markers, free)
        if begun is None and places == "stated":
            raise
    else:
        begun = _other_lenses(observed, design, markers, free) if _contradicts(measured) else None
    if begun is not None:
        try:
            other = measure_observations(observed, design, markers, free, progress, t, begun)
        except (NotEnoughData, NoOptimum):  # all frames do not agree with what a few of them did
            if measured is None and places == "stated":
                raise
        else:
            measured = other if measured is None or other.inliers.sum() > measured.inliers.sum() else measured
    contradicted = measured is None or len(unsolved_frames_with_enough_markers(measured)) > REFUSED * len(
        observed.frames
    )
    if measured is not None and (
        places == "stated" or not (contradicted or are_stated_places_doubtful(measured, markers))
    ):
        return measured
    loosened = measure_observations(observed, design, markers, loose, progress, t)
    if contradicted and not any(
        move.moved for move in marker_and_target_displacements(loosened.adjustment)
    ):  # it was the cameras that were not where they are stated
        loosened = measure_observations(observed, design, markers, free, progress, t, loosened.design.cameras)
    if measured is None or len(loosened.frames) > len(measured.frames) or loosened.noise < HALVED * measured.noise:
        return loosened
    return measured


def _contradicts(measured: Measurement) -> bool:
    """Whether corners contradict what is stated: frames that show enough are refused, or many corners of those solved
    set aside.
    """
    solved = np.isin(measured.observations.frames[measured.observations.frame], measured.frames)
    return len(unsolved_frames_with_enough_markers(measured)) > REFUSED * len(measured.observations.frames) or bool(
        (~measured.inliers[solved]).mean() > ASIDE
    )


def _other_lenses(
    observed: Observations, design: Design, markers: MarkerMap, free: Sequence[str]
) -> tuple[Camera, ...] | None:
    """Cameras from whose lenses a few frames agree with what is stated, where the stated lenses lead nowhere; None
    where no such are found.
    """
    if "lenses" not in free:
        return None
    rich = np.bincount(observed.frame, minlength=len(observed.frames))
    parts = np.array_split(np.arange(len(rich)), min(FRAMES, len(rich)))
    few = observations_of_frames(observed, np.array([part[np.argmax(rich[part])] for part in parts]))

    def adjusted(cameras: tuple[Camera, ...], free: Sequence[str]) -> Measurement | None:
        try:
            return measure_observations(few, design, markers, free, cameras=cameras)
        except (NotEnoughData, NoOptimum):  # nothing can be solved from these
            return None

    def loosened(cameras: tuple[Camera, ...]) -> tuple[Camera, ...] | None:
        found = adjusted(cameras, (*free, "markers"))
        return None if found is None else found.design.cameras

    for cameras in alternative_initial_lenses(design.cameras, loosened):
        found = adjusted(cameras, free)
        if found is not None and not _contradicts(found) and are_lenses_plausible(found.design.cameras, design.cameras):
            return found.design.cameras
    return None


def unsolved_frames_with_enough_markers(measured: Measurement) -> list[int]:
    """Numbers of unsolved frames with enough markers.

    Two or more of all that is needed.
    """
    enough = frames_with_enough_markers(measured.observations, measured.design)
    return [number for number in enough if number in measured.unsolved]


def frames_with_enough_markers(observations: Observations, design: Design) -> list[int]:
    """Numbers of frames with enough markers.

    They are two or more of all that is needed.
    """
    o = observations
    enough = np.ones(len(o.frames), bool)
    moving = [i for i, camera in enumerate(design.cameras) if camera.mount == "moving"]
    for mask in (o.on_platform, *(~o.on_platform & (o.camera == i) for i in moving)):
        frame, _ = np.unique(np.stack([o.frame[mask], o.camera[mask] * 100_000 + o.marker[mask]], axis=1), axis=0).T
        enough &= np.bincount(frame, minlength=len(o.frames)) >= 2
    found: list[int] = o.frames[enough].tolist()
    return found


def _why_none(recording: Recording, found: Collected, markers: MarkerMap) -> str:
    """How many images there are, and what some of them show instead of the rig's markers."""
    e = recording.exposures
    images = [(frame, camera) for frame, camera, name in zip(e.frame, e.camera, e.image) if name]
    if found.left_out:
        return f"{len(images)} images that could be located: " + "; ".join(
            sorted({one.reason for one in found.left_out})[:5]
        )
    read, some = (
        image_reader(recording),
        {round(k) for k in np.linspace(0, len(images) - 1, min(2 * LOOKED_AT, len(images)))},
    )
    why = no_marker_reason([image for k in sorted(some) if (image := read(*images[k])) is not None], markers)
    return f"{len(images)} images" + (f"; of {len(some)} that were examined again, {why}" if why else "")
