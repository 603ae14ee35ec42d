"""All families against one pair of planes: the best of each, most convincing first."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.stats import chi2

from calib.diagnose import scan
from calib.diagnose.forked import each
from calib.diagnose.planes import Column
from calib.diagnose.scan import Score
from rig.effects.base import Effect
from rig.effects.vibration import one_direction
from vision.derivatives import derivatives

FREQUENCIES = 8  # bins of the coarse spectrum for each cycle that the highest frequency makes
ALIAS = 0.25  # of the spectral window's height from which a frequency mirrors a slow one
SLOWEST = 20  # cycles in the recording, below which it is a drift
OVERSAMPLED = 4  # frequencies looked at for each that the recording's length can tell apart


def search(planes, families, signatures, progress=None):
    """[Score] of all families, the greatest gain first.

    planes : Planes; families : [Family]; signatures : Signatures at the planes' Knowledge; progress : called with (done, of), or None
    """
    k = planes.knowledge
    motion = k.motion(k.effects) if k.axes else None
    struts = scan.strut_atoms(planes) if k.axes else None
    mounts, held = {}, set(signatures.pixels)

    def ask(family):
        if "frequency" in {p.role for p in family.kind.parameters}:
            score = _vibration(planes, family, struts)
        elif family.plane == "struts":
            score = _strutwise(planes, family, signatures, struts, motion)
        elif family.kind.mount is not Effect.mount:
            if family.place not in mounts:
                mounts[family.place] = scan.view_atoms(planes, mount_pixels(planes, family.place))
            score = _mounted(planes, family, mounts[family.place])
        else:
            score = _viewed(planes, family, signatures)
        new = {key: signatures.pixels[key] for key in signatures.pixels.keys() - held}
        held.update(new)
        return replace(score, family=None), new  # a family is known by its identity, which no copy has

    out = []
    for family, (score, new) in zip(families, each(ask, families, progress)):
        signatures.pixels.update(new)
        out.append(replace(score, family=family))
    return sorted(out, key=lambda s: -s.raw_gain(planes.size))


def column_of(planes, family, shape, signatures, motion=None):
    """Column (k = linear parameters, or 1) of one shape of a family: its signature in both planes."""
    k = planes.knowledge
    if "frequency" in {p.role for p in family.kind.parameters}:
        return Column(None, planes.whitened(_wave(planes, family, np.array([shape["frequency"]]))[0]))
    if family.plane == "struts":
        return Column(None, planes.whitened(signatures.deviation(family, shape, motion or k.motion(k.effects))))
    if family.kind.mount is not Effect.mount:
        pixels = mount_pixels(planes, family.place) * _weight(planes, family, shape)[k.seen.observations.frame][:, None, None]
        return planes.fold(pixels)
    return planes.fold(signatures.corners(*signatures.seen(family, shape)))


def mount_pixels(planes, place):
    """(n, 2, 6) px per unit tangent by which corners move with a camera's mount."""
    k = planes.knowledge
    o = k.seen.observations
    out = np.zeros((len(o), 2, 6))
    for i, rows, _, J_camera, _ in derivatives(o, k.state):
        if f"camera {k.design.cameras[i].name}" == place:
            out[rows] = J_camera
    return out


def _strutwise(planes, family, signatures, atoms, motion):
    parts = []
    for start in range(0, len(family.shapes), scan.CHUNK):
        weights = np.stack([signatures.deviation(family, shape, motion) for shape in family.shapes[start : start + scan.CHUNK]])
        parts.append(scan.framewise(atoms, weights))
    b, G, raw = (np.concatenate(part) for part in zip(*parts))
    drops, coefficients, rank, seen = (scan.solve if family.linear else scan.whole)(b, G, raw)
    best = int(np.argmax(drops))
    weights = signatures.deviation(family, family.shapes[best], motion)
    return _score(planes, family, best, drops, coefficients, rank, seen, atoms, weights)


def _mounted(planes, family, atoms):
    w = np.stack([_weight(planes, family, shape) for shape in family.shapes])
    drops, coefficients, rank, seen = scan.solve(*scan.stepwise(atoms, w))
    best = int(np.argmax(drops))
    return _score(planes, family, best, drops, coefficients, rank, seen, atoms, w[best][:, None, None] * np.eye(6))


def _weight(planes, family, shape):
    """(F,) share of its motion that a mount has made by each frame."""
    camera = planes.knowledge.stated.camera(family.place.split(" ")[1])
    return family.effect(shape, np.r_[1.0, np.zeros(5)]).mount(camera, planes.knowledge.t, None)[:, 0]


def _viewed(planes, family, signatures):
    if len(family.shapes) > 1:
        return _shaped(planes, family, signatures)
    atoms = scan.view_atoms(planes, signatures.corners(*signatures.seen(family, family.shapes[0])))
    drops, coefficients, rank, seen = scan.solve(*scan.stepwise(atoms, np.ones((1, planes.frames))))
    weights = np.broadcast_to(np.eye(atoms.beta.shape[1]), atoms.gamma.shape)
    return _score(planes, family, 0, drops, coefficients, rank, seen, atoms, weights)


