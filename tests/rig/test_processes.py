"""How many processes there may be."""

import os

from rig.processes import cores


def test_cores_are_limited_as_threads_are(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert cores() == 1
    monkeypatch.setenv("OMP_NUM_THREADS", "4,2")  # of nested threads, which there are none of here
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(3)), raising=False)
    assert cores() == 3
