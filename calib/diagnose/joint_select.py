"""Which effects sit at which joints: forward steps, backward checks, simple cases before general ones, stretches held out."""

from dataclasses import dataclass, replace

import numpy as np

from calib.diagnose import joint_scan
from calib.diagnose.joint_families import FINE, KNOTS
from calib.diagnose.joint_prove import gain, held
from calib.diagnose.joints import Fit, fit
from calib.diagnose.scan import Rival, Score

ALPHA = 1e-3  # chance of a finding where there is nothing, over all effects, joints and searches
GAIN = 10.0  # of the Bayesian information criterion that an effect must bring
PAYS = 2.0  # standard errors by which held-out stretches must gain
ALIKE = 6.0  # of the same criterion: hypotheses closer than this are not told apart
COSINE = 0.99  # between signatures, from which two are the same
AKIN = 0.5  # between signatures, below which two are different effects and not rivals, whatever each explains
NEAR = 0.03  # of a finding's drop; a rival whose signature is nearly the same lies no farther behind
BESIDE = 0.4  # of the greatest gain; another joint's effect with so much is admitted in the same step
QUICK = 2  # times of weighing anew while the search goes on
MOST = 24  # effects at once
SIGNED = ("backlash", "hysteresis", "joint_clearance", "creep")  # sizes that physics lets be positive alone
OWN = ("scale_error", "cyclic_error", "transmission_error")  # what depends on a joint's own angle alone, simple before general
ALIASES = 3  # other orders of a sinusoid that are looked at
ONCE = ("scale_error", "transmission_error", "compliance")  # at a joint; a second one would be the first
CYCLES = 2  # sinusoids that a profile is tried to be made of


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """number : of the term; score : with all others admitted; rivals : [Rival]; gain : of held-out stretches, in standard
    errors; before, after : m (or rad), RMS of held-out positions without it and with it"""

    number: int
    score: Score
    rivals: list
    gain: float
    before: float
    after: float


def select(arms, families, train=None, progress=None):
    """Fit with the terms that poses of a mask train (n,) call for. progress : called with (label, done, of), or None

    Each step admits the best hypothesis and, beside it, what other joints show nearly as strongly, each asked again with the ones
    before it admitted; all is then weighed anew.
    """
    now = fit(arms, (), train)
    tried = set()
    while len(now.terms) < MOST:
        scores = joint_scan.scan(now, _open(now, families),
                                 _labelled(progress, f"searching beside {len(now.terms)} effects"), GAIN)
        scores = [s for s in scores if convincing(s, len(families), now.size) and _key(s) not in tried]
        if not scores:
            break
        top, joints = scores[0].raw_gain(now.size), set()
        for score in scores:
            if score.family.joint in joints or score.raw_gain(now.size) < BESIDE * top or len(now.terms) >= MOST:
                continue
            joints.add(score.family.joint)
            one = joint_scan.term(score)
            again = [score] if len(joints) == 1 else joint_scan.scan(now, [_only(one)])
            if again and convincing(again[0], len(families), now.size):
                tried.add(_key(score))
                now = now.beside([one])
        now = _pruned(_refined(now, train), train)
    now = _simplified(_gathered(now, families, train), families, train)
    return _paying(fit(arms, now.terms, train, now.scatter), train)


def _open(now, families):
    """The families that may still be admitted: where a joint has its profile, only sinusoids finer than knots can follow, and none
    that the joint's travel cannot tell from one that it has."""
    has = {(t.family.name, t.family.joint) for t in now.terms if t.family.name in ONCE}
    orders = [(t.family.joint, t.shape["order"]) for t in now.terms if t.family.name == "cyclic_error"]
    out = []
    for family in families:
        if (family.name, family.joint) in has or (family.name == "scale_error" and ("transmission_error", family.joint) in has):
            continue
        if family.name == "cyclic_error" and ("transmission_error", family.joint) in has:
            family = replace(family, shapes=[shape for shape in family.shapes if shape["order"] > np.pi / min(KNOTS)])
        for joint, order in orders:
            if family.step and joint == family.joint:
                family = replace(family, shapes=[shape for shape in family.shapes if abs(shape["order"] - order) > family.step / FINE])
        if family.shapes:
            out.append(family)
    return out


