"""certificate.json (schema "certificate/1"): a certificate for programs, in m, rad and s, as `certificate.schema.json`
beside this file has it.
"""

import json
from dataclasses import asdict
from importlib.resources import files
from typing import Any

from calib.certificate import certificate_sentences
from calib.certificate.certificate import Certificate
from calib.certificate.certificate_verdict import certificate_verdict
from calib.certify.held_out_errors import Figures
from calib.certify.pose_error_promise import Promise
from calib.certify.recording_claim_check import AgainstClaim
from calib.certify.uncertainty_budget import COVERAGE, Budget
from rig.formats.json_file import nan_to_null

SCHEMA = "certificate/1"


def certificate_schema() -> dict[str, Any]:
    """The JSON schema that a certificate.json keeps."""
    found: dict[str, Any] = json.loads((files("calib") / "certificate" / "certificate.schema.json").read_text())
    return found


def certificate_dict(c: Certificate) -> dict[str, Any]:
    """The dict that certificate.json holds; null where something was not measured or is not known."""
    v = c.volume
    out = {
        "schema": SCHEMA,
        "statement": [
            certificate_sentences.scale_line(c),
            certificate_sentences.promise_line(c),
            certificate_sentences.volume_line(c),
            *certificate_sentences.basis_lines(c),
        ],
        "machine": c.machine,
        "promise": _promise(c.promise),
        "scale": {
            "certified": c.asked.scale is not None,
            "relative_standard_uncertainty": c.asked.scale,
            "source": c.asked.scale_source,
        },
        "volume": {
            "position_low_m": v.low,
            "position_high_m": v.high,
            "rotation_rad": v.turned,
            "axes": v.axes,
            "commands": v.commands,
        },
        "cells": [
            {"position_low_m": cell.low, "position_high_m": cell.high, "promise": _promise(cell.promise)}
            for cell in c.cells
        ],
        "held_out": {"before": _figures(c.before), "after": _figures(c.after)},
        "repeatability": asdict(c.repeatability),
        "iso9283": asdict(c.iso9283),
        "iso230": [asdict(axis) for axis in c.iso230],
        "conformity": [asdict(k) for k in c.conformity],
        "budget": _budget(c.budget),
        "conditions": asdict(c.conditions),
        "claim": {
            "kept": all(one.found.kept for one in c.claims),
            "recordings": [_against_claim(one) for one in c.claims],
        }
        if c.claims
        else None,
        "verdict": certificate_verdict(c).tree(),
        **({} if c.confounds is None else {"confounds": c.confounds.tree()}),
        **c.provenance,
    }
    return {name: nan_to_null(value) for name, value in out.items()}


def certificate_text(c: Certificate) -> str:
    """What is written to certificate.json."""
    return json.dumps(certificate_dict(c), indent=1, allow_nan=False) + "\n"


def _promise(p: Promise) -> dict[str, Any]:
    return {
        "position_m": p.position.upper,
        "rotation_rad": p.turned,
        "coverage": p.coverage,
        "confidence": p.confidence,
        "n": p.n,
        "position": asdict(p.position),
        "rotation": None if p.rotation is None else asdict(p.rotation),
    }


def _against_claim(one: AgainstClaim) -> dict[str, Any]:
    parts = {
        name: {
            "rms": part.rms,
            "beyond_noise": beyond,
            "claimed": claimed,
            "of_allowed": part.of_allowed,
            "limit": part.limit,
            "kept": part.kept,
        }
        for name, (part, beyond, claimed) in one.parts.items()
    }
    return {
        "recording": one.recording,
        "n": one.found.n,
        "kept": one.found.kept,
        "position": parts.get("position"),
        "rotation": parts.get("rotation"),
        "offset": one.found.offset and asdict(one.found.offset),
    }


def _budget(b: Budget) -> dict[str, Any]:
    return {
        "k": b.machine.k[0],
        "coverage": COVERAGE,
        "rows": [asdict(row) for row in b.rows],
        "machine": [b.machine.position, b.machine.rotation],
        "measuring": [b.measuring.position, b.measuring.rotation],
        "machine_k": b.machine.k,
        "measuring_k": b.measuring.k,
    }


def _figures(f: Figures) -> dict[str, Any]:
    names = ("rms", "p95", "max")
    return {
        "n": f.n,
        "position_m": dict(zip(names, f.position)),
        "rotation_rad": dict(zip(names, f.rotation)),
        "bias": f.bias,
    }
