"""The configuration of learning by proximal policy optimisation (PPO); imports no torch."""

from collections.abc import Collection, Iterator, Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from neurorobo.errors import ConfigError, Fault, did_you_mean
from neurorobo.graph.plan import Edge, Plan, Repeat, Use
from neurorobo.learning.phase import Phase, QuantityText, Surroundings
from neurorobo.seeds import TRAINING_SEEDS
from neurorobo.units import UnitError, parse_quantity


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class CriticConfig(_Strict):
    """The critic: a network of plain numbers that reads the sensors and the time since the start of the episode."""

    hidden: tuple[Annotated[int, Field(ge=1)], ...] = Field(default=(64, 64), description="Units of each hidden layer.")
    learning_rate: float = Field(default=1e-3, gt=0)


class Episodes(_Strict):
    """Episodes of consecutive seeds, in which nothing is explored."""

    first_seed: int = Field(ge=0)
    episodes: int = Field(ge=1)

    @model_validator(mode="after")
    def _before_those_of_training(self) -> Self:
        if self.seeds.stop > TRAINING_SEEDS[0]:
            raise ValueError(f"seeds from {TRAINING_SEEDS[0]} on are those of training; the last is {self.seeds[-1]}")
        return self

    @property
    def seeds(self) -> range:
        """The seed of each episode."""
        return range(self.first_seed, self.first_seed + self.episodes)


class Validation(Episodes):
    """The episodes by which the best weights are chosen, and how often that is done."""

    first_seed: int = Field(default=1000, ge=0)
    episodes: int = Field(default=48, ge=1)
    every: int = Field(default=4, ge=1, description="Iterations from one validation to the next.")


class HeldOut(Episodes):
    """The episodes that only report how good the weights are, before and after."""

    first_seed: int = Field(default=0, ge=0)
    episodes: int = Field(default=100, ge=1)


