"""A case: a secret machine, its owner's belief, its fault, its day and its recording's plan, all drawn from a seed."""

from dataclasses import dataclass, replace

import numpy as np

from tests.truth.camera_sets import CameraSet, Sight, watching
from tests.truth.draw_faults import FAULTS, HURRIED, LOADED, SLOW, FaultRequest, fits
from tests.truth.draw_machines import nominal, secret
from tests.truth.journey import PLANS, Journey, journey, middle, visits
from tests.truth.kinematics import Machine, SixStruts
from tests.truth.laws import Law, stood
from tests.truth.motion import Conditions
from tests.truth.rigid import displaced, rows_of
from tests.truth.sights import SIGHTS, Scene

STRENGTHS = ("none", "weak", "strong")
LARGEST = 0.5  # px, of what a fault of seeing does to a corner


@dataclass(frozen=True)
class Case:
    """owner, machine : the machine as believed and as it is; laws : its faults; day : Conditions; journey : Journey
    that was recorded
    seen : (n, 6) poses in poses.csv, or (k, 6) rows of corners.csv; sigma : (m, rad) of the instrument, a coordinate;
        speeds : (axes,); dwell : s
    mass, centre, payload : kg, m, m as rig.toml states them; logged : which sensors are kept: "temperature", "payload"
        or ""
    size : m, of the fault on an axis, of SIGHTS in the same share of the noise; camera_set : cameras, None where an
        instrument looks
    """

    seed: int
    kind: str
    effect: str
    strength: str
    plan: str
    variant: int
    owner: Machine
    machine: Machine
    laws: tuple[Law, ...]
    day: Conditions
    journey: Journey
    seen: np.ndarray
    sigma: tuple[float, float]
    speeds: np.ndarray
    dwell: float
    mass: float
    centre: np.ndarray
    payload: np.ndarray
    logged: str
    size: float
    camera_set: CameraSet | None = None


def draw(
    seed: int,
    effect: str = "backlash",
    strength: str = "strong",
    plan: str = "shuffled",
    kind: str = "hexapod",
    count: int | None = None,
    variant: int | None = None,
    seen: bool | None = None,
) -> Case:
    """Case of a seed: the same for the same arguments, on any computer with the same numpy.

    effect : a name of FAULTS or of SIGHTS, or "none"; strength : of STRENGTHS: nothing, one to two standard deviations
    of the instrument, or ten to fifty; plan : of PLANS; kind : of draw_machines.KINDS; count : configurations, 14
    (ladders) or 14 to 60 by default;
    variant : which of the fault's laws, any by default; seen : whether cameras look at cubes, in place of an
        instrument; by default for SIGHTS alone
    Raises ValueError for names that are not known.
    """
    seen = effect in SIGHTS if seen is None else seen
    if strength not in STRENGTHS or plan not in PLANS or effect not in (*FAULTS, *SIGHTS, "none"):
        raise ValueError(f"no case of {effect!r}, {strength!r}, {plan!r}")
    if not fits(effect, kind) or (seen and kind != "hexapod") or (effect in SIGHTS and not seen):
        raise ValueError(f"there is no law of {effect} for a machine of kind {kind!r}")
    rng = np.random.default_rng([seed, *effect.encode(), *plan.encode(), *kind.encode()])
    owner = nominal(kind, rng)
    machine = secret(owner, float(10 ** rng.uniform(-4.3, -3)), rng)
    sigma = float(10 ** rng.uniform(-6, -5.2))
    if count is None:
        count = 14 if plan == "ladders" else int(rng.integers(14, 61))
        count = max(count, 20) if kind != "hexapod" else min(count, 30) if seen else count
    dwell = (
        60.0 if effect in SLOW or effect == "focal_drift" else float(rng.uniform(5, 20)) if effect == "creep" else 2.0
    )
    speeds = np.where(np.ptp(owner.ranges, axis=1) > 0.5, 0.5, 0.02)
    path = journey(visits(plan, owner.ranges, count, rng), owner.ranges.mean(axis=1), speeds, dwell, effect in HURRIED)
    warmth = float(rng.uniform(4, 8))
    span = float(path.t[-1])
    mass = float(rng.uniform(5, 20))
    centre, payload = np.array([0, 0, rng.uniform(0.01, 0.05)]), np.array([0, 0, rng.uniform(0.05, 0.15)])
    loads = np.array([[0.0, 0.0]])
    if effect in LOADED and rng.uniform() < 0.7:
        loads = np.array([[0.0, 0.0], [span / 3, 0.6 * mass], [2 * span / 3, 0.3 * mass]])
    day = Conditions(
        (20 + rng.uniform(-1, 1), warmth * rng.choice([-1, 1]), 0.2 * warmth, span / rng.uniform(1.2, 2.5), span),
        rng.uniform(0, 0.3, owner.width) * warmth,
        loads,
    )
    axes = np.zeros(owner.width)
    if rng.uniform() < 0.5:
        axes[int(rng.integers(owner.width))] = 1.0
    else:
        axes = rng.uniform(0.3, 1.2, owner.width)
    size = {"none": 0.0, "weak": float(rng.uniform(1, 2)), "strong": float(10 ** rng.uniform(1, 1.7))}[strength]
    camera_set = _camera_set(owner, effect, size, (span, warmth), variant, rng) if seen else None
    sigma = (
        sigma if camera_set is None else camera_set.sigma * 4.5 * float(np.linalg.norm(owner.base[0])) / 1650.0 / 3
    )  # some ten corners' share of a pose
    laws: tuple[Law, ...] = ()
    if size > 0 and effect in FAULTS:
        scale = np.where(np.ptp(owner.ranges, axis=1) > 0.5, 2.0, 1.0)  # an arm's angles, at half a metre
        found = FAULTS[effect](
            FaultRequest(size * sigma, axes * scale, machine, path, warmth, mass, centre, payload, rng)
        )
        chosen = int(rng.integers(len(found)))
        variant = chosen if variant is None else variant % len(found)
        laws = (found[variant],)
    sigmas = (sigma, sigma / 0.1)
    logged = (
        "temperature"
        if effect in ("thermal_expansion", "base_expansion", "focal_drift")
        else "payload"
        if effect in LOADED
        else ""
    )
    case = Case(
        seed,
        kind,
        effect,
        strength,
        plan,
        variant or 0,
        owner,
        machine,
        laws,
        day,
        path,
        np.zeros((0, 6)),
        sigmas,
        speeds,
        dwell,
        mass,
        centre,
        payload,
        logged,
        size * sigma,
        camera_set,
    )
    return replace(case, seen=_seen(case, rng))


