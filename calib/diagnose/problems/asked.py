"""What of the catalogue a diagnosis is asked for: effects, or effects at places, alone or left out."""

from dataclasses import dataclass

from rig.errors import RigError


@dataclass(frozen=True, slots=True)
class Asked:
    """only : "effect" or "effect place" to which the catalogue is confined, empty for all of it; without : what is left out."""

    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()

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

    def check(self, sites: dict[str, tuple[str, ...]]) -> None:
        """Raise RigError where a place is asked for, or left out, that none of the places (of each effect that can be asked for) is."""
        for text in (*self.only, *self.without):
            name, _, place = text.partition(" ")
            if place and name in sites and place not in sites[name]:
                raise RigError(f"{text!r}: {name} cannot sit at {place!r} in this recording; it can at {', '.join(sites[name])}")
