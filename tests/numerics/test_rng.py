"""Random numbers: stratified within a pixel, uniform, decorrelated between pixels and dimension sets."""

import numpy as np
import pytest

from pointmr_engine.image.filters import TABLE_SIZE, filter_extent, filter_offset, filter_table, filter_weight
from pointmr_engine.numerics.rng import fill_4d, fill_pixel_seeds, pixel_seed, sample_1d, sample_2d, sample_4d
from pointmr_engine.numerics.sobol import direction_numbers, sobol_tables
from pointmr_engine.scene.errors import SceneError

TABLES = sobol_tables()


def sequence(n: int, seed: int, dimension_set: int = 0, first: int = 0) -> np.ndarray:
    out = np.empty((n, 4))
    fill_4d(
        TABLES,
        np.full(n, seed, np.uint32),
        dimension_set,
        np.arange(first, first + n, dtype=np.int32),
        out,
        0,
        n,
    )
    return out


def seeds_of(n: int, setting: int = 0) -> np.ndarray:
    x, y = (a.ravel().astype(np.int32) for a in np.meshgrid(np.arange(n), np.arange(n)))
    out = np.empty(n * n, np.uint32)
    fill_pixel_seeds(x, y, setting, out, 0, n * n)
    return out


def test_tables_are_the_sobol_sequence():
    """The byte tables give what the direction numbers give; the first points are the known ones."""

    def reverse(v: int) -> int:
        return int(f"{v:032b}"[::-1], 2)

    numbers = direction_numbers()
    for index in (0, 1, 2, 3, 77, 1023, 65536, 123456789, 2**32 - 1):
        for d in range(4):
            direct = 0
            for bit in range(32):
                if index >> bit & 1:
                    direct ^= int(numbers[d, bit])
            by_table = 0
            for byte in range(4):
                by_table ^= int(TABLES[d, byte, (reverse(index) >> 8 * byte) & 255])
            assert reverse(by_table) == direct
    eighths = (numbers >> np.uint32(29)).astype(int)
    assert (eighths[:, 0] == 4).all() and eighths[0, 1] == 2 and eighths[1, 1] == 6 and eighths[2, 1] == 6


@pytest.mark.parametrize("log2", [2, 4, 6, 8, 10])
def test_two_dimensional_projection_is_a_net(log2):
    """Every elementary interval of the first two dimensions holds one of 2^m points, from any aligned start."""
    n = 2**log2
    for seed, start in ((1, 0), (0xDEADBEEF, 0), (77, n), (5, 6 * n)):
        points = sequence(n, seed, dimension_set=3, first=start)
        for a in range(log2 + 1):
            across, down = 2**a, 2 ** (log2 - a)
            cell = (points[:, 0] * across).astype(int) * down + (points[:, 1] * down).astype(int)
            assert len(np.unique(cell)) == n
    two = np.array([sample_2d(TABLES, np.uint32(9), 2, i) for i in range(n)])
    side = 2 ** (log2 // 2)
    assert (
        len(np.unique((two[:, 0] * side).astype(int) * side + (two[:, 1] * side).astype(int))) == side * side
    )
    one = np.array([sample_1d(TABLES, np.uint32(9), 2, i) for i in range(n)])
    assert len(np.unique((one * n).astype(int))) == n


def test_every_dimension_is_stratified():
    points = sequence(256, 1234)
    for d in range(4):
        assert len(np.unique((points[:, d] * 256).astype(int))) == 256


def test_uniform_over_pixels():
    """A fixed sample index over many pixels is uniform, in each dimension and in the plane of each two."""
    seeds = seeds_of(128)
    assert len(np.unique(seeds)) > len(seeds) - 5
    for index in (0, 1, 17):
        out = np.empty((len(seeds), 4))
        fill_4d(TABLES, seeds, 0, np.full(len(seeds), index, np.int32), out, 0, len(seeds))
        assert out.min() >= 0.0 and out.max() < 1.0
        for a in range(4):
            for b in range(a + 1, 4):
                cells = (out[:, a] * 16).astype(int) * 16 + (out[:, b] * 16).astype(int)
                counts = np.bincount(cells, minlength=256)
                chi2 = ((counts - len(seeds) / 256) ** 2).sum() / (len(seeds) / 256)
                assert 150 < chi2 < 390  # 255 degrees of freedom: five sigma to either side


def test_neighbours_sets_and_indices_are_uncorrelated():
    """No correlation between neighbouring pixels, dimension sets, consecutive indices, seeds."""
    n = 128
    images = {}
    for setting in (0, 1):
        for dimension_set in (0, 1, 2):
            for index in (0, 1, 2):
                out = np.empty((n * n, 4))
                fill_4d(
                    TABLES,
                    seeds_of(n, setting),
                    dimension_set,
                    np.full(n * n, index, np.int32),
                    out,
                    0,
                    n * n,
                )
                for d in range(4):
                    images[setting, dimension_set, d, index] = out[:, d].reshape(n, n) - 0.5
    base = images[0, 0, 0, 0]
    limit = 5.0 / n * (1 / 12)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)):
        assert abs(np.mean(base * np.roll(base, (dy, dx), (0, 1)))) < limit
    for key, image in images.items():
        same_set = key[:2] == (0, 0)
        if not same_set:
            assert abs(np.mean(base * image)) < limit, key
        elif key[3] == 0 and key[2] > 0:
            assert abs(np.mean(base * image)) < limit, key


