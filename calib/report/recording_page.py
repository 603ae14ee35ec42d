"""The page of a recording in three dimensions: its poses as measured, or as commanded, and what effects would do to
them.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.report.pose_figures import pose_coverage_figures
from calib.report.scene_3d import rig_stage
from calib.samples.effect_playback import effect_displacements
from rig.effects.framework.effect import Effect
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.pose import pose_difference, pose_to_vector
from rig.recording.recording_folder import Recording
from rig.report.pages.html_elements import heading, list_html
from rig.report.pages.page_template import Link, Page, write_page
from rig.report.pages.view_3d import Effect as Played
from rig.report.pages.view_3d import view_3d_html, view_scripts
from rig.report.verdict import Evidence, Missing, Verdict, judge_evidence


def write_recording_page(
    path: Path | str, recording: Recording, effects: Sequence[Effect] = (), links: Sequence[Link] = ()
) -> None:
    """Write the page of a recording by its poses, its commands or both. effects : to be tried on it, each by itself

    Raises RigError for a recording with neither, for effects on one without commands, and as their models do
    """
    design, poses, values = recording.design, recording.poses, None
    errors: dict[str, np.ndarray] = {}
    tried: list[Played | None] = []
    if recording.commands is not None:
        frames, t, values = recording.commanded()
        T = mechanisms.kinematics_of(design.mechanism).forward(values, design.mechanism)
        tried = [
            effect_displacements(design, recording.commands, t, (effect,), 0, recording.sensors) for effect in effects
        ]
        if poses is not None:
            at, by_model = np.searchsorted(frames, poses.frame), T
            frames, values, T = frames[at], values[at], poses.T_base_platform
            errors = {"the model in rig.toml, from what was measured": pose_difference(T, by_model[at])}
            tried = [one and replace(one, shifts=one.shifts[:, at]) for one in tried]
    elif poses is None:
        raise RigError(
            f"{recording.folder} has neither poses.csv nor commands.csv, so there is no pose to show; `rig "
            "measure` finds poses"
        )
    elif effects:
        raise RigError(f"{recording.folder} has no commands.csv, and effects act on what is commanded")
    else:
        frames, T = poses.frame, poses.T_base_platform
    still = [
        f"{effect.label()} at {effect.place} moves no platform: it acts on what cameras see"
        for effect, one in zip(effects, tried)
        if one is None
    ]
    shown = rig_stage(design, frames, T, values, errors, tuple(one for one in tried if one is not None))
    parts = [
        *view_3d_html(shown),
        *([list_html(still)] if still else []),
        heading("Where it went"),
        pose_coverage_figures(pose_to_vector(T)),
    ]
    title = f"{recording.name} in three dimensions"
    write_page(
        path,
        Page(
            "view",
            title,
            recording_verdict(recording, frames, errors),
            parts,
            recommended_actions(recording),
            links,
            view_scripts(parts),
        ),
    )


def recording_verdict(recording: Recording, frames: np.ndarray, errors: dict[str, np.ndarray]) -> Verdict:
    """The verdict on what is shown. frames : (n,) numbers; errors : of its poses, tangents (n, 6) m and rad"""
    if recording.poses is None:
        return judge_evidence(
            Evidence(
                f"{len(frames)} poses as rig.toml and the commands have them",
                missing=(Missing("nothing was measured"),),
            )
        )
    if not errors:
        return judge_evidence(Evidence(f"{len(frames)} poses as measured; nothing was commanded to hold them against"))
    far = np.linalg.norm(next(iter(errors.values()))[:, :3], axis=1)
    rms = float(np.sqrt(np.mean(far[np.isfinite(far)] ** 2))) if np.isfinite(far).any() else np.nan
    return judge_evidence(
        Evidence(f"{len(frames)} poses as measured; the model in rig.toml is off by {rms * 1e3:.3f} mm RMS")
    )


def recommended_actions(recording: Recording) -> list[str]:
    """What an owner does next."""
    if recording.poses is None:
        return ["Measure the poses: `rig measure REC --out measured`"]
    return [
        "Calibrate: `rig calibrate REC --out calibration.json`",
        "Ask what physics is left out: `rig diagnose REC --out found`",
    ]
