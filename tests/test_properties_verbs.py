"""What holds for every calibration, alignment and pre-compensation."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from dlwpredict import designs
from dlwpredict.alignment import align
from dlwpredict.calibration import calibrate
from dlwpredict.correction.limits import LEAST_SLICE_UM, Limits
from dlwpredict.correction.precompensate import precompensate
from dlwpredict.errors import InputError, ResultError
from dlwpredict.heightmap import HeightMap
from dlwpredict.infer.free import choose
from dlwpredict.infer.recording import prepare
from dlwpredict.model.levels import Levels
from dlwpredict.parameters import Paper, ParameterSet, declarations
from dlwpredict.process import predict
from tests.strategies import between, processes, targets

ONE = Levels(threads=1)
SEEDS = st.integers(0, 2**32 - 1)

properties = settings(max_examples=25, deadline=None, derandomize=True)
few = settings(properties, max_examples=5)


def air(size_um=20.0, seed=1) -> HeightMap:
    return designs.air(size_um=size_um, pitch_um=0.5, margin_um=3.0, seed=seed)


class TestCalibrate:
    @pytest.mark.slow
    @pytest.mark.long
    @few
    @given(
        start=processes(),
        truth=processes(),
        moved=st.sets(st.sampled_from(list(declarations(Paper))), min_size=1, max_size=3),
        spikes=between(0.0, 0.1),
        relative=st.booleans(),
        robust=st.booleans(),
        free_shift=st.booleans(),
        seed=SEEDS,
    )
    def test_never_ends_worse_than_it_started(self, start, truth, moved, spikes, relative, robust, free_shift, seed):
        """In the loss that it minimises, whatever the recording."""
        target, rng = air(), np.random.default_rng(seed)
        heights = predict(target, truth, numerics=ONE).heights_um + 0.02 * rng.normal(size=target.shape)
        heights = heights + np.where(rng.random(target.shape) < spikes, rng.uniform(-3, 6, target.shape), 0)
        recorded = replace(target.with_heights(heights), height_reference="relative" if relative else "substrate")
        free = choose(start, fix=[name for name in declarations(Paper) if name not in moved])
        found = calibrate([prepare(target, recorded, free_shift=free_shift)], free, robust=robust, profile=False)
        assert found.end.cost <= found.start.cost
        assert (found.end.vector >= free.low).all() and (found.end.vector <= free.high).all()
        assert found.parameters.paper.shrinkage_min <= found.parameters.paper.shrinkage_max

    @pytest.mark.slow
    @pytest.mark.long
    @few
    @given(start=processes(), truth=processes(), seed=SEEDS)
    def test_neither_does_the_simplex(self, start, truth, seed):
        target, rng = air(), np.random.default_rng(seed)
        heights = predict(target, truth, numerics=ONE).heights_um + 0.02 * rng.normal(size=target.shape)
        free = choose(start, fix=[name for name in declarations(Paper) if not name.startswith("shrinkage")])
        recording = prepare(target, target.with_heights(heights))
        found = calibrate([recording], free, method="simplex", profile=False)
        assert found.end.rmse_um() <= found.start.rmse_um() + 1e-4


class TestAlign:
    @pytest.mark.slow
    @pytest.mark.long
    @settings(few, max_examples=3)
    @given(
        turn_deg=between(-180.0, 180.0),
        shift_um=st.tuples(between(-1.5, 1.5), between(-1.5, 1.5)),
        tilt_mrad=between(-20.0, 20.0),
        seed=SEEDS,
    )
    def test_what_is_aligned_stays(self, turn_deg, shift_um, tilt_mrad, seed):
        """To a tenth of a pixel and the noise; twice aligned is aligned once."""
        target, rng = air(16.0), np.random.default_rng(seed)
        turned = align(recorded(target, turn_deg, shift_um, tilt_mrad, rng), target, distortion="rigid")
        again = align(turned.aligned, target, distortion="rigid")
        np.testing.assert_allclose(again.pose.shift_um, 0, atol=0.05)
        np.testing.assert_allclose(again.pose.matrix, np.eye(2), atol=2e-3)
        np.testing.assert_allclose(again.tilt_mrad, 0, atol=0.5)
        known = turned.aligned.measured & again.aligned.measured
        change = (again.aligned.heights_um - turned.aligned.heights_um)[known]
        assert np.sqrt(np.mean(change**2)) < 0.02


def recorded(target, turn_deg, shift_um, tilt_mrad, rng) -> HeightMap:
    """Return a wider recording of the target, turned and shifted: means over its pixels of 4 x 4 points.

    Between the target's points heights run linearly. Points read one by one would not do: they alias, and what they
    alias to is turned or shifted by up to half a pixel.
    """
    pitch, side = target.dx_um, 2 * target.shape[1]
    axis = ((np.arange(4 * side) + 0.5) / 4 - side / 2) * pitch
    x, y = np.meshgrid(axis - shift_um[0], axis[::-1] - shift_um[1])
    turn = np.deg2rad(turn_deg)
    back_x, back_y = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    rows, cols = target.shape
    place = [(rows - 1) / 2 - back_y / pitch, (cols - 1) / 2 + back_x / pitch]
    points = ndimage.map_coordinates(target.heights_um, place, order=1, mode="constant") + 1e-3 * tilt_mrad * x
    heights = points.reshape(side, 4, side, 4).mean(axis=(1, 3))
    return HeightMap(heights + 0.01 * rng.normal(size=heights.shape), pitch, pitch)


class TestPrecompensate:
    @pytest.mark.slow
    @properties
    @given(targets(most_px=24), processes(), st.integers(1, 8), st.sampled_from([0, 5]), between(0.0, 1.0))
    def test_ends_bounded_even_where_the_target_is_out_of_reach(self, target, process, most, memory, slicing_um):
        """Lines thinner than the focus, heights above the maximum of the press: it ends and says what is missing."""
        calls = 0

        def printed(written: HeightMap) -> HeightMap:
            nonlocal calls
            calls += 1
            return predict(written, process, numerics=ONE)

        maximum_um = 1.2 * float(target.heights_um.max())
        if slicing_um and not LEAST_SLICE_UM <= slicing_um <= maximum_um:
            with pytest.raises(InputError, match="--slicing-um"):
                Limits(maximum_um=maximum_um, slicing_um=slicing_um)
            return
        limits = Limits(maximum_um=maximum_um, slicing_um=slicing_um)
        try:
            found = precompensate(target, printed, limits=limits, most_predictions=most, memory=memory)
        except ResultError as problem:
            assert "no step lowers" in str(problem)
            return
        finally:
            assert calls <= most + 2
        written = found.corrected.heights_um
        assert np.isfinite(written).all() and written.min() >= 0 and written.max() <= limits.maximum_um + 1e-9
        np.testing.assert_array_equal(written > 0, target.heights_um > 0)
        if slicing_um == 0:
            assert found.as_dict()["rmse_um"]["after"] <= found.as_dict()["rmse_um"]["before"]

    @properties
    @given(targets(most_px=16), between(-3.0, 5.0), between(0.0, 4.0), st.sampled_from([0, 5]))
    def test_ends_for_prints_of_any_gain(self, target, gain, offset_um, memory):
        """Wrong sign, no answer at all, wild overshoot: an end in any case, and never worse than the start."""

        def printed(written: HeightMap) -> HeightMap:
            return written.with_heights(gain * written.heights_um + offset_um)

        try:
            found = precompensate(target, printed, memory=memory, most_predictions=12)
        except ResultError:
            assert gain < 0.2 or gain > 1
            return
        assert found.as_dict()["rmse_um"]["after"] <= found.as_dict()["rmse_um"]["before"]

    def test_slices_coarser_than_the_maximum_leave_at_most_the_maximum(self):
        target = HeightMap(np.pad(np.full((6, 6), 0.4), 3), 0.2, 0.2)
        found = precompensate(target, lambda written: written, limits=Limits(maximum_um=0.5, slicing_um=0.2))
        assert found.corrected.heights_um.max() == pytest.approx(0.4)


@pytest.mark.slow
def test_a_process_is_its_own_truth():
    """Calibrated on its own print, as a file keeps it, and from its own values, a process stays where it is.

    The file rounds to 2e-7 µm; the axial width of the focus, which one structure hardly shows, feels it most.
    """
    target, process = air(), ParameterSet()
    heights = predict(target, process, numerics=ONE).heights_um.astype(np.float32)
    found = calibrate([prepare(target, target.with_heights(heights))], choose(process), profile=False)
    np.testing.assert_allclose(found.end.vector, choose(process).start, rtol=1e-4)
