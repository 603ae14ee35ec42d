"""Claims held against 300 recordings, half of them true, half wrong by 1.5 or more in position, rotation or both: is
each decision right?
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.stats import beta

from calib.certification.claim_verification import Verification, verify_claim
from calib.certification.claimed_error_reduction_over_workspace import Claim
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.model.pose import exp

CLAIMS = 300
WRONG = (1.5, 4.0)  # times the claim's upper end
ARM = 0.2  # m: rotations are as large as positions at this distance


@dataclass(frozen=True)
class Trial:
    """wrong : which parts are, "position" and "rotation"; moved : whether the base was moved besides;
    found : Verification
    """

    wrong: frozenset[str]
    moved: bool
    found: Verification

    @property
    def right(self) -> bool:
        """Whether the decision is: by what is left without a motion of the base, where one was made."""
        if self.moved:
            return self.found.offset is not None and self.found.offset.kept == (not self.wrong)
        return self.found.kept == (not self.wrong)


def trial(seed: int) -> Trial:
    """A machine's smooth and direction-dependent errors, an instrument's own and shared noise, 60 to 100 poses; every
    tenth base was moved.
    """
    rng = np.random.default_rng([seed, 28])
    n, upper = int(rng.integers(60, 101)), 10 ** rng.uniform(-5.5, -4.3) * np.array([1.0, 1 / ARM])
    kinds = (("position",), ("rotation",), ("position", "rotation"))
    wrong = frozenset(() if seed % 2 else kinds[int(rng.integers(3))])
    commands = rng.uniform(-1, 1, (n, 6))
    direction = rng.choice([-1.0, 1.0], (n, 6))
    features = np.concatenate([commands, commands**2 - 1 / 3, rng.uniform(0, 1) * direction], axis=1)
    error = features @ rng.normal(size=(18, 6))
    for k, part in enumerate((slice(0, 3), slice(3, 6))):
        times = rng.uniform(*WRONG) if ("position", "rotation")[k] in wrong else rng.uniform(0.4, 1.0)
        error[:, part] *= times * upper[k] / np.sqrt((error[:, part] ** 2).sum(axis=1).mean())
    sigma, shared = np.repeat(rng.uniform(0.1, 0.5) * upper, 3), np.repeat(rng.uniform(0, 0.4) * upper, 3)
    places = exp(np.concatenate([rng.uniform(-0.1, 0.1, (n, 3)), rng.uniform(-0.2, 0.2, (n, 3))], axis=1))
    T = places * exp(error) * exp(sigma * rng.normal(size=(n, 6))) * exp(shared * rng.normal(size=6))
    moved = seed % 10 < 2
    if moved:
        T = exp(np.concatenate([rng.normal(size=3) * 0.05, rng.normal(size=3) * 0.05])) * T
    samples = Samples(
        np.arange(n),
        np.arange(n) * 1.0,
        commands,
        T,
        np.tile(np.diag(sigma**2), (n, 1, 1)),
        np.tile(np.diag(shared), (n, 1, 1)),
    )
    after = tuple((0.8 * u, 0.6 * u, u) for u in upper.tolist())
    claim = Claim(n, 42, 40, 42, "", "", ((1e-3,) * 3,) * 2, after, (50.0, 40.0, 60.0), (30.0, 20.0, 40.0))
    return Trial(
        wrong, moved, verify_claim(RigidTransform.from_matrix(places.as_matrix()), samples, np.arange(n), claim, rng)
    )


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    start = time.process_time()
    trials = [trial(seed) for seed in range(CLAIMS)]
    seconds = (time.process_time() - start) / CLAIMS
    groups = {
        "all": trials,
        "true claims": [t for t in trials if not t.wrong],
        "wrong claims": [t for t in trials if t.wrong],
        "wrong in rotation alone": [t for t in trials if t.wrong == {"rotation"}],
        "base moved": [t for t in trials if t.moved],
    }
    for name, some in groups.items():
        right, count = sum(t.right for t in some), len(some)
        low, high = (
            beta.ppf(0.025, right, count - right + 1),
            1.0 if right == count else beta.ppf(0.975, right + 1, count - right),
        )
        yield (
            f"{name}: decided right",
            f"{right} of {count} ({low:.1%} to {high:.1%})",
            ">= 97 %" if name == "all" else "",
        )
    yield "one claim against 60 to 100 poses, of one processor", f"{seconds:.2f} s", ""
