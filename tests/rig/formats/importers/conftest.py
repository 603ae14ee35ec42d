"""A good recording with poses, which tests write in other people's ways and import; none changes it."""

import pytest


@pytest.fixture(scope="package")
def good(tmp_path_factory):
    from tests.calib.checks.good import make

    return make("poses", tmp_path_factory.mktemp("good") / "rec")
