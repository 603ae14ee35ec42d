"""Score of diagnoses against the blind truth.

Verdicts by case, figures of a campaign with exact intervals.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from rig.array_and_json_types import Json
from rig.effects.catalogue.effect_list import BY_NAME
from rig.formats import json_toml_and_yaml_loading
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.local_and_remote_input_files import short_repr
from rig.model.arm_hands_effect_places_and_tolerances import Place

STRONG = 7.0  # signal-to-noise from which an effect must be found
Group = tuple[str, list["Figure"], dict[str, int]]  # (effect or strength, detected .. covered, {taken for: times})
BINS = (0.0, 3.0, 7.0, 20.0, 100.0, np.inf)  # of strength


@dataclass(frozen=True, slots=True)
class Hidden:
    """An effect that was at work. parameters : {name: number or list}; strength : signal-to-noise, freedoms projected
    out
    """

    effect: str
    place: str
    parameters: Json
    strength: float


@dataclass(frozen=True, slots=True)
class Found:
    """A finding. parameters : {name: (value, [low, high] or None)}; alternatives : [(effect, place)] that it cannot be
    told from
    """

    effect: str
    place: str
    parameters: Json
    alternatives: list[Any]

    def names(self) -> list[str]:
        """Effects that it leaves possible, its own first."""
        return [self.effect, *(name for name, _ in self.alternatives)]


@dataclass(frozen=True, slots=True)
class Case:
    """One case, unblinded. index; kind; disturbance : name or None; hidden : [Hidden]; found : [Found];
    unexplained : whether anything is said to be left; ratio : held-out misfit over the noise floor; seconds : that the
        diagnosis
    took; failed : its error or None
    remarks : (Found, ..) of what is there and within tolerances"""

    index: int
    kind: str
    disturbance: str | None
    hidden: list[Any]
    found: list[Any]
    unexplained: bool
    ratio: float
    seconds: float
    failed: str | None = None
    remarks: tuple[Any, ...] = ()

    @property
    def named(self) -> list[Found]:
        """Findings that name an effect of the catalogue."""
        return [f for f in self.found if f.effect != "unknown"]

    @property
    def named_or_remarked(self) -> list[Found]:
        """The same; where there is none, remarks on effects that were hidden, at their places: an effect within
        tolerances is rightly no finding.
        """
        hidden = [(h.effect, h.place) for h in self.hidden]
        return self.named or [r for r in self.remarks if (r.effect, r.place) in hidden]

    def match(self, hidden: Hidden) -> Found | None:
        """The finding that answers a hidden effect: same place if there is one, else the same name, else one that
        allows it, or None.
        """
        for fits in (
            lambda f: (f.effect, f.place) == (hidden.effect, hidden.place),
            lambda f: f.effect == hidden.effect,
            lambda f: (hidden.effect, hidden.place) in f.alternatives,
            lambda f: hidden.effect in f.names(),
        ):
            for f in self.named_or_remarked:
                if fits(f):
                    return f
        return None

    def wrong(self) -> list[Found]:
        """Findings whose effect was not hidden and which do not allow one that was."""
        names = {h.effect for h in self.hidden}
        return [f for f in self.named if not names & set(f.names())]

    def seen_as(self, hidden: Hidden) -> str:
        """What a hidden effect was taken for: the name of its finding, else of one that answers no other, else unknown
        or nothing.
        """
        own = self.match(hidden)
        if own is not None:
            return own.effect
        matches = [id(self.match(h)) for h in self.hidden]
        rest = [f.effect for f in self.named if id(f) not in matches]
        return rest[0] if rest else "unknown" if self.unexplained else "nothing"


@dataclass(frozen=True, slots=True)
class Figure:
    """name; hits of trials; low, high : Clopper and Pearson's 95 % interval; goal : the share to reach, or None"""

    name: str
    hits: int
    trials: int
    low: float
    high: float
    goal: float | None = None


def _share_figure(name: str, flags: list[bool], goal: float | None = None) -> Figure:
    """Figure of how many flags are true."""
    flags = [bool(f) for f in flags]
    return Figure(name, sum(flags), len(flags), *clopper_pearson_interval(sum(flags), len(flags)), goal)


def clopper_pearson_interval(hits: int, trials: int, level: float = 0.95) -> tuple[float, float]:
    """Clopper-Pearson exact interval (low, high) of a share, hits of trials.

    Source: Biometrika 26, 1934.
    """
    tail = (1 - level) / 2
    low = float(scipy.stats.beta.ppf(tail, hits, trials - hits + 1)) if hits else 0.0
    high = float(scipy.stats.beta.ppf(1 - tail, hits + 1, trials - hits)) if hits < trials else 1.0
    return low, high


