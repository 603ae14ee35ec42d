"""What users most likely did wrong, recognised by what it leaves in a recording; what needs no vision is here."""

from rig.checks.mistake_dataclass_and_clock_mistakes import Mistake, sort_mistakes

__all__ = ["Mistake", "sort_mistakes"]
