"""Passes over configurations, over poses and over both, in the whole of them and in a part: exact, undone, held out,
kept in order.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.configuration_space_correction_certification import claim_without_geometry
from calib.certification.platform_certification import corrected_platform_pose_covariance
from calib.correction import correction_field_methods_fitting_combination_and_json
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import (
    FieldSamples,
    RestrictedMap,
    SpacePart,
    SummedPasses,
)
from calib.correction.machine_correction import Correction
from calib.files import calibration_file
from calib.models.additional_correction_pass import CorrectionPass, certify_additional_pass
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.errors import FileError, NotEnoughData
from rig.model.mechanisms import hexapod
from rig.model.pose import exp, pose_difference
from rig.planning.configuration_generators import sobol_configurations
from synthetic import random_true_machine_and_truth_file
from tests.calib.noisy_samples import rms
from tests.numerical_derivatives import jacobian

OWN = np.repeat([1e-7, 1e-6], 3)  # m, rad; so little that what is left is the map's own
AXES = 6


def leaning(T):
    """The pose of a platform whose guide leans: its error grows with where it stands, whatever the struts do."""
    x = T.translation - [0.0, 0.0, 0.44]
    return T * exp(np.concatenate([1e-3 * x + 5e-3 * x * x[:, [1, 2, 0]], 1e-3 * x[:, ::-1]], axis=1))


@pytest.fixture(scope="module")
def machine(design):
    """(Calibration by the true geometry, Samples of the leaning machine at 200 configurations)."""
    true = random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(3)).true.mechanism
    before = Calibration(
        Correction(design.mechanism, true, (None,) * AXES),
        np.eye(42) * 1e-12,
        np.zeros(6),
        (),
        (),
        None,
        {"recording": "first", "created": "then", "data": ["1"]},
    )
    return before, seen(before, sobol_configurations(design.mechanism.strut_range, 200, 0.8, 5))


def seen(before, commands):
    n = len(commands)
    T = leaning(before.correction.predict(commands)) * exp(OWN * np.random.default_rng(1).normal(size=(n, 6)))
    return Samples(
        np.arange(n), np.arange(n) * 10.0, commands, T, np.tile(np.diag(OWN**2), (n, 1, 1)), np.zeros((n, 6, 0))
    )


def left(correction, before, wanted):
    """RMS m by which the leaning machine misses wanted poses."""
    return rms(pose_difference(wanted, leaning(before.correction.predict(correction.inverse(wanted)))))[0]


@pytest.mark.parametrize("space", ["pose", "both"])
def test_a_map_over_poses_takes_what_depends_on_the_pose(machine, design, space):
    before, samples = machine
    done, tried, count = certify_additional_pass(
        samples, before, CorrectionPass("polynomial", space), np.random.default_rng(0)
    )
    assert (
        count == 200
        and len(done.correction.posed) == 1
        and (done.correction.extension is not None) == (space == "both")
    )
    assert done.held_out.after.position[0] < 0.1 * tried[0].held_out.after.position[0]
    wanted = hexapod.forward(sobol_configurations(design.mechanism.strut_range, 50, 0.7, 9), design.mechanism)
    assert np.abs(pose_difference(done.correction.predict(done.correction.inverse(wanted)), wanted)).max() < 1e-11
    assert left(done.correction, before, wanted) < 0.05 * left(before.correction, before, wanted)
    made = Calibration(done.correction, done.found.covariance, done.found.scatter, (), (), None, {})
    stated = np.sqrt(np.trace(corrected_platform_pose_covariance(made, wanted)[:, :3, :3], axis1=1, axis2=2).mean())
    assert 0.2 * left(done.correction, before, wanted) < stated < 20 * left(done.correction, before, wanted)
    claim = claim_without_geometry(samples, done, np.random.default_rng(0))
    assert "in pose space" in claim.tolerance and claim.after[0][0] < 0.2 * claim.before[0][0]


def test_a_triangulation_of_poses_is_exact_at_them(machine):
    before, samples = machine
    some = samples.take(slice(0, 60))
    done, _, _ = certify_additional_pass(some, before, CorrectionPass("delaunay", "pose"), np.random.default_rng(0))
    assert np.abs(pose_difference(done.correction.predict(some.commanded), some.T_base_platform)).max() < 1e-10


def test_a_pass_in_a_part_leaves_the_rest_as_it_was_and_knows_it_no_better(machine, design):
    before, samples = machine
    low, high = np.full(6, -np.inf), np.full(6, np.inf)
    high[0] = 0.02  # m, x of poses
    done, _, count = certify_additional_pass(
        samples, before, CorrectionPass("polynomial", "pose", poses=SpacePart(low, high)), np.random.default_rng(0)
    )
    x = before.correction.predict(samples.commanded).translation[:, 0]
    assert count == (x <= 0.02).sum() < 200
    commands = sobol_configurations(design.mechanism.strut_range, 300, 0.8, 11)
    T, now = before.correction.predict(commands), done.correction.predict(commands)
    moved, off = (np.linalg.norm(pose_difference(T, other)[:, :3], axis=1) for other in (now, leaning(T)))
    inside, far = T.translation[:, 0] <= 0.02, T.translation[:, 0] > 0.05
    assert inside.sum() > 50 and far.sum() > 20
    assert rms(pose_difference(now[inside], leaning(T[inside])))[0] < 0.1 * np.sqrt((off[inside] ** 2).mean())
    assert moved[far].max() < 1e-15
    made = Calibration(done.correction, done.found.covariance, done.found.scatter, (), (), None, {})
    np.testing.assert_allclose(
        corrected_platform_pose_covariance(made, T[far]),
        corrected_platform_pose_covariance(before, T[far]),
        rtol=1e-6,
        atol=1e-20,
    )


def test_a_part_of_the_configuration_space_bounds_what_takes_part(machine):
    before, samples = machine
    low, high = np.full(6, -np.inf), np.full(6, np.inf)
    low[2] = np.median(samples.commanded[:, 2])
    done, _, count = certify_additional_pass(
        samples, before, CorrectionPass("polynomial", "configuration", SpacePart(low, high)), np.random.default_rng(0)
    )
    assert count == 100 and isinstance(done.correction.extension.fields[0], RestrictedMap)
    assert not done.correction.rho(samples.commanded - 0.05).any()
    with pytest.raises(NotEnoughData, match="none of 200 samples"):
        certify_additional_pass(
            samples,
            before,
            CorrectionPass("polynomial", "configuration", SpacePart(low + 9, high)),
            np.random.default_rng(0),
        )


def test_maps_of_both_spaces_are_kept_and_read_again(machine, tmp_path):
    before, samples = machine
    low, high = np.full(6, -np.inf), np.full(6, np.inf)
    high[2] = 0.45
    done, _, _ = certify_additional_pass(
        samples, before, CorrectionPass("polynomial", "both", poses=SpacePart(low, high)), np.random.default_rng(0)
    )
    source = calibration_file.additional_pass_provenance(
        {"recording": "b", "data": ["2"]}, before, {"number": 2, "space": "both"}
    )
    calibration_file.save(
        tmp_path / "c.json",
        Calibration(done.correction, done.found.covariance, done.found.scatter, (1,), (), done.held_out, source),
    )
    text = (tmp_path / "c.json").read_text()
    assert '"calibration/3"' in text
    loaded = calibration_file.load(tmp_path / "c.json")
    commands = samples.commanded[:40]
    assert np.abs(pose_difference(loaded.correction.predict(commands), done.correction.predict(commands))).max() < 1e-14
    assert loaded.provenance["pass"]["space"] == "both" and loaded.provenance["passes"] == [
        {"recording": "first", "created": "then"}
    ]
    (tmp_path / "c.json").write_text(text.replace('"rz"', '"ry"'))
    with pytest.raises(FileError, match="coordinates"):
        calibration_file.load(tmp_path / "c.json")


def test_a_part_is_whole_within_fades_smoothly_and_knows_its_slope():
    part = SpacePart(np.array([0.0, -np.inf]), np.array([1.0, 2.0]))
    assert part.weight(np.array([[0.5, 1.0], [0.0, 2.0], [1.0, -99.0]]))[0].tolist() == [1, 1, 1]
    assert part.weight(np.array([[1.11, 1.0], [-0.2, 1.0], [0.5, 2.2]]))[0].tolist() == [0, 0, 0]
    rng = np.random.default_rng(0)
    x = np.concatenate([rng.uniform(-0.2, 1.2, (300, 1)), rng.uniform(1.0, 2.2, (300, 1))], axis=1)
    field = RestrictedMap(
        correction_field_methods_fitting_combination_and_json.fit_field(
            "polynomial", FieldSamples(x, np.sin(x), np.full(x.shape, 1e-6), np.array([[-0.2, 1.2], [1.0, 2.2]]))
        ),
        part,
    )
    for one in x[:40]:
        np.testing.assert_allclose(field.gradient(one), jacobian(field.value, one), atol=1e-4)
    assert (field.error(x) >= 0).all() and not field.inside(np.array([[1.05, 1.5]])).any()


@pytest.mark.parametrize("low, high", [([0.0], [0.0]), ([1.0], [0.0]), ([-np.inf], [np.inf])])
def test_a_part_that_bounds_nothing_is_refused(low, high):
    with pytest.raises(ValueError, match="part"):
        SpacePart(np.array(low), np.array(high))


def test_an_earlier_pass_speaks_where_a_later_one_does_not_hold():
    x = np.linspace(0, 1, 21)[:, None]
    first, second = (
        correction_field_methods_fitting_combination_and_json.fit_field(
            "polynomial", FieldSamples(x, size * x, np.full((21, 1), size**2), np.array([[0.0, 1.0]]))
        )
        for size in (1.0, 0.1)
    )
    both = SummedPasses((first, RestrictedMap(second, SpacePart(np.array([-np.inf]), np.array([0.5])))))
    at = np.array([[0.2], [0.9]])
    np.testing.assert_allclose(both.error(at), [second.error(at)[0], first.error(at)[1]])
    assert replace(both, fields=(first, second)).error(at) == pytest.approx(second.error(at))
