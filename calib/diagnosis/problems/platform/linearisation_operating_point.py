"""Operating point of a platform's linearisation.

Cameras, geometry, poses and the effects admitted so far.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.diagnosis.engine.problem_interface import Progress
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import (
    smoothed_temperatures_and_errors,
)
from calib.samples.commanded_and_measured_pose_samples import Sampled, sample_recording
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.effects.catalogue.effect_list import effect_of_tolerance
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.errors import NotEnoughData, RigError
from rig.model import machine_motion_simulation as motion_simulation
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import FINDER, SEAT, Place
from rig.model.design import Camera, Design
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Parallel, require_parallel
from rig.model.pose import exp
from rig.recording.recording_folder import Commands, Recording, Sensors
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr
from vision.corner_observations_and_merging import Observations
from vision.marker_corner_prediction import MarkerMap, Sightings, State, marker_map, predict_sightings
from vision.recording_adjustment_with_hand_and_stages import Measurement, has_hand_cameras
from vision.recording_measurement import measure_recording

KINDS = ("hexapod", "planar2", "file", "free")  # of mechanisms
FEWEST = 12  # frames
ELSEWHERE = 60.0  # px; a corner farther off belongs to something else
EDGE_SHIFT = effect_of_tolerance(FINDER)  # what the corner finder does to all edges of a camera's images
CUBE_MOTION = effect_of_tolerance(SEAT)  # what a cube is off by that was put back


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SeenCorners(FieldSummaryRepr):
    """The corners of a recording and which sightings they belong to.

    observations : Observations of solved frames, frame an index into OperatingPoint.frames; markers : MarkerMap
    sightings : Sightings (k,); row : (n,) sighting of each corner; stated : px, noise of a corner in the middle of all,
    as stated; None where nobody states any and the residuals alone determine it
    """

    observations: Observations
    markers: MarkerMap
    sightings: Sightings
    row: Integers
    stated: float | None = None

    def take(self, rows: Booleans) -> "SeenCorners":
        """The same with only the corners of an index or mask (n,)."""
        return replace(
            observations_grouped_into_sightings(self.observations.take(rows), self.markers), stated=self.stated
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class OperatingPoint(FieldSummaryRepr):
    """One point at which everything is linearised.

    design : Design, cameras and mechanism as estimated; stated : Design of the owner; frames, t : (F,)
    T : T_base_platform (F,); moving : {camera index: T_base_camera (F,)}
    own : (F, 6, 6) covariance of poses that an outside instrument measured, or None
    commands : Commands or None; sensors : Sensors, temperatures smoothed, or None; seen : SeenCorners or None;
        effects : those admitted
    finder : (cameras,) px by which the corner finder is taken to shift all edges of a camera's images, or () for
        nothing
    standing : px, what comes back in every frame where neither camera nor marker moves
    known : (mechanism, (42, 42) root of their information) of joints and zeros as another recording has them, or None
    log_errors : {channel: (n, q)} of the sensors' temperatures, see `smoothed_temperatures_and_errors`
    seats : by which cubes that were put back sit off where they are stated; assumed : whether the noise is not stated
    of poses that an instrument measured, so that a usual figure stands for it
    """

    design: Design
    stated: Design
    frames: Integers
    t: Floats
    T: RigidTransform
    moving: dict[int, RigidTransform]
    own: Floats | None
    commands: Commands | None
    sensors: Sensors | None
    seen: SeenCorners | None
    effects: tuple[Effect, ...] = ()
    finder: tuple[float, ...] = ()
    standing: float = 0.0
    known: tuple[Hexapod, Floats] | None = None
    log_errors: dict[str, Floats] = field(default_factory=dict)
    seats: tuple[Effect, ...] = ()
    assumed: bool = False

    @property
    def state(self) -> State:
        """State of cameras and poses, as the forward model of seeing takes it."""
        return State(self.design.cameras, self.T, self.moving)

    @property
    def observed(self) -> SeenCorners:
        """What cameras saw. Raises ValueError where there are no corners"""
        if self.seen is None:
            raise ValueError("these poses come without corners")
        return self.seen

    def logged(self, *names: str) -> Floats:
        """(F,) values of the first of some sensor channels that there is. Raises RigError where there is none"""
        if self.sensors is None:
            raise RigError(f"this requires a sensor channel {' or '.join(map(repr, names))}, and there are no sensors")
        return self.sensors.at(self.t, *names)

    @property
    def commanded(self) -> Commands:
        """What was commanded. Raises RigError where nothing was"""
        if self.commands is None:
            raise RigError("nothing was commanded")
        return self.commands

    @property
    def platform(self) -> Parallel:
        """The mechanism as estimated. Raises RigError for one that is not parallel"""
        return require_parallel(self.design.mechanism)

    @property
    def places(self) -> tuple[Place, ...]:
        """Places of the axes."""
        return mechanisms.axis_places(self.design.mechanism)

    @property
    def axis_unit(self) -> str:
        """Unit of the axes' travel, "m" or "rad"; "m" where there are both."""
        return self.design.mechanism.axis_unit

    @property
    def axes(self) -> int:
        """How many struts are commanded, 0 where nothing is."""
        return len(self.design.mechanism.axes) if self.commands is not None else 0

    def motion(self, effects: Iterable[Effect]) -> Motion:
        """Motion at the exposures under effects, at the measured poses."""
        return motion_simulation.motion_of_commands(self.design, self.commanded, self.t, effects, self.sensors, self.T)

    def effective(self, effects: tuple[Effect, ...] | None = None) -> Floats:
        """(F, axes) m that commands become under effects (those admitted, by default), sway counted as struts'
        length.
        """
        effects = self.effects if effects is None else effects
        return motion_simulation.effective_commands(self.design, self.commanded, self.t, self.T, effects, self.sensors)

    def elongation(self, effect: Effect, motion: Motion) -> Floats:
        """(F, axes) m that an effect alone adds to commands, sway counted as struts' length, in a Motion of all."""
        sway = effect.sway(motion)
        return effect.deviation(motion) + (self.swayed(sway) if sway.any() else 0.0)

    def swayed(self, sway: Floats) -> Floats:
        """(F, axes) m by which struts seem longer where the platform is displaced by tangents (F, 6)."""
        return motion_simulation.apparent_strut_elongations_of_sway(self.design, self.T, sway)

    def closures(self) -> Floats:
        """(F, axes) m by which measured poses ask for longer struts than commands and effects give them."""
        m = self.design.mechanism
        return mechanisms.kinematics_of(m).inverse(self.T, m) - self.effective()

    def run(self, effects: tuple[Effect, ...]) -> motion_simulation.MachineRun | None:
        """MachineRun with rates where some camera exposes row by row, else None."""
        rolls = any(c.shutter == "rolling" for c in self.design.cameras) or any(e.rolls for e in effects)
        return (
            motion_simulation.simulate_machine_run(
                self.design, self.commands, self.t, [e for e in effects if e.stage != "view"], self.sensors, rates=True
            )
            if rolls and self.commands is not None
            else None
        )

    def pixels(
        self,
        effects: tuple[Effect, ...] | None = None,
        rows: Integers | None = None,
        run: motion_simulation.MachineRun | None = None,
    ) -> Floats:
        """(n, 2) px where the observed corners should be under effects (those admitted, by default).

        rows : indices of sightings to which it is confined, then (k, 4, 2) px of those
        """
        effects = self.effects if effects is None else effects
        seen = self.observed
        run = self.run(effects) if run is None else run
        sightings = seen.sightings if rows is None else seen.sightings.take(rows)
        shifted = [
            EDGE_SHIFT.of_numbers(str(Place("camera", c.name)), [b])
            for c, b in zip(self.design.cameras, self.finder)
            if b
        ]
        quads = predict_sightings(
            sightings, self.state, seen.markers, self.t, [*effects, *shifted, *self.seats], self.sensors, run
        )
        return quads if rows is not None else quads[seen.row, seen.observations.corner]

    def with_effects(self, effects: Iterable[Effect]) -> "OperatingPoint":
        """The same with other effects admitted."""
        return replace(self, effects=tuple(effects))