def score_case(
    index: int, truth: Path, diagnosis: Path | None, seconds: float = float("nan"), failed: str | None = None
) -> Case:
    """Case scored from a truth file and a diagnosis.json (None where it failed)."""
    tree = json_toml_and_yaml_loading.load_json(truth, "truth of a case")
    effects = tree.tables("effects")
    hidden = [
        _hidden(table, strength) for table, strength in zip(effects, tree.array("strengths", (len(effects),)).tolist())
    ]
    kind, disturbance = tree.text("kind"), tree.text("disturbance") if tree.get("disturbance") is not None else None
    if diagnosis is None:
        return Case(index, kind, disturbance, hidden, [], False, float("nan"), seconds, failed)
    tree = json_toml_and_yaml_loading.load_json(diagnosis, "diagnosis")
    found, fit = [_found(table) for table in tree.tables("findings")], tree.table("fit")
    after, floor = (fit.number(key, nulls=True) for key in ("heldout_after", "noise_floor"))
    unexplained = tree.get("unexplained") is not None or any(f.effect == "unknown" for f in found)
    remarks = tuple(_found(table) for table in tree.tables("remarks")) if "remarks" in tree.tree else ()
    return Case(
        index,
        kind,
        disturbance,
        hidden,
        found,
        unexplained,
        after / floor if floor else float("nan"),
        seconds,
        remarks=remarks,
    )


def _hidden(table: Entries, strength: float) -> Hidden:
    effect, parameters = table.text("effect"), table.table("parameters")
    if effect in BY_NAME:
        known = [p.name for p in BY_NAME[effect].parameters]
        for name, value in parameters.tree.items():
            if name not in known:
                parameters.fail(f"{effect} has no parameter {short_repr(name)}; it has {', '.join(known)}")
            parameters.numbers(value, (None,) if isinstance(value, list) else (), name, ())
    return Hidden(effect, _place(table, effect, parameters.tree.get("other", -1)), parameters.tree, strength)


def _found(table: Entries) -> Found:
    effect, parameters, inner = table.text("effect"), {}, table.table("parameters")
    for name in inner.tree:
        p = inner.table(name)
        value, interval = p.get("value"), p.get("ci95", None)
        if effect in BY_NAME:
            shape = (len(value),) if isinstance(value, list) else ()
            p.numbers(value, shape, "value", (), nulls=True)
            if interval is not None:
                p.numbers(interval, (2, *shape), "ci95", (), nulls=True)
        parameters[name] = (value, interval)
    alternatives = (
        [(r.text("effect"), r.text("place")) for r in table.tables("cannot_be_told_from")]
        if "cannot_be_told_from" in table.tree
        else []
    )
    return Found(effect, _place(table, effect, parameters.get("other", (-1,))[0]), parameters, alternatives)


def _place(table: Entries, effect: str, other: object) -> str:
    """The place; of two markers exchanged with each other, either of which may be given, the lower."""
    place, kind = table.text("place"), BY_NAME.get(effect)
    if kind is None or not kind.discrete or not isinstance(other, int | float) or not other >= 0:
        return place
    number = Place.parse(place).name
    if not (number.isascii() and number.isdigit()):
        table.fail(f"{table.name('place')} must be a marker, not {short_repr(place)}", "place")
    return str(Place("marker", str(min(int(number), int(other)))))


def do_parameter_intervals_cover_truth(true_effect: Hidden, finding: Found | None) -> list[bool]:
    """Whether each interval of a finding's parameters covers the truth."""
    out: list[bool] = []
    if finding is None or (finding.effect, finding.place) != (true_effect.effect, true_effect.place):
        return out
    roles = {p.name: p.role for p in BY_NAME[true_effect.effect].parameters}
    for name, true in true_effect.parameters.items():
        value, interval = finding.parameters.get(name, (None, None))
        if interval is None or roles[name] in ("moment", "choice"):
            continue
        true, low, high = (np.atleast_1d(np.asarray(v, float)) for v in (true, *interval))
        if len(true) != len(low) or (len(true) > 1 and not np.any(true)):  # another of its vectors says what it is
            continue
        if roles[name] == "phase":
            true = true + 2 * np.pi * np.round(((low + high) / 2 - true) / (2 * np.pi))
        out += [bool(a <= x <= b) for x, a, b in zip(true, low, high) if b > a]
    return out


