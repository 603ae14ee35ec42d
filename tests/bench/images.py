"""Images of rigs that are not there, printed as printers print, poses visited again: are poses and corners as true as
they say, are findings right?

Recordings are drawn, measured and diagnosed one after another, an hour of one core. In a folder that IMAGES names
drawings are kept, for next time.
"""

import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.diagnosis.effect_signal_to_noise_and_distinguishability_by_plan import platform_effect_signal_to_noise
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import (
    diagnosis_report,
    write_diagnosis_json_and_simulation_files,
)
from calib.samples.commanded_and_measured_pose_samples import Sampled, sample_recording
from rig.model.pose import pose_difference
from rig.recording import recording_folder
from rig.recording.recording_folder import Recording
from synthetic import blind_diagnosis_score, random_blind_platform_cases_with_truth
from tests.calib.diagnose_recording import diagnosis_of
from tests.vision.drawn_observations import nees
from tests.vision.test_recording_adjustment_with_hand_and_stages import joint_chi2
from vision.corner_observations_and_merging import Observations
from vision.marker_corner_prediction import Sightings, State, marker_map, predict_sightings

SEEDS = {"nothing": 7001, "one": 7302}  # by what is hidden
RECORDINGS = {"nothing": 24, "one": 36}
FRAMES = {"nothing": 40, "one": 24}  # asked for; ladders are whole, so that there are some 56 and 44
INSIDE = 5.991  # chi-square with 2 degrees of freedom that 95 % stay below
NEAR = 1e-4  # m and rad; poses as near to an earlier one are visited again


@dataclass(frozen=True, slots=True)
class ImageFigures:
    """How true a Measurement's poses and corners are. chi2 : of all poses together; poses : how many;
    alone : normalised error squared / 6 of a pose by itself, mean; inside, revisited_share : shares of corners in
        their 95 % ellipse, all
    and at poses visited again; ratio : of the corners' noise to the Cramer-Rao bound"""

    chi2: float
    poses: int
    alone: float
    inside: float
    revisited_share: float
    ratio: float


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted). Three resolutions, two lenses, blur, defocus, vignetting, noise; ladders and
    repeats.
    """
    with tempfile.TemporaryDirectory() as folder:
        keep = Path(os.environ.get("IMAGES", folder))
        found, figures = [], []
        for kind, wanted in RECORDINGS.items():
            for index in cases(kind, wanted):
                case, recorded, truth = drawn(keep, kind, index)
                sampled = sample_recording(recorded)
                if kind == "nothing":
                    figures.append(true(case, sampled))
                found.append(
                    blind_diagnosis_score.score_case(
                        index, truth, diagnosis_of(recorded, sampled, Path(folder) / f"{kind}{index}")
                    )
                )
                print(line(kind, found[-1]), file=sys.stderr, flush=True)
    yield from _measured(figures)
    yield from _named([one for one in found if one.kind == "nothing"], [one for one in found if one.kind == "one"])
    for one in found:
        if one.found or one.unexplained if one.kind == "nothing" else not right(one):
            yield line(one.kind, one), "", ""


def _measured(figures):
    figure = (
        f"{len(figures)} recordings of some {sum(t.poses for t in figures) // len(figures)} poses, nothing hidden: "
    )
    yield (
        figure + "normalised error squared / 6 of poses, jointly",
        f"{sum(t.chi2 for t in figures) / sum(t.poses for t in figures) / 6:.3f}",
        "0.93-1.07",
    )
    yield (
        figure + "the same, a recording each, least to most",
        " ".join(f"{t.chi2 / t.poses / 6:.2f}" for t in sorted(figures, key=_joint)),
        "",
    )
    yield (
        figure + "the same pose by pose, median; worst recording",
        f"{np.median([t.alone for t in figures]):.2f}; {max(t.alone for t in figures):.2f}",
        "",
    )
    yield (
        figure + "corners in their stated 95 % ellipse",
        f"{100 * np.mean([t.inside for t in figures]):.1f} %",
        "93-97 %",
    )
    yield (
        figure + "the same at poses visited again",
        f"{100 * np.nanmean([t.revisited_share for t in figures]):.1f} %",
        "93-97 %",
    )
    yield (
        figure + "corners' noise over the Cramer-Rao bound, median",
        f"{np.median([t.ratio for t in figures]):.2f}",
        "",
    )


def _named(still, one):
    yield (
        f"nothing hidden: with a finding, of {len(still)}",
        str(sum(bool(c.found) or c.unexplained for c in still)),
        "<= 1",
    )
    figures = {f.name: f for f in blind_diagnosis_score.campaign_rates_with_intervals([*still, *one])}
    for name, missed, most in (
        ("detected", "not detected", 2),
        ("named first", "not named first", 4),
        ("at its place", "misplaced", 3),
        ("nothing else named", "something else named", ""),
    ):
        f = figures[f"one effect: {name}"]
        figure = f"one effect at signal-to-noise >= {blind_diagnosis_score.STRONG:g}, {f.trials} recordings: {missed}"
        yield figure, str(f.trials - f.hits), f"<= {most}" if most else ""
    f = figures["95 % intervals that cover"]
    yield (
        f"95 % intervals that cover the truth, of {f.trials}",
        f"{f.hits / max(f.trials, 1):.0%} ({f.low:.0%} to {f.high:.0%})",
        "91 %",
    )


def _joint(t):
    return t.chi2 / t.poses


def cases(kind: str, wanted: int) -> list[int]:
    """Numbers of a kind's first cases whose effects are strong enough to be found."""
    out, index = [], 0
    while len(out) < wanted:
        index += 1
        if min(strength(drawn_case(kind, index)), default=np.inf) >= blind_diagnosis_score.STRONG:
            out.append(index)
    return out


