"""Options that take lengths, angles or speeds take them with their units; plain numbers mean what they did."""

import argparse

import numpy as np
import pytest

from rig.cli.command_parser_execution_and_exit_status import argument_adder_and_runner_of_command
from rig.cli.correct import _start
from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import (
    join_options_with_negative_numbers,
    parse_length_and_angle,
)
from rig.driving.axis_display_units_and_controller_counts import MM_AND_DEGREES, parse_axis_values
from rig.driving.driver_opening_and_settling import parse_settling
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import EmulatorOptions
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import RigError
from rig.formats.numbers_and_units import SI, LengthAndAngleUnits, parse_quantity
from rig.model.calibration_board_layout_and_description_parsing import parse_board


def option(command, *words):
    """Function of a text that parses a command's option and returns its value."""

    def parse(text):
        parser = argparse.ArgumentParser(exit_on_error=False)
        argument_adder_and_runner_of_command(command)[0](parser)
        *others, name = words
        given = join_options_with_negative_numbers([*others, f"--{name}", *text.split()])
        return getattr(parser.parse_args(given), name.replace("-", "_"))

    return parse


def jogged(texts, units):
    return parse_axis_values("--to", texts, units, MM_AND_DEGREES)


def board(text):
    made = parse_board(f"charuco:5x7:{text}:DICT_6X6_250")
    return made.pitch, made.side


def start_in_mm_and_degrees(text):
    return _start(text, ("m", "rad"), LengthAndAngleUnits("mm", "deg"))


def pose_sigma(text):
    return parse_length_and_angle(option("plan", "x", "--for", "parameters", "--out", "y", "sigma")(text), "--sigma")


QUANTITIES = {
    "plan --sigma": (pose_sigma, "20um 50urad", "2e-5 5e-5", (2e-5, 5e-5)),
    "calibrate online --drift": (option("calibrate online", "x", "drift"), "0.2um", "2e-7", 2e-7),
    "calibrate online --step": (option("calibrate online", "x", "step"), "2mm", "0.002", 2e-3),
    "export --lead": (option("export", "x", "--format", "json", "--out", "y", "lead"), "4mm", "0.004", 4e-3),
    "export --zero": (option("export", "x", "--format", "json", "--out", "y", "zero"), "250mm 0.3m", "0.25 0.3",
                      (0.25, 0.3)),
    "run --settle": (lambda text: parse_settling(f"limbs:{text}").amount, "20µm", "2e-5", 2e-5),
    "run --in-motion": (option("run", "x", "--plan", "home", "--out", "y", "in-motion"), "3mm/s", "3", 3e-3),
    "jog --by": (lambda text: jogged([text], ["m"])[0], "-0.5mm", "-0.5", -5e-4),
    "jog --to": (lambda text: jogged(text.split(","), ["m", "m"]), "300mm,0.31m", "300,310", (0.3, 0.31)),
    "jog --to of a joint": (lambda text: jogged(text.split(","), ["m", "rad"]), "300mm,0.5deg", "300,0.5",
                            (0.3, np.radians(0.5))),
    "emulate --start": (lambda text: EmulatorOptions(start=text).start_values(["m", "m"]), "300mm,0.31m", "0.3,0.31",
                        (0.3, 0.31)),
    "emulate --start of a joint": (lambda text: EmulatorOptions(start=text).start_values(["m", "rad"]), "300mm,90deg",
                                   "0.3,1.5707963267948966", (0.3, np.pi / 2)),
    "correct --start": (lambda text: _start(text, ("m", "rad"), SI), "300mm,2mrad", "0.3,0.002", (0.3, 2e-3)),
    "correct --start --units": (start_in_mm_and_degrees, "0.3m,1rad", f"300,{np.rad2deg(1)}", (0.3, 1)),
    "lens --board": (board, "36mm:18mm", "0.036:0.018", (0.036, 0.018)),
    "--effect": (lambda text: parse_effect(f"backlash:strut3:gap={text}").gap, "80um", "80e-6", 80e-6),
    "--effect at a joint": (lambda text: parse_effect(f"backlash:joint3:gap={text}").gap, "80urad", "80e-6", 80e-6),
}  # fmt: skip


@pytest.mark.parametrize("parse, with_unit, plain, value", QUANTITIES.values(), ids=QUANTITIES)
def test_a_quantity_with_its_unit_is_that_without(parse, with_unit, plain, value):
    assert np.array(parse(with_unit)) == pytest.approx(np.array(value), rel=1e-12)
    assert np.array(parse(plain)) == pytest.approx(np.array(value), rel=1e-12)
    with pytest.raises((RigError, argparse.ArgumentError)):
        parse(with_unit.replace("um", "kg").replace("µm", "kg").replace("mm", "kg").replace("urad", "kg").replace(
            "0.3m", "0.3kg"))  # fmt: skip


@pytest.mark.parametrize("text, unit", [("1mm", "1"), ("1mm", "rad"), ("mm", "m"), ("1e3 mm", "m"), ("1_0mm", "m")])
def test_what_is_no_quantity_of_a_unit_is_refused(text, unit):
    with pytest.raises(ValueError):
        parse_quantity(text, unit)
