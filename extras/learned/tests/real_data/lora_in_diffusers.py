"""Whether a LoRA that `train-exposure --backend flux-kontext` wrote for the small model does in diffusers what it says.

    python lora_in_diffusers.py ../shared/data/flux-kontext-tiny lora.safetensors

Needs torch, diffusers and peft. The model's output with the LoRA attached by diffusers is compared with that of weights
to which alpha / rank B A was added by hand. What it prints stands in docs/evidence/kontext.md.
"""

import json
import sys

import torch
from diffusers import FluxTransformer2DModel
from diffusers.loaders import FluxLoraLoaderMixin
from safetensors import safe_open
from safetensors.torch import load_file

folder, lora = sys.argv[1:]
torch.set_grad_enabled(False)
tensors = load_file(f"{folder}/tensors.safetensors")
with safe_open(lora, "pt") as file:
    header = json.loads(file.metadata()["lora_adapter_metadata"])
    updates = {key: file.get_tensor(key) for key in file.keys()}

# diffusers 0.35 hands torch 2.4 an argument that it does not have; the small model does not need it.
attention = torch.nn.functional.scaled_dot_product_attention
torch.nn.functional.scaled_dot_product_attention = lambda *a, enable_gqa=False, **named: attention(*a, **named)


def model():
    return FluxTransformer2DModel.from_pretrained(folder, subfolder="transformer")


def output(model):
    return model(
        hidden_states=tensors["step0.hidden_states"],
        encoder_hidden_states=tensors["prompt_embeds"],
        pooled_projections=tensors["pooled_prompt_embeds"],
        timestep=tensors["step0.timestep"].reshape(1),
        img_ids=tensors["img_ids"],
        txt_ids=tensors["txt_ids"],
        guidance=torch.tensor([2.5]),
    ).sample


base = model()
frozen = {name: value.clone() for name, value in base.named_parameters()}
plain = output(base)
state, header_there = FluxLoraLoaderMixin.lora_state_dict(lora, return_lora_metadata=True)
base.load_lora_adapter(state, metadata=header_there, prefix="transformer", adapter_name="exposure")
adapted = [name for name, part in base.named_modules() if "exposure" in getattr(part, "lora_A", {})]
there = output(base)
now = {name.replace(".base_layer", ""): value for name, value in base.named_parameters() if "lora_" not in name}
assert now.keys() == frozen.keys() and all(torch.equal(now[name], value) for name, value in frozen.items())

merged = model()
weights = dict(merged.named_parameters())
for key, down in updates.items():
    if key.endswith(".lora_A.weight"):
        up = updates[key.replace("lora_A", "lora_B")]
        name = key.removeprefix("transformer.").removesuffix(".lora_A.weight")
        weights[f"{name}.weight"].data += header["transformer.lora_alpha"] / down.shape[0] * (up @ down)
print(f"{len(adapted)} layers adapted of {len(updates) // 2} in the file; the base is as it was")
print(f"against weights merged by hand: {(there - output(merged)).abs().max():.1e}; against none: {(there - plain).abs().max():.2f}")
