"""Compiled kernels of hexapod kinematics.

Strut lengths of poses, and poses of strut lengths by Newton.

Newton on the pose as in `hexapod`, with a unit quaternion for the turn and the rows eliminated in one order for all,
chosen at the start:
what that order does not suit does not settle, is told by its residual and left to who calls. Each lane stands still
once it has settled, so that a pose comes out the same to the last bit whatever stands beside it. Source: Merlet,
Parallel Robots, 2nd ed., ch. 3 and 4
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from rig.array_and_json_types import Floats
from rig.compute.numba_compilation_and_kernel_cache_folder import njit
from rig.compute.worker_processes import worker_count

WIDTH = 8  # lanes: doubles of a 512-bit register, two registers of 256 bits
EACH = 8192  # poses for each thread, below which it is not worth starting any
STEPS = 20  # at most; from where a guess is good it takes 4 or 5


class StrutGeometry(NamedTuple):
    """base, platform : (6, 3) m, joints; order : (6,) of the struts' elimination; reach : m, longest single step;
    turn : rad, likewise.
    """

    base: Floats
    platform: Floats
    order: Floats
    reach: float
    turn: float


def run_kernel_in_threads(kernel: Callable[[slice], None], count: int, items_per_thread: int = EACH) -> None:
    """Run a kernel in threads over slices of `count` items.

    Threads are on all cores (OMP_NUM_THREADS at most).
    """
    threads = min(worker_count(), count // items_per_thread)
    if threads < 2:
        kernel(slice(0, count))
        return
    edges = np.linspace(0, count, threads + 1).astype(int) // WIDTH * WIDTH
    edges[-1] = count
    with ThreadPoolExecutor(threads) as pool:
        for done in [
            pool.submit(kernel, slice(low, high)) for low, high in zip(edges[:-1].tolist(), edges[1:].tolist())
        ]:
            done.result()


@njit(cache=True, nogil=True, error_model="numpy")
def fill_strut_lengths_of_poses(matrices: Floats, base: Floats, platform: Floats, zeros: Floats, out: Floats) -> None:
    """Fill `out` (n, struts) m with the commanded strut lengths of poses, matrices (n, 4, 4)."""
    for n in range(len(matrices)):
        for i in range(len(base)):
            total = 0.0
            for k in range(3):
                s = matrices[n, k, 3] - base[i, k]
                for j in range(3):
                    s += matrices[n, k, j] * platform[i, j]
                total += s * s
            out[n, i] = np.sqrt(total) - zeros[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _loops(R: Floats, t: Floats, wanted: Floats, struts: StrutGeometry, M: Floats, worst: Floats) -> None:
    """Into M (6, 7, lanes) the Jacobian's rows and what each strut lacks, in the elimination's order; into worst
    (lanes,) the largest lack.
    """
    for v in range(WIDTH):
        worst[v] = 0.0
    for i in range(6):
        s = struts.order[i]
        ax, ay, az = struts.platform[s, 0], struts.platform[s, 1], struts.platform[s, 2]
        bx, by, bz = struts.base[s, 0], struts.base[s, 1], struts.base[s, 2]
        for v in range(WIDTH):
            x = R[0, v] * ax + R[1, v] * ay + R[2, v] * az + t[0, v] - bx
            y = R[3, v] * ax + R[4, v] * ay + R[5, v] * az + t[1, v] - by
            z = R[6, v] * ax + R[7, v] * ay + R[8, v] * az + t[2, v] - bz
            length = np.sqrt(x * x + y * y + z * z)
            x, y, z = x / length, y / length, z / length
            ux = R[0, v] * x + R[3, v] * y + R[6, v] * z
            uy = R[1, v] * x + R[4, v] * y + R[7, v] * z
            uz = R[2, v] * x + R[5, v] * y + R[8, v] * z
            M[i, 0, v], M[i, 1, v], M[i, 2, v] = ux, uy, uz
            M[i, 3, v], M[i, 4, v], M[i, 5, v] = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
            M[i, 6, v] = wanted[s, v] - length
            worst[v] = max(worst[v], abs(M[i, 6, v]))


@njit(cache=True, nogil=True, error_model="numpy")
def _eliminate(M: Floats, factor: Floats, determinant: Floats) -> None:
    """M (6, 7, lanes) becomes upper triangular with a unit diagonal; its determinants into determinant (lanes,)."""
    for v in range(WIDTH):
        determinant[v] = 1.0
    for j in range(6):
        for v in range(WIDTH):
            determinant[v] *= M[j, j, v]
            factor[v] = 1.0 / M[j, j, v]
        for k in range(j + 1, 7):
            for v in range(WIDTH):
                M[j, k, v] *= factor[v]
        for i in range(j + 1, 6):
            for v in range(WIDTH):
                factor[v] = M[i, j, v]
            for k in range(j + 1, 7):
                for v in range(WIDTH):
                    M[i, k, v] -= factor[v] * M[j, k, v]


@njit(cache=True, nogil=True, error_model="numpy")
def _rotations(q: Floats, R: Floats) -> None:
    """Rotation matrices into R (9, lanes) of unit quaternions q (4, lanes), the real part first."""
    for v in range(WIDTH):
        w, x, y, z = q[0, v], q[1, v], q[2, v], q[3, v]
        R[0, v], R[1, v], R[2, v] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
        R[3, v], R[4, v], R[5, v] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
        R[6, v], R[7, v], R[8, v] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@njit(cache=True, nogil=True, error_model="numpy")
def _step(q: Floats, t: Floats, R: Floats, M: Floats, limits: tuple[float, float, float], worst: Floats) -> None:
    """Move poses q (4, lanes), t (3, lanes) by the step that M leads to where they have not settled; limits : (reach,
    turn, tolerance).
    """
    for j in range(5, 0, -1):
        for i in range(j):
            for v in range(WIDTH):
                M[i, 6, v] -= M[i, j, v] * M[j, 6, v]
    for v in range(WIDTH):
        going = not worst[v] < limits[2]
        x, y, z, rx, ry, rz = M[0, 6, v], M[1, 6, v], M[2, 6, v], M[3, 6, v], M[4, 6, v], M[5, 6, v]
        move, turn = np.sqrt(x * x + y * y + z * z), np.sqrt(rx * rx + ry * ry + rz * rz)
        share = 1.0 / max(1.0, max(turn / limits[1], move / limits[0]))
        if going:
            t[0, v] += share * (R[0, v] * x + R[1, v] * y + R[2, v] * z)
            t[1, v] += share * (R[3, v] * x + R[4, v] * y + R[5, v] * z)
            t[2, v] += share * (R[6, v] * x + R[7, v] * y + R[8, v] * z)
        rx, ry, rz = 0.5 * share * rx, 0.5 * share * ry, 0.5 * share * rz
        q0, q1, q2, q3 = q[0, v], q[1, v], q[2, v], q[3, v]
        a, b = q0 - q1 * rx - q2 * ry - q3 * rz, q1 + q0 * rx + q2 * rz - q3 * ry
        c, d = q2 + q0 * ry + q3 * rx - q1 * rz, q3 + q0 * rz + q1 * ry - q2 * rx
        size = np.sqrt(a * a + b * b + c * c + d * d)
        if going:
            q[0, v], q[1, v], q[2, v], q[3, v] = a / size, b / size, c / size, d / size


@njit(cache=True, nogil=True, error_model="numpy")
def fill_poses_of_strut_lengths_by_newton(
    wanted_lengths: Floats,
    struts: StrutGeometry,
    start: tuple[Floats, Floats],
    tolerance: float,
    matrices: Floats,
    residual: Floats,
    singularity_crossed: Floats,
) -> None:
    """Fill `matrices` (n, 4, 4) with the poses of strut lengths (n, 6) m, by Newton from a start.

    Lengths include the zeros.
    start : quaternions (n or 1, 4), real part first, and positions (n or 1, 3) m; tolerance : m, of a strut
    residual : (n,) m, filled with what is left; singularity_crossed : (n,) bool, whether the Jacobian's determinant
        changed its sign on the way
    """
    n = len(wanted_lengths)
    M, q, t, R, aim = (
        np.empty((6, 7, WIDTH)),
        np.empty((4, WIDTH)),
        np.empty((3, WIDTH)),
        np.empty((9, WIDTH)),
        np.empty((6, WIDTH)),
    )
    factor, worst, side, before = np.empty(WIDTH), np.empty(WIDTH), np.empty(WIDTH), np.empty(WIDTH)
    one = len(start[0]) == 1
    for at in range(0, n, WIDTH):
        count = min(WIDTH, n - at)
        for v in range(WIDTH):
            k = at + min(v, count - 1)
            for i in range(6):
                aim[i, v] = wanted_lengths[k, i]
            for i in range(4):
                q[i, v] = start[0][0 if one else k, i]
            for i in range(3):
                t[i, v] = start[1][0 if one else k, i]
        for step in range(STEPS + 1):
            _rotations(q, R)
            _loops(R, t, aim, struts, M, worst)
            settled = True
            for v in range(WIDTH):
                settled &= worst[v] < tolerance
            _eliminate(M, factor, side)
            if step == 0:
                before[:] = side
            if settled or step == STEPS:
                break
            _step(q, t, R, M, (struts.reach, struts.turn, tolerance), worst)
        for v in range(count):
            k = at + v
            residual[k], singularity_crossed[k] = worst[v], not side[v] * before[v] > 0.0
            for i in range(3):
                matrices[k, 3, i] = 0.0
                matrices[k, i, 3] = t[i, v]
                for j in range(3):
                    matrices[k, i, j] = R[3 * i + j, v]
            matrices[k, 3, 3] = 1.0