def campaign_rates_with_intervals(cases: list[Case]) -> list[Figure]:
    """Rates of a campaign's cases, with intervals.

    They are of detection, naming and placing, in the order of the page.
    Rates of detection, naming and placing, in the order of the page.
    """
    done = [c for c in cases if c.failed is None]
    still = [c for c in done if c.kind == "nothing"]
    one = [c for c in done if c.kind == "one" and c.hidden[0].strength >= STRONG]
    two = [c for c in done if c.kind == "two" and all(h.strength >= STRONG for h in c.hidden)]
    foreign = [c for c in done if c.kind == "foreign" and c.hidden[0].strength >= STRONG]
    noise = [c for c in done if c.kind == "noise"]
    inside = [
        flag
        for c in done
        for h in c.hidden
        if h.effect in BY_NAME
        for flag in do_parameter_intervals_cover_truth(h, c.match(h))
    ]
    return [
        _share_figure("diagnosed without an error", [c.failed is None for c in cases], 1.0),
        _share_figure("nothing hidden: no finding", [not c.found and not c.unexplained for c in still], 148 / 150),
        _share_figure(
            "one effect: detected", [bool(c.found or c.named_or_remarked) or c.unexplained for c in one], 0.97
        ),
        _share_figure(
            "one effect: named first",
            [bool(c.named_or_remarked) and c.named_or_remarked[0].effect == c.hidden[0].effect for c in one],
            0.92,
        ),
        _share_figure("one effect: truth in the set", [c.match(c.hidden[0]) is not None for c in one], 0.97),
        _share_figure(
            "one effect: at its place",
            [
                any((f.effect, f.place) == (h.effect, h.place) for f in c.named_or_remarked)
                for c in one
                for h in c.hidden
            ],
            0.9,
        ),
        _share_figure("one effect: nothing else named", [not c.wrong() and len(c.named) <= 1 for c in one]),
        _share_figure(
            "two effects: both named",
            [all(any(f.effect == h.effect for f in c.named) for h in c.hidden) for c in two],
            0.75,
        ),
        _share_figure("two effects: no wrong name", [not c.wrong() for c in two]),
        _share_figure("outside the catalogue: called unknown", [c.unexplained and not c.named for c in foreign], 0.8),
        _share_figure("outside the catalogue: no name given", [not c.named for c in foreign]),
        _share_figure("noise only disturbed: no name given", [not c.named for c in noise]),
        _share_figure("no wrong name in any case", [not c.wrong() for c in done]),
        _share_figure("95 % intervals that cover", inside, 0.91),
    ]


def campaign_medians(cases: list[Case]) -> dict[str, float]:
    """Medians {name: median} of a campaign's cases.

    Sizes, held-out misfit over the noise floor, seconds.
    """
    done = [c for c in cases if c.failed is None]
    one = [c.match(c.hidden[0]) for c in done if c.kind == "one" and c.hidden[0].strength >= STRONG]
    columns: dict[str, list[float]] = {
        "effects in a set": [len(set(f.names())) for f in one if f is not None],
        "held-out misfit / noise floor": [c.ratio for c in done],
        "seconds a diagnosis": [c.seconds for c in cases],
    }
    return {name: float(np.nanmedian(v)) if np.isfinite(v).any() else float("nan") for name, v in columns.items()}


def detection_and_naming_shares_by_effect(cases: list[Case]) -> list[Group]:
    """Shares of strong hidden effects detected and named, by effect.

    Also placed and covered.
    Returns (effect, [Figure detected, named, placed, covered], {effect found: count})
    """
    return _grouped(cases, lambda h: h.effect if h.strength >= STRONG else None)


def detection_and_naming_shares_by_strength(cases: list[Case]) -> list[Group]:
    """Shares of hidden effects detected and named, by strength.

    They are effects of the catalogue.
    """

    def group(h: Hidden) -> str | None:
        k = int(np.searchsorted(BINS, h.strength, side="right"))
        return f"{BINS[k - 1]:g} to {BINS[k]:g}" if h.effect in BY_NAME else None

    found = {row[0]: row for row in _grouped(cases, group)}
    return [found[name] for low, high in zip(BINS[:-1], BINS[1:]) if (name := f"{low:g} to {high:g}") in found]


def _grouped(cases: list[Case], group: Callable[[Hidden], str | None]) -> list[Group]:
    rows: dict[str, list[Any]] = {}
    for c in cases:
        for h in c.hidden if c.failed is None else ():
            name = group(h)
            if name is not None:
                rows.setdefault(name, []).append((c, h, c.match(h)))
    return [
        (
            name,
            [
                _share_figure("detected", [c.seen_as(h) != "nothing" for c, h, _ in rows[name]]),
                _share_figure("named", [f is not None and f.effect == h.effect for _, h, f in rows[name]]),
                _share_figure(
                    "placed", [f is not None and (f.effect, f.place) == (h.effect, h.place) for _, h, f in rows[name]]
                ),
                _share_figure(
                    "covered",
                    [
                        flag
                        for _, h, f in rows[name]
                        if h.effect in BY_NAME
                        for flag in do_parameter_intervals_cover_truth(h, f)
                    ],
                ),
            ],
            _count(c.seen_as(h) for c, h, _ in rows[name]),
        )
        for name in sorted(rows)
    ]


def strong_effect_confusion_table(cases: list[Case]) -> dict[str, dict[str, int]]:
    """Confusion table of a campaign's strong effects.

    Returns {hidden effect: {effect found: count}}
    """
    out = {name: counts for name, _, counts in detection_and_naming_shares_by_effect(cases)}
    for c in cases:
        if c.failed is None and not c.hidden:
            label = c.disturbance or "nothing"
            seen = c.named[0].effect if c.named else "unknown" if c.unexplained else "nothing"
            out.setdefault(label, {})
            out[label][seen] = out[label].get(seen, 0) + 1
    return out


def _count(names: Iterable[str]) -> dict[str, int]:
    out: Json = {}
    for name in names:
        out[name] = out.get(name, 0) + 1
    return out
