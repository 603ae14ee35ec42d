"""Mistake search by trial corrections of rig.toml and corners.csv."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform

from rig.checks import Mistake, platform_command_and_pose_mistakes, sort_mistakes
from rig.model.design import Design
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.frame_selection_and_content_hashes import recording_and_corners_of_first_seen_hand
from rig.recording.recording_folder import Recording
from vision.checks import camera_mistake_trials as cameras
from vision.checks import corner_and_lens_convention_trials as conventions
from vision.checks import target_mistake_trials as targets
from vision.checks.corner_and_lens_convention_trials import LOST, SampledRecording, Trial, measure_trial, sample_frames
from vision.checks.trials_from_other_start_poses import cameras_by_free_markers, stated_trial_from_other_camera_poses
from vision.lenses.lens_calibration_from_board_views import alternative_initial_lenses, are_lenses_plausible
from vision.recording_adjustment_with_hand_and_stages import Measurement, has_hand_cameras, recording_seen_from_hand

FINE = 0.3  # px; a misfit below it is noise and what calibration takes up
GROSS = 2.0  # px; a misfit beyond it is no matter of sizes and lenses alone
UNEXPLAINED = 5.0  # px; a misfit that nothing explains, places of markers neither, is spoken of from here on
ALIKE = 1.5  # times the least misfit: of mistakes that explain as much, the one that leaves cameras as stated is meant
LIKELY = 0.85  # proof of a mistake that explains all: figures that are impossible by themselves go first
HALF = 0.5  # of the squares that a wrong size may leave: of hundreds of corners that is no chance
BETTER = 0.35  # of the misfit that a mistake named may leave
DONE = 0.5  # px; a mistake that leaves less explains all
SEARCH = 20  # mistakes that are tried before a measurement; not seconds, of which a slow machine would try fewer
THOROUGH = 300  # likewise, where somebody asks for nothing else
AWAY = (0.15, 0.25)  # m, rad that a camera may stand from where it is stated: nobody measures them better by hand
MENDED = 0.25  # of how far a camera stands from there, which a mistake named may leave
HALVED = 0.5  # the same of each of several cameras with one mistake, which chance does not bring about
SAME = 0.05  # of that, which another reading of the stated lens may leave
BENT = 2.0  # px, RMS over the image, that a lens may be from what is stated
UNSTATED = "the lens is not as stated"
UNSURE = 3.0  # standard deviations of the poses measured, within which commands and poses may differ
MOVING = 120  # frames whose poses are held against the commands
Maker = Callable[[SampledRecording], Iterator[tuple[str, str, SampledRecording]]]


def find_corner_mistakes(recording: Recording, corners: Corners, thorough: bool = False) -> tuple[Mistake, ...]:
    """Find the mistakes of rig.toml and corners.csv that a recording's corners show, in order.

    corners : Corners of its images or its corners.csv; thorough : whether many frames are held against the commands,
    not a few, and the search goes on for longer. Of an arm with several hands the first is checked whose target is seen
    """
    recording, corners = recording_and_corners_of_first_seen_hand(recording, corners)
    held, recording = has_hand_cameras(recording.design), recording_seen_from_hand(recording)
    seen = sample_frames(recording.design, corners, *recording.exposures.times())
    if seen is None:
        return ()
    first = measure_trial(seen)
    found, best = _seen(first, THOROUGH if thorough else SEARCH)
    if best.measured is not None and best.misfit < GROSS:  # else its cameras and poses are no evidence of anything
        if not held:
            found += _camera_pose_mistakes(best.measured, recording.design)
        found += _lens(best.measured, best.seen.design)
        if not held:
            spoilt = any(one.spoils for one in found)
            found += _moved(recording, None if spoilt else corners, best.measured, thorough)
    return sort_mistakes(found)


def misplaced_or_exchanged_camera_sentences(recording: Recording, corners: Corners) -> list[str]:
    """Sentences on fixed cameras that are misplaced in rig.toml or exchanged, where the corners show it."""
    seen = sample_frames(recording.design, corners, *recording.exposures.times())
    m = None if seen is None else measure_trial(seen).measured
    if m is None or has_hand_cameras(recording.design):
        return []
    wrong = [one.what for one in _camera_pose_mistakes(m, recording.design) if "exchanged" in one.what]
    on_base = set(m.observations.camera[~m.observations.on_platform & m.inliers].tolist())
    for i in sorted(on_base):
        stated, found = recording.design.cameras[i], m.design.cameras[i]
        if stated.mount == "fixed":
            away = np.linalg.norm(stated.pose.translation - found.pose.translation) * 1e3
            turned = np.degrees((stated.pose.rotation.inv() * found.pose.rotation).magnitude())
            wrong.append(
                f"camera {stated.name}: the base markers put it {away:.0f} mm and {turned:.1f} degrees from its pose "
                "in rig.toml"
            )
    return wrong


def _seen(first: Trial, most: int) -> tuple[list[Mistake], Trial]:
    """Mistakes that explain a misfit, and the Trial that is best. most : mistakes to try"""
    if first.misfit < FINE:
        return [], first
    if first.sparse:
        do = "Add cubes or cameras, or place them so that every frame shows two markers of the platform"
        return [Mistake(f"corners show too little of the platform: {first.reason}", do, True, 0.2)], first
    begun = stated_trial_from_other_camera_poses(first, FINE)
    if begun is not None:
        return [], begun
    unstated = _unstated(first)
    if unstated is not None:
        return unstated
    sized, best = _sized(first)
    unexplained = "no common mistake explains it"
    if best.misfit > DONE and first.misfit > FINE:
        tried, through = _tried(first, most)
        rivals = [
            (what, do, other)
            for what, do, other in tried
            if other.misfit < BETTER * first.misfit and _stands(first.seen, other)
        ]
        if not through:
            unexplained = (
                f"the search ended after {len(tried)} common mistakes, none of which explains it, before all were tried"
            )
        if rivals:
            least = min(other.misfit for *_, other in rivals)
            what, do, other = min(
                (one for one in rivals if one[2].misfit < ALIKE * least), key=lambda one: _elsewhere(one[2])
            )
            begun = conventions.stated_trial_from_cameras_of_other_trial(first, other)
            if begun is not None and begun.misfit < DONE:
                return [], begun  # what is stated explains all: the mistake was but another place to begin
            if other.misfit < 0.7 * best.misfit:
                return [
                    Mistake(
                        f"{what}: corners lie {first.misfit:.3g} px RMS from their expected positions as it "
                        f"stands, {other.misfit:.3g} px so" + (" (20 px: not at all)" if first.misfit == LOST else ""),
                        do,
                        not targets.is_only_face_exchange_within_one_cube(first.seen, other.seen),
                        LIKELY * (1 - other.misfit / first.misfit),
                    )
                ], other
    if sized:
        return sized, best
    bound = GROSS if targets.targets_with_misfitting_corners(first) else UNEXPLAINED
    if (
        first.misfit > bound
        and measure_trial(first.seen, ("poses", "lenses", "markers")).misfit > BETTER * first.misfit
    ):
        lie = f"corners lie {first.misfit:.3g} px RMS from their expected positions"
        return [
            Mistake(
                f"corners and rig.toml do not agree: {first.reason or lie}; {unexplained}",
                "Look at `rig view REC --frame N`: sides, edges, faces and poses of the targets, matrix and "
                "size of the cameras",
                first.misfit > 0.8 * LOST,
                0.2,
            )
        ], first
    return [], first


def _stands(stated: SampledRecording, other: Trial) -> bool:
    """Whether adjusting leaves lenses as a mistake would have them: where it leads elsewhere, the mistake was but
    another place to begin.

    Lenses that a mistake leaves as stated may differ from that where it explains all: nothing is then left for them to
    take up
    """
    if other.measured is None:
        return True
    ones = list(zip(stated.design.cameras, other.seen.design.cameras, other.measured.design.cameras))
    return all(
        conventions.is_same_lens_within_calibration_drift(meant, adjusted)
        or (other.misfit < DONE and conventions.is_same_lens_within_calibration_drift(was, meant))
        for was, meant, adjusted in ones
    )


def _unstated(first: Trial) -> tuple[list[Mistake], Trial] | None:
    """What is to be said where lenses of which nothing is known explain the misfit, and the Trial with these; None
    where they do not.

    A reading of the stated lenses is named only where it gives what adjusting found: from where it begins, chance
    brings adjusting to an end
    """
    best = first
    for begun in alternative_initial_lenses(first.seen.design.cameras, partial(cameras_by_free_markers, first.seen)):
        tried = measure_trial(first.seen.with_cameras(begun))
        best = min(best, tried, key=lambda one: one.misfit)
        if tried.misfit < DONE:
            break
    if best.misfit > min(DONE, BETTER * first.misfit) or best.measured is None:
        return None
    adjusted, stated = best.measured.design.cameras, first.seen.design.cameras
    if not are_lenses_plausible(adjusted, stated):
        return None
    tail = f"corners lie {first.misfit:.3g} px RMS from their expected positions as it stands, {best.misfit:.3g} px"
    read = conventions.find_matching_lens_convention(first.seen, adjusted)
    if read is not None:
        what, do, other = read
        return [Mistake(f"{what}: {tail} so", do, True, LIKELY * (1 - best.misfit / first.misfit))], measure_trial(
            other
        )
    off = [s.name for s, a in zip(stated, adjusted) if not conventions.is_same_lens_within_calibration_drift(s, a)]
    if first.misfit < GROSS or not off:
        return [], best
    return [
        Mistake(
            f"rig.toml: {UNSTATED} of camera{'s' * (len(off) > 1)} {', '.join(off)}: {tail} with lenses of "
            "which nothing is known",
            "Calibrate the lens (`rig lens`) and state matrix and distortion; until then state the matrix by the focal "
            "length in pixels and distortion = [0, 0, 0, 0, 0]",
            False,
            0.6,
        )
    ], best


def _sized(first: Trial) -> tuple[list[Mistake], Trial]:
    """The print's scale, where that explains the misfit."""
    tried = [(body, share, measure_trial(other)) for body, share, other in targets.marker_size_trials(first.seen)]
    if not tried:
        return [], first
    body, share, best = min(tried, key=lambda one: one[2].misfit)
    share = targets.best_marker_size_ratio(first.seen, share, body, lambda seen: measure_trial(seen).misfit)
    at = measure_trial(targets.scale_marker_sides(first.seen, share, body))
    best = at if at.misfit < best.misfit else best
    if (
        best.misfit**2 > HALF * first.misfit**2
        or abs(share - 1) < targets.PRINTED
        or not _stands(first.seen, best)
        or conventions.least_misfit_with_edge_bias(first, best.misfit) < best.misfit
    ):
        return [], first
    who = next((t for t in first.seen.design.targets if body in (None, t.body)), None)
    message = targets.marker_size_ratio_text(share, who) + (f", those on the {body}" if body else "")
    return [
        Mistake(
            f"rig.toml: {message}: corners lie {first.misfit:.3g} px RMS from their expected positions as it stands, "
            f"{best.misfit:.3g} px so",
            "Measure the outer side of a black border and state it as marker (or side), in metres; print "
            "without fitting to the page",
            True,
            LIKELY * (1 - best.misfit / first.misfit),
        )
    ], best


