"""Check of recordings before use, their combination, and their view.

Unfit recordings are refused, and the instrument's displacement between recordings is removed.

The geometry and, for each further recording, the six numbers of the instrument's place are fitted to all closures at
once, each strut weighed by its poses' noise and by what it scatters beyond in that recording: what the machine's model
leaves out differs from plan to plan, and must not be taken for a place. Only a place that chance does not explain, and
that does more to the struts than all that it leaves there, is taken out.

A view is a picture of one frame, a page with the rig in three dimensions, or a file for Rerun.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform
from threadpoolctl import threadpool_limits

from calib.drift.visit_equations_and_reference import base_motion_columns
from calib.models.base_and_tool_displacement_between_recordings import has_base_and_tool_placements, placement_lines
from calib.models.geometry_and_placement_fit_of_several_recordings import remove_base_and_tool_displacement
from calib.models.platform.platform_identification import PRIOR
from calib.models.platform.strut_loop_closure_equations import loop_covariance
from calib.report.recording_and_plan_pages import write_recording_page
from calib.samples.commanded_and_measured_pose_samples import Samples, sample_recording
from calib.samples.freely_placed_instrument_poses_combined_with_tilts import (
    are_base_and_tool_frames_unknown,
    recording_in_machine_frames,
)
from rig.api import CheckResult, load_and_check_recording_files
from rig.array_and_json_types import Floats, Integers
from rig.checks import platform_command_and_pose_mistakes
from rig.checks.mistake_dataclass_and_clock_mistakes import Mistake, sort_mistakes
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect, require_nonzero_effect
from rig.formats.exporters import recording_as_rerun_tum_parquet
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Parallel,
    geometric_parameters,
    has_struts,
    loop_closure_parameter_jacobian,
    mechanism_with_parameters,
    require_parallel,
    strut_or_axis_jacobian_by_pose,
)
from rig.model.pose import adjoint, exp
from rig.recording.combined_recordings import is_measured_by_instrument
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.recording_folder import Recording, RecordingPart
from rig.report.pages.page_templates_and_index_page import Link
from vision.checks import find_corner_mistakes
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import (
    Notice,
    make_corner_check_raising_on_severe_mistakes,
    recorded_or_sampled_corners,
    require_no_severe_mistakes_and_notice_others,
    require_no_severe_mistakes_in_files_and_images,
    unevenly_placed_cubes_remarks,
)
from vision.recording_combination_and_moved_cameras import combine_recordings, require_one_rig_without_repeated_frames

ROUNDS = 4  # of linearising anew
ALIKE = 1e-3  # probability with which an instrument that stands still is taken for moved, which costs little
CLEAR = 2.0  # times what it leaves of the struts' closures; a place that does less may be what the model leaves out
HUBER = 3.0  # times the median; a pose farther off counts less
WIDE = 3.0  # times its uncertainty, by which a fit may still move a place, as what is unmodelled may have
SPREAD = 1.4826  # standard deviations in a median of absolute values


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where an instrument stood in a recording (its number, from 0), seen from its place in the first. motion : (6,) m,
    rad, in the base; covariance : (6, 6) of it
    p_value : of so much by chance"""

    recording: int
    motion: Floats
    covariance: Floats
    p_value: float

    def line(self, name: str) -> str:
        """In words; name : of the recording."""
        far, turned = np.linalg.norm(self.motion[:3]), np.linalg.norm(self.motion[3:])
        return (
            f"the instrument has moved, by {far * 1e3:.3g} mm and {turned * 1e3:.3g} mrad, in {name}: its "
            "poses are transformed to the first recording"
        )


