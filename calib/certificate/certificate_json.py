"""Certificate as JSON.

The contents of certificate.json.
"""

import json
from dataclasses import asdict

from calib.certificate import certificate_sentences
from calib.certificate.certificate_computation_verdict_and_provenance import Certificate, certificate_verdict
from calib.certification.calibration_evidence_verdict_and_claim_check import AgainstClaim
from calib.certification.held_out_errors import Figures
from calib.certification.pose_error_promise_and_conformity import Promise
from calib.certification.uncertainty_budget import COVERAGE, Budget
from rig.array_and_json_types import Json
from rig.formats.json_toml_and_yaml_loading import nan_to_null

SCHEMA = "certificate/1"


def certificate_dict(certificate: Certificate) -> Json:
    """dict of a certificate as certificate.json holds it.

    Null where something was not measured or is not known.
    """
    v = certificate.volume
    out = {
        "schema": SCHEMA,
        "statement": [
            certificate_sentences.length_scale_line(certificate),
            certificate_sentences.promise_line(certificate),
            certificate_sentences.measured_volume_line(certificate),
            *certificate_sentences.basis_lines(certificate),
        ],
        "machine": certificate.machine,
        "promise": _promise(certificate.promise),
        "scale": {
            "certified": certificate.asked.scale is not None,
            "relative_standard_uncertainty": certificate.asked.scale,
            "source": certificate.asked.scale_source,
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
            for cell in certificate.cells
        ],
        "held_out": {"before": _figures(certificate.before), "after": _figures(certificate.after)},
        "repeatability": asdict(certificate.repeatability),
        "iso9283": asdict(certificate.iso9283),
        "iso230": [asdict(axis) for axis in certificate.iso230],
        "conformity": [asdict(k) for k in certificate.conformity],
        "budget": _budget(certificate.budget),
        "conditions": asdict(certificate.conditions),
        "claim": {
            "kept": all(one.found.kept for one in certificate.claims),
            "recordings": [_against_claim(one) for one in certificate.claims],
        }
        if certificate.claims
        else None,
        "verdict": certificate_verdict(certificate).tree(),
        **({"displacement": list(certificate.displacement)} if certificate.displacement else {}),
        **({} if certificate.confounds is None else {"confounds": certificate.confounds.tree()}),
        **certificate.provenance,
    }
    return {name: nan_to_null(value) for name, value in out.items()}


def certificate_text(certificate: Certificate) -> str:
    """JSON text of a certificate, as certificate.json holds it."""
    return json.dumps(certificate_dict(certificate), indent=1, allow_nan=False) + "\n"


def _promise(p: Promise) -> Json:
    return {
        "position_m": p.position.upper,
        "rotation_rad": p.turned,
        "coverage": p.coverage,
        "confidence": p.confidence,
        "n": p.n,
        "position": asdict(p.position),
        "rotation": None if p.rotation is None else asdict(p.rotation),
    }


def _against_claim(one: AgainstClaim) -> Json:
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


def _budget(b: Budget) -> Json:
    return {
        "k": b.machine.k[0],
        "coverage": COVERAGE,
        "rows": [asdict(row) for row in b.rows],
        "machine": [b.machine.position, b.machine.rotation],
        "measuring": [b.measuring.position, b.measuring.rotation],
        "machine_k": b.machine.k,
        "measuring_k": b.measuring.k,
    }


def _figures(f: Figures) -> Json:
    names = ("rms", "p95", "max")
    return {
        "n": f.n,
        "position_m": dict(zip(names, f.position)),
        "rotation_rad": dict(zip(names, f.rotation)),
        "bias": f.bias,
    }
