"""An arm's commands undo what was found at its joints: seven kinds, three arms each, 60 poses driven, beside the same
arm without the effect.

A tracker measures a PUMA 560 with its wrist and, of the last kind, positions alone; each arm is simulated, diagnosed,
calibrated with what was found and plainly, and both are driven through new poses all over what was visited. Errors are
against simulated truth.
"""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.diagnosis.geometry_refitted_with_diagnosed_effects import findings_of_diagnosis, refit_arm_with_findings
from calib.files.calibration_file import calibration_with_provenance
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_certification import certify_arm
from calib.models.arm.joint_space_correction_and_workspace_claim import arm_workspace_claim
from calib.models.wanted_pose_commands import commands_along_route
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.effects.framework.effect_base_class import Effect
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.pose import pose_difference
from rig.planning import recording_plan as plan
from rig.planning.configuration_generators import sobol_configurations
from rig.planning.layout import shipped_arms_and_layouts
from rig.recording import recording_folder
from rig.recording.recording_folder import Recording
from synthetic import random_true_machine_and_truth_file, recording_simulation
from synthetic.random_true_machine_and_truth_file import World
from tests.calib.diagnose_recording import diagnosis_of

ARMS, ROUTE, POSES, REACH = 3, "sobol:150", 60, 0.7
NEAR_SINGULAR = 0.02  # least over greatest singular value; where a wrist is near it, a micrometre may be out of reach
SIZES = {  # what is drawn log-uniform between stands in braces
    "backlash": ("backlash:joint {joint}:gap={gap}", {"gap": (3e-4, 2e-3)}),
    "hysteresis": (
        "hysteresis:joint {joint}:range={range},weight={weight}",
        {"range": (0.2, 0.8), "weight": (5e-4, 2e-3)},
    ),
    "gear": (
        "cyclic_error:joint {joint}:amplitude={amplitude},order=1.0,phase={phase}",
        {"amplitude": (2e-4, 8e-4), "phase": (0.1, 3)},
    ),
    "teeth": (
        "cyclic_error:joint {joint}:amplitude={amplitude},order={order},phase={phase}",
        {"amplitude": (5e-5, 2e-4), "order": (20, 120), "phase": (0.1, 3)},
    ),
    "sag": ("compliance:joint {heavy}:moments={moments}", {}),
    "profile": ("transmission_error:joint {joint}:profile={profile}", {}),
    "backlash, positions": ("backlash:joint {joint}:gap={gap}", {"gap": (3e-4, 2e-3)}),
}


class Ways(NamedTuple):
    """RMS errors of driven poses, m and rad: known (physics taken in), plain, without (the same arm without the
    effect); stated : m and rad, standard uncertainty of the first."""

    known: np.ndarray
    plain: np.ndarray
    without: np.ndarray
    stated: np.ndarray


def effect_of(name: str, rng: np.random.Generator) -> Effect:
    """One of a kind of a size that shows, at one of the first five joints; the sag at the second or third."""
    text, sizes = SIZES[name]
    values = {key: float(np.exp(rng.uniform(np.log(low), np.log(high)))) for key, (low, high) in sizes.items()}
    profile = 3e-4 * np.cumsum(rng.normal(size=8)) / np.sqrt(8)
    moments = np.zeros((6, 4))
    moments[2, 1:] = 3e-5 * rng.uniform(0.5, 2) * rng.normal(size=3)
    return parse_effect(
        text.format(
            joint=rng.integers(1, 6),
            heavy=rng.integers(2, 4),
            profile="/".join(f"{x:.6g}" for x in profile - profile.mean()),
            moments="/".join(f"{x:.6g}" for x in moments.ravel()),
            **values,
        )
    )


def ways(folder: Path, name: str, seed: int) -> Ways:
    """Ways of one arm."""
    text = shipped_arms_and_layouts.shipped_arm_rig_toml("puma560")
    if name.endswith("positions"):
        text = "\n".join(line for line in text.splitlines() if not line.startswith("rotation_sigma")) + "\n"
    effect = effect_of(name, np.random.default_rng([seed, 7]))
    played, secret = _recorded(folder / "with", text, seed, (effect,))
    bare, innocent = _recorded(folder / "without", text, seed, ())
    known, stated = _driven(played, secret, True)
    plain, without = _driven(played, secret, False)[0], _driven(bare, innocent, False)[0]
    return Ways(known, plain, without, stated)


