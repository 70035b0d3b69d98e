"""Large maps: predicted tile by tile, each with a halo as wide as the physics reaches."""