def drawn_case(kind: str, index: int) -> random_blind_platform_cases_with_truth.DrawnCase:
    """The DrawnCase of a number, with nothing drawn yet."""
    return random_blind_platform_cases_with_truth.draw_case(SEEDS[kind], index, FRAMES[kind], kinds=[kind], images=True)


def strength(case: random_blind_platform_cases_with_truth.DrawnCase) -> list[float]:
    """Signal-to-noise of each hidden effect, from corners as good as those of its images."""
    if not case.hidden:
        return []
    with tempfile.TemporaryDirectory() as folder:
        # writing draws noise from the case's rng, so that the case's own remains unchanged: another is written
        random_blind_platform_cases_with_truth.write_recording(
            replace(case, image_settings=None, rng=np.random.default_rng(0)), Path(folder) / "rec"
        )
        written = replace(
            recording_folder.load_recording(Path(folder) / "rec"),
            corners=random_blind_platform_cases_with_truth.simulated_corners(case),
        )
    world = case.simulation.world
    return platform_effect_signal_to_noise(written, world.true, case.noise, world.effects, case.simulation.sensors)[
        : len(case.hidden)
    ].tolist()


def drawn(
    keep: Path, kind: str, index: int
) -> tuple[random_blind_platform_cases_with_truth.DrawnCase, Recording, Path]:
    """(DrawnCase, its Recording, its truth's path) of a number: drawn, unless it was."""
    name = f"{kind}-{SEEDS[kind]}-{FRAMES[kind]}-{index}"
    case, folder, truth = drawn_case(kind, index), keep / name, keep / f"{name}.json"
    if not truth.exists():
        random_blind_platform_cases_with_truth.write_recording(case, folder)
        random_blind_platform_cases_with_truth.write_truth(case, truth, index=index, strengths=strength(case))
    return case, recording_folder.load_recording(folder), truth


def diagnosed(recorded: Recording, sampled: Sampled, out: Path) -> Path:
    """The diagnosis.json of a recording that was measured before."""
    out.mkdir(parents=True, exist_ok=True)
    found = diagnosis_of(recorded, sampled=sampled)
    write_diagnosis_json_and_simulation_files(out, found, recorded, diagnosis_report(found))
    return out / "diagnosis.json"


def right(case: blind_diagnosis_score.Case) -> bool:
    """Whether the one hidden effect is named first, at its place, and nothing else."""
    hidden = case.hidden[0]
    return (
        bool(case.named_or_remarked)
        and (case.named_or_remarked[0].effect, case.named_or_remarked[0].place) == (hidden.effect, hidden.place)
        and len(case.named) <= 1
    )


def line(kind: str, case: blind_diagnosis_score.Case) -> str:
    """What was hidden and what was found, in one line."""
    hidden = ", ".join(f"{h.effect} at {h.place} ({h.strength:.0f})" for h in case.hidden) or "nothing"
    found = ", ".join(f"{f.effect} at {f.place}" for f in case.found) or (
        "something left" if case.unexplained else "nothing"
    )
    remarks = ", ".join(f"{f.effect} at {f.place}" for f in case.remarks[:3])
    return f"{kind} {case.index}: hidden {hidden}; found {found}" + (f"; remarks {remarks}" if remarks else "")


def true(case: random_blind_platform_cases_with_truth.DrawnCase, sampled: Sampled) -> ImageFigures:
    """Told of a case's measurement."""
    m, T = sampled.measurement, case.simulation.run.T_base_platform
    errors = pose_difference(m.T_base_platform, T[m.frames])
    retained = m.observations.take(m.inliers)
    square = nees(retained.uv - true_corners(case, retained), retained.covariance)
    revisited_square = square[np.isin(retained.frame, np.flatnonzero(revisited(T)[retained.frames]))]
    return ImageFigures(
        joint_chi2(m, errors),
        len(errors),
        float(np.mean(nees(errors, m.covariance)) / 6),
        float(np.mean(square < INSIDE)),
        float(np.mean(revisited_square < INSIDE)) if len(revisited_square) else np.nan,
        m.noise / case.noise,
    )


def true_corners(case: random_blind_platform_cases_with_truth.DrawnCase, observations: Observations) -> np.ndarray:
    """(n, 2) px where the observed corners of a DrawnCase really are."""
    done, o = case.simulation, observations
    sighting, row = np.unique(np.stack([o.camera, o.frame, o.marker], axis=1), axis=0, return_inverse=True)
    seen = Sightings(o.frames[sighting[:, 1]], sighting[:, 0], sighting[:, 2])
    state = State(done.world.true.cameras, done.run.T_base_platform, {})
    quads = predict_sightings(
        seen, state, marker_map(done.world.true), done.plan.t, done.world.effects, done.sensors, done.run
    )
    return quads[row.ravel(), o.corner]


def revisited(T) -> np.ndarray:
    """(F,) bool, which poses lie within NEAR of an earlier or a later one. T : RigidTransform (F,)"""
    apart = np.array([np.abs(pose_difference(T, one)).max(axis=1) for one in T])
    return (apart < NEAR).sum(axis=1) > 1
