"""The summary of what the tests ran."""

from tests.coverage_by_folder import shares, table


def file(run, total):
    return {"summary": {"covered_lines": run, "num_statements": total}}


def test_folders_count_all_below_them_and_packages_their_folders():
    report = {
        "files": {
            "rig/errors.py": file(3, 4),
            "rig/effects/catalogue/creep.py": file(5, 10),
            "rig/effects/base.py": file(1, 2),
            "vision/opencv_lens_model.py": file(0, 7),
            "calib/__init__.py": file(0, 0),
        }
    }
    found = shares(report)
    assert found == {"calib": (0, 0), "rig": (9, 16), "rig/effects": (6, 12), "vision": (0, 7)}
    lines = [line.split() for line in table(found).splitlines()]
    assert lines[0] == ["calib", "none", "0", "of", "0"] and lines[1] == ["rig", "56.2", "%", "9", "of", "16"]
    assert lines[-1] == ["all", "39.1", "%", "9", "of", "23"]