def test_error_falls_like_scrambled_nets():
    """Error of smooth, edged and four-dimensional integrands: far below random, with the slope of scrambled nets."""

    def smooth(p):
        return np.exp(-3.0 * (p[..., 0] + 0.5 * p[..., 1]))

    def disc(p):
        return ((p[..., 0] ** 2 + p[..., 1] ** 2) < 1.0).astype(float)

    def four(p):
        return np.prod(1.0 + 0.7 * (p - 0.5), axis=-1)

    exact = {
        smooth: (1 - np.exp(-3.0)) / 3.0 * (1 - np.exp(-1.5)) / 1.5,
        disc: np.pi / 4,
        four: 1.0,
    }
    rng = np.random.default_rng(1)
    seeds = rng.integers(0, 2**32, 64, dtype=np.uint32)

    def error(f, n):
        return np.sqrt(np.mean([(f(sequence(n, s)).mean() - exact[f]) ** 2 for s in seeds]))

    for f, at_256, slope in ((smooth, 0.02, -1.3), (disc, 0.35, -0.65), (four, 0.06, -1.1)):
        random = np.sqrt(f(rng.random((200_000, 4))).var() / 256)
        assert error(f, 256) < at_256 * random
        measured = np.log(error(f, 1024) / error(f, 16)) / np.log(64)
        assert measured < slope


def test_seed_setting_changes_everything():
    assert pixel_seed(3, 4, 0) != pixel_seed(3, 4, 1)
    assert pixel_seed(3, 4, 0) != pixel_seed(4, 3, 0)
    a, b = sequence(64, pixel_seed(3, 4, 0)), sequence(64, pixel_seed(3, 4, 1))
    assert (np.abs(a - b) > 1e-6).mean() > 0.99
    assert sample_4d(TABLES, np.uint32(5), 0, 7) == sample_4d(TABLES, np.uint32(5), 0, 7)


@pytest.mark.parametrize(
    "kind, width", [("box", 1.5), ("gaussian", 1.5), ("gaussian", 4.0), ("blackman_harris", 1.5)]
)
def test_filters_distribute_samples_as_their_profile(kind, width):
    table = filter_table(kind, width)
    assert len(table) == TABLE_SIZE and table[TABLE_SIZE // 2] == 0.0
    assert np.allclose(table, -table[::-1]) and np.isclose(table[-1], filter_extent(kind, width))
    u = (np.arange(100_000) + 0.5) / 100_000
    offsets = np.array([filter_offset(table, v) for v in u])
    counts, edges = np.histogram(offsets, 60, (-table[-1], table[-1]))
    fine = np.linspace(-table[-1], table[-1], 60 * 64 + 1)
    weight = filter_weight(kind, width, 0.5 * (fine[1:] + fine[:-1])).reshape(60, 64).sum(1)
    assert np.abs(counts / len(u) - weight / weight.sum()).max() < 2e-3
    if kind == "gaussian":  # the last entry of the table spreads the tail a little, as it does in Cycles
        assert np.isclose(offsets.std(), width / 4, rtol=0.015)
    assert filter_offset(table, 0.5) == 0.0 and filter_offset(table, 1.0) == table[-1]


def test_filters_refuse_what_they_do_not_know():
    with pytest.raises(SceneError, match="mitchell"):
        filter_table("mitchell", 1.5)
    with pytest.raises(SceneError, match="positive"):
        filter_table("gaussian", 0.0)
