"""Files with many slow tests come first, so that all cores end together: `-p tests.longest_first`.

With `--dist loadfile` a file stays on one core, and the last one begun may keep it busy alone for minutes.
"""

from collections import Counter

FIRST = ("test_mission.py", "test_diagnose_anytime.py", "test_align_truth.py", "test_docs.py")
"""Files whose tests take the longest, whatever their number."""


def pytest_configure(config):
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False  # by the number of tests, which says little


def pytest_collection_modifyitems(items):
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    place = {name: k for k, name in enumerate(FIRST)}
    items.sort(key=lambda item: (place.get(item.path.name, len(FIRST)), -slow[item.path]))