def _shaped(planes, family, signatures):
    """Of one linear parameter at several shapes: a column for each, and each taken alone."""
    parts = [signatures.seen(family, shape) for shape in family.shapes]
    atoms = scan.view_atoms(planes, signatures.corners(parts[0][0], np.concatenate([quads for _, quads in parts], axis=-1)))
    count = len(family.shapes)
    weights = np.broadcast_to(np.eye(count)[:, None, :, None], (count, planes.frames, count, 1))
    drops, coefficients, rank, seen = scan.solve(*scan.framewise(atoms, weights))
    best = int(np.argmax(drops))
    return _score(planes, family, best, drops, coefficients, rank, seen, atoms, weights[best])


def _score(planes, family, best, drops, coefficients, rank, seen, atoms, weights):
    """Score of the best of a family's shapes; weights : (F, a, q) of that shape."""
    theta = coefficients[best] if coefficients.shape[1] else np.ones(1)
    spread, active = scan.dispersion(planes, atoms, weights, theta)
    p = scan.davies(drops / spread, rank[best], spread, active)
    return Score(family, dict(family.shapes[best]), coefficients[best], float(drops[best] / spread), p, int(rank[best]) + family.extra, spread,
                 float(seen[best]), drops / spread)


def _wave(planes, family, frequencies):
    """(k, F, a, 12) m of struts under the sine, then the cosine of frequencies (k,) Hz along each of six directions."""
    k = planes.knowledge
    modes = np.stack([k.swayed(np.tile(unit, (len(k.t), 1))) for unit in np.eye(6)], axis=-1)
    angle = 2 * np.pi * frequencies[:, None] * k.t
    return np.concatenate([np.sin(angle)[:, :, None, None] * modes, np.cos(angle)[:, :, None, None] * modes], axis=-1)


def _vibration(planes, family, atoms):
    """A coarse spectrum of all directions over all frequencies, then the exact drop of one direction about its greatest peaks."""
    k = planes.knowledge
    parameter = next(p for p in family.kind.parameters if p.role == "frequency")
    low, high = parameter.usual
    modes = _wave(planes, family, np.zeros(1))[0, :, :, 6:]
    beta, power = np.einsum("fad,fa->fd", modes, atoms.beta), np.einsum("fad,fab,fbe->de", modes, atoms.gamma, modes)
    half = np.linalg.cholesky(np.linalg.inv(power + 1e-9 * np.diag(np.diag(power))))
    length = np.ptp(k.t) + 1e-9
    tick = _tick(k.t)
    high = min(high, 0.5 / tick)
    bins = int(2 ** np.ceil(np.log2(max(length * OVERSAMPLED, 1) * high * FREQUENCIES / OVERSAMPLED)))
    step = length * OVERSAMPLED / bins
    at = np.rint((k.t - k.t[0]) / step).astype(int)
    spectrum = sum(2 * np.abs(np.fft.rfft(np.bincount(at, weights=series, minlength=bins)[:bins], bins)) ** 2 for series in (beta @ half).T)
    frequency = np.fft.rfftfreq(bins, step)
    window = np.abs(np.fft.rfft(np.bincount(at, minlength=bins)[:bins], bins)) / len(k.t)
    slow = maximum_filter1d((window > ALIAS).astype(float), 2 * SLOWEST * OVERSAMPLED + 1) > 0  # looks like a drift, or like none
    inside = (frequency >= max(low, SLOWEST / length)) & (frequency <= high) & ~slow
    freedom = len(family.linear) - family.tied + family.extra
    if not inside.any():
        return Score(family, {**family.shapes[0], "frequency": low}, np.zeros(12), 0.0, 1.0, freedom, 1.0, 0.0, np.zeros(1))
    spectrum, frequency = spectrum[inside], frequency[inside]
    peaks = np.argsort(-spectrum)[: scan.PEAKS]
    near = np.unique(np.concatenate([frequency[p] + np.linspace(-1, 1, 21) / (OVERSAMPLED * length) for p in peaks]))
    b, G, raw = scan.framewise(atoms, _wave(planes, family, near))
    drops, coefficients = (np.array(part) for part in zip(*(one_direction(*pair) for pair in zip(b, G))))
    best = int(np.argmax(drops))
    seen = scan.solve(b[best : best + 1], G[best : best + 1], raw[best : best + 1])[3]
    spread, _ = scan.dispersion(planes, atoms, _wave(planes, family, near[best : best + 1])[0], coefficients[best])
    drop = drops[best] / spread
    p = min(1.0, length * high * float(chi2.sf(drop, freedom - family.extra)))
    return Score(family, {**family.shapes[0], "frequency": float(near[best])}, coefficients[best], float(drop), float(p), freedom,
                 spread, float(seen[0]), drops / spread)


def _tick(t):
    """s: the step of which all times (F,) are whole multiples; a frequency and its mirror images about 1 / tick look the same."""
    return np.gcd.reduce(np.rint((t - t[0]) * 1e4).astype(int)) * 1e-4 or 1e-4
