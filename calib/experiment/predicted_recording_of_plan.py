"""Predicted recording of a plan by a fitted model.

Poses, corners with noise, sensor log.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.diagnosis.problems.platform.linearisation_operating_point import (
    OperatingPoint,
    group_sightings,
    remounted_cube_seats,
)
from calib.diagnosis.problems.platform.simultaneous_refinement import Refinement
from rig.errors import RigError
from rig.model import motion_simulation
from rig.model.design import Design
from rig.model.pose import exp
from rig.planning.plan import sensors_with_payload
from rig.planning.timed_plan_and_visiting_order import Plan
from rig.recording.recording_folder import PAYLOAD, Sensors
from rig.recording.recording_tables import Corners
from vision.corner_observations import observations_from_corners
from vision.predict import State, is_inside_image, marker_map, predict_sightings, sightings_of_markers_facing_cameras

SEED = 0  # of the noise by which a recording that is not there yet is weighed
TEMPERATURE = "_temperature_C"  # how channels of temperatures end
PUT_BACK = "@next"  # after the name of a cube as a plan puts it back


def operating_point_of_last_recording(point: OperatingPoint) -> OperatingPoint:
    """OperatingPoint of the last recording, with each camera and cube where it stood then."""
    last = {c.name.partition("@")[0]: c for c in point.design.cameras}
    cubes = {t.name.partition("@")[0]: t for t in point.design.targets}
    return replace(point, design=replace(point.design, cameras=tuple(last.values()), targets=tuple(cubes.values())))


def operating_point_with_turned_cubes(point: OperatingPoint, plan: Plan) -> OperatingPoint:
    """OperatingPoint after a plan has turned cubes, which then stand at unknown poses."""
    quarters, targets = dict(plan.turned), []
    for target in point.design.targets:
        name = target.name.partition("@")[0]
        fresh = quarters.get(name, target.turned) != target.turned
        targets.append(replace(target, name=f"{name}{PUT_BACK}", turned=quarters[name]) if fresh else target)
    return replace(point, design=replace(point.design, targets=tuple(targets)))


def predicted_sensor_log(log: Sensors | None, plan: Plan, temperature_rise: float) -> Sensors | None:
    """Predicted sensor log of a plan's recording.

    Temperatures of the first log raised, payload as planned.
    """
    if log is None:
        return (
            sensors_with_payload(plan, Sensors(np.array([0.0, plan.commands.t[-1]]), {}))
            if (plan.payload[:, 1] > 0).any()
            else None
        )
    end = np.searchsorted(log.t, log.starts[0]) if len(log.starts) else len(log.t)
    first = {
        name: values[:end] + temperature_rise * name.endswith(TEMPERATURE)
        for name, values in log.channels.items()
        if name != PAYLOAD
    }
    return sensors_with_payload(plan, Sensors(log.t[:end], first))


def fitted_design(fit: Refinement, design: Design) -> Design:
    """Design with the geometry and the cameras as fitted."""
    cameras = {c.name: c for c in fit.point.design.cameras}
    return replace(design, mechanism=fit.point.design.mechanism, cameras=tuple(cameras[c.name] for c in design.cameras))


def predicted_poses(fit: Refinement, design: Design, plan: Plan, sensors: Sensors | None) -> RigidTransform:
    """Predicted poses T_base_platform (F,) at a plan's exposures, by a fit."""
    moving = [e for e in fit.point.effects if e.stage != "view"]
    return motion_simulation.simulate_machine_run(
        fitted_design(fit, design), plan.commands, plan.t, moving, sensors
    ).T_base_platform


def predicted_operating_point(
    point: OperatingPoint, fit: Refinement, plan: Plan, sensors: Sensors | None, T: RigidTransform
) -> OperatingPoint:
    """OperatingPoint predicted for a plan's recording by one fit, with noise as large as before.

    Raises RigError where no camera sees a marker in some of its exposures
    """
    rng, design, F = np.random.default_rng(SEED), fitted_design(fit, point.design), len(plan.t)
    stated = replace(point.stated, cameras=design.cameras, targets=design.targets)
    here = OperatingPoint(
        design,
        stated,
        np.arange(F),
        plan.t,
        T,
        {},
        None,
        plan.commands,
        sensors,
        None,
        fit.point.effects,
        standing=point.standing,
        seats=remounted_cube_seats(design, fit.point.seats),
    )
    if point.seen is None:
        own = point.own if point.own is not None else np.zeros((1, 6, 6))
        typical = np.median(own, axis=0)
        noise = rng.multivariate_normal(np.zeros(6), typical, F)
        return replace(here, T=T * exp(noise), own=np.broadcast_to(typical, (F, 6, 6)).copy())
    markers, state = marker_map(here.stated), State(design.cameras, T, {})
    sightings = sightings_of_markers_facing_cameras(state, markers)
    uv = predict_sightings(
        sightings, state, markers, plan.t, [*fit.point.effects, *here.seats], sensors, here.run(fit.point.effects)
    )
    whole = is_inside_image(sightings, uv, design.cameras)
    sightings, uv = sightings.take(whole), uv[whole].reshape(-1, 2)
    if len(np.unique(sightings.frame)) < F:
        raise RigError(
            f"in {F - len(np.unique(sightings.frame))} of the plan's {F} exposures no camera would see a marker"
        )
    sigma = fit.model.corner_noise()
    corners = Corners(
        np.repeat(sightings.frame, 4),
        [design.cameras[i].name for i in np.repeat(sightings.camera, 4)],
        np.repeat(markers.key[sightings.marker], 4),
        np.tile(np.arange(4), len(sightings.frame)),
        uv + sigma * rng.normal(size=uv.shape),
        np.broadcast_to(sigma**2 * np.eye(2), (len(uv), 2, 2)).copy(),
    )
    return replace(
        here, seen=group_sightings(observations_from_corners(corners, here.frames, here.stated, markers), markers)
    )
