"""Files in and out, one format per file; `read_height_map` and `write_height_map` choose by the ending."""

import logging

from dlwpredict.files.heightmaps import read_height_map, write_height_map

__all__ = ["read_height_map", "write_height_map"]

logging.getLogger("tifffile").setLevel(logging.CRITICAL + 1)  # its errors reach the user as ours
