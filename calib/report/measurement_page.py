"""The page of a measurement: what the cameras leave over, where the platform went, how well each pose is known, in mm
and mrad.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.report.frame_pictures import frame_of_greatest_residual, frame_of_median_residual, frame_pictures_html
from calib.report.pose_figures import pose_coverage_figures
from calib.samples.pose_samples import rms_uncertainty
from rig.model.pose import pose_to_vector
from rig.recording.recording_folder import Recording
from rig.report.pages.html_elements import folding_section, heading, list_html, note, paragraph, table
from rig.report.pages.image_plane_figures import Arrows, Cells, image_plane, patch_means
from rig.report.pages.page_template import Link, Page, write_page
from rig.report.pages.plots import Series, panel_row, plot_panel
from rig.report.verdict import AGREES, Evidence, Missing, Verdict, judge_evidence
from vision.bundle.held_out_frames import HeldOut, NotHeldOut
from vision.bundle.marker_displacements import Places
from vision.reading.marker_identity import Suspect
from vision.reading.recording_corners import Collected
from vision.recording_adjustment import Measurement

SOLVED = 0.5  # of the frames, below which a measurement is bad
TWICE = 2.0  # of the squares that the covariance predicts, from which it is not to be believed
CELLS = 16  # of a residual map, across the image


@dataclass(frozen=True, slots=True, eq=False)
class MeasurementResult:
    """What there is to say of a measurement. collected : what its images gave, or None; held : of frames held out;
    places : vision Places where markers' places were adjusted, else None; statement : lines on what the recording
    determines; suspects : markers that are not what rig.toml says"""

    recording: Recording
    measurement: Measurement
    held: HeldOut | NotHeldOut
    collected: Collected | None = None
    places: Places | None = None
    statement: Sequence[str] = ()
    suspects: Sequence[Suspect] = ()


def measurement_page(path: Path | str, told: MeasurementResult, links: Sequence[Link] = ()) -> None:
    """Write the page of a measurement: residual map of each camera, pose coverage, uncertainty, cameras, unsolved
    frames.
    """
    m, collected = told.measurement, told.collected
    rotation = np.sqrt(np.trace(m.covariance[:, 3:, 3:], axis1=1, axis2=2))
    position = np.sqrt(np.trace(m.covariance[:, :3, :3], axis1=1, axis2=2))
    parts = [
        paragraph(
            f"{m.inliers.sum()} corners used, {(~m.inliers & np.isfinite(m.residuals[:, 0])).sum()} set "
            "aside as outliers. A corner "
            f"scatters by {m.noise:.4f} px per axis. {_held(told.held)}"
        ),
        *_suspects(told.suspects),
        *_pictures(told),
        heading("What the cameras leave over"),
        note(
            "Mean residual over patches of the image, drawn enlarged, on the RMS there; a pattern here "
            "is a lens that the model lacks."
        ),
        _residual_maps(m),
        heading("Where the platform went"),
        pose_coverage_figures(pose_to_vector(m.T_base_platform)),
        heading("How well each pose is known"),
        note("Standard uncertainty of its length, cameras' own included."),
        _uncertainty(m, position, rotation),
        heading("Cameras"),
        _cameras(told.recording, m),
    ]
    if told.statement:
        parts += [heading("What this recording determines"), list_html(told.statement)]
    if told.places is not None:
        parts += [
            heading("Where the markers really are"),
            note(
                "From their stated places, along their own x (right), y (up), z (out), with 95 % intervals. "
                "The stated places, taken "
                "together, hold the frames."
            ),
            _moves(told.places),
            _residuals(told.places),
        ]
    disagreeing = _worst_markers(m)
    if disagreeing:
        parts += [
            heading("Markers that disagree"),
            note("Share of a marker's corners set aside: a face askew, a wrong print, a covered marker."),
            table(("marker", "corners", "set aside"), disagreeing),
        ]
    if m.unsolved:
        parts += [heading("Frames without a pose"), table(("frame", "reason"), sorted(m.unsolved.items()))]
    if collected is not None and collected.left_out:
        rows = [row[:4] for row in collected.left_out]
        parts += [
            heading("Markers read but not placed"),
            folding_section(f"{len(rows)} of them", table(("frame", "camera", "marker", "reason"), rows)),
        ]
    title, verdict = f"Measurement of {told.recording.name}", measurement_verdict(told)
    write_page(
        path,
        Page("measure", title, verdict, parts, list(dict.fromkeys([*recommended_actions(told), *verdict.next])), links),
    )


def measurement_verdict(told: MeasurementResult) -> Verdict:
    """The verdict on a measurement."""
    m, total = told.measurement, len(told.recording.exposures.times()[0])
    position, rotation = rms_uncertainty(m.covariance)
    size = f"poses to {position * 1e6:.1f} µm and {rotation * 1e6:.1f} µrad (standard uncertainty, RMS)"
    why = f"{len(m.frames)} of {total} frames solved, {size}"
    missing, unexplained = [], []
    if len(m.frames) < total:
        missing.append(Missing(f"{total - len(m.frames)} frames have no pose"))
    if told.suspects:
        missing.append(
            Missing(f"{len(told.suspects)} marker{'s are' if len(told.suspects) > 1 else ' is'} not what rig.toml says")
        )
    if isinstance(told.held, NotHeldOut):
        missing.append(Missing("no frame could be held out to check the uncertainties"))
    elif abs(told.held.ratio - 1) > 2 * told.held.scatter:
        if told.held.ratio > AGREES**2:
            unexplained.append(
                f"frames held out miss by {told.held.ratio:.1f} times the squares predicted: the "
                "uncertainties are not to be believed"
            )
        elif told.held.ratio < 1 / AGREES**2:
            missing.append(
                Missing(
                    f"frames held out miss by {told.held.ratio:.2f} of the squares predicted: the noise of "
                    "corners, and with it every "
                    "uncertainty, is less than stated"
                )
            )
    beyond = (
        not isinstance(told.held, NotHeldOut)
        and told.held.ratio > TWICE
        and abs(told.held.ratio - 1) > 2 * told.held.scatter
    )
    refuted = [*unexplained] if beyond else []
    if len(m.frames) < SOLVED * total:
        refuted.append("fewer than half of the frames have a pose")
    return judge_evidence(
        Evidence(why, unexplained=() if beyond else tuple(unexplained), missing=tuple(missing), refuted=tuple(refuted))
    )


def recommended_actions(told: MeasurementResult) -> list[str]:
    """What an owner does next with a measurement."""
    steps = (
        ["Correct what rig.toml says of the markers named below, or their print, and measure again"]
        if told.suspects
        else []
    )
    if told.measurement.unsolved:
        steps.append("See below why frames have no pose; `rig view REC --frame N` draws what was read in one")
    if told.held and told.held.ratio > TWICE and abs(told.held.ratio - 1) > 2 * told.held.scatter:
        steps.append("Ask what physics is left out: `rig diagnose REC --out found`")
    return [*steps, "Calibrate from these poses: `rig calibrate MEASURED --out calibration.json`"]


def _held(held: HeldOut | NotHeldOut) -> str:
    if isinstance(held, NotHeldOut):
        return f"No held-out figure: {held.reason}."
    return (
        f"On frames held out, residuals are {held.ratio:.3f} ± {2 * held.scatter:.3f} of what the covariance "
        "predicts (1 where it is true), "
        f"{held.rms:.3f} px RMS over {held.corners} corners."
    )


def _suspects(suspects: Sequence[Suspect]) -> list[str]:
    if not suspects:
        return []
    return [
        heading("Markers that are not what rig.toml says"),
        note("What disagrees is left out of the poses."),
        list_html(map(str, suspects)),
    ]


def _pictures(told: MeasurementResult) -> list[str]:
    m = told.measurement
    usual, bad = frame_of_median_residual(m), frame_of_greatest_residual(m)
    shown = frame_pictures_html(told.recording, m, usual)
    if not shown:
        return []
    rest = (
        [folding_section(f"The frame with the greatest residuals, {bad}", *frame_pictures_html(told.recording, m, bad))]
        if bad != usual
        else []
    )
    return [heading(f"A frame as it was read: {usual}"), *shown, *rest]


def _residual_maps(m: Measurement) -> str:
    return panel_row(*(_residual_map(m, i) for i in range(len(m.design.cameras))))


def _residual_map(m: Measurement, i: int) -> str:
    camera, rows = m.design.cameras[i], (m.observations.camera == i) & m.inliers
    size = (float(camera.width), float(camera.height))
    if not rows.any():
        return image_plane(camera.name, "no corners", size, ())
    uv, r = m.observations.uv[rows], m.residuals[rows]
    cell = camera.width / CELLS
    centre, means = patch_means(uv, np.column_stack([r, (r**2).sum(axis=1) / 2]), cell)
    mean, rms = means[:, :2], np.sqrt(means[:, 2])
    longest = max(float(np.linalg.norm(mean, axis=1).max(initial=0)), 1e-6)
    return image_plane(
        f"{camera.name}: {rows.sum()} corners",
        f"longest arrow {longest:.3f} px",
        size,
        (Cells(centre, rms, cell, "px RMS"), Arrows(centre, mean, 1.2 * cell / longest, "px", 3)),
    )


def _uncertainty(m: Measurement, position: np.ndarray, rotation: np.ndarray) -> str:
    return panel_row(
        *(
            plot_panel(
                name,
                ("frame", unit),
                [Series(m.frames, values * 1e6)],
                limits=(0.0, 1.1e6 * float(values.max()) or 1.0),
            )
            for name, unit, values in (("position", "µm", position), ("rotation", "µrad", rotation))
        )
    )


def _cameras(recording: Recording, m: Measurement) -> str:
    sigma = dict(zip(m.adjustment.shared_names, np.sqrt(np.diag(m.adjustment.shared_covariance))))
    rows = []
    for stated, found in zip(recording.design.cameras, m.design.cameras):
        moved = pose_to_vector(stated.pose.inv() * found.pose)
        rows.append(
            (
                found.name,
                f"{np.linalg.norm(moved[:3]) * 1e3:.3f}",
                f"{np.linalg.norm(moved[3:]) * 1e3:.3f}",
                *(
                    f"{value:.3f} ± {2 * sigma.get((found.name, term), 0):.3f}"
                    for term, value in (
                        ("fx", found.matrix[0, 0]),
                        ("fy", found.matrix[1, 1]),
                        ("cx", found.matrix[0, 2]),
                        ("cy", found.matrix[1, 2]),
                    )
                ),
            )
        )
    return table(("camera", "moved, mm", "turned, mrad", "fx, px (k = 2)", "fy", "cx", "cy"), rows)


def _moves(places: Places) -> str:
    rows = [
        (
            move.name,
            "yes" if move.moved else "no",
            *(f"{by * 1e3:+.3f} ± {half * 1e3:.3f}" for by, half in zip(move.by, move.ci95)),
        )
        for move in places.moves
    ]
    return table(("marker", "moved", "x, mm", "y, mm", "z, mm", "rx, mrad", "ry, mrad", "rz, mrad"), rows)


def _residuals(places: Places) -> str:
    return plot_panel(
        "residuals frame by frame",
        ("frame", "platform's corners, RMS px"),
        [
            Series(places.frames, places.before, "places as stated", colour=1),
            Series(places.frames, places.after, "as adjusted"),
        ],
        log=True,
    )


def _worst_markers(m: Measurement) -> list[tuple[int, int, str]]:
    o, known = m.observations, np.isfinite(m.residuals[:, 0])
    rows = []
    for marker in np.unique(o.marker[known]):
        own = known & (o.marker == marker)
        share = 1 - m.inliers[own].mean()
        if share > 0.05:
            rows.append((share, int(marker), int(own.sum())))
    ids = m.ids()
    return [(ids[marker], count, f"{share:.0%}") for share, marker, count in sorted(rows, reverse=True)[:12]]
