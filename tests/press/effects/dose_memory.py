"""Dose memory: each line meets resin that the lines before have prepared.

literal: D = 1 + gain (k_L * written), k_L a one-sided exponential along the hatch direction without lag 0, in each
         layer; D is the intensity of the line that is being written (under the convolution).
point:   the same D, but multiplying the exposure of each point; just above a top, where nothing is written, D = 1.
time:    the lines are written one after the other; between two of them passes the time that the line itself takes
         (length / speed + turnaround), the memory decays by exp(-dt/tau) and diffuses along the line by
         sqrt(2 D_m dt). tau is such that full lines (`full_line_um`) at the hatch pitch give the length L, so short
         lines leave a longer memory.
"""

from dataclasses import dataclass

import numpy as np

from tests.press.effect import PrintEffect, effect
from tests.press.lines import carried_up, left_behind


@effect("dose-memory")
@dataclass(frozen=True)
class DoseMemory(PrintEffect):
    """Gain without unit, length in um; direction +1 hatches towards +x."""

    models = ("literal", "point", "time")
    gain: float = 0.0
    length_um: float = 8.0
    direction: int = 1
    conversion: float | None = None
    model: str = "literal"
    hatch_um: float = 0.1
    speed_um_per_s: float = 2e4
    turnaround_ms: float = 1.0
    full_line_um: float = 100.0
    diffusivity_um2_per_s: float = 10.0

    @property
    def at_focus(self):
        """Whether D belongs to the line being written."""
        return self.model != "point"

    def dose(self, scene):
        if self.gain == 0:
            return None
        if self.model == "point":
            return 1 + self.gain * left_behind(scene.fill, self.length_um, scene.grid.dx, self.direction)
        written = scene.reached.astype(np.float32)
        if self.model == "time":
            memory = self._in_time(written, scene.grid)
        else:
            memory = left_behind(written, self.length_um, scene.grid.dx, self.direction)
        return carried_up(1 + self.gain * memory, scene.reached)

    def _in_time(self, written, grid):
        """Walk over the lines, all layers at once, along-line diffusion in the Fourier domain."""
        written = written if self.direction > 0 else written[..., ::-1]
        lines = grid.dx / self.hatch_um  # written lines per column of pixels
        pause = self.turnaround_ms * 1e-3
        tau = self.length_um / self.hatch_um * (self.full_line_um / self.speed_um_per_s + pause)
        rows = written.shape[-2] + int(np.ceil(4 * self.length_um / grid.dy))
        wave = 2 * np.pi * np.fft.rfftfreq(rows, grid.dy)
        spectrum = np.fft.rfft(written, rows, axis=-2)
        memory = np.zeros_like(spectrum)
        for column in range(1, written.shape[-1]):
            before = spectrum[..., column - 1]
            took = lines * (before[:, 0].real * grid.dy / self.speed_um_per_s + pause)
            decay = np.exp(-took / tau)[:, None]
            blur = np.exp(-self.diffusivity_um2_per_s * took[:, None] * wave**2)
            deposit = -np.expm1(-grid.dx / self.length_um)
            memory[..., column] = decay * blur * memory[..., column - 1] + deposit * np.sqrt(blur) * before
        left = np.fft.irfft(memory, rows, axis=-2)[..., : written.shape[-2], :]
        return left if self.direction > 0 else left[..., ::-1]
