"""Tests of features, networks and weights files. They need no data: `python3 python/exposure/test_exposure.py`."""
import os
import sys
import tempfile
import unittest

import numpy as np

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import features
import panoramas as hdr

try:
    import network
    import torch
    from safetensors.numpy import load_file, save_file
except ImportError:
    torch = None
TORCH = unittest.skipIf(torch is None, "needs torch and safetensors")


def room(seed=0):
    """A panorama of random patches with two lamps, one of them across the first column."""
    random = np.random.default_rng(seed)
    panorama = 0.1 + 0.1 * random.random((16, 32, 3)).repeat(8, 0).repeat(8, 1)
    panorama[20:28, :3] = panorama[20:28, -4:] = [40.0, 30.0, 20.0]
    panorama[40:44, 100:110] = [3.0, 4.0, 9.0]
    return hdr.to_ev0(panorama)


def plain(panorama):
    """The photograph of a panorama at EV 0."""
    return hdr.photograph(panorama, hdr.Shot(), None)


def correction(count=2, dropout=0.0):
    """Networks with random weights and biases."""
    networks = network.Networks(count, seed=3, dropout=dropout)
    with torch.no_grad():
        for bias in networks.bias.values():
            bias.normal_(0, 0.1, generator=torch.Generator().manual_seed(4))
    return networks


class Panoramas(unittest.TestCase):
    def test_places_ignore_numbers_and_puresky(self):
        names = ["quarry_01", "quarry", "kloppenheim_05_puresky", "kloppenheim_06", "studio_small_08"]
        self.assertEqual([hdr.place(name) for name in names],
                         ["quarry", "quarry", "kloppenheim", "kloppenheim", "studio_small"])

    def test_ev0_does_not_depend_on_the_exposure(self):
        np.testing.assert_allclose(hdr.to_ev0(room() * 7.0), room(), rtol=1e-9)

    def test_dominant_light_is_the_lamp_across_the_first_column(self):
        self.assertGreater(hdr.dominant_direction(room()) @ hdr.DIRECTION[24, 0], np.cos(np.radians(3)))

    def test_combined_panoramas_are_at_ev0(self):
        random = np.random.default_rng(1)
        made = [hdr.mixed(room(), room(1), random), hdr.exchanged_ground(room(), room(1), random),
                hdr.dimmed(room(), random)]
        for panorama in made:
            np.testing.assert_allclose(hdr.to_ev0(panorama), panorama, rtol=1e-9)

    def test_partners_show_other_places(self):
        places = np.array([0, 0, 1, 2])
        found = hdr.partners(np.random.default_rng(0).random((4, 23)), places)
        self.assertEqual(found.shape, (4, 2))
        self.assertTrue((places[found] != places[:, None]).all())


class Features(unittest.TestCase):
    def test_overview_does_not_change_by_rotation_and_mirroring(self):
        expected = features.overview(plain(room()))
        self.assertEqual(expected.shape, (features.OVERVIEW,))
        for turned in (np.roll(room(), 77, 1), room()[:, ::-1]):
            np.testing.assert_allclose(features.overview(plain(turned)), expected, atol=1e-9)

    def test_maps_turn_with_the_panorama(self):
        expected = features.maps(plain(room()))
        self.assertEqual(expected.shape, (64, 128, features.MAPS))
        np.testing.assert_allclose(features.maps(plain(np.roll(room(), 24, 1))), np.roll(expected, 12, 1), atol=1e-6)
        np.testing.assert_allclose(features.maps(plain(room()[:, ::-1])), expected[:, ::-1], atol=1e-6)

    def test_region_across_the_first_column_is_one_region(self):
        sizes = features.region_sizes(features.Parts(plain(room())))
        np.testing.assert_allclose(sizes, [7 * hdr.SOLID_ANGLE[20:28, 0].sum(), 10 * hdr.SOLID_ANGLE[40:44, 0].sum()])

    def test_true_hidden_light_has_no_error(self):
        panorama, shot = room(), hdr.Shot()
        truth = features.truth(panorama, shot, plain(panorama), hdr.dominant_direction(panorama))
        before, after = (features.errors(truth, hidden) for hidden in (0 * truth.hidden, truth.hidden))
        self.assertGreater(np.abs(before).min(), 0.3)
        # What remains is the rounding to 8 bits.
        self.assertLess(np.abs(after).max(), 0.01)

    def test_shares_sum_to_one(self):
        panorama = room()
        truth = features.truth(panorama, hdr.Shot(), plain(panorama), hdr.dominant_direction(panorama))
        shares = features.shares(truth, np.random.default_rng(0).normal(size=(128, 256)))
        self.assertAlmostEqual(shares.sum(), 1.0)
        self.assertEqual(shares[truth.clipped == 0].sum(), 0.0)


