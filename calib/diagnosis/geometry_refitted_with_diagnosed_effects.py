"""Geometry refitted together with the effects that a diagnosis found.

For a calibration, on platforms and arms.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform
from threadpoolctl import threadpool_limits

from calib.certification.platform_certification import (
    Certified,
    Progress,
    certified_with_machine_draws_and_covariance,
    ignore_progress,
)
from calib.correction.machine_correction import AnyCorrection
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics, Unknown
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import Z95
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import LackOfFit
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    effects_shown_by_instruments,
)
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import (
    smoothed_temperatures_and_errors,
)
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import Sensitivities
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import (
    Refinement,
    refine_operating_point,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import (
    OperatingPoint,
    operating_point_source_and_measurement,
    remove_corners_far_from_prediction,
)
from calib.diagnosis.problems.platform.marker_swap_detection_and_effect_cross_validation import (
    find_outliers,
    operating_point_with_marker_swaps_corrected,
    operating_point_without_outliers,
)
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.diagnosis.report.diagnosis_json_entries import SCHEMA, UNKNOWN
from calib.diagnosis.smooth_curve_choice_for_unexplained_axis_errors import (
    arm_fit_with_curves_for_unexplained,
    refinement_with_curves_for_unexplained,
)
from calib.models.arm.arm_certification import UNPLACED, CertifiedArm, start_arm_of_fit
from calib.models.arm.arm_error_model_and_instrument_observations import observations_of_samples, parameter_names
from calib.models.arm.joint_effect_fit_and_held_out_scatter import History, JointFit, Prior, fit_geometry_and_effects
from calib.models.platform.platform_identification import Loops
from calib.samples.commanded_and_measured_pose_samples import Sampled, Samples, samples_of_movable_coordinates
from rig.array_and_json_types import Floats
from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.effect_base_class import MOTION_STAGES, Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import Coordinate, fit_coordinates_of_effects
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import Kinds
from rig.errors import FileError, RigError
from rig.formats import json_toml_and_yaml_loading, machine_geometry_and_effects_json_file
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.output_files.staged_folder_and_manifest import load_manifest as manifest
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters, require_arm, require_parallel
from rig.recording.frame_selection_and_content_hashes import content_hashes_of_frames, frames_with_known_hashes
from rig.recording.recording_folder import Recording


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """effects : found, with their values; sigma : (c,) standard deviation of each of their coordinates where another
    recording told them, which then count beside what this one tells; None where they are of this very recording;
    unknown : what has no name."""

    effects: tuple[Effect, ...]
    sigma: Floats | None
    unknown: tuple[Unknown, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PlatformRefit:
    """samples : Samples with what the physics adds to their commands; physics : Physics, of which the geometry does not
    know yet
    point : OperatingPoint of all samples, with the geometry that was refined with the physics."""

    samples: Samples
    physics: Physics
    point: OperatingPoint

    def with_geometry(self, done: Certified) -> tuple[Physics, Floats]:
        """(Physics, (p, p) m^2 covariance of the geometry), of a geometry certified on these samples and the physics
        together.
        """
        response = self._response(done)
        cross = response @ self.physics.own
        unknown = _with_what_is_corrected(self.physics.unknown, done.correction)
        covariance = done.found.covariance + cross @ response.T if done.covariance is None else done.covariance
        return replace(self.physics, cross=cross, unknown=unknown), covariance

    def drawn(self, done: Certified, rng: np.random.Generator) -> Certified:
        """The Certified with what the physics' own errors add to its machines."""
        if done.machines is None or not self.physics.own.any():
            return done
        errors = rng.multivariate_normal(
            np.zeros(len(self.physics.own)), self.physics.own, len(done.machines.parameters), method="eigh"
        )
        course = np.einsum("nac,dc->dna", self._columns(), errors)
        return certified_with_machine_draws_and_covariance(
            done, done.machines.with_more(errors @ self._response(done).T, course)
        )

    def _response(self, done: Certified) -> Floats:
        """(p, c) m, change of the fitted geometry with each coordinate of the physics."""
        found, s, base = done.found, self.samples, done.correction
        loops = Loops(s, s.effective - base.rho(s.effective), base.nominal, found.prior)
        start, sigma = geometric_parameters(found.mechanism), np.sqrt(np.diag(self.physics.own))
        middle = loops.fit(start, found.inliers, found.scatter).parameters
        response = np.zeros((len(start), len(sigma)))
        for i, column in enumerate(np.moveaxis(self._columns(), 2, 0)):
            if sigma[i] > 0 and column.any():
                moved = Loops(s, loops.lengths + sigma[i] * column, base.nominal, found.prior)
                response[:, i] = (moved.fit(start, found.inliers, found.scatter).parameters - middle) / sigma[i]
        return response

    def _columns(self) -> Floats:
        """(n, axes, c) m by which struts lengthen with each coordinate; nothing for those that only cameras see."""
        k, effects = self.point, self.physics.effects
        out = []
        for c in fit_coordinates_of_effects(effects):
            high, low = c.around(effects[c.effect])
            ends = [
                _motion((*effects[: c.effect], c.written(effects[c.effect], end), *effects[c.effect + 1 :]))
                for end in (high, low)
            ]
            out.append((k.effective(ends[0]) - k.effective(ends[1])) / (high - low))
        return np.stack(out, axis=2) if out else np.zeros((*self.samples.commanded.shape, 0))


