"""Names, groups and summaries of commands, and exit statuses.

Names, groups and one line on each; earlier names and what they are now.
"""

GROUPS = {
    "prepare": {
        "new": "A rig.toml from four questions, or from options when not interactive.",
        "new design": "A sensible rig.toml from a radius or an arm's name: cubes and cameras placed.",
        "import": "A recording from existing files: folders of images, tables in any dialect, units and clocks; and a "
        "recipe of it.",
        "check": "All errors and implausible values of a recording, at once, with remedies.",
        "lens": "Photographs of a board -> one camera's lens: models compared, a [[camera]] block.",
        "print": "The cubes of a rig.toml as nets to print, true to scale.",
        "print check": "A photograph of a printed sheet -> the true side of its markers.",
        "plan": "Which configurations to visit so that the parameters are observable.",
    },
    "measure": {
        "measure": "Images or corners of a recording -> platform poses with covariance, cameras adjusted.",
        "view": "One frame of a recording with markers, axes and residuals drawn in; or all of it in three dimensions, "
        "as a page or for Rerun.",
        "view index": "One page of all pages below a folder, each with its verdict.",
        "limbs test": "Measuring limbs tested against vision; once they pass, saved to replace it.",
        "limbs closures": "More lengths than six: which six give the pose, and closure errors of the others.",
    },
    "calibrate": {
        "calibrate": "A recording -> calibration.json: geometry and corrections, with held-out figures.",
        "calibrate online": "A recording's poses learnt one at a time: the current estimate of the machine, and sudden "
        "changes.",
        "correct": "Wanted poses -> the strut lengths to command for them.",
        "correct serve": "The same to other programs of this computer: JSON lines over a loopback port.",
        "workspace": "What a calibration does to the workspace: lost, gained, room to limits, singularities, error "
        "bounds.",
    },
    "trust": {
        "why": "Data and a model, as a CSV and a URDF -> five lines: how wrong, why, how sure, what to do, what to "
        "measure next.",
        "verify": "A calibration verified by a recording not used for it: error before and after.",
        "certify": "What a calibration promises of all poses in a volume, from recordings held out: a certificate.",
        "watch": "Small visits compared with a calibration day by day: whether it still holds, what changed, what to "
        "remeasure.",
        "diagnose": "A recording -> its unmodelled effects: where, which, how large, and the evidence.",
        "investigate": "Automatic investigation: plan, diagnosis, the most informative experiment, repeated, up to a "
        "certificate.",
        "effects": "The known unmodelled effects: place, parameters, experiment that exposes them, remedy.",
        "effects document": "The known unmodelled effects, as a document: model, parameters, experiment and remedy of "
        "each.",
    },
    "drive": {
        "run": "A plan executed on the real machine: moved, settled, grabbed, journalled, measured during the run.",
        "go": "The platform sent to one pose through a calibration: corrected lengths or joint values, checked.",
        "jog": "Struts moved a little, checked as any move.",
        "home": "All struts homed.",
        "stop": "The struts stopped now, and any process that moves them.",
        "status": "The status of the controller; nothing moves.",
    },
    "simulate": {
        "simulate": "A simulated rig under a plan -> a recording, and its truth separately.",
        "simulate blind": "Blind cases of the diagnosis on simulated rigs, and their score.",
        "emulate": "An emulated controller, at a pseudo-terminal or over TCP, with faults on request.",
    },
    "tools": {
        "arm kinematics": "An arm's or a platform's poses of axis values, or all axis values of poses, step by step.",
        "arm posture": "A redundant arm's posture for sensing or exerting force, with the hand fixed.",
        "arm wrench": "The wrench on an arm's hand, from its joints' torques or motor currents: force and moment with "
        "covariance.",
        "export": "A calibrated geometry for other programs: genhexkins, URDF, JSON, CSV.",
        "doctor": "Requirements of rig on this computer: packages, OpenGL, cameras, ports, space, threads.",
        "doctor kernels": "Compile ahead what `rig run` and `rig measure` would compile, once after an installation.",
        "doctor completion": "The script that makes bash, zsh or fish complete rig's commands and options.",
    },
}
COMMANDS = {name: text for group in GROUPS.values() for name, text in group.items()}
BAD_VERDICT = (3, "the verdict is bad")
STATUSES = {
    "check": (1, "results from the recording would mean nothing"),
    "doctor": (1, "something is missing that every installation needs"),
    "limbs test": (1, "a limb is not accepted"),
    "limbs closures": (1, "a closure error exceeds what errors and geometry allow"),
    **dict.fromkeys(("verify", "certify", "watch", "why"), BAD_VERDICT),
}  # {command: its exit status where it is done and its answer is no, and what that means}
FAMILIES = {name.split()[0] for name in COMMANDS if " " in name}  # first words of commands of two words
SHARED_FILES = {
    "limbs test": "limbs_test_and_closures",
    "limbs closures": "limbs_test_and_closures",
    "doctor completion": "doctor",
    "doctor kernels": "doctor",
    "effects document": "effects",
    "view index": "view",
    "print check": "print",
    "new design": "new",
    "correct serve": "correct",
    "calibrate online": "calibrate",
    **dict.fromkeys(("home", "jog", "stop", "status"), "home_jog_stop_status"),
}  # {command: its file in rig/cli, where several stand in one: its functions end with its last word}
EARLIER_NAMES = {
    "blind": "simulate blind",
    "catalogue": "effects document",
    "check-print": "print check",
    "closure": "limbs closures",
    "completion": "doctor completion",
    "design": "new design",
    "index": "view index",
    "insitu": "limbs test",
    "kinematics": "arm kinematics",
    "online": "calibrate online",
    "posture": "arm posture",
    "wrench": "arm wrench",
}


