"""Possible machines given the recorded poses, and the pose errors of a correction on them over the workspace."""

from dataclasses import dataclass, replace

import numpy as np

from calib.certification.strut_deviation_kernels import CONDITION, CONFIGURATION, PLACE, SAMPLE, Component
from rig.arrays import Booleans, Floats

ANY = "any"
SURELY = 0.95  # probability from which a component is reported
# of the greatest singular value; combinations of a strut's parameters that are fainter stand for no function of place
FAINT = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Machines:
    """d machines about a fit, and what their struts do at m places of the workspace.

    parameters : (d, p) m, less the fitted ones; components : per strut its Components; parts : per strut (d, its
    components) m^2, mean square over the workspace of each
    mean : (d, m, axes) m by which struts are longer at the places than commanded, in the mean over the ways to come
    there; variance : (d, m, axes) m^2 about that; together : (d, axes, axes) m^2, covariance of what goes by time,
    temperature and load as recorded
    seen : (d, axes, axes) m^2, likewise of what either the struts do or whoever measured them saw amiss; amiss : (d,)
        bool, where it is the latter
    """

    parameters: Floats
    components: list[list[Component]]
    parts: list[Floats]
    mean: Floats
    variance: Floats
    together: Floats
    seen: Floats
    amiss: Booleans

    def squares(self, jacobian: Floats, back: Floats, offset: Floats, rho: Floats) -> tuple[Floats, Floats]:
        """(before, after), each (d, 2) m^2 and rad^2: the pose error's mean square over the places, by the owner's
        model and corrected.

        jacobian : (m, 6, p) and back : (m, 6, axes) of poses with parameters and struts; offset : (m, 6) of the owner's
        model against the corrected one; rho : (m, axes) m, the remainder
        """
        error = np.einsum("mip,dp->dmi", jacobian, self.parameters) + np.einsum("mia,dma->dmi", back, self.mean + rho)
        beyond = np.einsum("mia,dma->di", back**2, self.variance) / len(back)
        together = self.together + self.seen * ~self.amiss[:, None, None]
        beyond += np.einsum("mia,dab,mib->di", back, together, back, optimize=True) / len(back)
        before, after = (
            ((whole**2).mean(axis=1) + beyond).reshape(-1, 2, 3).sum(axis=2) for whole in (error + offset, error)
        )
        return before, after

    def second_moments(self, loops: Floats, rho: Floats) -> tuple[Floats, Floats]:
        """((p, p) m^2 of the parameters about the fitted ones, (axes, axes) m^2 of what struts are off besides), which
        over the workspace add up to what the machines do there: what is a function of place counts as parameters as far
        as these can stand for it.

        loops : (m, axes, p) derivatives of the struts' closures with the parameters at the places; rho : (m, axes) m,
            the remainder
        """
        beyond, parameters = self.mean + rho, self.parameters.copy()
        left = np.empty_like(beyond)
        for i in range(beyond.shape[2]):
            found = beyond[:, :, i] @ np.linalg.pinv(loops[:, i], rcond=FAINT).T
            parameters += found
            left[:, :, i] = beyond[:, :, i] - found @ loops[:, i].T
        rows = left.reshape(-1, left.shape[2])
        own = (
            np.diag(self.variance.mean(axis=(0, 1)))
            + (self.together + self.seen).mean(axis=0)
            + rows.T @ rows / len(rows)
        )
        return parameters.T @ parameters / len(parameters), (own + own.T) / 2

    def with_more(self, parameters: Floats, course: Floats) -> "Machines":
        """The machines with errors added. parameters : (d, p) m; course : (d, n, axes) m, of struts in the course of
        the recording
        """
        about = course - course.mean(axis=1, keepdims=True)
        more = np.swapaxes(about, 1, 2) @ about / course.shape[1]
        return replace(
            self,
            parameters=self.parameters + parameters,
            mean=self.mean + course.mean(axis=1)[:, None],
            together=self.together + more,
        )

    def moved(self, parameters: Floats) -> "Machines":
        """The machines about another fit, whose parameters exceed this one's by (p,) m."""
        return replace(self, parameters=self.parameters - parameters)

    def unexplained(self, corrected: tuple[bool, ...], axis: str) -> tuple[str, ...]:
        """A sentence for each thing that struts do, almost certainly, and that nothing corrects.

        corrected : per strut, whether functions of place are; axis : what an axis is called
        """
        found: dict[tuple[str, str], dict[int, float]] = {}
        rest = []
        for i, (own, parts) in enumerate(zip(self.components, self.parts)):
            groups = {
                (part.over, part.word if part.over == CONDITION else ""): None
                for part in own
                if not (part.over == PLACE and corrected[i])
            }
            squares = {
                key: parts[:, [(part.over, part.word if part.over == CONDITION else "") == key for part in own]].sum(
                    axis=1
                )
                for key in groups
            }
            sure = [key for key, square in squares.items() if _surely(square)]
            for key in sure:
                found.setdefault(key, {})[i] = _size(squares[key])
            rest.append(np.sum([square for key, square in squares.items() if key not in sure], axis=0))
            if not sure and _surely(rest[-1]):
                found.setdefault((ANY, ""), {})[i] = _size(rest[-1])
        if not found and _surely(np.sum(rest, axis=0)):
            return (
                f"the {axis}s together leave {_size(np.sum(rest, axis=0)) * 1e6:.2g} um beyond what the "
                "poses' stated noise explains, "
                "of which no single one or cause stands out",
            )
        return tuple(_sentence(over, word, sizes, axis) for (over, word), sizes in found.items())


def _surely(squares: Floats) -> bool:
    return bool((squares > 0).mean() > SURELY)


def _size(squares: Floats) -> float:
    return float(np.sqrt(np.median(squares[squares > 0])))


def _sentence(over: str, word: str, sizes: dict[int, float], axis: str) -> str:
    struts = f"{axis}{'' if len(sizes) == 1 else 's'} {', '.join(str(i + 1) for i in sizes)}"
    size = f"{max(sizes.values()) * 1e6:.2g} um" + ("" if len(sizes) == 1 else " at most")
    what = {
        SAMPLE: f"scatter by {size} beyond what the poses' stated noise explains",
        CONFIGURATION: f"differ from configuration to configuration by {size}, with no pattern "
        "that these poses resolve",
        ANY: f"are {size} beyond what the poses' stated noise explains, of a cause that these poses do not single out",
        PLACE: f"depend on the configuration, {size}, which no remainder corrects",
    }
    return (
        f"{struts}: residuals {what.get(over, f'depend on {word}, {size}, which nothing in this calibration corrects')}"
    )
