"""Two-phase level sets: against a plain NumPy sweep, and on images with a known answer."""

import os
import subprocess
import sys

import numpy as np
import pytest

from myork.core_image import evolve_two_phase
from myork.errors import InputError
from myork.imaging.phantom import make_phantom
from myork.records import Image
from myork.segmentation.level_sets import two_phase
from myork.segmentation.regions import body_mask, box_mask, otsu, piece_with_seed
from myork.segmentation.scores import dice

WEIGHTS = {
    "mu": 0.01,
    "nu": 0.0,
    "lambda1": 1.0,
    "lambda2": 1.0,
    "epsilon": 0.5,
    "dt": 50.0,
    "tolerance": 1e-4,
    "iterations": 300,
}


def numpy_sweeps(u, phi, count, *, mu, nu, lambda1, lambda2, epsilon, dt, spacing):
    """Scheme (A.1), (A.2) written with arrays; no flux across the image's edge."""
    hx, hy = spacing
    energy = []
    for _ in range(count):
        h = 0.5 + np.arctan(phi / epsilon) / np.pi
        delta = epsilon / (np.pi * (epsilon**2 + phi**2))
        c1, c2 = (u * h).sum() / h.sum(), (u * (1 - h)).sum() / (1 - h).sum()
        p = np.pad(phi, 1, mode="edge")
        east, west, north, south = p[2:, 1:-1], p[:-2, 1:-1], p[1:-1, 2:], p[1:-1, :-2]

        def size(a, b):
            return np.sqrt(a**2 + b**2 + 1e-8)

        a = size((east - phi) / hx, (north - south) / (2 * hy))
        b = size((phi - west) / hx, (p[:-2, 2:] - p[:-2, :-2]) / (2 * hy))
        c = size((east - west) / (2 * hx), (north - phi) / hy)
        d = size((p[2:, :-2] - p[:-2, :-2]) / (2 * hx), (phi - south) / hy)
        e1, e2 = lambda1 * (u - c1) ** 2, lambda2 * (u - c2) ** 2
        length = delta * np.hypot((east - west) / (2 * hx), (north - south) / (2 * hy))
        energy.append(hx * hy * (mu * length + nu * h + e1 * h + e2 * (1 - h)).sum())
        f = dt * delta * mu
        a, b, c, d = f / a / hx**2, f / b / hx**2, f / c / hy**2, f / d / hy**2
        a[-1], b[0], c[:, -1], d[:, 0] = 0, 0, 0, 0
        top = phi + a * east + b * west + c * north + d * south + dt * delta * (e2 - e1 - nu)
        phi = top / (1 + a + b + c + d)
    return phi, np.array(energy)


@pytest.mark.parametrize("spacing", [(1.0, 1.0), (1.0, 1.7)])
def test_sweeps_equal_plain_numpy(spacing):
    random = np.random.default_rng(3)
    u, start = random.random((2, 17, 13))
    start = start - 0.5
    weights = dict(mu=0.3, nu=0.05, lambda1=1.2, lambda2=0.8, epsilon=0.5, dt=0.7)
    expected, energy = numpy_sweeps(u, start, 9, spacing=spacing, **weights)
    phi, recorded, done = evolve_two_phase(
        u[..., None],
        np.ones((17, 13, 1)),
        start[..., None],
        spacing=spacing,
        tolerance=0.0,
        iterations=9,
        **weights,
    )
    np.testing.assert_allclose(phi[..., 0], expected, atol=1e-12)
    np.testing.assert_allclose(recorded[:, 0], energy, rtol=1e-12)
    assert done[0] == 9


def test_transposed_image_gives_transposed_result():
    """The old neighbours are used everywhere, so no order of sweeping shows.

    A mirrored image would give a slightly different result: (A.2b) and (A.2d) as printed take
    the slope along a face from one of its two sides.
    """
    random = np.random.default_rng(4)
    u = random.random((20, 20, 1))
    full = np.ones(u.shape)
    run = dict(spacing=(1.0, 1.0), **{**WEIGHTS, "iterations": 25})
    a = evolve_two_phase(u, full, u - 0.5, **run)[0]
    v = np.swapaxes(u, 0, 1)
    b = evolve_two_phase(v, full, v - 0.5, **run)[0]
    np.testing.assert_allclose(np.swapaxes(a, 0, 1), b, atol=1e-12)


def disc(n=64, radius=18.0, noise=0.0, seed=5):
    i, j = np.mgrid[:n, :n] - (n - 1) / 2
    inside = np.hypot(i, j) < radius
    u = np.where(inside, 0.3, 0.7) + np.random.default_rng(seed).normal(0, noise, (n, n))
    return Image(u[..., None], np.eye(4), "disc"), inside[..., None]


@pytest.mark.parametrize("start", ["otsu", "circles"])
@pytest.mark.parametrize("phase", ["dark", "bright"])
def test_noisy_disc(start, phase):
    image, inside = disc(noise=0.12)
    wanted = inside if phase == "dark" else ~inside
    region = np.ones(inside.shape, bool)
    weights = {**WEIGHTS, "mu": 0.05}
    result = two_phase(image, region, evolve_two_phase, weights, phase=phase, start=start)
    # Noise of 0.3 of the contrast: the threshold alone errs on some per cent of the pixels.
    assert dice(result.inside, wanted) > 0.985
    assert result.converged


