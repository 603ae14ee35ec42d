"""User's kinematics file, loaded and run.

Axes, parameters, home, inverse and forward; loaded, run and checked.

The file is run: it is a program, to be trusted as one. What is wrong with it is reported with file and line.
"""

import ast
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from traceback import extract_tb
from types import ModuleType
from typing import Literal, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.errors import FileError, RigError

FREEDOMS = ("x", "y", "z", "rx", "ry", "rz")
GROUPS = (FREEDOMS, ("x", "y", "z", "rz"), ("x", "y", "rz"))  # of freedoms in which a platform turns
LARGEST = {"m": 50.0, "rad": 50.0}  # no machine is larger, so a larger figure is in another unit
OTHER = {"m": "millimetres", "rad": "degrees"}
LARGEST_TOLERANCE = {"m": 0.05, "rad": 0.5}
TINY = 1e-30  # m or rad, of a complex step
STEP = 2e-4  # m or rad, of a difference
NEARER = (1e-2, 1e-4)  # of it, where a difference leaves the reach of the axes
STENCIL = ((1, 8 / 12), (-1, -8 / 12), (2, -1 / 12), (-2, 1 / 12))  # central difference of fourth order

Unit = Literal["m", "rad"]


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis that is commanded. name : heads its column in commands.csv; unit : "m" or "rad"; low, high : its travel,
    in unit
    """

    name: str
    unit: Unit
    low: float
    high: float

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.isidentifier() or self.name in ("t", "frame"):
            raise ValueError(f"the name of an axis is a word of letters and digits, not {self.name!r}")
        _require_unit(f"axis {self.name!r}", self.unit)
        for value in (self.low, self.high):
            _require_size(f"the travel of axis {self.name!r}", value, self.unit, LARGEST)
        if not self.low < self.high:
            raise ValueError(
                f"the travel of axis {self.name!r} must run from small to large, not {self.low:g} .. {self.high:g} "
                f"{self.unit}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Parameter:
    """A geometric parameter, a number or an array of them. nominal : as the owner believes it, in unit ("m" or "rad")
    tolerance : how far off each may well be (one standard deviation), in unit, one number or one of each; 0 holds it
    """

    name: str
    nominal: ArrayLike
    unit: Unit
    tolerance: ArrayLike
    values: Floats = field(init=False)
    tolerances: Floats = field(init=False)

    def __post_init__(self) -> None:
        what = f"parameter {self.name!r}"
        if not isinstance(self.name, str) or not self.name.isidentifier():
            raise ValueError(f"the name of a parameter is a word of letters, digits and underscores, not {self.name!r}")
        _require_unit(what, self.unit)
        values = np.array(self.nominal, float)
        tolerances = np.array(np.broadcast_to(np.asarray(self.tolerance, float), values.shape))
        for value in values.ravel().tolist():
            _require_size(what, value, self.unit, LARGEST)
        for value in tolerances.ravel().tolist():
            _require_size(f"the tolerance of {what}", value, self.unit, LARGEST_TOLERANCE)
            if value < 0:
                raise ValueError(f"the tolerance of {what} is {value:g} {self.unit}; it cannot be negative")
        for name, array in (("values", values), ("tolerances", tolerances)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its numbers: "bars 1", "rails 2 3", counted from 1."""
        return tuple(" ".join([self.name, *(str(i + 1) for i in at)]) for at in np.ndindex(self.values.shape))


