"""Bring the network of snnTorch's tutorial 5 into the region of snntorch_tutorial.yaml, and compare the spikes."""

from pathlib import Path

import snntorch
import torch

from neurorobo.config.experiment import load_experiment
from neurorobo.experiment.build import build_brain
from neurorobo.regions.weights import save_weights

torch.manual_seed(0)
fc1, lif1 = torch.nn.Linear(784, 1000), snntorch.Leaky(beta=0.95)  # as you have trained them
fc2, lif2 = torch.nn.Linear(1000, 10), snntorch.Leaky(beta=0.95)
region = build_brain(load_experiment(Path(__file__).with_suffix(".yaml"))).region("classifier")
with torch.no_grad():
    for layer, theirs in (("hidden", fc1), ("output", fc2)):
        weight, bias = region.parameter_groups()[layer].parameters()
        weight.copy_(theirs.weight)
        bias.copy_(theirs.bias[:, None])
    save_weights(region, Path("snntorch_tutorial.safetensors"), {"from": "snnTorch"})

    spikes = torch.rand(25, 1, 784).round()
    ours, _ = region.step({"image": spikes}, region.init_state(1))
    mem1, mem2 = torch.zeros(1, 1000), torch.zeros(1, 10)
    for now, fired in zip(spikes, ours["rate"], strict=True):
        spk1, mem1 = lif1(fc1(now), mem1)
        spk2, mem2 = lif2(fc2(spk1), mem2)
        print(fired.int().tolist(), "the same" if torch.equal(fired, spk2) else "others")
