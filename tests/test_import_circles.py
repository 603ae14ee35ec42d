"""No module imports itself by way of others, imports for types alone counted too."""

import grimp
import pytest

ROOMS = ("rig", "vision", "calib", "synthetic")


def circles(imports):
    """Groups of modules that reach one another, of {module: modules that it imports}."""
    left = {module: set(others) for module, others in imports.items()}
    while True:  # who imports nothing that is left, or is imported by nothing that is left, is in no circle
        used = set().union(*left.values()) if left else set()
        outside = {module for module, others in left.items() if not others or module not in used}
        if not outside:
            return left
        left = {module: others - outside for module, others in left.items() if module not in outside}


def test_a_circle_is_found():
    assert set(circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"b"}, "e": set()})) == {"b", "c"}


@pytest.fixture(scope="module")
def graph():
    return grimp.build_graph(*ROOMS, exclude_type_checking_imports=False, cache_dir=None)


def test_no_module_imports_itself_by_way_of_others(graph):
    assert circles({module: graph.find_modules_directly_imported_by(module) for module in graph.modules}) == {}
