"""Every reader takes what it should, and answers rubbish with a RigError, within a second and a gibibyte."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.errors import RigError
from tests.fuzz.readers import Reader, readers
from tests.fuzz.trial import TOKENS, confined, failure, mutated

EXAMPLES = 40  # for each reader and kind of rubbish; `make fuzz` tries a million


@pytest.fixture(scope="module")
def all_readers(tmp_path_factory):
    return readers(tmp_path_factory.mktemp("readers"))


def test_valid_inputs_are_read(all_readers, tmp_path):
    for reader in all_readers:
        if reader.name not in ("effect", "effect as JSON", "plan"):  # whose seeds are partly of another kind of rig
            for seed in reader.seeds:
                (tmp_path / "valid").write_bytes(seed)
                reader.read(tmp_path / "valid")


@settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(number=st.integers(0, 2**32 - 1))
def test_inputs_near_valid_ones_are_read_or_refused(all_readers, tmp_path, number):
    rng = np.random.default_rng(number)
    with confined():
        for reader in all_readers:
            data = mutated(reader.seeds[rng.integers(len(reader.seeds))], reader.seeds, rng)
            assert failure(reader, data, tmp_path / "input") is None, (reader.name, data[:2000])


@settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(parts=st.lists(st.one_of(st.binary(max_size=20), st.sampled_from(TOKENS)), max_size=6))
def test_rubbish_is_refused(all_readers, tmp_path, parts):
    with confined():
        for reader in all_readers:
            assert failure(reader, b"".join(parts), tmp_path / "input") is None, (reader.name, parts)


def spinning(path):
    while True:
        pass


def refusing(path):
    raise RigError("no")


@pytest.mark.parametrize(
    ("read", "says"),
    [
        (spinning, "TooLong"),
        (lambda path: np.ones(1 << 28), "MemoryError"),
        (lambda path: int("x"), "ValueError"),
        (refusing, None),
        (lambda path: None, None),
    ],
)
def test_what_a_reader_does_wrong_is_seen(tmp_path, read, says):
    with confined():
        found = failure(Reader("any", (b"",), read), b"x", tmp_path / "input")
    assert found is None if says is None else found.startswith(says)
