"""Effect file written from a formula.

The Python source of an effect, which a person can edit.
"""

import re
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.unmodelled_curve_and_formula_quantities import POSE, Quantity, quantity_by_name
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import (
    effect_classes_of_source_text,
    effect_name_problem,
)
from rig.errors import RigError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.checked_toml_and_json_entries import Entries
from rig.model.arm_hands_effect_places_and_tolerances import AXES

WIDTH = 145  # characters of a line
MOST = {"m": 1e-2, "rad": 0.1}  # that a term may come to
WIDER = 10.0  # times a value either way, that is taken as usual of it
TURNS = (
    0.25  # share of a frequency either way, at most, that is taken as usual of it; one turn over its quantity's range
)


@dataclass(frozen=True, slots=True)
class Term:
    """Of a formula: a product of powers of quantities, times a sinusoid, times what is fitted.

    powers : ((name of a quantity, power), ..); wave : (name, rad per its unit) of a sinusoid, or None
    along : of POSE, which way the platform goes, None where axes lengthen; values : one coefficient, or a sine's and a
        cosine's
    greatest : of the product without coefficients; turns : of the sinusoid over what was seen of its quantity
    """

    powers: tuple[tuple[str, int], ...]
    wave: tuple[str, float] | None
    along: str | None
    values: tuple[float, ...]
    greatest: float
    turns: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """The quantities that it looks at."""
        return tuple(dict.fromkeys([*(name for name, _ in self.powers), *([self.wave[0]] if self.wave else [])]))


