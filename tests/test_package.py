"""The package as others get it: licences of all that it needs, its own files, and (slow) the wheel in a fresh
environment.
"""

import importlib.util
import re
import subprocess
import sys
import tomllib
from importlib import metadata

import pytest

from rig.cli.command_line import main
from tests.conftest import ROOT

ALLOWED = re.compile(
    r"\b(MIT|BSD|0BSD|Apache|LGPL\w*|GNU Lesser General Public|MPL|Mozilla Public|PSF|Python Software Foundation|"
    r"HPND|ISC|Zlib|CC0|Unlicense)\b",
    re.IGNORECASE,
)
COPYLEFT = re.compile(
    r"(?<!L)(?<!Lesser )(?<!Library or Lesser )\b(A?GPL|GNU General Public|GNU Affero)", re.IGNORECASE
)
EXCEPTED = re.compile(
    r"\S*GPL\S* WITH GCC-exception-\S*"
)  # the run-time libraries of the Fortran compiler may be passed on with anything


def needed(name, seen):
    """Names of the distributions that one needs without extras, its own first."""
    key = re.sub(r"[-_.]+", "-", name).lower()
    if key in seen:
        return seen
    seen[key] = metadata.distribution(name)
    for need in metadata.requires(name) or ():
        condition = need.partition(";")[2]
        if (
            "extra" in condition
            or ("sys_platform" in condition and sys.platform not in condition)
            or "platform_system" in condition
        ):
            continue
        if "python_version" in condition and "<" in condition:
            continue
        needed(re.match(r"[\w.-]+", need)[0], seen)
    return seen


def licence(distribution):
    """What a distribution says of its licence: the expression, else its classifiers, else its own words, else what the
    text is.
    """
    distribution_metadata = distribution.metadata
    classified = [line for line in distribution_metadata.get_all("Classifier") or () if line.startswith("License ::")]
    return (
        distribution_metadata.get("License-Expression")
        or " / ".join(classified)
        or (distribution_metadata.get("License") or "")[:200]
        or _text(distribution)
    )


def _text(distribution):
    files = [
        path for path in distribution.files or () if path.name.upper().startswith(("LICENSE", "LICENCE", "COPYING"))
    ]
    text = " ".join(files[0].read_text().split()) if files else ""
    return (
        "BSD"
        if text.count("Redistribution and use in source and binary forms") == 1 and "GPL" not in text
        else text[:200]
    )


def allowed(text):
    """Whether a licence may be beside MIT: one of those allowed, none that asks for the whole to be like it."""
    rest = EXCEPTED.sub("", text)
    return bool(ALLOWED.search(rest)) and not COPYLEFT.search(rest)


@pytest.mark.parametrize(
    "text, fine",
    [
        ("MIT", True),
        ("BSD-3-Clause AND GPL-3.0-or-later WITH GCC-exception-3.1", True),
        ("License :: OSI Approved :: GNU General Public License v3", False),
        ("LGPL-2.1", True),
        ("License :: OSI Approved :: GNU Lesser General Public License v2", True),
        ("", False),
        ("Proprietary", False),
        ("AGPL-3.0", False),
        ("MIT AND GPL-3.0-only", False),
        ("MPL-2.0 AND MIT", True),
    ],
)
def test_licences_are_told_apart(text, fine):
    assert allowed(text) is fine


def test_all_that_is_installed_with_it_may_be():
    found = needed("rig", {})
    assert len(found) > 20 and not [name for name, one in found.items() if name != "rig" and not allowed(licence(one))]


def test_direct_needs_stand_in_the_table_of_licences():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    direct = [re.match(r"[\w.-]+", need)[0] for need in metadata.requires("rig") if "extra" not in need]
    assert [name for name in direct if name not in text] == []


@pytest.fixture
def plain(monkeypatch):
    """An installation without the extra `print`."""
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "matplotlib" else find_spec(name, *rest)
    )


def test_what_is_drawn_on_paper_says_what_to_install(plain, tmp_path, capsys):
    rig = ROOT / "tests" / "data" / "bench" / "check" / "rig.toml"
    for words in (
        ("print", rig, "--out", tmp_path / "sheets.pdf"),
        ("certify", "cal.json", "rec", "--out", tmp_path / "certificate.pdf"),
    ):
        assert main(list(map(str, words))) == 1
        assert "drawn by matplotlib: pip install 'rig[print]'" in capsys.readouterr().err and not list(
            tmp_path.iterdir()
        )


def test_only_what_is_drawn_on_paper_needs_matplotlib():
    found = {
        str(path.relative_to(ROOT))
        for package in ("rig", "vision", "calib", "synthetic")
        for path in (ROOT / package).rglob("*.py")
        if re.search(r"^\s*(from|import) matplotlib", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert found == {
        f"synthetic/{name}.py" for name in ("printable_target_sheets", "cube_nets_stl_rulers_and_assembly_page")
    } | {
        "calib/certificate/certificate_json_and_pdf_writers.py",
        "rig/posture/arm_force_transmission_and_exertable_wrench.py",
    }


def test_the_version_is_the_installed_one_and_the_newest_in_the_changes():
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    released = re.findall(
        r"^## (\d+\.\d+\.\d+)(?: \(\d{4}-\d{2}-\d{2}\))?$",
        (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    assert metadata.version("rig") == stated == released[0], "make setup, after a change of the version"
    assert released == sorted(released, key=lambda version: [int(part) for part in version.split(".")], reverse=True)


def test_decisions_are_listed():
    folder = ROOT / "docs" / "decisions"
    text = (folder / "README.md").read_text()
    assert sorted(re.findall(r"\((\d{4}-[\w-]+\.md)\)", text)) == sorted(path.name for path in folder.glob("0*.md"))


@pytest.mark.slow
def test_the_wheel_works_in_a_fresh_environment():
    done = subprocess.run(
        ["sh", ".ci/release"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env={"PYTHON": sys.executable, "PATH": "/usr/bin:/bin"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    times = dict(re.findall(r"(first|second) measure after this installation: (\d+) s", done.stdout))
    assert set(times) == {"first", "second"}, done.stdout
    assert "nothing wrong or unlikely" in done.stdout and ".whl" in done.stdout and ".tar.gz" in done.stdout