@TORCH
class Network(unittest.TestCase):
    def setUp(self):
        random = torch.Generator().manual_seed(0)
        self.maps = torch.randn(3, 64, 128, features.MAPS, generator=random)
        self.overview = torch.randn(3, features.OVERVIEW, generator=random)

    def test_mirrored_panoramas_have_mirrored_scores(self):
        networks = correction()
        amount, scores = networks.predict(self.maps, self.overview)
        mirrored_amount, mirrored_scores = networks.predict(self.maps.flip(2), self.overview)
        self.assertEqual(scores.shape, (2, 3, 32, 64))
        torch.testing.assert_close(mirrored_amount, amount, atol=1e-5, rtol=0)
        torch.testing.assert_close(mirrored_scores, scores.flip(3), atol=1e-5, rtol=0)

    def test_columns_wrap_around(self):
        networks = correction()
        amount, scores = networks.predict(self.maps, self.overview)
        # A cell of the coarsest map is 16 cells of the input wide.
        turned_amount, turned_scores = networks.predict(self.maps.roll(48, 2), self.overview)
        torch.testing.assert_close(turned_amount, amount, atol=1e-5, rtol=0)
        torch.testing.assert_close(turned_scores, scores.roll(24, 3), atol=1e-5, rtol=0)

    def test_columns_continue_across_the_poles(self):
        maps = torch.arange(8.0).reshape(1, 1, 1, 8, 1)
        around = network._neighbourhoods(maps)[0, 0, 0, 1]
        self.assertEqual(around.tolist(), [4, 5, 6, 0, 1, 2, 4, 5, 6])

    def test_correction_is_limited(self):
        networks = correction()
        with torch.no_grad():
            networks.bias["h2"].fill_(1e3)
        self.assertLessEqual(networks.predict(self.maps, self.overview)[0].abs().max(), network.REACH)

    def test_disturbance_keeps_what_is_clipped(self):
        maps = torch.rand(2, 3, 64, 128, features.MAPS)
        maps[..., features.CLIPPED_MAP] *= torch.rand(maps.shape[:-1]) < 0.1
        made, kept = network.disturbed(maps), [5, 6, 7, 8, 10, 11, 12, 13]
        torch.testing.assert_close(made[..., kept], maps[..., kept], atol=0, rtol=0)
        clipped = maps[..., features.CLIPPED_MAP] > 0
        self.assertTrue((made[clipped][:, features.VISIBLE_SHARE_MAP] > 0).all())

    def test_loss_is_least_for_the_truth(self):
        random = np.random.default_rng(0)
        clipped, hidden, near = (torch.tensor(random.random((1, 1, 64, 128)), dtype=torch.float32) for _ in range(3))
        clipped, hidden, far = clipped / 8192, hidden / 4096, 1 - near
        sums = [hidden.sum(), (hidden * near).sum(), (hidden * far).sum()]
        flux = torch.tensor([[[2, 1, 1, *(v + s for v, s in zip((2, 1, 1), sums)), sums[0], 1.5]]])
        target = {"flux": flux, "clipped": clipped, "hidden": hidden, "near": near, "far": far}
        amount, scores = torch.log2(flux[..., 6] / flux[..., 7]), (hidden / clipped).log()
        best = network.loss(amount, scores, target)
        self.assertLess(best, network.loss(amount + 0.3, scores, target))
        self.assertLess(best, network.loss(amount, scores + near, target))

    def test_weights_are_exported_and_imported(self):
        networks, kept = correction(3), {"amount.bias": np.float16([0.5]), "map.old": np.float16([1.0])}
        scale = np.linspace(-1, 1, 23), np.linspace(0, 1, 23)
        with tempfile.TemporaryDirectory() as folder:
            source, file = os.path.join(folder, "source.safetensors"), os.path.join(folder, "made.safetensors")
            save_file(kept, source)
            network.export(file, source, [networks, correction(1)], *scale)
            tensors, (read, mean, spread) = load_file(file), network.imported(file)
        self.assertEqual(len(tensors), 1 + 2 * len(network.LAYERS) + 2)
        self.assertEqual({str(value.dtype) for value in tensors.values()}, {"float16"})
        self.assertEqual(tensors["amount.bias"], kept["amount.bias"])
        self.assertEqual(tensors["map.h1.weight"].shape, (4, 223, 32))
        np.testing.assert_allclose(mean, scale[0], atol=1e-3)
        self.assertGreater(spread.min(), 0)
        for part, expected in zip(read.predict(self.maps, self.overview), networks.predict(self.maps, self.overview)):
            torch.testing.assert_close(part[:3], expected, atol=0.05, rtol=0.02)


if __name__ == "__main__":
    unittest.main()
