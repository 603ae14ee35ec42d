"""Captions of the residual figures of a diagnosis.

They say what is drawn, in which unit, and how good and bad ones look.
"""

DOTS = (
    "Small dots are residuals, large ones means of equal numbers of them with their 95 % interval; units stand at the "
    "axes. Without it: the best fit of the calibration alone, which absorbs part of it. Good: with it, the means lie "
    "at 0; against what it explains, they follow the line. Bad: a pattern remains."
)
IN_TIME = (
    "Dots are residuals over time (min), the line their running mean. Good: a line at 0. Bad: a drift or a step; "
    "something unknown changes with time."
)
BARS = (
    "RMS residual (px), without the finding and with it; in bold: its place. Good: with it, the bold bar is as short "
    "as the others. Bad: it stays longer."
)
MAP = (
    "Arrows: mean residual over patches of the image, enlarged; the longest is stated in px. Good: with the finding, "
    "short arrows in all directions. Bad: a pattern remains."
)