def recorded_anew(case: Case, plan: str = "shuffled") -> Case:
    """The same machine, fault and day recorded once more, by a plan with as many configurations drawn anew (14 with
    ladders).
    """
    rng = np.random.default_rng([case.seed, 99])
    count = 14 if plan == "ladders" else min(len(case.journey.looked), 60)
    places = visits(plan, case.owner.ranges, count, rng)
    path = journey(places, case.owner.ranges.mean(axis=1), case.speeds, case.dwell, case.effect in HURRIED)
    case = replace(case, plan=plan, journey=path)
    return replace(case, seen=_seen(case, rng))


def _seen(case: Case, rng: np.random.Generator) -> np.ndarray:
    """What was seen of a case, as in Case.seen."""
    if case.camera_set is None:
        noise = rng.normal(size=(len(case.journey.looked), 6)) * np.repeat(case.sigma, 3)
        return rows_of(displaced(stood(case.machine, case.journey, case.day, case.laws), noise))

    def bodies_at(late: np.ndarray) -> np.ndarray:
        return stood(case.machine, case.journey, case.day, case.laws, case.journey.looked + late)

    return case.camera_set.corners(case.journey.looked, bodies_at, case.day, rng)


def _camera_set(
    owner: SixStruts,
    effect: str,
    size: float,
    lasted: tuple[float, float],
    variant: int | None,
    rng: np.random.Generator,
) -> CameraSet:
    """Cameras about a platform, with a fault of so many standard deviations of a corner. lasted : (s, K) of the
    recording and its warmth
    """
    radius, sigma = float(np.linalg.norm(owner.base[0])), float(rng.uniform(0.02, 0.06))
    own = rng.spawn(1)[0]  # so that all else is drawn alike, whatever the fault
    scene = Scene(min(size * sigma, LARGEST), 1650.0, 4.5 * radius, *lasted, 0.012, 0.22 * radius, own)
    found = SIGHTS[effect](scene) if effect in SIGHTS and size > 0 else [Sight()]
    return watching(
        radius,
        owner.height,
        found[int(own.integers(len(found))) if variant is None else variant % len(found)],
        sigma,
        rng,
    )


def wanted(case: Case, count: int = 120) -> np.ndarray:
    """(count, 4, 4) fresh poses to be driven to: the owner's own of values scattered over the middle 80 % of the
    travels.
    """
    rng = np.random.default_rng([case.seed, 77])
    ranges = case.owner.ranges
    if case.kind == "arm":  # whose workspace is what was recorded of each joint
        ranges = np.stack([case.journey.values.min(axis=0), case.journey.values.max(axis=0)], axis=1)
    return case.owner.forward(middle(ranges, rng.uniform(size=(count, len(ranges)))))


def drive(case: Case, values: np.ndarray) -> np.ndarray:
    """(n, 4, 4) poses at which the machine really stands when commanded to values (n, axes) in turn, as fast and with
    dwells as recorded.

    It is homed and starts anew, and the recording's day with it, as often as the day recorded is over: conditions stay
    inside those recorded.
    Homing takes lost steps away.
    """
    out, home, left = [], case.owner.ranges.mean(axis=1), np.asarray(values, float)
    while len(left):
        ends = journey(left, home, case.speeds, case.dwell, case.effect in HURRIED).looked
        count = max(int(np.searchsorted(ends, case.journey.t[-1])), 1)
        path = journey(left[:count], home, case.speeds, case.dwell, case.effect in HURRIED)
        out.append(stood(case.machine, path, case.day, _later(case)))
        left = left[count:]
    return np.concatenate(out)


def drive_in_time(case: Case, t: np.ndarray, values: np.ndarray, looked: np.ndarray) -> np.ndarray:
    """(n, 4, 4) poses at which the machine really stands at looked (n,) s, under command rows t (k,) s, values (k,
    axes) that begin the day.
    """
    return stood(case.machine, Journey(t, values, looked), case.day, _later(case))


def _later(case: Case) -> tuple[Law, ...]:
    return tuple(law.later() for law in case.laws)
