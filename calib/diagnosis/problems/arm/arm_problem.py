"""The arm as a Problem of the diagnosis engine.

Effects at its joints, linear about the geometry; nested selection.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import ARM, SelectionPolicy, StatedTerms
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import (
    FOLDS,
    STRETCHES,
    CrossValidation,
    make_refit_without_columns,
    signed_rank_gain_in_standard_errors,
    time_stretch_folds,
)
from calib.diagnosis.engine.forward_and_backward_term_selection import (
    remove_redundant_terms,
    select_and_fit_terms_without_alternatives,
)
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import LackOfFit
from calib.diagnosis.engine.linear_residual_model import Column, LinearModel
from calib.diagnosis.engine.problem_interface import Progress, Wald
from calib.diagnosis.engine.term_confirmation_against_alternative_candidates import labelled_progress
from calib.diagnosis.problems.arm import arm_lack_of_fit_covariates_and_joint_formulas as remainder
from calib.diagnosis.problems.arm.arm_candidate_chi_square_scores import (
    candidate_column_at_scanned_parameters,
    candidate_with_grid_nodes,
    score_candidates,
)
from calib.diagnosis.problems.arm.finding_parameter_optimisation_and_intervals import has_continuous_parameters
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    JointCandidate,
    JointScore,
)
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import Arms, Geometry
from calib.diagnosis.problems.arm.load_term_reselection import fit_with_load_terms_chosen_anew
from calib.diagnosis.problems.arm.profile_and_sinusoid_simplification import (
    FINE,
    QUICK,
    candidates_compatible_with_terms,
    choose_forms_of_laws,
    merge_sinusoids_into_profiles,
    optimise_terms,
    refine_knots_and_parameters,
    simplify_profiles,
)
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import Fit, Term, fit_terms_to_poses
from calib.diagnosis.problems.evidence_interface_and_requested_effects import HeldOutPoses
from calib.identify.bounded_and_robust_least_squares_fit import time_block_folds
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.compute.parallel_map_and_dask_cluster import parallel_map
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr

ALIASES = 3  # other orders of a sinusoid that are looked at
KNOWN = 0.5  # numbers that data must determine of a term for it to be tested
PARTS = 3
FINE_PARTS, COARSE_PARTS = 30, 6  # stretches of time; every third is held out at once


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ArmProblem(FieldSummaryRepr):
    """arms : Arms; candidates : asked for; train : (n,) bool, poses that may be fitted, None for all;
    policy : thresholds
    given : what is said beforehand; geometry : Geometry that the poses are linear about, None where nobody asks for it
    What an instrument may do on its own is in the poses' covariance, so there are no tolerances; smooth functions of an
    arm's other joints are no freedom of anything, so none cover a term: it stands on its stretches held out"""

    arms: Arms
    candidates: list[JointCandidate]
    train: Booleans | None = None
    policy: SelectionPolicy = ARM
    given: StatedTerms = StatedTerms()
    geometry: Geometry | None = None

    def start(self) -> Fit:
        return fit_terms_to_poses(self.arms, (), self.train)

    def terms(self, fit: Fit) -> list[JointCandidate]:
        return [term.candidate for term in fit.terms]

    def size(self, fit: Fit) -> int:
        return fit.size

    def residual(self, fit: Fit) -> Fit:
        return fit

    def without_term(self, fit: Fit, number: int) -> Fit:
        return fit.without_terms([number])

    def linear(self, model: Fit) -> LinearModel:
        return model.linear

    def admissible(self, fit: Fit) -> list[JointCandidate]:
        return candidates_compatible_with_terms(fit, self.candidates)

    def search(
        self,
        model: Fit,
        candidates: list[JointCandidate],
        least: float = 0.0,
        progress: Callable[[int, int], None] | None = None,
    ) -> list[JointScore]:
        return score_candidates(model, candidates, least, self.policy.cluster, progress)

    def rescored(self, model: Fit, fit: Fit, number: int) -> JointScore:
        return self.search(model, [fit.terms[number].only], -np.inf)[0]

    def aliases(self, model: Fit, own: JointScore, score: JointScore) -> list[JointScore]:
        """Other orders of a sinusoid that explain as much, where commands stood on a lattice of angles."""
        candidate = score.candidate
        if not candidate.step:
            return []
        c, apart, grid, name = score.curve, candidate.step / FINE, candidate.grid, candidate.sought
        peaks = [
            i
            for i in range(1, len(c) - 1)
            if c[i] >= max(c[i - 1], c[i + 1]) and abs(grid[i][name] - own.node[name]) > apart
        ]
        best = sorted(peaks, key=lambda i: -c[i])[:ALIASES]
        return [other for i in best for other in self.search(model, [candidate_with_grid_nodes(candidate, [grid[i]])])]

    def column(self, model: Fit, score: JointScore) -> Column:
        return candidate_column_at_scanned_parameters(model, score)

    def add_term(self, fit: Fit, score: JointScore) -> Fit:
        return fit.with_terms([Term.of(score)])

    def companion(self, fit: Fit, score: JointScore) -> JointScore | None:
        repeated = self.search(fit, [candidate_with_grid_nodes(score.candidate, [score.node])])
        return replace(repeated[0], candidate=score.candidate) if repeated else None

    def remove_term(self, fit: Fit, number: int) -> Fit:
        return self._weighed(fit, [t for i, t in enumerate(fit.terms) if i != number])

    def exchange_term(self, fit: Fit, number: int, score: JointScore) -> Fit:
        return self.add_term(self.remove_term(fit, number), score)

    def in_place(self, fit: Fit, number: int) -> Fit:
        return self._weighed(fit, [*fit.terms[:number], fit.terms[-1], *fit.terms[number:-1]])

    def _weighed(self, now: Fit, terms: list[Term]) -> Fit:
        return fit_terms_to_poses(self.arms, terms, self.train, now.weighing, rounds=QUICK)

    def refine_terms(self, fit: Fit) -> Fit:
        fit = choose_forms_of_laws(fit, self.candidates, self.train, self.policy, self.given)
        return refine_knots_and_parameters(fit, self.train, self.policy)

    def simplify_terms(self, now: Fit) -> Fit:
        now = merge_sinusoids_into_profiles(now, self.candidates, self.train, self.policy, self.given)
        now = remove_redundant_terms(self, simplify_profiles(now, self.candidates, self.train, self.policy, self.given))
        anew = fit_with_load_terms_chosen_anew(self, now, self.candidates, self.train, self.given)
        now = now if anew is now else remove_redundant_terms(self, self.refine_terms(anew))
        now = optimise_terms(now, [term for term in now.terms if has_continuous_parameters(term)])
        return fit_terms_to_poses(self.arms, now.terms, self.train, now.weighing)

    def wald(self, fit: Fit, number: int) -> Wald:
        one, here = fit.terms[number], fit.slices[number]
        theta, covariance = fit.theta[here], fit.covariance(number)
        known = len(theta) - np.trace(covariance / one.prior**2)
        spread = covariance - covariance @ (
            covariance / one.prior[:, None] ** 2
        )  # scatter of the sizes, that of the priors left out
        statistic = theta @ np.linalg.pinv(spread, rcond=1e-9, hermitian=True) @ theta if known > KNOWN else 0.0
        return Wald(float(statistic), float(known))

    def likelihood_ratio(self, fit: Fit, other: Fit) -> float:
        return fit.cost() - other.cost()

    def cross_validations(self, fit: Fit, numbers: list[int]) -> list[CrossValidation]:
        return self._validations(fit, numbers)

    def by_regions(self, fit: Fit, numbers: list[int]) -> list[list[CrossValidation]]:
        """For each joint, CrossValidation of some terms where whole regions of that joint's travel are held out in
        turn.
        """
        angles = self.arms.q[fit.used]
        return [self._validations(fit, numbers, q) for q in angles.T]

    def _validations(self, now: Fit, numbers: list[int], along: Floats | None = None) -> list[CrossValidation]:
        """CrossValidation of each term alone; misfit in m, RMS of a position per axis.

        along : (m,) what the poses used are put in order by, stretches of which are held out whole; None for time, in
            many short stretches
        """
        W, target = now.W[now.used], now.target[now.used]
        order = np.arange(len(W)) if along is None else np.argsort(along, kind="stable")
        fold = time_stretch_folds(len(now.arms), STRETCHES)[now.used] % FOLDS
        if along is not None:
            fold[order] = time_block_folds(len(order), FOLDS)
        parts = [now.X.take(fold == f) for f in np.unique(fold)]
        rows = [fold == f for f in np.unique(fold)]
        sizes = make_refit_without_columns(
            [p.gram() for p in parts],
            [p.onto(target[r][..., None])[:, 0] for p, r in zip(parts, rows)],
            now.information,
        )

        def figures(gone: Integers) -> tuple[Floats, float]:
            white = target.copy()
            for part, at, size in zip(parts, rows, sizes(gone)):
                white[at] -= part.at(size[:, None])[..., 0]
            left = np.linalg.solve(W, white[..., None])[:, :3, 0]
            return (white**2).sum(axis=1), float(np.sqrt((left**2).mean()))

        squares, after = figures(np.arange(0))
        own = np.einsum("nkk->nk", now.arms.own)[now.used, :3]
        floor, out = float(np.sqrt(own.mean())), []
        for number in numbers:
            lacking, before = figures(np.arange(now.X.count)[now.slices[number]])
            out.append(
                CrossValidation(
                    before, after, floor, now.arms.unit, signed_rank_gain_in_standard_errors((lacking - squares)[order])
                )
            )
        return out

    def lack_of_fit(self, model: Fit, place: Place | None = None) -> list[LackOfFit]:
        if place is None:
            return remainder.find_lack_of_fit_by_joint(model, correlated_frames=self.policy.cluster)
        return remainder.find_lack_of_fit_by_joint(
            model, correlated_frames=self.policy.cluster, place=place, alpha=self.policy.alpha
        )

    def within(self, left: LackOfFit, place: Place) -> bool:
        return left.place == place


