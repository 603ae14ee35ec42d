"""Move to one pose through a calibration, and the server of corrected commands.

How near a move comes is reported (rig go). The server listens on the loopback; each request and each answer is a line
of JSON.

Every request stands for itself, as one call of `correct`: it states where the axes stand, so that clients do not
depend on each other and an answer is that of `rig correct`, to the last bit.
"""

import ipaddress
import json
import math
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.api.correct import CorrectionResult, CorrectOptions, correct, rms_and_greatest_uncertainty
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import require_commands_in_axis_ranges
from calib.files.mechanism_and_physics_entries import mechanism_dict
from calib.models.additional_correction_pass import mechanism_placed_as_calibrated
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.wanted_pose_commands import commands_along_route
from rig.array_and_json_types import Floats, Json
from rig.driving.axis_display_units_and_controller_counts import axis_values_text
from rig.driving.axis_driver import Driver
from rig.driving.controller_status_and_limits import ControllerStatus
from rig.errors import RigError, Unreachable
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG
from rig.formats.local_and_remote_input_files import short_repr
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import require_single_hand_mechanism
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_axes
from rig.model.pose import pose, pose_to_vector
from rig.recording.corner_and_pose_csv_tables import Poses
from rig.recording.recording_folder import Sensors
from rig.recording.wanted_poses_and_roll_pitch_yaw import WantedPoses


@dataclass(frozen=True, slots=True, eq=False)
class PoseMove:
    """A move to a pose. design; calibration, of an arm in the posture chosen; wanted : T_base_platform; lengths :
    (axes,) m, of joints rad, to command; uncorrected : whether these are by the nominal model; status : once it has
    been made, else None; covariance : (6, 6) m and rad, on the right, of the pose that the lengths give, None where
    they are not corrected
    """

    design: Design
    calibration: Calibration
    wanted: RigidTransform
    lengths: Floats
    uncorrected: bool = False
    status: ControllerStatus | None = None
    covariance: Floats | None = None

    @property
    def off_nominal(self) -> Floats:
        """(axes,) m or rad by which the lengths differ from the nominal model's."""
        return self.lengths - self.calibration.correction.uncorrected(_as_batch(self.wanted))[0]

    @property
    def remainder(self) -> RigidTransform | None:
        """T_wanted_reached by the calibration, None before the move and where it is not corrected."""
        if self.status is None or self.uncorrected:
            return None
        return self.wanted.inv() * self.pose_at(self.status.lengths)

    def pose_at(self, lengths: Floats) -> RigidTransform:
        """T_base_platform by the calibration where the axes read lengths (axes,) m or rad after this move."""
        correction = self.calibration.correction
        return correction.predict(correction.inverse_without_physics(self.wanted) + lengths - self.lengths)

    @property
    def uncertainty(self) -> tuple[float, float] | None:
        """Standard uncertainty (m, rad) of the pose by the calibration, over all three directions; None uncorrected."""
        return None if self.covariance is None else rms_and_greatest_uncertainty(self.covariance[None])[0]

    @property
    def within(self) -> tuple[float, float] | None:
        """(m, rad) within which the platform is of the wanted pose, k=2: what the axes left of the way, and the
        calibration's own uncertainty; None before the move and uncorrected.
        """
        left, own = self.remainder, self.uncertainty
        if left is None or own is None:
            return None
        sizes = float(np.linalg.norm(left.translation)), float(left.rotation.magnitude())
        return float(np.hypot(sizes[0], 2 * own[0])), float(np.hypot(sizes[1], 2 * own[1]))

    def __str__(self) -> str:
        shown = axis_values_text(self.lengths, self.design.mechanism)
        return f"{'to command' if self.status is None else 'commanded'}: {shown}"

    def tree(self) -> Json:
        """What `rig go --json` prints."""
        tree: Json = {
            "schema": "gone/1",
            "commanded": self.lengths.tolist(),
            "off_owners_model": self.off_nominal.tolist(),
            "moved": self.status is not None,
        }
        if self.status is not None:
            tree["lengths"] = self.status.lengths.tolist()
        if self.uncertainty is not None:
            tree["uncertainty"] = list(self.uncertainty)
        if self.remainder is not None and self.within is not None:
            tree |= {"left": pose_to_vector(self.remainder).tolist(), "within": list(self.within)}
        return tree

    def carry_out(
        self, driver: Driver, speed: float = 1.0, report: Callable[["PoseMove"], None] | None = None
    ) -> "PoseMove":
        """The same once made: from where the axes stand, not from home. speed : share of the greatest

        report : takes the move from there, before it begins
        Raises Unreachable for lengths out of range, MotionError where the axes do not arrive
        """
        stand = driver.status().lengths if driver.position_known else None  # else the driver refuses the move
        move = plan_pose_move(self.design, self.calibration, self.wanted, self.uncorrected, stand)
        if report is not None:
            report(move)
        driver.move(move.lengths, speed)
        return replace(move, status=driver.status())


