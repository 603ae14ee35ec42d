"""Cross-validation of an adjustment, and which unknowns its recording determines.

By held-out frames; determinacy says which unknowns the recording determines.
"""

import re
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from rig.array_and_json_types import Booleans, Floats
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import (
    Estimate,
    Unknowns,
    datum_marker_rows,
    estimate_offset_from_stated,
)
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import (
    POSE_SIGMA,
    adjustment_unknowns_and_start_estimate,
)
from vision.bundle.bundle_adjustment import Adjustment
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    normal_equations,
    schur_complement,
    whitened_residuals_and_derivatives,
)
from vision.corner_observations_and_merging import Observations, observations_of_frames, whitener_of_observations

FOLDS = 10
ALONE = 1e-9  # of the information in some direction; a stretch whose absence leaves less was the only one to tell it


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Residuals of held-out frames, each frame's own poses fitted anew.

    chi2 : their squares, whitened by the covariance predicted for them: the corners' and that of the shared unknowns,
    had from the other frames; expected : degrees of freedom; scatter : standard error of chi2 / expected
    rms : px per axis, of all held-out corners; corners : how many
    """

    chi2: float
    expected: float
    scatter: float
    rms: float
    corners: int

    @property
    def ratio(self) -> float:
        """Residuals' squares over the predicted ones: 1 where the covariance is true."""
        return self.chi2 / self.expected


@dataclass(frozen=True, slots=True)
class NotHeldOut:
    """Why no stretch could be held out; falsy."""

    reason: str

    def __bool__(self) -> Literal[False]:
        return False


class _Stretch(NamedTuple):
    """Normal equations of a stretch of frames, whitened, the frames' own unknowns taken out.

    reduced : (s, s), right : (s,) of what all frames share; left : squares that the frames' own unknowns leave; dof :
    degrees of freedom; corners : how many
    """

    reduced: Floats
    right: Floats
    left: float
    dof: int
    corners: int


def _stretch(observations: Observations, estimate: Estimate, u: Unknowns) -> _Stretch:
    residual, derivatives = whitened_residuals_and_derivatives(
        observations, estimate, u, whitener_of_observations(observations)
    )
    blocks = normal_equations(observations, derivatives, u, np.zeros(u.shared))
    _, reduced, right = schur_complement(blocks)
    own = float(np.einsum("fl,fl->", blocks.own, np.linalg.solve(blocks.local, blocks.own[..., None])[..., 0]))
    return _Stretch(
        reduced - np.diag(u.prior),
        right,
        float((residual**2).sum()) - own,
        2 * len(observations) - int(u.used.sum()),
        len(observations),
    )


