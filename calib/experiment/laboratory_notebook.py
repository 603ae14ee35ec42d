"""An investigation's looks -> a laboratory notebook: what was thought with odds, what was tried at which chance, what
it showed, what was dropped.
"""

from collections.abc import Sequence

from calib.experiment.investigation_folder import Look, Proposed


def notebook_text(rig: str, looks: Sequence[Look], budget: float, ended: str, after: Sequence[str]) -> str:
    """Markdown of an investigation. rig : its name; budget : min; ended : why it ended, "" while it goes on;
    after : what was done at the end
    """
    out = [
        f"# What is the matter with {rig}",
        "",
        f"A budget of {budget:.0f} min of the rig's time; {minutes_spent(looks):.1f} min were taken so far.",
        "",
    ]
    for before, look in zip((None, *looks), looks):
        out += [*_tried(before, look), *_seen(before, look), ""]
    if ended:
        out += ["## The end", "", f"{ended[0].upper()}{ended[1:]}.", ""]
    return "\n".join(out + [f"- {line}" for line in after]).rstrip() + "\n"


def minutes_spent(looks: Sequence[Look]) -> float:
    """min that all recordings so far took."""
    return sum(look.minutes for look in looks)


def next_experiment(look: Look) -> Proposed | None:
    """The experiment that follows a look, None where none would tell."""
    return look.proposed[0] if look.proposed else None


def _tried(before: Look | None, look: Look) -> list[str]:
    out = [f"## {look.number}. {look.recording}, {look.minutes:.1f} min", ""]
    experiment = next_experiment(before) if before is not None else None
    if experiment is None:
        return [*out, "Tried: the first plan, to see what there is.", ""]
    out += [
        f"Tried: {experiment.plan}, {experiment.exposures} exposures; it was to settle the question with a "
        f"chance of {experiment.settles:.0%} "
        f"and to tell {experiment.bits:.2f} bits.",
        "",
    ]
    return out + [f"- the operator was asked, {text}" for text in experiment.asks] + ([""] if experiment.asks else [])


def _seen(before: Look | None, look: Look) -> list[str]:
    out = [f"- alone: {title}" for title in look.alone]
    for question in look.questions:
        out.append("- alike: " + "; ".join(f"{h.title} {h.odds:.2f}" for h in question))
    out += [f"- cannot be foretold: {text}" for text in look.unasked]
    out += [f"- {text}, in no catalogue" for text in look.unknown]
    if not out:
        out = ["- nothing is left out: recordings and model agree within the noise"]
    if before is not None:
        dropped = [title for title, odds in before.odds.items() if title not in look.odds and odds > 0]
        out += [
            f"- dropped: {title} (odds before {before.odds[title]:.2f}); with {look.recording} it explains "
            "less than 1 in 20 of what is left, "
            "or nothing"
            for title in dropped
        ]
        out += [f"- settled: {'no' if look.questions else 'yes'}"] if before.questions else []
    return ["Seen, of all recordings together:", "", *out]
