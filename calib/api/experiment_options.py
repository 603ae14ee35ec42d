"""What the next experiment of a diagnosis may take and ask for."""

from dataclasses import dataclass

from rig.errors import RigError
from rig.model.cube_remounting import parse_cube_turn_permission
from rig.model.design import PERMITTED, TURN, Design

LONGEST = 6000.0  # min


@dataclass(frozen=True, slots=True)
class ExperimentOptions:
    """minutes : that the experiment may take; may : what may be asked of an operator ("payload", "wait", "turn cube
    NAME"), None for what rig.toml says; standing : whether the struts must stand to be exposed; seed : of the plan
    """

    minutes: float = 60.0
    may: tuple[str, ...] | None = None
    standing: bool = False
    seed: int = 1

    def __post_init__(self) -> None:
        if not 0 < self.minutes <= LONGEST:
            raise RigError(f"--minutes takes a time above 0 and up to {LONGEST:g} min, not {self.minutes:g}")
        for word in self.may or ():
            if word not in PERMITTED and not word.startswith(TURN):
                raise RigError(f"--may takes {', '.join(PERMITTED)} or '{TURN}NAME', not {word!r}")

    def interventions(self, design: Design) -> tuple[str, ...]:
        """What an experiment may ask of an operator, cubes by their names. Raises RigError for a cube that the design
        does not have
        """
        out = []
        for word in self.may or design.experiment.may:
            may, problem = parse_cube_turn_permission(word, design.targets)
            if problem:
                raise RigError(f"--may {word!r}: {problem}")
            out.append(may)
        return tuple(out)