class PpoPhase(Phase):
    """Train regions that command the body to gain more of the task's reward, by proximal policy optimisation.

    The policy is the closed loop of the experiment: a command is drawn from a Gaussian around what the brain says.
    Regions that no earlier phase has trained begin with the weights that the file names.

    Source: Schulman et al. 2017 (PPO) and 2016 (GAE), through spikes by the surrogate gradients of Wu et al. 2018.
    """

    implementation: ClassVar[str] = "neurorobo.learning.ppo:ppo"
    rollout: ClassVar[str] = "neurorobo.experiment.practice:Practice"
    from_weights: ClassVar[bool] = True

    phase: Literal["ppo"] = "ppo"
    regions: dict[str, tuple[str, ...]] = Field(
        min_length=1, description="The regions that learn, each with the parameter groups to train."
    )
    explore: dict[str, QuantityText] = Field(
        min_length=1,
        description="The commands that are varied, each with the standard deviation: {axial_speed: 2 um/s}.",
    )
    iterations: int = Field(ge=1, description="How often episodes are run and learned from.")
    episodes: int = Field(default=64, ge=1, description="Episodes of an iteration, each of a fresh seed.")
    epochs: int = Field(default=4, ge=1, description="How often each tick of them is learned from.")
    minibatch: int = Field(default=128, ge=1, description="Ticks of one step of training.")
    learning_rate: float = Field(
        gt=0,
        description="Adam's, for a fan-in of one; other weights get it divided by its root. It falls to zero linearly.",
    )
    discount: float = Field(default=0.99, ge=0, le=1, description="gamma: how much a reward counts one tick later.")
    gae_lambda: float = Field(
        default=0.95, ge=0, le=1, description="lambda: how far rewards are trusted over the critic (GAE)."
    )
    clip: float = Field(default=0.2, gt=0, lt=1, description="How far a probability may change for its own good.")
    target_kl: float | None = Field(
        default=None, gt=0, description="An iteration ends early when the policy has gone 1.5 times as far."
    )
    critic: CriticConfig = CriticConfig()
    validation: Validation = Validation()
    held_out: HeldOut = HeldOut()

    @model_validator(mode="after")
    def _held_out_from_the_choice(self) -> Self:
        chosen_on, held_out = self.validation.seeds, self.held_out.seeds
        if chosen_on.start < held_out.stop and held_out.start < chosen_on.stop:
            raise ValueError("the seeds of `held_out` and `validation` overlap, on which weights are chosen")
        return self

    @property
    def pupils(self) -> Mapping[str, tuple[str | int, ...]]:
        """The regions that learn."""
        return {name: ("regions", name) for name in self.regions}

    @property
    def needs_rollout(self) -> bool:
        """It learns from nothing else."""
        return True

    def deviations(self, plan: Plan) -> dict[str, float]:
        """Return the standard deviation of each command that is varied, in the actuator's unit."""
        return {name: parse_quantity(text, plan.command[name].reader_port.unit) for name, text in self.explore.items()}

    def check(self, surroundings: Surroundings) -> None:
        """Raise a ConfigError with all that does not fit the experiment."""
        if surroundings.body is None:
            raise ConfigError([Fault(("phase",), "needs a `body` and a `task`, whose reward it learns from")])
        assert surroundings.plan is not None
        if faults := [*self._command_faults(surroundings.plan), *self._pupil_faults(surroundings)]:
            raise ConfigError(faults)

    def check_parameters(self, groups: Mapping[str, Collection[str]]) -> None:
        """Raise a ConfigError if the phase names groups that there are not."""
        faults = [
            Fault(("regions", region, index), f"`{region}` has no parameter group `{name}`{did_you_mean(name, there)}")
            for region, there in groups.items()
            for index, name in enumerate(self.regions[region])
            if name not in there
        ]
        if faults:
            raise ConfigError(faults)

    def _command_faults(self, plan: Plan) -> Iterator[Fault]:
        """Yield what is wrong with the commands that are to be varied."""
        for name, text in self.explore.items():
            path = ("explore", name)
            if name not in plan.command:
                yield Fault(path, f"the body has no actuator `{name}`{did_you_mean(name, plan.command)}")
                continue
            edge = plan.command[name]
            try:
                if parse_quantity(text, edge.reader_port.unit) <= 0:
                    yield Fault(path, f"a standard deviation is above zero (got '{text}')")
            except UnitError as error:
                yield Fault(path, str(error))
            yield from self._source_faults(path, edge, plan)

    def _source_faults(self, path: tuple[str, ...], edge: Edge, plan: Plan) -> Iterator[Fault]:
        """Yield what keeps gradients from what commands an actuator."""
        use = acting_use(edge, plan)
        if use is None:
            yield Fault(path, f"comes from `{edge.source}` inside a `repeat`; let a step of its own command it")
            return
        if use.region not in self.regions:
            yield Fault(
                path,
                f"comes from `{use.name}`, whose region `{use.region}` does not learn in this phase; add it to "
                "`regions`, or leave this command out",
            )
        code = edge.source_port.code
        if code is not None and not code.differentiable:
            yield Fault(
                path,
                f"nothing can be learned through the code of `{edge.source}.{edge.output}`, {type(code).__name__}, "
                "which has no gradient; give it one that counts spikes, such as population_uniform",
            )

    def _pupil_faults(self, surroundings: Surroundings) -> Iterator[Fault]:
        """Yield the regions for which nothing tells how they should change, or whose state cannot be told."""
        plan = surroundings.plan
        assert plan is not None
        acting = [acting_use(plan.command[name], plan) for name in self.explore if name in plan.command]
        for name, groups in self.regions.items():
            if not groups:
                yield Fault(("regions", name), "name the parameter groups to train")
            if all(use is None or use.region != name for use in acting):
                yield Fault(("regions", name), f"no step of `{name}` gives a command under `explore`; leave it out")
            used = sum(use.region == name for use in plan.uses())
            if surroundings.pupils[name].config.carry == "always" and used > 1:
                yield Fault(
                    ("regions", name),
                    f"`{name}` carries its state through {used} steps; only one of one step can learn",
                )


def acting_use(edge: Edge, plan: Plan) -> Use | None:
    """Return the step that a command comes from, or nothing if it is inside a repeat."""
    for item in plan.order:
        if not isinstance(item, Repeat) and item.name == edge.source:
            return item
    return None
