"""Files in and out, one format per file; `read_height_map` and `write_height_map` choose by the ending."""

from dlwpredict.files.heightmaps import read_height_map, write_height_map

__all__ = ["read_height_map", "write_height_map"]