def _recorded(folder: Path, text: str, seed: int, effects: tuple[Effect, ...]) -> tuple[Recording, World]:
    folder.mkdir(parents=True)
    (folder / "rig.toml").write_text(text)
    design, rng = design_from_rig_toml.load_design(folder / "rig.toml"), np.random.default_rng(seed)
    secret = random_true_machine_and_truth_file.random_true_machine(design, rng, 1.0, effects)
    recording_simulation.write_recording(
        recording_simulation.simulate_world(secret, plan.build_plan(design, ROUTE, seed), rng),
        folder / "rec",
        text,
        rng,
    )
    return recording_folder.load_recording(folder / "rec"), secret


def _driven(rec: Recording, secret: World, physics: bool) -> tuple[np.ndarray, np.ndarray]:
    """((2,) RMS error of driven poses, (2,) its stated standard uncertainty, NaN without physics), m and rad."""
    sampled, rng = sample_recording(rec), np.random.default_rng(0)
    physics_fit = refit_arm_with_findings(rec, sampled, findings_of_diagnosis(diagnosis_of(rec))) if physics else None
    done = certify_arm(
        sampled.samples,
        rec.design.mechanism,
        sampled.instrument,
        rng,
        physics=None if physics_fit is None else physics_fit.together,
    )
    samples = sampled.samples if physics_fit is None else physics_fit.together.samples
    calibration = calibration_with_provenance(
        rec,
        sampled,
        done,
        arm_workspace_claim(samples, done, rng),
        (),
        None if physics_fit is None else physics_fit.with_geometry(done),
    )
    seen = np.stack([sampled.samples.commanded.min(axis=0), sampled.samples.commanded.max(axis=0)], axis=1)
    q = sobol_configurations(seen, 2 * POSES, REACH, 17)
    values = np.linalg.svd(
        arm_error_model_and_instrument_observations.joint_jacobian(q, secret.true.mechanism), compute_uv=False
    )
    T = arm_error_model_and_instrument_observations.predicted_target_poses(
        q[values[:, -1] > NEAR_SINGULAR * values[:, 0]][:POSES], done.correction.fitted
    )  # its own idea of how the hand is turned
    made = commands_along_route(calibration, T, np.zeros(len(seen)))
    run = motion_simulation.simulate_machine_run(
        secret.true, made.route.commands(np.round(made.values, 10)), made.route.times, secret.effects
    )
    error = _rms((pose_difference(T, run.T_base_platform) ** 2).reshape(-1, 2, 3))
    return error, np.full(2, np.nan) if made.covariance is None else _rms(
        np.einsum("nii->ni", made.covariance).reshape(-1, 2, 3)
    )


def _rms(squares: np.ndarray) -> np.ndarray:
    """(2,) of squares (n, 2, 3)."""
    return np.sqrt(squares.sum(axis=2).mean(axis=0))


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    with tempfile.TemporaryDirectory() as folder:
        for name in SIZES:
            found = [
                ways(Path(folder) / name.replace(", ", "-") / str(k), name, 100 * list(SIZES).index(name) + k)
                for k in range(ARMS)
            ]
            for one in found:
                print(
                    f"  {name}: um " + ", ".join(f"{key} {getattr(one, key)[0] * 1e6:.1f}" for key in one._fields),
                    file=sys.stderr,
                    flush=True,
                )
            known, plain, without, stated = (np.array([getattr(one, key)[0] for one in found]) for key in Ways._fields)
            yield (
                f"{name}: position error with physics over that without the effect, median of {ARMS}",
                f"{np.median(known / without):.2f}",
                "<= 1.5",
            )
            yield f"{name}: the same over what the commands state", f"{np.median(known / stated):.2f}", "0.5 to 2"
            reached = (
                f"{np.median(plain / without):.2f}; {np.median(known) * 1e6:.1f} / {np.median(plain) * 1e6:.1f} / "
                f"{np.median(without) * 1e6:.1f} um"
            )
            yield f"{name}: the same corrected plainly; um with physics / plain / without the effect", reached, ""
