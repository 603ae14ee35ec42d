"""Claim of an arm's calibration over its workspace: errors before and after correction, by draws of possible arms."""

from dataclasses import replace

import numpy as np

from calib.certification.error_claim_over_workspace import (
    DRAWS,
    PLACES,
    Claim,
    ConfigurationInformation,
    Workspace,
    claim_from_machine_draws,
    draw_variance_ratio,
    empty_claim_of_too_few_configurations,
    mean_square_pose_errors_of_extension,
)
from calib.certification.held_out_pose_errors_and_distinct_configurations import mean_sample_per_configuration
from calib.models.arm.certification import UNPLACED, CertifiedArm
from calib.models.arm.error_model_and_observations import (
    joint_jacobian,
    parameter_jacobian,
    predicted_target_poses,
    sample_observations,
)
from calib.models.arm.identification_and_joint_profiles import identify_arm, independent_arm_parameters
from calib.models.arm.joint_effect_fit_and_held_out_scatter import unexplained_scatter_sentences
from calib.samples.pose_samples import Samples
from rig.model.pose import pose_difference
from rig.planning.configuration_generators import FILL, sobol_configurations


def arm_workspace_claim(samples: Samples, certified: CertifiedArm, rng: np.random.Generator) -> Claim:
    """Claim of a certified arm over its workspace of recorded joint angles, each configuration once."""
    found, correction = certified.found, certified.correction
    good = found.inliers
    if samples.measured in UNPLACED:
        fitted = int(found.rank.free.sum())
        return Claim(
            int(certified.label.max()) + 1,
            fitted,
            fitted,
            found.rank.asked,
            "all determined parameters are fitted without one",
            "none",
            None,
            None,
            None,
            None,
            UNPLACED[samples.measured],
        )
    kept, hands = samples.take(good), max(len(found.arm.hands), 1)
    numbers = certified.label[good] * hands + (0 if kept.hand is None else kept.hand)
    label = np.unique(numbers, return_inverse=True)[1]
    each = mean_sample_per_configuration(kept, label, joint_jacobian(kept.commanded, found.arm, kept.hand))
    words = f"the middle {FILL * 100:.0f} % of the recorded angles, all joints independent"
    fitted = int(found.rank.free.sum())
    configurations = len(np.unique(certified.label[good]))
    told = ConfigurationInformation(
        configurations, fitted, fitted, found.rank.asked, "all determined parameters are fitted without one"
    )
    if certified.held_out is None:
        return empty_claim_of_too_few_configurations(told, words)
    seen = np.stack([each.commanded.min(axis=0), each.commanded.max(axis=0)], axis=1)
    q = sobol_configurations(seen, PLACES, FILL)
    hand = None if kept.hand is None else np.arange(len(q)) % hands  # the hands in turn
    T = (
        correction.predict(q)
        if hand is None
        else predicted_target_poses(q - correction.rho(q), correction.fitted, hand)
    )
    stated = mean_square_pose_errors_of_extension(correction, q, joint_jacobian(q, found.arm, hand))
    own = certified.left.own_draws(float(stated[0]), DRAWS, rng) if certified.left is not None else stated
    workspace = Workspace(
        parameter_jacobian(q, correction.fitted, hand),
        pose_difference(predicted_target_poses(q, correction.nominal, hand), T),
        own,
        words,
    )
    observed = sample_observations(each)
    free = independent_arm_parameters(
        correction.nominal, observed.kind
    )  # of the figures stated: axes found a little off parallel tell no more
    again = identify_arm(replace(observed, q=observed.q - correction.rho(observed.q)), correction.fitted, free)
    whitened = np.linalg.solve(
        np.linalg.cholesky(observed.covariance + np.diag(again.scatter**2)), again.residuals[..., None]
    )[again.inliers]
    freedom = max(whitened.size - int(again.rank.free.sum()), 1)
    draws = rng.multivariate_normal(np.zeros(len(again.covariance)), again.covariance, DRAWS, method="eigh")
    draws *= np.sqrt(draw_variance_ratio(float((whitened**2).sum()), freedom, DRAWS, rng))[:, None]
    return replace(
        claim_from_machine_draws(workspace, draws, each, told, rng),
        unexplained=unexplained_scatter_sentences(again.scatter, observed.covariance),
    )
