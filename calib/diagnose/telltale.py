"""What an effect looks like: residuals against the covariate that gives it away, without the effect and with it."""

import numpy as np
from matplotlib.figure import Figure

from rig.effects.base import REFERENCE_TEMPERATURE

BINS = 14  # of the covariate, with as many residuals each
BEFORE, AFTER = "tab:red", "tab:blue"
CELLS = 14  # of a residual map, across the image


def residuals(settled, without=()):
    """(closures (F, axes) m, corners (n, 2) px in the observations' order) that are left where some admitted effects (numbers) are taken
    away and cameras, geometry and poses make up for it as far as they can."""
    planes, k = settled.planes, settled.knowledge
    struts, image = planes.struts, planes.image
    effects = tuple(e for i, e in enumerate(k.effects) if i not in set(without))
    if len(effects) < len(k.effects):
        grown = planes.nothing(1) if not k.axes else planes.whitened((k.effective() - k.effective(effects))[..., None])
        shift = 0.0
        if k.seen is not None:
            moved = planes.fold((k.pixels() - k.pixels(effects))[..., None])
            grown, shift = grown + moved.struts, moved.image[:, 0]
        taken = planes.basis.struts.T @ grown[:, 0] + (planes.basis.image.T @ shift if k.seen is not None else 0)
        struts = struts + grown[:, 0] - planes.basis.struts @ taken
        image = image + shift - planes.basis.image @ taken
    return _in_metres(planes, struts), _in_pixels(planes, image)


def _in_metres(planes, struts):
    F, axes = planes.frames, planes.knowledge.axes
    return np.linalg.solve(planes.W, struts[: F * axes].reshape(F, axes, 1))[..., 0] if axes else np.zeros((F, 0))


def _in_pixels(planes, image):
    out = np.zeros((len(planes.order), 2))
    if len(planes.order):
        out[planes.order] = np.linalg.solve(planes.whiten, planes.sigma * image.reshape(-1, 2, 1))[..., 0]
    return out


def telltale(settled, number):
    """Figure of admitted effect number `number`: left without it, right with it, all else as admitted."""
    k, effect = settled.knowledge, settled.knowledge.effects[number]
    (struts_before, image_before), (struts_after, image_after) = residuals(settled, (number,)), residuals(settled)
    if effect.stage not in ("targets", "view"):
        x, label, y = _strut_view(effect, k, struts_before, struts_after)
        return _scatter(x, label, [v * 1e6 for v in y], "strut, µm" if k.design.mechanism.kind != "arm" else "joint, µrad")
    own = _own(effect, k)
    if effect.view == "map":
        return residual_map(k, own, (image_before, image_after))
    if effect.view == "time":
        frame = k.seen.observations.frame[own]
        along = _mean(frame, image_before[own] - image_after[own])
        way = along[np.argmax(np.linalg.norm(along, axis=1))]
        way = way / max(np.linalg.norm(way), 1e-12)
        return _scatter(k.t[np.unique(frame)] / 60, "time, min", [_mean(frame, v[own] @ way) for v in (image_before, image_after)],
                        "mean of a picture's corners, px")
    if effect.view == "scale":
        return _focal(effect, k, own, image_before, image_after)
    if effect.view == "outward":
        return _outward(k, own, image_before, image_after)
    if effect.view in ("markers", "targets"):
        return _bars(effect, k, image_before, image_after)
    way = image_before[own] - image_after[own]
    size = np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
    return _scatter(size[:, 0], "displacement that it makes, px", [np.einsum("ni,ni->n", v[own], way / size) for v in (image_before, image_after)],
                    "residual along it, px")


def _strut_view(effect, k, before, after):
    """(covariate (m,), its label, [residuals (m,) before, after]) of an effect of the struts."""
    motion = k.motion(tuple(e for e in k.effects if e is not effect))
    covariate, direction = effect.covariate(motion), effect.direction(motion)
    if direction is not None:
        mode = k.swayed(direction)
        size = np.maximum((mode**2).sum(axis=1), 1e-300)
        return covariate.values, covariate.label, [(mode * v).sum(axis=1) / size * np.sqrt(size.max()) for v in (before, after)]
    at = np.arange(k.axes) if effect.place == "clock" else np.flatnonzero(effect.axes(motion.places) > 0)
    x = covariate.values
    x = np.broadcast_to(x if x.ndim == 2 else x[:, None], before.shape)
    return x[:, at].ravel(), covariate.label, [before[:, at].ravel(), after[:, at].ravel()]


def _own(effect, k):
    """Indices of the corners at an effect's place."""
    o, (kind, _, name) = k.seen.observations, effect.place.partition(" ")
    if kind == "camera":
        return np.flatnonzero(o.camera == [c.name for c in k.design.cameras].index(name))
    if kind == "marker":
        return np.flatnonzero(k.seen.markers.id[o.marker] == int(name))
    if kind == "target":
        return np.flatnonzero(np.array(k.seen.markers.target)[o.marker] == name)
    return np.arange(len(o))


def _mean(key, values):
    """Means of values (n, ...) by key (n,), in the order of the keys."""
    _, index, count = np.unique(key, return_inverse=True, return_counts=True)
    out = np.zeros((len(count), *values.shape[1:]))
    np.add.at(out, index, values)
    return out / count.reshape(-1, *[1] * (values.ndim - 1))