def _tried(first: Trial, most: int) -> tuple[list[tuple[str, str, Trial]], bool]:
    """((what, do, Trial) of every mistake there is a name for, kind by kind, until one of a kind explains all; whether
    `most` sufficed for it).
    """
    seen = first.seen
    stated = not any(target.body == "base" for target in seen.design.targets)
    makers: list[Maker] = [conventions.lens_convention_trials]
    if first.misfit > GROSS:
        makers = [
            conventions.corner_correction_candidates_for_all_cameras,
            cameras.exchanged_camera_trials,
            targets.exchanged_or_moved_target_trials,
            conventions.lens_convention_trials,
            conventions.corner_correction_candidates_by_camera,
            *([cameras.alternative_camera_pose_trials] if stated else []),
        ]
    wrong = targets.targets_with_misfitting_corners(first) if first.misfit > GROSS else []
    ones: list[Maker] = [partial(targets.turned_face_trials, name=name) for name in wrong]
    ones += [
        partial(targets.exchanged_or_moved_target_trials, names=wrong),
        *(
            partial(kind, name=name)
            for kind in (targets.exchanged_face_trials, targets.single_target_trials)
            for name in wrong
        ),
    ]
    zoomed = (
        [lambda s, found=first.measured.design.cameras: cameras.focal_length_mistakes(s, found)]
        if first.measured is not None
        else []
    )
    tried: list[tuple[str, str, Trial]] = []
    for make in [*ones, *zoomed, *([targets.cube_edge_trials] if first.misfit > GROSS else []), *makers]:
        least = LOST
        for what, do, other in make(seen):
            tried.append((what, do, measure_trial(other)))
            least = min(least, tried[-1][2].misfit)
            if len(tried) >= most:
                return tried, False
        if least < min(DONE, 0.1 * first.misfit):
            break
    return tried, True


