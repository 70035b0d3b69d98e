"""The paper's chain as steps, and the two numerics that carry them out: levels (fast) and voxels (literal)."""