def test_length_weight_removes_small_regions():
    image, inside = disc(noise=0.0)
    image.data[4:6, 4:6] = 0.3
    region = np.ones(inside.shape, bool)
    kept = two_phase(image, region, evolve_two_phase, {**WEIGHTS, "mu": 1e-4}).inside
    gone = two_phase(image, region, evolve_two_phase, {**WEIGHTS, "mu": 0.6}).inside
    assert kept[4:6, 4:6].all()
    assert not gone[4:6, 4:6].any()
    assert dice(gone, inside) > 0.97


def test_energy_does_not_rise_on_the_phantom():
    phantom = make_phantom()
    region = body_mask(phantom.anatomy)
    result = two_phase(phantom.anatomy, region, evolve_two_phase, WEIGHTS)
    assert (np.diff(result.energy) <= 1e-9 * result.energy[0]).all()
    assert result.energy[-1] < 0.7 * result.energy[0]
    assert result.converged


def test_medial_gastrocnemius_of_the_phantom():
    phantom = make_phantom()
    region = body_mask(phantom.anatomy) & box_mask(phantom.anatomy, [-8, 46, -50, -6, -1, 100])
    result = two_phase(phantom.anatomy, region, evolve_two_phase, WEIGHTS)
    piece = piece_with_seed(result.inside, phantom.anatomy, [19, -27, 42])
    truth = phantom.truth.data == 1
    assert dice(piece, truth) > 0.97
    for k in range(truth.shape[2]):
        assert dice(piece[:, :, k], truth[:, :, k]) > 0.95


def test_pixels_outside_the_region_play_no_part():
    image, _ = disc(noise=0.05)
    region = np.zeros(image.data.shape, bool)
    region[8:56, 8:56] = True
    changed = image.data.copy()
    changed[~region] = 1e6
    a = two_phase(image, region, evolve_two_phase, WEIGHTS)
    b = two_phase(Image(changed, image.affine), region, evolve_two_phase, WEIGHTS)
    assert np.array_equal(a.inside, b.inside)
    assert not a.inside[~region].any()


def test_one_and_two_threads_give_the_same_bits():
    code = (
        "import hashlib, numpy as np\n"
        "from myork.core_image import evolve_two_phase\n"
        "u = np.random.default_rng(1).random((40, 40, 6))\n"
        "r = evolve_two_phase(u, u > -1, u - .5, spacing=(1., 1.), mu=.02, nu=0., lambda1=1.,"
        " lambda2=1., epsilon=.5, dt=10., tolerance=0., iterations=40)\n"
        "print(hashlib.sha256(b''.join(a.tobytes() for a in r)).hexdigest())\n"
    )
    runs = [
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "OMP_NUM_THREADS": n},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for n in ("1", "2")
    ]
    assert runs[0] == runs[1] != ""


def test_otsu_parts_two_heaps():
    values = np.concatenate([np.full(700, 1.0), np.full(300, 5.0)])
    assert 1.0 < otsu(values) < 5.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"epsilon": 0.0}, "epsilon must be positive, not 0"),
        ({"dt": -1.0}, "dt must be positive, not -1"),
        ({"mu": -0.5}, "mu must not be negative, not -0.5"),
        ({"lambda2": 0.0}, "lambda1 and lambda2 must be positive"),
        ({"iterations": 0}, "iterations must be at least 1"),
    ],
)
def test_impossible_weights(change, message):
    image, _ = disc()
    with pytest.raises(InputError, match=message):
        two_phase(image, image.data > 0, evolve_two_phase, {**WEIGHTS, **change})


def test_not_a_number_in_the_mask_is_named():
    u = np.zeros((4, 4, 3))
    u[1, 1, 2] = np.nan
    with pytest.raises(InputError, match="Slice 2 has values that are not finite"):
        evolve_two_phase(u, np.ones(u.shape), u * 0, spacing=(1.0, 1.0), **WEIGHTS)


def test_empty_region_and_flat_region():
    image, _ = disc()
    with pytest.raises(InputError, match="region to segment is empty"):
        two_phase(image, image.data < 0, evolve_two_phase, WEIGHTS)
    flat = Image(np.ones((8, 8, 1)), np.eye(4), "flat.nii")
    with pytest.raises(InputError, match="flat.nii: the region to segment has one grey value"):
        two_phase(flat, flat.data > 0, evolve_two_phase, WEIGHTS)


def test_seed_outside_and_seed_in_the_other_phase():
    image, inside = disc()
    with pytest.raises(InputError, match="lies outside of disc"):
        piece_with_seed(inside, image, [900.0, 0.0, 0.0])
    with pytest.raises(InputError, match="does not lie in the segmented phase"):
        piece_with_seed(inside, image, [0.0, 0.0, 0.0])


def test_seed_picks_one_of_two_pieces():
    mask = np.zeros((10, 10, 2), bool)
    mask[1:3] = mask[6:9] = True
    affine = np.diag([-2.0, 2.0, 5.0, 1.0])
    image = Image(np.zeros(mask.shape), affine, "two")
    piece = piece_with_seed(mask, image, [-14.0, 8.0, 5.0])
    assert np.array_equal(piece[6:9], mask[6:9])
    assert not piece[:6].any()