def findings_of_diagnosis(diagnosis: Diagnosis) -> Findings:
    """Findings of a Diagnosis of the recording that is calibrated."""
    return Findings(diagnosis.machine_effects, None, unexplained_findings(diagnosis.left))


def findings_with_missing_instrument_effects_added(
    findings: Findings | None, recording: Recording, sampled: Sampled
) -> Findings | None:
    """Findings with the `effects_shown_by_instruments` of an arm, where none of that kind and place is known."""
    known = Findings((), None, ()) if findings is None else findings
    places = {(effect.form, effect.place) for effect in known.effects}
    more = tuple(e for e in effects_shown_by_instruments(recording, sampled) if (e.form, e.place) not in places)
    if not more:
        return findings
    sigma = known.sigma
    if sigma is not None:
        sigma = np.r_[sigma, np.full(len(fit_coordinates_of_effects(more)), np.inf)]
    return replace(known, effects=(*known.effects, *more), sigma=sigma)


def unexplained_findings(lacks_of_fit: Iterable[LackOfFit]) -> tuple[Unknown, ...]:
    """Findings that stay unexplained.

    What is left over and has no name.
    """
    return _one_of_each_place(
        [Unknown(str(u.place), u.magnitude, u.unit, tuple(u.depends_on), False) for u in lacks_of_fit]
    )


def _one_of_each_place(found: Sequence[Unknown]) -> tuple[Unknown, ...]:
    """The first Unknown of each place, with all that those of its place depend on."""
    places = {u.place: [v for v in found if v.place == u.place] for u in found}
    return tuple(
        replace(own[0], depends_on=tuple(dict.fromkeys(name for u in own for name in u.depends_on)))
        for own in places.values()
    )


def load_findings(folder: Path, recording: Recording, kinds: Kinds = BY_NAME) -> Findings:
    """Findings loaded from the folder of a diagnosis.

    kinds : effects that there are
    Raises FileError for a folder that holds none, or of another rig
    """
    if folder.is_dir() and not (folder / "diagnosis.json").exists():
        raise FileError(folder, "holds no diagnosis.json; --diagnosis requires a folder that `rig diagnose` wrote")
    tree = json_toml_and_yaml_loading.load_json(folder / "diagnosis.json", "diagnosis", SCHEMA)
    if not (folder / "machine.json").exists():
        raise FileError(
            folder / "machine.json",
            "no such file; --diagnosis requires a folder that `rig diagnose` wrote from a commanded recording",
        )
    _, effects = machine_geometry_and_effects_json_file.load_machine(folder / "machine.json", recording.design, kinds)
    entries = tree.tables("findings")
    unknown = _one_of_each_place([_unknown(entry) for entry in entries if entry.text("effect") == UNKNOWN])
    origin = manifest(folder).origin
    known = [line.partition(" ")[2] for line in origin.data] if origin is not None else []
    another = known and not frames_with_known_hashes(content_hashes_of_frames(recording), known)
    return Findings(effects, _sigma(effects, entries, tree) if another else None, unknown)


def _unknown(entry: Entries) -> Unknown:
    values = entry.table("parameters")
    size, names = values.table("magnitude"), values.table("depends_on")
    return Unknown(entry.text("place"), size.number("value"), size.text("unit"), names.texts("value"), False)


