"""The hexapod's 42 parameters one pose at a time: a square-root information filter that watches for what jumps.

Linearised at every pose about the estimate of the moment, the first poses once more about a later one, it ends where a batch of the
same poses does. What jumps (calib/online/change_detection.py) is told within three poses; the filter then goes back to before it, opens what
jumped, and learns the poses since anew. A pose that disagrees is held until the next ones say whether it alone was wrong.
"""

import json
from dataclasses import dataclass

import numpy as np

from calib.identify.geometry import PRIOR, parameters, with_parameters
from calib.online.change_detection import SUSPECT, Evidence, judge
from calib.identify.observability import gauge
from calib.online.square_root import ALARM, KINDS, REFUSED, SUMS, WINDOW, follow, learn
from rig import json_file
from rig.design import Hexapod
from rig.entries import LARGEST_RIG
from rig.errors import FileError, RigError
from rig.pose import pose, vector
from rig.files import write_text

SCHEMA = "online/1"
LARGEST = 6  # changes at one pose
MOST_SHARED = 1000  # draws that all poses' errors have in common: six for a camera
SINGULAR = 1e-12  # 1/m; what a triangle's diagonal must exceed
AGAIN = (8, 16, 32, 64, 128)  # poses after which all up to then are linearised again


@dataclass(frozen=True, slots=True, eq=False)
class Update:
    """number : of the pose, from 0; innovation : (6,) whitened, N(0, I) where nothing is wrong; changes : Changes found with it
    held : whether the pose waits for the next one's word; dropped : numbers of poses found wrong with it"""

    number: int
    innovation: np.ndarray
    changes: tuple
    held: bool
    dropped: tuple


