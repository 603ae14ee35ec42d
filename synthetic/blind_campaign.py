"""Campaign of blind cases in a folder.

What makes it, which cases are drawn and diagnosed, and its score.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from rig.array_and_json_types import Json
from rig.effects.catalogue.effect_list import BY_NAME
from rig.errors import FileError, RigError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.local_and_remote_input_files import read_bytes, short_repr
from rig.formats.numbers_and_units import parse_whole_number
from rig.formats.output_files import write_text
from rig.report.verdict_refutations_and_result_display import OneLineRepr, Verdict, result_html
from synthetic import random_blind_arm_cases_with_truth, random_blind_platform_cases_with_truth
from synthetic.blind_campaign_page import campaign_dict, campaign_verdict, write_campaign_page
from synthetic.blind_diagnosis_score import Case, campaign_medians, campaign_rates_with_intervals, score_case
from synthetic.image_simulation import is_renderable

MOST, MOST_FRAMES = 1_000_000, 10_000  # cases of a campaign, frames of a case
FOLDERS = ("recordings", "hashes", "truth", "diagnoses")


@dataclass(frozen=True, slots=True)
class CampaignOptions:
    """season : how many cases; seed : another is another campaign; frames : of each recording, None for the usual;
    hide, effects, withhold : what cases may hide (None: all), effects to draw from, covariates to take away, joined by
    commas; arm : whether the rigs are arms; images : whether images are drawn
    """

    season: int
    seed: int = 0
    frames: int | None = None
    hide: str | None = None
    effects: str = ""
    withhold: str = ""
    arm: bool = False
    images: bool = False

    def settings(self) -> Json:
        """What makes a campaign: all that its recordings depend on. Raises RigError for what no campaign takes"""
        if not 1 <= self.season <= MOST or not 0 <= self.seed < 1 << 63:
            raise RigError(f"--season takes 1 to {MOST}, --seed at least 0 and below 2^63")
        if self.arm and self.images:
            raise RigError("--images are of hexapods; an arm's cases are poses: omit --images or --mechanism")
        usual = (
            random_blind_platform_cases_with_truth.IMAGE_FRAMES
            if self.images
            else random_blind_platform_cases_with_truth.FRAMES
        )
        frames = (
            (random_blind_arm_cases_with_truth.FRAMES if self.arm else usual) if self.frames is None else self.frames
        )
        if not 40 <= frames <= MOST_FRAMES:
            raise RigError(
                f"--frames must be at least 40 and at most {MOST_FRAMES}, not {frames}: a diagnosis needs enough poses"
            )
        kind = {"mechanism": "arm"} if self.arm else {"images": True} if self.images else {}
        return {"seed": self.seed, "frames": frames, **kind, **self._lists()}

    def _lists(self) -> dict[str, list[str]]:
        """What cases hide, are drawn from and lack, by name. Raises RigError for what there is not"""
        kinds = random_blind_arm_cases_with_truth.KINDS if self.arm else random_blind_platform_cases_with_truth.KINDS
        texts = {
            "hide": ",".join(kinds) if self.hide is None else self.hide,
            "effects": self.effects,
            "withhold": self.withhold,
        }
        lists = {name: [part.strip() for part in text.split(",") if part.strip()] for name, text in texts.items()}
        for name, known in (
            ("hide", kinds),
            ("effects", BY_NAME),
            ("withhold", random_blind_platform_cases_with_truth.WITHHELD),
        ):
            for part in lists[name]:
                if part not in known:
                    raise RigError(f"--{name}: there is no {part!r}; there are {', '.join(known)}")
        able = random_blind_platform_cases_with_truth.IMAGE_KINDS if self.images else kinds
        lists["hide"] = [kind for kind in lists["hide"] if kind in able]
        if not lists["hide"]:
            raise RigError(f"--hide takes some of {', '.join(able)}")
        if self.arm and lists["withhold"]:
            raise RigError("--withhold withholds covariates of a hexapod; omit it with --mechanism arm")
        unseen = [name for name in lists["effects"] if self.images and not is_renderable(BY_NAME[name])]
        if unseen:
            raise RigError(f"--effects: images do not show {', '.join(unseen)}, only corners do; omit --images")
        return lists


@dataclass(frozen=True, slots=True, repr=False)
class CampaignResult(OneLineRepr):
    """The score of a campaign. settings : of CampaignOptions; cases : those drawn and diagnosed"""

    settings: Json
    cases: tuple[Case, ...]

    @property
    def verdict(self) -> Verdict:
        """The verdict on the diagnosis."""
        return campaign_verdict(campaign_rates_with_intervals(list(self.cases)))

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), self.lines())

    def tree(self) -> Json:
        """What score.json holds."""
        return {"settings": self.settings, **campaign_dict(list(self.cases))}

    def lines(self) -> list[str]:
        """Its figures in words, with intervals."""
        lines = []
        for f in campaign_rates_with_intervals(list(self.cases)):
            goal = f", to reach {f.goal:.0%}" if f.goal is not None else ""
            found = (
                f"{f.hits:4} of {f.trials:<4} {f.hits / f.trials:6.1%} ({f.low:.1%} to {f.high:.1%}{goal})"
                if f.trials
                else "   none"
            )
            lines.append(f"{f.name:42}{found}")
        medians = campaign_medians(list(self.cases)).items()
        return [*lines, *(f"median {name:35}{value:10.3g}" for name, value in medians)]

    def write(self, folder: Path) -> None:
        """Write score.json and score.html."""
        write_text(folder / "score.json", json.dumps(self.tree(), indent=1) + "\n")
        write_campaign_page(folder / "score.html", self.settings, list(self.cases))


@dataclass(frozen=True, slots=True)
class Campaign:
    """A campaign's folder. notice : called with what is said of a torn file"""

    folder: Path
    notice: Callable[[str], None]

    def begin(self, settings: Json) -> None:
        """Write what makes this campaign, and make its folders. Raises RigError where the folder holds another."""
        path = self.folder / "campaign.json"
        if path.exists():
            _require_same(json_toml_and_yaml_loading.load_json(path, "campaign").tree, settings, self.folder)
        write_text(path, json.dumps(settings, indent=1) + "\n")
        for name in FOLDERS:
            (self.folder / name).mkdir(exist_ok=True)

    def undrawn(self, indices: Sequence[int]) -> list[int]:
        """The cases that are not drawn; what was diagnosed of another drawing of one is removed."""
        undrawn = [i for i in indices if self._digest(i) is None]
        for index in undrawn:
            self._record_file(index).unlink(missing_ok=True)
        return undrawn

    def record(self, index: int) -> tuple[float, str | None] | None:
        """(seconds, error or None) of a case's diagnosis, or None where there is none or it is torn, which is said: it
        is then diagnosed anew.
        """
        path = self._record_file(index)
        if not path.exists():
            return None
        try:
            table = json_toml_and_yaml_loading.load_json(path, "record of a diagnosis")
            return table.number("seconds", least=0), None if table.get("failed") is None else table.text("failed")
        except FileError as error:
            self.notice(f"case {index}: it is diagnosed anew: {error}")
            return None

    def score(self, settings: Json) -> CampaignResult:
        """CampaignResult of all cases drawn and diagnosed. Raises RigError where a truth differs from that hashed."""
        hashed = [int(path.stem) for path in (self.folder / "hashes").glob("*.sha256") if path.stem.isdigit()]
        known = sorted(i for i in hashed if self._digest(i) is not None and self.record(i) is not None)
        return CampaignResult(settings, tuple(self._case(i) for i in known))

    def _case(self, index: int) -> Case:
        """Case of one that is diagnosed. Raises RigError where the truth differs from that hashed."""
        truth, record = self.folder / "truth" / f"{index:04d}.json", self.record(index)
        if record is None:
            raise RigError(f"case {index} has not been diagnosed")
        if not truth.exists() or sha256(read_bytes(truth)).hexdigest() != self._digest(index):
            raise RigError(f"{truth} differs from that hashed before the diagnosis; remove the case from the campaign")
        seconds, failed = record
        diagnosis = None if failed else self.folder / "diagnoses" / f"{index:04d}" / "diagnosis.json"
        return score_case(index, truth, diagnosis, seconds, failed)

    def _record_file(self, index: int) -> Path:
        return self.folder / "diagnoses" / f"{index:04d}.json"

    def _digest(self, index: int) -> str | None:
        """What a case's hash says, or None where there is none or it is torn, which is said: the case is then drawn
        anew, the same by its seed.
        """
        path = truth_hash_path(self.folder, index)
        if not path.exists():
            return None
        found = re.match(rb"[0-9a-f]{64}\b", read_bytes(path))
        if found is None:
            self.notice(f"case {index}: {path} contains no sha256; it is regenerated")
        return found and found[0].decode()