def _labelled(progress, label):
    return None if progress is None else lambda done, of: progress(label, done, of)


def convincing(score, count, size):
    """Whether a Score is too good for chance over all families, worth its parameters, and of the sign that physics allows."""
    return score.p_value * count <= ALPHA and score.gain(size) >= GAIN and (score.family.name not in SIGNED or score.coefficients[0] > 0)


def findings(now, families, progress=None):
    """[Finding] of a Fit's terms, the weightiest first, each held against all families with the others admitted."""
    out = []
    squares = held(now)
    with_all = squares(())
    for number, one in enumerate(now.terms):
        without = now.without([number])
        own = joint_scan.scan(without, [_only(one)], least=-np.inf)[0]
        least = own.raw_gain(now.size) - max(2 * ALIKE, NEAR * own.drop * own.dispersion)
        scores = joint_scan.scan(without, families, _labelled(progress, f"rivals of {one.family.name} {number + 1}"), max(least, 0.0))
        mine = _signature(without, own)
        rivals = [r for r in (_rival(without, own, mine, s, one) for s in scores) if r is not None]
        rivals += [a for s in scores if s.family.name == one.family.name and s.family.joint == one.family.joint
                   for a in _aliases(without, own, mine, s)]
        lacking = squares((number,))
        out.append(Finding(number, own, sorted(rivals, key=lambda r: r.behind), gain(lacking[0] - with_all[0]), lacking[1], with_all[1]))
    return sorted(out, key=lambda f: -f.score.drop)


def _only(one):
    """The Family of a Term, confined to its shape."""
    return replace(one.family, shapes=[one.shape], step=0.0)


def _signature(without, score):
    return joint_scan.signature(without, joint_scan.atoms(without, score.family.joint), score.family, score.shape, score.coefficients).ravel()


def _rival(without, own, mine, score, one):
    if score.family.name == one.family.name and score.family.joint == one.family.joint:
        return None
    behind = own.raw_gain(without.size) - score.raw_gain(without.size)
    if score.p_value > 1e-4:
        return None
    if score.family.name in SIGNED and score.coefficients[0] <= 0:
        return None
    other = _signature(without, score)
    cosine = _cosine(mine, other)
    same = abs(cosine) > COSINE or (behind < ALIKE and abs(cosine) > AKIN)
    return Rival(score, behind, cosine) if same else None


def _aliases(without, own, mine, score):
    """Rivals of a sinusoid's finding: other orders that explain as much, where commands stood on a lattice of angles."""
    family = score.family
    if not family.step:
        return []
    c, apart = score.curve, family.step / FINE
    peaks = [i for i in range(1, len(c) - 1) if c[i] >= max(c[i - 1], c[i + 1]) and abs(family.shapes[i]["order"] - own.shape["order"]) > apart]
    out = []
    for i in sorted(peaks, key=lambda i: -c[i])[:ALIASES]:
        other = joint_scan.scan(without, [replace(family, shapes=[family.shapes[i]], step=0.0)])
        behind = own.raw_gain(without.size) - other[0].raw_gain(without.size) if other else np.inf
        cosine = _cosine(mine, _signature(without, other[0])) if other else 0.0
        if behind < 2 * ALIKE and abs(cosine) > AKIN:
            out.append(Rival(other[0], behind, cosine))
    return out


def _cosine(a, b):
    return float(a @ b / np.sqrt(max((a @ a) * (b @ b), 1e-300)))


def _key(score):
    return score.family.name, score.family.joint, tuple(sorted((k, round(float(v), 3)) for k, v in score.shape.items()))


