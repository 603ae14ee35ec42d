"""Geometry, a screw's profile and a load that bends: physics, parameters, a grid of 729 poses and a smooth map, each by
itself, driven to 200 poses.

Corner level, no images. The floor is what measuring repeats to: the standard uncertainty of one measured pose, what all
poses share left out.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.correction_field_methods_fitting_combination_and_json import (
    fit_correction_summand_field,
    fitted_or_nominal_geometry,
    identified_geometry_correction_with_field,
    measured_correction_summands,
)
from calib.diagnosis.geometry_refitted_with_diagnosed_effects import findings_of_diagnosis
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.rigs_with_unmodelled_physics import REQUESTED, driven, learnt, write

EFFECTS = ("transmission_error:strut2:profile=0/2e-5/-2e-5/3e-5/0/2e-5/-3e-5/1e-5", "compliance:rig:stiffness=3e6")
ROUTE, GRID = "sobol:60,ladder:2,payload:10,moving:8,warmup:16", "grid:3"
POSES, SEED = 200, 41


def by_field(sampled, design, kind) -> Calibration:
    """Calibration of KSF by a way of extending it alone, on the nominal model."""
    samples, nominal = sampled.samples, design.mechanism
    found = fitted_or_nominal_geometry(samples, nominal, True)
    correction = identified_geometry_correction_with_field(
        nominal, found, fit_correction_summand_field(measured_correction_summands(samples, nominal), kind)
    )
    return Calibration(
        correction, found.covariance, found.scatter, tuple(samples.frame.tolist()), (), None, {}, None, None
    )


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(text := hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3))
        design, effects = design_from_rig_toml.load_design(path), [parse_effect(one) for one in EFFECTS]
        recording, secret = write(Path(folder) / "rec", design, text, SEED, effects, ROUTE)
        sampled = sample_recording(recording)
        cube, _ = write(
            Path(folder) / "grid", design, text, SEED, effects, GRID
        )  # the same secret machine: its seed is the same
        on_grid = sample_recording(cube)
        own = sampled.samples.covariance
        floor = float(np.sqrt(np.trace(own[:, :3, :3], axis1=1, axis2=2).mean()))
        ways = {
            "physics": learnt(
                recording, sampled, findings_of_diagnosis(diagnosis_of(recording, only=REQUESTED, sampled=sampled))
            ),
            "parameters alone": learnt(recording, sampled, None, "none"),
            "grid alone, 729 poses, n-linear": by_field(on_grid, design, "linear"),
            "smooth map alone, radial": by_field(sampled, design, "radial"),
        }
        yield "one measured pose, standard uncertainty", f"{floor * 1e6:.2f} um", ""
        for name, calibration in ways.items():
            position, rotation = driven(calibration, secret, SEED + 1000, poses=POSES).error
            yield (
                f"{name}: error of {POSES} poses driven, over what measuring repeats to",
                f"{position / floor:.2f}; {position * 1e6:.1f} um, {rotation * 1e6:.1f} urad",
                "<= 1.3" if name == "physics" else "",
            )
