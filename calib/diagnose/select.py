"""Which effects: forward steps, backward checks, and for each the rivals that would have explained as much."""

from dataclasses import dataclass, replace

import numpy as np

from calib.diagnose.planes import Column, linearise
from calib.diagnose.prove import prove
from calib.diagnose.scan import Rival
from calib.diagnose.search import column_of, search
from calib.diagnose.settle import Settled, admit, released, resettle, settle, tangents
from calib.diagnose.smooth import cover, covered
from calib.diagnose.unknown import unknowns
from rig.effects.base import check
from rig.effects.transmission_error import TransmissionError

ALPHA = 1e-3  # chance of a finding where there is nothing, over all effects, places and searches
GAIN = 10.0  # of the Bayesian information criterion that an effect must bring
ALIKE = 6.0  # minus twice the logarithm of odds, from which hypotheses are told apart
REFITTED = 4  # hypotheses that are fitted in a finding's place
COSINE = 0.99  # between signatures, freedoms taken out, from which two are the same
NEAR = 0.03  # of a finding's drop; a rival whose signature is nearly the same lies no farther behind
MOST = 6  # effects at once
HELD_OUT = 0.5  # standard errors by which an effect must do better on stretches that it was not fitted to; its weight is tested elsewhere
BEYOND = 2.0  # times a name's gain, from which a smooth function without one explains so much more that no further name is given
TRIED = 3  # hypotheses that may fail there before the search ends


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """number : of the effect among the admitted; score : its scan with all others admitted; rivals : [Rival]"""

    number: int
    score: object
    rivals: list


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """settled : Settled of all admitted; findings : [Finding] in the order of their weight; families : how many were asked; before :
    Planes with nothing admitted"""

    settled: Settled
    findings: list
    families: int
    before: object


def select(knowledge, families, signatures, progress=None):
    """Selection of the effects that a Knowledge with none needs. progress : called with (label, done, of), or None"""
    settled = settle(knowledge, signatures)
    before = settled.planes
    chosen, refused = [], []  # families of the admitted, in their order; and of those that did not predict what was held out
    for _ in range(MOST):
        label = f"searching beside {len(chosen)} effects" if chosen else "searching"
        planes = settled.planes if settled.column is None else settled.planes.without(settled.column)
        signatures = signatures.at(settled.knowledge)
        scores = search(planes, families, signatures, (lambda done, of, label=label: progress(label, done, of)) if progress else None)
        promising = [s for s in scores if convincing(s, len(families), planes.size) and s.family not in refused]
        taken = None
        if chosen and promising and _beyond(planes, promising[0]):
            break
        for best in promising[:TRIED]:
            trial = admit(settled, best, signatures)
            if prove(trial, {len(chosen)}, best.family.plane if knowledge.axes else "view").gain > HELD_OUT:
                taken, best = _finer(settled, trial, best, scores, signatures)
                break
            refused.append(best.family)
        if taken is None:
            break
        settled, chosen = _prune(taken, [*chosen, best.family], signatures)
    settled, chosen, findings = _confirm(settled, chosen, families, signatures, progress)
    return Selection(settled, findings, len(families), before)


def _finer(settled, taken, best, scores, signatures):
    """(Settled, Score) of the best number of knots of a profile just admitted: before, what a coarse one leaves counted as scatter."""
    if best.family.kind is not TransmissionError:
        return taken, best
    trials = [(taken, best)]
    for score in scores:
        if score.family.kind is TransmissionError and score.family.place == best.family.place and score.family is not best.family:
            trials.append((admit(settled, score, signatures), score))
    least = min(trial.knowledge.standing for trial, _ in trials)
    return min(trials, key=lambda trial: trial[0].likelihood(least) + len(trial[0].coordinates) * np.log(trial[0].planes.size))


def _beyond(planes, best):
    """Whether something that no name explains is larger than what the best name would."""
    return any(u.gain(planes.size) > BEYOND * best.gain(planes.size) for u in unknowns(planes) if u.dispersion)


def convincing(score, count, size):
    """Whether a Score is a finding: too good for chance over all families, worth its parameters, and physically possible."""
    if score.p_value * count > ALPHA or score.gain(size) < GAIN:
        return False
    try:
        check(score.effect)
    except ValueError:
        return False
    return True


def _prune(settled, chosen, signatures):
    """The admitted without those that the others have made needless."""
    while chosen:
        gains = []
        for number in range(len(chosen)):
            statistic, parameters = settled.wald(number)
            gains.append(statistic - (parameters + chosen[number].extra) * np.log(settled.planes.size))
        worst = int(np.argmin(gains))
        if gains[worst] >= GAIN:
            break
        settled, chosen = _left_out(settled, worst, signatures), chosen[:worst] + chosen[worst + 1 :]
    return settled, chosen


def _left_out(settled, number, signatures):
    """Settled without an admitted effect."""
    return settle(released(settled, number), signatures)


def _confirm(settled, chosen, families, signatures, progress):
    """Each finding against all families with the others admitted: replaced where another does better, its rivals listed."""
    findings, number = [], 0
    for _ in range(2 * MOST):
        if number == len(chosen):
            break
        planes = freed(beside(settled, number, signatures), signatures)
        score, rivals = _rivals(planes, settled, number, chosen, families, signatures, progress)
        if not convincing(score, len(families), settled.planes.size) or _outdone(score, planes):  # beside all others it is none
            settled, chosen, number, findings = _left_out(settled, number, signatures), chosen[:number] + chosen[number + 1 :], 0, []
            continue
        rivals, refitted = _refitted(settled, number, score, rivals, signatures)
        better = rivals and rivals[0].behind < -1.0 and convincing(rivals[0].score, len(families), settled.planes.size)
        if better and rivals[0] in refitted:
            k = refitted[rivals[0]].knowledge
            order = [*k.effects[:number], k.effects[-1], *k.effects[number:-1]]
            settled, chosen[number], number, findings = settle(k.with_effects(order), signatures), rivals[0].score.family, 0, []
            continue
        findings.append(Finding(number, score, [r for r in rivals if _alike(r)]))
        number += 1
    return settled, chosen, sorted(findings, key=lambda f: -f.score.drop)


