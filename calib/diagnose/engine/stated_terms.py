"""What an operator says beforehand: terms that are in from the start, to stay or only to begin with."""

from dataclasses import dataclass

from calib.diagnose.engine.candidates import Candidate

Site = tuple[str, str]  # an effect's name and a place


@dataclass(frozen=True, slots=True)
class Given:
    """assumed : terms that are there, whatever the data say of them; before : terms seen before, that have to stand
    like any other.
    """

    assumed: tuple[Site, ...] = ()
    before: tuple[Site, ...] = ()

    @property
    def first(self) -> tuple[Site, ...]:
        """All that is in from the start, what is assumed first."""
        return tuple(dict.fromkeys((*self.assumed, *self.before)))

    def holds(self, candidate: Candidate) -> bool:
        """Whether a term stays whatever the data say."""
        return (candidate.name, candidate.place) in self.assumed


UNSAID = Given()
