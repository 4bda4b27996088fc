"""Proximal policy optimisation: regions learn from the task's reward, through their spikes."""

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from neurorobo.errors import NeuroroboError
from neurorobo.learning.actor import Actor, log_probability
from neurorobo.learning.checkpoint import Checkpoints
from neurorobo.learning.critic import Critic
from neurorobo.learning.experience import Experience, Practice, advantages
from neurorobo.learning.ppo_config import PpoPhase
from neurorobo.learning.supervise import Progress
from neurorobo.learning.trainable import adam, only_learning, set_learning_rate
from neurorobo.regions.region import Region, constrain
from neurorobo.regions.weights_file import signature_hash
from neurorobo.seeds import TRAINING_SEEDS

Parameters = Mapping[str, nn.Parameter]


def ppo(
    regions: Mapping[str, Region],
    phase: PpoPhase,
    generator: torch.Generator,
    *,
    rollout: Practice,
    report: Callable[[Progress], None] = lambda progress: None,
    checkpoints: Checkpoints | None = None,
) -> dict[str, Any]:
    """Train ``regions`` in place, and leave them with the weights that were best in validation, the first among them.

    ``generator`` draws the seeds of the episodes, the order of learning and the critic's weights. Returns how the phase
    went, ready for JSON: the mean return of each iteration's episodes, each validation, and what the weights before and
    after gain in the held-out episodes. With ``checkpoints`` an interrupted phase goes on where it stopped, to the very
    same weights; the iteration that Ctrl-C has stopped begins anew. Raises ConfigError if the phase does not fit the
    regions, and NeuroroboError if a checkpoint does not, or cannot be written.
    """
    phase.check_parameters({name: region.parameter_groups() for name, region in regions.items()})
    parameters = _chosen(regions, phase)
    with only_learning(regions.values(), parameters.values()), _as_in_use(regions.values()):
        actor = Actor(regions, rollout.plan, phase.deviations(rollout.plan))
        critic = Critic(rollout.observed, phase.critic, generator)
        learner = Learner(actor, critic, parameters, phase, generator)
        state = _State(regions, rollout, learner, parameters)
        done = 0 if checkpoints is None else state.resume(checkpoints)
        whole = state.tensors()
        try:
            while done < phase.iterations:
                figures, rate = _iterate(rollout, learner, state, done)
                done, whole = done + 1, state.tensors()
                gained = {"return": state.curve[-1][0], "validation": max(mean for _, mean in state.validations)}
                report(Progress(done, phase.iterations, figures.loss, gained, rate))
                if checkpoints is not None and checkpoints.due:
                    checkpoints.write(done, whole, state.belongs())
            held_out = {}
            for name, weights in (("before", state.start), ("after", state.best)):
                _load(parameters, weights)
                held_out[name] = rollout.perform(phase.held_out.seeds).to_json()
        except KeyboardInterrupt:
            if checkpoints is not None:
                checkpoints.write(done, whole, state.belongs())
            raise
    return {
        "learning_curve": [gained for gained, _ in state.curve],
        "kl": [kl for _, kl in state.curve],
        "validation": state.validations,
        "held_out": held_out,
    }


def _iterate(rollout: Practice, learner: "Learner", state: "_State", done: int) -> tuple["Figures", float]:
    """Run episodes and learn from them; return how it went, and the firing rate."""
    phase = learner.phase
    if done == 0:
        state.validate(0)
    seeds = torch.randint(*TRAINING_SEEDS, (phase.episodes,), generator=learner.generator).tolist()
    experience = rollout.explore(seeds, learner.actor.deviations)
    if done == 0:
        learner.critic.scale_to(*experience.returns(phase.discount))
    figures = learner.learn(experience, done / phase.iterations)
    state.curve.append([experience.mean_return, figures.kl])
    if (done + 1) % phase.validation.every == 0 or done + 1 == phase.iterations:
        state.validate(done + 1)
    return figures, experience.rate


class Losses(NamedTuple):
    """The loss of the policy, that of the critic, and an estimate of how far the policy went (the KL divergence)."""

    policy: Tensor
    value: Tensor
    kl: Tensor


