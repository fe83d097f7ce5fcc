"""Convolutional networks that correct the predicted amount of hidden light and distribute it over clipped cells.

All tensors have the network as their first dimension, so that several networks are trained at once. Amounts are log2 of
the flux that clipping hides over the flux of open pixels.
"""
import numpy as np
import torch
import torch.nn.functional as nn
from safetensors.numpy import load_file, save_file

from features import CLIPPED_MAP, COLUMNS, MAPS, OVERVIEW, ROWS, VISIBLE_MAPS, VISIBLE_SHARE_MAP
from panoramas import solid_angles

# Channels of the maps, from 64 x 32 cells to 8 x 4 cells.
WIDTHS = (12, 20, 28, 40)
# Number of weighted means over the coarsest map, and of units of the summary.
MEANS, UNITS = 4, 32
# Largest absolute correction of the amount, in stops.
REACH = 2.0


def _layers():
    """Numbers of inputs and outputs of each layer, and the gain of its initial weights."""
    a, b, c, d = WIDTHS
    return {
        "a0": (9 * MAPS, a, 1), "a1": (9 * a, b, 1), "b1": (9 * b, b, 1), "a2": (9 * b, c, 1), "b2": (9 * c, c, 1),
        "a3": (9 * c, d, 1), "b3": (9 * d, d, 1), "u2": (d + c, c, 1), "v2": (9 * c, c, 1), "u1": (c + b, b, 1),
        "v1": (9 * b, b, 1), "u0": (b + a, a, 1), "s": (a, 1, 0.2), "att": (d, MEANS, 1),
        "h1": ((1 + MEANS) * d + OVERVIEW, UNITS, 1), "h2": (UNITS, 1, 0.2), "gl": (UNITS, d, 0.5),
    }


LAYERS = _layers()


