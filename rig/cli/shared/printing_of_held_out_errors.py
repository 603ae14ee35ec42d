"""Printing of held-out errors, and of frames without a pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calib.certification.held_out_errors import HeldOut
    from vision.recording_adjustment import Measurement


def print_held_out_errors(held_out: HeldOut, title: str) -> None:
    """Print held-out errors before and after correction as a table in mm and mrad."""
    from calib.certification.calibration_dataclass_and_claim_sentences import ratio_interval_text

    names = ("mean", "RMS", "95 %", "max")
    print(f"{title}, N = {held_out.after.n}, {held_out.configurations} distinct configurations:")
    print(f"{'':14}{'position, mm':>40}{'rotation, mrad':>43}")
    print(f"{'':14}" + "".join(f"{name:>10}" for name in names) + "   " + "".join(f"{name:>10}" for name in names))
    for name, figures in (("nominal model", held_out.before), ("corrected", held_out.after)):
        position, rotation = (figures.mean[0], *figures.position), (figures.mean[1], *figures.rotation)
        print(f"{name:14}" + "".join(map(_cell, position)) + "   " + "".join(map(_cell, rotation)))
    turned = "; rotations were not measured"
    if held_out.floor[1] < 1:
        turned = f" and {held_out.floor[1] * 1e3:.4f} mrad" if held_out.floor[1] else "; it does not turn"
    placed = f"{held_out.floor[0] * 1e3:.4f} mm" if held_out.floor[0] < 1 else ""
    words = f"{placed}{turned}" if placed else f"{turned.removeprefix(' and ')}; positions were not measured"
    print(
        f"on these poses {ratio_interval_text(held_out.ratio)}; the measured poses themselves are uncertain by {words}"
    )


def _cell(value: float) -> str:
    return f"{value * 1e3:10.4f}" if value == value else f"{'-':>10}"


def print_frames_without_pose(measurement: Measurement | None) -> None:
    """Print the frames without a pose of a Measurement, with their reasons."""
    if measurement is None or not measurement.unsolved:
        return
    print(f"{len(measurement.unsolved)} frames without a pose:")
    for frame, reason in sorted(measurement.unsolved.items())[:20]:
        print(f"  frame {frame}: {reason}")
    if len(measurement.unsolved) > 20:
        print(f"  and {len(measurement.unsolved) - 20} more")
