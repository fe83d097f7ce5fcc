"""Trains the networks that correct the prediction of hidden light, and writes them to a weights file.

README.md describes the command, and docs/evidence/light.md the data and the accuracy.
"""
import argparse
import os
import time
from collections import namedtuple
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

# One thread for NumPy, since the examples are made by several processes. PyTorch is not affected.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import torch

import features
import network
import panoramas as hdr

WEIGHTS = Path(__file__).resolve().parents[2] / "render/weights/exposure.safetensors"
FOLDS, INNER = 6, 5
# Least amount that the regression learns, in stops, and the penalty of its squared weights.
LEAST_AMOUNT, PENALTY = -4.0, 0.01
# Part of the correction that is applied, as in the program.
PART = 0.5
# Largest learning rate, which is reached in `WARM_UP` steps and then falls to 0 as a cosine; photographs per step.
RATE, WARM_UP, BATCH = 3e-3, 50, 24
# Factor of the running means of the weights per step, and the largest norm of the gradients of a network.
AVERAGING, LARGEST_GRADIENT = 0.995, 1.5
# Noise of the overview numbers in training, in standard deviations.
OVERVIEW_NOISE = 0.1
# Kinds of combined panoramas, with the random seed of the first. Each kind has half the weight of all photographs of
# real panoramas.
COMBINED = {"mixed": 400_000, "exchanged_ground": 500_000, "dimmed": 400_000}
KINDS = ["real", *COMBINED]
# Random seed, decay of weights (AdamW), and dropout of the summary of each network.
Member = namedtuple("Member", "seed decay dropout")
MEMBERS = [Member(0, 0.02, 0.1), Member(1, 0.02, 0.1), Member(2, 0.1, 0.3), Member(3, 0.1, 0.3)]
# Numbers of photographs of each panorama, of combined panoramas of each kind, and of training steps.
Size = namedtuple("Size", "shots combined steps")


def example(job):
    """Features and truth of one photograph, as a dictionary of arrays.

    `job` is (kind, index of the panorama, index of the second one or -1, number of the photograph, random seed). The
    arrays are `maps` [64, 128, 14], `overview` [23], `flux` [8] (visible and true flux as in `features.Truth`, hidden
    flux, flux of open pixels), those of `features.truth_of_cells`, the indices `of` [2] of the panoramas, and `kind`,
    an index into `KINDS`.
    """
    kind, first, second, number, seed = job
    random, panorama = np.random.default_rng([7, seed]), _panoramas[first]
    if kind == "dimmed":
        panorama = hdr.dimmed(panorama, random)
    elif kind != "real":
        panorama = getattr(hdr, kind)(panorama, _panoramas[second], random)
    shot = hdr.Shot.random(random) if number else hdr.Shot()
    photograph = hdr.photograph(panorama, shot, random)
    truth = features.truth(panorama, shot, photograph, hdr.dominant_direction(panorama))
    flux = np.array([*truth.visible, *truth.truth, truth.hidden.sum(), truth.open])
    return {"maps": features.maps(photograph).astype(np.float16), "overview": features.overview(photograph),
            "flux": flux, "of": np.array([first, second]), "kind": np.array(KINDS.index(kind)),
            **features.truth_of_cells(truth)}


def _share(panoramas):
    """Makes the panoramas known to a process that calls `example`."""
    global _panoramas
    _panoramas = panoramas


