"""The noise of a height map: its covariance, where it is uneven, what whitens it, and how it is estimated."""
