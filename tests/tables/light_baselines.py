"""The baselines of docs/evidence/light.md: the regression by region and the network of the prior study, trained again in each part of the places.

    python tests/tables/light_baselines.py HDRI PEERS OUT [STEPS]

HDRI holds the panoramas (several folders are separated by commas), PEERS the scripts of the prior study, which are imported: `eval_pano.py` (regression) and
`train_unet.py` (network, its sampling, loss and optimiser; its clock is replaced by STEPS steps, by default 700, of six
pictures; 0 leaves the network out). Places and parts are those of `train-exposure`. Writes OUT/region/NAME.exr and OUT/network/NAME.exr, each
from what never saw its place; networks that are done are kept in OUT and not trained again.
"""

import os
import sys

import numpy as np
import torch

folders = sys.argv[1].split(",")
peers, out = (os.path.abspath(folder) for folder in sys.argv[2:4])
STEPS = int(sys.argv[4]) if len(sys.argv) > 4 else 700
SEED = 7
sys.path.insert(0, peers)
import eval_pano as ev  # noqa: E402
import panolib as pl  # noqa: E402
import train_unet as unet  # noqa: E402
from light_places import PARTS, places_of  # noqa: E402


class Clock:
    """Stands in for the module `time` of `train_unet.py`: a second passes for each step, which asks the time twice."""

    asked = 0

    def time(self):
        Clock.asked += 1
        return Clock.asked / 2


def trained(panoramas, part):
    """The network of the prior study, trained for STEPS steps on these panoramas."""
    for seed in range(SEED, SEED + 5):
        path = os.path.join(out, f"network-{part}of{PARTS}-{STEPS}-{seed}")
        if not os.path.exists(path + ".pt"):
            Clock.asked, unet.time, unet.load_dir = 0, Clock(), lambda _: panoramas
            unet.main(None, path, STEPS / 60, seed)
        network = unet.Net()
        network.load_state_dict(torch.load(path + ".pt"))
        # About one training in three ends in NaN, as one of the prior study's did: then another seed.
        if all(bool(v.isfinite().all()) for v in network.state_dict().values()):
            return network.eval()
    raise SystemExit("no seed gives a finite network")


def light(photograph, luminance):
    """The photograph's colours, at the predicted brightness."""
    linear = photograph**pl.G
    return linear * (luminance / np.maximum(linear @ pl.W, 1e-6))[..., None]


def write(kind, name, image):
    os.makedirs(os.path.join(out, kind), exist_ok=True)
    header = {"compression": pl.OpenEXR.ZIP_COMPRESSION, "type": pl.OpenEXR.scanlineimage}
    channels = {"RGB": np.ascontiguousarray(image, dtype=np.float32)}
    pl.OpenEXR.File(header, channels).write(os.path.join(out, kind, name + ".exr"))


torch.set_num_threads(1)
os.makedirs(out, exist_ok=True)
panoramas = dict(sorted((name, image) for folder in folders for name, image in pl.load_dir(folder).items()))
places = places_of(panoramas)
part_of = {name: place % PARTS for name, place in zip(panoramas, places)}
print(len(panoramas), "panoramas of", len(set(places)), "places", flush=True)
for part in range(PARTS):
    learns = {name: image for name, image in panoramas.items() if part_of[name] != part}
    region = ev.Classical().fit(learns.values(), np.random.default_rng(0))
    network = trained(learns, part) if STEPS else None
    for name, image in panoramas.items():
        if part_of[name] != part:
            continue
        photograph = pl.ldr(image * pl.expose_scale(image))
        write("region", name, light(photograph, region(photograph)))
        if network is None:
            continue
        with torch.no_grad():
            told = unet.predict_lum(network, torch.tensor(photograph).permute(2, 0, 1)[None])[0][0, 0]
        write("network", name, light(photograph, told.numpy()))