def undisplaced_recording_and_displaced_places(
    recording: Recording, is_anywhere: bool = False
) -> tuple[Recording, list[Place]]:
    """Recording with its instrument's displacement removed, and the [Place] where it was displaced.

    Of a platform. is_anywhere : whether it is placed anew in each recording,
    which needs no proof; the first one's is fitted where joints cannot take it up, as those of a plate on struts do
    Raises what sampling raises
    """
    samples, m = sample_recording(recording).samples, require_parallel(recording.design.mechanism)
    number, first = _numbers(recording, samples.frame), 0 if is_anywhere and not has_struts(m) else 1
    motions, scatter, start = (
        np.zeros((len(recording.parts), 6)),
        np.zeros((len(recording.parts), len(m.axes))),
        geometric_parameters(m),
    )
    for _ in range(ROUNDS):
        at = replace(samples, T_base_platform=_back(samples.T_base_platform, motions[number]))
        step, covariance, scatter = _solved(at, number, m, start, scatter, first)
        m = mechanism_with_parameters(m, geometric_parameters(m) + step[: len(start)])
        motions[first:] += step[len(start) :].reshape(-1, 6)
    places = []
    for k, motion in list(enumerate(motions))[first:]:
        rows = slice(len(start) + 6 * (k - first), len(start) + 6 * (k - first) + 6)
        own = covariance[rows, rows]
        p = float(scipy.special.chdtrc(6, motion @ np.linalg.solve(own, motion)))
        shows = p * (len(motions) - 1) < ALIKE and _clear(samples.take(number == k), motion, m)
        if is_anywhere or shows:
            places.append(Place(k, motion, own, p))
    return _recording_in_first_base_frame(recording, places, is_anywhere), places


def _clear(samples: Samples, motion: Floats, m: Parallel) -> bool:
    """Whether a place (6,) does CLEAR times as much to the closures of a recording's samples as it leaves, by a
    mechanism as fitted.
    """
    inverse, T = mechanisms.kinematics_of(m).inverse, samples.T_base_platform
    here = inverse(_back(T, np.tile(motion, (len(samples), 1))), m)
    return float(np.linalg.norm(inverse(T, m) - here)) > CLEAR * float(np.linalg.norm(here - samples.commanded))


def _solved(
    samples: Samples, number: Integers, m: Parallel, start: Floats, scatter: Floats, first: int
) -> tuple[Floats, Floats, Floats]:
    """(step (p + 6 places,), its covariance, (parts, axes) m scatter) of geometry and places, linear about a mechanism
    and places as they are.

    number : (n,) recording of each sample; start : (p,) the stated geometry, to which the prior pulls;
        scatter : (parts, axes) m, so far; first : of the recordings that has a place
    """
    T, p = samples.T_base_platform, len(start)
    parts = int(number.max()) + 1
    later = parts - first
    A = strut_or_axis_jacobian_by_pose(T, m)
    C = loop_covariance(A, samples.covariance)
    W = np.linalg.inv(np.linalg.cholesky(C + np.eye(len(m.axes)) * scatter[number][:, None] ** 2))
    moved = np.zeros((*A.shape[:2], later, 6))
    for k in range(later):
        moved[number == k + first, :, k] = (A @ base_motion_columns(T))[number == k + first]
    J = np.concatenate([loop_closure_parameter_jacobian(T, m), moved.reshape(*A.shape[:2], -1)], axis=2)
    left = mechanisms.kinematics_of(m).inverse(T, m) - samples.commanded
    off = np.linalg.norm((W @ left[..., None])[..., 0], axis=1)
    W = W * np.sqrt(np.minimum(1.0, HUBER * np.median(off) / np.maximum(off, 1e-12)))[:, None, None]
    white, away = (
        (W @ J).reshape(-1, J.shape[2]),
        np.r_[(start - geometric_parameters(m)) / PRIOR**2, np.zeros(6 * later)],
    )
    open_ = np.full(6 * later, 1.0 if first == 0 else 0.0)  # 1/m^2: some motion of a level platform shows nowhere
    covariance = np.linalg.inv(white.T @ white + np.diag(np.r_[np.full(p, 1 / PRIOR**2), open_]))
    step = covariance @ (white.T @ (W @ left[..., None]).ravel() + away)
    left, own = np.abs(left - J @ step), np.einsum("nii->ni", C)
    spread = np.stack(
        [(SPREAD * np.median(left[number == k], axis=0)) ** 2 - own[number == k].mean(axis=0) for k in range(parts)]
    )
    return step, covariance, np.sqrt(np.maximum(spread, 0.0))


def _back(T: RigidTransform, motions: Floats) -> RigidTransform:
    """Poses (n,) as the instrument would have seen them from its first place; motions : (n, 6) of the base, m and rad,
    along its axes.
    """
    return exp(motions).inv() * T