def losses(
    now: Tensor,
    before: Tensor,
    advantage: Tensor,
    value: Tensor,
    wanted: Tensor,
    *,
    clip: float,
) -> Losses:
    """Return the losses of some ticks (n): Eq. 7 of Schulman et al. 2017, and the squared error of the critic.

    ``now`` and ``before`` are the logarithms of the probability of what was done, now and at the time. The estimate of
    the divergence is Schulman's (http://joschu.net/blog/kl-approx.html).
    """
    log_ratio = now - before
    ratio = log_ratio.exp()
    clipped = ratio.clamp(1.0 - clip, 1.0 + clip)
    policy = -torch.min(advantage * ratio, advantage * clipped).mean()
    return Losses(policy, mse_loss(value, wanted), ((ratio - 1.0) - log_ratio).mean().detach())


class Figures(NamedTuple):
    """How an iteration went: the last loss, and how far the policy went."""

    loss: float
    kl: float


class Learner:
    """An actor and its critic, and how both learn from experience."""

    def __init__(
        self, actor: Actor, critic: Critic, parameters: Parameters, phase: PpoPhase, generator: torch.Generator
    ) -> None:
        """Prepare to train the ``parameters`` of the actor; ``generator`` draws the order of learning."""
        self.actor = actor
        self.critic = critic
        self.phase = phase
        self.generator = generator
        self.optimiser = adam(parameters.values())
        self.critic_optimiser = torch.optim.Adam(critic.parameters(), lr=phase.critic.learning_rate, fused=True)

    def learn(self, experience: Experience, done: float) -> Figures:
        """Learn from the episodes of one iteration; ``done`` is the share of the phase that is over."""
        phase, actor = self.phase, self.actor
        set_learning_rate(self.optimiser, phase.learning_rate * (1.0 - done))
        ticks, episodes = experience.running.nonzero(as_tuple=True)
        with torch.no_grad():
            value, following = self.critic(experience.observation), self.critic(experience.following)
            gained = advantages(experience, value, following, discount=phase.discount, gae_lambda=phase.gae_lambda)
            wanted = (gained + value)[ticks, episodes]
            advantage = normalised(gained[ticks, episodes])
            command, due = experience.command[ticks, episodes], experience.due[ticks, episodes]
            before = log_probability(experience.mean[ticks, episodes], actor.spread, command, due)
            observation = experience.observation[ticks, episodes]
        loss, kl = 0.0, 0.0
        for _ in range(phase.epochs):
            for chosen in torch.randperm(len(ticks), generator=self.generator).split(phase.minibatch):
                mean = actor.means(experience, ticks[chosen], episodes[chosen])
                found = losses(
                    log_probability(mean, actor.spread, command[chosen], due[chosen]),
                    before[chosen],
                    advantage[chosen],
                    self.critic.scaled(self.critic(observation[chosen])),
                    self.critic.scaled(wanted[chosen]),
                    clip=phase.clip,
                )
                kl = float(found.kl)
                if phase.target_kl is not None and kl > 1.5 * phase.target_kl:
                    return Figures(loss, kl)
                total = found.policy + found.value
                self.optimiser.zero_grad()
                self.critic_optimiser.zero_grad()
                total.backward()
                self.optimiser.step()
                self.critic_optimiser.step()
                for region in actor.regions:
                    constrain(region)
                loss = float(total.detach())
        return Figures(loss, kl)


def normalised(advantage: Tensor) -> Tensor:
    """Return advantages (n) with a mean of zero and, if there are several, a standard deviation of one."""
    centred = advantage - advantage.mean()
    return centred if len(advantage) < 2 else centred / (advantage.std() + 1e-8)