@dataclass(frozen=True, slots=True, eq=False)
class KinematicsFile:
    """A kinematics file that was loaded. name : of the file; sha256 : of its text; axes; parameters; freedoms: which
    of a pose's coordinates its platform can change; home : (4, 4) T_base_platform
    batched : whether inverse takes many poses at once; complex_step : whether derivatives are taken by complex step
    shorter : share of the step that differences take
    """

    name: str
    sha256: str
    axes: tuple[Axis, ...]
    parameters: tuple[Parameter, ...]
    freedoms: tuple[int, ...]
    home: Floats
    module: ModuleType
    lines: dict[str, int]
    batched: bool = False
    forward_batched: bool = False
    complex_step: bool = False
    shorter: float = 1.0

    @property
    def nominal(self) -> Floats:
        """(p,) the parameters as the owner believes them."""
        return np.concatenate([one.values.ravel() for one in self.parameters])

    @property
    def tolerances(self) -> Floats:
        """(p,) their tolerances."""
        return np.concatenate([one.tolerances.ravel() for one in self.parameters])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters' numbers."""
        return tuple(name for one in self.parameters for name in one.names)

    @property
    def units(self) -> tuple[Unit, ...]:
        """Unit of each of them."""
        return tuple(one.unit for one in self.parameters for _ in one.names)

    @property
    def has_forward(self) -> bool:
        """Whether the file states forward kinematics."""
        return hasattr(self.module, "forward")

    def by_name(self, p: Floats) -> dict[str, Floats | float]:
        """{name: number or array} of parameters (p,), as the file's functions take them."""
        out: dict[str, Floats | float] = {}
        at = 0
        for one in self.parameters:
            size = one.values.size
            out[one.name] = p[at : at + size].reshape(one.values.shape) if one.values.shape else p[at]
            at += size
        return out

    def inverse(self, poses: Floats, p: Floats) -> Floats:
        """Axis values (n, axes) of poses (n, 4, 4) by parameters (p,), real or complex; NaN where there are none.
        Raises FileError where the file's function fails or answers another shape."""
        return self._called("inverse", poses, p, (len(self.axes),), self.batched)

    def forward(self, values: Floats, p: Floats) -> Floats:
        """Poses (n, 4, 4) of axis values (n, axes), by the file's forward. Raises FileError as `inverse`."""
        return self._called("forward", values, p, (4, 4), self.forward_batched)

    def _called(self, name: str, given: Floats, p: Floats, shape: tuple[int, ...], batched: bool) -> Floats:
        function, by_name = getattr(self.module, name), self.by_name(p)
        with self._reported(name), np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", np.exceptions.ComplexWarning)  # of a complex step that a function discards
            found = (
                function(given, by_name)
                if batched
                else [
                    _one(function, one, by_name, shape) if name == "inverse" else function(one, by_name)
                    for one in given
                ]
            )
            out = np.asarray(found)
        expected = (len(given), *shape)
        if out.shape != expected and len(given):
            raise self.error(
                f"{name} returns shape {out.shape if batched else np.shape(found[0])}, expected "
                f"{expected if batched else shape}",
                name,
            )
        if out.dtype.kind not in "fciu":
            raise self.error(f"{name} returns {out.dtype}, expected numbers", name)
        return out.reshape(expected)

    @contextmanager
    def _reported(self, name: str) -> Iterator[None]:
        """Report what a function of the file raises with the file's line."""
        try:
            yield
        except RigError:
            raise
        except Exception as error:
            raise self.error(
                f"{name} fails: {type(error).__name__}: {error}", name, _within(error, self.name)
            ) from None

    def error(self, message: str, name: str = "", line: int | None = None) -> FileError:
        """FileError at a line of the file, or where it defines a name."""
        return FileError(self.name, message, self.lines.get(name) if line is None else line)

    def derivative(self, moved: Callable[[float | complex], Floats], step: float = STEP) -> Floats:
        """Derivative (...) of moved(s) with s at 0: by complex step, or by differences of fourth order.

        Source of the complex step: Squire and Trapp, Using complex variables to estimate derivatives, SIAM Review 1998
        """
        if self.complex_step:
            return np.asarray(np.imag(moved(TINY * 1j)) / TINY)
        out = _differences(moved, step * self.shorter)
        for share in NEARER:
            if np.isfinite(out).all():
                break
            out = np.where(np.isfinite(out), out, _differences(moved, step * self.shorter * share))
        return out


def _differences(moved: Callable[[float | complex], Floats], step: float) -> Floats:
    """Derivative (...) of moved(s) with s at 0 by differences of fourth order; NaN where these leave its reach."""
    return cast(Floats, sum(weight * moved(k * step) for k, weight in STENCIL) / step)


def _one(
    function: Callable[[Floats, dict[str, Floats | float]], Floats],
    given: Floats,
    by_name: dict[str, Floats | float],
    shape: tuple[int, ...],
) -> Floats:
    """What a function answers of one pose; NaN where Python's math has no answer, as numpy's functions have it."""
    try:
        return function(given, by_name)
    except ZeroDivisionError:
        return np.full(shape, np.nan)
    except ValueError as error:
        if not re.match(r"math domain error|expected a \w+ (input|number)", str(error)):
            raise
        return np.full(shape, np.nan)


def run_kinematics_source_without_function_checks(source: str, name: str) -> KinematicsFile:
    """KinematicsFile of a source text, run, its statements checked but its functions not yet called.

    name : of its file, in errors. Raises FileError with the line of what is wrong
    """
    module = ModuleType(f"kinematics_{sha256(source.encode()).hexdigest()[:16]}")
    module.__file__ = name
    try:
        exec(compile(source, name, "exec"), vars(module))
    except SyntaxError as error:
        raise FileError(name, f"is no Python: {error.msg}", error.lineno, error.offset) from None
    except Exception as error:
        raise FileError(name, f"cannot be run: {type(error).__name__}: {error}", _within(error, name)) from None
    return _stated(module, source, name)