def _sigma(effects: tuple[Effect, ...], entries: list[Entries], tree: Entries) -> Floats:
    """(c,) standard deviations of effects' coordinates, by the intervals that their findings state."""
    out, left, found = [], list(entries), {}
    for number, effect in enumerate(effects):
        own = next((e for e in left if (e.text("effect"), e.text("place")) == (effect.name, effect.place)), None)
        if own is None:
            tree.fail(
                f"machine.json has {effect.name} at {effect.place}, which diagnosis.json does not list", "findings"
            )
        left.remove(own)
        found[number] = own.table("parameters")
    for c in fit_coordinates_of_effects(effects):
        value = found[c.effect].table(c.name)
        ends = value.get("ci95")
        if not isinstance(ends, list) or np.shape(ends)[:1] != (2,):
            value.fail(f"{value.name('ci95')} must hold two ends, not {ends}", "ci95")
        numbers = effects[c.effect].fitted(
            next(p for p in effects[c.effect].parameters if p.name == c.name)
        )  # which of a vector are listed
        estimates = np.array([value.get("value"), *ends], float)
        middle, low, high = map(c.measured, estimates if c.index is None else estimates[:, numbers.index(c.index)])
        out.append(max(abs(low - middle), abs(high - middle)) / Z95)  # one end may be cut off at a bound
    return np.array(out)


@threadpool_limits.wrap(limits=1)
def refit_platform_with_findings(
    recording: Recording, sampled: Sampled, findings: Findings, progress: Progress | None = None
) -> PlatformRefit:
    """Refit a platform with findings to a recording's samples (PlatformRefit).

    Cameras, geometry and the findings' parameters fitted together, without what is wild beside the findings, as a
    diagnosis leaves it out.
    Raises RigError for a machine without struts, and what refining raises
    """
    nominal = require_parallel(recording.design.mechanism)
    report = progress or ignore_progress
    report("refining physics and geometry jointly", 0, 1)
    point, _, _ = operating_point_source_and_measurement(recording, progress, sampled=sampled)
    point = operating_point_with_marker_swaps_corrected(point, [e for e in findings.effects if e.discrete])
    point = point.with_effects(e for e in findings.effects if not e.discrete)
    wild = find_outliers(point, _pose_covariance(point, sampled))
    retained = remove_corners_far_from_prediction(operating_point_without_outliers(point, wild))
    refined = refine_operating_point(retained, Sensitivities(retained.with_effects(())))
    refined, unknown = refinement_with_curves_for_unexplained(refined, findings.unknown)
    effects, own = _combined(refined, findings)
    report("refining physics and geometry jointly", 1, 1)
    k, samples = _at_all_frames(refined.point, point).with_effects(_motion(effects)), sampled.samples
    if any(e.stage not in MOTION_STAGES for e in findings.effects):  # what cameras left out moved every pose
        samples = samples_of_movable_coordinates(replace(samples, T_base_platform=k.T), recording.design.mechanism)
    known = replace(k, T=samples.T_base_platform).effective() - samples.commanded
    physics = _physics(effects, own, unknown, len(geometric_parameters(nominal)), recording, samples.t)
    return PlatformRefit(replace(samples, known=known), physics, k)


def _pose_covariance(point: OperatingPoint, sampled: Sampled) -> Floats:
    """(F, 6, 6) covariance of a point's poses, measured by an instrument or by cameras."""
    if point.own is not None:
        return point.own
    if sampled.measurement is None:
        raise ValueError("poses that no instrument measured come with the measurement by cameras")
    return sampled.measurement.covariance


def _at_all_frames(refined: OperatingPoint, point: OperatingPoint) -> OperatingPoint:
    """A point with the design, poses and effects of one that was refined with fewer of its frames; poses of the others
    stay.
    """
    poses = point.T.as_matrix().copy()
    poses[np.searchsorted(point.frames, refined.frames)] = refined.T.as_matrix()
    return replace(point, design=refined.design, T=RigidTransform.from_matrix(poses), effects=refined.effects)


def _combined(refined: Refinement, findings: Findings) -> tuple[tuple[Effect, ...], Floats]:
    """(effects, (c, c) covariance of their coordinates) as refined, and where another recording told them, by both
    together.
    """
    effects, own = [*refined.point.effects], refined.covariance
    coordinates: list[Coordinate] = refined.coordinates
    if findings.sigma is not None and refined.column is not None:
        retained = [e for e in findings.effects if not e.discrete]
        count = len(findings.sigma)  # curves for what has no name stand behind these, and are of this recording alone
        before = np.r_[[c.read(retained[c.effect]) for c in coordinates[:count]], refined.values[count:]]
        weight = np.diag(np.r_[1 / np.maximum(findings.sigma, 1e-300) ** 2, np.zeros(len(coordinates) - count)])
        loose = np.diag(np.r_[np.zeros(count), [c.loose**2 for c in coordinates[count:]]])
        own = cast(Floats, np.linalg.inv(refined.model.linear.project(refined.column).gram + weight + loose))
        for c, value in zip(coordinates, refined.values + own @ (weight @ (before - refined.values))):
            effects[c.effect] = c.written(effects[c.effect], value)
    return (*(e for e in findings.effects if e.discrete), *effects), own


