"""Written lines: where they start and end, and what one leaves to the next."""

import numpy as np


def lag_weights(lag_um, pitch):
    """Return the weights of exp(-s/lag)/lag, s > 0, integrated over the pixels 0, 1, 2, ... that lie behind."""
    count = int(np.ceil(12 * lag_um / pitch)) + 2
    edges = np.concatenate([[0.0], (np.arange(count) + 0.5) * pitch])
    return -np.diff(np.exp(-edges / lag_um))


def trailed(values, lag_um, pitch, direction):
    """Smear along y (the last but one axis, upwards), to the side that the scanner goes to; zeros come in."""
    turned = values if direction > 0 else values[..., ::-1, :]
    out = np.zeros(turned.shape)
    for step, weight in enumerate(lag_weights(lag_um, pitch)[: turned.shape[-2]]):
        out[..., step:, :] += weight * turned[..., : turned.shape[-2] - step, :]
    return out if direction > 0 else out[..., ::-1, :]


def from_start(written, pitch):
    """Return the distance in um along +y from the start of a voxel's written segment; infinite if unwritten."""
    row = np.arange(written.shape[-2])[:, None]
    last_gap = np.maximum.accumulate(np.where(written, -1, row), axis=-2)
    return np.where(written, (row - last_gap - 0.5) * pitch, np.inf)


def from_end(written, pitch):
    """Return the distance in um along y to the end of the segment."""
    return from_start(written[..., ::-1, :], pitch)[..., ::-1, :]


def left_behind(written, length_um, pitch, direction):
    """Return what the lines before left: a one-sided exponential along x without lag 0, plateau 1."""
    turned = written if direction > 0 else written[..., ::-1]
    keep = np.exp(-pitch / length_um)
    out = np.zeros(turned.shape)
    for column in range(1, turned.shape[-1]):
        out[..., column] = keep * out[..., column - 1] + (1 - keep) * turned[..., column - 1]
    return out if direction > 0 else out[..., ::-1]


def carried_up(values, written):
    """Give each voxel that its own layer does not reach the value of the layer below (for partly filled top voxels)."""
    out = values.copy()
    out[1:] = np.where(written[1:], values[1:], values[:-1])
    return out