def examples(panoramas, places, size, processes):
    """Examples of all photographs: a dictionary of arrays whose first dimension is the example.

    `panoramas` is [count, 128, 256, 3], and `places` [count] holds the indices of their places. The first `count`
    examples are the plain photographs. In addition to the arrays of `example` there are the `places` [2] that an
    example shows, whether it is `valid` (has visible and hidden light), and `scale`, means and standard deviations of
    the overview numbers.
    """
    count, random = len(panoramas), np.random.default_rng(3)
    # Computes the lobes once, for all processes that are forked.
    hdr.dominant_direction(panoramas[0])
    with ProcessPoolExecutor(processes, initializer=_share, initargs=(panoramas,)) as pool:
        made = list(pool.map(example, [("real", i, -1, 0, i) for i in range(count)]))
        similar = hdr.partners(np.stack([one["overview"] for one in made]), places)
        jobs = [("real", i, -1, n, 1000 * n + i) for i in range(count) for n in range(1, size.shots)]
        for kind, seed in COMBINED.items():
            for k in range(size.combined):
                first = int(random.integers(count))
                second = int(similar[first][random.integers(similar.shape[1])]) if kind != "dimmed" else -1
                jobs.append((kind, first, second, int(random.random() < 0.8), seed + k))
        made += pool.map(example, jobs, chunksize=4)
    data = {name: np.stack([one.pop(name) for one in made]) for name in list(made[0])}
    first, second = data.pop("of").T
    data["places"] = np.stack([places[first], np.where(second < 0, places[first], places[second])], 1)
    data["valid"] = (data["flux"][:, 6:] > 0).all(1)
    numbers = data["overview"][data["kind"] == 0]
    data["scale"] = numbers.mean(0), numbers.std(0) + 1e-4
    return data


def folds_of(places, grouping):
    """Fold of each place. Grouping 0 is that of `train-exposure`, others are random."""
    folds = np.arange(places) % FOLDS
    return np.random.default_rng(1000 + grouping).permutation(folds) if grouping else folds


def regression(data, held_out, seed):
    """Amounts [examples] that ridge regressions of the overview numbers predict, in stops.

    `held_out` [places] marks places that no regression may learn from. Examples of other places are predicted by
    regressions of four fifths of the places, without their own, so that the networks see errors as large as for unseen
    places.
    """
    first, second = data["places"].T
    learned = data["valid"] & (data["kind"] == 0) & ~held_out[first]
    hidden, visible = np.maximum(data["flux"][:, 6:], 1e-30).T
    amount = np.maximum(np.log2(hidden / visible), LEAST_AMOUNT)
    chosen = data["overview"][learned]
    scaled = np.clip((data["overview"] - chosen.mean(0)) / (chosen.std(0) + 1e-4), -3, 3)

    def fitted(chosen):
        """Amounts [examples] that a regression of the `chosen` examples predicts."""
        x, y = scaled[chosen], amount[chosen]
        centred = x - x.mean(0)
        matrix = centred.T @ centred / len(x) + PENALTY * np.eye(x.shape[1])
        weight = np.linalg.solve(matrix, centred.T @ (y - y.mean()) / len(x))
        return (scaled - x.mean(0)) @ weight + y.mean()

    inner = np.random.default_rng(seed).permutation(np.arange(len(held_out)) % INNER)
    predicted = fitted(learned)
    for a in range(INNER):
        for b in range(a, INNER):
            of_pair = (np.sort(inner[data["places"]], 1) == (a, b)).all(1) & ~held_out[first] & ~held_out[second]
            if of_pair.any():
                predicted[of_pair] = fitted(learned & (inner[first] != a) & (inner[first] != b))[of_pair]
    return np.clip(predicted, -6, 8)


def training_weights(data, held_out):
    """Probabilities [examples], not normalised, with which examples are drawn: 0 for those of held-out places."""
    valid = data["valid"] & ~held_out[data["places"]].any(1)
    counts = np.bincount(data["kind"][valid], minlength=len(KINDS))
    of_kind = np.where(np.arange(len(counts)) == 0, 1.0, 0.5 * counts[0] / np.maximum(counts, 1))
    return valid * of_kind[data["kind"]]


