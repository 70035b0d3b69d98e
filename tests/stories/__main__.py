"""Tell stories of concealed physics: run their steps, judge their claims, write their pages.

python -m tests.stories RUN_DIR [NAME ...]      what `make stories` does
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from tests.stories import STORIES, page
from tests.stories.bench import Bench


def main(words: Sequence[str]) -> int:
    """Tell the stories named, all if none is; return 1 if a claim does not hold."""
    root, names = Path(words[0]), list(words[1:]) or list(STORIES)
    unknown = [name for name in names if name not in STORIES]
    if unknown:
        print(f"error: {unknown[0]}: no such story; allowed: {', '.join(STORIES)}", file=sys.stderr)
        return 2
    all_hold = True
    for name in names:
        started, bench = time.monotonic(), Bench(root / name)
        told = STORIES[name].tell(bench)
        page.publish(bench.folder, name, told, bench.steps)
        print(f"{told.title} ({time.monotonic() - started:.0f} s): {bench.folder / 'README.md'}")
        for one in told.claims:
            print(f"  {'holds' if one.holds else 'DOES NOT HOLD'}: {one.words}: {one.found}", flush=True)
        all_hold &= all(one.holds for one in told.claims)
    page.index(root)
    return 0 if all_hold else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
