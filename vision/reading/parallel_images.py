"""Parallel maps over images: by threads, by processes, or by a cluster."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import cv2

from rig.compute.parallel_map_and_dask_cluster import parallel_map
from rig.compute.worker_processes import executor_map, worker_count

EACH = 2  # images for each process, below which it is not worth starting any

Item = TypeVar("Item")
Result = TypeVar("Result")


def map_images_in_threads(
    function: Callable[[Item], Result], items: Sequence[Item], progress: Callable[..., None] | None
) -> list[Result]:
    """Map a function over images in threads, results in order: for few items, or shared images.
    progress : called with (done, of)
    """
    with _one_thread_each(), ThreadPoolExecutor(worker_count()) as pool:
        return executor_map(pool, function, items, progress)


def map_images_in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], progress: Callable[..., None] | None
) -> list[Result]:
    """Map a function over images in processes or on a cluster, results in order: for many items.
    Each item reads an image of its own; what `function` changes elsewhere is lost.
    """

    def alone(item: Item) -> Result:
        cv2.setNumThreads(1)
        return function(item)

    with _one_thread_each():
        return parallel_map(alone, items, progress, items_per_process=EACH, on_cluster=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Within it OpenCV shares no image among threads: images are what is done at the same time."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