@dataclass
class _State:
    """All that the rest of a phase depends on, and what is to be told of it at the end."""

    regions: Mapping[str, Region]
    rollout: Practice
    learner: Learner
    parameters: Parameters
    start: dict[str, Tensor] = field(init=False)
    best: dict[str, Tensor] = field(init=False)
    curve: list[list[float]] = field(default_factory=list)  # of each iteration: mean return, divergence
    validations: list[list[float]] = field(default_factory=list)  # iterations done, mean return

    def __post_init__(self) -> None:
        """Begin with the weights that there are, which are the best so far."""
        self.start = _kept(self.parameters)
        self.best = self.start

    def validate(self, done: int) -> None:
        """Find out what the present weights gain, and keep them if that is the most."""
        mean = float(np.mean(self.rollout.perform(self.learner.phase.validation.seeds).returns))
        if all(mean > other for _, other in self.validations):
            self.best = _kept(self.parameters)
        self.validations.append([done, mean])

    def belongs(self) -> dict[str, Any]:
        """Return what a checkpoint must agree in to be gone on from, under the names that an error gives them."""
        return {
            "the settings of the phase": self.learner.phase.model_dump(mode="json"),
            "the configuration of the regions": {
                name: signature_hash(region.config, region.clock) for name, region in self.regions.items()
            },
            "the rest of the closed loop": self.rollout.fingerprint(),
        }

    def tensors(self) -> dict[str, Tensor]:
        """Return the state as named tensors that share no memory with it."""
        learner = self.learner
        named = {
            **_below("best", self.best),
            **_below("weights", _kept(self.parameters)),
            **_below("critic", _kept(learner.critic.state_dict())),
            "generator": learner.generator.get_state(),
            "curve": torch.tensor(self.curve, dtype=torch.float64).reshape(-1, 2),
            "validations": torch.tensor(self.validations, dtype=torch.float64).reshape(-1, 2),
        }
        for prefix, optimiser, parameters in self._optimisers():
            for name, parameter in parameters.items():
                named |= _below(f"{prefix}.{name}", _kept(optimiser.state.get(parameter, {})))
        return named

    def resume(self, checkpoints: Checkpoints) -> int:
        """Take over a checkpoint, if there is one, and return how many iterations are done."""
        found = checkpoints.read(self.belongs())
        if found is None:
            return 0
        done, tensors = found
        learner = self.learner
        try:
            _load(self.parameters, _under("weights", tensors))
            self.best = _under("best", tensors)
            learner.critic.load_state_dict(_under("critic", tensors))
            for prefix, optimiser, parameters in self._optimisers():
                for name, parameter in parameters.items():
                    if moments := _under(f"{prefix}.{name}", tensors):
                        optimiser.state[parameter] = moments
            learner.generator.set_state(tensors["generator"])
            self.curve, self.validations = (
                tensors["curve"].tolist(),
                [[int(count), mean] for count, mean in tensors["validations"].tolist()],
            )
        except (KeyError, TypeError, RuntimeError) as error:
            raise NeuroroboError(
                f"{checkpoints.file} is not a checkpoint of these regions ({error}); remove it to start afresh"
            ) from error
        return done

    def _optimisers(self) -> Iterator[tuple[str, torch.optim.Adam, Parameters]]:
        yield "adam", self.learner.optimiser, self.parameters
        yield "critic_adam", self.learner.critic_optimiser, dict(self.learner.critic.named_parameters())


def _kept(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name: tensor.detach().clone() for name, tensor in tensors.items()}


def _below(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {f"{prefix}/{name}": tensor for name, tensor in tensors.items()}


def _under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {
        name.removeprefix(f"{prefix}/"): tensor for name, tensor in tensors.items() if name.startswith(f"{prefix}/")
    }


@torch.no_grad()
def _load(parameters: Parameters, weights: Mapping[str, Tensor]) -> None:
    for name, parameter in parameters.items():
        parameter.copy_(weights[name])


def _chosen(regions: Mapping[str, Region], phase: PpoPhase) -> dict[str, nn.Parameter]:
    """Return the parameters that the phase trains, by region and name."""
    chosen: dict[str, nn.Parameter] = {}
    for name, region in regions.items():
        groups = region.parameter_groups()
        wanted = {id(parameter) for group in phase.regions[name] for parameter in groups[group].parameters()}
        if not wanted:
            raise NeuroroboError(f"there is nothing to train in {', '.join(phase.regions[name])} of `{name}`")
        chosen |= {f"{name}.{key}": each for key, each in region.named_parameters() if id(each) in wanted}
    return chosen


@contextmanager
def _as_in_use(regions: Collection[Region]) -> Iterator[None]:
    """Let regions learn as they act: no part of them behaves as in training, if there were one that does."""
    modes = [(region, region.training) for region in regions]
    try:
        for region, _ in modes:
            region.eval()
        yield
    finally:
        for region, mode in modes:
            region.train(mode)
