"""Where a mount really points: the pointing equations of the literature, to first order in each term.

Source: Wallace, TPOINT; azimuth from north to east; x north, y east, z down.
"""

import numpy as np

ARCSEC = np.pi / 648000


def altazimuth(a: np.ndarray, e: np.ndarray, terms: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Azimuth and elevation (n,) rad of a mount commanded to a, e (n,) rad, with terms in rad."""
    t = terms
    da = -t["IA"] - t["CA"] / np.cos(e) - (t["NPAE"] + t["AN"] * np.sin(a) + t["AW"] * np.cos(a)) * np.tan(e)
    de = t["IE"] - t["AN"] * np.cos(a) + t["AW"] * np.sin(a) - t["TF"] * np.cos(e)
    return a + da, e + de


def equatorial(h: np.ndarray, d: np.ndarray, terms: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Hour angle and declination (n,) rad of a mount commanded to h, d (n,) rad, with terms in rad."""
    t = terms
    dh = t["IH"] + t["CH"] / np.cos(d) + (t["NP"] - t["MA"] * np.cos(h) + t["ME"] * np.sin(h)) * np.tan(d)
    return h + dh, d + t["ID"] + t["MA"] * np.sin(h) + t["ME"] * np.cos(h)


def to_horizon(h: np.ndarray, d: np.ndarray, latitude: float) -> np.ndarray:
    """(n, 3) unit vectors of hour angle and declination (n,) rad at a latitude, rad."""
    up = np.sin(d) * np.sin(latitude) + np.cos(d) * np.cos(latitude) * np.cos(h)
    north = np.sin(d) * np.cos(latitude) - np.cos(d) * np.sin(latitude) * np.cos(h)
    return np.stack([north, -np.cos(d) * np.sin(h), -up], axis=1)


def of_angles(a: np.ndarray, e: np.ndarray) -> np.ndarray:
    """(n, 3) unit vectors of azimuth and elevation (n,) rad."""
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), -np.sin(e)], axis=1)


def seen(directions: np.ndarray, sigma: float, wrong: int, rng: np.random.Generator) -> np.ndarray:
    """(n, 3) directions with noise of sigma rad along two axes across them; `wrong` of them are other stars, 1 arcmin
    to 3 degrees away.
    """
    size = np.full(len(directions), sigma)
    off = size[:, None] * rng.normal(size=(len(directions), 2))
    for i in rng.permutation(len(directions))[:wrong]:
        angle = rng.uniform(0, 2 * np.pi)
        off[i] += np.radians(10 ** rng.uniform(np.log10(1 / 60), np.log10(3))) * np.array(
            [np.cos(angle), np.sin(angle)]
        )
    other = np.eye(3)[np.argmin(np.abs(directions), axis=1)]
    x = np.cross(directions, other)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    out = directions + off[:, :1] * x + off[:, 1:] * np.cross(directions, x)
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def altazimuth_scores(q: np.ndarray, seen: np.ndarray, terms: dict[str, float], sigma: float) -> np.ndarray:
    """(7,) errors, in their standard deviations, of the terms of `altazimuth` by plain linear least squares: the best
    that anybody can do who knows which stars are right.

    q : (n, 2) rad, commands; seen : (n, 3) directions of right stars; terms : the true ones, rad; sigma : rad
    """
    (a, e), none = q.T, np.zeros(len(q))
    off = (np.arctan2(seen[:, 1], seen[:, 0]) - a + np.pi) % (2 * np.pi) - np.pi
    y = np.concatenate([off * np.cos(e), -np.arcsin(seen[:, 2]) - e])
    columns = {
        "IA": (-np.cos(e), none),
        "IE": (none, none + 1),
        "CA": (none - 1, none),
        "NPAE": (-np.sin(e), none),
        "AN": (-np.sin(a) * np.sin(e), -np.cos(a)),
        "AW": (-np.cos(a) * np.sin(e), np.sin(a)),
        "TF": (none, -np.cos(e)),
    }
    X = np.stack([np.concatenate(columns[name]) for name in terms], axis=1)
    found = np.linalg.lstsq(X, y)[0] - np.array(list(terms.values()))
    return found / (sigma * np.sqrt(np.diag(np.linalg.inv(X.T @ X))))
