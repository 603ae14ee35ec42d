"""Faces exchanged or glued on turned: told from corners that lie whole marker sides away from where they should be."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.diagnosis.problems.platform.operating_point import OperatingPoint
from rig.arrays import Floats, Integers
from rig.effects.framework.effect import Effect
from rig.effects.framework.place import Place
from vision.predict import predict_sightings

FAR = 5.0  # px; a sighting farther off than this, in the middle, is misplaced
BROUGHT_BACK = 0.2  # of that distance to which an exchange must bring it
SHARE = 0.7  # of a marker's sightings that must be misplaced


def find_marker_swaps(point: OperatingPoint, kinds: Sequence[type[Effect]]) -> list[Effect]:
    """Effects of discrete kinds found from corners that lie whole marker sides from where they should be."""
    seen = point.seen
    if seen is None or not kinds:
        return []
    off = _distance(point, ())
    ids, rows = seen.markers.id, seen.sightings.marker
    misplaced = [m for m in np.unique(rows) if np.mean(off[rows == m] > FAR) > SHARE]
    unseen = np.setdiff1d(np.arange(len(ids)), rows)  # a face that no camera sees may have been exchanged as well
    out: list[Effect] = []
    done: set[int] = set()
    for m in misplaced:
        if m in done:
            continue
        others = [Place("marker", str(ids[n])) for n in (*misplaced, *unseen) if n != m]
        trials = [t for kind in kinds for t in kind.exchanges(Place("marker", str(ids[m])), others)]
        if not trials:
            continue
        worst = []
        for trial in trials:
            moved = _distance(point, (trial,))
            both = {m, *_rows(ids, trial)}
            worst.append(max(np.median(moved[rows == n]) for n in both if (rows == n).any()))
        best = int(np.argmin(worst))
        if worst[best] < max(BROUGHT_BACK * np.median(off[rows == m]), 2.0):
            out.append(trials[best])
            done |= {m, *_rows(ids, trials[best])}
    return out


def correct_marker_swaps(point: OperatingPoint, marker_swaps: Sequence[Effect]) -> OperatingPoint:
    """OperatingPoint with marker swaps corrected: each marker sits where they state."""
    if not marker_swaps:
        return point
    seen, markers = point.observed, point.observed.markers
    for effect in marker_swaps:
        markers = effect.attach(markers)
    o = seen.observations
    o = replace(o, points=markers.corners[o.marker, o.corner], on_platform=markers.on_platform[o.marker])
    return replace(point, seen=replace(seen, observations=o, markers=markers))


def _distance(point: OperatingPoint, effects: tuple[Effect, ...]) -> Floats:
    """(sightings,) px, the middle corner's distance from where effects put it."""
    seen = point.observed
    quads = predict_sightings(seen.sightings, point.state, seen.markers, point.t, effects, point.sensors)
    error = np.linalg.norm(seen.observations.uv - quads[seen.row, seen.observations.corner], axis=1)
    total, count = np.bincount(seen.row, weights=error), np.bincount(seen.row)
    return total / np.maximum(count, 1)


def _rows(ids: Integers, effect: Effect) -> Integers:
    """Indices of the markers (their ids) at which an effect changes something."""
    return np.flatnonzero(np.isin(ids, [place.number for place in effect.sites_touched()]))
