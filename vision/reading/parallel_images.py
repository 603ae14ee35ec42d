"""Work on many images at the same time: by threads of this process, or by other processes and clusters."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import cv2

from rig.compute.parallel_map import parallel_map
from rig.compute.worker_processes import executor_map, worker_count

EACH = 2  # images for each process, below which it is not worth starting any

Item = TypeVar("Item")
Result = TypeVar("Result")


def map_images_in_threads(
    one: Callable[[Item], Result], work: Sequence[Item], progress: Callable[..., None] | None
) -> list[Result]:
    """What comes of each item of some work on images, in order, by threads: few items, or that share images.
    progress : called with (done, of)
    """
    with _one_thread_each(), ThreadPoolExecutor(worker_count()) as pool:
        return executor_map(pool, one, work, progress)


def map_images_in_processes(
    one: Callable[[Item], Result], work: Sequence[Item], progress: Callable[..., None] | None
) -> list[Result]:
    """The same by processes, or by a cluster: many items that each read an image of their own. What `one` changes
    elsewhere is lost.
    """

    def alone(item: Item) -> Result:
        cv2.setNumThreads(1)
        return one(item)

    with _one_thread_each():
        return parallel_map(alone, work, progress, items_per_process=EACH, on_cluster=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Within it OpenCV shares no image among threads: images are what is done at the same time."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
