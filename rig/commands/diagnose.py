"""rig diagnose REC --out DIR [--calibration FILE]."""

from pathlib import Path

from rig.commands.output import Progress, add_force, add_recording, read_recording
from rig.errors import RigError


LONG_TIME = 1000.0  # s; times from there on, and clocks, are printed to a tenth of a second
FEW = 6  # numbers of a parameter that are printed; of more, how many there are


def arguments(parser):
    """Add this command's arguments to a parser."""
    add_recording(parser)
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="diagnosis.json and the page are written there")
    parser.add_argument("--calibration", metavar="FILE", type=Path, help="of the same rig from another recording: its joints are taken as known, "
                        "so that less can hide in them")
    parser.add_argument("--only", metavar="EFFECT", action="append", help="ask for this effect alone (or 'EFFECT PLACE'); may be given again")
    parser.add_argument("--without", metavar="EFFECT", action="append", default=[], help="leave this effect out; may be given again")
    add_force(parser)


def run(arguments):
    """Diagnose a recording and write what was found."""
    from rig.effects.parse import asked

    progress = Progress()
    progress("reading the recording", 0, 1)
    recording = read_recording(arguments)
    for text in (arguments.only or []) + arguments.without:
        asked(text, recording.design)
    out = arguments.outputs.folder(arguments.out)

    calibration = None if arguments.calibration is None else _known(arguments.calibration, recording)
    if recording.design.mechanism.kind == "arm":
        if calibration is not None:
            raise RigError("--calibration is for hexapods; an arm's geometry is always fitted to the recording")
        from calib.diagnose import arm
        from calib.diagnose import arm_result as result
        from calib.diagnose.arm_page import diagnosis_page

        found = arm.diagnose(recording, arguments.only, tuple(arguments.without), progress)
        result.save(out, found, recording)
        diagnosis_page(out / "diagnosis.html", found)
    else:
        from calib.diagnose import result
        from calib.diagnose.page import diagnosis_page

        found = result.diagnose(recording, arguments.only, tuple(arguments.without), progress, calibration)
        result.save(out, found, recording)
        diagnosis_page(out / "diagnosis.html", recording, found)
    tree = result.to_dict(found)
    for finding in tree["findings"]:
        print(f"{finding['effect']} at {finding['place']}: " + ", ".join(_parameter(*item) for item in finding["parameters"].items()))
        for rival in finding["cannot_be_told_from"]:
            print(f"  cannot be told from {rival['effect']} at {rival['place']}; {rival['experiment']}")
    if not tree["findings"]:
        print("nothing is left out: the recording and the model agree within the noise")
    fit = tree["fit"]
    scale, unit = (1e6, "um") if fit["unit"] == "m" else (1, fit["unit"])
    before, after, floor = (fit[name] * scale for name in ("heldout_before", "heldout_after", "noise_floor"))
    print(f"held out: {before:.4g} {unit} before, {after:.4g} after; noise {floor:.4g}")
    print(f"written: {arguments.out / 'diagnosis.json'}; look at {arguments.out / 'diagnosis.html'}")


def _known(path, recording):
    """Calibration of a file. Raises RigError where it was made from this very recording, which would count twice."""
    from calib import store

    calibration = store.load(path)
    same = store.seen_before(calibration, recording)
    if same:
        raise RigError(f"{path} was made from {len(same)} of the frames of {recording.folder}, which would count twice; diagnose without it, or "
                       "take another recording's")
    return calibration


def _parameter(name, parameter):
    value, unit = parameter["value"], parameter["unit"]
    if not isinstance(value, float):
        numbers = value and isinstance(value[0], float)
        if numbers and len(value) <= FEW:
            pairs = zip(value, zip(*parameter["ci95"])) if "ci95" in parameter else ((v, None) for v in value)
            shown = " ".join(f"{v:.3g}" + (f" ({ends[0]:.3g} to {ends[1]:.3g})" if ends else "") for v, ends in pairs)
            return f"{name} {shown} {parameter['unit']}"
        return f"{name} ({len(value)} numbers)" if numbers else f"{name} {', '.join(map(str, value)) or 'nothing known'}"
    low, high = parameter.get("ci95", (None, None))
    digits = ".1f" if unit == "s" and abs(value) >= LONG_TIME else ".4g"
    return f"{name} {value:{digits}} {unit}" + (f" ({low:{digits}} to {high:{digits}})" if low is not None else "")