def held_out_poses_by_nested_selection(
    problem: ArmProblem, time_stretch_counts: tuple[int, ...], progress: Progress | None = None
) -> list[HeldOutPoses]:
    """Held-out poses (HeldOutPoses) by nested selection, over each of the numbers of time stretches.

    Effects are chosen, and all is fitted, on two thirds of the stretches at a time.
    """
    arms, retained = problem.arms, np.ones(len(problem.arms), bool) if problem.train is None else problem.train
    parts = [time_stretch_folds(len(arms), count) % PARTS for count in time_stretch_counts]

    def predicted(one: tuple[int, int]) -> tuple[Floats, Floats, tuple[str, ...]]:
        part = parts[one[0]] == one[1]
        with threadpool_limits(1):
            chosen, bare = (
                select_and_fit_terms_without_alternatives(replace(problem, train=retained & ~part)),
                fit_terms_to_poses(arms, (), retained & ~part),
            )
        return (
            bare.left[part],
            chosen.left[part],
            tuple(f"{t.candidate.name} {t.candidate.place}" for t in chosen.terms),
        )

    things = [(i, k) for i in range(len(time_stretch_counts)) for k in range(PARTS)]
    found = dict(
        zip(
            things,
            parallel_map(
                predicted, things, labelled_progress(progress, "reselecting without stretches"), items_per_process=1
            ),
        )
    )
    out = []
    for i, (count, part) in enumerate(zip(time_stretch_counts, parts)):
        before, after, far = np.empty(arms.left.shape), np.empty(arms.left.shape), np.empty(len(arms))
        for k in range(PARTS):
            before[part == k], after[part == k], _ = found[i, k]
            far[part == k] = _farthest(arms.q[part == k], arms.q[(part != k) & retained])
        out.append(
            HeldOutPoses(
                before[retained], after[retained], count, tuple(found[i, k][2] for k in range(PARTS)), far[retained]
            )
        )
    return out


def _farthest(q: Floats, fitted: Floats) -> Floats:
    """(m,) rad: over the joints, the greatest distance of angles q (m, joints) from the nearest of fitted (n,
    joints).
    """
    return np.stack([cKDTree(b[:, None]).query(a[:, None])[0] for a, b in zip(q.T, fitted.T)]).max(axis=0)