def _camera_pose_mistakes(m: Measurement, design: Design) -> list[Mistake]:
    """Cameras that the base's markers put elsewhere than rig.toml has them."""
    on_base = set(m.observations.camera[~m.observations.on_platform & m.inliers].tolist())
    rows = [i for i, camera in enumerate(design.cameras) if camera.mount == "fixed" and i in on_base]
    stated, seen = [design.cameras[i] for i in rows], [m.design.cameras[i] for i in rows]
    far = [k for k in range(len(rows)) if _far(stated[k].pose, seen[k].pose) > 1]
    if not far:
        return []
    gap = max(np.linalg.norm(stated[k].pose.translation - seen[k].pose.translation) for k in far)
    cost = np.array([[_far(a.pose, b.pose) for b in stated] for a in seen])
    match = scipy.optimize.linear_sum_assignment(cost)[1]
    tail = f" (the stated poses are up to {gap * 1e3:.0f} mm off)"
    if (match != np.arange(len(match))).any() and (cost[np.arange(len(match)), match] < 1).all():
        pairs = ", ".join(
            f"{stated[k].name} is at the stated pose of {stated[j].name}" for k, j in enumerate(match) if k != j
        )
        return [
            Mistake(
                f"cameras are exchanged: {pairs}{tail}",
                "Exchange the names, in rig.toml or in frames.csv and corners.csv, or the poses alone",
                False,
                0.9,
            )
        ]
    found = []
    ways = {
        k: {what: _far(pose, seen[k].pose) for what, pose in cameras.alternative_camera_poses(stated[k].pose)}
        for k in far
    }
    common = min(ways[far[0]], key=lambda what: max(ways[k][what] for k in far))
    if len(far) > 1 and all(ways[k][common] < min(1.0, HALVED * _far(stated[k].pose, seen[k].pose)) for k in far):
        return [
            Mistake(
                f"rig.toml: cameras {', '.join(stated[k].name for k in far)}: {common}{tail}",
                cameras.BEFORE,
                False,
                0.85,
            )
        ]
    for k in far:
        what = min(ways[k], key=lambda trial: ways[k][trial])
        away = np.linalg.norm(stated[k].pose.translation - seen[k].pose.translation)
        turned = (stated[k].pose.rotation.inv() * seen[k].pose.rotation).magnitude()
        named = ways[k][what] < min(1.5, MENDED * _far(stated[k].pose, seen[k].pose))
        found.append(
            Mistake(
                f"rig.toml: camera {stated[k].name}: {f'{what}: ' if named else ''}it stands {away * 1e3:.0f} mm and "
                f"{np.degrees(turned):.0f} degrees from its stated pose",
                cameras.BEFORE,
                False,
                0.7,
            )
        )
    return found