def halved(maps):
    """Means of 2 x 2 cells of maps [networks, batch, rows, columns, channels]."""
    networks, batch, rows, columns, channels = maps.shape
    return maps.reshape(networks, batch, rows // 2, 2, columns // 2, 2, channels).mean((3, 5))


def doubled(maps):
    """Maps of twice the size, in which each value is repeated; rows and columns are dimensions 2 and 3."""
    return maps.repeat_interleave(2, 2).repeat_interleave(2, 3)


def _neighbourhoods(maps):
    """The channels of the 3 x 3 cells around each cell, row by row: [..., channels] becomes [..., 9 x channels].

    Rows wrap around, and columns continue across a pole on the opposite meridian.
    """
    rows, columns = maps.shape[2:4]
    top, bottom = (edge.roll(columns // 2, 3) for edge in (maps[:, :, :1], maps[:, :, -1:]))
    maps = torch.cat([top, maps, bottom], 2)
    maps = torch.cat([maps[:, :, :, -1:], maps, maps[:, :, :, :1]], 3)
    return torch.cat([maps[:, :, y:y + rows, x:x + columns] for y in range(3) for x in range(3)], -1)


def _activate(values):
    """Leaky rectifier."""
    return nn.leaky_relu(values, 0.1)


class Networks:
    """Networks of the same shape. `weight` holds tensors [networks, inputs, outputs], `bias` [networks, 1, outputs]."""

    def __init__(self, count, seed=0, dropout=0.0, device="cpu"):
        """Draws the initial weights of `count` networks. `dropout` applies to the summary in training."""
        self.count, self.dropout, self.weight, self.bias = count, dropout, {}, {}
        random = torch.Generator(device=device).manual_seed(seed)
        for name, (inputs, outputs, gain) in LAYERS.items():
            drawn = torch.randn(count, inputs, outputs, device=device, generator=random)
            self.weight[name] = (drawn * gain * (2 / inputs) ** 0.5).requires_grad_()
            self.bias[name] = torch.zeros(count, 1, outputs, device=device, requires_grad=True)
        self.sizes = torch.tensor(solid_angles(4, 8).reshape(-1, 1), dtype=torch.float32, device=device)

    def parameters(self):
        """All weights and biases."""
        return [*self.weight.values(), *self.bias.values()]

    def _affine(self, name, values):
        """A layer applied to the last dimension of `values` [networks, ..., inputs]."""
        shape = values.shape
        out = torch.baddbmm(self.bias[name], values.reshape(shape[0], -1, shape[-1]), self.weight[name])
        return out.reshape(*shape[:-1], -1)

    def _convolved(self, name, maps):
        """A convolution with 3 x 3 cells and its activation; layers `b` and `v` are added to their input."""
        out = _activate(self._affine(name, _neighbourhoods(maps)))
        return out + maps if name[0] in "bv" else out

    def _summary(self, coarse, overview, dropout):
        """Units [networks, batch, 32] from the coarsest map and the overview numbers."""
        cells = coarse.flatten(2, 3)
        attention = torch.softmax(self._affine("att", cells) + self.sizes.log(), 2)
        mean = (cells * self.sizes / (4 * np.pi)).sum(2)
        weighted = torch.einsum("nbpk,nbpc->nbkc", attention, cells).flatten(2)
        values = nn.dropout(torch.cat([mean, weighted, overview], -1), dropout)
        return nn.dropout(_activate(self._affine("h1", values)), dropout)

    def forward(self, maps, overview, training=False):
        """Correction [networks, batch] of the amount in stops, and scores [networks, batch, 32, 64] of cells.

        `maps` is [networks, batch, 64, 128, 14] and `overview` [networks, batch, 23], scaled. The share of the hidden
        light of a pixel is proportional to its visible flux times the exponential of the score.
        """
        fine = self._convolved("a0", halved(maps))
        middle = self._convolved("b1", self._convolved("a1", halved(fine)))
        small = self._convolved("b2", self._convolved("a2", halved(middle)))
        coarse = self._convolved("b3", self._convolved("a3", halved(small)))
        units = self._summary(coarse, overview, self.dropout if training else 0.0)
        correction = REACH * torch.tanh(self._affine("h2", units)[..., 0] / REACH)
        out = coarse + self._affine("gl", units)[:, :, None, None]
        for level, skipped in (("2", small), ("1", middle), ("0", fine)):
            out = _activate(self._affine("u" + level, torch.cat([doubled(out), skipped], -1)))
            if level != "0":
                out = self._convolved("v" + level, out)
        return correction, self._affine("s", out)[..., 0]

    @torch.no_grad()
    def predict(self, maps, overview):
        """Means of `forward` over the panoramas [batch, 64, 128, 14] and their mirror images, for all networks."""
        maps, overview = (values.float().expand(self.count, *values.shape) for values in (maps, overview))
        correction, scores = self.forward(maps, overview)
        mirrored_correction, mirrored_scores = self.forward(maps.flip(3), overview)
        return (correction + mirrored_correction) / 2, (scores + mirrored_scores.flip(3)) / 2

    def tensors(self):
        """Tensors `map.LAYER.weight` [networks, inputs, outputs] and `map.LAYER.bias` [networks, outputs], float32."""
        named = {f"map.{name}.weight": value for name, value in self.weight.items()}
        named |= {f"map.{name}.bias": value[:, 0] for name, value in self.bias.items()}
        return {name: value.detach().float().cpu().numpy() for name, value in named.items()}

    @classmethod
    def of_tensors(cls, tensors, device="cpu"):
        """The networks with the given tensors; the inverse of `tensors`."""
        networks = cls(len(tensors["map.a0.weight"]), device=device)
        for name in LAYERS:
            weight, bias = (torch.tensor(np.float32(tensors[f"map.{name}.{part}"])) for part in ("weight", "bias"))
            if weight.shape != networks.weight[name].shape or bias.shape != (networks.count, LAYERS[name][1]):
                raise ValueError(f"layer {name} has shapes {tuple(weight.shape)} and {tuple(bias.shape)}")
            networks.weight[name], networks.bias[name] = weight.to(device), bias[:, None].to(device)
        return networks


def export(file, source, networks, mean, spread):
    """Writes the tensors of `source` to `file`, with those of the correction replaced by `networks`, in float16.

    `networks` holds objects of `Networks`, which are joined in this order. `mean` and `spread` [23] scale the overview
    numbers.
    """
    kept = {name: value for name, value in load_file(source).items() if not name.startswith("map.")}
    each = [part.tensors() for part in networks]
    made = {name: np.concatenate([tensors[name] for tensors in each]) for name in each[0]}
    made |= {"map.mean": mean, "map.spread": np.maximum(spread, 1e-4)}
    save_file(kept | {name: np.ascontiguousarray(value, np.float16) for name, value in made.items()}, file)


def imported(file):
    """The networks of a weights file, and `mean` and `spread` [23] of the overview numbers."""
    tensors = load_file(file)
    return Networks.of_tensors(tensors), *(tensors[f"map.{name}"].astype(np.float64) for name in ("mean", "spread"))


def limit_gradients(parameters, largest):
    """Scales the gradients of each network, over all its parameters, to a norm of at most `largest`."""
    norm = sum((value.grad.flatten(1) ** 2).sum(1) for value in parameters).sqrt()
    factor = (largest / (norm + 1e-6)).clamp(max=1)
    for value in parameters:
        value.grad.mul_(factor.reshape(-1, 1, 1))


def disturbed(maps):
    """Maps [networks, batch, 64, 128, 14] with random errors, for training.

    In half of them a rectangle of cells that are not clipped is hidden. Brightness and hue of each panorama and of each
    cell are changed at random.
    """
    networks, batch, rows, columns, channels = maps.shape
    device, maps = maps.device, maps.clone()

    def uniform():
        """One random number for each panorama."""
        return torch.rand(networks, batch, 1, 1, device=device)

    height, width = 6 + uniform() * 26, 8 + uniform() * 48
    top, left = uniform() * rows - height / 2, uniform() * columns
    y, x = torch.arange(rows, device=device)[:, None], torch.arange(columns, device=device)
    inside = (y >= top) & (y < top + height) & ((x - left) % columns < width)
    hide = inside & (uniform() < 0.5) & (maps[..., CLIPPED_MAP] == 0)
    kept = torch.ones(channels, device=device)
    kept[VISIBLE_MAPS] = 0
    maps = torch.where(hide[..., None], maps * kept, maps)
    is_open = maps[..., VISIBLE_SHARE_MAP, None] > 0
    of_panorama = torch.tensor([0.03, 0.04, 0.04, 0.15, 0.15], device=device)
    of_cell = torch.tensor([0.05, 0.08, 0.08, 0.1, 0.1], device=device)
    noise = torch.randn(networks, batch, 1, 1, 5, device=device) * of_panorama
    noise = noise + torch.randn(networks, batch, rows, columns, 5, device=device) * of_cell
    maps[..., :5] += noise * is_open
    return maps


def loss(amount, scores, target):
    """Loss [networks, batch] of predicted amounts [networks, batch] and scores [networks, batch, 64, 128].

    `target` holds tensors [networks, batch, ...]: `flux` [8] (visible and true flux as in `features.Truth`, hidden flux
    and that of open pixels), maps [64, 128] of `clipped` and `hidden` flux, and of the cosines `near` and `far`.
    """
    flux = target["flux"].unbind(-1)
    clipped, hidden, near, far = (target[name].flatten(2) for name in ("clipped", "hidden", "near", "far"))
    log_flux = torch.where(clipped > 0, clipped.clamp(min=1e-12).log(), torch.full_like(clipped, -1e9))
    log_share = torch.log_softmax(scores.flatten(2) + log_flux, -1)
    true_amount = torch.log2(flux[6] / flux[7]).clamp(min=-4)
    of_amount = nn.smooth_l1_loss(amount, true_amount, reduction="none")
    predicted = flux[7] * torch.exp2(amount.clamp(-8, 8))
    irradiance = torch.log2((flux[0] + predicted) / flux[3])

    def contrast(near, far):
        """Logarithm of the ratio of the dominant light to the rest."""
        return torch.log2((near + 1e-4) / (far + 1e-9))

    share = log_share.exp()
    lit = contrast(flux[1] + predicted * (share * near).sum(-1), flux[2] + predicted * (share * far).sum(-1))
    of_contrast = ((lit - contrast(flux[4], flux[5])) ** 2 + 0.05).sqrt()
    entropy = -(hidden * log_share).sum(-1) / (hidden.sum(-1) + 1e-12)
    return of_amount + (irradiance ** 2 + 0.02).sqrt() + 0.7 * of_contrast + 0.7 * entropy * flux[6] / flux[3]