@dataclass(frozen=True, slots=True)
class Written:
    """A formula of what axes (word: strut, joint or slide) or the platform do. terms : (Term, ..), the platform's all
    along something or none
    alike : whether it holds of all axes alike, else of one."""

    word: str
    terms: tuple[Term, ...]
    alike: bool = False

    @staticmethod
    def read(table: Entries) -> "Written":
        """Written of a table as diagnosis.json holds it. Raises FileError for one that is none."""
        terms = []
        for entry in table.tables("terms"):
            sine = entry.get("wave", None) is not None
            values, powers = tuple(entry.array("values", (2 if sine else 1,)).tolist()), entry.get("powers")
            if not isinstance(powers, list) or not all(_paired(pair) and pair[1] in (1, 2, 3) for pair in powers):
                entry.fail(f"{entry.name('powers')} must list names with powers 1 to 3, not {powers}", "powers")
            wave = _wave(entry) if sine else None
            along = None if entry.get("along", None) is None else entry.text("along", POSE)
            terms.append(
                Term(
                    tuple((name, power) for name, power in powers),
                    wave,
                    along,
                    values,
                    entry.number("greatest", above=0),
                    entry.number("turns", least=0),
                )
            )
        if not terms or len({term.along is None for term in terms}) > 1:
            table.fail(f"{table.name('terms')} must be terms of axes, or all of the platform", "terms")
        return Written(table.text("word", AXES), tuple(terms), table.flag("alike"))

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Those that it looks at, in order."""
        return tuple(
            quantity_by_name(name, self.word)
            for name in dict.fromkeys(name for term in self.terms for name in term.names)
        )

    @property
    def moves_platform(self) -> bool:
        """Whether it moves the platform, not axes."""
        return self.terms[0].along is not None

    @property
    def waves(self) -> dict[tuple[str, float], str]:
        """{wave: name of its frequency}."""
        waves = list(dict.fromkeys(term.wave for term in self.terms if term.wave is not None))
        return {wave: "frequency" if len(waves) == 1 else f"frequency{n + 1}" for n, wave in enumerate(waves)}

    @property
    def values(self) -> dict[str, float]:
        """{parameter: value} of the fitted effect."""
        out = {name: value for n, term in enumerate(self.terms) for name, value in zip(_names(term, n), term.values)}
        return out | {name: wave[1] for wave, name in self.waves.items()}

    def text(self, prefix: str = "") -> str:
        """The formula by its parameters and the quantities' symbols. prefix : before each parameter"""
        return ", ".join(
            f"{direction}: {total}" if direction else total for direction, total in self._totals(prefix).items()
        )

    def _totals(self, prefix: str) -> dict[str | None, str]:
        """{which way the platform goes, None where axes lengthen: its terms}"""
        parts: dict[str | None, list[str]] = {}
        for n, term in enumerate(self.terms):
            turn = "" if term.wave is None else f"{prefix}{self.waves[term.wave]} * {self._symbol(term.wave[0])}"
            product = "".join(
                f" * {self._symbol(name)}" + (f"**{power}" if power > 1 else "") for name, power in term.powers
            )
            for name, function in zip(_names(term, n), ("np.sin", "np.cos") if turn else ("",)):
                parts.setdefault(term.along, []).append(
                    f"{prefix}{name}{product}" + (f" * {function}({turn})" if turn else "")
                )
        return {direction: " + ".join(terms) for direction, terms in parts.items()}

    def _symbol(self, name: str) -> str:
        return quantity_by_name(name, self.word).symbol

    def where(self) -> str:
        """What the symbols stand for, in words."""
        return ", ".join(
            f"{q.symbol} is {q.name}"
            + (" of the platform from home" if q.name in POSE else "")
            + (f" ({q.unit})" if q.unit else "")
            for q in self.quantities
        )

    def kind(self, name: str) -> type[Effect]:
        """The class of the effect, as its file makes it."""
        return effect_classes_of_source_text(self.source(name), Path(f"{name}.py"))[0]

    def source(self, name: str) -> str:
        """The file of an effect of a name."""
        title = "".join(part.capitalize() for part in name.split("_"))
        what = "The platform goes" if self.moves_platform else "Deviation"
        model = f"{what} {self.text().replace('np.', '')}; {_plain(self.where())}."
        apart, many = (
            _plain(words)
            for words in ("; ".join(q.apart for q in self.quantities), " and ".join(q.name for q in self.quantities))
        )
        uses = "REFERENCE_TEMPERATURE" in "".join(q.code for q in self.quantities)
        lines = [
            '"""A user-defined effect: a formula to be edited, and to be named after its cause once that is known."""',
            "",
            "from dataclasses import dataclass",
            "from typing import ClassVar",
            "",
            "import numpy as np",
            "",
            f"from rig.effects.base import {'REFERENCE_TEMPERATURE, ' if uses else ''}Effect, Motion, Parameter",
            "",
            "",
            "@dataclass(frozen=True, slots=True)",
            f"class {title}(Effect):",
            *_docstring_lines(model),
            "",
            "    place: str",
            *(f"    {p}: float = {_number(v) if p in self.waves.values() else 0.0}" for p, v in self.values.items()),
            f'    name: ClassVar = "{name}"',
            f'    stage: ClassVar = "{"structure" if self.moves_platform else "struts"}"',
            f'    places: ClassVar = ("{"rig" if self.moves_platform or self.alike else "axis"}",)',
            "    parameters: ClassVar = (",
            *(f"        {line}," for line in self._parameters()),
            "    )",
            f'    experiment: ClassVar = "{apart}"',
            '    action: ClassVar = "A formula, not a cause: look for what makes the '
            f"{'platform' if self.moves_platform else '{axis}'} follow "
            f'{many}."',
            *["    on_pose: ClassVar = True"] * (self.moves_platform or any(q.on_pose for q in self.quantities)),
            *self._needs(),
            "",
            *self._model(),
        ]
        return "\n".join(lines) + "\n"

    def _parameters(self) -> list[str]:
        """The parameters' lines, with what is usual about the values that were fitted."""
        base, out = "rad" if self.word == "joint" else "m", []
        for n, term in enumerate(self.terms):
            own = base if term.along is None else "rad" if term.along.startswith("r") else "m"
            size, most = float(np.linalg.norm(term.values)), MOST[own] / term.greatest
            for name in _names(term, n):
                out.append(
                    f'Parameter("{name}", "{_unit(own, self._factors(term))}", ({_number(-max(most, 2 * size))}, '
                    f"{_number(max(most, 2 * size))}), ({_number(size / WIDER)}, {_number(size * WIDER)}), signed=True)"
                )
        for wave, name in self.waves.items():
            turns = max(term.turns for term in self.terms if term.wave == wave)
            share, unit = min(TURNS, 1 / max(turns, 1.0)), quantity_by_name(wave[0], self.word).unit
            out.append(
                f'Parameter("{name}", "rad/{unit}", ({_number(wave[1] / 10)}, {_number(wave[1] * 10)}), '
                f'({_number(wave[1] * (1 - share))}, {_number(wave[1] * (1 + share))}), role="log")'
            )
        return out

    def _factors(self, term: Term) -> list[tuple[str, int]]:
        return [(quantity_by_name(name, self.word).unit, power) for name, power in term.powers]

    def _needs(self) -> list[str]:
        lacking = [q.lacking for q in self.quantities if q.lacking]
        if not lacking:
            return []
        body = lacking[0] if len(lacking) == 1 else f"next(filter(None, ({', '.join(lacking)})), None)"
        return ["", "    def needs(self, motion: Motion) -> str | None:", f"        return {body}"]

    def _model(self) -> list[str]:
        given = [f"        {q.symbol} = {q.code}" for q in self.quantities]
        if not self.moves_platform:
            total = textwrap.wrap(self.text("self."), WIDTH - 45, break_on_hyphens=False)
            body = [
                f"        return self.axes(motion.places) * ({total[0]}",
                *(f"{' ' * 43}{line}" for line in total[1:]),
            ]
            body[-1] += ")"
            return ["    def deviation(self, motion: Motion) -> np.ndarray:", *given, *body]
        rows = [
            f"        moved[:, [{POSE.index(direction)}]] = {total}"
            for direction, total in self._totals("self.").items()
            if direction
        ]
        return [
            "    def sway(self, motion: Motion) -> np.ndarray:",
            *given,
            "        moved = np.zeros((len(motion.t), 6))  # along and about the base's axes, m and rad",
            *rows,
            "        return motion.tangents(moved)",
        ]


