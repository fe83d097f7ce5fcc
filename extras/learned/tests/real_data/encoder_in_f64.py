"""How far off in float64 the latents are that the reference's autoencoder made of the picture in float32.

    python encoder_in_f64.py ../shared/data/flux-kontext-tiny

Needs torch and diffusers. What it prints stands in docs/evidence/kontext.md; the same comparison with this program's own encoder
is the test `inputs_and_the_autoencoder_are_the_reference_s`.
"""

import sys

import torch
from diffusers import AutoencoderKL
from safetensors.torch import load_file

folder = sys.argv[1]
tensors = load_file(f"{folder}/tensors.safetensors")
torch.set_grad_enabled(False)


def latents(dtype):
    vae = AutoencoderKL.from_pretrained(folder, subfolder="vae", torch_dtype=dtype)
    mean = vae.encode(tensors["image_pre"].to(dtype)).latent_dist.mode()
    return ((mean - vae.config.shift_factor) * vae.config.scaling_factor).double()


exact = latents(torch.float64)
for name, value in [("float32 here", latents(torch.float32)), ("the fixture", tensors["vae.latents_scaled"].double())]:
    print(f"{name}: {(value - exact).abs().max():.1e} from float64")
print(f"latents reach {exact.abs().max():.2f}")