def operating_point_source_and_measurement(
    recording: Recording,
    progress: Progress | None = None,
    calibration: Calibration | None = None,
    places: str = "auto",
    sampled: Sampled | None = None,
) -> tuple[OperatingPoint, str, Measurement | None]:
    """OperatingPoint of a recording, calibrated, without effects, its source in words, and its Measurement.

    All corners are back in; the Measurement may be None.
    calibration : of another recording of the same hexapod, whose joints are then known beforehand, or None
    places : whether a free body's markers are taken as adjusted, see vision.recording_measurement; where something was
        commanded they are as stated
    sampled : Sampled of this commanded recording where it was measured before, or None
    Raises NotEnoughData where nothing was measured, RigError for a mechanism that is no platform, and what measuring
        raises
    """
    design, (sensors, log_errors) = recording.design, smoothed_temperatures_and_errors(recording.sensors)
    kind = design.mechanism.kind
    if kind not in KINDS:
        raise RigError(
            f"{recording.folder}: diagnosis requires a {' or '.join(KINDS)}, not a mechanism of kind {kind!r}; "
            "rig calibrate reports the residuals of its geometry"
        )
    known = None if calibration is None else _known(recording, calibration)
    if kind == "free" or recording.commands is None:
        measured: Measurement | None
        measured, collected = measure_recording(
            recording, progress=progress, places=places if kind == "free" else "stated"
        )
        source = "images" if collected is not None else "corners.csv"
    else:
        sampled = sample_recording(recording, progress=progress) if sampled is None else sampled
        measured, source = sampled.measurement, sampled.source
        if measured is None or has_hand_cameras(
            design
        ):  # whose corners are seen from the platform: its poses stand for them
            s = sampled.samples
            return (
                OperatingPoint(
                    design,
                    design,
                    s.frame,
                    s.t,
                    s.T_base_platform,
                    {},
                    s.total_covariance(),
                    recording.commands,
                    sensors,
                    None,
                    known=known,
                    log_errors=log_errors,
                    assumed=sampled.assumed,
                ),
                source,
                None,
            )
    if len(measured.frames) < FEWEST:
        raise NotEnoughData(
            f"{recording.folder}: {len(measured.frames)} solved frames are too few to diagnose; minimum "
            f"{FEWEST}, better 100"
        )
    frames, times = recording.exposures.times()
    state = measured.adjustment.state
    point = OperatingPoint(
        measured.design,
        design,
        measured.frames,
        times[np.searchsorted(frames, measured.frames)],
        state.platform,
        state.moving,
        None,
        recording.commands if kind != "free" else None,
        sensors,
        None,
        known=known,
        log_errors=log_errors,
    )
    seen = _seen(measured, point)
    if source != "images" and measured.observations.stated:
        seen = replace(seen, stated=measured.noise / np.sqrt(measured.factor))
    return replace(point, seen=seen, seats=remounted_cube_seats(design)), source, measured