def _paired(entry: object) -> bool:
    """Whether an entry of a file is a name with something."""
    return isinstance(entry, list) and len(entry) == 2 and isinstance(entry[0], str)


def _wave(entry: Entries) -> tuple[str, float]:
    """(name, rad per its unit) of the sinusoid that a term's table states."""
    wave = entry.get("wave")
    if isinstance(wave, list) and _paired(wave) and isinstance(wave[1], float) and 0 < wave[1] < np.inf:
        return wave[0], wave[1]
    entry.fail(f"{entry.name('wave')} must be a name and a frequency above 0, not {wave}", "wave")


def _names(term: Term, number: int) -> tuple[str, ...]:
    """The names of a term's coefficients, by its number in the formula."""
    return (f"c{number + 1}",) if term.wave is None else (f"sine{number + 1}", f"cosine{number + 1}")


def _docstring_lines(text: str) -> list[str]:
    """Lines of a class' docstring."""
    lines = textwrap.wrap(f'"""{text}"""', WIDTH, break_on_hyphens=False)
    return [f"    {line}" for line in lines]


def _unit(base: str, factors: Iterable[tuple[str, int]]) -> str:
    """Unit of a coefficient: that of the deviation over those of the quantities."""
    below = [
        unit + (f"^{power}" if power > 1 else "")
        if "/" not in unit
        else f"({unit})" + (f"^{power}" if power > 1 else "")
        for unit, power in factors
        if unit
    ]
    return base if not below else f"{base}/{below[0]}" if len(below) == 1 else f"{base}/({' '.join(below)})"


def _plain(words: str) -> str:
    """Words as they may stand in a text of a program that is formatted: a channel's name is anybody's."""
    return re.sub(r"[^\w .,;()/^+-]", "_", words)


def _number(value: float) -> str:
    return f"{value:.6g}"


EXAMPLE = Written(
    "strut", (Term((), ("travel of strut 2", 90.0), None, (2e-5, 0.0), 1.0, 1.5),)
)  # a strut that follows another one's travel


def load_place_and_suggested_formula(folder: Path, place: str | None) -> tuple[str, Written]:
    """Load the formula that a diagnosis in a folder suggests, and its place.

    Returns (place, Written)
    Raises RigError where it suggests nothing there, or several things anywhere.
    """
    table = json_toml_and_yaml_loading.load_json(folder / "diagnosis.json", "diagnosis", "diagnosis/1")
    found = {
        entry.text("place"): entry for entry in (table.tables("suggestions") if "suggestions" in table.tree else ())
    }
    if not found:
        raise RigError(
            f"{folder} suggests no formula: a formula for an unidentified effect is in the "
            "diagnosis' page and under "
            "'suggestions' in diagnosis.json"
        )
    if place is None and len(found) > 1:
        raise RigError(f"{folder} suggests formulas at {', '.join(found)}: select one with --place")
    if place is not None and place not in found:
        raise RigError(f"{folder} suggests nothing at {place!r}; it does at {', '.join(found)}")
    place = place or next(iter(found))
    return place, Written.read(found[place].table("model"))


@dataclass(frozen=True, slots=True)
class NewEffect:
    """A new user-defined effect. name; place : where it is fitted; places : where it can sit; formula
    source : text of its file
    """

    name: str
    place: str
    places: tuple[str, ...]
    formula: Written
    source: str

    @property
    def argument(self) -> str:
        """The effect as the option --effect of `rig simulate` names it, with its fitted values."""
        values = ",".join(f"{name}={value:.6g}" for name, value in self.formula.values.items())
        return f"{self.name}:{self.place.replace(' ', '')}:{values}"

    def __str__(self) -> str:
        formula = self.formula.text().replace("np.", "")
        return f"{self.name} at {', '.join(self.places)}: {formula}; {self.formula.where()}"


def new_effect_from_suggestion_or_example(
    name: str, path: Path, diagnosis_folder: Path | None = None, place: str | None = None
) -> NewEffect:
    """New effect of a name, from a suggestion or an example.

    By the formula that a diagnosis suggests at a place, or by an example.
    path : of its file, to be named in errors; diagnosis_folder : with diagnosis.json, or None for the example
    place : None where the diagnosis suggests one formula
    Raises RigError for an invalid name, a place without a diagnosis, and as `load_place_and_suggested_formula`
    """
    problem = effect_name_problem(name)
    if problem:
        raise RigError(f"--new {problem}")
    if place is not None and diagnosis_folder is None:
        raise RigError("--place selects a suggestion of a diagnosis: state its folder with --from")
    found, formula = (
        ("strut 1", EXAMPLE) if diagnosis_folder is None else load_place_and_suggested_formula(diagnosis_folder, place)
    )
    source = formula.source(name)
    (kind,) = effect_classes_of_source_text(source, path)
    return NewEffect(name, found, kind.places, formula, source)
