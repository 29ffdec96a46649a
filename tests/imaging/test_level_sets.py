"""Level sets: compared with a plain NumPy sweep for two, and on images with known answer."""

import numpy as np
import pytest

from myork.core.deck import table_defaults
from myork.core.level_sets import evolve_level_sets
from myork.records import Image
from myork.segmentation.channels import scaled_values
from myork.segmentation.level_sets import LevelSets, segment_regions, wanted_phase
from myork.segmentation.regions import otsu
from myork.segmentation.scores import dice
from myork.segmentation.starts import kmeans, level_sets_of, regions_of
from tests.images import centred
from tests.scenes import refuses

DEFAULTS = table_defaults("image")
STEERING = {key: DEFAULTS[key] for key in ("mu", "tolerance")}
STEERING |= {"iterations": 300, "nu": 0.0, "epsilon": 0.5, "dt": 500.0}


def choice(**changes):
    """Level sets as in a deck without settings, with some fields changed."""
    return LevelSets.of_table(DEFAULTS, **changes)


def evolve(channels, phi, **change):
    """The core with unit weights; `change` gives the differences."""
    options = {"spacing": (1.0, 1.0), **STEERING, **change}
    weight = options.pop("weight", np.ones(channels.shape[:3]))
    options.setdefault("lambdas", np.ones((channels.shape[-1], 2 ** phi.shape[-1])))
    return evolve_level_sets(channels, weight, phi, **options)


def shifted(a, axis, side):
    """Neighbours along an axis; at the edge of the image the value itself."""
    return np.take(a, np.clip(np.arange(n := a.shape[axis]) + side, 0, n - 1), axis)


def numpy_step(u, phi, *, mu, nu, epsilon, dt, spacing, lambdas):
    """One step of (A.1) for two level sets and any channels, written out; and the energy."""
    axes = range(2)
    h1, h2 = (0.5 + np.arctan(phi[..., k] / epsilon) / np.pi for k in (0, 1))
    members = [(1 - h1) * (1 - h2), h1 * (1 - h2), (1 - h1) * h2, h1 * h2]
    misfits, energy = [], 0.0
    for member, weights in zip(members, lambdas.T, strict=True):
        c = (u * member[..., None]).sum((0, 1, 2)) / member.sum()
        misfits.append(((u - c) ** 2 * weights).mean(-1))
        energy += (misfits[-1] * member).sum()
    forces = (
        (misfits[0] - misfits[1]) * (1 - h2) + (misfits[2] - misfits[3]) * h2,
        (misfits[0] - misfits[2]) * (1 - h1) + (misfits[1] - misfits[3]) * h1,
    )
    new = np.empty_like(phi)
    for k, force in enumerate(forces):
        p = phi[..., k]
        delta = epsilon / (np.pi * (epsilon**2 + p**2))
        h = (h1, h2)[k]
        slope, pull, drawn = 0.0, 0.0, 0.0
        for d in axes:
            rise = (shifted(h, d, 1) - h) ** 2 + (h - shifted(h, d, -1)) ** 2
            slope = slope + rise / (2 * spacing[d] ** 2)
            square = ((shifted(p, d, 1) - p) / spacing[d]) ** 2 + 1e-8
            for e in {*axes} - {d}:
                square += ((shifted(p, e, 1) - shifted(p, e, -1)) / (2 * spacing[e])) ** 2
            a = 1 / np.sqrt(square) / spacing[d] ** 2
            np.moveaxis(a, d, 0)[-1] = 0.0  # no flux through the edge of the image
            b = np.roll(a, 1, d)
            pull = pull + a + b
            drawn = drawn + a * shifted(p, d, 1) + b * shifted(p, d, -1)
        energy += (mu[k] * np.sqrt(slope) + nu * h).sum()
        top = p + dt * delta * (mu[k] * drawn + force - nu)
        new[..., k] = top / (1 + dt * delta * mu[k] * pull)
    return new, energy * np.prod([spacing[d] for d in axes])


@pytest.mark.parametrize("spacing", [(1.0, 1.0), (1.0, 1.7), (4.0, 1.0)])
def test_steps_equal_plain_numpy(spacing):
    random, shape = np.random.default_rng(3), (17, 13, 1)
    u, phi = random.random((*shape, 3)), [random.random((*shape, 2)) - 0.5]
    lambdas = np.array([1.0, 0.5, 2.0])[:, None] * [1.2, 0.8, 1.0, 0.6] + random.random((3, 4)) / 4
    keys = dict(mu=[0.02, 0.05], nu=0.01, epsilon=0.5, dt=0.7, spacing=spacing, lambdas=lambdas)
    found = evolve(u, phi[0], tolerance=0.0, iterations=9, **keys)
    energies = []
    for _ in range(10):
        new, energy = numpy_step(u, phi[-1], **keys)
        phi.append(new)
        energies.append(energy)
    assert found["iterations"][0] == 9 and (np.diff(energies) < 0).all()
    np.testing.assert_allclose(found["phi"], phi[9], atol=1e-12)
    np.testing.assert_allclose(found["energy"][:, 0], energies, rtol=1e-12)


def test_slices_are_independent():
    u = np.random.default_rng(7).random((20, 18, 3, 1))
    alone = [evolve(u[:, :, [k]], u[:, :, [k]] - 0.5)["phi"] for k in range(3)]
    stack = evolve(u, u - 0.5)["phi"]
    assert np.array_equal(stack, np.concatenate(alone, axis=2))