def plan_pose_move(
    design: Design,
    calibration: Calibration,
    wanted: RigidTransform,
    uncorrected: bool = False,
    start: Floats | None = None,
) -> PoseMove:
    """PoseMove to a wanted pose T_base_platform (), checked.

    start : (axes,) m or rad, where the axes stand, home by default: of the postures in which an arm takes the pose the
        one nearest to it is chosen
    What nobody logs is taken as when calibrated.
    Raises Unreachable for lengths out of range, RigError for an arm of several hands
    """
    correction = calibration.correction
    if start is None:
        start = mechanisms.kinematics_of(correction.nominal).home_values(correction.nominal)
    if isinstance(correction, ArmCorrection):
        require_single_hand_mechanism(correction.nominal, "a pose is gone to")
        speed = design.driver().max_speed
        calibration = replace(calibration, correction=correction.in_posture_nearest_to(wanted, start, speed))
    T = _as_batch(wanted)
    plain = calibration.correction.uncorrected(T) if uncorrected else None
    found = commands_along_route(calibration, T, np.asarray(start, float), commands_to_keep=plain)
    require_commands_in_axis_ranges(found.values, require_axes(design.mechanism), ["the pose"])
    covariance = None if found.covariance is None else found.covariance[0]
    return PoseMove(design, calibration, wanted, found.values[0], uncorrected, covariance=covariance)


NOT_COMPARED = ("limits", "strut_range", "strut_zeros", "home", "file")  # what is not of the geometry, and zeros
SAME = 1e-6  # m or rad, by which stated figures may differ


def require_same_rig(
    design: Design, calibration: Calibration, design_path: Path | str, calibration_path: Path | str
) -> None:
    """Raise RigError where a calibration is of another rig than a design, or for an arm of several hands.

    Ends of an arm that are stated free stand where the calibration has them. The paths, or names, are for the message.
    """
    require_single_hand_mechanism(design.mechanism, "a pose is gone to")
    known = calibration.correction.nominal
    stated = mechanism_placed_as_calibrated(require_axes(design.mechanism), known, design.instrument)
    if difference := _difference(mechanism_dict(known), mechanism_dict(stated), "mechanism"):
        raise RigError(f"{calibration_path} is a calibration of another rig than {design_path}: {difference}")


def _difference(known: object, stated: object, place: str) -> str:
    """What differs first between JSON of a calibration's mechanism and of a rig.toml's; "" where nothing does."""
    if isinstance(known, dict) and isinstance(stated, dict):
        names = [name for name in {**known, **stated} if name not in NOT_COMPARED]
        parts = [(known.get(name), stated.get(name), f"{place}.{name}") for name in names]
    elif isinstance(known, list) and isinstance(stated, list) and len(known) == len(stated):
        parts = [(one, another, f"{place}[{i}]") for i, (one, another) in enumerate(zip(known, stated), 1)]
    elif isinstance(known, float | int) and isinstance(stated, float | int):
        return "" if abs(known - stated) <= SAME else f"{place} is {stated:.9g} there, and {known:.9g} as calibrated"
    else:
        return (
            "" if known == stated else f"{place} is {short_repr(stated)} there, and {short_repr(known)} as calibrated"
        )
    return next(filter(None, (_difference(*part) for part in parts)), "")


def _as_batch(T: RigidTransform) -> RigidTransform:
    """A pose () as poses (1,)."""
    return RigidTransform.from_matrix(T.as_matrix()[None])


