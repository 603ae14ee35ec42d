"""What a recording can and cannot determine: combinations of shared unknowns that its images leave where they were
stated.
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from vision.bundle.adjustment_unknowns import Unknowns
from vision.bundle.bundle_adjustment import Adjustment
from vision.bundle.unknown_priors import POSE_WORTH

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
                f"not determined by this recording ({share:.0%} of the stated uncertainty is left): "
                f"{' with '.join(names)}"
            )
        if len(self.undetermined) > 6:
            out.append(f"and {len(self.undetermined) - 6} more combinations not determined")
        for a, b, r in self.entangled[:6]:
            out.append(f"hardly told apart (correlation {r:+.3f}): {a} and {b}")
        if len(self.entangled) > 6:
            out.append(f"and {len(self.entangled) - 6} more pairs hardly told apart")
        if not self.undetermined:
            out.append("every adjusted combination is determined by the images better than by what was stated")
        return out

    def from_the_hand(self) -> "DeterminedUnknowns":
        """The same where the platform carries the cameras, and the body that they see is the base."""
        swap = {"platform frame": "base frame", "base frame": "platform frame"}
        return replace(self, held=tuple(re.sub("|".join(swap), lambda word: swap[word[0]], line) for line in self.held))

    def summary(self) -> str:
        """The statement in one line: how much the recording determines; which, the lines say."""
        weak, pairs = len(self.undetermined), len(self.entangled)
        left = [f"{weak} combination{'s' * (weak > 1)} of them it cannot determine"] * bool(weak) + [
            f"{pairs} pair{'s' * (pairs > 1)} hardly to be told apart"
        ] * bool(pairs)
        return (
            f"{self.unknowns} shared unknowns adjusted to this recording"
            + (f"; {' and '.join(left)}: the page lists them" if left else ", all determined by it")
            + f"; {'; '.join(self.held)}"
        )


def determined_combinations(adjustment: Adjustment) -> DeterminedUnknowns:
    """DeterminedUnknowns of an Adjustment: its covariance held against what each unknown was worth before."""
    kept = np.flatnonzero(
        ~adjustment.of_prints
    )  # how markers are printed, no recording tells marker by marker: that is said in one line
    u, names = adjustment.unknowns, [" ".join(adjustment.shared_names[k]) for k in kept]
    worth = np.where(np.isfinite(adjustment.prior), adjustment.prior, POSE_WORTH)[kept]
    covariance = adjustment.shared_covariance[np.ix_(kept, kept)]
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


def _names(vector: np.ndarray, names: list[str]) -> tuple[str, ...]:
    order = np.argsort(-(vector**2))
    kept = [k for k in order[:4] if vector[k] ** 2 > NAMED] or [order[0]]
    return tuple(names[k] for k in kept)


def _held(adjustment: Adjustment, u: Unknowns) -> tuple[str, ...]:
    """Who holds the frames, and what was kept as stated."""
    state, out = adjustment.state, []
    loose = bool(u.markers or u.targets)
    bodies = {bool(state.markers.on_platform[row]) for row in u.seen} if state.markers is not None else {False, True}
    together = "the stated places of its markers, taken together" if loose else "the stated places of its markers"
    out += [
        f"the {name} frame is held by {together}" for on, name in ((False, "base"), (True, "platform")) if on in bodies
    ]
    if False not in bodies:
        out.append("the base frame is held by the stated poses of the cameras")
    for i in u.poses:
        if u.prior[u.poses[i]].any():
            out.append(
                f"camera {state.cameras[i].name!r} shows too little of the base to say where it stands: its "
                "stated pose is taken to be "
                f"worth {POSE_WORTH * 1e3:g} mm and {POSE_WORTH * 1e3:g} mrad"
            )
    out += [
        f"{what} as stated"
        for columns, what in (
            (u.poses, "camera poses"),
            (u.lenses, "lenses"),
            (u.markers, "places of markers on their targets"),
            (u.targets, "places of targets"),
        )
        if not columns
    ]
    if adjustment.printing is not None:
        out.append(f"markers off that as they are printed: {adjustment.printing}")
    else:
        out.append("sides of markers as stated, which set the scale")
    return tuple(out)
