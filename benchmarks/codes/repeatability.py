"""The repeatable accuracy of the three codes (Sec. IV-A): how far, and how reproducibly, a value comes back.

Run ``python benchmarks/codes/repeatability.py`` (seconds). Every value is encoded and decoded many times; the table
gives the rms error, the standard deviation between repetitions, and the resolution that each code states.
"""

import torch

from neurorobo.codes import Code, Poisson, PopulationUniform, TimeToFirstSpike

STEPS = 50
NEURONS = 50
REPETITIONS = 64
CODES: tuple[type[Code], ...] = (PopulationUniform, TimeToFirstSpike, Poisson)


def measure(code: Code, values: torch.Tensor, generator: torch.Generator) -> tuple[float, float, float]:
    """Return rms error, deviation between repetitions, and mean spikes per neuron and step."""
    decoded, rates = [], []
    for _ in range(REPETITIONS):
        spikes = code.encode(values, STEPS, generator)
        decoded.append(code.decode(spikes))
        rates.append(spikes.mean())
    found = torch.stack(decoded)
    error = (found - values).square().mean().sqrt()
    return float(error), float(found.std(0).square().mean().sqrt()), float(torch.stack(rates).mean())


def main() -> None:
    """Print the table for a speed of 0..100 um/s."""
    generator = torch.Generator().manual_seed(0)
    values = torch.rand(512, 1, generator=generator, dtype=torch.float64) * 100
    print(f"speed 0..100 um/s, {NEURONS} neurons, {STEPS} steps, {REPETITIONS} repetitions of 512 values")
    print(f"{'code':20} {'resolution':>10} {'rms error':>10} {'deviation':>10} {'firing rate':>12}")
    for kind in CODES:
        code = kind(NEURONS, 0.0, 100.0)
        error, deviation, rate = measure(code, values, generator)
        print(f"{kind.__name__:20} {code.resolution(STEPS):10.4f} {error:10.4f} {deviation:10.4f} {rate:12.3f}")


if __name__ == "__main__":
    main()