def _recording_in_first_base_frame(recording: Recording, places: list[Place], is_anywhere: bool) -> Recording:
    """Recording with its places taken out; of an instrument placed anew in each part, what is open of them is an error
    that its poses share, so that all later fits solve for it.
    """
    poses = recording.poses
    if not places or poses is None:
        return recording
    motions, number = np.zeros((len(recording.parts), 6)), _numbers(recording, poses.frame)
    for place in places:
        motions[place.recording] = place.motion
    T, common = _back(poses.T_base_platform, motions[number]), poses.common
    for place in (one for one in places if is_anywhere and one.recording):
        moved = adjoint(T.inv()) @ np.linalg.cholesky(WIDE**2 * place.covariance)
        moved[number != place.recording] = 0
        common = moved if common is None else np.concatenate([common, moved], axis=2)
    return replace(recording, poses=replace(poses, T_base_platform=T, common=common))


def _numbers(recording: Recording, frame: Integers) -> Integers:
    """(n,) which of several recordings together, from 0, frames (n,) are of."""
    return np.searchsorted([part.frames for part in recording.parts], frame, side="right") - 1


Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class PreparedRecording:
    """recording : one Recording of all; look : judges its corners once they are read, where that is not done; joined :
    whether it was made of several
    """

    recording: Recording
    look: Callable[[Corners], None]
    joined: bool


def check_and_combine_recordings(
    recordings: Recording | Sequence[Recording], ignore_mistakes: bool, notice: Notice, progress: Progress | None
) -> PreparedRecording:
    """Checked and combined recordings (PreparedRecording).

    Each checked and refused if unfit, several combined.
    ignore_mistakes : whether to go on though a mistake makes results meaningless; notice : called with lines on what is
    unlikely, on what the recordings share and what is each one's own; progress : called with (label, done, of), or None
    Raises RigError that names the likeliest mistake first, and for recordings that are not of one rig
    """
    every = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if len(every) == 1:
        recording, look = every[0], refuse_unfit_recording_and_make_corner_check(every[0], ignore_mistakes, notice)
        if (
            are_base_and_tool_frames_unknown(recording.design.instrument, recording.design.mechanism)[0]
            and recording.poses is not None
        ):
            alone = replace(recording, parts=(RecordingPart(recording, 0, 0.0),))
            recording, _ = undisplaced_recording_and_displaced_places(recording_in_machine_frames(alone), True)
        return PreparedRecording(recording, look, False)
    require_one_rig_without_repeated_frames(every)
    for recording in every:
        look = refuse_unfit_recording_and_make_corner_check(recording, ignore_mistakes, notice)
        corners = recorded_or_sampled_corners(recording)
        if corners is not None:
            look(corners)
    found = combine_recordings(every, progress)
    for line in found.lines():
        notice(line)
    recording = found.recording
    if is_measured_by_instrument(recording):
        is_anywhere = are_base_and_tool_frames_unknown(recording.design.instrument, recording.design.mechanism)[0]
        recording = recording_in_machine_frames(recording)
        measured = "pose" if recording.design.instrument is None else recording.design.instrument.kind
        several = bool(hand_names(recording.design.mechanism))
        if recording.design.mechanism.strut_joints is not None or is_anywhere:
            recording, places = undisplaced_recording_and_displaced_places(recording, is_anywhere)
            for place in [] if is_anywhere else places:
                notice(place.line(every[place.recording].name))
            if is_anywhere:
                notice("the instrument stands anywhere: its place is fitted in each recording")
            elif not places:
                notice("the instrument has not moved")
        elif has_base_and_tool_placements(recording.design.mechanism, measured) and not several:
            recording, placements = remove_base_and_tool_displacement(recording)
            for line in placement_lines(placements, [one.name for one in every[1:]]):
                notice(line)
            if not any(any(one.moved) for one in placements):
                notice("base and tool stand where they stood")
        else:
            notice(
                "the instrument is assumed not to have moved: this is not checked for a mechanism of kind "
                f"{recording.design.mechanism.kind!r} {'with several hands' if several else 'seen so'}"
            )
    return PreparedRecording(recording, lambda corners: None, True)