def _stated(module: ModuleType, source: str, name: str) -> KinematicsFile:
    """What a file states, each figure checked alone."""
    lines, stated = _lines(source), vars(module)

    def refuse(message: str, at: str) -> FileError:
        return FileError(name, message, lines.get(at))

    for key, what in (
        ("axes", "a tuple of Axis(name, unit, low, high)"),
        ("parameters", "a tuple of Parameter(name, nominal, unit, tolerance)"),
        ("home", "the pose x y z rx ry rz of the platform at home, m and rad"),
        ("inverse", "a function inverse(pose, parameters)"),
    ):
        if key not in stated:
            raise refuse(f"states no {key}: {what}", key)
    for key, kind in (("axes", Axis), ("parameters", Parameter)):
        listed = stated[key]
        if not isinstance(listed, tuple | list) or not listed or not all(isinstance(one, kind) for one in listed):
            raise refuse(f"{key} must be a tuple of {kind.__name__}, got {listed!r}"[:200], key)
        names = [one.name for one in listed]
        if len(set(names)) < len(names):
            raise refuse(f"{key}: {next(n for n in names if names.count(n) > 1)!r} is stated twice", key)
    for key in ("inverse", "forward"):
        if key in stated and not callable(stated[key]):
            raise refuse(f"{key} must be a function, got {stated[key]!r}"[:200], key)
    axes, parameters = tuple(stated["axes"]), tuple(stated["parameters"])
    freedoms = tuple(stated.get("freedoms", FREEDOMS))
    problem = _freedoms_problem(freedoms, len(axes))
    if problem:
        raise refuse(problem, "freedoms" if "freedoms" in stated else "axes")
    try:
        home = np.array(stated["home"], float)
    except (TypeError, ValueError):
        home = np.zeros(0)
    if home.shape != (6,) or not np.isfinite(home).all():
        raise refuse(f"home must be six numbers x y z rx ry rz, m and rad, got {stated['home']!r}"[:200], "home")
    if np.abs(home[:3]).max() > LARGEST["m"] or np.abs(home[3:]).max() > 2 * np.pi:
        raise refuse(f"home is {home.tolist()}; positions are in m and the rotation vector in rad", "home")
    if len(freedoms) < 6 and home[3:].any():
        raise refuse(
            f"home turns by {home[3:].tolist()} rad; a platform of fewer than six freedoms stands parallel to "
            "the base there: turn the platform's frame instead",
            "home",
        )
    if not any(one.tolerances.any() for one in parameters):
        raise refuse("parameters: every tolerance is 0, so no calibration could change anything", "parameters")
    return KinematicsFile(
        name,
        sha256(source.encode()).hexdigest(),
        axes,
        parameters,
        tuple(FREEDOMS.index(one) for one in freedoms),
        _matrix(home),
        module,
        lines,
    )


def _matrix(home: Floats) -> Floats:
    """(4, 4) of a home pose (6,): m, and a rotation vector in rad."""
    return RigidTransform.from_components(home[:3], Rotation.from_rotvec(home[3:])).as_matrix()


def _freedoms_problem(freedoms: tuple[str, ...], axes: int) -> str | None:
    """What is wrong with freedoms of so many axes, in words; None where nothing is."""
    if (
        any(one not in FREEDOMS for one in freedoms)
        or tuple(sorted(freedoms, key=FREEDOMS.index)) != freedoms
        or (len(set(freedoms)) < len(freedoms) or not freedoms)
    ):
        return f"freedoms must be some of {', '.join(FREEDOMS)}, in this order, got {freedoms!r}"
    if any(one.startswith("r") for one in freedoms) and freedoms not in GROUPS:
        return (
            f"freedoms {', '.join(freedoms)} are not supported: a platform that turns has "
            f"{' or '.join(' '.join(group) for group in GROUPS)}"
        )
    if len(freedoms) != axes:
        return f"{axes} axes move {len(freedoms)} freedoms ({', '.join(freedoms)}); there must be as many of each"
    return None


def _require_unit(what: str, unit: object) -> None:
    if unit not in LARGEST:
        raise ValueError(f"the unit of {what} is m or rad, not {unit!r}")


def _require_size(what: str, value: float, unit: Unit, largest: dict[str, float]) -> None:
    if not np.isfinite(value):
        raise ValueError(f"{what} is {value}, expected a finite number")
    if abs(value) > largest[unit]:
        raise ValueError(f"{what} is {value:g} {unit}, more than {largest[unit]:g} {unit}: is it in {OTHER[unit]}?")


def _lines(source: str) -> dict[str, int]:
    """{name: line} of what a source text defines at its top level."""
    out: dict[str, int] = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef):
            out[node.name] = node.lineno
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        out |= {target.id: node.lineno for target in targets if isinstance(target, ast.Name)}
    return out


def _within(error: Exception, name: str) -> int | None:
    """The last line of a file that an error came through."""
    lines = [frame.lineno for frame in extract_tb(error.__traceback__) if frame.filename == name]
    return lines[-1] if lines else None
