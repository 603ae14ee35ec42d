"""More legs than six: the six that tell a pose best, closures of the others as large as said, and a leg that is off
named.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from calib.certification import measuring_limb_calibration_slips_and_vision_agreement
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.loop_closure_checks_of_redundant_measuring_limbs import Limbs
from calib.correction.machine_correction import Correction
from calib.files import calibration_file
from calib.online import accepted_measuring_limbs_file
from rig.cli.command_line import main
from rig.errors import RigError
from rig.model.mechanisms import hexapod, redundant_strut_best_six_legs_and_loop_closures
from rig.planning.configuration_generators import sobol_configurations


@pytest.fixture(scope="module")
def machine(limbed):
    """(strut and limb Hexapods as they truly are, poses (40,))"""
    true = limbed[2].world.true
    limbs = measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(true)
    return (
        true.mechanism,
        limbs,
        hexapod.forward(sobol_configurations(true.mechanism.strut_range, 40, 0.8), true.mechanism),
    )


def legs(machine, sigma=(1e-6, 1e-6), covariance=None):
    none = np.zeros((42, 42))
    return redundant_strut_best_six_legs_and_loop_closures.combine_leg_sets(
        [
            (letter, m, np.full(6, s), none if covariance is None else covariance)
            for letter, m, s in zip("lm", machine[:2], sigma)
        ],
        machine[0].home,
    )


def lengths(machine):
    return np.hstack([hexapod.inverse(machine[2], m) for m in machine[:2]])


def test_legs_that_are_as_stated_close(machine):
    found = redundant_strut_best_six_legs_and_loop_closures.leg_closures(
        legs(machine), lengths(machine), np.array([0, 2, 4, 7, 9, 11])
    )
    assert np.abs(found.error).max() < 1e-10 and found.checks.tolist() == [1, 3, 5, 6, 8, 10]


def test_closures_scatter_as_expected_of_readings_and_geometry(machine):
    rng, half = np.random.default_rng(3), 2e-6 * np.eye(42)
    of, read, chosen, ratios = (
        legs(machine, (2e-6, 1e-6), half @ half),
        lengths(machine),
        np.array([0, 1, 2, 9, 10, 11]),
        [],
    )
    for _ in range(150):
        wrong = [
            replace(
                m,
                base_joints=m.base_joints + d[:18].reshape(6, 3),
                platform_joints=m.platform_joints + d[18:36].reshape(6, 3),
                strut_zeros=m.strut_zeros + d[36:],
            )
            for m, d in zip(machine[:2], 2e-6 * rng.normal(size=(2, 42)))
        ]
        as_believed = replace(
            of,
            **{
                name: np.concatenate([getattr(m, key) for m in wrong])
                for name, key in (("base", "base_joints"), ("platform", "platform_joints"), ("zeros", "strut_zeros"))
            },
        )
        found = redundant_strut_best_six_legs_and_loop_closures.leg_closures(
            as_believed, read + of.sigma * rng.normal(size=read.shape), chosen
        )
        ratios.append((found.error**2).mean(axis=0) / np.einsum("nii->ni", found.covariance).mean(axis=0))
    assert np.mean(ratios, axis=0) == pytest.approx(1.0, abs=0.25) and np.mean(ratios) == pytest.approx(1.0, abs=0.1)


def test_the_best_six_are_the_best_of_all(machine):
    of, T = legs(machine, (3e-6, 1e-6)), machine[2][:8]
    size = np.linalg.norm(of.platform - of.platform.mean(axis=0), axis=1).mean()
    J = (
        redundant_strut_best_six_legs_and_loop_closures.leg_lengths_and_pose_and_base_jacobians(of, T)[1]
        / np.repeat([1.0, size], 3)
        / of.sigma[:, None]
    )
    least = {
        six: min(np.linalg.svd(one[list(six)], compute_uv=False)[-1] for one in J)
        for six in list(combinations(range(12), 6))[::7]
    }
    best = redundant_strut_best_six_legs_and_loop_closures.best_six_leg_indices(of, T)
    assert min(np.linalg.svd(one[best], compute_uv=False)[-1] for one in J) >= max(least.values())
    assert not set(range(6)) & set(
        redundant_strut_best_six_legs_and_loop_closures.best_six_leg_indices(legs(machine, (1e-3, 1e-6)), T).tolist()
    ), "struts that nobody knows are not chosen"


def test_a_leg_that_is_off_is_named_whether_it_was_chosen_or_not(machine):
    for leg in (3, 8):
        read = lengths(machine) + 1e-6 * np.random.default_rng(0).normal(size=(40, 12)) - 3e-5 * np.eye(12)[leg]
        found = redundant_strut_best_six_legs_and_loop_closures.leg_closures(
            legs(machine), read, np.array([0, 1, 2, 3, 4, 5])
        )
        assert (
            found.share.argmax() == leg and found.off[leg] == pytest.approx(-3e-5, abs=2e-6) and found.share[leg] > 0.95
        )


def test_legs_that_leave_the_platform_loose_are_refused(machine):
    m = machine[0]
    flat = replace(
        m, base_joints=m.base_joints[[0, 0, 1, 1, 2, 2]], platform_joints=m.platform_joints[[0, 0, 1, 1, 2, 2]]
    )
    with pytest.raises(RigError):
        redundant_strut_best_six_legs_and_loop_closures.leg_closures(
            legs((flat, machine[1])),
            np.hstack([hexapod.inverse(machine[2], one) for one in (flat, machine[1])]),
            np.arange(6),
        )


def test_the_command_chooses_checks_and_names(limbed, tmp_path, capsys):
    design, read, done = limbed
    true, limbs, calibration, out = (
        done.world.true,
        tmp_path / "limbs.json",
        tmp_path / "c.json",
        tmp_path / "closures.csv",
    )
    T = done.run.T_base_platform[:30]
    agreement = measuring_limb_calibration_slips_and_vision_agreement.limb_agreement(
        T, T, np.zeros((30, 6, 6)), (1e-3, 1e-3)
    )
    known = 1e-14 * np.eye(42)
    accepted_measuring_limbs_file.save_limbs(
        limbs,
        accepted_measuring_limbs_file.Accepted(
            Limbs(
                measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(true),
                known,
                np.full(6, 1e-6),
            ),
            measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(design),
            agreement,
            None,
            {},
        ),
    )
    calibration_file.save(
        calibration,
        Calibration(Correction(design.mechanism, true.mechanism, (None,) * 6), known, np.zeros(6), (0,), (), None, {}),
    )
    given = [str(read.folder), "--calibration", str(calibration), "--limbs", str(limbs), "--out", str(out)]
    assert main(["closure", *given]) == 0
    output = capsys.readouterr().out
    assert (
        "12 legs for six freedoms" in output
        and "the best-conditioned six" in output
        and "times what is expected" not in output
    )
    assert out.read_text().startswith("frame,e_") and len(out.read_text().splitlines()) == 81
    assert main(["closure", *given, "--use", "l1,l2,l3,m4,m5,m6"]) == 0
    assert "l1, l2, l3, m4, m5, m6 give the pose, as requested" in capsys.readouterr().out
    assert main(["closure", str(read.folder), "--calibration", str(calibration)]) == 1
    assert "times what is expected" in capsys.readouterr().out
    for use, says in (
        ("l1,l2", "six different legs"),
        ("l1,l2,l3,l4,l5,x1", "six different legs"),
        ("l1,l1,l3,l4,l5,l6", "six different legs"),
    ):
        assert main(["closure", str(read.folder), "--use", use]) == 1
        assert says in capsys.readouterr().err
    assert main(["closure", str(tmp_path / "typo")]) == 1