def _pruned(now, train):
    """The fit without terms that the others have made needless."""
    while now.terms:
        gains, inverse = [], now.inverse()
        for number, one in enumerate(now.terms):
            theta, covariance = now.theta[now.slices[number]], inverse[now.slices[number]] @ inverse[now.slices[number]].T
            known = len(theta) - np.trace(covariance / one.prior**2)
            spread = covariance - covariance @ (covariance / one.prior[:, None] ** 2)  # scatter of the sizes, that of the priors left out
            statistic = theta @ np.linalg.pinv(spread, rcond=1e-9, hermitian=True) @ theta if known > 0.5 else 0.0
            gains.append(statistic - (known + one.family.extra) * np.log(now.size))
        worst = int(np.argmin(gains))
        if gains[worst] >= GAIN:
            break
        now = fit(now.arms, tuple(t for i, t in enumerate(now.terms) if i != worst), train, now.scatter, rounds=QUICK)
    return now


def _gathered(now, families, train):
    """More sinusoids at a joint than a simple case has, made one profile, where that does about as well."""
    for family in [f for f in families if f.name == "transmission_error"]:
        finest = max(shape["knots"] for shape in family.shapes)
        reach = np.pi * (finest - 1) / max(family.shapes[0]["high"] - family.shapes[0]["low"], 1e-9)  # orders that its knots can follow
        cycles = [i for i, t in enumerate(now.terms) if t.family.joint == family.joint and t.family.name in OWN and t.shape.get("order", 0) < reach]
        if len(cycles) <= CYCLES:
            continue
        rest = now.without(cycles)
        best = joint_scan.scan(rest, [family])
        trial = rest.beside([joint_scan.term(best[0])]) if best else rest
        if _criterion(trial) < _criterion(now) + GAIN * len(cycles):
            now = fit(now.arms, trial.terms, train, now.scatter, rounds=QUICK)
    return now


def _refined(now, train):
    """Profiles with as many knots and sinusoids of just the order that pay now that others are admitted; all is weighed anew."""
    for one in [t for t in now.terms if t.family.name in ("transmission_error", "cyclic_error")]:
        rest, family = now.without(_numbers(now, [one])), one.family
        if "order" in one.shape:
            whole = round(one.shape["order"] / family.step) if family.step else 0
            near = [{"order": k * family.step} for k in range(max(whole - 2, 1), whole + 3)] if family.step else [one.shape]
            best = joint_scan.scan(rest, [replace(family, shapes=near)])
        else:
            best = joint_scan.scan(rest, [family])
        if best and best[0].shape != one.shape:
            trial = rest.beside([joint_scan.term(best[0])])
            now = trial if _criterion(trial) < _criterion(now) else now
    return fit(now.arms, now.terms, train, now.scatter, rounds=QUICK)


def _simplified(now, families, train):
    """Profiles in place of which one scale or a few sinusoids do as well, replaced by these."""
    for one in [t for t in now.terms if t.family.name == "transmission_error"]:
        here, worth = now.without(_numbers(now, [one])), _criterion(now)
        own = [f for f in families if f.joint == one.family.joint and f.name in ("scale_error", "cyclic_error")]
        for left in range(CYCLES, 0, -1):
            scores = joint_scan.scan(here, own)
            if not scores or _criterion(here) - left * max(s.drop * s.dispersion for s in scores) > worth:
                break  # later ones seldom bring more than the first
            here = here.beside([joint_scan.term(scores[0])])
            if _criterion(here) < worth:
                now = fit(now.arms, here.terms, train, now.scatter, rounds=QUICK)
                break
    return _pruned(now, train)


def _numbers(now, terms):
    return [i for i, t in enumerate(now.terms) if any(t is one for one in terms)]


def _criterion(now):
    """Bayesian information criterion of a Fit with its weights as they are."""
    return now.cost() + (now.known() + sum(one.family.extra for one in now.terms)) * np.log(now.size)


def _paying(now, train):
    """The fit without terms that do not pay on stretches held out."""
    while now.terms:
        squares = held(now)
        base = squares(())[0]
        gains = [gain(squares((number,))[0] - base) for number in range(len(now.terms))]
        worst = int(np.argmin(gains))
        if gains[worst] >= PAYS:
            break
        now = fit(now.arms, tuple(t for i, t in enumerate(now.terms) if i != worst), train, now.scatter)
    return now


__all__ = ["Finding", "Fit", "Rival", "convincing", "findings", "select"]