LONGEST = 1 << 24  # bytes of a request's line
CLIENTS = 64  # at a time
LAST = 2.0  # s that clients have to take their last answer once the server ends
SOON = 0.2  # s after which it is looked whether to end
MOST_POSES = 10_000  # of a request; others wait meanwhile
MOST_TURN = 1e3  # rad, of a rotation vector; more is no pose, and its sine is left to chance
KEYS = ("id", "poses", "start", "sensors")


class CorrectionServer:
    """Answers requests with a Calibration until closed. address : (host, port) where it listens; port 0 for any free

    Raises RigError for a host that is not of the loopback, and where the port cannot be had
    """

    def __init__(self, calibration: Calibration, host: str = "127.0.0.1", port: int = 0) -> None:
        try:
            place = ipaddress.ip_address(host)
        except ValueError:
            raise RigError(f"the host must be an address of the loopback, as 127.0.0.1 or ::1, not {host!r}") from None
        if not place.is_loopback:
            raise RigError(f"{host} is not of the loopback: this server answers programs of this computer alone")
        self._calibration = calibration
        self._one = threading.Lock()  # one request is computed at a time
        self._clients: dict[socket.socket, threading.Thread] = {}
        self._listener = socket.socket(socket.AF_INET6 if place.version == 6 else socket.AF_INET)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind((host, port))
            self._listener.listen()
        except OSError as error:
            self._listener.close()
            raise RigError(f"no server at {host} port {port}: {error.strerror}") from None
        self._listener.settimeout(SOON)
        self.address: tuple[str, int] = self._listener.getsockname()[:2]

    def serve(self, goes_on: Callable[[], bool]) -> None:
        """Take clients for as long as goes_on() is true."""
        while goes_on():
            with suppress(TimeoutError):
                client, _ = self._listener.accept()
                client.settimeout(None)
                self._take(client)

    def _take(self, client: socket.socket) -> None:
        """Answer a client in a thread of its own; one too many gets an error and is let go."""
        self._clients = {one: thread for one, thread in self._clients.items() if thread.is_alive()}
        if len(self._clients) >= CLIENTS:
            with suppress(OSError), client:
                client.sendall(_line({"id": None, "error": f"{CLIENTS} clients are connected, the most there may be"}))
            return
        thread = threading.Thread(target=self._converse, args=(client,), daemon=True)
        self._clients[client] = thread
        thread.start()

    def _converse(self, client: socket.socket) -> None:
        """Answer each line of a client until it, or the server, ends; a broken connection ends it too."""
        with client, client.makefile("rb") as lines, suppress(OSError):
            while line := lines.readline(LONGEST + 1):
                if len(line) > LONGEST:
                    while line and not line.endswith(b"\n"):
                        line = lines.readline(LONGEST)
                    reply: Json = {"id": None, "error": f"a line has at most {LONGEST} bytes; this one is longer"}
                else:
                    with self._one:
                        reply = correction_server_answer(self._calibration, line)
                client.sendall(_line(reply))

    def close(self) -> None:
        """Listen no more, let requests that came be answered, and end all connections."""
        self._listener.close()
        until = time.monotonic() + LAST
        for client in self._clients:
            with suppress(OSError):
                client.shutdown(socket.SHUT_RD)
        for thread in self._clients.values():
            thread.join(max(until - time.monotonic(), 0.0))
        for client in self._clients:
            with suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)


def correction_server_answer(calibration: Calibration, line: bytes) -> Json:
    """Answer of the correction server to a request's line: commands with covariance, or what is wrong with it.

    A fault of the program is an error in the answer too, and its traceback is printed on the error output.
    """
    identity: object = None
    try:
        request = _parsed(line)
        identity = request.get("id")
        return {"id": identity, **_commands(calibration, request)}
    except RigError as error:
        return {"id": identity, "error": str(error)}
    except Exception as fault:
        traceback.print_exc(file=sys.stderr)
        return {"id": identity, "error": f"a fault of this program, {type(fault).__name__}: {fault}"}


def _line(tree: Json) -> bytes:
    return json.dumps(tree).encode() + b"\n"


def _refuse_constant(name: str) -> None:
    raise RigError(f"{name} is no number of JSON")