def exit_status_meanings() -> dict[str, str]:
    """Meanings of all exit statuses: {"0": "done", ..}."""
    answers = [
        f"{' and '.join(f'`rig {name}`' for name, one in STATUSES.items() if one == answer)}: {answer[1]}"
        for answer in dict.fromkeys(STATUSES.values())
        if answer[0] == 1
    ]
    judges = [f"`rig {name}`" for name, answer in STATUSES.items() if answer == BAD_VERDICT]
    return {
        "0": "done",
        "1": f"refused, with a reason; or the answer is no ({'; '.join(answers)})",
        "2": "wrong usage",
        str(BAD_VERDICT[0]): f"{', '.join(judges[:-1])} and {judges[-1]}: {BAD_VERDICT[1]}",
        "130": "interrupted",
        "128 + N": "ended by signal N, as 143 by SIGTERM",
    }


def exit_status_text(width: int) -> str:
    """Text of all exit statuses.

    As the help of `rig` lists them. width : columns
    """
    from textwrap import wrap

    lines = ["exit status:"]
    for status, meaning in exit_status_meanings().items():
        first, *more = wrap(meaning.replace("`", ""), max(width - 12, 40))
        lines += [f"  {status:<8}  {first}", *(f"{'':12}{line}" for line in more)]
    return "\n".join(lines)


def commands_by_group_help_text(width: int) -> str:
    """Help text of all commands by group.

    Commands of two words below the first.
    width : columns
    """
    from textwrap import wrap

    lines = []
    for group, commands in GROUPS.items():
        lines.append(f"{group}:")
        family = ""
        for name, text in commands.items():
            first, _, second = name.partition(" ")
            if second and first not in commands and first != family:
                lines.append(f"  {first}")
            family, shown = first, f"    {second}" if second else f"  {first}"
            body = wrap(text, max(width - 18, 40))
            lines += [f"{shown:<16}  {body[0]}", *(f"{'':18}{line}" for line in body[1:])]
        lines.append("")
    return "\n".join(lines)