def _focal(effect, k, own, before, after):
    """Scale of each picture about its centre against temperature."""
    o = k.seen.observations
    matrix = np.stack([c.matrix[:2, 2] for c in k.design.cameras])
    away = o.uv[own] - matrix[o.camera[own]]
    key = o.frame[own] * len(matrix) + o.camera[own]
    keys, first = np.unique(key, return_index=True)
    scale = [_mean(key, np.einsum("ni,ni->n", v[own], away)) / np.maximum(_mean(key, (away**2).sum(axis=1)), 1e-12) * 1e6 for v in (before, after)]
    camera = [c.name for c in k.design.cameras]
    warmth = np.stack([k.sensors.at(k.t, f"camera_{name}_temperature_C", "ambient_temperature_C") for name in camera])
    x = warmth[o.camera[own][first], o.frame[own][first]]
    return _scatter(x, f"temperature, C (dimensions hold at {REFERENCE_TEMPERATURE:g})", scale, "scale of a picture, 1e-6")


def _outward(k, own, before, after):
    """How far corners lie outward of their marker's middle against its size in the image."""
    o = k.seen.observations
    row = k.seen.row[own]
    middle = _mean(row, o.uv[own])
    _, index = np.unique(row, return_inverse=True)
    away = o.uv[own] - middle[index]
    size = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    values = [_mean(row, np.einsum("ni,ni->n", v[own], away) / size) for v in (before, after)]
    return _scatter(np.sqrt(2) * _mean(row, size), "side of the marker in the image, px", values, "corners lie outward by, px")


def _bars(effect, k, before, after):
    """Residuals of every marker or target of the same body."""
    o = k.seen.observations
    by_target = effect.view == "targets"
    names = np.array(k.seen.markers.target if by_target else [str(i) for i in k.seen.markers.id])[o.marker]
    labels = sorted(set(names.tolist()), key=lambda n: (len(n), n))
    figure = Figure(figsize=(11, 2.6), layout="constrained")
    axes = figure.subplots()
    mine = effect.place.split(" ")[1]
    for offset, values, colour, text in ((-0.2, before, BEFORE, "without it"), (0.2, after, AFTER, "with it")):
        height = [np.sqrt(np.mean(values[names == n] ** 2)) for n in labels]
        axes.bar(np.arange(len(labels)) + offset, height, 0.4, color=colour, label=text)
    axes.set(xticks=range(len(labels)), ylabel="RMS, px", xlabel="cube" if by_target else "marker")
    axes.set_xticklabels(labels, fontsize=7)
    for tick, n in zip(axes.get_xticklabels(), labels):
        tick.set(color="crimson" if n == mine else "black", fontweight="bold" if n == mine else "normal")
    axes.legend(fontsize=8)
    return figure


def residual_map(k, own, both, titles=("without it", "with it")):
    """Figure of mean residuals over patches of one camera's image, one panel for each of `both` (n, 2) px."""
    o = k.seen.observations
    camera = k.design.cameras[o.camera[own[0]]]
    cell = camera.width / CELLS
    key = (o.uv[own] // cell).astype(int) @ [1, 1000]
    keys, count = np.unique(key, return_counts=True)
    centre = np.stack([keys % 1000, keys // 1000], axis=1) * cell + cell / 2
    means = [_mean(key, values[own]) for values in both]
    enough = count >= 5
    longest = max(np.linalg.norm(means[0][enough], axis=1).max(initial=0), 1e-9)
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    for axes, mean, title, colour in zip(figure.subplots(1, len(both), squeeze=False)[0], means, titles, (BEFORE, AFTER)):
        axes.quiver(*centre[enough].T, *mean[enough].T, angles="xy", scale_units="xy", scale=longest / (1.2 * cell), color=colour, width=0.004)
        axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal", title=f"{camera.name}, {title}",
                 xlabel=f"longest arrow of both {longest:.3g} px")
    return figure


def _scatter(x, label, both, y):
    """Figure of residuals before and after (m,) against a covariate x (m,), and of those before against what the effect explains."""
    figure = Figure(figsize=(11, 3.2), layout="constrained")
    limit = 1.15 * max(np.quantile(np.abs(v), 0.995) for v in both) + 1e-12
    panels = ((x, both[0], "without it", BEFORE, label), (x, both[1], "with it", AFTER, label),
              (both[0] - both[1], both[0], "without it, against what it explains", BEFORE, f"explained: {y}"))
    for axes, (at, values, title, colour, below) in zip(figure.subplots(1, 3, sharey=True), panels):
        axes.plot(at, np.clip(values, -limit, limit), ".", ms=3, alpha=0.4, color="grey")
        inside = _bins(at)
        axes.errorbar([at[b].mean() for b in inside], [values[b].mean() for b in inside],
                      [2 * values[b].std() / np.sqrt(b.sum()) for b in inside], fmt="o", ms=4, color=colour, capsize=2)
        axes.axhline(0, color="black", lw=0.6)
        axes.set_xlabel(below, fontsize=8)
        axes.set_title(title, fontsize=10)
        axes.set_ylim(-limit, limit)
    ends = np.array([(both[0] - both[1]).min(), (both[0] - both[1]).max()])
    figure.axes[2].plot(ends, ends, color="black", lw=1, ls="--")
    figure.axes[0].set_ylabel(y)
    return figure


def _bins(x):
    """[(m,) bool] of BINS bins with as many of x (m,) each; fewer where x repeats itself."""
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    return [place == b for b in np.unique(place)]


def over_time(t, values, y):
    """Figure of what is left (n,) at times t (n,) s, its running mean drawn in."""
    order = np.argsort(t)
    figure = Figure(figsize=(11, 2.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(t / 60, values, ".", ms=3, alpha=0.5, color="grey")
    width = max(len(t) // 25, 1)
    axes.plot(np.convolve(t[order], np.ones(width) / width, "valid") / 60, np.convolve(values[order], np.ones(width) / width, "valid"), color=AFTER)
    axes.axhline(0, color="black", lw=0.6)
    axes.set(xlabel="time, min", ylabel=y)
    return figure
