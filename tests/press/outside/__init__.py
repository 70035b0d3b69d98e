"""Physics that the library does not have, one file each."""