class Online:
    """The filter. Its estimate is `hexapod`, with `covariance`; `save` and `load` carry it over a restart exactly."""

    def __init__(self, nominal: Hexapod, shared=0, scatter=None, covariance=None):
        """nominal : Hexapod to start from; shared : draws that all poses' errors have in common
        scatter : (6,) m of each strut beyond the poses' covariance, or None
        covariance : (42, 42) m^2 of the start, from a calibration, or None for what an owner's figures are worth (5 mm)"""
        self.nominal = nominal
        self.root = np.eye(42) / PRIOR if covariance is None else np.linalg.qr(np.linalg.inv(np.linalg.cholesky(covariance)), mode="r")
        self.home = np.ascontiguousarray(nominal.home.as_matrix())
        self.scatter = np.zeros(6) if scatter is None else np.asarray(scatter, float)
        self.variance = self.scatter**2
        k = shared + 42
        S = np.zeros((k, k + 1 + KINDS * WINDOW))
        S[:shared, :shared], S[shared:, shared:k] = np.eye(shared), self.root
        self.p, self.s, self.S, self.sums, self.count = parameters(nominal), np.zeros(shared), S, np.zeros((WINDOW, SUMS)), 0
        self.number, self.held, self.said = 0, (), 0
        self.data = set()  # marks of what was learnt (see rig.provenance), so that it is not learnt again
        self.recent = []  # (state before, pose, its own sums) of the last WINDOW poses
        self.first = []  # poses to linearise again; None once that is over

    @property
    def hexapod(self):
        """The Hexapod as estimated now."""
        return with_parameters(self.nominal, self.p)

    @property
    def covariance(self):
        """(42, 42) m^2 of the estimate."""
        k = len(self.S)
        half = np.linalg.inv(self.S[:, :k])
        return (half @ half.T)[-42:, -42:]

    def new_session(self, shared=0):
        """From here on the poses share other errors: `shared` new draws, what was known of the old ones is marginalised.

        Poses that were held are given up."""
        c, k = len(self.s), shared + 42
        kept = self.S[c:, c : c + 42]
        self.S, self.s = np.zeros((k, k + 1 + KINDS * WINDOW)), np.zeros(shared)
        self.S[:shared, :shared], self.S[shared:, shared:k] = np.eye(shared), kept
        self.sums[:], self.recent, self.first, self.held = 0, [], None, ()

    def update(self, x, T_base_platform, covariance, common=None):
        """One pose. x : (6,) m commanded; T_base_platform : RigidTransform measured; covariance : (6, 6) tangent on the right
        common : (6, shared) factor of the shared errors, needed where there are any. Returns Update.
        Raises ValueError for wrong shapes, RigError for a command that closes on no pose or a covariance that is none.
        """
        matrix = T_base_platform.as_matrix()
        common = np.zeros((6, 0)) if common is None else np.ascontiguousarray(common, float)
        raw = (self.number, np.array(x, float), matrix[:3, :3].copy(), matrix[:3, 3].copy(), np.array(covariance, float), common)
        if raw[1].shape != (6,) or raw[4].shape != (6, 6) or common.shape != (6, len(self.s)) or not np.isfinite(raw[1]).all():
            raise ValueError(f"expected a command (6,), a covariance (6, 6) and common (6, {len(self.s)}), got {raw[1].shape}, {raw[4].shape} "
                             f"and {common.shape}")
        start, held = self._state(), self.held
        try:
            return self._take(raw, start)
        except RigError:
            self._restore(start)
            self.held = held
            raise

    def _take(self, raw, before):
        """Update with a pose. before : the state, which is now"""
        innovation, changes, dropped, waiting = np.empty(6), [], (), self.held
        for each in (*waiting, raw):
            self._learn(each, innovation, state=before if each is raw and not waiting else None)
        found = self._judged(innovation)
        if waiting and not found and (innovation @ innovation < SUSPECT or self._quiet(before, raw, innovation)):
            dropped, waiting = tuple(each[0] for each in waiting), ()  # those held were wrong, each alone
            self._restore(before)
            self._learn(raw, innovation)
            found = self._judged(innovation)
        while found and len(changes) < LARGEST:
            changes += found
            found = self._open(found, innovation)
        self.held = ()
        if not changes and (waiting or innovation @ innovation > SUSPECT):
            self._restore(before)
            self.held = (*waiting, raw)
            if len(self.held) == WINDOW:  # nothing explains them: the oldest is given up
                dropped, self.held = (*dropped, self.held[0][0]), self.held[1:]
        elif self.first is not None and len(self.first) in AGAIN:
            self._again(innovation)
        self.number += 1
        return Update(self.number - 1, innovation.copy(), tuple(changes), bool(self.held), dropped)

    def _judged(self, innovation):
        """Changes that the last poses bear out; early on, when a pose may still move the estimate far, only once linearised there."""
        found = judge(self._evidence())
        for _ in range(2):
            if self.first is None or not (found or innovation @ innovation > SUSPECT):
                break
            self._again(innovation)
            found = judge(self._evidence())
        return found

    def _quiet(self, before, raw, innovation):
        """Whether a pose agrees with the state before; the state is then as it was after `before` and this pose."""
        after = self._state()
        self._restore(before)
        self._learn(raw, innovation)
        agrees = innovation @ innovation < SUSPECT
        self._restore(after)
        return agrees

    def _learn(self, raw, innovation, move=True, state=None):
        """Take in a pose. state : the present state where the caller has it already"""
        number, x, R, t, C, common = raw
        before = self._state() if state is None else state
        try:
            self.said = learn(x, R, t, C, common, self.variance, self.home, self.p, self.s, self.S, self.sums, self.count % WINDOW, innovation, move)
        except ZeroDivisionError:  # a strut without length
            self.said = REFUSED
        if self.said == REFUSED:
            raise RigError(f"pose {number}: the commanded lengths {x.round(6).tolist()} m close on no pose, or its covariance is none")
        self.count += 1
        self.recent = [*self.recent[1 - WINDOW :], (before, raw, self.sums[(self.count - 1) % WINDOW].copy())]
        if self.first is not None:
            self.first = [*self.first, raw] if len(self.first) < AGAIN[-1] else None

    def _state(self):
        return self.p.copy(), self.s.copy(), self.S.copy(), self.sums.copy(), self.count, self.recent, self.first

    def _restore(self, state):
        p, s, S, sums, self.count, self.recent, self.first = state
        self.p, self.s, self.S, self.sums = p.copy(), s.copy(), S.copy(), sums.copy()

    def _evidence(self):
        """Evidence of the last 1, 2, .. poses; none where no hypothesis can hold."""
        found = []
        if self.said != ALARM:
            return found
        for poses in range(1, len(self.recent) + 1):
            total = self.sums[(self.count - poses) % WINDOW]
            if round(total[-1]) != poses:
                break
            single = np.array([[own[1:7], own[1 + KINDS : -1 : KINDS + 1][:6]] for _, _, own in self.recent[-poses:]])
            found.append(Evidence(self.recent[-poses][1][0], total[0], total[1 : 1 + KINDS], total[1 + KINDS : -1].reshape(KINDS, KINDS), single))
        return found

    def _open(self, changes, innovation):
        """Go back to before changes, let what jumped move, and learn the poses since anew; what is found then."""
        at = next(k for k in range(1, WINDOW + 1) if self.recent[-k][1][0] == changes[0].onset)
        since = [raw for _, raw, _ in self.recent[-at:]]
        self._restore(self.recent[-at][0])
        for change in changes:
            self._loosen(change)
        self.sums[:], self.recent, self.first = 0, [], None
        for raw in since:
            self._learn(raw, innovation)
        return judge(self._evidence())

    def _loosen(self, change):
        """Process noise along what jumped: x_new = x_old + g w, w ~ N(0, I), in information form."""
        k, c = len(self.S), len(self.s)
        if change.strut is not None:
            i, size = change.strut - 1, max(abs(change.size), 3 * change.sigma)
            g = np.zeros((k, 7))
            g[c + 36 + i, 0] = 3 * size
            for k0, joint in enumerate((c + 3 * i, c + 18 + 3 * i)):
                g[joint + np.arange(3), 1 + 3 * k0 + np.arange(3)] = (3 if change.kind == "joint" else 2) * size
        else:
            g = np.concatenate([np.zeros((c, 6)), gauge(self.hexapod)[:, :6] * 3 * np.abs(change.size)])
        R, r = self.S[:, :k], g.shape[1]
        both = np.linalg.qr(np.block([[np.eye(r), np.zeros((r, k))], [-R @ g, R]]), mode="r")
        self.S[:, :k] = both[r:, r:]

    def _again(self, innovation):
        """All poses so far once more from the prior, linearised about the present estimate; innovation : gets the last one's."""
        k, c, poses = len(self.S), len(self.s), self.first
        self.S[:] = 0
        self.S[:c, :c], self.S[c:, c:k] = np.eye(c), self.root
        self.S[:, k] = np.r_[-self.s, self.root @ (parameters(self.nominal) - self.p)]
        self.sums[:], self.recent, self.first = 0, [], []
        for raw in poses:
            self._learn(raw, innovation, move=False)
        follow(self.p, self.s, self.S)

    def save(self, path):
        """Write the state, whole or not at all: the filter before its last poses, and those."""
        p, s, S, _, _, _, first = self.recent[0][0] if self.recent else self._state()
        tree = {"schema": SCHEMA, "nominal": {"base_joints": self.nominal.base_joints.tolist(), "strut_zeros": self.nominal.strut_zeros.tolist(),
                                              "platform_joints": self.nominal.platform_joints.tolist(), "home": vector(self.nominal.home).tolist(),
                                              "strut_range": self.nominal.strut_range.tolist()},
                "root": self.root.tolist(), "scatter": self.scatter.tolist(), "p": p.tolist(), "s": s.tolist(), "S": S[:, : len(S) + 1].tolist(),
                "number": self.number, "data": sorted(self.data), "recent": [_out(raw) for _, raw, _ in self.recent], "held": [_out(raw) for raw in self.held],
                "first": None if first is None else [_out(raw) for raw in first]}
        write_text(path, json.dumps(tree) + "\n")

    @classmethod
    def load(cls, path):
        """The filter as saved. Raises FileError for a file that is missing, cut off, or none of these: every array's shape is checked, since
        compiled code takes it on trust."""
        tree = json_file.load(path, "state of on-line learning", SCHEMA)
        m, home = tree.table("nominal"), tree.table("nominal").array("home", (6,))
        nominal = Hexapod(m.array("base_joints", (6, 3), length_limit=LARGEST_RIG), m.array("platform_joints", (6, 3), length_limit=LARGEST_RIG),
                          m.array("strut_range", (6, 2), length_limit=LARGEST_RIG), pose(home[:3], home[3:]), m.array("strut_zeros", (6,)))
        s = tree.array("s", (None,))
        if len(s) > MOST_SHARED:
            tree.fail(f"s has {len(s)} draws, more than {MOST_SHARED}", "s")
        made = cls(nominal, len(s), tree.array("scatter", (6,)))
        made.root, made.p, made.s = tree.array("root", (42, 42)), tree.array("p", (42,), length_limit=LARGEST_RIG), s
        made.S[:, : len(made.S) + 1] = tree.array("S", (len(made.S), len(made.S) + 1))
        for key, R in (("root", made.root), ("S", made.S[:, : len(made.S)])):
            if not (np.abs(np.diag(R)) > SINGULAR).all() or np.tril(R, -1).any() and key == "S":
                tree.fail(f"{key} is no triangle with an inverse", key)
        made.first = None if tree.get("first") is None else _in(tree, "first", len(s), AGAIN[-1])
        recent, held = _in(tree, "recent", len(s), WINDOW), _in(tree, "held", len(s), WINDOW)
        made.number = tree.whole("number", 0)
        try:
            for raw in recent:
                made._learn(raw, np.empty(6))
        except RigError as error:
            raise FileError(path, f"is no state of on-line learning: its last poses cannot be learnt again: {error}") from None
        made.held = tuple(held)
        made.data = set(tree.texts("data")) if "data" in tree.tree else set()
        return made


def _out(raw):
    return [raw[0], *[part.tolist() for part in raw[1:]]]


def _in(tree, key, shared, most):
    """[raw pose] of what `_out` wrote, at most so many."""
    rows = tree.lists(key, 6)
    if len(rows) > most:
        tree.fail(f"{key} has {len(rows)} poses, more than {most}", key)
    return [(row.whole(0, 0), row.array(1, (6,)), row.array(2, (3, 3)), row.array(3, (3,)), row.array(4, (6, 6)), row.array(5, (6, shared)))
            for row in rows]