def supported(selection, signatures, left):
    """Selection without findings whose name does not stand where something is left unexplained: which smooth functions of the same would explain
    as well, or which explain less than they leave at their place. left : [Unknown]"""
    settled, kept = selection.settled, []
    for f in selection.findings:
        if any(u.drop > f.score.drop for u in left if u.depends_on and u.within(f.score.family.place)):
            continue
        planes = beside(settled, f.number, signatures)
        planes = freed(covered(planes, *cover(planes, left)), signatures)
        if stands(f, planes, selection.families, signatures):
            kept.append(f)
    if len(kept) == len(selection.findings):
        return selection
    numbers = sorted(f.number for f in kept)
    settled = settle(settled.knowledge.with_effects([settled.knowledge.effects[i] for i in numbers]), signatures)
    return replace(selection, settled=settled, findings=[replace(f, number=numbers.index(f.number)) for f in kept])


def stands(finding, planes, count, signatures):
    """Whether a Finding convinces on Planes without it, of so many families asked."""
    return convincing(search(planes, [finding.score.family], signatures.at(planes.knowledge))[0], count, planes.size)


def beside(settled, number, signatures):
    """Planes without an admitted effect. What moves corners is first taken up by cameras and poses as far as they can: corners that it moved far
    would be clipped, and what it does would no longer be linear."""
    k = settled.knowledge
    if k.effects[number].stage in ("targets", "view"):
        return resettle(released(settled, number), signatures).planes
    return linearise(k.with_effects(e for i, e in enumerate(k.effects) if i != number))


def freed(planes, signatures):
    """Planes with the parameters of the effects admitted there among the freedoms."""
    _, column = tangents(planes, signatures)
    return planes if column is None else planes.without(column)


def _alike(rival):
    """Whether a Rival is not told apart from its finding."""
    return rival.behind < ALIKE or abs(rival.cosine) > COSINE


def _refitted(settled, number, score, rivals, signatures):
    """([Rival] by weight, {Rival: Settled with it in place of the finding, the last of the effects}).

    Those that a scan does not tell from a finding are fitted with all that is free: a scan takes for scatter what is not admitted yet, and
    so tells of a strong effect far less than it could.
    """
    close = [r for r in rivals if _alike(r)][:REFITTED]
    if not close:
        return rivals, {}
    size = settled.planes.size
    bare, out = _left_out(settled, number, signatures), {}
    for r in close:
        new = admit(bare, r.score, signatures.at(bare.knowledge))
        least = min(new.knowledge.standing, settled.knowledge.standing)
        behind = new.likelihood(least) - settled.likelihood(least) + r.score.occam(size) - score.occam(size)
        out[replace(r, behind=behind)] = new
    return sorted([*out, *(r for r in rivals if r not in close)], key=lambda r: r.behind), out


def _outdone(score, planes):
    """Whether a smooth function without a name is likelier than a hypothesis that consists of a few numbers: these lie far from what rigs show, or
    the place is another."""
    if any(index is not None for _, index, _ in score.family.linear):
        return False
    size = planes.size
    smooth = [u.drop * u.dispersion - u.freedom * np.log(size) for u in unknowns(planes) if u.dispersion]
    return bool(smooth) and max(smooth) > score.drop * score.dispersion - score.occam(size) + ALIKE


def _rivals(planes, settled, number, chosen, families, signatures, progress):
    """(Score of a finding, [Rival] by weight) on Planes without it, with the other findings admitted and their parameters free."""
    signatures = signatures.at(planes.knowledge)
    label = f"rivals of {settled.knowledge.effects[number].name}"
    scores = search(planes, families, signatures, (lambda done, of: progress(label, done, of)) if progress else None)
    own = next(s for s in scores if s.family is chosen[number])
    signature = _signature(planes, own, signatures)
    rivals, listed = [], set()
    for s in scores:  # the best of each kind and place first
        if s.family is own.family or (s.family.kind is own.family.kind and s.family.place == own.family.place):
            continue
        behind = own.drop * own.dispersion - own.occam(planes.size) - s.drop * s.dispersion + s.occam(planes.size)
        if behind > max(2 * ALIKE, NEAR * own.drop * own.dispersion) or s.p_value > 1e-4:
            continue
        if (s.family.kind, s.family.place) in listed:
            continue
        listed.add((s.family.kind, s.family.place))
        other = _signature(planes, s, signatures)
        rivals.append(Rival(s, behind, _cosine(planes, signature, other)))
    return own, sorted(rivals, key=lambda r: r.behind)


def _signature(planes, score, signatures):
    """Column (1) of what a Score's effect does as scanned, freedoms not yet taken out."""
    column = column_of(planes, score.family, score.shape, signatures)
    theta = score.coefficients if len(score.coefficients) else np.ones(1)
    return Column(None if column.image is None else column.image @ theta[:, None], column.struts @ theta[:, None])


def _cosine(planes, a, b):
    parts = [planes.project(column) for column in (a, b)]
    inner = float((a.struts.T @ b.struts)[0, 0]) - float((parts[0][0].T @ parts[1][0])[0, 0])
    if a.image is not None and b.image is not None:
        inner += float((a.image.T @ b.image)[0, 0])
    return inner / np.sqrt(max(float(parts[0][2][0, 0]) * float(parts[1][2][0, 0]), 1e-300))
