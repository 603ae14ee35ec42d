"""Simulation of a machine's motion.

Poses of the machine from commands through time, with effects.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.machine_motion_and_play import Motion, Path
from rig.errors import NotConverged, RigError
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.design import Design
from rig.model.mechanisms import hexapod, mechanism_chain, redundant_strut_best_six_legs_and_loop_closures
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Mechanism,
    has_stages,
    is_redundant,
    require_arm,
    require_axes,
    require_parallel,
)
from rig.model.pose import exp, pose_difference
from rig.recording.recording_folder import Commands, Sensors

MAX_ITERATIONS = 50
TOLERANCE = 1e-12  # m or rad; of the fixed point between a pose and what depends on it
ABOUT = 0.02  # s; before and after an exposure, for its velocity


@dataclass(frozen=True, slots=True, eq=False)
class MachineRun:
    """What a machine did at n exposures.

    T_base_platform : RigidTransform (n,); deviation : (n, axes) m or rad the axes stood beyond their command
    rate, curvature : (n, 6) tangent per s and per s^2 at the exposure (on the right), None where not asked for
    stages : of a chain T_base_stage : RigidTransform (n,) of every stage's platform but the last, which is
        T_base_platform; of an arm with several hands those of its second hand and on
    """

    T_base_platform: RigidTransform
    deviation: Floats
    rate: Floats | None = None
    curvature: Floats | None = None
    stages: tuple[RigidTransform, ...] = ()


def motion_of_commands(
    design: Design,
    commands: Commands,
    t: Floats,
    effects: Iterable[Effect] = (),
    sensors: Sensors | None = None,
    T: RigidTransform | None = None,
) -> Motion:
    """Motion of a design's commands at exposures logged at t (n,) s.

    Clock and path under effects.
    commands : Commands; effects : Effects; sensors : Sensors or None; T : T_base_platform (n,) there, None where it is
        not known
    """
    t = np.asarray(t, float)
    began = np.r_[0.0, commands.starts][
        np.searchsorted(commands.starts, t, side="right")
    ]  # each recording sets its clocks anew
    for effect in effects:
        if type(effect).times is not Effect.times:
            t = began + effect.times(t - began)
    knots = np.union1d(commands.t, t)
    lengths = np.stack([np.interp(knots, commands.t, column) for column in commands.values.T], axis=1)
    path = Path(knots, lengths, np.searchsorted(knots, t), commands.starts)
    for effect in effects:
        path = effect.follow(path, mechanisms.axis_place_texts(design.mechanism))
    home = mechanisms.kinematics_of(design.mechanism).home_values(design.mechanism)
    return Motion(
        require_axes(design.mechanism), design.platform, design.actuator, design.gravity, t, path, sensors, home, T
    )


def simulate_machine_run(
    design: Design,
    commands: Commands,
    t: Floats,
    effects: Sequence[Effect] = (),
    sensors: Sensors | None = None,
    rates: bool = False,
) -> MachineRun:
    """Simulate the run of a design's machine under commands.

    With effects.
    Its poses and, if requested, rates.
    design : Design as it really is; commands : Commands; t : (n,) s, exposures as logged; effects : Effects, acting
        together
    sensors : Sensors with the channels that some effects need; rates : whether velocities are wanted too
    Effects that depend on the pose are solved with it as a fixed point. Raises NotConverged where there is none,
    RigError for an effect that the machine or its recording lacks something for, and what `forward` raises.
    """
    if rates:
        return _with_rates(design, commands, np.asarray(t, float), effects, sensors)
    state = motion_of_commands(design, commands, t, effects, sensors)
    m = design.mechanism
    for effect in effects:
        reason = effect.needs(state)
        if reason:
            raise RigError(f"{effect.name} {reason}")
    fixed = sum((e.deviation(state) for e in effects if not e.on_pose), np.zeros(state.lengths.shape))
    T = _held_poses(state.lengths + fixed, m)
    deviation = fixed
    bound = [effect for effect in effects if effect.on_pose]
    for _ in range(MAX_ITERATIONS if bound else 0):
        state = replace(state, T=T)
        before, deviation = deviation, fixed + sum(effect.deviation(state) for effect in bound)
        if np.abs(deviation - before).max() < TOLERANCE:
            break
        T = _held_poses(state.lengths + deviation, m, T)
    else:
        if bound:
            left = np.abs(deviation - before).max(axis=1)
            failed = np.flatnonzero(left >= TOLERANCE)
            raise NotConverged(
                f"no balance between pose and {', '.join(e.name for e in bound)} at {len(failed)} exposures",
                failed,
                state.lengths[failed],
                left[failed],
            )
    sway = sum((effect.sway(state) for effect in effects), np.zeros((len(state.t), 6)))
    stages = mechanism_chain.stage_poses(state.lengths + deviation, m)[:-1] if has_stages(m) else []
    if hand_names(m) and not require_arm(m).hand:
        others = [replace(design, mechanism=require_arm(m).of_hand(k)) for k in range(1, len(hand_names(m)))]
        stages = [simulate_machine_run(one, commands, t, effects, sensors).T_base_platform for one in others]
    return MachineRun(T * exp(sway) if sway.any() else T, deviation, stages=tuple(stages))


def _held_poses(lengths: Floats, mechanism: Mechanism, guess: RigidTransform | None = None) -> RigidTransform:
    """T_base_platform (n,) of lengths or axis values (n, axes): where the driven struts hold it, followers aside."""
    if is_redundant(mechanism) and mechanism.followers:
        driven = redundant_strut_best_six_legs_and_loop_closures.hexapod_of_actuated_struts(mechanism)
        return hexapod.forward(
            lengths[..., redundant_strut_best_six_legs_and_loop_closures.actuated_strut_numbers(mechanism)],
            driven,
            guess,
        )
    return mechanisms.kinematics_of(mechanism).forward(lengths, mechanism, guess)


def commands_with_followers(
    design: Design, commands: Commands, t: Floats, effects: Sequence[Effect] = (), sensors: Sensors | None = None
) -> Commands:
    """Commands with the lengths of the followers.

    They are as long as they read while the driven struts hold the platform.
    The arguments are those of `simulate_machine_run`; exposures at t (n,) s in motion get a row of their own, for
    followers do not move evenly between others. Of a machine without followers the commands themselves
    """
    m = design.mechanism
    if not is_redundant(m) or not m.followers:
        return commands
    k = np.clip(np.searchsorted(commands.t, t), 1, len(commands.t) - 1)
    moving = (commands.values[k] != commands.values[k - 1]).any(axis=1)
    rows = np.union1d(commands.t, t[moving])
    run, values = simulate_machine_run(design, commands, rows, effects, sensors), commands.at(rows)
    some = list(m.followers)
    values[:, some] = (hexapod.inverse(run.T_base_platform, m) - run.deviation)[:, some]
    return replace(commands, t=rows, values=values)


def effective_commands(
    design: Design,
    commands: Commands,
    t: Floats,
    T: RigidTransform,
    effects: Sequence[Effect] = (),
    sensors: Sensors | None = None,
) -> Floats:
    """Effective commands (n, axes) under effects, at exposures logged at t (n,) s and poses T (n,).

    Sway counts as struts' length. The machine stands at T where this is the inverse kinematics of T. Raises as
    `motion_of_commands`
    """
    out, sway = effective_commands_and_sway(design, commands, t, T, effects, sensors)
    return out + apparent_strut_elongations_of_sway(design, T, sway) if sway.any() else out


def effective_commands_and_sway(
    design: Design,
    commands: Commands,
    t: Floats,
    T: RigidTransform,
    effects: Sequence[Effect] = (),
    sensors: Sensors | None = None,
    hand: Integers | None = None,
) -> tuple[Floats, Floats]:
    """Effective commands (n, axes) under effects and the platform's sway (n, 6), taken at poses T (n,).

    What joints hold is displaced along with them in ways that no joint may make up for. hand : (n,) number of the hand
    that each pose is of, None for that at which an arm is seen. Raises as `motion_of_commands`
    """
    if hand is not None:
        arm, out, sway = (
            require_arm(design.mechanism),
            np.empty((len(t), len(design.mechanism.axes))),
            np.empty((len(t), 6)),
        )
        for k in np.unique(hand):
            rows, seen = hand == k, replace(design, mechanism=arm.of_hand(int(k)))
            out[rows], sway[rows] = effective_commands_and_sway(seen, commands, t[rows], T[rows], effects, sensors)
        return out, sway
    state = motion_of_commands(design, commands, t, effects, sensors, T)
    out = state.lengths + sum((e.deviation(state) for e in effects), np.zeros(state.lengths.shape))
    return out, sum((e.sway(state) for e in effects), np.zeros((len(state.t), 6)))


def base_lean_rotation_vectors(
    design: Design,
    commands: Commands,
    t: Floats,
    T: RigidTransform,
    effects: Sequence[Effect] = (),
    sensors: Sensors | None = None,
) -> Floats:
    """Lean of the base under effects, rotation vectors (n, 3) rad.

    In the frame of poses.

    At poses T (n,).
    """
    turning = [effect for effect in effects if type(effect).lean is not Effect.lean]
    if not turning:
        return np.zeros((len(t), 3))
    state = motion_of_commands(design, commands, t, effects, sensors, T)
    return np.sum([effect.lean(state) for effect in turning], axis=0)


def apparent_strut_elongations_of_sway(design: Design, T: RigidTransform, sway: Floats) -> Floats:
    """Strut elongations (n, axes) m that a swaying platform appears to have.

    A platform at T (n,), displaced by sway (n, 6).
    """
    m = require_parallel(design.mechanism, "a mechanism of kind {kind!r} is not parallel")
    return np.einsum("nij,nj->ni", mechanisms.kinematics_of(m).inverse_kinematics_jacobian(T, np.zeros(0), m), sway)


def has_rolling_shutter(design: Design, effects: Iterable[Effect]) -> bool:
    """Whether a camera has a rolling shutter, stated in the design or by an effect."""
    return any(camera.shutter == "rolling" for camera in design.cameras) or any(effect.rolls for effect in effects)


def _with_rates(
    design: Design, commands: Commands, t: Floats, effects: Sequence[Effect], sensors: Sensors | None
) -> MachineRun:
    around = np.concatenate([t - ABOUT, t, t + ABOUT])
    order = np.argsort(around, kind="stable")
    done = simulate_machine_run(design, commands, around[order], effects, sensors)
    back = np.empty(len(order), int)
    back[order] = np.arange(len(order))
    before, at, after = np.split(back, 3)
    T = done.T_base_platform
    return MachineRun(
        T[at],
        done.deviation[at],
        *pose_rates_and_curvatures(T[at], T[before], T[after]),
        tuple(stage[at] for stage in done.stages),
    )


def pose_rates_and_curvatures(
    T: RigidTransform, before: RigidTransform, after: RigidTransform
) -> tuple[Floats, Floats]:
    """Rates (n, 6) per s and curvatures (n, 6) of poses T (n,).

    From poses shortly before and after.
    """
    minus, plus = pose_difference(T, before), pose_difference(T, after)
    return (plus - minus) / (2 * ABOUT), (plus + minus) / ABOUT**2
