"""What a campaign of truth says, cell by cell: shares with the interval of Clopper and Pearson."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.stats import beta

SMALL = 20  # machines; cells of one effect, or of one way and strength, that have fewer are not told apart
WRONG = 1.5  # times the claim's upper end, beyond which a calibration that says good is wrong


def share(count: int, of: int) -> list[float]:
    """[share, low, high] of count of so many, 95 % between (Clopper and Pearson, Biometrika 26, 1934); of none NaN."""
    if not of:
        return [float("nan")] * 3
    low = float(beta.ppf(0.025, count, of - count + 1)) if count else 0.0
    high = float(beta.ppf(0.975, count + 1, of - count)) if count < of else 1.0
    return [round(x, 4) for x in (count / of, low, high)]


def figures(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures of machines that made a claim: how often its interval covers the truth in position and rotation, whether
    from above or below, how many say good and are wrong, how many of the wanted poses lie within their 95 % ellipsoids,
    and how the claim's middle compares with the truth."""
    claims = [line for line in lines if "claim" in line]
    good = [line for line in claims if line["state"] == "good"]
    posed = [line["ellipsoids"] for line in claims if line.get("ellipsoids")]
    count = sum(each[2] for each in posed)
    ratio = np.array([line["true"] / line["claim"][0] for line in claims if line["claim"][0] > 0])
    return {
        "n": len(claims),
        "refused": len(lines) - len(claims),
        "covered": share(sum(line["covered"] for line in claims), len(claims)),
        "covered_rotation": share(sum(line["covered_rotation"] for line in claims), len(claims)),
        "above": sum(line["true"] > line["claim"][2] for line in claims),
        "below": sum(line["true"] < line["claim"][1] for line in claims),
        "good": len(good),
        "wrongly_good": sum(line["true"] > WRONG * line["claim"][2] for line in good),
        "beyond": sum(line["true"] > WRONG * line["claim"][2] for line in claims),
        "ellipsoids": [round(sum(each[k] for each in posed) / count, 4) for k in range(2)] if count else None,
        "poses": count,
        "true_over_claim": [round(float(x), 3) for x in np.quantile(ratio, (0.5, 0.1, 0.9))] if len(ratio) else None,
    }


def summary(lines: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """{cell: figures}: all, and by way, strength, plan, effect and way with strength."""
    cells: dict[str, Callable[[dict[str, Any]], str]] = {
        "way": lambda x: x["way"],
        "strength": lambda x: x["strength"],
        "plan": lambda x: x["plan"],
        "effect": lambda x: x["effect"],
        "way, strength": lambda x: f"{x['way']}, {x['strength']}",
    }
    out = {"all": figures(lines)}
    for name, of in cells.items():
        for value in sorted({of(line) for line in lines}):
            out[f"{name}: {value}"] = figures([line for line in lines if of(line) == value])
    return out


def figures_in_words(lines: list[dict[str, Any]]) -> list[tuple[str, str, str]]:
    """(figure, reached, wanted) of every cell."""
    out = []
    for cell, found in summary(lines).items():
        if cell.partition(":")[0] in ("effect", "way, strength") and found["n"] < SMALL:
            continue
        if not found["n"]:
            out.append((f"{cell}: machines without a claim", str(found["refused"]), ""))
            continue
        held, low, high = found["covered"]
        out.append(
            (
                f"{cell}: 95 % intervals that cover the true position error; good where it exceeds 1.5 times "
                "the upper end",
                f"{held:.1%} ({low:.1%} to {high:.1%}) of {found['n']}, {found['above']} above, "
                f"{found['below']} below; "
                f"{found['wrongly_good']} of {found['good']} good, "
                f"{found['beyond'] - found['wrongly_good']} of {found['n'] - found['good']} others",
                "93 to 98 %; 0 good" if found["n"] >= 40 else "0 good",
            )
        )
        if cell == "all" or cell.startswith("way: "):
            middle, low, high = found["true_over_claim"] or (float("nan"),) * 3
            out.append(
                (
                    f"{cell}: rotation covered; true position error over the claim's middle, median and 80 % between",
                    f"{found['covered_rotation'][0]:.1%}; {middle:.2f} ({low:.2f} to {high:.2f})",
                    "",
                )
            )
            if found["ellipsoids"]:
                out.append(
                    (
                        f"{cell}: poses within their 95 % ellipsoids, whole and position",
                        "{:.1%}, {:.1%}".format(*found["ellipsoids"]) + f" of {found['poses']}",
                        "93 to 97 %",
                    )
                )
            if found["refused"]:
                out.append((f"{cell}: machines without a claim", str(found["refused"]), ""))
    return out