def trained(data, member, held_out, amounts, steps, device):
    """Trains one network for each row of `held_out` [networks, places].

    `amounts` [networks, examples] are the predictions of the regressions. Returns the networks with averaged weights.
    """
    networks = network.Networks(len(held_out), member.seed, member.dropout, device)
    optimizer = torch.optim.AdamW([{"params": list(networks.weight.values()), "weight_decay": member.decay},
                                   {"params": list(networks.bias.values()), "weight_decay": 0.0}],
                                  lr=RATE, betas=(0.9, 0.98))
    parameters = networks.parameters()
    average = [value.detach().clone() for value in parameters]
    chance = torch.tensor(np.stack([training_weights(data, held) for held in held_out]), dtype=torch.float32)
    mean, spread = data["scale"]
    overview = torch.tensor(np.clip((data["overview"] - mean) / spread, -3, 3), dtype=torch.float32)
    amounts, flux = (torch.tensor(values, dtype=torch.float32) for values in (amounts, data["flux"]))
    stored = {name: torch.from_numpy(data[name]) for name in ("maps", "clipped", "hidden", "near", "far")}
    random = np.random.default_rng(member.seed)
    torch.manual_seed(member.seed)
    for step in range(steps):
        drawn = torch.multinomial(chance, BATCH, replacement=True)
        target = {name: values[drawn].to(device) for name, values in stored.items()} | {"flux": flux[drawn].to(device)}
        shift, mirror = int(random.integers(features.COLUMNS)), random.random() < 0.5
        maps = target["maps"].float().roll(shift, 3)
        maps = network.disturbed(maps.flip(3) if mirror else maps)
        numbers = overview[drawn].to(device)
        numbers = numbers + OVERVIEW_NOISE * torch.randn_like(numbers)
        correction, scores = networks.forward(maps, numbers, training=True)
        scores = network.doubled(scores)
        scores = (scores.flip(3) if mirror else scores).roll(-shift, 3)
        amount = amounts.gather(1, drawn).to(device) + correction
        error = network.loss(amount, scores, target).mean(1)
        for group in optimizer.param_groups:
            group["lr"] = RATE * min(1, (step + 1) / WARM_UP) * 0.5 * (1 + np.cos(np.pi * step / steps))
        optimizer.zero_grad()
        error.sum().backward()
        network.limit_gradients(parameters, LARGEST_GRADIENT)
        optimizer.step()
        with torch.no_grad():
            for mean_value, value in zip(average, parameters):
                mean_value.lerp_(value, 1 - min(AVERAGING, (step + 1) / (step + 10)))
        if step % 100 == 0:
            print(f"  step {step} of {steps}, loss {error.mean().item():.3f}", flush=True)
    with torch.no_grad():
        for value, mean_value in zip(parameters, average):
            value.copy_(mean_value)
    return networks


def validate(data, panoramas, names, places, size, grouping, recovered, device):
    """Prints the errors of plain photographs of places that neither regressions nor networks have seen.

    `recovered` is a folder of panoramas that `train-exposure --recovered` wrote, which supply the other half of the
    distribution, or `None`. The arrays are those of `examples`, and `names` and `panoramas` those of `read_all`.
    """
    count = len(names)
    folds = folds_of(places.max() + 1, grouping)
    held_out = np.stack([folds == fold for fold in range(FOLDS)])
    amounts = np.stack([regression(data, held, 17 * (grouping + 2) + fold) for fold, held in enumerate(held_out)])
    mean, spread = data["scale"]
    overview = torch.tensor(np.clip((data["overview"][:count] - mean) / spread, -3, 3), dtype=torch.float32)
    maps, of = torch.from_numpy(data["maps"][:count]), folds[places]
    corrections, scores = np.zeros(count), [[] for _ in names]
    for member in MEMBERS:
        networks = trained(data, member, held_out, amounts, size.steps, device)
        for i in range(count):
            correction, score = networks.predict(maps[i:i + 1].to(device), overview[i:i + 1].to(device))
            corrections[i] += float(correction[of[i], 0]) / len(MEMBERS)
            scores[i].append(score[of[i], 0].cpu().numpy().repeat(4, 0).repeat(4, 1))
    rows = {"as photographed": [], "without correction": [], "with correction": []}
    for i, panorama in enumerate(panoramas):
        photograph = hdr.photograph(panorama, hdr.Shot(), None)
        truth = features.truth(panorama, hdr.Shot(), photograph, hdr.dominant_direction(panorama))
        shares = np.mean([features.shares(truth, score) for score in scores[i]], 0)
        other = shares
        if recovered:
            light = (hdr.read(Path(recovered) / f"{names[i]}.exr") - photograph.rgb) @ hdr.LUMINANCE
            light = np.where(truth.clipped > 0, np.maximum(light, 0) * hdr.SOLID_ANGLE, 0)
            other = light / light.sum() if light.sum() > 0 else shares
        amount = amounts[of[i], i]
        rows["as photographed"].append(features.errors(truth, 0 * shares))
        rows["without correction"].append(features.errors(truth, other * features.hidden_flux(truth, amount)))
        corrected = features.hidden_flux(truth, amount + PART * corrections[i])
        rows["with correction"].append(features.errors(truth, (other + shares) / 2 * corrected))
    report({name: np.abs(errors) for name, errors in rows.items()}, places)


