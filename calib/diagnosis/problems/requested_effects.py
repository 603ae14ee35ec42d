"""Requested effects: which effects of the catalogue, at which places, a diagnosis includes or omits."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from calib.diagnosis.engine.selection_candidates_thresholds_and_outliers import Candidate, NotAsked, StatedTerms
from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect import Effect
from rig.errors import FileError, RigError

Made = TypeVar("Made", bound=Candidate)


class EffectSites(NamedTuple):
    """places : at which an effect may be requested, None for any; searched : those at which candidates are made;
    not_asked : what it cannot be asked for"""

    places: tuple[str, ...] | None
    searched: tuple[str, ...]
    not_asked: Sequence[NotAsked] = ()


@dataclass(frozen=True, slots=True)
class RequestedEffects:
    """only : "effect" or "effect place" to which the catalogue is confined, empty for all of it; without : what is left
    out
    kinds : the catalogue, with what a user adds to it."""

    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    kinds: tuple[type[Effect], ...] = ALL

    @staticmethod
    def of(
        only: Iterable[str] | None, without: Iterable[str], given: StatedTerms, kinds: tuple[type[Effect], ...] = ALL
    ) -> "RequestedEffects":
        """Asked with what is assumed besides. Raises RigError where that is left out at the same time."""
        asked = RequestedEffects(tuple(only or ()), tuple(without), kinds)
        assumed = tuple(f"{name} {place}" for name, place in given.assumed)
        out = [text for text, (name, _) in zip(assumed, given.assumed) if {name, text} & set(asked.without)]
        if out:
            raise RigError(f"{' and '.join(out)} cannot be both assumed and excluded")
        return RequestedEffects((*asked.only, *assumed) if asked.only else (), asked.without, kinds)

    def name(self, name: str) -> bool:
        """Whether an effect is asked for at any place."""
        return (not self.only or any(text.split(" ")[0] == name for text in self.only)) and name not in self.without

    def touches(self, name: str) -> bool:
        """Whether anything is said of an effect, or everything is asked for."""
        return not self.only or any(text.split(" ")[0] == name for text in (*self.only, *self.without))

    def place(self, name: str, place: str) -> bool:
        """Whether an effect is asked for at a place."""
        there = {name, f"{name} {place}"}
        return (not self.only or bool(there & set(self.only))) and not there & set(self.without)

    def candidates(
        self, sites_of: Callable[[type[Effect]], EffectSites], candidates_at: Callable[[type[Effect], str], list[Made]]
    ) -> tuple[list[Made], list[NotAsked]]:
        """(candidates, what cannot be tested) of the requested catalogue.

        sites_of : EffectSites of an effect, RigError where it cannot be tested at all; candidates_at : of an effect at
            a place. Raises RigError for a requested place at which an effect cannot sit
        """
        out: list[Made] = []
        skipped: list[NotAsked] = []
        sites: dict[str, tuple[str, ...]] = {}
        for kind in filter(lambda kind: self.touches(kind.name), self.kinds):
            try:
                found = sites_of(kind)
                skipped += found.not_asked
                if found.places is not None:
                    sites[kind.name] = found.places
                for place in found.searched:
                    if self.place(kind.name, place):
                        out += candidates_at(kind, place)
            except FileError:
                raise  # of a file that a user wrote
            except RigError as error:
                skipped.append(NotAsked(kind.name, str(error)))
        self.check(sites)
        return out, [s for s in skipped if self.name(s.effect)]

    def check(self, sites: dict[str, tuple[str, ...]]) -> None:
        """Raise RigError where a place is asked for, or left out, that none of the places (of each effect that can be
        asked for) is.
        """
        for text in (*self.only, *self.without):
            name, _, place = text.partition(" ")
            if place and name in sites and place not in sites[name]:
                raise RigError(
                    f"{text!r}: {name} cannot sit at {place!r} in this recording; it can at {', '.join(sites[name])}"
                )


def require_assumed_effects_testable(
    stated_terms: StatedTerms, candidates: Sequence[Candidate], untestable_effects: Sequence[NotAsked]
) -> StatedTerms:
    """The stated terms, unchanged. Raises RigError where the recording cannot test an assumed effect."""
    there = {(c.name, c.place) for c in candidates}
    for name, place in stated_terms.assumed:
        if (name, place) not in there:
            reasons = [s.reason for s in untestable_effects if s.effect == name]
            raise RigError(
                f"{name} at {place} is assumed, but this recording cannot be tested for it"
                + (f": {reasons[0]}" if reasons else "")
            )
    return stated_terms
