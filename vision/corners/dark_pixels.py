"""Pixels that are darker than the mean of what is around them, by windows of three sizes; one pass over the image each.

Source: adaptive thresholds in three windows, as OpenCV's ArUco reader takes them, Garrido-Jurado et al., Pattern
    Recognition 47, 2014
"""

import numpy as np

from vision.corners.numba_compilation import kernel, kernel_part

WINDOWS = (3, 13, 23)  # px, odd
BY = 7  # grey levels, by which the mean, rounded, has to be brighter
LEFT = 1  # columns and rows of zeros before the image's own


@kernel
def mark_dark_pixels(image: np.ndarray, window: int, out: np.ndarray) -> None:
    """out (height + 2, width + 2 or more) uint8, at LEFT rows and columns off: 1 where a pixel of an image (height,
    width) uint8 is darker, else 0.

    window : px, of WINDOWS. The image goes on beyond its border as it is there. out : zeros beyond the image's own
        pixels
    """
    height, width = image.shape
    r, room = window // 2, np.uintp(width + window)
    sums = np.zeros((3, room), np.uint16)  # down the window's rows; these over two columns, and over four
    one = sums[0]
    for k in range(-r, r + 1):
        row = image[min(max(k, 0), height - 1)]
        for x in range(np.uintp(width)):
            one[x + np.uintp(r)] += row[x]
    for y in range(height):
        if y > 0:
            fresh, gone = image[min(y + r, height - 1)], image[max(y - r - 1, 0)]
            for x in range(np.uintp(width)):
                one[x + np.uintp(r)] += np.uint16(fresh[x]) - np.uint16(gone[x])
        for k in range(r):
            one[k], one[r + width + k] = one[r], one[r + width - 1]
        _compare(image[y], sums, window, out[y + LEFT])


@kernel_part
def _compare(row: np.ndarray, sums: np.ndarray, window: int, out: np.ndarray) -> None:
    """out (width + 2 or more): which pixels of an image row are darker, by sums (3, width + window); sums of two and
    four columns are overwritten.
    """
    one, two, four, width = sums[0], sums[1], sums[2], np.uintp(len(row))
    x1, x2, x4, x8, x12, x16 = np.uintp(1), np.uintp(2), np.uintp(4), np.uintp(8), np.uintp(12), np.uintp(16)
    area = window * window
    more = (area * (2 * BY - 1)) // 2  # the mean is rounded: what is brighter by half a level less does
    for x in range(width + np.uintp(window - 1)):
        two[x] = one[x] + one[x + x1]
    if window > 3:
        for x in range(width + np.uintp(window - 4)):
            four[x] = two[x] + two[x + x2]
    if window == 3:
        for x in range(width):
            out[x + x1] = np.uint16(two[x] + one[x + x2]) > np.uint16(area * row[x] + more)
    elif window == 13:
        for x in range(width):
            out[x + x1] = np.uint16(four[x] + four[x + x4] + four[x + x8] + one[x + x12]) > np.uint16(
                area * row[x] + more
            )
    else:
        for x in range(width):
            total = (
                np.int32(four[x])
                + np.int32(four[x + x4])
                + np.int32(four[x + x8])
                + np.int32(four[x + x12])
                + np.int32(four[x + x16])
            )
            total += np.int32(two[x + np.uintp(20)]) + np.int32(one[x + np.uintp(22)])
            out[x + x1] = np.int32(total) > np.int32(area * row[x] + more)