def truth_hash_path(folder: Path, index: int) -> Path:
    """Path of the file with the hash of a case's truth, in a campaign's folder."""
    return folder / "hashes" / f"{index:04d}.sha256"


def parse_case_numbers(text: str | None, count: int) -> list[int]:
    """Parse the numbers of cases of a list such as 3,7-9.

    None for all of 1..count.
    Raises RigError for anything else
    """
    if text is None:
        return list(range(1, count + 1))
    try:
        ranges = [[parse_whole_number(end) for end in part.split("-")] for part in text.split(",")]
    except ValueError:
        raise RigError(f"--cases takes for example 3,7-9, not {short_repr(text)}") from None
    if any(len(ends) > 2 or not 1 <= ends[0] <= ends[-1] <= count for ends in ranges):
        raise RigError(
            f"--cases {short_repr(text)}: the campaign has cases 1 to {count}, and a range runs from small to large"
        )
    return sorted({i for ends in ranges for i in range(ends[0], ends[-1] + 1)})


def _require_same(stored: Mapping[str, object], settings: Json, folder: Path) -> None:
    """Raise RigError where what is stored makes another campaign."""
    other = [name for name in {**settings, **stored} if stored.get(name) != settings.get(name)]
    if other:
        named = ", ".join(f"{n} {short_repr(stored.get(n))} (not {settings.get(n)!r})" for n in other)
        raise RigError(f"{folder} contains another campaign, with {named}")