def remounted_cube_seats(design: Design, known_seats: Sequence[Effect] = ()) -> tuple[Effect, ...]:
    """Seats of a design's remounted cubes, a CubeMisplacement each.

    The known one, else zero.
    """
    own = {seat.place: seat for seat in known_seats}
    places = [str(Place("target", target.name)) for target in design.targets if target.turned is not None]
    return tuple(own.get(place, CUBE_MOTION(place)) for place in places)


def _known(recording: Recording, calibration: Calibration) -> tuple[Hexapod, Floats]:
    """(mechanism, root of the information) that a calibration says of a hexapod's joints. Raises RigError for another
    kind.
    """
    fitted = calibration.correction.fitted
    if recording.design.mechanism.kind != "hexapod" or fitted.kind != "hexapod":
        raise RigError(f"{recording.folder}: a known calibration can be used for a hexapod only")
    return fitted, np.linalg.cholesky(np.linalg.inv(calibration.covariance)).T


def _seen(measured: Measurement, point: OperatingPoint) -> SeenCorners:
    o = measured.observations
    if measured.to_frame_time is not None:  # here all cameras see the platform where it is at the frame's time
        o = replace(o, uv=o.uv + measured.to_frame_time)
    keep = np.isin(o.frames[o.frame], measured.frames)
    retained = o.take(keep)
    retained = replace(
        retained, frames=measured.frames, frame=np.searchsorted(measured.frames, retained.frames[retained.frame])
    )
    return observations_grouped_into_sightings(
        retained, measured.adjustment.state.placed if measured.places_free else marker_map(point.stated)
    )


def remove_corners_far_from_prediction(point: OperatingPoint) -> OperatingPoint:
    """OperatingPoint without the corners too far from prediction.

    They are too far from their predicted pixels to belong to their marker; a frame that would have none of its platform
    left keeps all.
    """
    seen = point.seen
    if seen is None:
        return point
    o = seen.observations
    near = np.linalg.norm(o.uv - point.pixels(), axis=1) < ELSEWHERE
    near |= (np.bincount(o.frame[near & o.on_platform], minlength=len(point.frames)) == 0)[o.frame]
    return point if near.all() else replace(point, seen=seen.take(near))


def observations_grouped_into_sightings(observations: Observations, markers: MarkerMap) -> SeenCorners:
    """SeenCorners of observations (n,), grouped into sightings."""
    key = (observations.camera * (len(observations.frames) + 1) + observations.frame) * (
        len(markers.id) + 1
    ) + observations.marker
    _, first, row = np.unique(key, return_index=True, return_inverse=True)
    sightings = Sightings(observations.frame[first], observations.camera[first], observations.marker[first])
    return SeenCorners(observations, markers, sightings, row)


def move_operating_point(point: OperatingPoint, cameras: list[Camera], local_tangents: Floats) -> OperatingPoint:
    """OperatingPoint with its cameras replaced, and each frame's poses moved by local tangents.

    local_tangents : (F, 6 + 6 per moving camera)
    """
    moving = {
        i: T * exp(local_tangents[:, 6 + 6 * k : 12 + 6 * k]) for k, (i, T) in enumerate(sorted(point.moving.items()))
    }
    return replace(
        point,
        design=replace(point.design, cameras=tuple(cameras)),
        T=point.T * exp(local_tangents[:, :6]),
        moving=moving,
    )