def _elsewhere(one: Trial) -> float:
    """How far a Trial's cameras stand from where they are stated, in all, in what is allowed."""
    if one.measured is None:
        return np.inf
    return sum(
        _far(a.pose, b.pose) for a, b in zip(one.seen.design.cameras, one.measured.design.cameras) if a.mount == "fixed"
    )


def _lens(m: Measurement, design: Design) -> list[Mistake]:
    """Mistakes of lenses that adjustment brought to another sign or order of the stated terms, the others as stated."""
    found: dict[tuple[str, str], list[str]] = {}
    ones = list(zip(design.cameras, m.design.cameras))
    if not all(
        any(
            conventions.is_same_lens_within_calibration_drift(trial, seen)
            for trial in (stated, *(other for *_, other in conventions.alternative_distortion_conventions(stated)))
        )
        for stated, seen in ones
    ):
        return []  # lenses of which nothing was known: one of them resembles a term exchanged by chance
    for stated, seen in ones:
        off = conventions.rms_pixel_difference_of_distortions(stated, seen)
        ways = {
            (what, do): conventions.rms_pixel_difference_of_distortions(other, seen)
            for what, do, other in conventions.alternative_distortion_conventions(stated)
        }
        named = min(ways, key=lambda trial: ways[trial], default=None)
        if off > BENT and named is not None and ways[named] < min(SAME * off, conventions.ALIKE[2]):
            found.setdefault(named, []).append(stated.name)
    return [
        Mistake(
            f"rig.toml: {what}, of camera{'s' * (len(names) > 1)} {', '.join(names)}: adjusting them to the "
            "images corrects it",
            do,
            False,
            0.6,
        )
        for (what, do), names in found.items()
    ]


def _far(a: RigidTransform, b: RigidTransform) -> float:
    """How far two poses are apart, in what is allowed."""
    return max(
        float(np.linalg.norm(a.translation - b.translation)) / AWAY[0],
        float((a.rotation.inv() * b.rotation).magnitude()) / AWAY[1],
    )


def _moved(recording: Recording, corners: Corners | None, m: Measurement, thorough: bool) -> list[Mistake]:
    """What commands and the poses seen say of each other. corners : all there are, for more poses; None where they are
    not as stated.
    """
    if recording.commands is None or recording.design.mechanism.plates is None:
        return []
    few = platform_command_and_pose_mistakes.commands_and_measured_poses(recording, m.frames, m.T_base_platform)
    if corners is not None and (thorough or platform_command_and_pose_mistakes.commands_disagree_with_poses(few)):
        frames, t = recording.exposures.times()
        many = sample_frames(replace(recording.design, cameras=m.design.cameras), corners, frames, t, MOVING)
        more = measure_trial(many).measured if many is not None else None
        if more is not None:
            m, few = (
                more,
                platform_command_and_pose_mistakes.commands_and_measured_poses(
                    recording, more.frames, more.T_base_platform
                ),
            )
    unsure = float(
        np.sqrt(np.einsum("nii->ni", m.covariance)[:, :3].sum(axis=1).mean())
    )  # m, shared errors of cameras and lenses included
    return [] if few.miss() < UNSURE * unsure else list(platform_command_and_pose_mistakes.command_pose_mistakes(few))
