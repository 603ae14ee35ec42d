"""What CONTRIBUTING.md and the checks before a commit name exists."""

import re

import yaml

from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import effect_with_valid_place_and_parameters
from tests.docs.document_commands import ROOT

PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
CODE = re.compile(r"`([^`\n]+)`|^ {4}(.*)$", re.MULTILINE)  # words in code, lines of blocks
TARGETS = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


def code() -> list[str]:
    return [word or line for word, line in CODE.findall(PAGE)]


def test_every_target_of_make_that_is_named_exists():
    named = {target for text in code() for target in re.findall(r"\bmake ([a-z][a-z-]+)", text)}
    assert len(named) > 5 and named - TARGETS == set()


def test_every_path_that_is_named_exists():
    paths = [
        text.rstrip("/")
        for text in code()
        if re.fullmatch(r"(rig|vision|calib|synthetic|tests|docs|firmware|\.ci|\.github)/[\w./-]*", text)
    ]
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_the_first_change_is_an_effect_as_it_is_written():
    names: dict = {}
    exec(re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)[1], names)
    kind = names["LeadGrowth"]
    made = kind("strut 3", growth=5e-3)
    assert (
        issubclass(kind, Effect) and kind.name not in BY_NAME and effect_with_valid_place_and_parameters(made) is made
    )


def workflow(name: str) -> dict:
    return yaml.safe_load((ROOT / ".github" / "workflows" / f"{name}.yml").read_text(encoding="utf-8"))


def test_hosted_tests_are_those_of_make_on_three_systems():
    (job,) = workflow("tests")["jobs"].values()
    systems = [name.split("-")[0] for name in job["strategy"]["matrix"]["system"]]
    assert systems == ["ubuntu", "macos", "windows"] and job["strategy"]["matrix"]["python"] == ["3.11", "3.13"]
    commands = [step.get("run", "") for step in job["steps"]]
    made = re.search(r"^test: setup\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)[1]
    assert [line.replace("\t$(BIN)/python", "python") for line in made.splitlines()] == commands[-2:]


def test_a_hosted_release_is_that_of_make():
    (job,) = workflow("release")["jobs"].values()
    assert any("sh .ci/release" in step.get("run", "") for step in job["steps"])


def test_hooks_before_a_commit_use_the_environment_of_the_project():
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    hooks = {hook["id"]: hook for repo in config["repos"] for hook in repo["hooks"]}
    assert set(hooks) == {"ruff-check", "ruff-format", "mypy", "import-linter"}
    assert {repo["repo"] for repo in config["repos"]} == {"local"} and {
        hook["language"] for hook in hooks.values()
    } == {"system"}
    assert all(hook["entry"].startswith(".venv/bin/") for hook in hooks.values())
