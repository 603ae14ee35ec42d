"""Secret machines, and what their owners believe of them: the same drawing with joints and zeros that are off."""

from dataclasses import replace

import numpy as np

from tests.truth.kinematics import Arm, Chain, Hinge, Machine, SixStruts
from tests.truth.rigid import matrices

KINDS = ("hexapod", "planar2", "arm", "chain")


def nominal(kind: str, rng: np.random.Generator) -> Machine:
    """A machine of a kind as drawn by its owner. Raises ValueError for a kind that is not known."""
    if kind == "hexapod":
        return _six_struts(rng)
    if kind == "planar2":
        base = np.array([[0.0, 0.0], [0.5 * rng.uniform(0.8, 1.2), 0.0]])
        mid = rng.uniform(0.4, 0.5, 2)
        return Hinge(base, np.zeros(2), np.stack([mid - 0.06, mid + 0.06], axis=1))
    if kind == "arm":
        return _six_joints(rng)
    if kind == "chain":
        slide = Arm(
            np.array([[0.0, 0.0, 0.0, 0.0]]), np.array([True]), np.zeros(1), np.array([[-0.1, 0.1]]), np.zeros(1)
        )
        return Chain((slide, _six_struts(rng)))
    raise ValueError(f"no kind {kind!r}; there are {', '.join(KINDS)}")


def _six_struts(rng: np.random.Generator) -> SixStruts:
    radius, ratio, height = rng.uniform(0.2, 0.35), rng.uniform(0.55, 0.75), rng.uniform(1.3, 1.7)
    apart = np.array([-1, 1, -1, 1, -1, 1])
    thirds = np.repeat(np.arange(3), 2) * 2 * np.pi / 3
    below = thirds + apart * rng.uniform(0.15, 0.3)
    above = thirds + apart * (np.pi / 3 - rng.uniform(0.15, 0.3))
    base = radius * np.stack([np.cos(below), np.sin(below), np.zeros(6)], axis=1)
    plate = radius * ratio * np.stack([np.cos(above), np.sin(above), np.zeros(6)], axis=1)
    machine = SixStruts(base, plate, np.zeros(6), np.zeros((6, 2)), radius * height)
    mid = machine.inverse(matrices(np.array([[0, 0, machine.height, 0, 0, 0]])))[0]
    half = 0.17 * radius
    return replace(machine, ranges=np.stack([mid - half, mid + half], axis=1))


def _six_joints(rng: np.random.Generator) -> Arm:
    reach = rng.uniform(0.35, 0.5)
    right = np.pi / 2
    rows = np.array(
        [
            [0, 0.4, 0.05, -right],
            [-right, 0, reach, 0],
            [0, 0, 0.05, -right],
            [0, 0.9 * reach, 0, right],
            [0, 0, 0, -right],
            [0, 0.1, 0, 0],
        ]
    )
    mid = np.array([0, 0.3, 0.4, 0.2, 0.8, 0.0])
    return Arm(rows, np.zeros(6, bool), np.zeros(6), np.stack([mid - 0.8, mid + 0.8], axis=1), np.zeros(6))


def secret(machine: Machine, size: float, rng: np.random.Generator) -> Machine:
    """The machine as built: its figures off by normal errors of size m (angles: size over 0.3 m)."""

    def off(shape: tuple[int, ...]) -> np.ndarray:
        return rng.normal(0, size, shape)

    if isinstance(machine, SixStruts):
        return replace(machine, base=machine.base + off((6, 3)), plate=machine.plate + off((6, 3)), zeros=off((6,)))
    if isinstance(machine, Hinge):
        return replace(machine, base=machine.base + off((2, 2)), zeros=off((2,)))
    if isinstance(machine, Chain):
        return Chain(tuple(secret(stage, size, rng) for stage in machine.stages))
    lengths, angles = off((machine.width, 2)), off((machine.width, 2)) / 0.3
    zeros = np.where(machine.slides, off((machine.width,)), off((machine.width,)) / 0.3)
    return replace(
        machine,
        rows=machine.rows + np.stack([0 * zeros, lengths[:, 0], lengths[:, 1], angles[:, 0]], axis=1),
        zeros=zeros,
        tilts=angles[:, 1],
    )
