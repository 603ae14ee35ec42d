"""Compiled kinematics: the same bits whatever stands beside a pose and however many threads, and every pose that pivots
solve.
"""

import numpy as np

from rig.model.mechanisms import hexapod, hexapod_kernels
from rig.planning.configuration_generators import sobol_configurations
from tests.calib.random_hexapods import machine


def test_a_pose_comes_out_the_same_to_the_last_bit_whatever_stands_beside_it(design, monkeypatch):
    commands = sobol_configurations(design.mechanism.strut_range, 300, 0.95)
    together = hexapod.forward(commands, design.mechanism).as_matrix()
    alone = np.stack([hexapod.forward(one, design.mechanism).as_matrix() for one in commands[:40]])
    assert (together[:40] == alone).all() and (
        hexapod.forward(commands[37:90], design.mechanism).as_matrix() == together[37:90]
    ).all()
    monkeypatch.setattr(hexapod_kernels, "worker_count", lambda: 3)
    parts = []
    hexapod_kernels.run_kernel_in_threads(parts.append, 100, 10)
    assert len(parts) == 3 and sorted(k for part in parts for k in range(100)[part]) == list(range(100))
    many = np.tile(commands, (100, 1))
    assert (hexapod.forward(many, design.mechanism).as_matrix().reshape(100, 300, 4, 4) == together).all()


def test_random_machines_are_solved_as_pivots_solve_them():
    rng = np.random.default_rng(3)
    for _ in range(40):
        m, T = machine(rng)
        lengths = hexapod.inverse(T, m)
        found = hexapod.forward(lengths, m, T)
        np.testing.assert_allclose(found.as_matrix(), T.as_matrix(), atol=1e-9)
        matrix = T.as_matrix()
        plain = (
            np.linalg.norm(m.platform_joints @ matrix[:3, :3].T + matrix[:3, 3] - m.base_joints, axis=1) - m.strut_zeros
        )
        np.testing.assert_allclose(lengths, plain, atol=1e-15)