def _parsed(line: bytes) -> Json:
    """The object of a line. Raises RigError for a line that is none."""
    try:
        request = json.loads(line.decode(), parse_constant=_refuse_constant)
    except json.JSONDecodeError as error:
        raise RigError(f"no JSON: {error.msg} at column {error.colno}") from None
    except (ValueError, RecursionError) as error:  # no UTF-8, too many digits, too deep
        raise RigError(f"no JSON: {error}") from None
    if not isinstance(request, dict):
        raise RigError(f"a request is an object of JSON with {', '.join(KEYS)}, not {type(request).__name__}")
    return request


def _numbers(values: object, count: int, where: str) -> Floats:
    """(count,) numbers, all finite. Raises RigError that says where they are none."""
    if not isinstance(values, list) or len(values) != count:
        found = f"{len(values)} entries" if isinstance(values, list) else type(values).__name__
        raise RigError(f"{where} must be a list of {count} numbers, not {found}")
    for i, value in enumerate(values):
        real = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300
        if not real or not math.isfinite(value):
            raise RigError(f"{where}[{i}] must be a finite number, not {json.dumps(value)[:40]}")
    return np.array(values, float)


def _commands(calibration: Calibration, request: Json) -> Json:
    """What answers a request. Raises RigError for a wrong request."""
    unknown = [key for key in request if key not in KEYS]
    if unknown:
        raise RigError(f"the key {unknown[0]!r} is not known; known are {', '.join(KEYS)}")
    wanted = request.get("poses")
    if not isinstance(wanted, list) or not wanted:
        raise RigError("poses must be a list of poses [x, y, z, rx, ry, rz], m and rad, at least one")
    if len(wanted) > MOST_POSES:
        raise RigError(f"a request has at most {MOST_POSES} poses, not {len(wanted)}")
    vectors = np.array([_numbers(one, 6, f"poses[{i}]") for i, one in enumerate(wanted)])
    for i, (place, turn) in enumerate(np.abs(vectors).reshape(-1, 2, 3).max(axis=2).tolist()):
        if place > LARGEST_RIG:
            raise RigError(f"poses[{i}] is {place:g} m from the base: poses are in metres")
        if turn > MOST_TURN:
            raise RigError(f"poses[{i}] turns by {turn:g} rad: rotation vectors are in rad")
    T = pose(vectors[:, :3], vectors[:, 3:])
    poses = WantedPoses(Poses(np.arange(len(vectors)), T, None))  # as of a file: poses alone are normalised once more
    start = request.get("start")
    lengths = None if start is None else _numbers(start, len(calibration.correction.nominal.axes), "start")
    options = CorrectOptions(_sensors(request.get("sensors")), lengths, skip_unreachable=True)
    try:
        result = correct(calibration, poses, options)
    except Unreachable as error:  # all of them
        return _tree(None, len(wanted), dict(zip(error.index, error.violations)))
    return _tree(result, len(wanted), dict(result.out_of_reach))


def _sensors(given: object) -> Sensors | None:
    """Sensors of {channel: value}, None for none. Raises RigError for what is none."""
    if given is None:
        return None
    if not isinstance(given, dict):
        raise RigError(f"sensors must be an object of channels and values, not {type(given).__name__}")
    values = {name: _numbers([value], 1, f"sensors[{name!r}]") for name, value in given.items()}
    return Sensors(np.zeros(1), values)


def _tree(result: CorrectionResult | None, count: int, refused: dict[int, str]) -> Json:
    """An answer: lists by wanted pose with null for those that are refused."""
    commands: list[object] = [None] * count
    poses: list[object] = [None] * count
    covariance: list[object] = [None] * count
    if result is not None:
        reached = pose_to_vector(result.commanded.T_base_platform).tolist()
        spread = None if result.covariance is None else result.covariance.tolist()
        for i, frame in enumerate(result.frames.tolist()):
            commands[frame], poses[frame] = result.values[i].tolist(), reached[i]
            covariance[frame] = None if spread is None else spread[i]
    return {
        "commands": commands,
        "poses": poses,
        "covariance": covariance,
        "out_of_reach": [{"pose": i, "reason": refused[i].removeprefix(f"frame {i}: ")} for i in sorted(refused)],
        "not_logged": [] if result is None else list(result.commanded.missing),
    }