def crossvalidate_adjustment(
    observations: Observations, adjustment: Adjustment, own: Booleans | None = None, folds: int = FOLDS
) -> HeldOut | NotHeldOut:
    """Cross-validation of an adjustment.

    HeldOut residuals over folds of frames, or NotHeldOut with a reason.
    observations : Observations that were adjusted; adjustment : their Adjustment; own : (n,) whether a corner's
        covariance is that of its own errors alone, None where all are such. The others, weighed so that all repeats
        together count as one, help to predict; what is left of them says nothing of any covariance
    Linear about the optimum: leaving a stretch out takes its share from the reduced normal equations, so nothing is
    adjusted anew. A frame's own poses are fitted to it, as they must be; what is tested is what frames share. A stretch
    without which something shared would be open (a camera seen only there, say) is not asked for.
    """
    if len(observations.frames) < 2:
        return NotHeldOut("there is only one frame, and nothing to predict it from")
    stated = adjustment.stated
    u, estimate = adjustment_unknowns_and_start_estimate(
        observations, adjustment.state, stated, adjustment.free, printing=adjustment.printing
    )
    away = estimate_offset_from_stated(estimate, stated, u)
    stretch = np.minimum(np.arange(len(observations.frames)) * folds // len(observations.frames), folds - 1)
    tested = observations if own is None or own.all() else observations.take(own)
    parts = []
    for fold in np.unique(stretch):
        frames = np.flatnonzero(stretch == fold)
        own_u, there = replace(u, used=u.used[frames]), replace(estimate, state=estimate.state.at(frames))
        whole = part = _stretch(observations_of_frames(observations, frames), there, own_u)
        if tested is not observations:
            part = _stretch(observations_of_frames(tested, frames), there, own_u)
        parts.append((whole, part))
    prior, pull = np.diag(u.prior), -u.prior * away
    total, drawn = sum(p.reduced for p, _ in parts) + prior, sum(p.right for p, _ in parts) + pull
    chi2, expected, square = 0.0, 0, 0.0
    ratios = []
    root = np.linalg.inv(np.linalg.cholesky(u.basis.T @ total @ u.basis))
    retained = [
        (whole, part)
        for whole, part in parts
        if not len(root) or np.linalg.eigvalsh(root @ u.basis.T @ (total - whole.reduced) @ u.basis @ root.T)[0] > ALONE
    ]
    if len(retained) < 2:
        return NotHeldOut("every frame determines something of the cameras that no other does")
    for whole, part in retained:
        H, g = total - whole.reduced, drawn - whole.right
        inner = np.linalg.inv(u.basis.T @ H @ u.basis) if u.basis.shape[1] else np.zeros((0, 0))
        delta = u.basis @ (inner @ (u.basis.T @ g))
        plain = here = part.left - 2 * part.right @ delta + delta @ part.reduced @ delta
        surprise = u.basis.T @ (
            part.right - part.reduced @ delta
        )  # what the shared unknowns' uncertainty explains of it (Woodbury)
        here -= surprise @ np.linalg.solve(u.basis.T @ (H + part.reduced) @ u.basis, surprise)
        chi2, expected, square = chi2 + float(here), expected + part.dof, square + float(plain)
        ratios.append(here / part.dof)
    corners = sum(part.corners for _, part in retained)
    mean = np.sqrt(np.median(np.einsum("nii->n", tested.covariance)) / 2)
    scatter = float(np.std(ratios, ddof=1) / np.sqrt(len(ratios)))
    return HeldOut(float(chi2), float(expected), scatter, float(mean * np.sqrt(square / (2 * corners))), corners)


UNDETERMINED = (
    0.5  # of what was stated; a combination that keeps more of its uncertainty owes it to its owner, not to the images
)
ENTANGLED = 0.98  # correlation from which two unknowns are hardly told apart
NAMED = 0.15  # share of a combination from which an unknown is named as part of it


@dataclass(frozen=True, slots=True)
class DeterminedUnknowns:
    """unknowns : number adjusted; undetermined : (share of the stated uncertainty that is left, (names)) of
    combinations, weakest first
    entangled : (name, name, correlation) of pairs hardly told apart; held : what was not adjusted, or holds a frame, in
        words
    """

    unknowns: int
    undetermined: tuple[tuple[float, tuple[str, ...]], ...]
    entangled: tuple[tuple[str, str, float], ...]
    held: tuple[str, ...]

    def lines(self) -> list[str]:
        """The statement as lines of text."""
        out = [f"{self.unknowns} shared unknowns adjusted; {'; '.join(self.held)}"]
        for share, names in self.undetermined[:6]:
            out.append(
                f"not determined by this recording ({share:.0%} of the stated uncertainty remains): "
                f"{' with '.join(names)}"
            )
        if len(self.undetermined) > 6:
            out.append(f"and {len(self.undetermined) - 6} more combinations not determined")
        for a, b, r in self.entangled[:6]:
            out.append(f"hardly separable (correlation {r:+.3f}): {a} and {b}")
        if len(self.entangled) > 6:
            out.append(f"and {len(self.entangled) - 6} more pairs hardly separable")
        if not self.undetermined:
            out.append("every adjusted combination is determined better by the images than by its stated uncertainty")
        return out

    def from_the_hand(self) -> "DeterminedUnknowns":
        """The same where the platform carries the cameras, and the body that they see is the base."""
        swap = {"platform frame": "base frame", "base frame": "platform frame"}
        return replace(self, held=tuple(re.sub("|".join(swap), lambda word: swap[word[0]], line) for line in self.held))

    def summary(self) -> str:
        """The statement in one line: how much the recording determines; which, the lines say."""
        weak, pairs = len(self.undetermined), len(self.entangled)
        left = [f"{weak} combination{'s' * (weak > 1)} not determined by it"] * bool(weak) + [
            f"{pairs} pair{'s' * (pairs > 1)} hardly separable"
        ] * bool(pairs)
        return (
            f"{self.unknowns} shared unknowns adjusted to this recording"
            + (f"; {' and '.join(left)}: the page lists them" if left else ", all determined by it")
            + f"; {'; '.join(self.held)}"
        )


def determinacy_of_adjusted_unknowns(adjustment: Adjustment) -> DeterminedUnknowns:
    """Determinacy of an Adjustment's unknowns (DeterminedUnknowns).

    It is in combinations of unknowns.
    Its covariance compared with the priors.
    """
    retained = np.flatnonzero(
        ~adjustment.of_prints
    )  # how markers are printed, no recording tells marker by marker: that is said in one line
    u, names = adjustment.unknowns, [str(adjustment.shared_names[k]) for k in retained]
    worth = np.where(np.isfinite(adjustment.prior), adjustment.prior, POSE_SIGMA)[retained]
    covariance = adjustment.shared_covariance[np.ix_(retained, retained)]
    scaled = covariance / np.outer(worth, worth)
    values, vectors = np.linalg.eigh(scaled) if len(worth) else (np.zeros(0), np.zeros((0, 0)))
    weak = [
        (float(np.sqrt(values[k])), _names(vectors[:, k], names))
        for k in np.argsort(-values)
        if values[k] > UNDETERMINED**2
    ]
    sigma = np.sqrt(np.diag(covariance))
    known = sigma > 1e-9 * worth
    correlation = covariance / np.outer(np.where(known, sigma, 1), np.where(known, sigma, 1))
    alike = np.argwhere(np.triu(np.abs(correlation) > ENTANGLED, 1) & known & known[:, None])
    pairs = sorted(alike.tolist(), key=lambda ij: -abs(correlation[ij[0], ij[1]]))
    return DeterminedUnknowns(
        len(names),
        tuple(weak),
        tuple((names[i], names[j], float(correlation[i, j])) for i, j in pairs),
        _held(adjustment, u),
    )


def _names(vector: Floats, names: list[str]) -> tuple[str, ...]:
    order = np.argsort(-(vector**2))
    retained = [k for k in order[:4] if vector[k] ** 2 > NAMED] or [order[0]]
    return tuple(names[k] for k in retained)


def _datum(adjustment: Adjustment, on_platform: bool) -> str:
    """Which markers hold a body's frame where their positions were adjusted."""
    m, rows = adjustment.stated.placed, adjustment.unknowns.seen
    rows = rows[m.on_platform[rows] == on_platform]
    datum = datum_marker_rows(m, rows)
    if not m.stated[datum].any():
        return f"that of its marker {m.id[datum[0]]}, since the position of none is stated"
    if len(datum) == 1 < len(rows):
        return f"fixed by the stated position of its marker {m.id[datum[0]]}"
    some = "" if len(datum) == len(rows) else " " + ", ".join(map(str, m.id[datum]))
    return f"fixed by the stated positions of its markers{some} as a whole"


def _held(adjustment: Adjustment, u: Unknowns) -> tuple[str, ...]:
    """Who holds the frames, and what was kept as stated."""
    state, out = adjustment.state, []
    loose = bool(u.markers or u.targets)
    bodies = {bool(state.markers.on_platform[row]) for row in u.seen} if state.markers is not None else {False, True}
    out += [
        f"the {name} frame is {_datum(adjustment, on) if loose else 'fixed by the stated positions of its markers'}"
        for on, name in ((False, "base"), (True, "platform"))
        if on in bodies
    ]
    if False not in bodies:
        out.append("the base frame is fixed by the stated poses of the cameras")
    for i in u.poses:
        if u.prior[u.poses[i]].any():
            out.append(
                f"camera {state.cameras[i].name!r} shows too little of the base to locate it: its "
                "stated pose is assumed "
                f"worth {POSE_SIGMA * 1e3:g} mm and {POSE_SIGMA * 1e3:g} mrad"
            )
    out += [
        f"{what} as stated"
        for columns, what in (
            (u.poses, "camera poses"),
            (u.lenses, "lenses"),
            (u.markers, "positions of markers on their targets"),
            (u.targets, "places of targets"),
        )
        if not columns
    ]
    if adjustment.printing is not None:
        out.append(f"printing errors of the markers: {adjustment.printing}")
    else:
        out.append("sides of markers as stated, which fix the scale")
    return tuple(out)
