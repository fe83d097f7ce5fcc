"""What more places would bring: the learning curve of docs/evidence/light.md.

    lightharmony train-exposure HDRI HDRI2 --folds 0 --members 1 --steps 1 --numbers numbers.csv
    python tests/tables/light_curve.py numbers.csv

The amount of hidden light is fitted as `training/amount.rs` does, to a part of the places, and judged on the plain
photographs of places apart: mean |log2| error of all light, over eight ways to part the places into six. Then how far
off the amount of the place is whose numbers are most alike, which no method that reads these numbers would trust less.
"""

import csv
import sys

import numpy as np

rows = list(csv.reader(open(sys.argv[1])))[1:]
place = np.array([int(row[0]) if row[0] else -1 for row in rows])
shot, weight, visible, unclipped, hidden = np.array([row[1:6] for row in rows], float).T
numbers = np.array([row[6:] for row in rows], float)
amount = np.maximum(np.log2(np.maximum(hidden, 1e-30) / np.maximum(unclipped, 1e-30)), -10)
learns = (hidden > 0) & (unclipped > 0)
plain = (shot == 0) & (place >= 0)
places = np.unique(place[plain])
WAYS, PARTS = range(8), 6


def scaled(chosen):
    mean, spread = numbers[chosen].mean(0), numbers[chosen].std(0) + 1e-4
    return np.clip((numbers - mean) / spread, -3, 3)


def fitted(x, chosen, penalty):
    part = weight[chosen] / weight[chosen].sum()
    mean, centre = part @ x[chosen], part @ amount[chosen]
    off = x[chosen] - mean
    matrix = (off * part[:, None]).T @ off + penalty * np.eye(x.shape[1])
    slope = np.linalg.solve(matrix, off.T @ (part * (amount[chosen] - centre)))
    return np.clip((x - mean) @ slope + centre, -8, 8)


def error(told, judged):
    return np.abs(np.log2((visible + unclipped * 2**told) / (visible + hidden)))[judged]


def curve(share, formula, penalty):
    """Mean over the ways, and how many places were learned from."""
    means, counts = [], []
    for way in WAYS:
        random = np.random.default_rng(way)
        part = dict(zip(random.permutation(places), np.arange(len(places)) % PARTS))
        of = np.array([part.get(p, -1) for p in place])
        errors = []
        for held in range(PARTS):
            others = [p for p in places if part[p] != held]
            known = random.choice(others, max(2, round(share * len(others))), replace=False)
            chosen = learns & (np.isin(place, known) | ((place < 0) & formula))
            told = fitted(scaled(chosen), chosen, penalty)
            errors.extend(error(told, plain & (of == held)))
            counts.append(len(known))
        means.append(np.mean(errors))
    return np.mean(counts), np.mean(means), np.std(means)


PENALTIES = [0.04, 0.08, 0.16, 0.32, 0.64]
print("| places learned from | with panoramas by formula | without |\n|---|---|---|")
found = []
for share in (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0):
    cells = []
    for formula in (True, False):
        count, mean, spread = min((curve(share, formula, p) for p in PENALTIES), key=lambda v: v[1])
        cells.append(f"{mean:.3f} +- {spread:.3f}")
        if not formula:
            found.append((count, mean))
    print(f"| {count:.0f} | {cells[0]} | {cells[1]} |", flush=True)

x, y = np.log2(np.array(found)).T
slope, offset = np.polyfit(x, y, 1)
print(f"\nwithout: about {2**offset:.2f} n^{slope:.2f}; 0.40 at n = {2 ** ((np.log2(0.4) - offset) / slope):.0f}")

x = scaled(plain)
apart = np.linalg.norm(x[plain][:, None] - x[plain][None], axis=2)
apart[place[plain][:, None] == place[plain][None]] = np.inf
told = np.zeros(len(place))
told[plain] = amount[plain][apart.argmin(1)]
off, nearest = error(told, plain), apart.min(1)
alike = nearest <= np.quantile(nearest, 1 / 3)
print(f"as the place most alike: {off.mean():.2f}, of the third most alike {off[alike].mean():.2f}")
