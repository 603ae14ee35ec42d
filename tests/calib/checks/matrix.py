"""What users do to a good recording, one thing at a time: (name, kind of recording, what is done to its folder, what
the first line must say).
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tests.calib.checks.cases import (
    ANGLES,
    CASES,
    POSE,
    Case,
    all_times,
    cameras,
    case,
    each,
    lengths,
    matrix,
    simple,
    size,
    time,
    uv,
)
from tests.calib.checks.files import column, columns, rename, rig, rows, write

# -- lengths and times
simple("lengths in mm", "corners", "lengths are in millimetres", lengths(lambda q: q * 1e3))
simple("lengths in inches", "corners", "lengths are in inches", lengths(lambda q: q / 0.0254))
simple("lengths relative to home", "corners", "relative to home", lengths(lambda q: q - q[0]))
simple(
    "lengths relative to home, mm", "corners", "millimetres and relative to home", lengths(lambda q: (q - q[0]) * 1e3)
)
simple("lengths in steps", "corners", "steps", lengths(lambda q: np.round((q - q[0]) * 3.2e6 + 1e6)))
simple("lengths with the other sign", "corners", "sign", lengths(lambda q: -q))
simple(
    "travel with the other sign", "corners", "all struts run with the sign reversed", lengths(lambda q: 2 * q[0] - q)
)
simple(
    "one strut with the other sign",
    "corners",
    "strut 3 run.* sign reversed",
    lengths(lambda q: np.where(np.arange(6) == 2, 2 * q[0] - q, q)),
)
simple("struts in another order", "corners", "struts are in another order", lengths(lambda q: q[:, [1, 2, 3, 4, 5, 0]]))
simple(
    "two struts exchanged",
    "corners",
    "struts are in another order: strut 2 is column l5",
    lengths(lambda q: q[:, [0, 4, 2, 3, 1, 5]]),
)
simple(
    "a strut's zero 20 mm off",
    "corners",
    "strut 4 is (19|20|21)(\\.\\d+)? mm (longer|shorter)",
    lengths(lambda q: q - 0.02 * (np.arange(6) == 3)),
)
simple("wrong screw lead", "corners", "travel is 1.2.* times", lengths(lambda q: q[0] + (q - q[0]) / 1.25))
simple("frames in ms", "corners", "frames.csv: times are in milliseconds", time("frames.csv", 1e3))
simple("commands in ms", "corners", "commands.csv: times are in milliseconds", time("commands.csv", 1e3))
simple("commands in us", "corners", "commands.csv: times are in microseconds", time("commands.csv", 1e6))
simple("sensors in ms", "corners", "sensors.csv: times are in milliseconds", time("sensors.csv", 1e3))
simple("all times in ms", "corners", "look like milliseconds", all_times(1e3))
simple("all times in us", "corners", "look like microseconds", all_times(1e6))
simple("frames an hour late", "corners", "different clocks.* 1 hours", time("frames.csv", 1, 3600))
simple("frames count from 1970", "corners", "1970", time("frames.csv", 1, 1.76e9))
simple("frames 30 s late", "corners", "clock is (29|3[0-2])(\\.\\d+)? s", time("frames.csv", 1, 30))


@case("frames shifted by one", "corners", "shifted by 1")
def _(f: Path) -> None:
    header, body = rows(f / "frames.csv")
    per = len({row[2] for row in body})
    times = [row[1] for row in body]
    for row, t in zip(body, times[per:] + [repr(float(t) + 5) for t in times[-per:]]):
        row[1] = t
    write(f / "frames.csv", header, body)


@case("frames shuffled", "corners", "another order \\(shuffled")
def _(f: Path) -> None:
    header, body = rows(f / "corners.csv")
    numbers = sorted({int(row[0]) for row in body})
    other = dict(zip(numbers, np.random.default_rng(5).permutation(numbers).tolist()))
    write(f / "corners.csv", header, [[str(other[int(row[0])]), *row[1:]] for row in body])


@case("frames in text order", "corners", "order of their names as text")
def _(f: Path) -> None:
    header, body = rows(f / "corners.csv")
    numbers = sorted({int(row[0]) for row in body})
    other = dict(zip(sorted(numbers, key=str), numbers))
    write(f / "corners.csv", header, [[str(other[int(row[0])]), *row[1:]] for row in body])


@case("rows of frames.csv shuffled", "corners", "rows are in another order")
def _(f: Path) -> None:
    header, body = rows(f / "frames.csv")
    np.random.default_rng(1).shuffle(body)
    write(f / "frames.csv", header, body)


# -- corners
simple("u and v exchanged", "corners", "u and v are exchanged", uv(lambda p: p[:, ::-1]))
CASES.append(
    Case(
        "mirrored left to right",
        "corners",
        lambda f: uv(lambda p: np.column_stack([size(f)[0] - 1 - p[:, 0], p[:, 1]]))(f),
        "mirrored left to right",
    )
)
CASES.append(
    Case(
        "v upwards",
        "corners",
        lambda f: uv(lambda p: np.column_stack([p[:, 0], size(f)[1] - 1 - p[:, 1]]))(f),
        "upside down|v counts upwards",
    )
)
simple("corners of half the resolution", "corners", "0.5 times the size", uv(lambda p: (p + 0.5) / 2 - 0.5))
simple(
    "corners of twice the resolution",
    "corners",
    "another image size|2 times the size",
    uv(lambda p: (p + 0.5) * 2 - 0.5),
)
CASES.append(Case("normalised pixels", "corners", lambda f: uv(lambda p: p / size(f))(f), "no pixels"))
simple(
    "corners counter-clockwise",
    "corners",
    "order is another: they run counter-clockwise",
    lambda f: column(f / "corners.csv", "corner", lambda k: (4 - k) % 4),
)
simple(
    "corners begin one on",
    "corners",
    "order is another: they begin one corner",
    lambda f: column(f / "corners.csv", "corner", lambda k: (k + 1) % 4),
)
simple(
    "corners from the bottom left",
    "corners",
    "order is another",
    lambda f: column(f / "corners.csv", "corner", lambda k: 3 - k),
)
simple(
    "corners from 1 to 4",
    "corners",
    "counted from 1 to 4",
    lambda f: column(f / "corners.csv", "corner", lambda k: k + 1),
)
simple(
    "ids off by one", "corners", "ids are off by one", lambda f: column(f / "corners.csv", "marker", lambda k: k + 1)
)
simple(
    "cameras exchanged in corners",
    "corners",
    "cameras are exchanged|cameras cam0 and cam1 are exchanged",
    lambda f: write(
        f / "corners.csv",
        rows(f / "corners.csv")[0],
        [
            [row[0], {"cam0": "cam1", "cam1": "cam0"}.get(row[1], row[1]), *row[2:]]
            for row in rows(f / "corners.csv")[1]
        ],
    ),
)


# -- rig.toml
def swap(a: dict, b: dict, key: str) -> None:
    a[key], b[key] = b[key], a[key]


simple(
    "camera poses exchanged",
    "corners",
    "cameras are exchanged",
    lambda f: rig(f, lambda t: swap(t["camera"][0], t["camera"][1], "pose")),
)


def inverted(camera: dict) -> None:
    pose = camera["pose"]
    R = Rotation.from_rotvec(pose["rotvec"]).inv()
    camera["pose"] = {"position": (-R.apply(pose["position"])).tolist(), "rotvec": R.as_rotvec().tolist()}


def in_degrees(entry: dict) -> None:
    entry["pose"]["rotvec"] = np.degrees(entry["pose"]["rotvec"]).tolist()


def euler(entry: dict) -> None:
    entry["pose"]["rotvec"] = Rotation.from_rotvec(entry["pose"]["rotvec"]).as_euler("xyz").tolist()


def opengl(entry: dict) -> None:
    entry["pose"]["rotvec"] = (
        (Rotation.from_rotvec(entry["pose"]["rotvec"]) * Rotation.from_euler("x", np.pi)).as_rotvec().tolist()
    )


simple("camera poses inverted", "corners", "pose is inverted", cameras(inverted))
simple("camera rotations in degrees", "corners", "in degrees", cameras(in_degrees))
simple("camera rotations as Euler angles", "corners", "Euler angles", cameras(euler))
simple("camera axes of OpenGL", "corners", "OpenGL", cameras(opengl))
simple(
    "fx and cx exchanged",
    "corners",
    "fx, fy and cx, cy are exchanged",
    cameras(matrix(lambda fx, fy, cx, cy: (cx, cy, fx, fy))),
)
simple(
    "cx and cy exchanged",
    "corners",
    "cx and cy are exchanged",
    cameras(matrix(lambda fx, fy, cx, cy: (fx, fy, cy, cx))),
)
simple(
    "matrix of half the resolution",
    "corners",
    "another image size|half the size",
    cameras(matrix(lambda fx, fy, cx, cy: (fx / 2, fy / 2, cx / 2, cy / 2))),
)
simple(
    "width and height exchanged",
    "corners",
    "width and height",
    cameras(lambda c: c.update(width=c["height"], height=c["width"])),
)
simple(
    "width of other images",
    "corners",
    "width is of another image size than the matrix",
    cameras(lambda c: c.update(width=c["width"] * 5 // 4)),
)
simple("focal length in mm", "corners", "focal length", cameras(matrix(lambda fx, fy, cx, cy: (8.0, 8.0, cx, cy))))
simple(
    "distortion with the other sign",
    "corners",
    "sign of the distortion",
    cameras(lambda c: c.update(distortion=[-k for k in c["distortion"]])),
)
simple(
    "distortion k1 k2 k3 p1 p2",
    "corners",
    "distortion is in another order",
    cameras(
        lambda c: c.update(
            distortion=[0.08, -0.1, 0.0, 0.0, 0.0][:0]
            or [c["distortion"][0], c["distortion"][4], c["distortion"][1], c["distortion"][2], c["distortion"][3]]
        )
    ),
)
simple(
    "an unused camera",
    "corners",
    "cam9 is unused",
    lambda f: rig(f, lambda t: t["camera"].append({**t["camera"][0], "name": "cam9"})),
)
simple(
    "markers 1.5 % small",
    "corners",
    "1\\.5% smaller|scale of print|1\\.[45]% larger",
    lambda f: rig(f, lambda t: each(t, "target", "marker", lambda s: s * 0.985)),
)
simple(
    "markers 3 % large",
    "corners",
    "scale of print",
    lambda f: rig(f, lambda t: each(t, "target", "marker", lambda s: s * 1.03)),
)
simple(
    "inner side measured",
    "corners",
    "black border is not counted",
    lambda f: rig(f, lambda t: each(t, "target", "marker", lambda s: s * 5 / 7)),
)
simple(
    "edge stated as marker",
    "corners",
    "cubes' edge is stated as the markers' side",
    lambda f: rig(f, lambda t: [e.update(marker=e["edge"]) for e in t["target"]] and None),
)
simple(
    "edge and marker exchanged",
    "corners",
    "edge and marker are exchanged",
    lambda f: rig(f, lambda t: [e.update(marker=e["edge"], edge=e["marker"]) for e in t["target"]] and None),
)
simple(
    "two cubes exchanged",
    "corners",
    "cubes P1 and P2 are exchanged",
    lambda f: rig(f, lambda t: swap(t["target"][0], t["target"][1], "faces")),
)


def turned(tree: dict) -> None:
    pose = tree["target"][0]["pose"]
    pose["rotvec"] = (Rotation.from_rotvec(pose["rotvec"]) * Rotation.from_euler("z", np.pi / 2)).as_rotvec().tolist()


simple("a cube turned", "corners", "cube P1 is turned", lambda f: rig(f, turned))
simple(
    "a cube on the other body",
    "corners",
    "P1 stands on the platform",
    lambda f: rig(f, lambda t: t["target"][0].update(body="base")),
)
simple(
    "base and platform joints exchanged",
    "corners",
    "base_joints and platform_joints are exchanged",
    lambda f: rig(
        f,
        lambda t: t["mechanism"].update(
            base_joints=t["mechanism"]["platform_joints"], platform_joints=t["mechanism"]["base_joints"]
        ),
    ),
)
simple(
    "joints in cm",
    "corners",
    "joints are in centimetres|platform_joints are in centimetres",
    lambda f: rig(
        f,
        lambda t: t["mechanism"].update(
            base_joints=(np.array(t["mechanism"]["base_joints"]) * 100).tolist(),
            platform_joints=(np.array(t["mechanism"]["platform_joints"]) * 100).tolist(),
        ),
    ),
)
simple(
    "joints in mm",
    "corners",
    "millimetres",
    lambda f: rig(
        f, lambda t: t["mechanism"].update(base_joints=(np.array(t["mechanism"]["base_joints"]) * 1e3).tolist())
    ),
)
simple(
    "base joints numbered from another",
    "corners",
    "numbered",
    lambda f: rig(
        f, lambda t: t["mechanism"].update(base_joints=np.roll(t["mechanism"]["base_joints"], 2, axis=0).tolist())
    ),
)
simple(
    "gravity upwards",
    "corners",
    "gravity has the wrong sign",
    lambda f: rig(f, lambda t: t["environment"].update(gravity=[0.0, 0.0, 9.80665])),
)
simple(
    "gravity in g",
    "corners",
    "gravity is in units of g",
    lambda f: rig(f, lambda t: t["environment"].update(gravity=[0.0, 0.0, -1.0])),
)


# -- sensors
def channel(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    return lambda f: column(f / "sensors.csv", name, change)


def add_payload(f: Path, kilograms: float) -> None:
    header, body = rows(f / "sensors.csv")
    retained = [k for k, name in enumerate(header) if name != "payload_mass_kg"]
    write(
        f / "sensors.csv",
        [*(header[k] for k in retained), "payload_mass_kg"],
        [[*(row[k] for k in retained), repr(kilograms if i > len(body) / 2 else 0.0)] for i, row in enumerate(body)],
    )


simple("temperatures in Kelvin", "corners", "Kelvin", channel("ambient_temperature_C", lambda T: T + 273.15))
simple("temperatures in Fahrenheit", "corners", "Fahrenheit", channel("ambient_temperature_C", lambda T: T * 1.8 + 32))
simple("payload in grams", "corners", "payload_mass_kg is in grams", lambda f: add_payload(f, 4000.0))


# -- images
@case("an image twice", "images", "an image occurs twice")
def _(f: Path) -> None:
    body = rows(f / "frames.csv")[1]
    shutil.copy(f / body[0][3], f / body[9][3])


simple(
    "another dictionary",
    "images",
    "wrong dictionary.*DICT_5X5_(50|100)",
    lambda f: rig(f, lambda t: each(t, "target", "dictionary", lambda _: "DICT_4X4_100")),
)
simple(
    "another dictionary for one cube",
    "images",
    "wrong dictionary: the markers of P2 are of DICT_5X5",
    lambda f: rig(f, lambda t: t["target"][1].update(dictionary="DICT_6X6_250")),
)


@case("images mirrored", "images", "mirrored")
def _(f: Path) -> None:
    for path in f.rglob("*.png"):
        cv2.imwrite(str(path), cv2.flip(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), 1))


@case("images half the size", "images", "is \\d+ x \\d+ px, but camera")
def _(f: Path) -> None:
    for path in f.rglob("*.png"):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


# -- poses of a platform, by an instrument
def poses(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    return lambda f: columns(f / "poses.csv", POSE, change)


def flipped(v: np.ndarray) -> np.ndarray:
    R = Rotation.from_rotvec(v[:, 3:]).inv()
    return np.column_stack([-R.apply(v[:, :3]), R.as_rotvec()])


def as_euler(v: np.ndarray) -> np.ndarray:
    return np.column_stack([v[:, :3], Rotation.from_rotvec(v[:, 3:]).as_euler("xyz")])


def degrees(v: np.ndarray) -> np.ndarray:
    return np.column_stack([v[:, :3], np.degrees(v[:, 3:])])


def quaternion(v: np.ndarray) -> np.ndarray:
    return np.column_stack([v[:, :3], Rotation.from_rotvec(v[:, 3:]).as_quat()[:, :3]])


simple("poses inverted", "poses", "poses are inverted", poses(flipped))
simple("poses in degrees", "poses", "in degrees", poses(degrees))
simple("poses in mm", "poses", "millimetres", poses(lambda v: v * [1e3, 1e3, 1e3, 1, 1, 1]))

# -- an arm and a tracker
simple("arm: poses inverted", "arm", "poses are inverted", poses(flipped))
simple("arm: poses as Euler angles", "arm", "Euler angles", poses(as_euler))
simple("arm: poses as quaternions", "arm", "quaternions", poses(quaternion))
simple("arm: poses in degrees", "arm", "in degrees", poses(degrees))
simple(
    "arm: joint 3 with the other sign",
    "arm",
    "joint 3 turns backwards",
    lambda f: column(f / "commands.csv", "q3", lambda q: -q),
)
simple(
    "arm: joint 2 from another zero",
    "arm",
    "joint 2 has another zero",
    lambda f: column(f / "commands.csv", "q2", lambda q: q + np.pi / 2),
)
simple(
    "arm: joints in degrees",
    "arm",
    "joint angles are in degrees",
    lambda f: columns(f / "commands.csv", ANGLES, np.degrees),
)
simple(
    "arm: joints exchanged",
    "arm",
    "joints 2 and 3 are exchanged",
    lambda f: rename(f / "commands.csv", lambda h: [{"q2": "q3", "q3": "q2"}.get(n, n) for n in h]),
)
simple(
    "arm: alpha in degrees",
    "arm",
    "in degrees",
    lambda f: rig(
        f, lambda t: [row.__setitem__(3, float(np.degrees(row[3]))) for row in t["mechanism"]["joints"]] and None
    ),
)
simple(
    "arm: a and d exchanged",
    "arm",
    "a and d are exchanged",
    lambda f: rig(
        f, lambda t: [row.__setitem__(slice(1, 3), row[2:0:-1]) for row in t["mechanism"]["joints"]] and None
    ),
)


@case("arm: poses shifted by one", "arm", "shifted by 1")
def _(f: Path) -> None:
    header, body = rows(f / "poses.csv")
    write(f / "poses.csv", header, [[row[0], *other[1:]] for row, other in zip(body, body[1:])])


# -- those that hide
def faces(tree: dict) -> None:
    numbers = tree["target"][0]["faces"]
    numbers["+x"], numbers["-x"] = numbers["-x"], numbers["+x"]


def wider(name: str) -> Callable[[Path], None]:
    return lambda f: rig(f, lambda t: t["mechanism"].update({name: (np.array(t["mechanism"][name]) * 1.1).tolist()}))


@case("frames shifted by two", "corners", "shifted by 2")
def _(f: Path) -> None:
    header, body = rows(f / "frames.csv")
    per = 2 * len({row[2] for row in body})
    times = [row[1] for row in body]
    for row, t in zip(body, times[per:] + [repr(float(times[-1]) + 5 * (1 + 2 * k // per)) for k in range(per)]):
        row[1] = t
    write(f / "frames.csv", header, body)


simple("faces +x and -x exchanged", "corners", "faces \\+x and -x of cube P1 are exchanged", lambda f: rig(f, faces))
simple("base joints 10 % large", "corners", "base_joints are (9|10|11)% too large", wider("base_joints"))
simple(
    "arm: poses in cm",
    "arm",
    "positions are in centimetres",
    lambda f: columns(f / "poses.csv", ("x", "y", "z"), lambda p: p * 100),
)
simple(
    "edges 20 mm large",
    "corners",
    "edge of all cubes is stated about 20 mm too large",
    lambda f: rig(f, lambda t: each(t, "target", "edge", lambda e: e + 0.02)),
)
simple(
    "focal length x 1.3",
    "corners",
    "focal length is about (29|30|31)% too large",
    cameras(matrix(lambda fx, fy, cx, cy: (1.3 * fx, 1.3 * fy, cx, cy))),
)
