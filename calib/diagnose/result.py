"""A recording -> its Diagnosis, and that as diagnosis.json."""

import json
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from calib.diagnose import knowledge as known
from calib.diagnose.gross import exchanged, swaps
from calib.diagnose.hypotheses import Signatures, families
from calib.diagnose.knowledge import within_reach
from calib.diagnose.prove import Proof, corner_noise, overall, prove
from calib.diagnose.select import Selection, select, supported
from calib.diagnose.temperatures import unlogged, widened
from calib.diagnose.unknown import unknowns
from rig.origin import Origin
from rig.effects import BY_NAME
from rig.effects.face_misplacement import FaceMisplacement
from rig.effects.marker_swap import MarkerSwap
from rig.effects.parse import to_dict as effect_dict
from rig.pose import vector
from rig.files import write_text
from vision.places import moves

SCHEMA = "diagnosis/1"


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """recording : its name; source : of the poses, in words; swapped : [MarkerSwap] found before all else
    moved : [Move] of the faces of a free body's rig that are not where it is stated, measured before all else and taken as measured
    selection : Selection; proofs : [Proof], one for each finding;
    fit : Proof of all together; unknown : [Unknown]; skipped : [Skipped]; noise : {corner_px, pose_m, pose_rad, strut_m}
    origin : of the owner's clock, which moments are told by"""

    recording: str
    source: str
    swapped: list
    moved: list
    selection: Selection
    proofs: list[Proof]
    fit: Proof
    unknown: list
    skipped: list
    noise: dict
    origin: Origin = Origin()

    @property
    def effects(self):
        """The admitted effects, in the findings' order."""
        return [self.selection.settled.knowledge.effects[f.number] for f in self.selection.findings]


@threadpool_limits.wrap(limits=1)
def diagnose(recording, only=None, without=(), progress=None, calibration=None):
    """Diagnosis of a Recording.

    only, without : names of effects, or "effect place", to which the catalogue is confined or which are left out
    progress : called with (label, done, of), or None
    calibration : store.Calibration of another recording, whose joints are taken as known to its covariance: what it has not swallowed
    shows, and what has changed since. Raises NotEnoughData where too little was measured, and what measuring raises
    """
    faces = FaceMisplacement.name not in without and (not only or FaceMisplacement.name in only)
    knowledge, source, measured = known.of_recording(recording, progress, calibration, "auto" if faces else "stated")
    moved = [m for m in moves(measured.adjustment) if m.moved] if measured is not None and measured.places_free else []
    swapped = swaps(knowledge) if MarkerSwap.name not in without and (not only or MarkerSwap.name in only) else []
    knowledge = within_reach(exchanged(knowledge, swapped))
    asked, skipped = families(knowledge, only, without)
    signatures = Signatures(knowledge)
    selection = select(knowledge, asked, signatures, progress)
    left = unknowns(_bare(selection.settled))
    if left:
        selection = supported(selection, signatures, left)
        left = unknowns(_bare(selection.settled))
    selection = unlogged(selection, signatures)
    selection = replace(selection, settled=widened(selection.settled))
    plane = "struts" if knowledge.axes else "view"
    proofs = [prove(selection.settled, {f.number}, f.score.family.plane if knowledge.axes else "view") for f in selection.findings]
    if selection.findings and knowledge.axes:
        plane = selection.findings[0].score.family.plane
    return Diagnosis(recording.folder.resolve().name, source, swapped, moved, selection, proofs, overall(selection.settled, plane), left, skipped,
                     _noise(selection.settled.planes), recording.origin)


def _bare(settled):
    """Planes with the admitted effects' parameters among the freedoms."""
    return settled.planes if settled.column is None else settled.planes.without(settled.column)


def _noise(planes):
    """{corner_px, pose_m, pose_rad, strut_m}: standard deviations of what was measured, cameras known."""
    k = planes.knowledge
    if k.own is not None:
        covariance = k.own
    else:
        covariance = planes.to_local[:, :6] @ np.swapaxes(planes.to_local[:, :6], 1, 2)
    out = {"corner_px": corner_noise(planes) or None, "pose_m": _length(covariance[:, :3, :3]), "pose_rad": _length(covariance[:, 3:, 3:])}
    if k.axes:
        inverse = np.linalg.inv(planes.W)
        out["strut_m"] = float(np.sqrt(np.mean(np.einsum("fij,fij->fi", inverse, inverse))))
    return out


def _length(covariance):
    return float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean()))