def refuse_unfit_recording_and_make_corner_check(
    recording: Recording, anyway: bool, notice: Notice
) -> Callable[[Corners], None]:
    """Refuse an unfit recording, and make the check of its corners.

    Unfit are spoilt files or poses.
    Returns the check that refuses its corners once read
    """
    require_no_severe_mistakes_in_files_and_images(recording, anyway, notice)
    if recording.poses is not None and recording.corners is None and not recording.has_images:
        require_no_severe_mistakes_and_notice_others(
            find_mistakes_between_poses_and_commands(recording), anyway, notice
        )
    return make_corner_check_raising_on_severe_mistakes(recording, anyway, notice)


def find_mistakes_between_poses_and_commands(recording: Recording) -> tuple[Mistake, ...]:
    """Mistakes that poses.csv and commands.csv show of each other."""
    from calib.models.arm.arm_command_and_pose_mistakes import find_arm_mistakes, find_mistakes_of_several_hands

    if recording.poses is None or recording.commands is None:
        return ()
    mechanism = recording.design.mechanism
    if hand_names(mechanism):
        return find_mistakes_of_several_hands(recording)
    if mechanism.link_rows is not None:
        return find_arm_mistakes(recording)
    if mechanism.plates is None or any(are_base_and_tool_frames_unknown(recording.design.instrument, mechanism)):
        return ()
    return sort_mistakes(
        platform_command_and_pose_mistakes.command_pose_mistakes(
            platform_command_and_pose_mistakes.commands_and_measured_poses(
                recording,
                recording.poses.frame,
                recording.poses.T_base_platform,
                platform_command_and_pose_mistakes.pose_columns_of_poses_csv_as_written(recording),
            )
        )
    )


def check(path: Path | str, detect: bool = False) -> CheckResult:
    """CheckResult of a recording's folder, as `rig check` states it.

    detect : whether to read some images even where corners.csv is there, and compare both

    >>> import calib
    >>> print(calib.check("tests/data/bench/check"))
    good: nothing wrong or unlikely was found
    """
    recording, files = load_and_check_recording_files(Path(path))
    if recording is None:
        return files
    found = [*files.found, *find_mistakes_between_poses_and_commands(recording)]
    corners = recording.corners
    if recording.has_images and (corners is None or detect):
        from vision.checks.image_sample_corners_and_dictionary_mistakes import image_sample_corners_and_mistakes

        seen, more = image_sample_corners_and_mistakes(recording)
        found += more
        corners = corners or seen
    if corners is not None:
        with threadpool_limits(1):  # threads in products as small as these make it some ten times as long
            found += find_corner_mistakes(recording, corners, thorough=True)
    return CheckResult(sort_mistakes(found), unevenly_placed_cubes_remarks(recording.design))


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """frame : number of the frame that a picture shows, None for all frames; rerun : whether all frames are written for
    the viewer Rerun, else as a page; enlarge : how much larger a picture's residuals are drawn
    effects : as `rig simulate` takes them, what each would do to the poses of a page

    Raises MissingLibrary where Rerun's library is needed and not installed
    """

    frame: int | None = None
    rerun: bool = False
    enlarge: float = 200.0
    effects: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.rerun:
            recording_as_rerun_tum_parquet.import_rerun()


def view(
    recording: Recording,
    path: Path,
    options: ViewOptions = ViewOptions(),
    links: Sequence[Link] = (),
    progress: Callable[[str, int, int], None] | None = None,
) -> tuple[str, ...]:
    """Write a view of a recording to a file, as `rig view` does.

    links : of a page; progress : called with (label, done, of), or None
    Returns sentences on what it shows
    Raises RigError for a frame or an effect that the recording cannot have, FileError for a picture's unknown format
    """
    if options.frame is not None:
        from vision.measured_frame_drawings_and_frame_jpegs import measure_and_draw_frame, save_pictures_side_by_side

        pictures, measured = measure_and_draw_frame(recording, options.frame, options.enlarge, progress)
        return tuple(save_pictures_side_by_side(path, pictures, measured).splitlines())
    if options.rerun:
        rerun = recording_as_rerun_tum_parquet.import_rerun()
        left_out = recording_as_rerun_tum_parquet.write_rerun_file(recording, path, rerun)
        frames = f"{len(recording.exposures.times()[0])} frames"
        return (f"{left_out} images are left out: Rerun shows PNG and JPEG", frames) if left_out else (frames,)
    effects = [require_nonzero_effect(parse_effect(text)) for text in options.effects]
    write_recording_page(path, recording, effects, links)
    return ()
