"""The effects of the library's list, one file each, with the press's own numerics."""