def to_dict(diagnosis):
    """The tree of diagnosis.json."""
    findings = [{**effect_dict(effect), "evidence": {}, "cannot_be_told_from": []} for effect in diagnosis.swapped]
    for finding in findings:
        finding["parameters"] = {name: {"value": value, "unit": ""} for name, value in finding["parameters"].items()}
    findings += [{"effect": FaceMisplacement.name, "place": m.name, "parameters": _moved(m), "evidence": {}, "cannot_be_told_from": []}
                 for m in diagnosis.moved]
    findings += [_finding(diagnosis, f, proof) for f, proof in zip(diagnosis.selection.findings, diagnosis.proofs)]
    findings += [{"effect": "unknown", "place": u.place,
                  "parameters": {"magnitude": {"value": u.magnitude, "unit": u.unit}, "depends_on": {"value": list(u.depends_on), "unit": ""}},
                  "evidence": {"p_value": u.p_value, "drop": u.drop}, "cannot_be_told_from": []} for u in _places(diagnosis.unknown)]
    worst = diagnosis.unknown[0] if diagnosis.unknown else None
    fit = diagnosis.fit
    return {"schema": SCHEMA, "recording": diagnosis.recording, "start_s": diagnosis.origin.shown(0.0), "noise": diagnosis.noise, "findings": findings,
            "unexplained": None if worst is None else {"place": worst.place, "magnitude": worst.magnitude, "unit": worst.unit,
                                                       "depends_on": list(worst.depends_on)},
            "fit": {"heldout_before": fit.before, "heldout_after": fit.after, "noise_floor": fit.floor, "unit": fit.unit},
            "not_asked": [{"effect": s.effect, "reason": s.reason} for s in diagnosis.skipped]}


def _moved(move):
    """{parameter: value and interval} of a Move."""
    ends = np.stack([move.by, move.by - move.ci95, move.by + move.ci95])
    return {p.name: {"value": part[0].tolist(), "unit": p.unit, "ci95": part[1:].tolist()}
            for p, part in zip(FaceMisplacement.parameters, (ends[:, :3], ends[:, 3:]))}


def _places(unknown):
    """The most convincing Unknown of each place."""
    seen = {}
    for u in unknown:
        seen.setdefault(u.place, u)
    return list(seen.values())


def _finding(diagnosis, finding, proof):
    settled = diagnosis.selection.settled
    effect = settled.knowledge.effects[finding.number]
    size = settled.planes.size
    units = {p.name: p.unit for p in effect.parameters}
    parameters = {name: {"value": value, "unit": units[name], "ci95": [low, high]}
                  for name, (value, low, high) in settled.intervals(finding.number).items()}
    for p in effect.parameters:
        if p.role in ("moment", "choice") and p.size == 1 and np.isfinite(getattr(effect, p.name)):
            value = getattr(effect, p.name)
            parameters[p.name] = {"value": value, "unit": p.unit} if p.role == "choice" else _moment(settled.knowledge.t, value, diagnosis.origin)
    return {"effect": effect.name, "place": effect.place, "parameters": parameters,
            "evidence": {"delta_bic": finding.score.gain(size), "p_value": min(1.0, finding.score.p_value * diagnosis.selection.families),
                         "heldout_before": proof.before, "heldout_after": proof.after, "unit": proof.unit, "gain_sigma": proof.gain},
            "cannot_be_told_from": [{"effect": r.score.family.kind.name, "place": r.score.family.place, "delta_bic": r.behind,
                                     "cosine": r.cosine, "experiment": experiment(effect.name, r.score.family.kind.name)}
                                    for r in finding.rivals]}


def _moment(t, value, origin):
    """A moment (s from the recording's start) by the owner's clock, and the frames, at t (n,) s, between which it lies."""
    i = int(np.clip(np.searchsorted(t, value), 1, len(t) - 1))
    return {"value": origin.shown(value), "unit": "s", "ci95": [origin.shown(t[i - 1]), origin.shown(t[i])]}


def experiment(a, b):
    """What would tell two effects apart, in words."""
    if a == b:
        return f"{BY_NAME[a].experiment}"
    return f"{a}: {BY_NAME[a].experiment}; {b}: {BY_NAME[b].experiment}"


def save(folder, diagnosis, recording):
    """Write diagnosis.json into a folder and, where a machine with cameras was commanded, what it takes to simulate it as found:
    machine.json and the recording's own rig.toml, commands, frames and sensors."""
    write_text(folder / "diagnosis.json", json.dumps(to_dict(diagnosis), indent=1) + "\n")
    k = diagnosis.selection.settled.knowledge
    if not k.axes or k.seen is None:
        return
    m = k.design.mechanism
    tree = {"effects": [effect_dict(effect) for effect in (*diagnosis.swapped, *diagnosis.effects)], "base_joints": m.base_joints.tolist(),
            "platform_joints": m.platform_joints.tolist(), "strut_zeros": m.strut_zeros.tolist(),
            "cameras": [{"name": c.name, "matrix": c.matrix.tolist(), "distortion": c.distortion.tolist(), "pose": vector(c.pose).tolist()}
                        for c in k.design.cameras]}
    write_text(folder / "machine.json", json.dumps(tree) + "\n")
    for name in ("rig.toml", "commands.csv", "frames.csv", "sensors.csv"):
        if (recording.folder / name).exists():
            write_text(folder / name, (recording.folder / name).read_text(encoding="utf-8-sig"))