def _motion(effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
    return tuple(e for e in effects if e.stage in MOTION_STAGES)


def median_and_spread_of_each_sensor_channel(recording: Recording, t: Floats) -> dict[str, tuple[float, float]]:
    """Median and standard deviation of each sensor channel at times t (n,) s.

    Returns {channel: (median, deviation)}
    """
    if recording.sensors is None:
        return {}
    values = {name: recording.sensors.at(t, name) for name in recording.sensors.channels}
    return {name: (float(np.median(v)), float(np.sqrt(np.mean((v - np.median(v)) ** 2)))) for name, v in values.items()}


def _with_what_is_corrected(unknown: Sequence[Unknown], correction: AnyCorrection) -> tuple[Unknown, ...]:
    """The Unknowns, with whether their axis, or any for the whole rig, is corrected over the configuration space."""
    places = mechanisms.axis_place_texts(correction.nominal)
    corrected = {place for place, part in zip(places, correction.remainder) if part is not None}
    return tuple(replace(u, corrected=u.place in corrected or (u.place == "rig" and bool(corrected))) for u in unknown)


def _physics(
    effects: tuple[Effect, ...], own: Floats, unknown: tuple[Unknown, ...], parameters: int, of: Recording, t: Floats
) -> Physics:
    """Physics whose covariance with the geometry's parameters is not known yet.

    own : (c, c) covariance of the effects' coordinates; parameters : of the geometry; t : (n,) s of the samples
    """
    design = of.design
    sensed = median_and_spread_of_each_sensor_channel(of, t)
    return Physics(
        effects,
        own,
        np.zeros((parameters, len(own))),
        design.gravity,
        design.actuator,
        design.platform,
        sensed,
        unknown,
        design.tilts,
    )


@dataclass(frozen=True, slots=True, eq=False)
class ArmRefit:
    """together : JointFit of what was found; physics : Physics, of which the geometry does not know yet."""

    together: JointFit
    physics: Physics

    def with_geometry(self, done: CertifiedArm) -> tuple[Physics, Floats]:
        """(Physics, (p, p) covariance of the geometry, m and rad), of a geometry certified on these samples and the
        physics together.
        """
        response = self.together.response(done.found)
        cross = response @ self.physics.own
        unknown = _with_what_is_corrected(self.physics.unknown, done.correction)
        return replace(self.physics, cross=cross, unknown=unknown), done.found.covariance + cross @ response.T


@threadpool_limits.wrap(limits=1)
def refit_arm_with_findings(
    recording: Recording, sampled: Sampled, findings: Findings, progress: Progress | None = None
) -> ArmRefit:
    """Refit an arm with findings to a recording's samples (ArmRefit).

    The arm's geometry and the findings' parameters fitted together.
    Raises RigError where neither poses nor positions were measured, and what identifying raises
    """
    report, samples, design = progress or ignore_progress, sampled.samples, recording.design
    nominal = require_arm(design.mechanism)
    if samples.measured in UNPLACED and samples.measured != "direction":
        raise RigError(
            f"physics is included where poses, positions or directions were measured: {UNPLACED[samples.measured]}"
        )
    commands = recording.commands
    if commands is None:
        raise RigError(f"{recording.folder}: nothing was commanded")
    report("refining physics and geometry jointly", 0, 1)
    before = None
    if findings.sigma is not None:
        before = Prior(
            np.array([c.read(findings.effects[c.effect]) for c in fit_coordinates_of_effects(findings.effects)]),
            findings.sigma,
        )
    start = start_arm_of_fit(observations_of_samples(samples), nominal, sampled.instrument)
    found = fit_geometry_and_effects(
        samples,
        History(design, commands, smoothed_temperatures_and_errors(recording.sensors)[0]),
        start,
        findings.effects,
        before,
    )
    found, unknown = arm_fit_with_curves_for_unexplained(found, findings.unknown)
    report("refining physics and geometry jointly", 1, 1)
    physics = _physics(found.effects, found.own, unknown, len(parameter_names(nominal)), recording, samples.t)
    return ArmRefit(found, physics)
