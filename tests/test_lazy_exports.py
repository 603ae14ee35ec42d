"""Every name that a package hands on is there and listed: they are looked up only when somebody asks."""

import importlib

import pytest


@pytest.mark.parametrize("name", ["rig", "vision", "calib", "synthetic"])
def test_every_name_that_is_handed_on_is_there_and_listed(name):
    package = importlib.import_module(name)
    assert set(package.__all__) <= set(dir(package))
    assert [one for one in getattr(package, "__all__", ()) if getattr(package, one, None) is None] == []