def report(errors, places):
    """Prints means, medians and shares of harm.

    `errors` holds, for each row of the table, absolute errors [panoramas, 2] in stops. Harm is the share of panoramas
    whose irradiance is worse than in the photograph by over 0.3 stops.
    """
    before = errors["as photographed"][:, 0]
    print(f"{'mean (median), stops':20} {'|irr|':>15} {'contrast':>15} {'harm':>7}")
    for name, values in errors.items():
        cells = [f"{values[:, k].mean():7.3f} ({np.median(values[:, k]):.2f})" for k in range(2)]
        print(f"{name:20} {cells[0]:>15} {cells[1]:>15} {(values[:, 0] > before + 0.3).mean():>7.1%}")
    drawn = np.random.default_rng(7).integers(0, places.max() + 1, (10_000, places.max() + 1))
    weights = np.stack([np.bincount(row, minlength=places.max() + 1) for row in drawn])[:, places]
    weights = weights / weights.sum(1, keepdims=True)
    change = errors["with correction"] - errors["without correction"]
    for k, name in enumerate(("|irr|", "contrast")):
        low, high = np.percentile(weights @ change[:, k], [2.5, 97.5])
        print(f"difference, {name}: {change[:, k].mean():+.3f} ({low:+.3f} to {high:+.3f}, 95 % over places)")


def main():
    """Reads the panoramas, then trains and writes the networks, or cross-validates."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", nargs="+", help="folders of HDR panoramas (.exr)")
    parser.add_argument("--weights", default=WEIGHTS, help="weights file whose other tensors are kept")
    parser.add_argument("--out", default="exposure.safetensors", help="weights file to write")
    parser.add_argument("--validate", action="store_true", help="cross-validate instead of writing weights")
    parser.add_argument("--recovered", help="folder that `train-exposure --recovered` wrote from the same panoramas; "
                        "without it, both rows of contrast use the distribution of the networks")
    parser.add_argument("--grouping", type=int, default=0, help="division of places into folds; 0: as train-exposure")
    parser.add_argument("--tiny", action="store_true", help="test of all steps with twelve panoramas")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--processes", type=int, default=os.cpu_count(), help="processes that make the examples")
    options = parser.parse_args()
    if options.recovered and options.grouping:
        parser.error("--recovered can only be used with --grouping 0")
    started, size = time.time(), Size(2, 4, 3) if options.tiny else Size(8, 1200, 900)
    names, places, panoramas = hdr.read_all(options.folders)
    if options.tiny:
        chosen = np.arange(0, len(names), max(1, len(names) // 12))[:12]
        names, panoramas = [names[i] for i in chosen], panoramas[chosen]
        places = np.unique(places[chosen], return_inverse=True)[1]
    print(f"{len(names)} panoramas of {places.max() + 1} places, {time.time() - started:.0f} s", flush=True)
    data = examples(panoramas, places, size, options.processes)
    print(f"{len(data['kind'])} examples, {time.time() - started:.0f} s", flush=True)
    if options.validate or options.tiny:
        validate(data, panoramas, names, places, size, options.grouping, options.recovered, options.device)
    if not options.validate:
        nobody = np.zeros((1, places.max() + 1), bool)
        amounts = regression(data, nobody[0], 16)[None]
        ensemble = [trained(data, member, nobody, amounts, size.steps, options.device) for member in MEMBERS]
        network.export(options.out, options.weights, ensemble, *data["scale"])
        print(f"wrote {options.out}")
    print(f"{time.time() - started:.0f} s")


if __name__ == "__main__":
    main()