@pytest.mark.parametrize("dt", [0.5, 50.0, 5000.0])
@pytest.mark.parametrize("mu", [0.0, 0.01, 0.3])
def test_energy_never_rises(mu, dt):
    random = np.random.default_rng(9)
    u, start = random.random((24, 24, 1, 2)), random.random((24, 24, 1, 3)) - 0.5
    energy = evolve(u, start, mu=mu, dt=dt)["energy"][:, 0]
    assert (np.diff(energy) <= 0).all() and energy[-1] < energy[0]


def test_weight_of_a_voxel_counts_it_so_often():
    """Without contour length, weight 2 everywhere equals lambda 2."""
    u = np.random.default_rng(2).random((15, 15, 1, 1))
    keys = dict(iterations=20, dt=5.0, mu=0.0)
    twice = evolve(u, u - 0.5, weight=np.full((15, 15, 1), 2.0), **keys)["phi"]
    np.testing.assert_allclose(twice, evolve(u, u - 0.5, lambdas=[[2.0, 2.0]], **keys)["phi"])


def disc(noise=0.0):
    inside = np.hypot(*centred(64, 64, 1)[:2]) < 18.0
    random = np.random.default_rng(5)
    u = np.where(inside, 0.3, 0.7) + random.normal(0, noise, inside.shape)
    return Image(u, np.eye(4), "disc"), inside


#: Labels of the pixels of a disc
THREE = np.arange(64 * 64).reshape(64, 64, 1) % 3


def phase_of(image, region, phase="dark", labels=None, **change):
    grey = scaled_values(image, region)
    result = segment_regions(
        grey[..., None], region, choice(**change),
        spacing=image.spacing, labels=labels, name=image.name,
    )  # fmt: skip
    return wanted_phase(result, grey, phase), result


@pytest.mark.parametrize("start", ["otsu", "kmeans"])
@pytest.mark.parametrize("phase", ["dark", "bright"])
def test_noisy_disc(start, phase):
    image, inside = disc(noise=0.12)
    wanted = inside if phase == "dark" else ~inside
    found, result = phase_of(image, inside >= 0, phase, mu=0.05, start=start)
    # Noise of 0.3 of the contrast: the threshold alone is wrong in some per cent of the pixels.
    assert dice(found, wanted) > 0.985
    assert not result.unrest


def test_length_weight_removes_small_regions():
    image, inside = disc(noise=0.0)
    image.data[4:6, 4:6] = 0.3
    kept, gone = (phase_of(image, inside >= 0, mu=mu)[0] for mu in (1e-4, 0.6))
    assert kept[4:6, 4:6].all() and not gone[4:6, 4:6].any()
    assert dice(gone, inside) > 0.97


def test_pixels_outside_the_region_play_no_part():
    image, _ = disc(noise=0.05)
    region = np.zeros(image.data.shape, bool)
    region[8:56, 8:56] = True
    changed = Image(np.where(region, image.data, np.nan), image.affine)
    a, b = (phase_of(one, region)[0] for one in (image, changed))
    assert np.array_equal(a, b) and not a[~region].any()


def test_regions_survive_level_sets():
    regions = np.random.default_rng(0).integers(0, 8, (6, 5, 4)).repeat(4, 0).repeat(4, 1)
    again = regions_of(level_sets_of(regions.astype(np.int32), 8), 8)
    # Blocks of 4 pixels; smoothing may round their corners.
    assert (again == regions).mean() > 0.9
    # the user's labels as start
    image, inside = disc(noise=0.05)
    start = 7 * np.roll(inside, 5, axis=0).astype(np.int32)
    _, result = phase_of(image, inside >= 0, labels=start, mu=0.05)
    assert dice(result.region == 1, inside) > 0.985


def test_kmeans_finds_heaps_in_order_and_repeats_itself():
    random = np.random.default_rng(0)
    heaps = np.array([[0.9, 0.1], [0.1, 0.9], [0.5, 0.5]])
    which = random.integers(0, 3, 500)
    values = heaps[which] + random.normal(0, 0.05, (500, 2))
    found, centres = kmeans(values, 3)
    np.testing.assert_allclose(centres, heaps[[1, 2, 0]], atol=0.02)
    assert np.array_equal(found, np.array([2, 0, 1])[which])
    assert np.array_equal(found, kmeans(values, 3)[0])
    assert kmeans(np.zeros((5, 1)), 3)[0].shape == (5,)
    # fewer values than clusters
    assert kmeans(np.arange(2.0)[:, np.newaxis], 3)[0].tolist() == [0, 1]
    assert 1.0 < otsu(np.repeat([1.0, 5.0], [700, 300])) < 5.0


@pytest.mark.parametrize(("change", "message"), [
    ({"labels": THREE}, "the start has 3 regions, image.regions is 2"),
    ({"mu": [0.1, 0.2]}, "image.mu has 2 weights; give one for all level sets or one for each"),
    ({"regions": 3, "start": "otsu"}, "'otsu' makes two regions"),
])  # fmt: skip
def test_impossible_choices(change, message):
    image, inside = disc()
    refuses(message, phase_of, image, inside >= 0, **change)


def test_regions_without_an_image():
    u = np.zeros((4, 4, 3, 2))
    u[1, 1, 2, 1] = np.nan
    said, there = r"channel 1 is not finite at voxel \(1, 1, 2\)", np.ones((4, 4, 3), bool)
    refuses(said, segment_regions, u, there, choice(), spacing=(1, 1, 1))
    refuses("must be finite", evolve, u[..., :1] * 0, u[..., :1] + np.inf)
    image, _ = disc()
    refuses("region to segment is empty", phase_of, image, image.data < 0)
    flat = Image(np.ones((8, 8, 1)), np.eye(4), "flat.nii")
    refuses("flat.nii: the region to segment has one grey value", phase_of, flat, flat.data > 0)
